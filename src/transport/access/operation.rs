//! The one table of what each operation needs, whatever transport it came by.

use super::Role;

/// What a caller may ask for. The words are those of the interface's methods.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[expect(missing_docs, reason = "the names are those of the interface")]
pub enum Operation {
    CreateMap,
    GetMap,
    ListMaps,
    DeleteMap,
    InsertScans,
    StreamScans,
    GetClasses,
    GetRegion,
    GetGrid,
    GetTile,
    CheckGuaranteedFree,
    GetChanges,
    WatchMap,
    ListRobots,
    CreateSnapshot,
    ListSnapshots,
    RestoreSnapshot,
    DeleteSnapshot,
    ExportMap,
    ImportMap,
    /// The server's metrics: no method of the interface.
    ReadMetrics,
}

/// On which maps an operation looks.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Reach {
    /// The one that the request names.
    OneMap,
    /// Those that the caller may see: the answer holds no others.
    Visible,
    /// Whatever there is: a caller of some maps alone may not.
    Everything,
}

impl Operation {
    /// The methods of the interface, in its order.
    pub const METHODS: [Self; 20] = [
        Self::CreateMap,
        Self::GetMap,
        Self::ListMaps,
        Self::DeleteMap,
        Self::InsertScans,
        Self::StreamScans,
        Self::GetClasses,
        Self::GetRegion,
        Self::GetGrid,
        Self::GetTile,
        Self::CheckGuaranteedFree,
        Self::GetChanges,
        Self::WatchMap,
        Self::ListRobots,
        Self::CreateSnapshot,
        Self::ListSnapshots,
        Self::RestoreSnapshot,
        Self::DeleteSnapshot,
        Self::ExportMap,
        Self::ImportMap,
    ];

    /// The operation of a method of the interface.
    #[must_use]
    pub fn of_method(method: &str) -> Option<Self> {
        Self::METHODS.into_iter().find(|operation| operation.method() == method)
    }

    /// The least role and the maps that it needs. This is the table.
    #[must_use]
    pub fn needs(self) -> (Role, Reach) {
        match self {
            Self::GetMap
            | Self::GetClasses
            | Self::GetRegion
            | Self::GetGrid
            | Self::GetTile
            | Self::CheckGuaranteedFree
            | Self::GetChanges
            | Self::WatchMap
            | Self::ListRobots
            | Self::ListSnapshots
            | Self::ExportMap => (Role::Read, Reach::OneMap),
            Self::ListMaps => (Role::Read, Reach::Visible),
            Self::ReadMetrics => (Role::Read, Reach::Everything),
            Self::InsertScans | Self::StreamScans => (Role::Write, Reach::OneMap),
            Self::CreateMap
            | Self::DeleteMap
            | Self::CreateSnapshot
            | Self::RestoreSnapshot
            | Self::DeleteSnapshot
            | Self::ImportMap => (Role::Admin, Reach::OneMap),
        }
    }

    /// Its name in the interface.
    #[must_use]
    pub fn method(self) -> &'static str {
        match self {
            Self::CreateMap => "CreateMap",
            Self::GetMap => "GetMap",
            Self::ListMaps => "ListMaps",
            Self::DeleteMap => "DeleteMap",
            Self::InsertScans => "InsertScans",
            Self::StreamScans => "StreamScans",
            Self::GetClasses => "GetClasses",
            Self::GetRegion => "GetRegion",
            Self::GetGrid => "GetGrid",
            Self::GetTile => "GetTile",
            Self::CheckGuaranteedFree => "CheckGuaranteedFree",
            Self::GetChanges => "GetChanges",
            Self::WatchMap => "WatchMap",
            Self::ListRobots => "ListRobots",
            Self::CreateSnapshot => "CreateSnapshot",
            Self::ListSnapshots => "ListSnapshots",
            Self::RestoreSnapshot => "RestoreSnapshot",
            Self::DeleteSnapshot => "DeleteSnapshot",
            Self::ExportMap => "ExportMap",
            Self::ImportMap => "ImportMap",
            Self::ReadMetrics => "ReadMetrics",
        }
    }

    /// What it does, as a sentence about a caller says it: `may not ...`.
    #[must_use]
    pub fn words(self) -> &'static str {
        match self {
            Self::CreateMap => "create the map",
            Self::GetMap
            | Self::GetClasses
            | Self::GetRegion
            | Self::GetGrid
            | Self::GetTile
            | Self::CheckGuaranteedFree
            | Self::GetChanges
            | Self::WatchMap
            | Self::ListRobots => "read the map",
            Self::ListMaps => "list maps",
            Self::DeleteMap => "delete the map",
            Self::InsertScans | Self::StreamScans => "send scans to the map",
            Self::CreateSnapshot => "take snapshots of the map",
            Self::ListSnapshots => "list the snapshots of the map",
            Self::RestoreSnapshot => "restore snapshots of the map",
            Self::DeleteSnapshot => "delete snapshots of the map",
            Self::ExportMap => "export the map",
            Self::ImportMap => "import the map",
            Self::ReadMetrics => "read the metrics, which tell of all maps",
        }
    }
}
