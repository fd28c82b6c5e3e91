//! Floor 6: the server as a whole: store, service, listener, and an orderly end.

use crate::config::{Config, ConfigError, StoreKind, seconds};
use crate::service::{MapService, ServiceError};
use crate::store::{MapStore, MemoryStore, SledOptions, SledStore, StoreError};
use crate::telemetry;
use crate::transport::door::{Door, DoorSettings};
use crate::transport::grpc::{self, GrpcSettings};
use crate::transport::http::{self, HttpSettings, OutsideView, ServeLimits};
use crate::transport::zenoh::{Reachable, ZenohError, ZenohServer};
use std::net::SocketAddr;
use std::sync::{Arc, Weak};
use std::time::{Duration, Instant};
use thiserror::Error;
use tokio::net::TcpListener;
use tokio::sync::oneshot;
use tokio::task::JoinHandle;

/// How long the end waits for the store to close.
const CLOSE_PATIENCE: Duration = Duration::from_secs(5);

/// Why a server does not start or ends early.
#[derive(Debug, Error)]
pub enum AppError {
    /// A setting.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// The store does not open.
    #[error("cannot open the store: {0}")]
    Store(#[from] StoreError),
    /// Opening the store ended in a panic, which the log tells.
    #[error("cannot open the store: its opening failed")]
    StorePanicked,
    /// The service does not start.
    #[error("cannot start the service: {0}")]
    Service(#[from] ServiceError),
    /// The address cannot be listened on.
    #[error("cannot listen on {address}: {source}")]
    Listen {
        /// The address.
        address: SocketAddr,
        /// Why not.
        source: std::io::Error,
    },
    /// The signals of the end cannot be waited for.
    #[error("cannot wait for signals: {0}")]
    Signal(std::io::Error),
    /// The transport over Zenoh does not start.
    #[error(transparent)]
    Zenoh(#[from] ZenohError),
    /// The interface's description, which reflection serves, cannot be read.
    #[error("cannot serve the description of the interface: {0}")]
    Reflection(tonic_reflection::server::Error),
    /// The listener's task ended by a panic.
    #[error("the listener failed")]
    Listener,
}

/// Serves until SIGTERM or SIGINT; `ready` is called with the bound address once requests are answered. What was
/// acknowledged is durable when it returns.
///
/// # Errors
/// [`AppError`] when the server cannot start.
pub async fn serve(config: Config, ready: impl FnOnce(SocketAddr)) -> Result<(), AppError> {
    // Before anything is opened, so that a signal during the start is not lost.
    let stop = stop_signal().map_err(AppError::Signal)?;
    config.check()?;
    let store = open_store(&config).await?;
    let open = Arc::downgrade(&store);
    let server = Server::start(&config, store).await?;
    tracing::info!(address = %server.address(), "ready");
    if let Some(zenoh) = server.zenoh() {
        tracing::info!(id = zenoh.id(), listen = zenoh.locators().join(","), "on Zenoh");
    }
    ready(server.address());
    stop.await;
    tracing::info!("draining");
    server.shutdown().await?;
    closed(&open).await;
    tracing::info!("done");
    Ok(())
}

/// A running server.
#[derive(Debug)]
pub struct Server {
    address: SocketAddr,
    door: Door,
    stop: oneshot::Sender<()>,
    listener: JoinHandle<()>,
    zenoh: Option<ZenohServer>,
    service: ServiceHandle,
}

/// The service, which has no debug form.
struct ServiceHandle(MapService);

impl std::fmt::Debug for ServiceHandle {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("MapService")
    }
}

impl Server {
    /// Starts a server over a store on the address that the settings name.
    ///
    /// # Errors
    /// [`AppError`] when the settings do not hold, the service does not start or the address is taken.
    pub async fn start(config: &Config, store: Arc<dyn MapStore>) -> Result<Self, AppError> {
        config.check()?;
        let metrics = telemetry::metrics_handle();
        let service = MapService::open(store, config.service_settings())?;
        let limits = &config.limits;
        let door = Door::new(DoorSettings {
            requests: limits.requests,
            insertions: limits.insertions,
            streams: limits.streams,
            streams_per_client: limits.streams_per_client,
            connections_per_client: limits.connections_per_client,
            header_bytes: limits.header_bytes,
            incoming_bytes: limits.incoming_bytes,
            answer_bytes: limits.answer_bytes,
            transfers: limits.transfers,
            request_timeout: seconds(limits.request_seconds),
            transfer_timeout: seconds(limits.transfer_seconds),
        });
        let settings = HttpSettings {
            body_bytes: limits.body_bytes,
            config_bytes: limits.config_bytes,
            import_bytes: limits.import_bytes,
            scans_per_stream: limits.scans_per_stream,
        };
        let failed = |source| AppError::Listen { address: config.listen, source };
        let listener = TcpListener::bind(config.listen).await.map_err(failed)?;
        let address = listener.local_addr().map_err(failed)?;
        let zenoh = match config.zenoh_settings() {
            Some(settings) => Some(ZenohServer::start(service.clone(), door.clone(), settings).await?),
            None => None,
        };
        let reached = zenoh.as_ref().map(ZenohServer::reachable).cloned();
        let counted = service.clone();
        let outside = OutsideView {
            metrics: Box::new(move || {
                counted.note_metrics();
                metrics.render()
            }),
            reachable: Box::new(move || reached.as_ref().is_none_or(Reachable::now)),
        };
        let rest = http::router(service.clone(), settings, door.clone(), outside);
        let settings = GrpcSettings {
            message_bytes: limits.body_bytes,
            import_bytes: limits.import_bytes,
            scans_per_stream: limits.scans_per_stream,
        };
        let rpc = grpc::router(service.clone(), settings, door.clone()).map_err(AppError::Reflection)?;
        let router = rest.merge(rpc).layer(http::cors(&config.origins()));
        let serve_limits = ServeLimits {
            connections: limits.connections,
            header_timeout: seconds(limits.header_seconds),
            idle_timeout: seconds(limits.idle_seconds),
            requests_per_connection: u32::try_from(limits.requests_per_connection).unwrap_or(u32::MAX),
            clients: Arc::clone(door.connections()),
            grace: config.grace(),
        };
        let (stop, stopped) = oneshot::channel();
        let listener = tokio::spawn(async move {
            http::serve(listener, router, &serve_limits, async {
                // A dropped handle stops the server as well.
                let _ = stopped.await;
            })
            .await;
        });
        Ok(Self { address, door, stop, listener, zenoh, service: ServiceHandle(service) })
    }

    /// Where it listens.
    #[must_use]
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// Its address as clients write it, without a slash at the end.
    #[must_use]
    pub fn url(&self) -> String {
        format!("http://{}", self.address)
    }

    /// Its part in a network of Zenoh, where it has one.
    #[must_use]
    pub fn zenoh(&self) -> Option<&ZenohServer> {
        self.zenoh.as_ref()
    }

    /// The service behind it.
    #[must_use]
    pub fn service(&self) -> &MapService {
        &self.service.0
    }

    /// Turns away new connections, finishes the requests under way, and returns when all that was taken is durable.
    ///
    /// # Errors
    /// [`AppError::Listener`] when the listener's task failed; the service is drained all the same.
    pub async fn shutdown(self) -> Result<(), AppError> {
        self.door.begin_draining();
        // The listener's task has ended already when this fails.
        let _ = self.stop.send(());
        let ended = self.listener.await;
        if let Some(zenoh) = self.zenoh {
            zenoh.shutdown().await;
        }
        self.service.0.drain().await;
        ended.map_err(|_| AppError::Listener)
    }
}

async fn open_store(config: &Config) -> Result<Arc<dyn MapStore>, AppError> {
    match config.store {
        StoreKind::Memory => Ok(Arc::new(MemoryStore::new())),
        StoreKind::Sled => {
            let directory = config.data_dir.clone();
            // Opening reads and writes files, and a large store takes a while.
            let options = SledOptions { cache_bytes: config.cache.page_bytes, rewrite: config.rewrite_options() };
            let opened = tokio::task::spawn_blocking(move || SledStore::open(&directory, options));
            Ok(Arc::new(opened.await.map_err(|_| AppError::StorePanicked)??))
        }
    }
}

/// Waits until nothing holds the store: its writers let go of it a little after the drain. Everything is durable by
/// then, so a store that stays open is only worth a line.
async fn closed(store: &Weak<dyn MapStore>) {
    let begun = Instant::now();
    while store.strong_count() > 0 {
        if begun.elapsed() > CLOSE_PATIENCE {
            tracing::warn!("the store is still open");
            return;
        }
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
}

#[cfg(unix)]
fn stop_signal() -> std::io::Result<impl Future<Output = ()>> {
    use tokio::signal::unix::{SignalKind, signal};
    let mut terminate = signal(SignalKind::terminate())?;
    let mut interrupt = signal(SignalKind::interrupt())?;
    Ok(async move {
        tokio::select! {
            _ = terminate.recv() => {}
            _ = interrupt.recv() => {}
        }
    })
}

#[cfg(not(unix))]
fn stop_signal() -> std::io::Result<impl Future<Output = ()>> {
    Ok(async {
        // Without a way to be told, the server runs until the process ends.
        if tokio::signal::ctrl_c().await.is_err() {
            std::future::pending::<()>().await;
        }
    })
}
