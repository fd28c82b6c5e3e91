//! The health service: serving while the server takes work.

use super::generated::map_service_server::MapServiceServer;
use super::service::MapRpc;
use crate::transport::access::Guarded;
use crate::transport::door::Door;
use futures_util::stream::{Stream, StreamExt};
use std::pin::Pin;
use std::time::Duration;
use tonic::{Request, Response, Status};
use tonic_health::ServingStatus;
use tonic_health::pb::health_server::{Health, HealthServer};
use tonic_health::pb::{HealthCheckRequest, HealthCheckResponse};
use tonic_health::server::{HealthReporter, HealthService};

/// How often the store's state is looked at.
const LOOK: Duration = Duration::from_secs(1);

/// How long those who watch have to hear that the server ends.
const TOLD: Duration = Duration::from_millis(200);

/// The name that stands for the whole server.
const WHOLE: &str = "";

/// The health service, and a task that keeps it true until the server ends.
pub fn watched(service: Guarded, door: Door) -> HealthServer<impl Health> {
    let reporter = HealthReporter::new();
    let known = HealthService::from_health_reporter(reporter.clone());
    let server = HealthServer::new(Ending { known, door: door.clone() });
    tokio::spawn(async move {
        loop {
            let ended = door.is_draining();
            let serving = if !ended && service.is_ready() { ServingStatus::Serving } else { ServingStatus::NotServing };
            reporter.set_service_status(WHOLE, serving).await;
            match serving {
                ServingStatus::Serving => reporter.set_serving::<MapServiceServer<MapRpc>>().await,
                _ => reporter.set_not_serving::<MapServiceServer<MapRpc>>().await,
            }
            if ended {
                break;
            }
            tokio::select! {
                () = tokio::time::sleep(LOOK) => {}
                () = door.draining() => {}
            }
        }
    });
    server
}

/// The health of the services; whoever watches it is told of the end, and then it is the end of the watch too.
struct Ending {
    known: HealthService,
    door: Door,
}

#[tonic::async_trait]
impl Health for Ending {
    type WatchStream = Pin<Box<dyn Stream<Item = Result<HealthCheckResponse, Status>> + Send>>;

    async fn check(&self, request: Request<HealthCheckRequest>) -> Result<Response<HealthCheckResponse>, Status> {
        self.known.check(request).await
    }

    async fn watch(&self, request: Request<HealthCheckRequest>) -> Result<Response<Self::WatchStream>, Status> {
        let told = self.known.watch(request).await?.into_inner();
        let door = self.door.clone();
        let end = async move {
            door.draining().await;
            tokio::time::sleep(TOLD).await;
        };
        Ok(Response::new(Box::pin(told.take_until(end))))
    }
}
