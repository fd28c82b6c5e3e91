//! Bounds against variances: how much of what was seen a map calls free.

use super::maps::{Called, METHODS, Method, Setup, middle, returns, with_pose};
use super::report::{Block, Cell, Table};
use super::simulated::Simulated;
use super::{Experiment, Tell};
use crate::sensor::{Reading, Scan, apex_offset};

/// Half widths of the simulated pose boxes, metres and degrees.
const POSES: [(f64, f64); 3] = [(0.0, 0.0), (0.03, 0.7), (0.1, 1.0)];

/// Most returns of the scans left out that are asked about.
const ASKED: usize = 6000;

/// How near a scan's pose must be to what its neighbours make of it, metres and degrees.
const AGREES: (f64, f64) = (0.05, 1.0);

/// Seen obstacle points called free, in the simulated building and by leaving out scans of the log.
///
/// # Errors
/// When a map cannot be made.
pub fn compare(experiment: &Experiment, tell: &mut Tell<'_>) -> anyhow::Result<Vec<Block>> {
    let mut blocks = vec![
        Block::Head("Bounds against variances: seen obstacles called free".to_owned()),
        Block::Text(
            "A cell is called free below unknown: a class below u, a probability below 0.5. Surely free is the lowest class, or a \
             probability below 0.196, where map servers draw the line. The grid and OctoMap take the middle of the pose box."
                .to_owned(),
        ),
    ];
    blocks.push(Block::Table(building(experiment, tell)?));
    blocks.push(Block::Text(
        "By leaving out: the map is made from the even scans of the log; asked are the returns of odd scans whose pose is within \
         0.05 m and 1 deg of the mean of its neighbours' poses. A return in a free leaf is no proof of a fault, since a range may be \
         off by its error and the leaf beside be free: contradicted is a return when every leaf that it may have come from is called \
         free, for the pose as it stands and for poses anywhere in their boxes. What moves, such as people, is counted too: no \
         method is at fault there."
            .to_owned(),
    ));
    blocks.push(Block::Table(left_out(experiment, tell)?));
    Ok(blocks)
}

fn percent(share: f64) -> Cell {
    Cell::Number(100.0 * share, 3)
}

fn building(experiment: &Experiment, tell: &mut Tell<'_>) -> anyhow::Result<Table> {
    let simulated = Simulated::new(experiment.seed, experiment.simulated)?;
    let setup = Setup { min_obstacle_width: 0.02, ..experiment.setup() };
    let columns = ["poses", "map", "free m2", "seen points", "called free", "share %", "surely free %"];
    let caption = format!(
        "The simulated building, {} scans, whose truth is known exactly: points of obstacles that a beam met (obstacles at least 2 cm \
         wide, {} m leaves). With uncertain poses the claimed pose is anywhere in its box.",
        experiment.simulated, experiment.resolution
    );
    let mut table = Table::new("seen-building", caption, &columns);
    for (position, degrees) in POSES {
        tell(&format!("seen obstacles: the building, poses +-{position} m, +-{degrees} deg"));
        let scans = simulated.claimed((position, degrees.to_radians()), 0.0, 0)?.0;
        let poses = pose_words(position, degrees);
        for method in METHODS {
            let Some(judged) = setup.judge(method, &scans, &simulated.points)? else { continue };
            let free = judged.called.iter().filter(|called| called.is_free()).count() as u64;
            table.rows.push(vec![
                poses.clone().into(),
                method.name().into(),
                Cell::known(judged.free_area, 1),
                Cell::count(judged.called.len() as u64),
                Cell::count(free),
                percent(judged.share(Called::is_free)),
                percent(judged.share(|called| called == Called::SurelyFree)),
            ]);
        }
    }
    Ok(table)
}

fn pose_words(position: f64, degrees: f64) -> String {
    if position == 0.0 && degrees == 0.0 { "exact".to_owned() } else { format!("±{position} m, ±{degrees:.1}°") }
}

/// What is asked about one return: where it was measured, and where it may have come from by an exact and by an uncertain
/// pose.
struct Question {
    measured: (f64, f64),
    exact: Vec<(f64, f64)>,
    boxed: Vec<(f64, f64)>,
}

/// Points all over the set (6) of a beam for a pose box about the scan's pose.
fn spread(scan: &Scan, beam: usize, position: f64, heading: f64) -> Vec<(f64, f64)> {
    let Reading::Return { near, far } = scan.reading(beam) else { return Vec::new() };
    let spec = scan.sensor().spec();
    let (x, y, theta) = middle(scan);
    let both = |bound: f64| if bound > 0.0 { vec![-bound, 0.0, bound] } else { vec![0.0] };
    let half = 0.5 * spec.beam_opening;
    let mut points = Vec::new();
    for d in [near, 0.5 * (near + far), far] {
        for share in [-1.0, 0.0, 1.0] {
            let (along, across) = if half == 0.0 {
                (d, 0.5 * share * spec.beam_diameter)
            } else {
                let offset = apex_offset(spec.beam_opening, spec.beam_diameter);
                ((d + offset) * (share * half).cos() - offset, (d + offset) * (share * half).sin())
            };
            for turn in both(heading) {
                let (sin, cos) = (theta + turn).sin_cos();
                let origin = (x + spec.mount.x * cos - spec.mount.y * sin, y + spec.mount.x * sin + spec.mount.y * cos);
                let (sin, cos) = (theta + turn + spec.mount.theta + scan.angle(beam)).sin_cos();
                let (px, py) = (origin.0 + along * cos - across * sin, origin.1 + along * sin + across * cos);
                for dx in both(position) {
                    points.extend(both(position).into_iter().map(|dy| (px + dx, py + dy)));
                }
            }
        }
    }
    points
}

/// Is the pose of a scan what its neighbours make of it?
fn agrees(before: &Scan, scan: &Scan, after: &Scan) -> bool {
    let ((ax, ay, at), (x, y, theta), (bx, by, bt)) = (middle(before), middle(scan), middle(after));
    let turn = |from: f64, to: f64| {
        (to - from + std::f64::consts::PI).rem_euclid(std::f64::consts::TAU) - std::f64::consts::PI
    };
    let off = (0.5 * (ax + bx) - x).hypot(0.5 * (ay + by) - y);
    let turned = 0.5 * (turn(theta, at) + turn(theta, bt));
    off <= AGREES.0 && turned.abs() <= AGREES.1.to_radians()
}

fn questions(experiment: &Experiment) -> Vec<Question> {
    let scans = &experiment.scans;
    let odd = (1..scans.len().saturating_sub(1)).step_by(2);
    let agreeing: Vec<&Scan> =
        odd.filter(|i| agrees(&scans[i - 1], &scans[*i], &scans[i + 1])).map(|i| &scans[i]).collect();
    let all: usize = agreeing.iter().map(|scan| scan.reading_counts().returns).sum();
    let step = all.div_ceil(ASKED).max(1);
    let (position, heading) = experiment.pose_error;
    let picked = agreeing.into_iter().flat_map(|scan| returns(scan).map(move |found| (scan, found))).step_by(step);
    picked
        .map(|(scan, (beam, measured))| Question {
            measured,
            exact: spread(scan, beam, 0.0, 0.0),
            boxed: spread(scan, beam, position, heading),
        })
        .collect()
}

fn left_out(experiment: &Experiment, tell: &mut Tell<'_>) -> anyhow::Result<Table> {
    let questions = questions(experiment);
    let points: Vec<(f64, f64)> = questions
        .iter()
        .flat_map(|question| {
            std::iter::once(question.measured).chain(question.exact.clone()).chain(question.boxed.clone())
        })
        .collect();
    let even: Vec<Scan> = experiment.scans.iter().step_by(2).cloned().collect();
    let (position, heading) = experiment.pose_error;
    let boxed: Vec<Scan> =
        even.iter().map(|scan| with_pose(scan, middle(scan), position, heading)).collect::<anyhow::Result<_>>()?;
    let columns = [
        "poses",
        "map",
        "free m2",
        "returns",
        "in a free leaf %",
        "in a surely free leaf %",
        "contradicted, pose exact %",
        "contradicted, pose in its box %",
    ];
    let caption = format!("{}: returns of scans left out, against the map of the others.", experiment.log);
    let mut table = Table::new("seen-log", caption, &columns);
    let uncertain = (position > 0.0 || heading > 0.0).then(|| (pose_words(position, heading.to_degrees()), &boxed));
    for (poses, scans) in std::iter::once(("exact".to_owned(), &even)).chain(uncertain) {
        // The grid and OctoMap know no boxes: they are the same for both.
        let methods = METHODS.iter().filter(|method| poses == "exact" || matches!(method, Method::Rule(_)));
        for method in methods {
            tell(&format!("seen obstacles: {} left out, {}", experiment.log, method.name()));
            let Some(judged) = experiment.setup().judge(*method, scans, &points)? else { continue };
            let mut row = vec![poses.clone().into(), method.name().into(), Cell::known(judged.free_area, 1)];
            row.push(Cell::count(questions.len() as u64));
            row.extend(answers(&questions, &judged.called));
            table.rows.push(row);
        }
    }
    Ok(table)
}

/// Shares of the questions: measured in a free leaf, in a surely free one, contradicted by the exact pose, by its box.
fn answers(questions: &[Question], called: &[Called]) -> [Cell; 4] {
    let mut counts = [0_usize; 4];
    let mut rest = called;
    for question in questions {
        let (own, after) = rest.split_at(1 + question.exact.len() + question.boxed.len());
        rest = after;
        let (measured, spread) = own.split_at(1);
        let (exact, boxed) = spread.split_at(question.exact.len());
        let all_free = |called: &[Called]| called.iter().all(|called| called.is_free());
        let holds = [
            measured[0].is_free(),
            measured[0] == Called::SurelyFree,
            all_free(measured) && all_free(exact),
            all_free(measured) && all_free(exact) && all_free(boxed),
        ];
        counts.iter_mut().zip(holds).for_each(|(count, holds)| *count += usize::from(holds));
    }
    counts.map(|count| percent(count as f64 / questions.len().max(1) as f64))
}
