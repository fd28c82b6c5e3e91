//! Maps by each method from the same scans, and what they say of points.

use super::octomap::OctoMap;
use crate::mapping::{CellPoint, EvidenceRule, GaussianGrid, GaussianModel, MapConfig, Surveyor};
use crate::quadtree::{ClassScale, Grid, LeafRange, NodeAddress, OccupancyTree};
use crate::sensor::{PoseBox, PoseLimits, Reading, Scan, ScanLimits, ScanSpec, SensorModel, SensorSpec};
use anyhow::{Context, bail};
use rustix::time::{ClockId, clock_gettime};
use std::collections::BTreeMap;
use std::path::PathBuf;

/// Most cells of a dense grid: half a GiB of log-odds.
const MAX_CELLS: u64 = 1 << 27;

/// Most cells that OctoMap is asked about, as text: beyond, its area is left out.
const MAX_ASKED: usize = 1 << 23;

/// Leaves about the returns that a dense grid has too.
const MARGIN: f64 = 4.0;

/// Below this probability map servers commonly call a cell free (`free_thresh` of ROS).
pub const SURELY_FREE: f64 = 0.196;

/// A way to make a map.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Method {
    /// The occupancy grid with Gaussian errors.
    Gaussian(CellPoint),
    /// A quadtree by one of the rules.
    Rule(EvidenceRule),
    /// OctoMap with its defaults.
    OctoMap,
}

/// The rules in the order of the report.
pub const RULES: [EvidenceRule; 3] = [EvidenceRule::Outer, EvidenceRule::Inner, EvidenceRule::Guaranteed];

/// All methods in the order of the report.
pub const METHODS: [Method; 6] = [
    Method::Gaussian(CellPoint::Nearest),
    Method::Gaussian(CellPoint::Center),
    Method::OctoMap,
    Method::Rule(EvidenceRule::Outer),
    Method::Rule(EvidenceRule::Inner),
    Method::Rule(EvidenceRule::Guaranteed),
];

impl Method {
    /// What the report calls it.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Gaussian(CellPoint::Nearest) => "Gaussian grid",
            Self::Gaussian(CellPoint::Center) => "Gaussian grid, cell centres",
            Self::OctoMap => "OctoMap",
            Self::Rule(EvidenceRule::Outer) => "outer",
            Self::Rule(EvidenceRule::Inner) => "inner",
            Self::Rule(EvidenceRule::Guaranteed) => "guaranteed",
        }
    }
}

/// What a map calls a cell.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Called {
    /// The lowest class, or a probability below [`SURELY_FREE`].
    SurelyFree,
    /// Below unknown.
    Free,
    /// Nothing is known.
    Unknown,
    /// Above unknown.
    Occupied,
}

impl Called {
    /// Free, surely or not.
    #[must_use]
    pub fn is_free(self) -> bool {
        self <= Self::Free
    }

    fn of_class(class: u8, scale: ClassScale) -> Self {
        match class.cmp(&scale.unknown()) {
            std::cmp::Ordering::Less if class == scale.free() => Self::SurelyFree,
            std::cmp::Ordering::Less => Self::Free,
            std::cmp::Ordering::Equal => Self::Unknown,
            std::cmp::Ordering::Greater => Self::Occupied,
        }
    }

    fn of_probability(p: Option<f64>) -> Self {
        match p {
            None => Self::Unknown,
            Some(p) if p < SURELY_FREE => Self::SurelyFree,
            Some(p) if p < 0.5 => Self::Free,
            Some(_) => Self::Occupied,
        }
    }

    fn of_log_odds(log_odds: f32) -> Self {
        let known = (log_odds != 0.0).then(|| 1.0 / (1.0 + (-f64::from(log_odds)).exp()));
        Self::of_probability(known)
    }
}

/// What maps are made with.
#[derive(Debug, Clone)]
pub struct Setup {
    /// Side of a leaf, metres.
    pub resolution: f64,
    /// Depth of the leaves.
    pub depth: u32,
    /// `k`
    pub classes: u32,
    /// `s` of A4, metres.
    pub min_obstacle_width: f64,
    /// The OctoMap driver, where there is one.
    pub octomap: Option<PathBuf>,
    /// For the driver's files.
    pub folder: PathBuf,
}

/// A map and how long it took.
#[derive(Debug, Clone)]
pub struct Built<M> {
    /// The map.
    pub map: M,
    /// Its lattice.
    pub grid: Grid,
    /// Processor seconds of this thread.
    pub seconds: f64,
}

/// What a map says of points, and what it says in all.
#[derive(Debug, Clone)]
pub struct Judged {
    /// Of each point.
    pub called: Vec<Called>,
    /// Square metres called free, where they were counted.
    pub free_area: Option<f64>,
}

impl Judged {
    /// The share of the points for which something holds.
    #[must_use]
    pub fn share(&self, holds: impl Fn(Called) -> bool) -> f64 {
        self.called.iter().filter(|called| holds(**called)).count() as f64 / self.called.len().max(1) as f64
    }
}

/// Processor time of this thread, seconds.
#[must_use]
pub fn thread_seconds() -> f64 {
    let time = clock_gettime(ClockId::ThreadCPUTime);
    time.tv_sec as f64 + 1e-9 * time.tv_nsec as f64
}

impl Setup {
    /// The lattice of the leaves.
    ///
    /// # Errors
    /// Where the numbers are refused.
    pub fn grid(&self) -> anyhow::Result<Grid> {
        Ok(Grid::new(self.resolution, self.depth, None)?)
    }

    /// A map's configuration for scans of a sensor.
    ///
    /// # Errors
    /// Where the numbers are refused.
    pub fn config(&self, rule: EvidenceRule, sensor: SensorModel) -> anyhow::Result<MapConfig> {
        let sensors = BTreeMap::from([("default".to_owned(), sensor)]);
        Ok(MapConfig::new(self.grid()?, ClassScale::new(self.classes)?, rule, self.min_obstacle_width, sensors)?)
    }

    /// The quadtree of scans by a rule, on this thread alone.
    ///
    /// # Errors
    /// Without scans, or where the numbers are refused.
    pub fn tree(&self, rule: EvidenceRule, scans: &[Scan]) -> anyhow::Result<Built<OccupancyTree>> {
        let config = self.config(rule, *scans.first().context("no scans")?.sensor())?;
        let mut surveyor = Surveyor::new();
        let mut map = OccupancyTree::new(config.grid().depth(), config.scale());
        let mut changed = Vec::new();
        let start = thread_seconds();
        for scan in scans {
            map.apply(&surveyor.survey(&config, scan), &mut changed);
            changed.clear();
        }
        Ok(Built { map, grid: *config.grid(), seconds: thread_seconds() - start })
    }

    /// The Gaussian grid of scans.
    ///
    /// # Errors
    /// When the scans span too many cells, or the numbers are refused.
    pub fn gaussian(&self, cell_point: CellPoint, scans: &[Scan]) -> anyhow::Result<Built<GaussianGrid>> {
        let grid = self.grid()?;
        let model = GaussianModel { cell_point, ..GaussianModel::default() };
        let mut map = GaussianGrid::new(grid, window(&grid, scans)?, model);
        let start = thread_seconds();
        for scan in scans {
            map.insert(scan);
        }
        Ok(Built { map, grid, seconds: thread_seconds() - start })
    }

    /// What a method's map of scans calls points, and how much it calls free. `None` for OctoMap where it is not there.
    ///
    /// # Errors
    /// As the maps, or when the driver fails.
    pub fn judge(&self, method: Method, scans: &[Scan], points: &[(f64, f64)]) -> anyhow::Result<Option<Judged>> {
        let cell = self.resolution * self.resolution;
        let area = |cells: u64| cells as f64 * cell;
        let at = |grid: &Grid, (x, y): (f64, f64)| grid.leaf_at(x, y);
        Ok(match method {
            Method::Rule(rule) => {
                let built = self.tree(rule, scans)?;
                Some(judge_tree(&built.map, &built.grid, points))
            }
            Method::Gaussian(cell_point) => {
                let built = self.gaussian(cell_point, scans)?;
                let called = points
                    .iter()
                    .map(|point| at(&built.grid, *point))
                    .map(|leaf| leaf.map_or(Called::Unknown, |leaf| Called::of_log_odds(built.map.log_odds(leaf))));
                let free = built.map.cells().iter().filter(|cell| **cell < 0.0).count();
                Some(Judged { called: called.collect(), free_area: Some(area(free as u64)) })
            }
            Method::OctoMap => match self.octomap(scans)? {
                None => None,
                Some(peer) => {
                    let grid = self.grid()?;
                    let mut asked = points.to_vec();
                    let cells = centres(&grid, window(&grid, scans)?, MAX_ASKED);
                    asked.extend(&cells);
                    let answers = peer.occupancy(self.resolution, &asked)?;
                    let mut called: Vec<Called> = answers.into_iter().map(Called::of_probability).collect();
                    let free = called.split_off(points.len()).into_iter().filter(|called| called.is_free()).count();
                    Some(Judged { called, free_area: (!cells.is_empty()).then(|| area(free as u64)) })
                }
            },
        })
    }

    /// OctoMap with its scans; `None` where it is not there.
    ///
    /// # Errors
    /// When the scans cannot be written for the driver.
    pub fn octomap(&self, scans: &[Scan]) -> anyhow::Result<Option<OctoMap>> {
        self.octomap.as_ref().map(|driver| OctoMap::new(driver, &self.folder, scans)).transpose()
    }
}

/// What a tree calls points, and how much it calls free.
#[must_use]
pub fn judge_tree(tree: &OccupancyTree, grid: &Grid, points: &[(f64, f64)]) -> Judged {
    let cell = grid.resolution() * grid.resolution();
    let class = |(x, y): &(f64, f64)| grid.leaf_at(*x, *y).map(|leaf| tree.max_class(leaf));
    let called = points.iter().map(|point| class(point).map_or(Called::Unknown, |c| Called::of_class(c, tree.scale())));
    Judged { called: called.collect(), free_area: Some(tree.statistics().free_cells as f64 * cell) }
}

/// The middles of the leaves of a range, row by row; none where there are more than `most`.
fn centres(grid: &Grid, range: LeafRange, most: usize) -> Vec<(f64, f64)> {
    let count = (range.max_x - range.min_x) as usize * (range.max_y - range.min_y) as usize;
    if count > most {
        return Vec::new();
    }
    let ((left, low), cell) = (grid.origin(), grid.resolution());
    let middle = move |origin: f64, index: u32| origin + (f64::from(index) + 0.5) * cell;
    let row = move |y: u32| (range.min_x..range.max_x).map(move |x| (middle(left, x), middle(low, y)));
    (range.min_y..range.max_y).flat_map(row).collect()
}

/// The leaves about all sensors and returns.
///
/// # Errors
/// When there is none in the root, or there are too many.
pub fn window(grid: &Grid, scans: &[Scan]) -> anyhow::Result<LeafRange> {
    let mut hull: Option<(f64, f64, f64, f64)> = None;
    let mut add = |(x, y): (f64, f64)| {
        let (a, b, c, d) = hull.unwrap_or((x, y, x, y));
        hull = Some((a.min(x), b.min(y), c.max(x), d.max(y)));
    };
    for scan in scans {
        add((scan.origins().x.mid(), scan.origins().y.mid()));
        returns(scan).for_each(|(_, point)| add(point));
    }
    let (min_x, min_y, max_x, max_y) = hull.context("no scans")?;
    let margin = MARGIN * grid.resolution();
    let range = grid.leaves_within(min_x - margin, min_y - margin, max_x + margin, max_y + margin);
    let cells = u64::from(range.max_x.saturating_sub(range.min_x)) * u64::from(range.max_y.saturating_sub(range.min_y));
    if cells == 0 || cells > MAX_CELLS {
        bail!("the scans span {cells} cells of {} m: a dense grid takes 1 to {MAX_CELLS}", grid.resolution());
    }
    Ok(range)
}

/// The returns of a scan at the middle of its pose box: beam and point, metres.
pub fn returns(scan: &Scan) -> impl Iterator<Item = (usize, (f64, f64))> + '_ {
    let (origins, heading) = (scan.origins(), scan.headings().mid());
    let (x, y) = (origins.x.mid(), origins.y.mid());
    (0..scan.beams()).filter(|beam| matches!(scan.reading(*beam), Reading::Return { .. })).map(move |beam| {
        let (sin, cos) = (heading + scan.angle(beam)).sin_cos();
        let range = f64::from(scan.spec().ranges[beam]);
        (beam, (x + range * cos, y + range * sin))
    })
}

/// How many returns fall into each leaf of a range, row by row.
#[must_use]
pub fn hits(grid: &Grid, range: &LeafRange, scans: &[Scan]) -> Vec<u32> {
    let width = (range.max_x - range.min_x) as usize;
    let mut hits = vec![0; width * (range.max_y - range.min_y) as usize];
    for (_, (x, y)) in scans.iter().flat_map(returns) {
        if let Some(NodeAddress { x, y, .. }) = grid.leaf_at(x, y)
            && (range.min_x..range.max_x).contains(&x)
            && (range.min_y..range.max_y).contains(&y)
        {
            hits[(y - range.min_y) as usize * width + (x - range.min_x) as usize] += 1;
        }
    }
    hits
}

/// A scan as another sensor model reads it.
///
/// # Errors
/// When the model is refused.
pub fn with_sensor(scan: &Scan, spec: SensorSpec) -> anyhow::Result<Scan> {
    Ok(Scan::new(scan.spec().clone(), SensorModel::new(spec)?, &ScanLimits::default())?)
}

/// A scan with the box `pose +- position, +- heading` about a pose; metres and radians.
///
/// # Errors
/// When the box is refused.
pub fn with_pose(scan: &Scan, pose: (f64, f64, f64), position: f64, heading: f64) -> anyhow::Result<Scan> {
    let around = |v: f64, e: f64| if e > 0.0 { ((v - e).next_down(), (v + e).next_up()) } else { (v, v) };
    let (x, y, theta) = pose;
    let limits = PoseLimits::default();
    let pose = PoseBox::new(around(x, position), around(y, position), around(theta, heading), &limits)?;
    let spec = ScanSpec { pose, ..scan.spec().clone() };
    Ok(Scan::new(spec, *scan.sensor(), &ScanLimits::default())?)
}

/// The middle of a scan's pose box.
#[must_use]
pub fn middle(scan: &Scan) -> (f64, f64, f64) {
    let pose = scan.pose();
    (pose.x().mid(), pose.y().mid(), pose.theta().mid())
}
