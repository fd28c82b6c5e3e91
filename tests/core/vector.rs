//! Functions that are compiled once for each set of vector instructions, each held to plain loops.

use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use ubbmap::vector::{Path, step_rows};

/// A mask of one of the kinds that scans make: nothing, everything, runs, scattered bits.
fn mask(random: &mut ChaCha8Rng) -> u64 {
    match random.random_range(0..5) {
        0 => 0,
        1 => u64::MAX,
        2 => u64::MAX << random.random_range(0..64) >> random.random_range(0..64),
        3 => random.next_u64() & random.next_u64() & random.next_u64(),
        _ => random.next_u64(),
    }
}

#[test]
fn rows_step_by_one_and_stay_within_their_limits_on_every_path() {
    let mut random = ChaCha8Rng::seed_from_u64(11);
    let paths = Path::all();
    assert_eq!(paths[0], Path::PORTABLE);
    for round in 0..2_000_u32 {
        let (lowest, highest) = (1, [4, 10, 254, 255][round as usize % 4]);
        let mut rows = [[0_u8; 64]; 64];
        rows.as_flattened_mut().iter_mut().for_each(|byte| *byte = random.random_range(lowest..=highest));
        let up: [u64; 64] = std::array::from_fn(|_| mask(&mut random));
        let down: [u64; 64] = std::array::from_fn(|_| mask(&mut random));
        let mut expected = rows;
        let mut changed = 0;
        for (y, row) in expected.iter_mut().enumerate() {
            for (x, byte) in row.iter_mut().enumerate() {
                let before = *byte;
                if up[y] >> x & 1 == 1 {
                    *byte = highest.min(byte.saturating_add(1));
                } else if down[y] >> x & 1 == 1 {
                    *byte = lowest.max(*byte - 1);
                }
                changed |= u64::from(*byte != before) << y;
            }
        }
        for path in &paths {
            let mut stepped = rows;
            let found = step_rows(*path, &mut stepped, &up, &down, lowest, highest);
            assert_eq!((found, stepped), (changed, expected), "{path}, round {round}");
        }
    }
}

#[test]
fn paths_have_names_and_are_found_by_them() {
    for path in Path::all() {
        assert_eq!(Path::named(&path.to_string()), Some(path));
    }
    assert_eq!(Path::named("avx1024"), None);
    assert!(Path::all().contains(&Path::best()));
}
