//! Named maps: created and deleted durably, loaded when first used, each with its writer.

use super::changes::{ChangeLog, NOTICES};
use super::evidence::{EvidencePool, Task, counted_as, input_bytes};
use super::failures::{map_exists, map_not_found, store_error, store_failure, thread_failed};
use super::fair::Places;
use super::gate::Gate;
use super::metrics;
use super::reconfigure::first_difference;
use super::rescue::Rescue;
use super::robots::Robots;
use super::snapshot_cache::SnapshotCache;
use super::stamps::time_of;
use super::tasks::{self, CancellationToken, OnceCell, mpsc, oneshot};
use super::writer::{Published, Request, Writer};
use super::{
    CommitNotice, Created, ErrorKind, InsertAnswer, MapDescription, RobotDescription, ScanInput, ServiceError,
    ServiceSettings, setting,
};
use crate::mapping::MapConfig;
use crate::quadtree::BlockCache;
use crate::store::{DamagedMap, MapId, MapName, MapStore, OpenMap, StoredMap};
use crate::sync::{ArcSwap, RwLock};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, PoisonError};
use std::time::{Duration, SystemTime, UNIX_EPOCH};
use tokio::sync::{Mutex, Semaphore, broadcast};

/// How long an insertion that waits for memory waits before it looks again.
const MEMORY_PAUSE: Duration = Duration::from_millis(5);

/// What becomes of an insertion when the map's queue or the memory for scans is full.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum WhenFull {
    /// It is refused: its sender can come back later.
    Refuse,
    /// It waits: its sender is held up by not being read.
    Wait,
}

/// All that the clones of one service share.
pub(super) struct Registry {
    pub(super) store: Arc<dyn MapStore>,
    /// Blocks of all maps in memory.
    pub(super) cache: Arc<BlockCache>,
    /// Snapshots that are asked, in memory.
    pub(super) snapshots: Arc<SnapshotCache>,
    pub(super) settings: Arc<ServiceSettings>,
    /// Held for a look or a change, never across a disk access or an await.
    table: RwLock<Table>,
    /// Creations, deletions and changes of configurations, one after the other.
    changes: Mutex<()>,
    pub(super) pool: EvidencePool,
    pub(super) gate: Arc<Gate>,
    pub(super) heavy: Arc<Semaphore>,
    /// Tells of every commit.
    pub(super) notices: broadcast::Sender<CommitNotice>,
}

/// What the names stand for.
#[derive(Default)]
struct Table {
    maps: BTreeMap<MapName, Arc<Entry>>,
    /// Maps of which the store cannot read what they are. Their names stay taken until they are deleted.
    damaged: BTreeMap<MapName, DamagedMap>,
    /// Names of maps that are being imported.
    coming: BTreeSet<MapName>,
}

/// A name that is kept for a map which is being imported.
pub(super) struct Coming {
    registry: Arc<Registry>,
    name: MapName,
}

impl Drop for Coming {
    fn drop(&mut self) {
        self.registry.change(|table| table.coming.remove(&self.name));
    }
}

/// A map by name, loaded or not.
pub(super) struct Entry {
    name: MapName,
    pub(super) id: MapId,
    created: f64,
    pub(super) config: ArcSwap<MapConfig>,
    /// The revision in the store while the map is not loaded: only a loaded map is written to.
    stored_revision: u64,
    pub(super) opened: OnceCell<Opened>,
    /// The snapshot that a damaged map can be rescued from.
    pub(super) rescue: Rescue,
    pub(super) changes: Arc<ChangeLog>,
    pub(super) robots: Arc<Robots>,
    /// Cancelled when the map is being deleted.
    pub(super) stop: CancellationToken,
}

/// A loaded map.
pub(super) struct Opened {
    pub(super) published: Arc<ArcSwap<Published>>,
    /// Whoever sends has a place among `places`, or is one of few.
    pub(super) queue: mpsc::UnboundedSender<Request>,
    pub(super) places: Arc<Places>,
    /// Cancelled when the writer has made its last commit.
    stopped: CancellationToken,
    _counted: metrics::Loaded,
}

impl Registry {
    pub(super) fn open(store: Arc<dyn MapStore>, settings: ServiceSettings) -> Result<Self, ServiceError> {
        let stored = store.list().map_err(|e| store_error("list the maps of the store", &e))?;
        let notices = broadcast::Sender::new(NOTICES);
        let mut table = Table::default();
        let entry = |map: StoredMap| (map.name.clone(), Arc::new(Entry::new(map, &settings, &notices)));
        table.maps.extend(stored.into_iter().map(entry));
        for damaged in store.damaged() {
            tracing::error!(id = damaged.id.map(|id| id.0), what = damaged.what, "the store has a damaged map");
            if let Some(name) = damaged.name.clone().filter(|name| !table.maps.contains_key(name)) {
                table.damaged.insert(name, damaged);
            }
        }
        Ok(Self {
            store,
            table: RwLock::new(table),
            changes: Mutex::new(()),
            pool: EvidencePool::new(&settings)?,
            cache: Arc::new(BlockCache::new(settings.cache_bytes)),
            snapshots: Arc::new(SnapshotCache::new(settings.snapshot_cache_bytes)),
            gate: Arc::new(Gate::new()),
            heavy: Arc::new(Semaphore::new(settings.max_concurrent_queries.clamp(1, Semaphore::MAX_PERMITS))),
            notices,
            settings: Arc::new(settings),
        })
    }

    pub(super) fn is_ready(&self) -> bool {
        self.gate.is_open() && self.store.failure().is_none()
    }

    pub(super) fn find(&self, name: &MapName) -> Result<Arc<Entry>, ServiceError> {
        let table = self.table.read().unwrap_or_else(PoisonError::into_inner);
        match (table.maps.get(name), table.damaged.get(name)) {
            (Some(entry), _) => Ok(Arc::clone(entry)),
            (None, Some(damaged)) => {
                let detail = format!("map {:?} is damaged: {}", name.as_str(), damaged.what);
                Err(ServiceError::new(ErrorKind::MapDamaged, detail).at("map"))
            }
            (None, None) => Err(map_not_found(name)),
        }
    }

    /// Refuses a name that is taken.
    pub(super) fn free(&self, name: &MapName) -> Result<(), ServiceError> {
        match self.find(name) {
            Ok(_) => Err(map_exists(name)),
            Err(error) if error.kind == ErrorKind::MapNotFound => Ok(()),
            Err(error) => Err(error),
        }
    }

    /// Keeps a name and a place among the maps for one that is being imported.
    pub(super) async fn reserve(self: &Arc<Self>, name: &MapName) -> Result<Coming, ServiceError> {
        let _changes = self.changes.lock().await;
        self.free(name)?;
        self.room_for_a_map()?;
        if !self.change(|table| table.coming.insert(name.clone())) {
            return Err(map_exists(name));
        }
        Ok(Coming { registry: Arc::clone(self), name: name.clone() })
    }

    pub(super) fn entries(&self) -> Vec<Arc<Entry>> {
        self.table.read().unwrap_or_else(PoisonError::into_inner).maps.values().cloned().collect()
    }

    fn change<T>(&self, change: impl FnOnce(&mut Table) -> T) -> T {
        change(&mut self.table.write().unwrap_or_else(PoisonError::into_inner))
    }

    /// The loaded map; whoever comes first loads it, the others wait.
    pub(super) async fn opened<'e>(&self, entry: &'e Entry) -> Result<&'e Opened, ServiceError> {
        match entry.opened.get_or_try_init(|| self.load(entry)).await {
            Ok(opened) => Ok(opened),
            Err(error) => Err(self.with_rescue(entry, error).await),
        }
    }

    async fn load(&self, entry: &Entry) -> Result<Opened, ServiceError> {
        let (store, cache, id) = (Arc::clone(&self.store), Arc::clone(&self.cache), entry.id);
        let loaded = blocking(move || store.open(id, &cache)).await?;
        let loaded = loaded.map_err(|e| store_failure(&entry.name, "load", &e))?;
        tracing::debug!(map = %entry.name, revision = loaded.revision, "loaded");
        let OpenMap { revision, tree, pager, windows, stamps } = loaded;
        let root = Published { revision, tree, windows: Arc::new(windows), stamps, restored: 0 };
        let published = Arc::new(ArcSwap::from_pointee(root));
        let (sender, receiver) = mpsc::unbounded_channel();
        let stopped = CancellationToken::new();
        let writer = Writer {
            name: entry.name.clone(),
            id,
            store: Arc::clone(&self.store),
            published: Arc::clone(&published),
            pager,
            changes: Arc::clone(&entry.changes),
            robots: Arc::clone(&entry.robots),
            max_scans_per_commit: self.settings.max_scans_per_commit,
            max_robots: self.settings.max_robots,
            max_name_bytes: self.settings.max_name_bytes,
            max_snapshots: self.settings.max_snapshots,
        };
        tasks::spawn(writer.run(receiver, entry.stop.clone(), stopped.clone()));
        let places = Places::new(self.settings.queue_length);
        Ok(Opened { published, queue: sender, places, stopped, _counted: metrics::Loaded::new() })
    }

    /// Creates a map or takes over added and replaced sensors. Runs to its end even if the caller goes away.
    pub(super) async fn create(self: &Arc<Self>, name: &MapName, config: MapConfig) -> Result<Created, ServiceError> {
        let inside = self.gate.enter()?;
        let (registry, name) = (Arc::clone(self), name.clone());
        let work = async move {
            let _inside = inside;
            let changes = registry.changes.lock().await;
            let entry = match registry.find(&name) {
                Ok(entry) => entry,
                Err(error) if error.kind == ErrorKind::MapNotFound => return registry.create_new(&name, config).await,
                Err(error) => return Err(error),
            };
            registry.reconfigure(&entry, config).await?;
            // Loading the map for its description is no change.
            drop(changes);
            Ok(Created { created: false, map: registry.describe(&entry).await? })
        };
        tasks::spawn(work).await.unwrap_or_else(|e| Err(thread_failed(&e)))
    }

    async fn create_new(&self, name: &MapName, config: MapConfig) -> Result<Created, ServiceError> {
        self.may_be_new(name, &config)?;
        self.room_for_a_map()?;
        if self.table.read().unwrap_or_else(PoisonError::into_inner).coming.contains(name) {
            return Err(map_exists(name));
        }
        let created = now();
        let (store, named, stored) = (Arc::clone(&self.store), name.clone(), config.clone());
        let result = blocking(move || store.create(&named, &stored, created)).await?;
        let id = result.map_err(|e| store_failure(name, "create", &e))?;
        let stored = StoredMap { id, name: name.clone(), config, revision: 0, created };
        let entry = Arc::new(self.entry(stored));
        self.put(Arc::clone(&entry));
        tracing::info!(map = %name, id = id.0, "created");
        Ok(Created { created: true, map: entry.describe(Vec::new()) })
    }

    /// Holds what a new map is to the limits; those that are there stay as they are.
    pub(super) fn may_be_new(&self, name: &MapName, config: &MapConfig) -> Result<(), ServiceError> {
        self.may_be_named(name.as_str(), "map")?;
        config.sensors().keys().try_for_each(|sensor| self.may_be_named(sensor, "config.sensors"))?;
        let (depth, most) = (config.grid().depth(), self.settings.max_depth);
        if depth <= most {
            return Ok(());
        }
        let detail = format!("depth is {depth}, the limit of this server is {most}");
        Err(ServiceError::over(ErrorKind::InvalidConfig, setting::DEPTH, detail).at("config.depth"))
    }

    /// Holds a new name to its limit; the rule of its letters is looked at elsewhere.
    pub(super) fn may_be_named(&self, name: &str, field: &str) -> Result<(), ServiceError> {
        let most = self.settings.max_name_bytes;
        if name.len() <= most {
            return Ok(());
        }
        let detail = format!("the name {name:?} has {} bytes, the limit of this server is {most}", name.len());
        Err(ServiceError::over(ErrorKind::InvalidName, setting::NAME_BYTES, detail).at(field))
    }

    fn room_for_a_map(&self) -> Result<(), ServiceError> {
        let limit = self.settings.max_maps;
        let table = self.table.read().unwrap_or_else(PoisonError::into_inner);
        if table.maps.len() + table.coming.len() < limit {
            return Ok(());
        }
        let detail = format!("the server has {limit} maps, which is the limit");
        Err(ServiceError::over(ErrorKind::TooManyMaps, setting::MAPS, detail))
    }

    async fn reconfigure(&self, entry: &Entry, config: MapConfig) -> Result<(), ServiceError> {
        let now = entry.config.load_full();
        if let Some(field) = first_difference(&now, &config) {
            let detail = format!("map {:?} exists with another {field}", entry.name.as_str());
            return Err(ServiceError::new(ErrorKind::MapExists, detail).at(format!("config.{field}")));
        }
        if now.sensors() != config.sensors() {
            let (store, id, stored) = (Arc::clone(&self.store), entry.id, config.clone());
            let result = blocking(move || store.update_config(id, &stored)).await?;
            result.map_err(|e| store_failure(&entry.name, "update the configuration of", &e))?;
            entry.config.store(Arc::new(config));
            tracing::info!(map = %entry.name, "sensors changed");
        }
        Ok(())
    }

    /// Deletes a map. Runs to its end even if the caller goes away.
    pub(super) async fn delete(self: &Arc<Self>, name: &MapName) -> Result<(), ServiceError> {
        let inside = self.gate.enter()?;
        let (registry, name) = (Arc::clone(self), name.clone());
        let work = async move {
            let _inside = inside;
            let _changes = registry.changes.lock().await;
            match registry.damaged_id(&name) {
                Some(id) => registry.delete_damaged(&name, id).await,
                None => registry.delete_entry(&*registry.find(&name)?).await,
            }
        };
        tasks::spawn(work).await.unwrap_or_else(|e| Err(thread_failed(&e)))
    }

    async fn delete_entry(&self, entry: &Entry) -> Result<(), ServiceError> {
        // From here on no round begins. A load that ends after the look below starts a writer that finds `stop`
        // cancelled before its first round: the token's lock orders the two.
        entry.stop.cancel();
        if let Some(opened) = entry.opened.get() {
            opened.stopped.cancelled().await;
        }
        let (store, id) = (Arc::clone(&self.store), entry.id);
        let result = blocking(move || store.delete(id))
            .await
            .and_then(|result| result.map_err(|e| store_failure(&entry.name, "delete", &e)));
        if let Err(error) = result
            && error.kind != ErrorKind::MapNotFound
        {
            // The map is still there: with an entry of its own it is loaded again and takes writes again.
            self.put_stored(entry.stored());
            return Err(error);
        }
        self.change(|table| table.maps.remove(&entry.name));
        self.snapshots.forget(id);
        tracing::info!(map = %entry.name, id = id.0, "deleted");
        Ok(())
    }

    fn damaged_id(&self, name: &MapName) -> Option<MapId> {
        self.table.read().unwrap_or_else(PoisonError::into_inner).damaged.get(name).and_then(|damaged| damaged.id)
    }

    async fn delete_damaged(&self, name: &MapName, id: MapId) -> Result<(), ServiceError> {
        let store = Arc::clone(&self.store);
        blocking(move || store.delete(id)).await?.map_err(|e| store_failure(name, "delete", &e))?;
        self.change(|table| table.damaged.remove(name));
        tracing::info!(map = %name, id = id.0, "deleted a damaged map");
        Ok(())
    }

    fn entry(&self, map: StoredMap) -> Entry {
        Entry::new(map, &self.settings, &self.notices)
    }

    pub(super) fn put_stored(&self, map: StoredMap) {
        self.put(Arc::new(self.entry(map)));
    }

    fn put(&self, entry: Arc<Entry>) {
        self.change(|table| table.maps.insert(entry.name.clone(), entry));
    }

    /// A map with its robots, loaded for it.
    pub(super) async fn describe(&self, entry: &Entry) -> Result<MapDescription, ServiceError> {
        let published = self.opened(entry).await?.published.load_full();
        let robot = |(name, window): (&crate::store::RobotName, &crate::store::SequenceWindow)| RobotDescription {
            name: name.as_str().to_owned(),
            highest_sequence: window.highest(),
            applied: window.count(),
        };
        let mut description = entry.describe(published.windows.iter().map(robot).collect());
        description.revision = published.revision;
        description.last_change = published.stamps.newest().and_then(time_of);
        Ok(description)
    }

    /// Refuses scans of a map whose queue is full, before they are looked at.
    pub(super) fn room(&self, name: &MapName) -> Result<(), ServiceError> {
        match self.find(name)?.opened.get() {
            Some(opened) if opened.places.full() => Err(opened.places.refusal()),
            _ => Ok(()),
        }
    }

    /// Computes scans and waits until their commit is durable.
    pub(super) async fn insert(
        &self,
        name: &MapName,
        scans: Vec<ScanInput>,
        when_full: WhenFull,
    ) -> Result<InsertAnswer, ServiceError> {
        let inside = self.gate.enter()?;
        let limit = self.settings.max_scans_per_request;
        if scans.len() > limit {
            let detail = format!("scans has {} entries, the limit is {limit} a request", scans.len());
            return Err(ServiceError::over(ErrorKind::TooManyScans, setting::SCANS_PER_REQUEST, detail).at("scans"));
        }
        let entry = self.find(name)?;
        let opened = self.opened(&entry).await?;
        let robot = counted_as(&scans);
        let place = match when_full {
            WhenFull::Wait => opened.places.wait(robot).await.ok_or_else(|| map_not_found(name))?,
            WhenFull::Refuse => opened.places.take(robot)?,
        };
        let reservation = self.pool.budget.reservation(robot);
        let bytes = input_bytes(&scans);
        while let Err(error) = reservation.grow(bytes) {
            if error.kind != ErrorKind::Busy || when_full == WhenFull::Refuse {
                return Err(error);
            }
            tasks::sleep(MEMORY_PAUSE).await;
        }
        let (reply, answer) = oneshot::channel();
        self.pool.submit(Task {
            map: name.clone(),
            config: entry.config.load_full(),
            published: opened.published.load_full(),
            settings: Arc::clone(&self.settings),
            scans,
            reservation,
            place,
            queue: opened.queue.clone(),
            inside,
            reply,
        });
        answer.await.unwrap_or_else(|_| {
            Err(ServiceError::new(ErrorKind::Internal, "the server failed while it worked on these scans"))
        })
    }
}

impl Entry {
    fn new(map: StoredMap, settings: &ServiceSettings, notices: &broadcast::Sender<CommitNotice>) -> Self {
        let changes = ChangeLog::new(map.name.clone(), map.id, map.revision, settings.max_changes, notices.clone());
        Self {
            changes: Arc::new(changes),
            robots: Arc::new(Robots::new(settings.max_robots)),
            name: map.name,
            id: map.id,
            created: map.created,
            config: ArcSwap::from_pointee(map.config),
            stored_revision: map.revision,
            opened: OnceCell::new(),
            rescue: Rescue::default(),
            stop: CancellationToken::new(),
        }
    }

    pub(super) fn name(&self) -> &MapName {
        &self.name
    }

    /// The map's revision as readers see it.
    pub(super) fn revision(&self) -> u64 {
        self.opened.get().map_or(self.stored_revision, |opened| opened.published.load().revision)
    }

    /// The map without loading it.
    pub(super) fn describe(&self, robots: Vec<RobotDescription>) -> MapDescription {
        MapDescription {
            name: self.name.clone(),
            config: MapConfig::clone(&self.config.load()),
            revision: self.revision(),
            created: self.created,
            robots,
            last_change: None,
        }
    }

    fn stored(&self) -> StoredMap {
        StoredMap {
            id: self.id,
            name: self.name.clone(),
            config: MapConfig::clone(&self.config.load()),
            revision: self.revision(),
            created: self.created,
        }
    }
}

/// Seconds since the Unix epoch.
pub(super) fn now() -> f64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0.0, |since| since.as_secs_f64())
}

/// Runs what blocks on a thread for it.
pub(super) async fn blocking<T: Send + 'static>(work: impl FnOnce() -> T + Send + 'static) -> Result<T, ServiceError> {
    tasks::spawn_blocking(work).await.map_err(|e| thread_failed(&e))
}
