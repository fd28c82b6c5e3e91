//! The methods of `ubbmap.v1.MapService`.

use super::GrpcSettings;
use super::generated::map_service_server;
use super::status::{from_status, to_status};
use crate::service::{ErrorKind, ServiceError};
use crate::transport::access::{OnBehalf, Operation};
use crate::transport::door::Door;
use crate::transport::{files, operations, scan_stream, watching};
use crate::wire::{self, v1};
use futures_util::StreamExt;
use std::pin::Pin;
use tokio::sync::mpsc;
use tokio_stream::Stream;
use tokio_stream::wrappers::ReceiverStream;
use tonic::{Request, Response, Status, Streaming};

/// Acknowledgements that wait for a client to read them.
const WAITING_ACKNOWLEDGEMENTS: usize = 16;

type Answer<T> = Result<Response<T>, Status>;
type Messages<T> = Pin<Box<dyn Stream<Item = Result<T, Status>> + Send>>;

/// The service behind the generated routes.
pub struct MapRpc {
    settings: GrpcSettings,
    door: Door,
}

impl MapRpc {
    pub(super) fn new(settings: GrpcSettings, door: Door) -> Self {
        Self { settings, door }
    }

    /// One operation, among those under way and for as long as one may take.
    async fn unary<T>(&self, work: impl Future<Output = Result<T, ServiceError>>) -> Answer<T> {
        let answer = async {
            let _place = self.door.request()?;
            self.door.timed(work).await?
        };
        answer.await.map(Response::new).map_err(|error| to_status(&error))
    }

    /// A file as its pieces come; nothing is made of one that breaks off.
    async fn import(
        &self,
        caller: &OnBehalf,
        mut pieces: Streaming<v1::ImportMapRequest>,
    ) -> Result<v1::ImportMapResponse, ServiceError> {
        let mut map = None;
        let mut file = files::Incoming::default();
        while let Some(piece) = pieces.next().await {
            let piece = piece.map_err(|status| from_status(&status, self.settings.message_bytes))?;
            match &map {
                None => {
                    let named = wire::map_name(&piece.map)?;
                    // Nobody holds a whole file in memory for whom nothing is made of it.
                    caller.may(Operation::ImportMap, &named)?;
                    map = Some(named);
                }
                Some(_) if !piece.map.is_empty() => {
                    let detail = "map stands in the first message alone";
                    return Err(ServiceError::new(ErrorKind::InvalidRequest, detail).at("map"));
                }
                Some(_) => {}
            }
            file.take(&piece.data, self.settings.import_bytes)?;
        }
        let map = match map {
            Some(map) => map,
            None => wire::map_name("")?,
        };
        operations::import_map(caller, map.as_str(), file.done()).await
    }
}

/// Who asks, as the layer around the service has found out, and what for. Without that layer nobody is let in.
fn asked<T>(request: Request<T>) -> Result<(OnBehalf, T), Status> {
    let (_, mut extensions, message) = request.into_parts();
    match extensions.remove::<OnBehalf>() {
        Some(caller) => Ok((caller, message)),
        None => {
            let error = ServiceError::new(ErrorKind::Unauthenticated, "it is not known who asks");
            Err(to_status(&error))
        }
    }
}

fn messages<T: Send + 'static>(receiver: mpsc::Receiver<Result<T, ServiceError>>) -> Messages<T> {
    Box::pin(ReceiverStream::new(receiver).map(|message| message.map_err(|error| to_status(&error))))
}

#[tonic::async_trait]
impl map_service_server::MapService for MapRpc {
    type StreamScansStream = Messages<v1::StreamScansResponse>;
    type WatchMapStream = Messages<v1::WatchMapResponse>;
    type ExportMapStream = Messages<v1::ExportMapResponse>;

    async fn create_map(&self, request: Request<v1::CreateMapRequest>) -> Answer<v1::CreateMapResponse> {
        let (caller, request) = asked(request)?;
        self.unary(operations::create_map(&caller, request)).await
    }

    async fn get_map(&self, request: Request<v1::GetMapRequest>) -> Answer<v1::GetMapResponse> {
        let (caller, request) = asked(request)?;
        self.unary(operations::get_map(&caller, request)).await
    }

    async fn list_maps(&self, request: Request<v1::ListMapsRequest>) -> Answer<v1::ListMapsResponse> {
        let (caller, _) = asked(request)?;
        self.unary(operations::list_maps(&caller)).await
    }

    async fn delete_map(&self, request: Request<v1::DeleteMapRequest>) -> Answer<v1::DeleteMapResponse> {
        let (caller, request) = asked(request)?;
        self.unary(operations::delete_map(&caller, request)).await
    }

    async fn insert_scans(&self, request: Request<v1::InsertScansRequest>) -> Answer<v1::InsertScansResponse> {
        let (caller, request) = asked(request)?;
        self.unary(operations::insert_scans(&caller, request)).await
    }

    async fn stream_scans(
        &self,
        request: Request<Streaming<v1::StreamScansRequest>>,
    ) -> Answer<Self::StreamScansStream> {
        let (caller, messages_in) = asked(request)?;
        let place = self.door.stream().map_err(|error| to_status(&error))?;
        let (door, settings) = (self.door.clone(), self.settings.clone());
        let limit = settings.message_bytes;
        let incoming = messages_in.map(move |message| message.map_err(|status| from_status(&status, limit)));
        let (out, receiver) = mpsc::channel(WAITING_ACKNOWLEDGEMENTS);
        tokio::spawn(async move {
            scan_stream::run(&caller, &door, settings.scans_per_stream, incoming, out).await;
            drop(place);
        });
        Ok(Response::new(messages(receiver)))
    }

    async fn get_classes(&self, request: Request<v1::GetClassesRequest>) -> Answer<v1::GetClassesResponse> {
        let (caller, request) = asked(request)?;
        self.unary(operations::get_classes(&caller, request)).await
    }

    async fn get_region(&self, request: Request<v1::GetRegionRequest>) -> Answer<v1::GetRegionResponse> {
        let (caller, request) = asked(request)?;
        self.unary(operations::get_region(&caller, request)).await
    }

    async fn get_grid(&self, request: Request<v1::GetGridRequest>) -> Answer<v1::GetGridResponse> {
        let (caller, request) = asked(request)?;
        self.unary(operations::get_grid(&caller, request)).await
    }

    async fn get_tile(&self, request: Request<v1::GetTileRequest>) -> Answer<v1::GetTileResponse> {
        let (caller, request) = asked(request)?;
        self.unary(operations::get_tile(&caller, request)).await
    }

    async fn check_guaranteed_free(
        &self,
        request: Request<v1::CheckGuaranteedFreeRequest>,
    ) -> Answer<v1::CheckGuaranteedFreeResponse> {
        let (caller, request) = asked(request)?;
        self.unary(operations::check_guaranteed_free(&caller, request)).await
    }

    async fn get_changes(&self, request: Request<v1::GetChangesRequest>) -> Answer<v1::GetChangesResponse> {
        let (caller, request) = asked(request)?;
        self.unary(operations::get_changes(&caller, request)).await
    }

    async fn watch_map(&self, request: Request<v1::WatchMapRequest>) -> Answer<Self::WatchMapStream> {
        let (caller, request) = asked(request)?;
        let watch = self.door.timed(watching::begin(&caller, &self.door, &request)).await;
        watch.and_then(|begun| begun).map(messages).map(Response::new).map_err(|error| to_status(&error))
    }

    async fn list_robots(&self, request: Request<v1::ListRobotsRequest>) -> Answer<v1::ListRobotsResponse> {
        let (caller, request) = asked(request)?;
        self.unary(operations::list_robots(&caller, request)).await
    }

    async fn create_snapshot(&self, request: Request<v1::CreateSnapshotRequest>) -> Answer<v1::CreateSnapshotResponse> {
        let (caller, request) = asked(request)?;
        self.unary(operations::create_snapshot(&caller, request)).await
    }

    async fn list_snapshots(&self, request: Request<v1::ListSnapshotsRequest>) -> Answer<v1::ListSnapshotsResponse> {
        let (caller, request) = asked(request)?;
        self.unary(operations::list_snapshots(&caller, request)).await
    }

    async fn restore_snapshot(
        &self,
        request: Request<v1::RestoreSnapshotRequest>,
    ) -> Answer<v1::RestoreSnapshotResponse> {
        let (caller, request) = asked(request)?;
        self.unary(operations::restore_snapshot(&caller, request)).await
    }

    async fn delete_snapshot(&self, request: Request<v1::DeleteSnapshotRequest>) -> Answer<v1::DeleteSnapshotResponse> {
        let (caller, request) = asked(request)?;
        self.unary(operations::delete_snapshot(&caller, request)).await
    }

    async fn export_map(&self, request: Request<v1::ExportMapRequest>) -> Answer<Self::ExportMapStream> {
        let (caller, request) = asked(request)?;
        let exported = self.unary(async {
            let place = self.door.transfer()?;
            Ok((operations::export_map(&caller, &request).await?, place))
        });
        let (file, place) = exported.await?.into_inner();
        let revision = file.revision;
        let pieces = files::outgoing(file.bytes.into(), place, &self.door).map(move |piece| {
            let message = |data: bytes::Bytes| v1::ExportMapResponse { data: data.to_vec(), revision };
            piece.map(message).map_err(|error| to_status(&error))
        });
        Ok(Response::new(Box::pin(pieces)))
    }

    async fn import_map(&self, request: Request<Streaming<v1::ImportMapRequest>>) -> Answer<v1::ImportMapResponse> {
        let (caller, pieces) = asked(request)?;
        let imported = async {
            let _place = self.door.transfer()?;
            self.door.timed_transfer(self.import(&caller, pieces)).await?
        };
        imported.await.map(Response::new).map_err(|error| to_status(&error))
    }
}
