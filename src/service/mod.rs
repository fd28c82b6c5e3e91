//! Floor 4: named maps, one writer each, group commit, exactly-once, queries, limits and the one error type.
//!
//! [`MapService`] is what every transport calls; it knows neither HTTP nor gRPC nor Zenoh.

mod answers;
mod budget;
mod changes;
mod error;
mod evidence;
mod failures;
mod fair;
mod gate;
mod input;
mod limits;
mod metrics;
mod nav2;
mod queries;
mod reconfigure;
mod registry;
mod rescue;
mod robots;
mod settings;
mod snapshot_cache;
mod snapshots;
mod stamps;
mod tasks;
mod transfer;
mod views;
mod writer;

#[cfg(all(test, not(feature = "shuttle")))]
mod budget_tests;
#[cfg(all(test, not(feature = "shuttle")))]
mod evidence_tests;
#[cfg(all(test, not(feature = "shuttle")))]
mod fair_tests;
#[cfg(all(test, not(feature = "shuttle")))]
mod gate_tests;
#[cfg(all(test, feature = "server"))]
mod metrics_tests;
#[cfg(all(test, feature = "shuttle"))]
mod schedules;

use crate::mapping::{MapConfig, Region};
use crate::quadtree::CacheStatistics;
use crate::store::{MapName, MapStore};
use failures::store_failure;
use queries::{QueryError, Root};
use registry::{Entry, Registry, WhenFull, blocking};
use std::sync::Arc;

pub use answers::{
    BlockChange, BoxQuery, Changes, ChangesQuery, ClassesAnswer, CommitNotice, Created, FreeAnswers, InsertAnswer,
    MapDescription, MapVersion, Raster, RegionAnswer, Rejection, RobotDescription,
};
pub use changes::Watch;
pub use error::{ErrorKind, ServiceError};
pub use input::{RawPose, ScanInput};
pub use limits::{LIMITS, limit_hit, setting};
pub use metrics::describe_metrics;
pub use nav2::Nav2Mode;
pub use robots::{RobotPose, RobotsAnswer};
pub use settings::ServiceSettings;
pub use transfer::{ExportForm, ExportedFile};
pub use views::MapView;

/// The maps of one server. Cheap to clone; all clones are one service.
#[derive(Clone)]
pub struct MapService {
    registry: Arc<Registry>,
}

impl MapService {
    /// A service over a store. Maps are loaded when first used. Blocks while the store lists its maps.
    ///
    /// # Errors
    /// [`ErrorKind::StoreFailed`] when the store's list of maps cannot be read.
    pub fn open(store: Arc<dyn MapStore>, settings: ServiceSettings) -> Result<Self, ServiceError> {
        Ok(Self { registry: Arc::new(Registry::open(store, settings)?) })
    }

    /// The limits and settings in force.
    #[must_use]
    pub fn settings(&self) -> &ServiceSettings {
        &self.registry.settings
    }

    /// Creates a map; the same configuration again finds the map there (`created: false`).
    ///
    /// # Errors
    /// [`ErrorKind::MapExists`] with another configuration; added or replaced sensors alone are taken over.
    pub async fn create_map(&self, name: &MapName, config: MapConfig) -> Result<Created, ServiceError> {
        self.registry.create(name, config).await
    }

    /// One map.
    ///
    /// # Errors
    /// [`ErrorKind::MapNotFound`]
    pub async fn map(&self, name: &MapName) -> Result<MapDescription, ServiceError> {
        let entry = self.registry.find(name)?;
        self.registry.describe(&entry).await
    }

    /// All maps by name (without their robots).
    ///
    /// # Errors
    /// [`ErrorKind::StoreFailed`]
    pub async fn maps(&self) -> Result<Vec<MapDescription>, ServiceError> {
        Ok(self.registry.entries().iter().map(|entry| entry.describe(Vec::new())).collect())
    }

    /// Deletes a map.
    ///
    /// # Errors
    /// [`ErrorKind::MapNotFound`]
    pub async fn delete_map(&self, name: &MapName) -> Result<(), ServiceError> {
        self.registry.delete(name).await
    }

    /// Applies scans; returns when what was applied is durable. Bad scans are named in the answer, good ones applied.
    ///
    /// # Errors
    /// [`ErrorKind::MapNotFound`], [`ErrorKind::TooManyScans`], [`ErrorKind::Busy`] when the map's queue is full,
    /// [`ErrorKind::ShuttingDown`], [`ErrorKind::StoreFailed`].
    pub async fn insert(&self, name: &MapName, scans: Vec<ScanInput>) -> Result<InsertAnswer, ServiceError> {
        self.registry.insert(name, scans, WhenFull::Refuse).await
    }

    /// Refuses scans of a map whose queue is full, before they are looked at.
    ///
    /// # Errors
    /// [`ErrorKind::MapNotFound`], [`ErrorKind::Busy`]
    pub fn room(&self, name: &MapName) -> Result<(), ServiceError> {
        self.registry.room(name)
    }

    /// As [`MapService::insert`], but waits for a place in the map's queue and for memory: for senders that are held
    /// up by not being read.
    ///
    /// # Errors
    /// As [`MapService::insert`]; [`ErrorKind::Busy`] only where the memory ran out after the wait.
    pub async fn insert_when_free(&self, name: &MapName, scans: Vec<ScanInput>) -> Result<InsertAnswer, ServiceError> {
        self.registry.insert(name, scans, WhenFull::Wait).await
    }

    /// Classes at points of the last revision.
    ///
    /// # Errors
    /// As [`MapService::view`] and [`MapView::classes`].
    pub async fn classes(
        &self,
        name: &MapName,
        points: &[(f64, f64)],
        depth: Option<u32>,
    ) -> Result<ClassesAnswer, ServiceError> {
        self.view(name, None).await?.classes(points, depth).await
    }

    /// The quadtree leaves of a half-open box of the last revision, at most to a depth.
    ///
    /// # Errors
    /// As [`MapService::view`] and [`MapView::region`].
    pub async fn region(&self, name: &MapName, query: &BoxQuery) -> Result<RegionAnswer, ServiceError> {
        self.view(name, None).await?.region(query, false).await
    }

    /// A dense raster of a half-open box of the last revision.
    ///
    /// # Errors
    /// As [`MapService::view`] and [`MapView::grid`].
    pub async fn grid(&self, name: &MapName, query: &BoxQuery) -> Result<Raster, ServiceError> {
        self.view(name, None).await?.grid(query).await
    }

    /// The node `(z, x, y)` of the last revision as 256 x 256 cells.
    ///
    /// # Errors
    /// As [`MapService::view`] and [`MapView::tile`].
    pub async fn tile(&self, name: &MapName, z: u32, x: u32, y: u32) -> Result<Raster, ServiceError> {
        self.view(name, None).await?.tile(z, x, y).await
    }

    /// Is each region guaranteed free? All of the last revision.
    ///
    /// # Errors
    /// As [`MapService::view`] and [`MapView::guaranteed_free`].
    pub async fn guaranteed_free(
        &self,
        name: &MapName,
        regions: &[Region],
        tolerance: u32,
    ) -> Result<FreeAnswers, ServiceError> {
        self.view(name, None).await?.guaranteed_free(regions, tolerance).await
    }

    /// True while the service takes work and its store takes writes.
    #[must_use]
    pub fn is_ready(&self) -> bool {
        self.registry.is_ready()
    }

    /// Takes no more writes, finishes what was taken, and returns when all of it is durable.
    pub async fn drain(&self) {
        self.registry.gate.close().await;
    }

    /// Names the content that a read of a map sees now, without reading it: what an entity tag is made of. Loads the
    /// map, since a map that cannot be loaded has no content to name.
    ///
    /// # Errors
    /// [`ErrorKind::MapNotFound`], [`ErrorKind::MapDamaged`]
    pub async fn version(&self, name: &MapName) -> Result<MapVersion, ServiceError> {
        let root = self.root(name).await?;
        Ok(MapVersion { map_id: root.id.0, revision: root.published.revision })
    }

    /// The root that a query reads: one revision, whatever is committed meanwhile.
    async fn root(&self, name: &MapName) -> Result<Root, ServiceError> {
        let entry = self.registry.find(name)?;
        self.root_of(&entry).await
    }

    async fn root_of(&self, entry: &Entry) -> Result<Root, ServiceError> {
        let published = self.registry.opened(entry).await?.published.load_full();
        let tree = published.tree.clone();
        Ok(Root { id: entry.id, config: entry.config.load_full(), published, tree })
    }

    /// Computes an answer on a thread that may be busy for long. So many at once: the others wait for their turn, and
    /// the writers find threads for their commits.
    async fn apart<T: Send + 'static>(
        &self,
        kind: &'static str,
        name: &MapName,
        compute: impl FnOnce() -> Result<T, QueryError> + Send + 'static,
    ) -> Result<T, ServiceError> {
        // The semaphore is never closed; without a permit the answer would only be computed at once.
        let permit = Arc::clone(&self.registry.heavy).acquire_owned().await.ok();
        let answer = blocking(move || {
            let _permit = permit;
            metrics::query(kind, compute)
        })
        .await?;
        match answer.map_err(|error| query_failure(name, error)) {
            Err(error) => match self.registry.find(name) {
                Ok(entry) => Err(self.registry.with_rescue(&entry, error).await),
                Err(_) => Err(error),
            },
            answer => answer,
        }
    }

    /// Hands what is counted elsewhere to the recorder: called before the metrics are shown.
    pub fn note_metrics(&self) {
        metrics::cache(&self.cache());
        metrics::snapshot_cache(self.registry.snapshots.bytes());
        if let Some(statistics) = self.registry.store.statistics() {
            metrics::store(&statistics);
        }
    }

    /// What the blocks in memory take, and what was done to keep them under their limit.
    #[must_use]
    pub fn cache(&self) -> CacheStatistics {
        self.registry.cache.statistics()
    }
}

/// Computes an answer on the caller's thread from what is in memory; `None` when that is not enough.
fn inline<T>(
    kind: &'static str,
    name: &MapName,
    compute: impl FnOnce() -> Result<T, QueryError>,
) -> Option<Result<T, ServiceError>> {
    match metrics::query(kind, compute) {
        Err(QueryError::Absent) => None,
        answer => Some(answer.map_err(|error| query_failure(name, error))),
    }
}

fn query_failure(name: &MapName, error: QueryError) -> ServiceError {
    match error {
        QueryError::Refused(error) => error,
        QueryError::Store(error) => store_failure(name, "read", &error),
        QueryError::Absent => ServiceError::new(ErrorKind::Internal, "the server did not read a block of the map"),
    }
}

fn limited(
    field: &str,
    count: usize,
    limit: usize,
    kind: ErrorKind,
    setting: &'static str,
) -> Result<(), ServiceError> {
    if count <= limit {
        return Ok(());
    }
    Err(ServiceError::over(kind, setting, format!("{field} has {count} entries, the limit is {limit}")).at(field))
}
