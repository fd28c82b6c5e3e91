//! The counterpart of the paper's experiment: an occupancy grid with Gaussian errors in range and angle.
//!
//! Bounded errors are compared with this; nothing that a map promises rests on it. For a beam with the measured range
//! `r` the inverse model gives a cell at the distance `rho` and the angle `alpha` off the beam's axis the probability
//!
//! ```text
//! p = 1/2 + E (p_occ - 1/2) G                                 rho >= r
//! p = 1/2 + E ((p_occ - 1/2) G - (1/2 - p_free) (1 - G))      rho <  r
//! G = exp(-(rho - r)^2 / (2 sigma_d^2))     E = exp(-alpha^2 / (2 sigma_phi^2))
//! ```
//!
//! (the form of Elfes, *Using occupancy grids for mobile robot perception and navigation*, 1989): continuous, `p_free` on
//! the axis well before the obstacle, `p_occ` at it, and 1/2 beside and behind. Cells add up `ln(p / (1 - p))`, held to
//! a range, and a scan is taken at the middle of its pose box: a grid of this kind knows no pose error.

use crate::quadtree::{Grid, LeafRange, NodeAddress};
use crate::sensor::{Reading, Scan};

/// Beyond so many standard deviations an error is taken to be impossible.
const CUTOFF: f64 = 3.0;

/// So many standard deviations before the measured range, on the axis, the model is `p_free` to the last digit of a float.
const ON_AXIS: f64 = 7.0;

/// Nor is an angle beyond this, radians: the walk along a beam wants a wedge well below 45 degrees.
const WIDEST: f64 = 0.7;

/// Where in a cell the model is evaluated.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub enum CellPoint {
    /// At the cell's point nearest to the beam's axis and to the measured range, so that a cell that holds the end of a
    /// beam gets the whole of `p_occ`: the grid at its best.
    #[default]
    Nearest,
    /// At the cell's centre, as textbooks have it: cells wider than `sigma_d` miss the peak.
    Center,
}

/// The inverse sensor model.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GaussianModel {
    /// `sigma_d`, metres; positive.
    pub sigma_range: f64,
    /// `sigma_phi`, radians; positive.
    pub sigma_angle: f64,
    /// Probability well before the obstacle, below 1/2.
    pub p_free: f64,
    /// Probability at the obstacle, above 1/2.
    pub p_occupied: f64,
    /// Log-odds of a cell are held to this range.
    pub log_odds_range: (f32, f32),
    /// Where a cell is evaluated.
    pub cell_point: CellPoint,
}

impl Default for GaussianModel {
    /// The paper's `sigma_d` = 35 mm and `sigma_phi` = 0.125 degrees; free and occupied weigh the same, as the steps of a
    /// class do, and log-odds are held to the range that OctoMap has (0.12 to 0.97).
    fn default() -> Self {
        Self {
            sigma_range: 0.035,
            sigma_angle: 0.125_f64.to_radians(),
            p_free: 0.3,
            p_occupied: 0.7,
            log_odds_range: (-2.0, 3.5),
            cell_point: CellPoint::Nearest,
        }
    }
}

impl GaussianModel {
    /// What one beam says of a point: `ln(p / (1 - p))` at `rho` metres and `alpha` radians off the axis of a beam that
    /// measured `range` (metres; infinite for a beam that met nothing).
    #[must_use]
    pub fn log_odds(&self, rho: f64, alpha: f64, range: f64) -> f64 {
        let off = (rho - range) / self.sigma_range;
        let peak = (-0.5 * off * off).exp();
        let aside = alpha / self.sigma_angle;
        let weight = (-0.5 * aside * aside).exp();
        let mut p = (self.p_occupied - 0.5) * peak;
        if rho < range {
            p -= (0.5 - self.p_free) * (1.0 - peak);
        }
        let p = 0.5 + weight * p;
        (p / (1.0 - p)).ln()
    }
}

/// One beam in units of cells, from the sensor at the origin.
#[derive(Debug, Clone, Copy)]
struct Beam {
    origin: (f64, f64),
    /// Unit vector of the axis.
    axis: (f64, f64),
    /// The measured range, cells; infinite for a beam that met nothing.
    range: f64,
    /// How far cells are touched, cells.
    reach: f64,
}

/// A dense grid of log-odds on the cells of a map's lattice.
#[derive(Debug, Clone, PartialEq)]
pub struct GaussianGrid {
    grid: Grid,
    window: LeafRange,
    width: usize,
    model: GaussianModel,
    /// `tan` of the largest angle off the axis that counts.
    widest_tan: f64,
    /// `ln(p_free / (1 - p_free))`
    free_log_odds: f32,
    cells: Vec<f32>,
}

impl GaussianGrid {
    /// A grid over the leaves of `window` (4 bytes each: the caller limits it), all at probability 1/2.
    #[must_use]
    pub fn new(grid: Grid, window: LeafRange, model: GaussianModel) -> Self {
        let width = window.max_x.saturating_sub(window.min_x) as usize;
        let height = window.max_y.saturating_sub(window.min_y) as usize;
        let widest_tan = (CUTOFF * model.sigma_angle).min(WIDEST).tan();
        let free_log_odds = (model.p_free / (1.0 - model.p_free)).ln() as f32;
        Self { grid, window, width, model, widest_tan, free_log_odds, cells: vec![0.0; width * height] }
    }

    /// The cells that it has, as leaves of the map's lattice.
    #[must_use]
    pub fn window(&self) -> LeafRange {
        self.window
    }

    /// Log-odds row by row from the lowest, 0 for unknown.
    #[must_use]
    pub fn cells(&self) -> &[f32] {
        &self.cells
    }

    /// Log-odds of a leaf; 0, unknown, outside the window.
    #[must_use]
    pub fn log_odds(&self, leaf: NodeAddress) -> f32 {
        self.index(i64::from(leaf.x), i64::from(leaf.y)).map_or(0.0, |index| self.cells[index])
    }

    fn index(&self, x: i64, y: i64) -> Option<usize> {
        let column = usize::try_from(x - i64::from(self.window.min_x)).ok()?;
        let row = usize::try_from(y - i64::from(self.window.min_y)).ok()?;
        (column < self.width).then_some(row * self.width + column).filter(|index| *index < self.cells.len())
    }

    /// Adds one scan. A beam without a return is free to its sensor's `no_return_free_to`, or says nothing.
    pub fn insert(&mut self, scan: &Scan) {
        let origins = scan.origins();
        let cell = self.grid.resolution();
        let (left, low) = self.grid.origin();
        let origin = ((origins.x.mid() - left) / cell, (origins.y.mid() - low) / cell);
        let heading = scan.headings().mid();
        let tail = CUTOFF * self.model.sigma_range;
        for (beam, reading) in scan.readings().enumerate() {
            let (range, reach) = match (reading, scan.sensor().no_return_free_to()) {
                (Reading::Return { .. }, _) => {
                    let range = f64::from(scan.spec().ranges[beam]);
                    (range, range + tail)
                }
                (Reading::NoReturn, Some(free_to)) => (f64::INFINITY, free_to),
                _ => continue,
            };
            let (sin, cos) = (heading + scan.angle(beam)).sin_cos();
            self.add(&Beam { origin, axis: (cos, sin), range: range / cell, reach: reach / cell });
        }
    }

    /// Adds one beam: walks along the axis that it is nearer to, and across over the cells that its wedge may touch.
    fn add(&mut self, beam: &Beam) {
        let steep = beam.axis.1.abs() > beam.axis.0.abs();
        let swap = |(a, b): (f64, f64)| if steep { (b, a) } else { (a, b) };
        let (main, cross) = swap(beam.axis);
        let (start, aside) = swap(beam.origin);
        let slope = cross / main;
        let spread = self.widest_tan;
        // Half a cell as the axis sees it, at most; how wide the wedge is at a distance, with the cell at its side.
        let extent = std::f64::consts::FRAC_1_SQRT_2;
        let half_width = |u: f64| (u + extent) * spread + extent;
        let end = start + beam.reach * main;
        let margin = extent + half_width(beam.reach + extent) * cross.abs();
        for step in (start.min(end) - margin - 0.5).floor() as i64..=(start.max(end) + margin).ceil() as i64 {
            let ahead = step as f64 + 0.5 - start;
            let middle = aside + ahead * slope;
            // A cell `v` beside the axis is `v |cross / main|` farther along it than the axis is at the same step.
            let half = half_width((ahead / main).abs()) / ((1.0 - spread * slope.abs()) * main.abs());
            for across in (middle - half - 0.5).ceil() as i64..=(middle + half - 0.5).floor() as i64 {
                let (x, y) = if steep { (across, step) } else { (step, across) };
                self.add_to_cell(beam, x, y);
            }
        }
    }

    fn add_to_cell(&mut self, beam: &Beam, x: i64, y: i64) {
        let Some(index) = self.index(x, y) else { return };
        let (dx, dy) = (x as f64 + 0.5 - beam.origin.0, y as f64 + 0.5 - beam.origin.1);
        let (ux, uy) = beam.axis;
        let (mut along, mut aside) = (dx * ux + dy * uy, (dy * ux - dx * uy).abs());
        if self.model.cell_point == CellPoint::Nearest {
            let extent = 0.5 * (ux.abs() + uy.abs());
            along = beam.range.min(beam.reach).clamp(along - extent, along + extent);
            aside = (aside - extent).max(0.0);
        }
        let square = along * along + aside * aside;
        if along < 0.0 || aside > along * self.widest_tan || square > beam.reach * beam.reach {
            return;
        }
        let cell = self.grid.resolution();
        let said = if aside == 0.0 && (beam.range - along) * cell > ON_AXIS * self.model.sigma_range {
            self.free_log_odds
        } else {
            self.model.log_odds(square.sqrt() * cell, aside.atan2(along), beam.range * cell) as f32
        };
        let (least, most) = self.model.log_odds_range;
        self.cells[index] = (self.cells[index] + said).min(most).max(least);
    }
}
