//! Soundness by simulation: no leaf that holds an obstacle point is ever decremented (model section 4).
//!
//! Everything is drawn from fixed seeds. What the runs can be told by the environment:
//!
//! - `UBBMAP_SOUNDNESS_PAIRS`: about how many leaf-scan pairs with obstacle points to check in all; the long run is
//!   `UBBMAP_SOUNDNESS_PAIRS=10000000 cargo test --release --test soundness -- --nocapture`
//! - `UBBMAP_SOUNDNESS_SEED`: the first seed, to see other scenes than the usual ones.
//! - `UBBMAP_SOUNDNESS_CASE`: `FAMILY:SEED` as a violation prints it, to check that one scene alone.
#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "tests fail by panicking and print their counts"
)]
#![allow(missing_docs, reason = "a test binary has no public interface")]

mod maps;
mod oracle;
mod placement;
mod pointwise;
mod scenario;
mod share;
mod single;

/// Pairs checked in the ordinary run, over all tests.
const ORDINARY_PAIRS: u64 = 800_000;

fn number(name: &str) -> Option<u64> {
    std::env::var(name).ok().map(|v| v.trim().parse().unwrap_or_else(|_| panic!("{name} is not a number: {v:?}")))
}

/// Pairs to check in all.
fn total_pairs() -> u64 {
    number("UBBMAP_SOUNDNESS_PAIRS").unwrap_or(ORDINARY_PAIRS)
}

/// The first seed.
fn base_seed() -> u64 {
    number("UBBMAP_SOUNDNESS_SEED").unwrap_or(1_000_000)
}

/// The one scene to check, as `(family, seed)`.
fn only_case() -> Option<(String, u64)> {
    let case = std::env::var("UBBMAP_SOUNDNESS_CASE").ok()?;
    let (family, seed) = case.split_once(':').unwrap_or_else(|| panic!("UBBMAP_SOUNDNESS_CASE is FAMILY:SEED"));
    Some((family.to_owned(), seed.parse().unwrap_or_else(|_| panic!("not a seed: {seed:?}"))))
}
