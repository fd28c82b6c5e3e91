//! What each kind of error costs, and how run time grows.

use super::maps::{Built, RULES, Setup, middle, with_pose, with_sensor};
use super::paper::median;
use super::report::{Block, Cell, Table};
use super::{Experiment, Tell};
use crate::mapping::CellPoint;
use crate::picture::{Axis, Chart, Drawing, Series};
use crate::quadtree::OccupancyTree;
use crate::sensor::{Angles, Scan, ScanLimits, ScanSpec, SensorSpec};

/// Rounds of each time; the median is taken.
const ROUNDS: usize = 3;

/// One kind of error, its unit, and its values.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Swept {
    RangeError,
    Opening,
    Diameter,
    Position,
    Heading,
    ObstacleWidth,
    Resolution,
    Classes,
}

const SWEPT: [Swept; 8] = [
    Swept::RangeError,
    Swept::Opening,
    Swept::Diameter,
    Swept::Position,
    Swept::Heading,
    Swept::ObstacleWidth,
    Swept::Resolution,
    Swept::Classes,
];

impl Swept {
    fn name(self) -> &'static str {
        match self {
            Self::RangeError => "range error, m",
            Self::Opening => "beam opening, deg",
            Self::Diameter => "beam diameter, m",
            Self::Position => "position error, m",
            Self::Heading => "heading error, deg",
            Self::ObstacleWidth => "min obstacle width, m",
            Self::Resolution => "leaf side, m",
            Self::Classes => "classes",
        }
    }

    fn values(self) -> &'static [f64] {
        match self {
            Self::RangeError => &[0.005, 0.01, 0.02, 0.035, 0.05, 0.1],
            Self::Opening => &[0.0, 0.125, 0.25, 0.5, 1.0],
            Self::Diameter => &[0.0, 0.006, 0.012, 0.025, 0.05],
            Self::Position => &[0.0, 0.01, 0.02, 0.05, 0.1, 0.2],
            Self::Heading => &[0.0, 0.1, 0.25, 0.5, 1.0, 2.0],
            Self::ObstacleWidth => &[0.0, 0.01, 0.02, 0.05, 0.1],
            Self::Resolution => &[0.025, 0.05, 0.1, 0.2, 0.4],
            Self::Classes => &[4.0, 6.0, 10.0, 20.0, 50.0],
        }
    }

    /// The setup and the scans with one value changed.
    fn apply(self, value: f64, setup: &Setup, scans: &[Scan]) -> anyhow::Result<(Setup, Vec<Scan>)> {
        let mut setup = setup.clone();
        let sensed = |change: &dyn Fn(SensorSpec) -> SensorSpec| {
            scans
                .iter()
                .map(|scan| with_sensor(scan, change(*scan.sensor().spec())))
                .collect::<anyhow::Result<Vec<_>>>()
        };
        let posed = |position: f64, heading: f64| {
            scans
                .iter()
                .map(|scan| with_pose(scan, middle(scan), position, heading))
                .collect::<anyhow::Result<Vec<_>>>()
        };
        let scans = match self {
            Self::RangeError => {
                sensed(&|spec| SensorSpec { range_error_minus: value, range_error_plus: value, ..spec })?
            }
            Self::Opening => sensed(&|spec| SensorSpec { beam_opening: value.to_radians(), ..spec })?,
            Self::Diameter => sensed(&|spec| SensorSpec { beam_diameter: value, ..spec })?,
            Self::Position => posed(value, 0.0)?,
            Self::Heading => posed(0.0, value.to_radians())?,
            Self::ObstacleWidth => {
                setup.min_obstacle_width = value;
                scans.to_vec()
            }
            Self::Resolution => {
                setup.resolution = value;
                scans.to_vec()
            }
            Self::Classes => {
                setup.classes = value as u32;
                scans.to_vec()
            }
        };
        Ok((setup, scans))
    }
}

/// Square metres called free, and surely free.
fn areas(built: &Built<OccupancyTree>) -> (f64, f64) {
    let leaf = built.grid.resolution() * built.grid.resolution();
    let tree = &built.map;
    let mut surely = 0.0;
    let all = crate::quadtree::LeafRange { min_x: 0, min_y: 0, max_x: built.grid.side(), max_y: built.grid.side() };
    tree.visit_leaves(&all, tree.depth(), &mut |found| {
        if found.class == tree.scale().free() {
            surely += leaf * 4_f64.powi(i32::from(tree.depth() - found.node.depth));
        }
        true
    });
    (tree.statistics().free_cells as f64 * leaf, surely)
}

/// The influence of each kind of error on the area that is called free.
///
/// # Errors
/// When a map cannot be made.
pub fn errors(experiment: &Experiment, tell: &mut Tell<'_>) -> anyhow::Result<Vec<Block>> {
    let (setup, scans) = (experiment.setup(), experiment.sampled());
    let columns = [
        "what",
        "value",
        "outer m2",
        "inner m2",
        "guaranteed m2",
        "surely free: outer m2",
        "inner m2",
        "guaranteed m2",
    ];
    let caption = format!(
        "Area called free (class below unknown) and surely free (class 1) with one value changed, {} scans. What `guaranteed` calls \
         free is proven, so it shrinks with every error of range or pose. `inner` grows with those of the pose, since its corners may \
         pass for different poses, and so may `outer`. Opening and diameter are no errors but the width in which detection is certain: \
         a wider beam leaves smaller gaps.",
        scans.len()
    );
    let mut table = Table::new("errors", caption, &columns);
    let mut charts = Vec::new();
    for swept in SWEPT {
        tell(&format!("what each error costs: {}", swept.name()));
        let mut lines: Vec<Series> = RULES
            .iter()
            .map(|rule| Series { name: super::maps::Method::Rule(*rule).name().to_owned(), points: Vec::new() })
            .collect();
        for value in swept.values() {
            let (setup, scans) = swept.apply(*value, &setup, &scans)?;
            let mut row = vec![swept.name().into(), Cell::Number(*value, if swept == Swept::Classes { 0 } else { 3 })];
            let mut surely = Vec::new();
            for (rule, line) in RULES.iter().zip(&mut lines) {
                let (free, class_one) = areas(&setup.tree(*rule, &scans)?);
                row.push(Cell::Number(free, 1));
                surely.push(Cell::Number(class_one, 1));
                line.points.push((*value, free));
            }
            row.extend(surely);
            table.rows.push(row);
        }
        let title = format!("free m2 by {}", swept.name());
        let chart = Chart { title, axes: (Axis::Linear, Axis::Linear), series: lines };
        charts.push(chart.draw(360, 240));
    }
    let figure = Drawing::beside(&charts, 3);
    Ok(vec![
        Block::Head("What each kind of error costs".to_owned()),
        Block::Figure {
            name: "errors",
            caption: "Area called free against each kind of error, by rule; the other values are those of the paper's setting.".to_owned(),
            png: figure.png()?,
        },
        Block::Table(table),
    ])
}

/// Every `step`-th beam of a scan.
fn thinned(scan: &Scan, step: usize) -> anyhow::Result<Scan> {
    let kept = (0..scan.beams()).step_by(step);
    let spec = ScanSpec {
        angles: Angles::Listed(kept.clone().map(|beam| scan.angle(beam)).collect()),
        ranges: kept.map(|beam| scan.spec().ranges[beam]).collect(),
        ..scan.spec().clone()
    };
    Ok(Scan::new(spec, *scan.sensor(), &ScanLimits::default())?)
}

/// Milliseconds a scan: the Gaussian grid, then the rules.
fn times(setup: &Setup, scans: &[Scan]) -> anyhow::Result<[f64; 4]> {
    let per_scan = |seconds: Vec<f64>| 1e3 * median(seconds) / scans.len().max(1) as f64;
    let mut rounds: [Vec<f64>; 4] = Default::default();
    for _ in 0..ROUNDS {
        rounds[0].push(setup.gaussian(CellPoint::Nearest, scans)?.seconds);
        for (rule, seconds) in RULES.iter().zip(&mut rounds[1..]) {
            seconds.push(setup.tree(*rule, scans)?.seconds);
        }
    }
    Ok(rounds.map(per_scan))
}

/// Run time against resolution and beams.
///
/// # Errors
/// When a map cannot be made.
pub fn run_time(experiment: &Experiment, tell: &mut Tell<'_>) -> anyhow::Result<Vec<Block>> {
    let (setup, scans) = (experiment.setup(), experiment.sampled());
    let names = ["Gaussian grid", "outer", "inner", "guaranteed"];
    let columns = ["what", "value", "Gaussian grid ms", "outer ms", "inner ms", "guaranteed ms"];
    let caption =
        format!("Milliseconds a scan on one core, medians of {ROUNDS} alternating rounds of {} scans.", scans.len());
    let mut table = Table::new("run-time-growth", caption, &columns);
    let mut charts = Vec::new();
    let mut add = |what: &str, measured: Vec<(f64, [f64; 4])>| {
        let series = names.iter().enumerate().map(|(i, name)| Series {
            name: (*name).to_owned(),
            points: measured.iter().map(|(value, times)| (*value, times[i])).collect(),
        });
        let title = format!("ms a scan by {what}");
        let chart = Chart { title, axes: (Axis::Logarithmic, Axis::Logarithmic), series: series.collect() };
        charts.push(chart.draw(500, 340));
        for (value, times) in measured {
            let mut row = vec![what.into(), Cell::Number(value, if what == "beams" { 0 } else { 3 })];
            row.extend(times.map(|time| Cell::Number(time, 4)));
            table.rows.push(row);
        }
    };
    tell("run time by resolution");
    let mut by_resolution = Vec::new();
    for resolution in [0.025, 0.05, 0.1, 0.2, 0.4] {
        by_resolution.push((resolution, times(&Setup { resolution, ..setup.clone() }, &scans)?));
    }
    add("leaf side, m", by_resolution);
    tell("run time by beams");
    let mut by_beams = Vec::new();
    for step in [8, 4, 2, 1] {
        let thinned: Vec<Scan> = scans.iter().map(|scan| thinned(scan, step)).collect::<anyhow::Result<_>>()?;
        let beams = thinned.first().map_or(0, Scan::beams);
        by_beams.push((beams as f64, times(&setup, &thinned)?));
    }
    add("beams", by_beams);
    Ok(vec![
        Block::Head("Run time".to_owned()),
        Block::Figure {
            name: "run-time-growth",
            caption:
                "Milliseconds a scan against the side of a leaf and against the number of beams, both axes by powers."
                    .to_owned(),
            png: Drawing::beside(&charts, 2).png()?,
        },
        Block::Table(table),
    ])
}
