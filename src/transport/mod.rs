//! Floor 5: the transports. They translate, and hold no logic.

pub mod http;
pub mod status;
