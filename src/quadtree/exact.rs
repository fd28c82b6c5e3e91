//! Exact comparison of floating-point numbers with leaf edges `origin + index * resolution`.
//!
//! A product of an index of at most 2^24 and a resolution is the sum of two floating-point numbers, and the sum of a
//! few floating-point numbers has an exact sign (Shewchuk 1997, "Adaptive Precision Floating-Point Arithmetic").

use std::cmp::Ordering;

/// `a + b = sum + error` exactly (Knuth), for finite operands whose sum does not overflow.
fn two_sum(a: f64, b: f64) -> (f64, f64) {
    let sum = a + b;
    let of_b = sum - a;
    let of_a = sum - of_b;
    (sum, (a - of_a) + (b - of_b))
}

/// `index * resolution` as the exact sum of two floating-point numbers, for `index <= 2^24` and a resolution far from
/// the range of subnormal numbers: the upper 26 and the lower 27 bits of the resolution times at most 24 bits.
fn product(resolution: f64, index: u32) -> (f64, f64) {
    const LOWER: u64 = (1 << 27) - 1;
    let upper = f64::from_bits(resolution.to_bits() & !LOWER);
    let lower = resolution - upper;
    (upper * f64::from(index), lower * f64::from(index))
}

/// `origin + index * resolution` as a floating-point number near it and the rest: the rest is zero exactly when the
/// number is the edge, and otherwise is the difference rounded to nearest.
pub(super) fn edge(origin: f64, resolution: f64, index: u32) -> (f64, f64) {
    let (upper, lower) = product(resolution, index);
    let (sum, first) = two_sum(origin, upper);
    let (sum, second) = two_sum(sum, lower);
    (sum, first + second)
}

/// How a finite `v` compares with `origin + index * resolution` as real numbers.
pub(super) fn compare_with_edge(v: f64, origin: f64, resolution: f64, index: u32) -> Ordering {
    let (upper, lower) = product(resolution, index);
    // Adding a number to an expansion of non-overlapping parts of growing size gives such an expansion again; its sign
    // is that of its largest part that is not zero.
    let mut parts = [0.0; 4];
    for (count, term) in [v, -origin, -upper, -lower].into_iter().enumerate() {
        let mut carried = term;
        for part in &mut parts[..count] {
            (carried, *part) = two_sum(carried, *part);
        }
        parts[count] = carried;
    }
    let largest = parts.iter().rev().find(|part| **part != 0.0).copied().unwrap_or(0.0);
    largest.total_cmp(&0.0)
}
