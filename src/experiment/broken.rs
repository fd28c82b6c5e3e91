//! Bounds that do not hold: poses off by more than their box in a share of the scans, and how the tolerance answers.

use super::maps::{Setup, window};
use super::report::{Block, Cell, Table};
use super::simulated::{BURST, LOST, Simulated};
use super::{Experiment, Tell};
use crate::mapping::EvidenceRule;
use crate::picture::{Axis, Chart, Series};

/// Half widths of the pose boxes, metres and degrees.
const POSE: (f64, f64) = (0.03, 0.7);

/// Shares of the scans that break their bounds.
const BROKEN: [f64; 5] = [0.0, 0.03, 0.1, 0.2, 0.4];

/// The paper's classes, and more of them, so that there is room for a tolerance; with tolerances below `u - 1`.
const CLASSES: [(u32, &[u8]); 2] = [(10, &[0, 1, 3]), (24, &[0, 3, 10])];

/// Each share is drawn so often, since which scans break matters more than how many.
const DRAWS: u64 = 12;

/// Seen obstacle points guaranteed free by tolerance, and the area that is left.
///
/// # Errors
/// When a map cannot be made.
pub fn tolerate(experiment: &Experiment, tell: &mut Tell<'_>) -> anyhow::Result<Vec<Block>> {
    let simulated = Simulated::new(experiment.seed, experiment.simulated)?;
    let columns = [
        "broken scans %",
        "classes",
        "tolerance q",
        "guaranteed free m2",
        "seen points",
        "called free",
        "share %",
        "worst draw %",
    ];
    let caption = format!(
        "The simulated building by `guaranteed`, pose boxes of +-{} m and +-{} deg. Broken scans come {BURST} of a robot in a row, with a \
         pose that is off by {} to {} times the box in position and heading. A leaf is free with tolerance q when its class is at most \
         u - 1 - q. Means of {DRAWS} draws of the errors, and the worst one.",
        POSE.0, POSE.1, LOST.0, LOST.1
    );
    let mut table = Table::new("broken-bounds", caption, &columns);
    let mut lines: Vec<Series> = Vec::new();
    for (classes, tolerances) in CLASSES {
        let name = |q: &u8| Series { name: format!("k = {classes}, q = {q}"), points: Vec::new() };
        let mut own: Vec<Series> = tolerances.iter().map(name).collect();
        for broken in BROKEN {
            tell(&format!("bounds that do not hold: {classes} classes, {} % of the scans", 100.0 * broken));
            let setup = Setup { min_obstacle_width: 0.02, classes, ..experiment.setup() };
            let (percent, answers) = drawn(&setup, &simulated, broken, tolerances)?;
            for (row, line) in answers.into_iter().zip(&mut own) {
                let share = 100.0 * row.free / simulated.points.len().max(1) as f64;
                line.points.push((percent, share));
                table.rows.push(vec![
                    Cell::Number(percent, 1),
                    Cell::count(u64::from(classes)),
                    Cell::count(u64::from(row.tolerance)),
                    Cell::Number(row.area, 1),
                    Cell::count(simulated.points.len() as u64),
                    Cell::Number(row.free, 1),
                    Cell::Number(share, 4),
                    Cell::Number(100.0 * row.worst / simulated.points.len().max(1) as f64, 4),
                ]);
            }
        }
        lines.extend(own);
    }
    let chart = Chart {
        title: "seen obstacle points called free, %, by broken scans, %".to_owned(),
        axes: (Axis::Linear, Axis::Linear),
        series: lines,
    };
    Ok(vec![
        Block::Head("Bounds that do not hold".to_owned()),
        Block::Text(
            "While bounds hold, no seen point is in a free leaf. Scans that break them can clear a leaf that holds an obstacle; an answer \
             with tolerance q survives q of them at that leaf, and costs area that few scans have seen. A lost robot repeats one error, so \
             several scans in a row clear the same leaf: a tolerance below the length of such a burst helps less."
                .to_owned(),
        ),
        Block::Figure {
            name: "broken-bounds",
            caption: "Seen obstacle points called free against the share of scans that break their bounds, by tolerance.".to_owned(),
            png: chart.draw(760, 380).png()?,
        },
        Block::Table(table),
    ])
}

/// What a tolerance answers: means of the draws.
#[derive(Debug, Clone, Copy, Default)]
struct Answer {
    tolerance: u8,
    /// Square metres that are free.
    area: f64,
    /// Seen obstacle points that are called free, and the most of one draw.
    free: f64,
    worst: f64,
}

/// Percent of the scans that are broken, and the answer of each tolerance.
fn drawn(setup: &Setup, simulated: &Simulated, broken: f64, tolerances: &[u8]) -> anyhow::Result<(f64, Vec<Answer>)> {
    let mut sums: Vec<Answer> = tolerances.iter().map(|q| Answer { tolerance: *q, ..Answer::default() }).collect();
    let mut percent = 0.0;
    for draw in 0..DRAWS {
        let (scans, count) = simulated.claimed((POSE.0, POSE.1.to_radians()), broken, draw)?;
        percent += 100.0 * count as f64 / scans.len().max(1) as f64 / DRAWS as f64;
        let built = setup.tree(EvidenceRule::Guaranteed, &scans)?;
        let raster = built.map.raster(&window(&built.grid, &scans)?, built.grid.depth());
        let unknown = built.map.scale().unknown();
        let class = |(x, y): &(f64, f64)| built.grid.leaf_at(*x, *y).map_or(unknown, |leaf| built.map.max_class(leaf));
        let classes: Vec<u8> = simulated.points.iter().map(class).collect();
        for sum in &mut sums {
            let tolerance = sum.tolerance;
            let count = |classes: &[u8]| classes.iter().filter(|class| **class < unknown - tolerance).count() as f64;
            let free = count(&classes);
            sum.area += count(&raster) * setup.resolution * setup.resolution / DRAWS as f64;
            sum.free += free / DRAWS as f64;
            sum.worst = sum.worst.max(free);
        }
    }
    Ok((percent, sums))
}
