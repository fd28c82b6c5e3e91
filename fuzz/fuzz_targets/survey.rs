//! The evidence of one scan with numbers from the edge of floating point. What the engine calls empty is empty by the
//! pointwise rule, at points of the leaf and poses of the box; all paths tell the same sets; no leaf is of both.
#![no_main]

use arbitrary::{Arbitrary, Result, Unstructured};
use libfuzzer_sys::fuzz_target;
use std::collections::BTreeMap;
use ubbmap::mapping::reference::Reference;
use ubbmap::mapping::{EvidenceRule, MapConfig, Surveyor};
use ubbmap::quadtree::{BlockMasks, ClassScale, Grid, NodeAddress};
use ubbmap::sensor::{Angles, Mount, PoseBox, PoseLimits, Scan, ScanLimits, ScanSpec, SensorModel, SensorSpec};
use ubbmap::vector::Path;

/// Numbers that break arithmetic.
const EDGES: [f64; 14] = [
    0.0,
    -0.0,
    5e-324,
    1e-300,
    1e-162,
    1e-16,
    1e-9,
    1.0,
    std::f64::consts::PI,
    std::f64::consts::TAU,
    1e9,
    9_007_199_254_740_993.0,
    1e308,
    f64::INFINITY,
];

/// A number: an edge, one near `usual`, or any bits.
fn number(from: &mut Unstructured<'_>, usual: f64) -> Result<f64> {
    Ok(match from.int_in_range(0..=9)? {
        0 => EDGES[from.int_in_range(0..=EDGES.len() - 1)?],
        1 => -EDGES[from.int_in_range(0..=EDGES.len() - 1)?],
        2 => f64::arbitrary(from)?,
        3 => usual.next_up(),
        _ => usual * (1.0 + f64::from(i16::arbitrary(from)?) / 32768.0),
    })
}

fn sensor(from: &mut Unstructured<'_>) -> Result<Option<SensorModel>> {
    let mut spec = SensorSpec { range_max: number(from, 4.0)?, ..SensorSpec::default() };
    spec.range_error_minus = number(from, 0.03)?.abs();
    spec.range_error_plus = number(from, 0.03)?.abs();
    spec.beam_opening = number(from, 0.004)?.abs();
    spec.beam_diameter = number(from, 0.01)?.abs();
    spec.beam_angle_error = if bool::arbitrary(from)? { number(from, 1e-3)?.abs() } else { 0.0 };
    spec.no_return_free_to = if bool::arbitrary(from)? { Some(number(from, 2.0)?) } else { None };
    if bool::arbitrary(from)? {
        spec.mount = Mount { x: number(from, 0.2)?, y: number(from, 0.1)?, theta: number(from, 0.5)? };
    }
    Ok(SensorModel::new(spec).ok())
}

fn scan(from: &mut Unstructured<'_>, sensor: SensorModel) -> Result<Option<Scan>> {
    let beams = from.int_in_range(1..=24)?;
    let limits = PoseLimits { max_position_width: 2.0, max_heading_width: 1.1 };
    let mut side = |usual: f64, width: f64| -> Result<(f64, f64)> {
        let low = number(from, usual)?;
        Ok((low, if bool::arbitrary(from)? { low } else { low + number(from, width)?.abs() }))
    };
    let (x, y, theta) = (side(0.3, 0.05)?, side(-0.2, 0.05)?, side(0.5, 0.01)?);
    let Ok(pose) = PoseBox::new(x, y, theta, &limits) else { return Ok(None) };
    let angles = if bool::arbitrary(from)? {
        Angles::Uniform { min: number(from, -1.5)?, increment: number(from, 0.13)? }
    } else {
        let listed = (0..beams).map(|beam| number(from, 0.26 * beam as f64)).collect::<Result<Vec<f64>>>()?;
        Angles::Listed(listed)
    };
    let usual = number(from, 2.0)?;
    let ranges = (0..beams).map(|_| Ok(number(from, usual)? as f32)).collect::<Result<Vec<f32>>>()?;
    let spec = ScanSpec {
        pose,
        angles,
        ranges,
        footprint_radius: if bool::arbitrary(from)? { number(from, 0.3)?.abs() } else { 0.0 },
        sweep_rotation: if bool::arbitrary(from)? { number(from, 0.05)?.abs() } else { 0.0 },
        sweep_translation: if bool::arbitrary(from)? { number(from, 0.02)?.abs() } else { 0.0 },
    };
    Ok(Scan::new(spec, sensor, &ScanLimits::default()).ok())
}

/// Do two beams have one direction, and does it matter which of them comes first? To a sensor that moves, always; to one that
/// is still, where they tell different ranges.
fn has_twins(scan: &Scan, moves: bool) -> bool {
    let turn = std::f64::consts::TAU;
    let mut beams: Vec<(f64, f32)> =
        (0..scan.beams()).map(|beam| (scan.angle(beam).rem_euclid(turn), scan.spec().ranges[beam])).collect();
    beams.sort_by(|a, b| a.0.total_cmp(&b.0));
    let are_twins = |a: (f64, f32), b: (f64, f32)| b.0 - a.0 < 1e-9 && (moves || a.1.to_bits() != b.1.to_bits());
    let seam = beams.first().zip(beams.last());
    seam.is_some_and(|(first, last)| are_twins(*last, (first.0 + turn, first.1)))
        || beams.windows(2).any(|pair| are_twins(pair[0], pair[1]))
}

fn check(from: &mut Unstructured<'_>) -> Result<()> {
    let resolution = number(from, 0.1)?;
    let depth = from.int_in_range(1..=12)?;
    let origin = if bool::arbitrary(from)? { Some((number(from, -3.0)?, number(from, -3.0)?)) } else { None };
    let Ok(grid) = Grid::new(resolution, depth, origin) else { return Ok(()) };
    let Some(sensor) = sensor(from)? else { return Ok(()) };
    let sensors = BTreeMap::from([("default".to_owned(), sensor)]);
    let Ok(scale) = ClassScale::new(10) else { return Ok(()) };
    let width = number(from, 0.05)?.abs();
    let Ok(config) = MapConfig::new(grid, scale, EvidenceRule::Guaranteed, width, sensors) else { return Ok(()) };
    let Some(scan) = scan(from, sensor)? else { return Ok(()) };
    if Surveyor::fits(&config, &scan).is_err() {
        return Ok(());
    }
    let masks = Surveyor::new().survey(&config, &scan);
    for path in Path::all() {
        assert!(masks == Surveyor::on(path).survey(&config, &scan), "{path:?} tells other sets");
    }
    let moves = scan.spec().sweep_rotation > 0.0 || scan.spec().sweep_translation > 0.0;
    if has_twins(&scan, moves) {
        // Either of two beams in one direction may come first, and which does tells whose neighbour it is and what the motion
        // between them is. Both orders prove what they prove.
        return Ok(());
    }
    let reference = Reference::new(&scan, config.min_obstacle_width());
    let mut seed = u64::from(u32::arbitrary(from).unwrap_or(1)) | 1;
    let mut unit = move || {
        seed ^= seed << 13;
        seed ^= seed >> 7;
        seed ^= seed << 17;
        (seed >> 11) as f64 / (1_u64 << 53) as f64
    };
    let mut looked = 0;
    let depth = config.grid().depth();
    for (address, block) in &masks.blocks {
        let all = ([0; 64], [u64::MAX; 64]);
        let (occupied, empty) = match block {
            BlockMasks::AllEmpty => (&all.0, &all.1),
            BlockMasks::Some { occupied, empty } => (&**occupied, &**empty),
        };
        for (y, (occupied, empty)) in (0..64_u32).zip(occupied.iter().zip(empty)) {
            assert_eq!(empty & occupied, 0, "a leaf of both sets");
            for x in (0..64_u32).filter(|x| empty >> x & 1 == 1) {
                looked += 1;
                // A few hundred leaves of each scan.
                if looked > 256 && unit() > 0.01 {
                    continue;
                }
                let leaf = NodeAddress { depth, x: address.x * 64 + x, y: address.y * 64 + y };
                let square = config.grid().node_box(leaf);
                assert!(
                    reference.is_proven_by_points(&square, 3, &mut unit),
                    "{leaf:?} {square:?} of {:?}, width {}, scan {:?}",
                    config.grid(),
                    config.min_obstacle_width(),
                    scan.spec()
                );
            }
        }
    }
    Ok(())
}

fuzz_target!(|bytes: &[u8]| {
    // Bytes that are too few say nothing.
    let _ = check(&mut Unstructured::new(bytes));
});
