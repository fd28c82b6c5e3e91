//! Occupancy classes.

use thiserror::Error;

/// An occupancy class, `1..=k`: 1 is empty, `k` occupied, [`ClassScale::unknown`] unknown.
pub type Class = u8;

/// `k` is out of its range.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
#[error("classes must be between 4 and 255, got {0}")]
pub struct ClassScaleError(pub u32);

/// The number of classes `k` of a map and the classes with a name.
///
/// ```
/// use ubbmap::quadtree::ClassScale;
/// let scale = ClassScale::new(10)?;
/// assert_eq!((scale.free(), scale.unknown(), scale.occupied()), (1, 5, 10));
/// # Ok::<(), ubbmap::quadtree::ClassScaleError>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct ClassScale {
    k: u8,
}

impl ClassScale {
    /// A scale of `k` classes.
    ///
    /// # Errors
    /// Unless `4 <= k <= 255`: unknown, `floor(k / 2)`, must differ from 1.
    pub fn new(k: u32) -> Result<Self, ClassScaleError> {
        u8::try_from(k).ok().filter(|k| *k >= 4).map(|k| Self { k }).ok_or(ClassScaleError(k))
    }

    /// `k`, the number of classes.
    #[must_use]
    pub fn count(self) -> u8 {
        self.k
    }

    /// The lowest class, 1.
    #[must_use]
    pub fn free(self) -> Class {
        1
    }

    /// `u = floor(k / 2)`.
    #[must_use]
    pub fn unknown(self) -> Class {
        self.k / 2
    }

    /// The highest class, `k`.
    #[must_use]
    pub fn occupied(self) -> Class {
        self.k
    }

    /// The class after one scan's evidence: `+1` where occupied, `-1` where empty, held to `1..=k`.
    #[must_use]
    pub fn step(self, class: Class, occupied: bool, empty: bool) -> Class {
        match (occupied, empty) {
            (true, _) => class.saturating_add(1).min(self.k),
            (false, true) => class.saturating_sub(1).max(1),
            (false, false) => class,
        }
    }
}
