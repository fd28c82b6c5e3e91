//! Maps as pictures: what is where, in which grey, and how large.

#![allow(clippy::unwrap_used, reason = "tests")]

use ubbmap::picture::{MAX_SIDE, Picture, known_range};
use ubbmap::quadtree::{Block, BlockAddress, BlockView, ClassScale, Grid, LeafRange, OccupancyTree};

/// A map whose leaves have these classes, the others unknown.
fn map(depth: u32, leaves: &[(u32, u32, u8)]) -> (OccupancyTree, Grid) {
    let scale = ClassScale::new(10).unwrap();
    let mut tree = OccupancyTree::new(depth as u8, scale);
    for (x, y, class) in leaves {
        let address = BlockAddress { x: x / 64, y: y / 64 };
        let mut cells = match tree.block(address) {
            BlockView::Uniform(class) => Box::new([class; 64 * 64]),
            BlockView::Mixed(block) => Box::new(*block.leaves()),
        };
        cells[(y % 64 * 64 + x % 64) as usize] = *class;
        tree.set_block(address, BlockView::Mixed(Block::from_leaves(cells).into()));
    }
    (tree, Grid::new(0.1, depth, None).unwrap())
}

/// The grey at the middle of a cell's place.
fn grey(picture: &Picture, x: u32, y: u32) -> u8 {
    picture.pixels()[(y * picture.width() + x) as usize]
}

#[test]
fn known_range_is_tight() {
    let range = |min_x, min_y, max_x, max_y| Some(LeafRange { min_x, min_y, max_x, max_y });
    assert_eq!(known_range(&map(12, &[]).0), None);
    assert_eq!(known_range(&map(12, &[(70, 130, 1)]).0), range(70, 130, 71, 131));
    assert_eq!(known_range(&map(12, &[(70, 130, 4), (5, 3000, 6), (70, 131, 5)]).0), range(5, 130, 71, 3001));
    assert_eq!(known_range(&map(3, &[(7, 0, 1)]).0), range(7, 0, 8, 1));
    let (mut tree, _) = map(8, &[]);
    tree.set_block(BlockAddress { x: 2, y: 1 }, BlockView::Uniform(1));
    assert_eq!(known_range(&tree), range(128, 64, 192, 128));
}

#[test]
fn up_is_up_and_greys_tell_classes() {
    let classes: Vec<(u32, u32, u8)> = (1..=10).map(|class| (100 + u32::from(class) * 10, 200, class)).collect();
    let (tree, grid) = map(10, &[&classes[..], &[(105, 290, 10)]].concat());
    let picture = Picture::of_map(&tree, &grid, "greys");
    // Leaves 105 .. 201 with a margin of 6 on each side, 8 pixels a leaf.
    let (left, top, scale) = (105 - 6, 291 + 6, 8);
    let at = |x: u32, y: u32| grey(&picture, (x - left) * scale + 4, (top - 1 - y) * scale + 4);
    assert_eq!(picture.width(), (201 - 105 + 12) * scale);
    let greys: Vec<u8> = (1..=10).map(|class| at(100 + class * 10, 200)).collect();
    assert_eq!((greys[0], greys[9]), (255, 0), "free is white, occupied black");
    assert!(greys.windows(2).all(|pair| pair[0] > pair[1]), "every class is darker than the one below: {greys:?}");
    assert_eq!(greys[4], at(150, 250), "unknown is the ground");
    assert_eq!(at(105, 290), 0, "rows go up");
    assert_eq!(at(105, 289), greys[4]);
    // Each grade can be told from unknown.
    assert!(greys[3] - greys[4] > 30 && greys[4] - greys[5] > 30, "{greys:?}");
}

#[test]
fn a_huge_map_is_drawn_by_coarse_maxima_and_loses_no_obstacle() {
    let corners = [(10, 20, 1), (60_000, 50_000, 1), (33_333, 22_222, 10), (33_334, 22_222, 1)];
    let (tree, grid) = map(16, &corners);
    let picture = Picture::of_map(&tree, &grid, "huge");
    assert!(picture.width() <= MAX_SIDE && picture.width() > MAX_SIDE / 2, "{}", picture.width());
    // The map's part ends at the black line; above, the one obstacle is the one black cell.
    let mut rows =
        picture.pixels().chunks(picture.width() as usize).take_while(|row| row.iter().any(|grey| *grey != 0));
    assert_eq!(rows.by_ref().flatten().filter(|grey| **grey == 0).count(), 1);
}

#[test]
fn an_empty_map_and_a_tiny_one_are_pictures_too() {
    for (tree, grid) in [map(16, &[]), map(1, &[]), map(1, &[(0, 0, 1), (1, 1, 10)]), map(24, &[(0, 0, 10)])] {
        let picture =
            Picture::of_map(&tree, &grid, "a caption, with (marks) ~ and letters that no font has: \u{1f600}");
        let mut bytes = Vec::new();
        picture.write_png(&mut bytes).unwrap();
        let reader = png::Decoder::new(std::io::Cursor::new(bytes)).read_info().unwrap();
        assert_eq!((reader.info().width, reader.info().height), (picture.width(), picture.height()));
        assert!(picture.width() >= 500 && picture.height() < 2000);
    }
}
