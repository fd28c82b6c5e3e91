//! The service behind its access: what the transports hold.

use super::audit::Change;
use super::{Access, Caller, Operation, Peer, Refused, Shown};
use crate::mapping::MapConfig;
use crate::service::{
    Changes, ChangesQuery, Created, ExportForm, ExportedFile, InsertAnswer, MapDescription, MapService, MapVersion,
    MapView, RobotsAnswer, ScanInput, ServiceError, ServiceSettings, Watch,
};
use crate::store::{MapName, SnapshotName, StoredSnapshot};
use std::sync::Arc;

/// Longest name of a request that is written down, bytes.
const LONGEST_ID: usize = 128;

/// Where a request came from, for the log.
#[derive(Debug, Clone)]
pub struct Origin {
    /// `rest`, `grpc` or `zenoh`.
    pub transport: &'static str,
    /// The connection's other end.
    pub peer: Peer,
    /// What the client, or a proxy between, calls the request.
    pub request_id: Option<String>,
}

impl Origin {
    /// An origin. A `request_id` that is long or has unusual characters is left out: it goes into the log.
    #[must_use]
    pub fn new(transport: &'static str, peer: Peer, request_id: Option<&[u8]>) -> Self {
        let fits = |id: &&[u8]| !id.is_empty() && id.len() <= LONGEST_ID && id.iter().all(u8::is_ascii_graphic);
        let request_id = request_id.filter(fits).map(|id| String::from_utf8_lossy(id).into_owned());
        Self { transport, peer, request_id }
    }
}

/// A service that nobody gets to without saying who they are. Cheap to clone.
#[derive(Clone)]
pub struct Guarded {
    service: MapService,
    access: Access,
}

impl Guarded {
    /// A service behind an access.
    #[must_use]
    pub fn new(service: MapService, access: Access) -> Self {
        Self { service, access }
    }

    /// The service as whoever shows this may use it.
    ///
    /// # Errors
    /// [`crate::service::ErrorKind::Unauthenticated`]
    pub fn identify(&self, shown: Shown<'_>, origin: Origin) -> Result<OnBehalf, ServiceError> {
        let caller = self.access.identify(shown, &origin.peer)?;
        Ok(self.of(caller, origin))
    }

    /// The service as a caller may use it whom something else has let in, as Zenoh does by its own access control.
    #[must_use]
    pub fn of(&self, caller: Caller, origin: Origin) -> OnBehalf {
        OnBehalf { service: self.service.clone(), access: self.access.clone(), caller, origin: Arc::new(origin) }
    }

    /// The limits and settings in force.
    #[must_use]
    pub fn settings(&self) -> &ServiceSettings {
        self.service.settings()
    }

    /// True while the service takes work and its store takes writes.
    #[must_use]
    pub fn is_ready(&self) -> bool {
        self.service.is_ready()
    }

    /// True where strangers reach the server and nothing is asked of them.
    #[must_use]
    pub fn is_insecure(&self) -> bool {
        self.access.is_insecure()
    }
}

/// The service as one caller may use it: every operation of [`MapService`] with the check before it, and for a change by
/// an administrator the line of the log behind it. Cheap to clone.
#[derive(Clone)]
pub struct OnBehalf {
    service: MapService,
    access: Access,
    caller: Caller,
    origin: Arc<Origin>,
}

impl OnBehalf {
    /// Who it is.
    #[must_use]
    pub fn caller(&self) -> &Caller {
        &self.caller
    }

    /// The limits and settings in force.
    #[must_use]
    pub fn settings(&self) -> &ServiceSettings {
        self.service.settings()
    }

    /// May the caller do this with this map? Every operation asks by itself; this is for those who read a long body first.
    ///
    /// # Errors
    /// [`crate::service::ErrorKind::PermissionDenied`], or [`crate::service::ErrorKind::Unauthenticated`] for a grant that
    /// has ended meanwhile. As every operation below.
    pub fn may(&self, operation: Operation, map: &MapName) -> Result<(), ServiceError> {
        self.noted(self.caller.may(operation, map))
    }

    /// May the caller do this with any map?
    ///
    /// # Errors
    /// As [`OnBehalf::may`].
    pub fn may_at_all(&self, operation: Operation) -> Result<(), ServiceError> {
        self.noted(self.caller.may_at_all(operation))
    }

    /// Waits until the caller's grant ends: what an open stream is told then.
    pub async fn ended(&self) -> ServiceError {
        let refused = self.caller.ended().await;
        self.access.note(refused, &self.origin.peer)
    }

    /// As [`MapService::create_map`].
    ///
    /// # Errors
    /// Those, and of [`OnBehalf::may`].
    pub async fn create_map(&self, name: &MapName, config: MapConfig) -> Result<Created, ServiceError> {
        let change = self.change(Operation::CreateMap, name, None)?;
        change.end(self.service.create_map(name, config).await)
    }

    /// As [`MapService::map`].
    ///
    /// # Errors
    /// Those, and of [`OnBehalf::may`].
    pub async fn map(&self, name: &MapName) -> Result<MapDescription, ServiceError> {
        self.may(Operation::GetMap, name)?;
        self.service.map(name).await
    }

    /// As [`MapService::version`].
    ///
    /// # Errors
    /// Those, and of [`OnBehalf::may`].
    pub async fn version(&self, name: &MapName) -> Result<MapVersion, ServiceError> {
        self.may(Operation::GetMap, name)?;
        self.service.version(name).await
    }

    /// As [`MapService::maps`], of those that the caller may see.
    ///
    /// # Errors
    /// Those, and of [`OnBehalf::may_at_all`].
    pub async fn maps(&self) -> Result<Vec<MapDescription>, ServiceError> {
        self.may_at_all(Operation::ListMaps)?;
        let mut maps = self.service.maps().await?;
        maps.retain(|map| self.caller.grant().maps.holds(&map.name));
        Ok(maps)
    }

    /// As [`MapService::delete_map`].
    ///
    /// # Errors
    /// Those, and of [`OnBehalf::may`].
    pub async fn delete_map(&self, name: &MapName) -> Result<(), ServiceError> {
        let change = self.change(Operation::DeleteMap, name, None)?;
        change.end(self.service.delete_map(name).await)
    }

    /// As [`MapService::insert`].
    ///
    /// # Errors
    /// Those, and of [`OnBehalf::may`]; nothing is applied where one scan is of a robot that is not the caller's.
    pub async fn insert(&self, name: &MapName, scans: Vec<ScanInput>) -> Result<InsertAnswer, ServiceError> {
        self.may_insert(Operation::InsertScans, name, &scans)?;
        self.service.insert(name, scans).await
    }

    /// As [`MapService::insert_when_free`].
    ///
    /// # Errors
    /// As [`OnBehalf::insert`].
    pub async fn insert_when_free(&self, name: &MapName, scans: Vec<ScanInput>) -> Result<InsertAnswer, ServiceError> {
        self.may_insert(Operation::StreamScans, name, &scans)?;
        self.service.insert_when_free(name, scans).await
    }

    /// As [`MapService::view`], to be read for an operation.
    ///
    /// # Errors
    /// Those, and of [`OnBehalf::may`].
    pub async fn view(
        &self,
        operation: Operation,
        name: &MapName,
        snapshot: Option<&SnapshotName>,
    ) -> Result<MapView, ServiceError> {
        self.may(operation, name)?;
        self.service.view(name, snapshot).await
    }

    /// As [`MapService::robots`].
    ///
    /// # Errors
    /// Those, and of [`OnBehalf::may`].
    pub async fn robots(&self, name: &MapName) -> Result<RobotsAnswer, ServiceError> {
        self.may(Operation::ListRobots, name)?;
        self.service.robots(name).await
    }

    /// As [`MapService::changes`].
    ///
    /// # Errors
    /// Those, and of [`OnBehalf::may`].
    pub async fn changes(&self, name: &MapName, since: u64, query: &ChangesQuery) -> Result<Changes, ServiceError> {
        self.may(Operation::GetChanges, name)?;
        self.service.changes(name, since, query).await
    }

    /// As [`MapService::watch`]. Whoever reads it must end with [`OnBehalf::ended`].
    ///
    /// # Errors
    /// Those, and of [`OnBehalf::may`].
    pub async fn watch(&self, name: &MapName, since: Option<u64>, query: ChangesQuery) -> Result<Watch, ServiceError> {
        self.may(Operation::WatchMap, name)?;
        self.service.watch(name, since, query).await
    }

    /// As [`MapService::take_snapshot`].
    ///
    /// # Errors
    /// Those, and of [`OnBehalf::may`].
    pub async fn take_snapshot(&self, map: &MapName, snapshot: &SnapshotName) -> Result<StoredSnapshot, ServiceError> {
        let change = self.change(Operation::CreateSnapshot, map, Some(snapshot))?;
        change.end(self.service.take_snapshot(map, snapshot).await)
    }

    /// As [`MapService::snapshots`].
    ///
    /// # Errors
    /// Those, and of [`OnBehalf::may`].
    pub async fn snapshots(&self, map: &MapName) -> Result<Vec<StoredSnapshot>, ServiceError> {
        self.may(Operation::ListSnapshots, map)?;
        self.service.snapshots(map).await
    }

    /// As [`MapService::restore_snapshot`].
    ///
    /// # Errors
    /// Those, and of [`OnBehalf::may`].
    pub async fn restore_snapshot(&self, map: &MapName, snapshot: &SnapshotName) -> Result<u64, ServiceError> {
        let change = self.change(Operation::RestoreSnapshot, map, Some(snapshot))?;
        change.end(self.service.restore_snapshot(map, snapshot).await)
    }

    /// As [`MapService::delete_snapshot`].
    ///
    /// # Errors
    /// Those, and of [`OnBehalf::may`].
    pub async fn delete_snapshot(&self, map: &MapName, snapshot: &SnapshotName) -> Result<(), ServiceError> {
        let change = self.change(Operation::DeleteSnapshot, map, Some(snapshot))?;
        change.end(self.service.delete_snapshot(map, snapshot).await)
    }

    /// As [`MapService::export`].
    ///
    /// # Errors
    /// Those, and of [`OnBehalf::may`].
    pub async fn export(
        &self,
        map: &MapName,
        snapshot: Option<&SnapshotName>,
        form: ExportForm,
    ) -> Result<ExportedFile, ServiceError> {
        self.may(Operation::ExportMap, map)?;
        self.service.export(map, snapshot, form).await
    }

    /// As [`MapService::import`].
    ///
    /// # Errors
    /// Those, and of [`OnBehalf::may`].
    pub async fn import<B>(&self, map: &MapName, file: B) -> Result<MapVersion, ServiceError>
    where
        B: AsRef<[u8]> + Send + 'static,
    {
        let change = self.change(Operation::ImportMap, map, None)?;
        change.end(self.service.import(map, file).await)
    }

    fn may_insert(&self, operation: Operation, name: &MapName, scans: &[ScanInput]) -> Result<(), ServiceError> {
        self.may(operation, name)?;
        self.noted(scans.iter().try_for_each(|scan| self.caller.may_send_for(&scan.robot)))
    }

    fn change<'a>(
        &'a self,
        operation: Operation,
        map: &'a MapName,
        snapshot: Option<&'a SnapshotName>,
    ) -> Result<Change<'a>, ServiceError> {
        self.may(operation, map)?;
        let snapshot = snapshot.map(SnapshotName::as_str);
        Ok(Change::begin(&self.caller, &self.origin, self.access.is_insecure(), operation, map, snapshot))
    }

    fn noted<T>(&self, allowed: Result<T, Refused>) -> Result<T, ServiceError> {
        allowed.map_err(|refused| self.access.note(refused, &self.origin.peer))
    }
}
