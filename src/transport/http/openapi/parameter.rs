//! Parameters of the query string, of the path and of headers, as the description of the interface tells them.

/// Where a parameter stands.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Place {
    /// In the path.
    Path,
    /// In the query string.
    Query,
    /// A header of the request.
    Header,
}

/// What a parameter's text is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Kind {
    /// A number of metres.
    Metres,
    /// A whole number, from the first to the second.
    Whole(u32, u32),
    /// A revision.
    Revision,
    /// `true` or `false`.
    Flag,
    /// One of these words.
    Word(&'static [&'static str]),
    /// A text by a rule, a regular expression.
    Name(&'static str),
    /// Any text.
    Text,
}

/// One parameter.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Parameter {
    /// Its name.
    pub name: &'static str,
    /// Where it stands.
    pub place: Place,
    /// What it is.
    pub kind: Kind,
    /// Is it needed?
    pub required: bool,
    /// What it does.
    pub text: &'static str,
    /// A value, as it is written.
    pub example: Option<&'static str>,
}

/// The rule of the names of maps.
pub const MAP_RULE: &str = "^[a-z0-9][a-z0-9_-]{0,62}$";

/// The rule of the names of robots and snapshots.
pub const NAME_RULE: &str = "^[A-Za-z0-9][A-Za-z0-9_.-]{0,62}$";

const MOST: u32 = u32::MAX;

const fn query(name: &'static str, kind: Kind, text: &'static str) -> Parameter {
    Parameter { name, place: Place::Query, kind, required: false, text, example: None }
}

const fn path(name: &'static str, kind: Kind, text: &'static str, example: &'static str) -> Parameter {
    Parameter { name, place: Place::Path, kind, required: true, text, example: Some(example) }
}

const fn header(name: &'static str, kind: Kind, text: &'static str) -> Parameter {
    Parameter { name, place: Place::Header, kind, required: false, text, example: None }
}

pub const MAP: Parameter = path("map", Kind::Name(MAP_RULE), "The map's name.", "hall");
pub const SNAPSHOT_NAME: Parameter = path("name", Kind::Name(NAME_RULE), "The snapshot's name.", "before-the-shift");
pub const Z: Parameter = path("z", Kind::Whole(0, 24), "Depth of the node that the tile shows.", "8");
pub const X: Parameter = path("x", Kind::Whole(0, 16_777_215), "Its column, from the root's `min_x`.", "128");
pub const Y: Parameter = path("y", Kind::Whole(0, 16_777_215), "Its row, from the root's `min_y` upwards.", "128");
pub const ENDING: Parameter =
    path("ending", Kind::Word(&["png", "npy", "pb"]), "The form: an image, a NumPy array, a `GetTileResponse`.", "png");

pub const MIN_X: Parameter = query(
    "min_x",
    Kind::Metres,
    "Least x of the half-open box [min_x, max_x) x [min_y, max_y), metres; default the root's.",
);
pub const MIN_Y: Parameter = query("min_y", Kind::Metres, "Least y of the box, metres; default the root's.");
pub const MAX_X: Parameter = query("max_x", Kind::Metres, "The x at which the box ends, metres; default the root's.");
pub const MAX_Y: Parameter = query("max_y", Kind::Metres, "The y at which the box ends, metres; default the root's.");
pub const DEPTH: Parameter = query("depth", Kind::Whole(0, 24), "Depth to read at most to; default the map's.");
pub const CELL_DEPTH: Parameter = query("depth", Kind::Whole(0, 24), "Depth of the cells; default the map's.");
pub const BLOCKS: Parameter =
    query("blocks", Kind::Flag, "With the blocks that meet the box and ever changed, and when they last did.");
pub const GRID_FORMAT: Parameter = query(
    "format",
    Kind::Word(&["json", "npy", "png", "protobuf", "pb"]),
    "The form of the answer, above what `Accept` says. `pb` is `protobuf`.",
);
pub const SINCE: Parameter =
    Parameter { required: true, example: Some("0"), ..query("since", Kind::Revision, "Changes after this revision.") };
pub const WATCH_SINCE: Parameter =
    query("since", Kind::Revision, "Begin with the changes after this revision; left out: with those to come.");
pub const CONTENTS: Parameter = query("contents", Kind::Flag, "With the contents of each block.");
pub const EXPORT_FORMAT: Parameter = query(
    "format",
    Kind::Word(&["ubbmap", "nav2"]),
    "`ubbmap`, the default: the map file of this program, everything in it. `nav2`: a zip of `map.yaml` and `map.pgm`.",
);
pub const EXPORT_SNAPSHOT: Parameter =
    query("snapshot", Kind::Name(NAME_RULE), "A snapshot in place of the current revision.");
pub const SNAPSHOT: Parameter =
    query("snapshot", Kind::Name(NAME_RULE), "The snapshot to read; left out: the map as it is now.");
pub const ROBOTS: Parameter = query(
    "robots",
    Kind::Flag,
    "With the robots whose scans were applied: all in the first message, then those of the commits.",
);
pub const EXPORT_DEPTH: Parameter =
    query("depth", Kind::Whole(0, 24), "Depth of the raster of the format `nav2`; default the map's.");
pub const EXPORT_MODE: Parameter = query(
    "mode",
    Kind::Word(&["trinary", "scale"]),
    "Mode of the format `nav2`: free, unknown or occupied, the default; or a grey for every class.",
);

pub const IF_NONE_MATCH: Parameter =
    header("If-None-Match", Kind::Text, "Tags of what the client has; 304 where it is still the same.");
pub const LAST_EVENT_ID: Parameter = header(
    "Last-Event-ID",
    Kind::Whole(0, MOST),
    "Where a client that lost the connection stopped reading: a revision. Above `since`.",
);
