//! Limits that something from outside met: each is counted under the name of its setting, and its error names it.

use super::{ErrorKind, ServiceError};
use metrics::{counter, describe_counter};

/// What met a limit, by the limit's setting.
const HITS: &str = "ubbmap_limit_hits_total";

macro_rules! settings {
    ($($constant:ident = $name:literal,)+) => {
        /// The names of the settings that are limits on what comes from outside, as `config/default.toml` has them.
        #[expect(missing_docs, reason = "each is its setting's name")]
        pub mod setting {
            $(pub const $constant: &str = $name;)+
        }

        /// All of them.
        pub const LIMITS: &[&str] = &[$(setting::$constant,)+];
    };
}

settings! {
    BODY_BYTES = "limits.body_bytes",
    CONFIG_BYTES = "limits.config_bytes",
    IMPORT_BYTES = "limits.import_bytes",
    INCOMING_BYTES = "limits.incoming_bytes",
    ANSWER_BYTES = "limits.answer_bytes",
    HEADER_BYTES = "limits.header_bytes",
    SCANS_PER_REQUEST = "limits.scans_per_request",
    BEAMS_PER_SCAN = "limits.beams_per_scan",
    POSE_WIDTH = "limits.pose_width",
    POSE_HEADING = "limits.pose_heading_degrees",
    POINTS_PER_QUERY = "limits.points_per_query",
    REGIONS_PER_QUERY = "limits.regions_per_query",
    POINTS_PER_REGION = "limits.points_per_region",
    LEAVES_PER_ANSWER = "limits.leaves_per_answer",
    CELLS_PER_ANSWER = "limits.cells_per_answer",
    DEPTH = "limits.depth",
    NAME_BYTES = "limits.name_bytes",
    MAPS = "limits.maps",
    ROBOTS_PER_MAP = "limits.robots_per_map",
    SNAPSHOTS = "limits.snapshots",
    CONNECTIONS = "limits.connections",
    CONNECTIONS_PER_CLIENT = "limits.connections_per_client",
    REQUESTS = "limits.requests",
    INSERTIONS = "limits.insertions",
    STREAMS = "limits.streams",
    STREAMS_PER_CLIENT = "limits.streams_per_client",
    TRANSFERS = "limits.transfers",
    INSERT_BYTES = "limits.insert_bytes",
    REQUEST_SECONDS = "limits.request_seconds",
    TRANSFER_SECONDS = "limits.transfer_seconds",
    HEADER_SECONDS = "limits.header_seconds",
    IDLE_SECONDS = "limits.idle_seconds",
    WRITER_QUEUE = "writer.queue",
    ZENOH_QUEUE = "zenoh.queue",
}

/// Tells the recorder what the counter means, and shows every limit before it is met.
pub(super) fn describe_metrics() {
    describe_counter!(HITS, "What met a limit and was refused, cut off or made to wait, by the limit's setting");
    for limit in LIMITS {
        counter!(HITS, "limit" => *limit).increment(0);
    }
}

/// Counts something that met a limit and is told so in another way than by an error of the service.
pub fn limit_hit(setting: &'static str) {
    counter!(HITS, "limit" => setting).increment(1);
}

/// The same for one scan of a request, which is refused by itself: the sentence that its refusal gives.
pub(super) fn over(setting: &'static str, detail: impl std::fmt::Display) -> String {
    limit_hit(setting);
    format!("{detail} (setting {setting})")
}

impl ServiceError {
    /// What met a limit: counted, and the detail names the setting.
    #[must_use]
    pub fn over(kind: ErrorKind, setting: &'static str, detail: impl std::fmt::Display) -> Self {
        Self::new(kind, over(setting, detail))
    }
}
