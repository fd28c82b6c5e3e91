//! What evidence is drawn on: one bit a leaf and plane.

/// A plane of a sheet.
pub(super) type Plane = usize;
/// Leaves of X_OCC.
pub(super) const OCCUPIED: Plane = 0;
/// Leaves that the dilated boundary of the free star may touch.
pub(super) const BOUNDARY: Plane = 1;
/// Where the parity "inside the free star" changes along a row.
pub(super) const TOGGLE: Plane = 2;
/// Leaves that are empty for another reason: cones of the paper's rules, the robot's footprint.
pub(super) const FILLED: Plane = 3;

/// Leaves along one side of a tile, as a shift.
pub(super) const TILE_SHIFT: i32 = 6;

/// A window of leaves that can be drawn on row by row. What lies outside the window is left out.
pub(super) trait Sheet {
    /// Sets the leaves `first..=last` of a row, in window coordinates.
    fn span<const PLANE: Plane>(&mut self, row: i32, first: i32, last: i32);

    /// Flips "inside" for the leaf `column` of a row and all behind it.
    fn toggle(&mut self, row: i32, column: i32);

    /// Adds the leaves inside the star and off its boundary to [`FILLED`], and blanks the star's two planes.
    fn keep_star(&mut self);
}

/// The leaves inside, from the toggles of a tile and the parity that its left neighbour hands over, row by row; `carry`
/// becomes what this tile hands over to its right neighbour.
#[inline(always)]
pub(super) fn fill(toggle: &[u64; 64], carry: &mut [u64; 64]) -> [u64; 64] {
    let mut inside = *toggle;
    for word in &mut inside {
        *word ^= *word << 1;
        *word ^= *word << 2;
        *word ^= *word << 4;
        *word ^= *word << 8;
        *word ^= *word << 16;
        *word ^= *word << 32;
    }
    for (word, carry) in inside.iter_mut().zip(carry) {
        *word ^= *carry;
        // The last leaf's parity, spread over a word.
        *carry = 0_u64.wrapping_sub(*word >> 63);
    }
    inside
}
