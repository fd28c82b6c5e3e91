//! The chain of format versions: a store of an older version is brought to the newest, one step after the other.
//!
//! Each step has a page in `migrations/`, `NNNN-title.md`, and a fixture written by the version before it that a test
//! opens for ever.

use super::{StoreError, groups, migrate_times};

/// The format version that this program writes, and the newest that it reads.
pub const STORE_FORMAT: u32 = 3;

/// One step: from version `from` to `from + 1`. It must be repeatable: a crash in its middle leaves the old version in
/// the header, and the step runs again from its beginning.
struct Step {
    from: u32,
    run: fn(&sled::Tree) -> Result<(), StoreError>,
}

/// All steps, in order.
const STEPS: [Step; 2] = [Step { from: 1, run: groups::write_groups }, Step { from: 2, run: migrate_times::add_times }];

/// Brings a store of version `found` to [`STORE_FORMAT`] and returns whether anything was done; the caller writes the
/// new version into the header, durably, after each step that `between` is told of.
///
/// # Errors
/// [`StoreError::NewerFormat`] for a later version, [`StoreError::Damaged`] for one that never was, a step's failure.
pub(super) fn migrate(
    tree: &sled::Tree,
    found: u32,
    between: &mut dyn FnMut(u32) -> Result<(), StoreError>,
) -> Result<(), StoreError> {
    if found > STORE_FORMAT {
        return Err(StoreError::NewerFormat { what: "the store".to_owned(), found, supported: STORE_FORMAT });
    }
    if found == 0 {
        return Err(StoreError::Damaged { what: "the store's header: format version 0".to_owned() });
    }
    for step in STEPS.iter().filter(|step| step.from >= found) {
        (step.run)(tree)?;
        between(step.from + 1)?;
    }
    Ok(())
}
