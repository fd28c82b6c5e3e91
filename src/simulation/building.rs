//! A small office building: nine rooms on both sides of a corridor, furnished, 25 m by 15 m.

use super::furniture::RoomFrame;
use super::{Pane, Point, Shape, World};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::f64::consts::{PI, TAU};

/// Outer size along x and y, metres: the building stands on `0..WIDTH` and `0..DEPTH`.
pub const WIDTH: f64 = 25.0;
/// See [`WIDTH`].
pub const DEPTH: f64 = 15.0;

/// The corridor's wall faces, metres.
const CORRIDOR: (f64, f64) = (6.675, 8.525);
const WALL: f64 = 0.15;
const DOOR: f64 = 0.95;

#[derive(Debug, Clone, Copy, PartialEq)]
enum Kind {
    Office,
    Meeting,
    Kitchen,
    Lab,
    OpenPlan,
    Store,
}

/// South of the corridor, from the west: the wall on the east side of each room.
const SOUTH: [(f64, Kind); 5] =
    [(4.6, Kind::Office), (9.2, Kind::Office), (15.2, Kind::Meeting), (19.9, Kind::Office), (WIDTH, Kind::Kitchen)];
/// North of the corridor.
const NORTH: [(f64, Kind); 4] = [(5.4, Kind::Lab), (15.0, Kind::OpenPlan), (19.6, Kind::Store), (WIDTH, Kind::Office)];

/// A room and the way through it.
#[derive(Debug, Clone, PartialEq)]
pub struct Room {
    /// What it is for, in one word.
    pub name: &'static str,
    /// Way points from the corridor's middle before the door into the room, about it, and out again; metres. A robot of
    /// 0.25 m radius gets through without touching anything.
    pub route: Vec<Point>,
}

/// The building: its obstacles and its rooms.
#[derive(Debug, Clone, PartialEq)]
pub struct Building {
    /// All walls and furniture; none thinner than 2 cm.
    pub world: World,
    /// The rooms, south side from the west, then the north side.
    pub rooms: Vec<Room>,
}

/// Half the width of a window, metres.
const WINDOW: f64 = 0.9;

impl Building {
    /// The building; `seed` shifts chairs, doors and clutter a little, the plan stays.
    #[must_use]
    pub fn new(seed: u64) -> Self {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let mut shapes = vec![
            Shape::rectangle_between((-0.25, -0.25), (WIDTH + 0.25, 0.0)),
            Shape::rectangle_between((-0.25, DEPTH), (WIDTH + 0.25, DEPTH + 0.25)),
            Shape::rectangle_between((-0.25, 0.0), (0.0, DEPTH)),
            Shape::rectangle_between((WIDTH, 0.0), (WIDTH + 0.25, DEPTH)),
        ];
        let mut rooms = Vec::new();
        for (up, plan) in [(-1.0, &SOUTH[..]), (1.0, &NORTH[..])] {
            let wall = if up < 0.0 { CORRIDOR.0 - WALL } else { CORRIDOR.1 + WALL };
            let mut west = 0.0;
            for (east, kind) in plan {
                let frame = RoomFrame { origin: (west, wall), up };
                let size = (
                    east - west - if *east < WIDTH { WALL } else { 0.0 },
                    (if up < 0.0 { wall } else { DEPTH - wall }),
                );
                rooms.push(build_room(*kind, &frame, size, &mut shapes, &mut random));
                if *east < WIDTH {
                    shapes.push(frame.block((size.0, 0.0), (size.0 + WALL, size.1)));
                }
                west = *east;
            }
        }
        furnish_corridor(&mut shapes);
        Self { world: World::new(shapes), rooms }
    }

    /// A window in the middle of the outer wall of every room.
    #[must_use]
    pub fn panes() -> Vec<Pane> {
        let mut panes = Vec::new();
        for (y, plan) in [(0.0, &SOUTH[..]), (DEPTH, &NORTH[..])] {
            let mut west = 0.0;
            for (east, _) in plan {
                let middle = 0.5 * (west + east);
                panes.push(Pane { y, x: (middle - WINDOW, middle + WINDOW) });
                west = *east;
            }
        }
        panes
    }
}

/// Corridor wall with a door, the door's leaf standing open, the furniture, and the way.
fn build_room(
    kind: Kind,
    frame: &RoomFrame,
    (width, depth): (f64, f64),
    shapes: &mut Vec<Shape>,
    random: &mut ChaCha8Rng,
) -> Room {
    let hinge = 0.3 + random.random_range(0.0..0.06);
    let door = hinge + 0.5 * DOOR;
    // The wall runs on over the partition on the room's east side.
    shapes.push(frame.block((0.0, -WALL), (hinge, 0.0)));
    shapes.push(frame.block((hinge + DOOR, -WALL), (width + WALL, 0.0)));
    let open: f64 = random.random_range(1.5..1.75);
    shapes.push(frame.board((hinge, 0.03), (hinge + 0.9 * open.cos(), 0.03 + 0.9 * open.sin()), 0.04));
    let middle = 0.5 * width;
    let (name, inside): (&str, Vec<(f64, f64)>) = match kind {
        Kind::Office => {
            office(frame, (width, depth), shapes, random);
            ("office", vec![(middle, 1.6), (middle, depth - 1.2), (middle, 1.6)])
        }
        Kind::Meeting => {
            meeting(frame, (width, depth), shapes, random);
            let (far, back) = (width - 0.65, depth - 1.0);
            ("meeting", vec![(0.65, 1.5), (0.65, back), (far, back), (far, 1.1)])
        }
        Kind::Kitchen => {
            kitchen(frame, (width, depth), shapes, random);
            ("kitchen", vec![(middle, 1.1), (middle, depth - 1.4), (middle, 1.1)])
        }
        Kind::Lab => {
            lab(frame, (width, depth), shapes);
            ("lab", vec![(middle, 1.3), (middle - 1.05, 3.6), (middle, 5.15), (middle + 1.05, 3.6), (middle, 1.3)])
        }
        Kind::OpenPlan => {
            open_plan(frame, (width, depth), shapes, random);
            ("open plan", vec![(4.8, 1.2), (4.8, 5.2), (4.8, 1.2), (width - 0.8, 1.2)])
        }
        Kind::Store => {
            store(frame, (width, depth), shapes, random);
            ("store", vec![(1.28, 1.4), (1.28, 5.2), (3.3, 5.2), (3.3, 1.2)])
        }
    };
    let before = -(WALL + 0.5 * (CORRIDOR.1 - CORRIDOR.0));
    let way = [(door, before), (door, 0.95)].into_iter().chain(inside).chain([(door, 0.95), (door, before)]);
    Room { name, route: way.map(|(u, v)| frame.point(u, v)).collect() }
}

fn office(frame: &RoomFrame, (width, depth): (f64, f64), shapes: &mut Vec<Shape>, random: &mut ChaCha8Rng) {
    for (left, v) in [(true, 2.6), (false, 2.2)] {
        let side = |u: f64| if left { u } else { width - u };
        let (a, b) = (side(0.05).min(side(0.85)), side(0.05).max(side(0.85)));
        frame.table((a, v), (b, v + 1.6), 2, 0.025, shapes);
        // A set of drawers under the desk.
        shapes.push(frame.block((side(0.12), v + 1.1), (side(0.7), v + 1.5)));
        let chair = (side(1.15 + random.random_range(0.0..0.08)), v + 0.6 + random.random_range(-0.2..0.2));
        frame.office_chair(chair.0, chair.1, random.random_range(0.0..TAU), shapes);
    }
    shapes.push(frame.block((0.3, depth - 0.45), (1.5, depth)));
    shapes.push(frame.block((width - 1.6, depth - 0.45), (width - 0.5, depth)));
    shapes.push(frame.round(width - 0.35, 0.45, 0.17));
    shapes.push(frame.round(0.3, 2.2, 0.14));
}

fn meeting(frame: &RoomFrame, (width, depth): (f64, f64), shapes: &mut Vec<Shape>, random: &mut ChaCha8Rng) {
    let (u, v) = (0.5 * width, 3.3);
    frame.table((u - 1.3, v - 0.6), (u + 1.3, v + 0.6), 2, 0.035, shapes);
    frame.table((u - 0.3, v - 0.6), (u + 0.3, v + 0.6), 2, 0.035, shapes);
    for i in 0..3 {
        let across = u - 0.85 + 0.85 * f64::from(i) + random.random_range(-0.06..0.06);
        frame.chair(across, v - 0.85, random.random_range(-0.3..0.3), shapes);
        frame.chair(across, v + 0.85, PI + random.random_range(-0.3..0.3), shapes);
    }
    frame.chair(u - 1.5, v, random.random_range(-0.3..0.3), shapes);
    frame.chair(u + 1.5, v, random.random_range(-0.3..0.3), shapes);
    shapes.push(frame.block((1.2, depth - 0.4), (width - 1.2, depth)));
    // A whiteboard on its stand.
    shapes.push(frame.board((width - 1.9, 0.35), (width - 0.9, 0.3), 0.03));
}

fn kitchen(frame: &RoomFrame, (width, depth): (f64, f64), shapes: &mut Vec<Shape>, random: &mut ChaCha8Rng) {
    shapes.push(frame.block((0.0, depth - 0.6), (width - 0.75, depth)));
    shapes.push(frame.block((width - 0.68, depth - 0.68), (width, depth)));
    for (u, away) in [(1.1, 1.0), (width - 1.1, -1.0)] {
        let v = 3.1;
        shapes.push(frame.round(u, v, 0.05));
        for k in 0..3 {
            let angle = if away > 0.0 { PI } else { 0.0 } + (f64::from(k) - 1.0) * 1.35;
            let turn = random.random_range(-0.4..0.4);
            frame.chair(u + 0.62 * angle.cos(), v + 0.62 * angle.sin(), angle + turn, shapes);
        }
    }
    shapes.push(frame.round(width - 0.3, 0.35, 0.2));
}

fn lab(frame: &RoomFrame, (width, depth): (f64, f64), shapes: &mut Vec<Shape>) {
    frame.table((0.02, 1.9), (0.77, 5.1), 5, 0.03, shapes);
    frame.table((width - 0.77, 1.9), (width - 0.02, 5.1), 5, 0.03, shapes);
    shapes.push(frame.round(0.5 * width, 3.6, 0.5));
    shapes.push(frame.block((0.1, depth - 0.4), (1.3, depth)));
    shapes.push(Shape::Rectangle { center: frame.point(width - 0.7, depth - 0.6), heading: 0.5, half: (0.4, 0.3) });
    shapes.push(frame.block((width - 0.4, 0.05), (width - 0.05, 0.9)));
}

fn open_plan(frame: &RoomFrame, (width, depth): (f64, f64), shapes: &mut Vec<Shape>, random: &mut ChaCha8Rng) {
    for u in [0.7, width - 0.7 - 3.2] {
        let v = 2.9;
        for (du, dv) in [(0.0, 0.0), (1.6, 0.0), (0.0, 0.8), (1.6, 0.8)] {
            frame.table((u + du, v + dv), (u + du + 1.6, v + dv + 0.8), 2, 0.025, shapes);
            let chair = (u + du + 0.8 + random.random_range(-0.15..0.15), if dv == 0.0 { v - 0.25 } else { v + 1.85 });
            frame.office_chair(chair.0, chair.1, random.random_range(0.0..TAU), shapes);
        }
        // The screen between the desks.
        shapes.push(frame.board((u + 0.1, v + 0.8), (u + 3.1, v + 0.8), 0.04));
        shapes.push(frame.round(u + 1.6, 1.95, 0.18));
    }
    shapes.push(frame.block((0.6, depth - 0.42), (3.4, depth)));
    shapes.push(frame.block((5.6, depth - 0.42), (8.2, depth)));
    shapes.push(frame.round(4.8, depth - 0.3, 0.2));
}

fn store(frame: &RoomFrame, (width, depth): (f64, f64), shapes: &mut Vec<Shape>, random: &mut ChaCha8Rng) {
    for u in [0.05, 2.05, width - 0.5] {
        shapes.push(frame.block((u, 2.0), (u + 0.45, 4.5)));
    }
    for u in [0.4, 1.1, 2.3, 3.1, 3.9] {
        let half = (random.random_range(0.12..0.22), random.random_range(0.12..0.2));
        let heading = random.random_range(-0.4..0.4);
        shapes.push(Shape::Rectangle { center: frame.point(u, depth - 0.32), heading, half });
    }
}

/// Benches, plants and a printer along the corridor's walls, clear of the doors.
fn furnish_corridor(shapes: &mut Vec<Shape>) {
    let (south, north) = CORRIDOR;
    shapes.push(Shape::rectangle_between((2.3, north - 0.38), (3.8, north)));
    shapes.push(Shape::rectangle_between((11.6, north - 0.35), (13.2, north)));
    shapes.push(Shape::rectangle_between((6.6, south), (7.4, south + 0.36)));
    shapes.push(Shape::rectangle_between((17.1, south), (18.6, south + 0.35)));
    for (x, y) in [(8.5, north - 0.2), (22.6, north - 0.2), (12.9, south + 0.2), (24.7, south + 0.3)] {
        shapes.push(Shape::Disc { center: Point::new(x, y), radius: 0.16 });
    }
}
