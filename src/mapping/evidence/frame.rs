//! From metres in the map frame to window coordinates in leaves, and the slack that floating point needs.

use super::outline::Place;
use super::raster::Point;
use crate::interval::Interval;
use crate::quadtree::{BLOCK_SIDE, Grid};
use crate::sensor::Scan;

/// Slack of the window arithmetic, leaves.
///
/// A scan reaches at most four times [`super::super::config::MAX_REACH_CELLS`] (its range, twice that aside for a wide heading,
/// the beam's diameter; or the footprint and twice the mount), from anywhere in a box of positions that is at most
/// [`super::super::config::MAX_SPREAD_CELLS`] wide. The window has room for that on both sides, so its coordinates are below 2^18
/// leaves and one operation is off by at most 2^-35. A vertex is the sensor's centre plus a distance times a product of two unit vectors: below 16 operations, 2^-31. Angles are
/// off by at most 2^-42 rad (see [`super::star`]), which moves a vertex by at most 2^14 * 2^-42 = 2^-28. An edge's x is found
/// for a y that is off by 2^-34. Together below 2^-27; 2^-20 leaves a factor of 128.
const WINDOW_SLACK: f64 = 1.0 / (1 << 20) as f64;

/// Tiles along one side of a dense window.
const DENSE_TILES: i32 = super::window::TILES as i32;

/// Farther from the sensor's middle nothing may be drawn on a dense window, leaves: half its side less the sensor's tile and
/// the rows that are written together.
const DENSE_REACH: f64 = (super::window::SIDE / 2 - 64 - 16) as f64;

/// The window of one scan: where it lies and where the sensor's origin may be in it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Frame {
    /// Block coordinates of the window's first tile.
    pub base: (i64, i64),
    /// Tiles along x and y.
    pub size: (i32, i32),
    /// Middle of the box of the sensor's origins, window coordinates.
    pub origin: Point,
    /// Half widths of that box, leaves, rounded up, without slack.
    pub spread: Point,
    /// Bound of all rounding, leaves: grows every dilation.
    pub slack: f64,
    /// Leaves per metre.
    pub scale: f64,
    /// Heading of the sensor: middle and half width (rounded up), radians.
    pub heading: (f64, f64),
    /// Sine and cosine of the middle.
    pub turn: (f64, f64),
    /// How far from the sensor's origin the scan can say something, leaves.
    pub reach: f64,
    /// True when the window is a dense one.
    pub dense: bool,
    corner: (f64, f64),
}

impl Frame {
    /// The window that holds everything within `reach` metres of all origins.
    pub(super) fn new(grid: &Grid, scan: &Scan, reach: f64) -> Self {
        let origins = scan.origins();
        let scale = grid.resolution().recip();
        let (origin_x, origin_y) = grid.origin();
        let mut x = axis(origins.x, origin_x, grid.resolution(), reach);
        let mut y = axis(origins.y, origin_y, grid.resolution(), reach);
        let dense = x.around.max(y.around) <= DENSE_REACH;
        if dense {
            x.widen();
            y.widen();
        }
        let heading = scan.headings();
        Self {
            base: (x.base, y.base),
            size: (x.tiles, y.tiles),
            origin: (x.center, y.center),
            spread: (x.half, y.half),
            slack: grid.cell_slack() + WINDOW_SLACK,
            scale,
            reach: reach * scale,
            dense,
            heading: (heading.mid(), heading.radius()),
            turn: (core_math::sin(heading.mid()), core_math::cos(heading.mid())),
            corner: (
                origin_x + (x.base * i64::from(BLOCK_SIDE)) as f64 * grid.resolution(),
                origin_y + (y.base * i64::from(BLOCK_SIDE)) as f64 * grid.resolution(),
            ),
        }
    }

    /// How far from the sensor's middle anything is drawn, leaves.
    pub(super) fn around(&self) -> f64 {
        self.reach + self.spread.0.max(self.spread.1) + 2.0
    }

    /// Bound of the rounding of single precision, leaves: see [`super::outline`].
    ///
    /// With `u = 2^-24` and `R` the reach, all in leaves: a unit vector's part is off by 3.5 u (its own rounding, that of the
    /// heading's direction, two products and a sum), `rho` by 7 u R (the scaled range, its error, the product and sum of the
    /// rule), so a vertex by 13 u R with its product and the sum with the sensor's place. Where the x of an edge or side is found
    /// for a y, that y is off by as much as the vertex and 8 u R more. A heading taken for whole steps (`NEGLIGIBLE` in
    /// [`super::sectors`]) moves what is shown by up to 4 u R. The dilation `dx`, `less + 0.5` and `v - (..)` of a floor are rounded
    /// once each, the first two at the size of the half width S of the box of positions, the last at that of R + S: u R + 3 u S,
    /// below 4 u R while S is no larger than R. Together 29 u R; taken is 32 u (R + 2) = 2^-19 (R + 2).
    ///
    /// Where S is larger than R, the star proves nothing: of no leaf are all positions within R, whatever is rounded. X_OCC is drawn
    /// in single precision in sets of at most 16 columns, so there S is at most 8, and the 24 u that 3 u S may come to are covered
    /// by the 64 u of the two leaves; larger sets are drawn in double precision.
    pub(super) fn rounding(&self) -> f64 {
        (self.reach + 2.0) / f64::from(1 << 19)
    }

    /// Where the sensor stands in a dense window, and the dilation of what is drawn about it in single precision.
    pub(super) fn place(&self) -> Place {
        let corner = (self.origin.0.floor(), self.origin.1.floor());
        let dilation = self.dilation();
        Place {
            x: (self.origin.0 - corner.0) as f32,
            y: (self.origin.1 - corner.1) as f32,
            column: corner.0 as i32,
            row: corner.1 as i32,
            dx: (dilation.0 + self.rounding()) as f32,
            dy: (dilation.1 + self.rounding()) as f32,
        }
    }

    /// The dilation of what is drawn about the sensor.
    pub(super) fn dilation(&self) -> Point {
        (self.spread.0 + self.slack, self.spread.1 + self.slack)
    }

    /// A box of the map frame: its middle in window coordinates and its half widths in leaves.
    pub(super) fn locate(&self, x: Interval, y: Interval) -> (Point, Point) {
        let at = |v: Interval, corner: f64| ((v.mid() - corner) * self.scale, (v.radius() * self.scale).next_up());
        let ((center_x, half_x), (center_y, half_y)) = (at(x, self.corner.0), at(y, self.corner.1));
        ((center_x, center_y), (half_x, half_y))
    }
}

struct Axis {
    base: i64,
    tiles: i32,
    center: f64,
    half: f64,
    /// How far from the middle anything is drawn, leaves.
    around: f64,
}

impl Axis {
    /// Puts the middle into the middle tile of a dense window.
    fn widen(&mut self) {
        let sensor = self.base + (self.center / f64::from(BLOCK_SIDE)).floor() as i64;
        let base = sensor - i64::from(DENSE_TILES / 2);
        self.center += ((self.base - base) * i64::from(BLOCK_SIDE)) as f64;
        self.base = base;
        self.tiles = DENSE_TILES;
    }
}

fn axis(origins: Interval, corner: f64, resolution: f64, reach: f64) -> Axis {
    let center = (origins.mid() - corner) / resolution;
    let half = (origins.radius() / resolution).next_up();
    let around = reach / resolution + half + 2.0;
    let side = f64::from(BLOCK_SIDE);
    let first = ((center - around) / side).floor();
    let last = ((center + around) / side).floor();
    Axis { base: first as i64, tiles: (last - first) as i32 + 1, center: center - first * side, half, around }
}
