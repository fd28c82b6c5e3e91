//! Every operation of REST: the router is made of this table, and so is the description of the interface.

use super::operation::{Body, Content, Operation, Verb};
use super::parameter as at;
use crate::service::ErrorKind::*;

const MAPS: &str = "maps";
const SCANS: &str = "scans";
const QUERIES: &str = "queries";
const CHANGES: &str = "changes";
const SNAPSHOTS: &str = "snapshots";
const FILES: &str = "files";
const SERVER: &str = "server";

/// The groups of operations, and what each is about.
pub const TAGS: [(&str, &str); 7] = [
    (MAPS, "Named maps and their configuration."),
    (SCANS, "Scans go in; an answer means that they are durable."),
    (QUERIES, "Every answer is of one revision, and shows only what is durable."),
    (CHANGES, "What changed since a revision, at once or as it is committed."),
    (SNAPSHOTS, "Revisions that are kept under a name."),
    (FILES, "Whole maps as files."),
    (SERVER, "Health, metrics, and this description."),
];

/// What is told of no operation in particular: the base of those below.
const PLAIN: Operation = Operation {
    id: "",
    method: Verb::Get,
    path: "",
    tag: SERVER,
    summary: "",
    text: "",
    parameters: &[],
    body: Body::None,
    answers: &[],
    refused: &[],
};

pub static CREATE_MAP: Operation = Operation {
    id: "CreateMap",
    method: Verb::Put,
    path: "/v1/maps/{map}",
    tag: MAPS,
    summary: "Create a map",
    text: "The body is the configuration; without one the map has the default one. The same configuration again \
        finds the map there (200); other sensors are added or replaced for scans to come; any other difference is an \
        error.",
    parameters: &[at::MAP],
    body: Body::Config,
    answers: &[(201, Content::Message("CreateMapResponse")), (200, Content::Message("CreateMapResponse"))],
    refused: &[
        InvalidName,
        InvalidConfig,
        InvalidRequest,
        NotAcceptable,
        MapExists,
        TooManyMaps,
        BodyTooLarge,
        UnsupportedMediaType,
    ],
};

pub static LIST_MAPS: Operation = Operation {
    id: "ListMaps",
    path: "/v1/maps",
    tag: MAPS,
    summary: "List the maps",
    answers: &[(200, Content::Message("ListMapsResponse"))],
    refused: &[InvalidRequest, NotAcceptable],
    ..PLAIN
};

pub static GET_MAP: Operation = Operation {
    id: "GetMap",
    path: "/v1/maps/{map}",
    tag: MAPS,
    summary: "Read a map's configuration, revision and robots",
    parameters: &[at::MAP],
    answers: &[(200, Content::Message("GetMapResponse"))],
    refused: &[InvalidName, InvalidRequest, NotAcceptable, MapNotFound],
    ..PLAIN
};

pub static DELETE_MAP: Operation = Operation {
    id: "DeleteMap",
    method: Verb::Delete,
    path: "/v1/maps/{map}",
    tag: MAPS,
    summary: "Delete a map with its snapshots",
    parameters: &[at::MAP],
    answers: &[(204, Content::None)],
    refused: &[InvalidName, InvalidRequest, MapNotFound],
    ..PLAIN
};

pub static INSERT_SCANS: Operation = Operation {
    id: "InsertScans",
    method: Verb::Post,
    path: "/v1/maps/{map}/scans",
    tag: SCANS,
    summary: "Apply scans",
    text: "The answer means that what was applied is durable: it survives a crash and a power cut. Good scans of a \
        request are applied, bad ones are named in `rejected`. A scan whose `(robot, sequence)` was applied before \
        is a duplicate and is not applied again, so a request without an answer may be sent again.\n\nOne scan a \
        line (`application/x-ndjson`) with `Accept: application/x-ndjson` is a stream: each scan is acknowledged \
        with a line as soon as it is durable, and the next is read as there is room.",
    parameters: &[at::MAP],
    body: Body::Scans,
    answers: &[(200, Content::Acknowledgements)],
    refused: &[
        InvalidName,
        InvalidRequest,
        TooManyScans,
        NotAcceptable,
        MapNotFound,
        BodyTooLarge,
        UnsupportedMediaType,
        MapDamaged,
    ],
};

pub static GET_CLASSES: Operation = Operation {
    id: "GetClasses",
    method: Verb::Post,
    path: "/v1/maps/{map}/classes",
    tag: QUERIES,
    summary: "Read the classes at points",
    parameters: &[at::MAP],
    body: Body::Message("GetClassesRequest"),
    answers: &[(200, Content::Message("GetClassesResponse"))],
    refused: &[
        InvalidName,
        InvalidRequest,
        InvalidPoint,
        DepthOutOfRange,
        TooManyPoints,
        NotAcceptable,
        MapNotFound,
        SnapshotNotFound,
        BodyTooLarge,
        UnsupportedMediaType,
        MapDamaged,
    ],
    ..PLAIN
};

pub static CHECK_GUARANTEED_FREE: Operation = Operation {
    id: "CheckGuaranteedFree",
    method: Verb::Post,
    path: "/v1/maps/{map}/guaranteed-free",
    tag: QUERIES,
    summary: "Ask whether regions are guaranteed free",
    text: "A region is free exactly when every leaf that meets it has class <= u - 1 - tolerance. Otherwise the \
        answer names a witness: a leaf, its class, and why. For a path it is the first one along it.",
    parameters: &[at::MAP],
    body: Body::Message("CheckGuaranteedFreeRequest"),
    answers: &[(200, Content::Message("CheckGuaranteedFreeResponse"))],
    refused: &[
        InvalidName,
        InvalidRequest,
        InvalidRegion,
        TooManyRegions,
        ToleranceTooHigh,
        NotAcceptable,
        MapNotFound,
        SnapshotNotFound,
        BodyTooLarge,
        UnsupportedMediaType,
        MapDamaged,
    ],
};

pub static GET_REGION: Operation = Operation {
    id: "GetRegion",
    path: "/v1/maps/{map}/region",
    tag: QUERIES,
    summary: "Read the quadtree's leaves in a box",
    text: "A node that is cut by `depth` appears with its maximum class.",
    parameters: &[at::MAP, at::MIN_X, at::MIN_Y, at::MAX_X, at::MAX_Y, at::DEPTH, at::BLOCKS, at::SNAPSHOT],
    answers: &[(200, Content::Message("GetRegionResponse"))],
    refused: &[
        InvalidName,
        InvalidRequest,
        InvalidRegion,
        DepthOutOfRange,
        RegionTooLarge,
        NotAcceptable,
        MapNotFound,
        SnapshotNotFound,
        MapDamaged,
    ],
    ..PLAIN
};

pub static GET_GRID: Operation = Operation {
    id: "GetGrid",
    path: "/v1/maps/{map}/grid",
    tag: QUERIES,
    summary: "Read a dense raster of a box",
    text: "By `Accept` or `format`: JSON, protobuf, a NumPy array (u8, row 0 at min_y) or a PNG image (the top row \
        at max_y; free white, unknown grey, occupied black). The headers `ubbmap-*` tell where it lies.",
    parameters: &[at::MAP, at::MIN_X, at::MIN_Y, at::MAX_X, at::MAX_Y, at::CELL_DEPTH, at::GRID_FORMAT, at::SNAPSHOT],
    answers: &[(200, Content::Raster)],
    refused: &[
        InvalidName,
        InvalidRequest,
        InvalidRegion,
        DepthOutOfRange,
        RegionTooLarge,
        NotAcceptable,
        MapNotFound,
        SnapshotNotFound,
        MapDamaged,
    ],
    ..PLAIN
};

pub static LIST_ROBOTS: Operation = Operation {
    id: "ListRobots",
    path: "/v1/maps/{map}/robots",
    tag: QUERIES,
    summary: "Read where the robots are",
    text: "As their last applied scans say. Kept in memory alone: after a restart a robot appears with its next scan.",
    parameters: &[at::MAP],
    answers: &[(200, Content::Message("ListRobotsResponse"))],
    refused: &[InvalidName, InvalidRequest, NotAcceptable, MapNotFound, MapDamaged],
    ..PLAIN
};

pub static GET_TILE: Operation = Operation {
    id: "GetTile",
    path: "/v1/maps/{map}/tiles/{z}/{x}/{y}",
    tag: QUERIES,
    summary: "Read a tile",
    text: "The node `(z, x, y)` drawn with 256 x 256 cells of depth `z + 8` (below the leaves, a leaf fills \
        several), with a strong tag of its contents: the tag stays where other parts of the map change.",
    parameters: &[at::MAP, at::Z, at::X, at::Y, at::ENDING, at::SNAPSHOT, at::IF_NONE_MATCH],
    answers: &[(200, Content::Tile), (304, Content::None)],
    refused: &[
        InvalidName,
        InvalidRequest,
        TileOutOfRange,
        RegionTooLarge,
        NotAcceptable,
        MapNotFound,
        SnapshotNotFound,
        MapDamaged,
    ],
    ..PLAIN
};

pub static GET_CHANGES: Operation = Operation {
    id: "GetChanges",
    path: "/v1/maps/{map}/changes",
    tag: CHANGES,
    summary: "Read which blocks changed since a revision",
    parameters: &[at::MAP, at::SINCE, at::MIN_X, at::MIN_Y, at::MAX_X, at::MAX_Y, at::CELL_DEPTH, at::CONTENTS],
    answers: &[(200, Content::Message("GetChangesResponse"))],
    refused: &[
        InvalidName,
        InvalidRequest,
        InvalidRegion,
        DepthOutOfRange,
        RegionTooLarge,
        NotAcceptable,
        MapNotFound,
        MapDamaged,
    ],
    ..PLAIN
};

pub static WATCH_MAP: Operation = Operation {
    id: "WatchMap",
    path: "/v1/maps/{map}/events",
    tag: CHANGES,
    summary: "Follow a map's changes as they are committed",
    text: "Server-sent events named `changes` whose id is the revision, so a client that lost the connection goes on \
        where it stopped (`Last-Event-ID`); or lines of JSON, by `Accept`. The first comes at once and tells where \
        the map stands. Each begins where the one before ended; several commits are put together where the client is \
        slow. A stream that the server ends has as its last event `end`, a problem.",
    parameters: &[
        at::MAP,
        at::WATCH_SINCE,
        at::MIN_X,
        at::MIN_Y,
        at::MAX_X,
        at::MAX_Y,
        at::CELL_DEPTH,
        at::CONTENTS,
        at::ROBOTS,
        at::LAST_EVENT_ID,
    ],
    answers: &[(200, Content::Events)],
    refused: &[
        InvalidName,
        InvalidRequest,
        InvalidRegion,
        DepthOutOfRange,
        RegionTooLarge,
        NotAcceptable,
        MapNotFound,
        MapDamaged,
    ],
    ..PLAIN
};

pub static CREATE_SNAPSHOT: Operation = Operation {
    id: "CreateSnapshot",
    method: Verb::Post,
    path: "/v1/maps/{map}/snapshots",
    tag: SNAPSHOTS,
    summary: "Keep the map's current revision under a name",
    parameters: &[at::MAP],
    body: Body::Message("CreateSnapshotRequest"),
    answers: &[(201, Content::Message("CreateSnapshotResponse"))],
    refused: &[
        InvalidName,
        InvalidRequest,
        NotAcceptable,
        MapNotFound,
        SnapshotExists,
        TooManySnapshots,
        BodyTooLarge,
        UnsupportedMediaType,
        MapDamaged,
    ],
    ..PLAIN
};

pub static LIST_SNAPSHOTS: Operation = Operation {
    id: "ListSnapshots",
    path: "/v1/maps/{map}/snapshots",
    tag: SNAPSHOTS,
    summary: "List a map's snapshots",
    parameters: &[at::MAP],
    answers: &[(200, Content::Message("ListSnapshotsResponse"))],
    refused: &[InvalidName, InvalidRequest, NotAcceptable, MapNotFound],
    ..PLAIN
};

pub static RESTORE_SNAPSHOT: Operation = Operation {
    id: "RestoreSnapshot",
    method: Verb::Post,
    path: "/v1/maps/{map}/snapshots/{name}/restore",
    tag: SNAPSHOTS,
    summary: "Make a snapshot's content the map's",
    text: "A commit like any other, with a revision of its own. What is known of the robots' sequence numbers is the \
        snapshot's too. A body may repeat what the path says.",
    parameters: &[at::MAP, at::SNAPSHOT_NAME],
    body: Body::Maybe("RestoreSnapshotRequest"),
    answers: &[(200, Content::Message("RestoreSnapshotResponse"))],
    refused: &[
        InvalidName,
        InvalidRequest,
        NotAcceptable,
        MapNotFound,
        SnapshotNotFound,
        BodyTooLarge,
        UnsupportedMediaType,
        MapDamaged,
    ],
};

pub static DELETE_SNAPSHOT: Operation = Operation {
    id: "DeleteSnapshot",
    method: Verb::Delete,
    path: "/v1/maps/{map}/snapshots/{name}",
    tag: SNAPSHOTS,
    summary: "Remove a snapshot",
    parameters: &[at::MAP, at::SNAPSHOT_NAME],
    answers: &[(204, Content::None)],
    refused: &[InvalidName, InvalidRequest, MapNotFound, SnapshotNotFound],
    ..PLAIN
};

pub static EXPORT_MAP: Operation = Operation {
    id: "ExportMap",
    path: "/v1/maps/{map}/export",
    tag: FILES,
    summary: "Take a whole map as a file",
    parameters: &[
        at::MAP,
        at::EXPORT_FORMAT,
        at::EXPORT_SNAPSHOT,
        at::EXPORT_DEPTH,
        at::EXPORT_MODE,
        at::IF_NONE_MATCH,
    ],
    answers: &[(200, Content::File), (304, Content::None)],
    refused: &[InvalidName, InvalidRequest, DepthOutOfRange, RegionTooLarge, MapNotFound, SnapshotNotFound, MapDamaged],
    ..PLAIN
};

pub static IMPORT_MAP: Operation = Operation {
    id: "ImportMap",
    method: Verb::Put,
    path: "/v1/maps/{map}/import",
    tag: FILES,
    summary: "Make a new map of a file",
    text: "The body is a file that an export gave, of this or another server. Sequence windows come with it.",
    parameters: &[at::MAP],
    body: Body::File,
    answers: &[(201, Content::Message("ImportMapResponse"))],
    refused: &[
        InvalidName,
        InvalidRequest,
        InvalidFile,
        NotAcceptable,
        MapExists,
        TooManyMaps,
        BodyTooLarge,
        UnsupportedMediaType,
    ],
};

pub static INDEX: Operation = Operation {
    id: "GetIndex",
    path: "/",
    summary: "Browsers get the viewer, programs the routes",
    answers: &[(200, Content::Index)],
    refused: &[InvalidRequest, NotAcceptable],
    ..PLAIN
};

pub static HEALTH: Operation = Operation {
    id: "GetHealth",
    path: "/healthz",
    summary: "Does the process answer?",
    answers: &[(200, Content::Json("Health"))],
    ..PLAIN
};

pub static READY: Operation = Operation {
    id: "GetReadiness",
    path: "/readyz",
    summary: "Does the server take work?",
    answers: &[(200, Content::Json("Health"))],
    ..PLAIN
};

pub static METRICS: Operation = Operation {
    id: "GetMetrics",
    path: "/metrics",
    summary: "Metrics in the text form of Prometheus",
    text: "For those who may read all maps; where administration has an address of its own, there alone, for everybody.",
    answers: &[(200, Content::Metrics)],
    refused: &[Unauthenticated, PermissionDenied, RouteNotFound],
    ..PLAIN
};

pub static DESCRIPTION: Operation = Operation {
    id: "GetDescription",
    path: "/openapi.json",
    summary: "This description",
    parameters: &[at::IF_NONE_MATCH],
    answers: &[(200, Content::Json("Description")), (304, Content::None)],
    refused: &[InvalidRequest],
    ..PLAIN
};

pub static DOCS: Operation = Operation {
    id: "GetDocs",
    path: "/docs",
    summary: "This description as a page",
    answers: &[(200, Content::Page)],
    refused: &[InvalidRequest],
    ..PLAIN
};

/// All of them, in an order in which they can be tried on an empty server.
pub static OPERATIONS: [&Operation; 25] = [
    &CREATE_MAP,
    &LIST_MAPS,
    &GET_MAP,
    &INSERT_SCANS,
    &GET_CLASSES,
    &CHECK_GUARANTEED_FREE,
    &GET_REGION,
    &GET_GRID,
    &GET_TILE,
    &LIST_ROBOTS,
    &GET_CHANGES,
    &WATCH_MAP,
    &CREATE_SNAPSHOT,
    &LIST_SNAPSHOTS,
    &RESTORE_SNAPSHOT,
    &DELETE_SNAPSHOT,
    &EXPORT_MAP,
    &DELETE_MAP,
    &IMPORT_MAP,
    &INDEX,
    &HEALTH,
    &READY,
    &METRICS,
    &DESCRIPTION,
    &DOCS,
];
