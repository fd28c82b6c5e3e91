//! Floor 0: closed intervals with outward rounding, 2-D boxes and three-valued verdicts.
//!
//! Every operation returns an interval that contains all results of the real operation on members of its
//! operands (the fundamental theorem of interval arithmetic). Bounds are rounded outward by one unit in the last
//! place of a correctly rounded result, which is rigorous whatever the rounding mode did.

mod arithmetic;
mod box2;
mod trig;
mod verdict;

pub use arithmetic::Interval;
pub(crate) use arithmetic::{down, up};
pub use box2::Box2;
pub use verdict::Verdict;
