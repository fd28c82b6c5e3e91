//! The leaves of one block that meet a region: a row of nodes above them first, then pieces of rows.

use super::lens::{Lens, Scaled, bits};
use super::probe::Cover;
use super::rows::Rows;
use crate::quadtree::{BLOCK_LEVELS, BLOCK_SIDE, Block, BlockAddress, Class, NodeAddress};

/// Level of a block whose nodes are looked at before the leaves, and their side in leaves.
const CELL_LEVEL: u8 = BLOCK_LEVELS - 2;
const CELL: u32 = 4;

impl Lens<'_> {
    /// The largest class of the leaves of a block that meet the part, or `least` where none is larger. The block's node
    /// was classified, or the part's first node is within the block.
    pub fn largest_in(&mut self, address: BlockAddress, block: &Block, least: Class) -> Class {
        let mut largest = least;
        let slack = self.slack;
        match &self.shape {
            Scaled::Rectangle { lo, hi } => {
                let (lo, hi) = ((lo.0 - slack, lo.1 - slack), (hi.0 + slack, hi.1 + slack));
                self.scan(address, block, (lo, hi), |_, _| (lo.0, hi.0), &mut largest);
            }
            Scaled::Disc { center, radius, .. } => {
                let rows = Rows::new(*center, *center, radius + slack);
                self.scan(address, block, rows.bounds(), |y, height| rows.span(y, height), &mut largest);
            }
            Scaled::Path(capsules) => {
                let (radius, leaves) = (capsules.radius + slack, usize::from(self.grid.depth()));
                for bit in bits(capsules.candidates(self.grid.depth() - BLOCK_LEVELS)) {
                    let Scaled::Path(capsules) = &mut self.shape else { break };
                    let line = capsules.lines[capsules.first + bit];
                    if !line.is_near(address, radius) {
                        continue;
                    }
                    let rows = Rows::new(line.start, line.end(), radius);
                    // One piece at a time: leaves are tested against it alone.
                    capsules.open[leaves] = 1 << bit;
                    self.scan(address, block, rows.bounds(), |y, height| rows.span(y, height), &mut largest);
                }
            }
        }
        largest
    }

    /// Raises `largest` to the largest class of the leaves of a block that meet a piece of the part, which lies within
    /// `bounds` and covers `span` along x from a height on for another.
    fn scan(
        &mut self,
        address: BlockAddress,
        block: &Block,
        bounds: ((f64, f64), (f64, f64)),
        span: impl Fn(f64, f64) -> (f64, f64),
        largest: &mut Class,
    ) {
        let (left, low) = (address.x * BLOCK_SIDE, address.y * BLOCK_SIDE);
        let (from, to) = bounds;
        let (Some(columns), Some(rows)) = (within((from.0, to.0), left), within((from.1, to.1), low)) else { return };
        if *largest == 0 {
            // Most leaves of a free region are of one class; with it the tests below settle nearly everything.
            let [x, y] = [columns, rows].map(|(first, last)| first.midpoint(last));
            self.test(block, NodeAddress { depth: self.grid.depth(), x: left + x, y: low + y }, largest);
        }
        let cells = |row: u32, (first, last): (u32, u32)| {
            &block.level_row(CELL_LEVEL, row)[(first / CELL) as usize..=(last / CELL) as usize]
        };
        let cell_rows = rows.0 / CELL..=rows.1 / CELL;
        if cell_rows.clone().all(|row| none_above(cells(row, columns), *largest)) {
            return;
        }
        for cell_row in cell_rows {
            let (first, last) = ((cell_row * CELL).max(rows.0), (cell_row * CELL + CELL - 1).min(rows.1));
            let covered = within(span(f64::from(low + first), f64::from(last + 1 - first)), left);
            if covered.is_none_or(|columns| none_above(cells(cell_row, columns), *largest)) {
                continue;
            }
            for row in first..=last {
                let Some((from, to)) = within(span(f64::from(low + row), 1.0), left) else { continue };
                let classes = &block.level_row(BLOCK_LEVELS, row)[from as usize..=to as usize];
                if !none_above(classes, *largest) {
                    for x in left + from..=left + to {
                        self.test(block, NodeAddress { depth: self.grid.depth(), x, y: low + row }, largest);
                    }
                }
            }
        }
    }

    /// Raises `largest` to the class of a leaf of a block, if it meets the part.
    fn test(&mut self, block: &Block, leaf: NodeAddress, largest: &mut Class) {
        let class = block.max_at(BLOCK_LEVELS, leaf.x, leaf.y);
        if class > *largest && self.classify(leaf) == Cover::All {
            *largest = class;
        }
    }
}

/// The columns (or rows) of the block that begins at leaf `first` which an interval meets, from 0.
fn within((from, to): (f64, f64), first: u32) -> Option<(u32, u32)> {
    let (from, to, side) = (from - f64::from(first), to - f64::from(first), f64::from(BLOCK_SIDE));
    // Casts round towards zero, which is down here.
    (to >= 0.0 && from < side).then(|| (from.max(0.0) as u32, to.min(side - 1.0) as u32))
}

fn none_above(classes: &[Class], largest: Class) -> bool {
    // Without an early end this compiles to vector code; the slices are short.
    classes.iter().fold(0, |above, class| above | u8::from(*class > largest)) == 0
}
