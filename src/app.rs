//! Floor 6: the server as a whole: store, service, listener, and an orderly end.

mod files;

use crate::config::{Config, ConfigError, StoreKind, seconds};
use crate::reload::{self, Watch};
use crate::service::{MapService, ServiceError};
use crate::store::{MapStore, MemoryStore, SledOptions, SledStore, StoreError};
use crate::telemetry;
use crate::transport::access::{Access, Guarded, Listener};
use crate::transport::door::{Door, DoorSettings};
use crate::transport::grpc::{self, GrpcSettings};
use crate::transport::http::{self, HttpSettings, OutsideView, ServeLimits};
use crate::transport::tls::Tls;
use crate::transport::zenoh::{Reachable, ZenohError, ZenohServer};
use axum::Router;
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
    #[error("cannot listen on {address}: {source}{}", way_out(source))]
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
    /// Reading files ended in a panic, which the log tells.
    #[error("cannot read the files that the settings name: reading them failed")]
    Files,
    /// The listener's task ended by a panic.
    #[error("the listener failed")]
    Listener,
}

/// What helps where an address is taken.
pub(crate) fn way_out(error: &std::io::Error) -> &'static str {
    match error.kind() {
        std::io::ErrorKind::AddrInUse => {
            ": another program has it; --listen names another address, and port 0 takes a free one"
        }
        _ => "",
    }
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
    // Read again when the server starts; a fault in the files should not wait for a large store.
    files::tls(&config).await?;
    config.access()?;
    config.zenoh_users()?;
    // A server that cannot listen leaves no new store behind.
    let bound = bind(&config).await?;
    let store = open_store(&config).await?;
    let open = Arc::downgrade(&store);
    let server = Server::start_on(bound, &config, store).await?;
    server.warn_if_insecure();
    tracing::info!(address = %server.address(), "ready");
    if let Some(address) = server.administration() {
        tracing::info!(%address, "administration and metrics");
    }
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
    secure: bool,
    public: Listening,
    administration: Option<Listening>,
    access: Access,
    door: Door,
    zenoh: Option<ZenohServer>,
    service: ServiceHandle,
    /// Files that are read anew for as long as the server is there.
    _watch: Watch,
}

/// One address that is listened on.
#[derive(Debug)]
struct Listening {
    address: SocketAddr,
    stop: oneshot::Sender<()>,
    task: JoinHandle<()>,
}

impl Listening {
    /// Listens on an address; nothing is accepted before [`Listening::serve`].
    async fn bind(address: SocketAddr) -> Result<(TcpListener, SocketAddr), AppError> {
        let failed = |source| AppError::Listen { address, source };
        let listener = TcpListener::bind(address).await.map_err(failed)?;
        let bound = listener.local_addr().map_err(failed)?;
        Ok((listener, bound))
    }

    fn serve(
        (listener, address): (TcpListener, SocketAddr),
        kind: Listener,
        router: Router,
        limits: ServeLimits,
        tls: Option<Tls>,
    ) -> Self {
        let (stop, stopped) = oneshot::channel();
        let task = tokio::spawn(async move {
            http::serve(listener, kind, router, &limits, tls, async {
                // A dropped handle stops the server as well.
                let _ = stopped.await;
            })
            .await;
        });
        Self { address, stop, task }
    }

    async fn shutdown(self) -> Result<(), AppError> {
        // The listener's task has ended already when this fails.
        let _ = self.stop.send(());
        self.task.await.map_err(|_| AppError::Listener)
    }
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
        Self::start_on(bind(config).await?, config, store).await
    }

    /// Starts a server over a store on the addresses that [`bind`] took.
    ///
    /// # Errors
    /// [`AppError`] when the settings do not hold or the service does not start.
    pub async fn start_on(bound: Bound, config: &Config, store: Arc<dyn MapStore>) -> Result<Self, AppError> {
        config.check()?;
        let metrics = telemetry::metrics_handle();
        let (tls, mut watched) = files::tls(config).await?;
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
            idle_timeout: seconds(limits.idle_seconds),
        });
        let (access, tokens) = files::access(config)?;
        watched.extend(tokens);
        let guarded = Guarded::new(service.clone(), access.clone());
        let zenoh = match files::zenoh(config, &access)? {
            Some((settings, users)) => {
                watched.extend(users);
                Some(ZenohServer::start(service.clone(), guarded.clone(), door.clone(), settings).await?)
            }
            None => None,
        };
        let reached = zenoh.as_ref().map(ZenohServer::reachable).cloned();
        let (counted, timed) = (service.clone(), tls.clone());
        let outside = OutsideView {
            metrics: Box::new(move || {
                counted.note_metrics();
                timed.iter().for_each(Tls::note_metrics);
                metrics.render()
            }),
            reachable: Box::new(move || reached.as_ref().is_none_or(Reachable::now)),
        };
        let router = routes(config, guarded, &door, outside)?;
        let serve_limits = ServeLimits {
            connections: limits.connections,
            header_timeout: seconds(limits.header_seconds),
            idle_timeout: seconds(limits.idle_seconds),
            requests_per_connection: u32::try_from(limits.requests_per_connection).unwrap_or(u32::MAX),
            clients: Arc::clone(door.connections()),
            grace: config.grace(),
        };
        let watch = Watch::start(watched, reload::LOOK).map_err(AppError::Signal)?;
        let secure = tls.is_some();
        let kind = if bound.administration.is_some() { Listener::Public } else { Listener::Only };
        let administration = bound.administration.map(|taken| {
            Listening::serve(taken, Listener::Administration, router.clone(), serve_limits.clone(), tls.clone())
        });
        let public = Listening::serve(bound.public, kind, router, serve_limits, tls);
        Ok(Self { secure, public, administration, access, door, zenoh, service: ServiceHandle(service), _watch: watch })
    }

    /// Where it listens.
    #[must_use]
    pub fn address(&self) -> SocketAddr {
        self.public.address
    }

    /// Where it listens for administration and metrics, where that is an address of its own.
    #[must_use]
    pub fn administration(&self) -> Option<SocketAddr> {
        self.administration.as_ref().map(|listening| listening.address)
    }

    /// The door that all requests pass.
    #[must_use]
    pub fn door(&self) -> &Door {
        &self.door
    }

    /// Who may come in.
    #[must_use]
    pub fn access(&self) -> &Access {
        &self.access
    }

    fn warn_if_insecure(&self) {
        if self.access.is_insecure() {
            tracing::warn!(
                address = %self.public.address,
                "--insecure: anyone who reaches this server may read and change every map"
            );
        }
    }

    /// Its address as clients write it, without a slash at the end.
    #[must_use]
    pub fn url(&self) -> String {
        format!("{}://{}", if self.secure { "https" } else { "http" }, self.public.address)
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
        let administration = async {
            match self.administration {
                Some(listening) => listening.shutdown().await,
                None => Ok(()),
            }
        };
        let (public, administration) = tokio::join!(self.public.shutdown(), administration);
        if let Some(zenoh) = self.zenoh {
            zenoh.shutdown().await;
        }
        self.service.0.drain().await;
        public.and(administration)
    }
}

/// The routes of REST and gRPC.
fn routes(config: &Config, service: Guarded, door: &Door, outside: OutsideView) -> Result<Router, AppError> {
    let limits = &config.limits;
    let settings = HttpSettings {
        body_bytes: limits.body_bytes,
        config_bytes: limits.config_bytes,
        import_bytes: limits.import_bytes,
        scans_per_stream: limits.scans_per_stream,
    };
    let rest = http::router(service.clone(), settings, door.clone(), outside);
    let settings = GrpcSettings {
        message_bytes: limits.body_bytes,
        import_bytes: limits.import_bytes,
        scans_per_stream: limits.scans_per_stream,
    };
    let rpc = grpc::router(service, settings, door.clone()).map_err(AppError::Reflection)?;
    Ok(telemetry::trace_requests(rest.merge(rpc).layer(http::cors(&config.origins()))))
}

/// The addresses that the settings name, taken. Connections wait there until a server answers them.
#[derive(Debug)]
pub struct Bound {
    public: (TcpListener, SocketAddr),
    administration: Option<(TcpListener, SocketAddr)>,
}

/// Takes the addresses that the settings name.
///
/// # Errors
/// [`AppError::Listen`] when one cannot be listened on.
pub async fn bind(config: &Config) -> Result<Bound, AppError> {
    let public = Listening::bind(config.listen).await?;
    let administration = match config.administration()? {
        Some(address) => Some(Listening::bind(address).await?),
        None => None,
    };
    Ok(Bound { public, administration })
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
