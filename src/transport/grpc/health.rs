//! The health service: serving while the server takes work.

use super::generated::map_service_server::MapServiceServer;
use super::service::MapRpc;
use crate::transport::access::Guarded;
use crate::transport::door::Door;
use std::time::Duration;
use tonic_health::ServingStatus;
use tonic_health::pb::health_server::{Health, HealthServer};

/// How often the store's state is looked at.
const LOOK: Duration = Duration::from_secs(1);

/// The name that stands for the whole server.
const WHOLE: &str = "";

/// The health service, and a task that keeps it true until the server ends.
pub fn watched(service: Guarded, door: Door) -> HealthServer<impl Health> {
    let (reporter, server) = tonic_health::server::health_reporter();
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
