//! The methods of `ubbmap.v1.MapService`.

use super::GrpcSettings;
use super::generated::map_service_server;
use super::status::{from_status, to_status};
use crate::service::{ErrorKind, MapService, ServiceError};
use crate::transport::client::Client;
use crate::transport::door::{Door, Place};
use crate::transport::{files, operations, scan_stream, watching};
use crate::wire::{self, v1};
use futures_util::StreamExt;
use prost::Message;
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
    service: MapService,
    settings: GrpcSettings,
    door: Door,
}

impl MapRpc {
    pub(super) fn new(service: MapService, settings: GrpcSettings, door: Door) -> Self {
        Self { service, settings, door }
    }

    /// One operation, among those under way and for as long as one may take.
    async fn unary<T: Message>(&self, work: impl Future<Output = Result<T, ServiceError>>) -> Answer<T> {
        self.placed(self.door.request(), work).await
    }

    /// The same for one that has its place.
    async fn placed<T: Message>(
        &self,
        place: Result<Place, ServiceError>,
        work: impl Future<Output = Result<T, ServiceError>>,
    ) -> Answer<T> {
        let answer = async {
            let _place = place?;
            let answer = self.door.timed(work).await??;
            let held = self.door.answers().answer(answer.encoded_len())?;
            let mut response = Response::new(answer);
            if let Some(held) = held {
                // Kept until the answer has gone out.
                response.extensions_mut().insert(held);
            }
            Ok(response)
        };
        answer.await.map_err(|error: ServiceError| to_status(&error))
    }

    /// A file as its pieces come; nothing is made of one that breaks off.
    async fn import(&self, mut pieces: Streaming<v1::ImportMapRequest>) -> Result<v1::ImportMapResponse, ServiceError> {
        let mut map = None;
        let mut file = files::Incoming::default();
        while let Some(piece) = pieces.next().await {
            let piece = piece.map_err(|status| from_status(&status, self.settings.message_bytes))?;
            match &map {
                None => map = Some(wire::map_name(&piece.map)?),
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
        operations::import_map(&self.service, map.as_str(), file.done()).await
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
        self.unary(operations::create_map(&self.service, request.into_inner())).await
    }

    async fn get_map(&self, request: Request<v1::GetMapRequest>) -> Answer<v1::GetMapResponse> {
        self.unary(operations::get_map(&self.service, request.into_inner())).await
    }

    async fn list_maps(&self, _: Request<v1::ListMapsRequest>) -> Answer<v1::ListMapsResponse> {
        self.unary(operations::list_maps(&self.service)).await
    }

    async fn delete_map(&self, request: Request<v1::DeleteMapRequest>) -> Answer<v1::DeleteMapResponse> {
        self.unary(operations::delete_map(&self.service, request.into_inner())).await
    }

    async fn insert_scans(&self, request: Request<v1::InsertScansRequest>) -> Answer<v1::InsertScansResponse> {
        self.placed(self.door.insertion(), operations::insert_scans(&self.service, request.into_inner())).await
    }

    async fn stream_scans(
        &self,
        request: Request<Streaming<v1::StreamScansRequest>>,
    ) -> Answer<Self::StreamScansStream> {
        let client = request.extensions().get::<Client>();
        let place = self.door.stream(client).map_err(|error| to_status(&error))?;
        let (service, door, settings) = (self.service.clone(), self.door.clone(), self.settings.clone());
        let limit = settings.message_bytes;
        let incoming = request.into_inner().map(move |message| message.map_err(|status| from_status(&status, limit)));
        let (out, receiver) = mpsc::channel(WAITING_ACKNOWLEDGEMENTS);
        tokio::spawn(async move {
            scan_stream::run(&service, &door, settings.scans_per_stream, incoming, out).await;
            drop(place);
        });
        Ok(Response::new(messages(receiver)))
    }

    async fn get_classes(&self, request: Request<v1::GetClassesRequest>) -> Answer<v1::GetClassesResponse> {
        self.unary(operations::get_classes(&self.service, request.into_inner())).await
    }

    async fn get_region(&self, request: Request<v1::GetRegionRequest>) -> Answer<v1::GetRegionResponse> {
        self.unary(operations::get_region(&self.service, request.into_inner())).await
    }

    async fn get_grid(&self, request: Request<v1::GetGridRequest>) -> Answer<v1::GetGridResponse> {
        self.unary(operations::get_grid(&self.service, request.into_inner())).await
    }

    async fn get_tile(&self, request: Request<v1::GetTileRequest>) -> Answer<v1::GetTileResponse> {
        self.unary(operations::get_tile(&self.service, request.into_inner())).await
    }

    async fn check_guaranteed_free(
        &self,
        request: Request<v1::CheckGuaranteedFreeRequest>,
    ) -> Answer<v1::CheckGuaranteedFreeResponse> {
        self.unary(operations::check_guaranteed_free(&self.service, request.into_inner())).await
    }

    async fn get_changes(&self, request: Request<v1::GetChangesRequest>) -> Answer<v1::GetChangesResponse> {
        self.unary(operations::get_changes(&self.service, request.into_inner())).await
    }

    async fn watch_map(&self, request: Request<v1::WatchMapRequest>) -> Answer<Self::WatchMapStream> {
        let client = request.extensions().get::<Client>().cloned();
        let request = request.into_inner();
        let watch = self.door.timed(watching::begin(&self.service, &self.door, client.as_ref(), &request)).await;
        watch.and_then(|begun| begun).map(messages).map(Response::new).map_err(|error| to_status(&error))
    }

    async fn create_snapshot(&self, request: Request<v1::CreateSnapshotRequest>) -> Answer<v1::CreateSnapshotResponse> {
        self.unary(operations::create_snapshot(&self.service, request.into_inner())).await
    }

    async fn list_snapshots(&self, request: Request<v1::ListSnapshotsRequest>) -> Answer<v1::ListSnapshotsResponse> {
        self.unary(operations::list_snapshots(&self.service, request.into_inner())).await
    }

    async fn restore_snapshot(
        &self,
        request: Request<v1::RestoreSnapshotRequest>,
    ) -> Answer<v1::RestoreSnapshotResponse> {
        self.unary(operations::restore_snapshot(&self.service, request.into_inner())).await
    }

    async fn delete_snapshot(&self, request: Request<v1::DeleteSnapshotRequest>) -> Answer<v1::DeleteSnapshotResponse> {
        self.unary(operations::delete_snapshot(&self.service, request.into_inner())).await
    }

    async fn export_map(&self, request: Request<v1::ExportMapRequest>) -> Answer<Self::ExportMapStream> {
        let request = request.into_inner();
        let exported = async {
            let _place = self.door.request()?;
            let place = self.door.transfer()?;
            Ok((self.door.timed(operations::export_map(&self.service, &request)).await??, place))
        };
        let (file, place) = exported.await.map_err(|error: ServiceError| to_status(&error))?;
        let revision = file.revision;
        let pieces = files::outgoing(file.bytes.into(), place, &self.door).map(move |piece| {
            let message = |data: bytes::Bytes| v1::ExportMapResponse { data: data.to_vec(), revision };
            piece.map(message).map_err(|error| to_status(&error))
        });
        Ok(Response::new(Box::pin(pieces)))
    }

    async fn import_map(&self, request: Request<Streaming<v1::ImportMapRequest>>) -> Answer<v1::ImportMapResponse> {
        let imported = async {
            let _place = self.door.transfer()?;
            self.door.timed_transfer(self.import(request.into_inner())).await?
        };
        imported.await.map(Response::new).map_err(|error| to_status(&error))
    }
}
