//! Zenoh: queries and acknowledged insertions as queryables, best-effort scans, published changes, a liveliness token.
//! What an operation means is the service's alone.
//!
//! Zenoh calls back on threads of its own, which must not wait. They hand what came to bounded queues; where a queue is
//! full the sender is told that the server is busy.

mod gaps;
mod guard;
#[cfg(fuzzing)]
#[allow(missing_docs, reason = "public for the fuzzer alone")]
pub mod keys;
#[cfg(not(fuzzing))]
mod keys;
mod probe;
mod publish;
mod queries;
mod reply;
mod rivals;
mod rules;
mod scans;
mod settings;
mod users;
#[cfg(test)]
mod zenoh_tests;

use super::access::{Caller, Guarded, OnBehalf, Origin, Peer};
use super::door::Door;
use crate::service::{ErrorKind, MapService, ServiceError, setting};
use ::zenoh::Session;
use ::zenoh::liveliness::LivelinessToken;
use ::zenoh::pubsub::Subscriber;
use ::zenoh::query::{Query, Queryable};
use guard::Guard;
use metrics::{counter, describe_counter};
use queries::Asked;
use reply::{Replies, Reply};
use rivals::Rivals;
use std::sync::Arc;
use std::thread::JoinHandle;
use thiserror::Error;
use tokio::sync::{Semaphore, mpsc};
use tokio_util::task::TaskTracker;

pub use probe::Reachable;
pub use settings::{Mode, ZenohSettings, ZenohTls};
pub use users::{User, parse as parse_users, read as read_users};

/// Queries that wait to be told that the server is busy; those beyond are dropped, and their clients' time runs out.
const REFUSALS: usize = 256;

const QUERIES: &str = "ubbmap_zenoh_queries_total";

/// Tells the recorder what each metric means. Call it once, after the recorder is installed.
pub fn describe_metrics() {
    describe_counter!(QUERIES, "Queries by code of the reply: OK or that of the error; DROPPED got none");
    describe_counter!(
        scans::SCANS,
        "Best-effort scans by outcome: applied, duplicate, refused, dropped, and of these late"
    );
    describe_counter!(scans::MISSING, "Numbers of best-effort scans that had not come when a later one did");
    describe_counter!(publish::PUBLISHED, "Messages of changes published");
}

/// Why the transport does not start.
#[derive(Debug, Error)]
pub enum ZenohError {
    /// The settings are not Zenoh's.
    #[error("the settings of Zenoh are not valid: {0}")]
    Settings(String),
    /// The session does not open.
    #[error("no session of Zenoh: {0}")]
    Session(String),
    /// Another server answers on these keys.
    #[error("another server is on the same keys ({0}): give each its own zenoh.prefix")]
    AnotherServer(String),
    /// The server does not reach itself.
    #[error("the server does not answer {0} over the network")]
    Unreachable(String),
}

/// What every query needs.
struct Context {
    service: Guarded,
    /// Whoever Zenoh's own access control lets in.
    caller: OnBehalf,
    door: Door,
    settings: ZenohSettings,
    rivals: Rivals,
    replies: Replies,
}

/// The running transport.
#[derive(Debug)]
pub struct ZenohServer {
    session: Session,
    id: String,
    locators: Vec<String>,
    reachable: Reachable,
    token: LivelinessToken,
    queryables: [Queryable<()>; 2],
    subscribers: [Subscriber<()>; 2],
    tracker: TaskTracker,
    sending: JoinHandle<()>,
}

/// Where a callback of Zenoh puts a query.
#[derive(Clone)]
struct Inbox {
    queries: mpsc::Sender<Query>,
    insertions: mpsc::Sender<Query>,
    refusals: mpsc::Sender<Query>,
}

impl Inbox {
    /// Takes a query on a thread of Zenoh's.
    fn take(&self, query: Query) {
        let insertion = query.key_expr().as_str().contains("/insert/");
        let queue = if insertion { &self.insertions } else { &self.queries };
        let Err(refused) = queue.try_send(query) else { return };
        let (mpsc::error::TrySendError::Full(query) | mpsc::error::TrySendError::Closed(query)) = refused;
        if self.refusals.try_send(query).is_err() {
            counter!(QUERIES, "code" => "DROPPED").increment(1);
        }
    }
}

impl ZenohServer {
    /// Opens a session, makes sure that no other server is on the same keys, and answers. Returns when the server has
    /// reached itself over the network.
    ///
    /// # Errors
    /// [`ZenohError`]
    pub async fn start(
        service: MapService,
        guarded: Guarded,
        door: Door,
        settings: ZenohSettings,
    ) -> Result<Self, ZenohError> {
        let failed = |error: ::zenoh::Error| ZenohError::Session(error.to_string());
        let prefix = settings.prefix.clone();
        let guard = Guard::new(&settings)?;
        let (config, passwords) = settings::session(&settings, &guard)?;
        let session = ::zenoh::open(config).await.map_err(failed)?;
        drop(passwords);
        rivals::alone(&session, &prefix).await?;
        let id = session.zid().to_string();
        let own = rivals::token(&prefix, &id);
        let rivals = Rivals::new(own.clone());
        let noting = rivals.clone();
        let others = session
            .liveliness()
            .declare_subscriber(rivals::token(&prefix, "*"))
            .history(true)
            .callback(move |sample| noting.note(&sample))
            .await
            .map_err(failed)?;
        let (replies, sending) = Replies::start().map_err(|error| ZenohError::Session(error.to_string()))?;
        let caller = guarded.of(Caller::anyone("zenoh"), Origin::new("zenoh", Peer::default(), None));
        let context = Arc::new(Context { service: guarded, caller, door, settings, rivals, replies });
        let tracker = TaskTracker::new();
        let (inbox, samples) = queues(&context, &tracker);
        let taking = inbox.clone();
        let queries = session
            .declare_queryable(format!("{prefix}/**"))
            .complete(true)
            .callback(move |query| taking.take(query))
            .await
            .map_err(failed)?;
        let health = probe::health(&prefix, &id);
        let asked = session
            .declare_queryable(health.clone())
            .complete(true)
            .callback(move |query| inbox.take(query))
            .await
            .map_err(failed)?;
        let scans = session
            .declare_subscriber(format!("{prefix}/*/scans/*"))
            .callback(move |sample| scans::take(&samples, sample))
            .await
            .map_err(failed)?;
        let token = session.liveliness().declare_token(own).await.map_err(failed)?;
        let mut locators: Vec<String> = session.info().locators().await.iter().map(ToString::to_string).collect();
        let endpoints = asked_endpoints(&context.settings, &locators);
        let reachable = probe::start(&context.settings, &guard, &endpoints, health, context.door.clone()).await?;
        if guard.inner().is_some() {
            // It is nobody's affair.
            locators.retain(|locator| guard::is_tls(locator));
        }
        tokio::spawn(publish::run(session.clone(), service, context.door.clone(), prefix));
        let (queryables, subscribers) = ([queries, asked], [others, scans]);
        Ok(Self { session, id, locators, reachable, token, queryables, subscribers, tracker, sending })
    }

    /// Where it listens.
    #[must_use]
    pub fn locators(&self) -> &[String] {
        &self.locators
    }

    /// Its identity in the network.
    #[must_use]
    pub fn id(&self) -> &str {
        &self.id
    }

    /// Whether it is to be reached.
    #[must_use]
    pub fn reachable(&self) -> &Reachable {
        &self.reachable
    }

    /// Takes nothing new, finishes what was taken, and leaves the network.
    pub async fn shutdown(self) {
        let left = async {
            self.token.undeclare().await?;
            for queryable in self.queryables {
                queryable.undeclare().await?;
            }
            for subscriber in self.subscribers {
                subscriber.undeclare().await?;
            }
            self.tracker.close();
            self.tracker.wait().await;
            // With the last query the replies' thread has got its last one, and ends behind it.
            let sending = self.sending;
            if tokio::task::spawn_blocking(move || sending.join()).await.is_err() {
                tracing::error!("the thread of the replies could not be waited for");
            }
            self.session.close().await
        };
        if let Err(error) = left.await {
            tracing::warn!(%error, "leaving the network of Zenoh failed");
        }
    }
}

/// The queues behind the callbacks, each with its workers.
fn queues(context: &Arc<Context>, tracker: &TaskTracker) -> (Inbox, mpsc::Sender<::zenoh::sample::Sample>) {
    let (queue, in_flight) = (context.settings.queue, context.settings.in_flight);
    let worked = || {
        let (sender, receiver) = mpsc::channel(queue);
        tracker.spawn(work(receiver, Arc::clone(context), places(in_flight), tracker.clone()));
        sender
    };
    let (refusals, refused) = mpsc::channel(REFUSALS);
    tracker.spawn(refuse(refused, Arc::clone(context)));
    let inbox = Inbox { queries: worked(), insertions: worked(), refusals };
    let (samples, receiver) = mpsc::channel(queue);
    tracker.spawn(scans::run(receiver, Arc::clone(context), places(in_flight), tracker.clone()));
    (inbox, samples)
}

/// Where the health check connects: as any client would, but not by TLS of our own settings, which is made for others.
fn asked_endpoints(settings: &ZenohSettings, locators: &[String]) -> Vec<String> {
    if locators.is_empty() {
        return settings.connect.clone();
    }
    let plain = |locator: &&String| settings.tls.is_none() || !guard::is_tls(locator);
    locators.iter().filter(plain).cloned().collect()
}

fn places(count: usize) -> Arc<Semaphore> {
    Arc::new(Semaphore::new(count.clamp(1, Semaphore::MAX_PERMITS)))
}

/// Answers the queries of a queue until its callback is gone.
async fn work(mut queue: mpsc::Receiver<Query>, context: Arc<Context>, places: Arc<Semaphore>, tracker: TaskTracker) {
    while let Some(query) = queue.recv().await {
        // The semaphore is never closed.
        let place = Arc::clone(&places).acquire_owned().await.ok();
        let context = Arc::clone(&context);
        tracker.spawn(async move {
            if let Some(answer) = respond(&context, &query).await {
                finish(&context, query, answer).await;
            }
            drop(place);
        });
    }
}

/// Tells those for whom there was no room.
async fn refuse(mut queue: mpsc::Receiver<Query>, context: Arc<Context>) {
    while let Some(query) = queue.recv().await {
        let busy = ServiceError::over(
            ErrorKind::Busy,
            setting::ZENOH_QUEUE,
            "as many queries wait as the server's queue holds: try again",
        );
        finish(&context, query, Err(busy)).await;
    }
}

async fn finish(context: &Context, query: Query, answer: Result<Reply, ServiceError>) {
    let code = answer.as_ref().map_or_else(|error| error.kind.code(), |_| "OK");
    counter!(QUERIES, "code" => code).increment(1);
    context.replies.send(query, answer).await;
}

/// The answer to a query; `None` where it is not meant for this server.
async fn respond(context: &Context, query: &Query) -> Option<Result<Reply, ServiceError>> {
    let Context { caller, door, settings, rivals, .. } = context;
    let key = query.key_expr().as_str();
    if key.ends_with("/health") && key.contains("/@server/") {
        return Some(health(context));
    }
    let target = keys::target(&settings.prefix, key)?;
    if let Some(other) = rivals.any() {
        let detail = format!("another server, {other}, is on the same keys: none of the two answers");
        return Some(Err(ServiceError::new(ErrorKind::AnotherServer, detail)));
    }
    let payload = query.payload().map(|payload| payload.to_bytes()).unwrap_or_default();
    let answer = async {
        let limit = settings.message_bytes;
        if payload.len() > limit {
            let detail = format!("the payload is larger than {limit} bytes, the limit: send less at a time");
            return Err(ServiceError::over(ErrorKind::BodyTooLarge, setting::BODY_BYTES, detail).at("body"));
        }
        let asked = Asked { target: target?, parameters: query.parameters().as_str(), payload: &payload };
        door.timed(queries::answer(caller, asked)).await?
    };
    Some(answer.await)
}

fn health(context: &Context) -> Result<Reply, ServiceError> {
    if context.door.is_draining() {
        return Err(super::door::ending());
    }
    if !context.service.is_ready() {
        return Err(ServiceError::new(ErrorKind::StoreFailed, ServiceError::NO_MORE_WRITES));
    }
    Ok(Reply::empty())
}
