//! Whole maps as files: written from one revision or snapshot, and read into a new map.

use super::failures::{file_failure, store_failure, thread_failed};
use super::nav2::{Drawing, Nav2Mode};
use super::queries::{QueryError, checked_depth};
use super::registry::{Registry, blocking, now};
use super::tasks::spawn;
use super::{ErrorKind, MapService, MapVersion, ServiceError};
use crate::mapping::MapConfig;
use crate::quadtree::PagedTree;
use crate::store::{
    LoadedMap, MapFileError, MapFileLimits, MapName, RobotName, SequenceWindow, SnapshotName, StoredMap,
    read_map_file_within, write_map_file,
};
use std::collections::BTreeMap;
use std::sync::Arc;

/// What an export is written as.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum ExportForm {
    /// The map file of this program: everything, sequence windows too.
    Ubbmap,
    /// A zip of `map.yaml` and `map.pgm` for Nav2.
    Nav2 {
        /// Depth of the cells; `None` is the map's.
        depth: Option<u32>,
        /// How pixels are to be read.
        mode: Nav2Mode,
    },
}

/// A map as one file, in memory as a whole.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ExportedFile {
    /// What the file may be called: `hall-r12.ubbmap`.
    pub file_name: String,
    /// The revision that it holds.
    pub revision: u64,
    /// The file.
    pub bytes: Vec<u8>,
}

/// What is exported: one revision, from memory or a snapshot.
struct Exported {
    map: MapName,
    config: Arc<MapConfig>,
    revision: u64,
    tree: PagedTree,
    windows: BTreeMap<RobotName, SequenceWindow>,
    max_cells: usize,
}

impl Exported {
    fn write(self, form: ExportForm) -> Result<ExportedFile, QueryError> {
        let (map, revision) = (&self.map, self.revision);
        match form {
            ExportForm::Nav2 { depth, mode } => {
                let depth = checked_depth(self.config.grid(), depth)?;
                let drawing = Drawing {
                    map: map.as_str(),
                    revision,
                    config: &self.config,
                    tree: &self.tree,
                    depth,
                    mode,
                    max_cells: self.max_cells,
                };
                Ok(ExportedFile { file_name: format!("{map}-r{revision}-nav2.zip"), revision, bytes: drawing.zip()? })
            }
            ExportForm::Ubbmap => {
                let file_name = format!("{map}-r{revision}.ubbmap");
                let loaded = LoadedMap { revision, tree: self.tree.try_whole()?, windows: self.windows };
                let mut bytes = Vec::new();
                write_map_file(&mut bytes, &self.config, &loaded).map_err(|error| not_written(&error))?;
                Ok(ExportedFile { file_name, revision, bytes })
            }
        }
    }
}

fn not_written(error: &MapFileError) -> ServiceError {
    match error {
        MapFileError::TooLarge { .. } => ServiceError::new(ErrorKind::RegionTooLarge, error.to_string()),
        _ => {
            tracing::error!(%error, "a map file cannot be written");
            ServiceError::new(ErrorKind::Internal, "the server failed to write the map file")
        }
    }
}

impl MapService {
    /// A map as one file: its last revision, or that of a snapshot, for which the map itself need not be readable.
    /// Computed as a heavy query; nothing of the map is held once the file is there.
    ///
    /// # Errors
    /// [`ErrorKind::MapNotFound`], [`ErrorKind::SnapshotNotFound`], [`ErrorKind::DepthOutOfRange`],
    /// [`ErrorKind::RegionTooLarge`] naming the depth that would fit, [`ErrorKind::MapDamaged`].
    pub async fn export(
        &self,
        map: &MapName,
        snapshot: Option<&SnapshotName>,
        form: ExportForm,
    ) -> Result<ExportedFile, ServiceError> {
        let entry = self.registry.find(map)?;
        let (name, max_cells) = (map.clone(), self.settings().max_cells);
        let Some(snapshot) = snapshot.cloned() else {
            let root = self.root_of(&entry).await?;
            let write = move || {
                let windows = BTreeMap::clone(&root.published.windows);
                let revision = root.published.revision;
                Exported { map: name, config: root.config, revision, tree: root.tree, windows, max_cells }.write(form)
            };
            return self.apart("export", map, write).await;
        };
        let (store, id, config) = (Arc::clone(&self.registry.store), entry.id, entry.config.load_full());
        let write = move || {
            let loaded = store.load_snapshot(id, &snapshot).map_err(QueryError::Store)?;
            let LoadedMap { revision, tree, windows } = loaded;
            let tree = PagedTree::from(&tree);
            Exported { map: name, config, revision, tree, windows, max_cells }.write(form)
        };
        self.apart("export", map, write).await.map_err(|error| named(error, "snapshot"))
    }

    /// A new map from a map file: the same leaves, sensors, revision and sequence windows. It is there as a whole or not
    /// at all; once the file is sound, the import goes on when the caller leaves.
    ///
    /// # Errors
    /// [`ErrorKind::InvalidFile`] with what is wrong with it, [`ErrorKind::MapExists`], [`ErrorKind::TooManyMaps`],
    /// [`ErrorKind::ShuttingDown`], [`ErrorKind::StoreFailed`].
    pub async fn import<B>(&self, map: &MapName, file: B) -> Result<MapVersion, ServiceError>
    where
        B: AsRef<[u8]> + Send + 'static,
    {
        // A name that is taken is told before the file is read; whether it still is free is looked at again.
        self.registry.free(map)?;
        let limits = MapFileLimits {
            file_bytes: self.settings().max_import_bytes as u64,
            windows: self.settings().max_robots as u64,
            ..MapFileLimits::default()
        };
        let read = move || {
            let read = read_map_file_within(&mut file.as_ref(), &limits);
            read.map_err(|error| QueryError::Refused(file_failure(&error)))
        };
        let (config, contents) = self.apart("import", map, read).await?;
        self.registry.may_be_new(map, &config)?;
        self.registry.import(map, config, contents).await
    }
}

/// The error at the field that the request has for it.
pub(super) fn named(mut error: ServiceError, field: &str) -> ServiceError {
    if error.kind == ErrorKind::SnapshotNotFound {
        error.field = Some(field.to_owned());
    }
    error
}

impl Registry {
    /// Makes a map with contents. Runs to its end even if the caller goes away.
    async fn import(
        self: &Arc<Self>,
        name: &MapName,
        config: MapConfig,
        contents: LoadedMap,
    ) -> Result<MapVersion, ServiceError> {
        let inside = self.gate.enter()?;
        let (registry, name) = (Arc::clone(self), name.clone());
        let work = async move {
            let _inside = inside;
            // Held until the map is there or refused, so that other maps are not held up by a large one.
            let _coming = registry.reserve(&name).await?;
            let (revision, created) = (contents.revision, now());
            let (store, named, stored) = (Arc::clone(&registry.store), name.clone(), config.clone());
            let result = blocking(move || store.import(&named, &stored, created, &contents)).await?;
            let id = result.map_err(|error| store_failure(&name, "import", &error))?;
            registry.put_stored(StoredMap { id, name: name.clone(), config, revision, created });
            tracing::info!(map = %name, id = id.0, revision, "imported");
            Ok(MapVersion { map_id: id.0, revision })
        };
        spawn(work).await.unwrap_or_else(|error| Err(thread_failed(&error)))
    }
}
