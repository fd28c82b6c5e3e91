//! Three-valued answers of interval tests.

/// What an interval test can say of a set: all of it, none of it, or undecided.
///
/// Nothing converts to `bool` by itself: [`Verdict::is_certainly`] and [`Verdict::is_possibly`] differ.
///
/// ```
/// use ubbmap::interval::Verdict;
/// assert_eq!(Verdict::Yes.and(Verdict::Unknown), Verdict::Unknown);
/// assert!(Verdict::Unknown.is_possibly() && !Verdict::Unknown.is_certainly());
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Verdict {
    /// Holds for every member of the set.
    Yes,
    /// Holds for no member of the set.
    No,
    /// Neither could be shown.
    Unknown,
}

impl Verdict {
    /// True when the property holds for every member.
    #[must_use]
    pub fn is_certainly(self) -> bool {
        self == Self::Yes
    }

    /// True unless the property is known to hold for no member.
    #[must_use]
    pub fn is_possibly(self) -> bool {
        self != Self::No
    }

    /// Both properties hold.
    #[must_use]
    pub fn and(self, other: Self) -> Self {
        match (self, other) {
            (Self::No, _) | (_, Self::No) => Self::No,
            (Self::Yes, Self::Yes) => Self::Yes,
            _ => Self::Unknown,
        }
    }

    /// At least one property holds.
    #[must_use]
    pub fn or(self, other: Self) -> Self {
        match (self, other) {
            (Self::Yes, _) | (_, Self::Yes) => Self::Yes,
            (Self::No, Self::No) => Self::No,
            _ => Self::Unknown,
        }
    }
}
