//! Who is at the other end of a connection, and how much of the server one client may have.

use crate::service::{ServiceError, limit_hit, setting};
use std::collections::HashMap;
use std::net::{IpAddr, Ipv6Addr};
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio::sync::Notify;
use tokio::time::Instant;

/// Connections of one client beyond its limit that are kept as long as it takes to tell it so; more are closed unanswered.
const TOLD: usize = 16;

/// An extension of every request: the client that sent it, and its connection.
#[derive(Debug, Clone)]
pub struct Client {
    address: IpAddr,
    activity: Arc<Activity>,
    /// One connection too many: it is told so, and nothing else.
    refused: bool,
}

impl Client {
    /// Whose share counts: an address of IPv4, and of IPv6 the network of 64 bits, in which a client can be anybody.
    #[must_use]
    pub fn address(&self) -> IpAddr {
        self.address
    }

    /// Is it to be told that it has too many connections?
    #[must_use]
    pub fn is_refused(&self) -> bool {
        self.refused
    }

    /// Counts a request as under way on its connection, until what it gives is dropped.
    #[must_use]
    pub fn begin(&self) -> UnderWay {
        self.activity.under_way.fetch_add(1, Ordering::SeqCst);
        UnderWay { id: self.activity.next.fetch_add(1, Ordering::Relaxed), activity: Arc::clone(&self.activity) }
    }

    /// Waits until an answer on the connection has waited for its client for so long, or at most half as long again: under
    /// HTTP/2 a client can be there, take other answers, and never take one, whatever that holds.
    pub async fn stuck(&self, limit: Duration) {
        loop {
            let now = Instant::now();
            let oldest = self.activity.offered().values().min().copied();
            let over = oldest.map_or(now + limit / 2, |since| since + limit);
            if over <= now {
                limit_hit(setting::IDLE_SECONDS);
                return;
            }
            tokio::time::sleep_until(over.min(now + limit / 2)).await;
        }
    }

    /// Waits until the connection has had no request under way for so long.
    pub async fn idle(&self, limit: Duration) {
        loop {
            let quiet = self.activity.quiet.notified();
            if self.activity.under_way.load(Ordering::SeqCst) > 0 {
                quiet.await;
                continue;
            }
            let over = self.activity.since() + limit;
            if Instant::now() >= over {
                limit_hit(setting::IDLE_SECONDS);
                return;
            }
            tokio::time::sleep_until(over).await;
        }
    }
}

/// What happens on a connection.
#[derive(Debug)]
struct Activity {
    under_way: AtomicUsize,
    /// When the last request was done, or the connection was opened.
    since: Mutex<Instant>,
    quiet: Notify,
    /// The answers of which the client has yet to take something, and since when.
    offered: Mutex<HashMap<u64, Instant>>,
    /// The number of the next request.
    next: AtomicU64,
}

impl Activity {
    fn since(&self) -> Instant {
        *self.since.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn offered(&self) -> MutexGuard<'_, HashMap<u64, Instant>> {
        self.offered.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// One request under way on its connection.
#[derive(Debug)]
pub struct UnderWay {
    id: u64,
    activity: Arc<Activity>,
}

impl UnderWay {
    /// From now on it is the client's turn to take some of the answer.
    pub fn offered(&self) {
        self.activity.offered().insert(self.id, Instant::now());
    }

    /// The client has taken all that there is so far.
    pub fn taken(&self) {
        self.activity.offered().remove(&self.id);
    }
}

impl Drop for UnderWay {
    fn drop(&mut self) {
        self.taken();
        *self.activity.since.lock().unwrap_or_else(PoisonError::into_inner) = Instant::now();
        if self.activity.under_way.fetch_sub(1, Ordering::SeqCst) == 1 {
            self.activity.quiet.notify_one();
        }
    }
}

/// How many of something each client has.
#[derive(Debug)]
pub struct PerClient {
    most: usize,
    counts: Mutex<HashMap<IpAddr, usize>>,
}

/// One of a client's; given back when it is dropped.
#[derive(Debug)]
pub struct Share {
    owner: Arc<PerClient>,
    address: IpAddr,
}

impl PerClient {
    /// At most so many each.
    #[must_use]
    pub fn new(most: usize) -> Arc<Self> {
        Arc::new(Self { most, counts: Mutex::default() })
    }

    /// One more for a client; `None` where it has as many as it may, and so many above.
    #[must_use]
    pub fn take(self: &Arc<Self>, address: IpAddr, above: usize) -> Option<Share> {
        let mut counts = self.lock();
        let count = counts.entry(address).or_insert(0);
        if *count >= self.most.saturating_add(above) {
            return None;
        }
        *count += 1;
        Some(Share { owner: Arc::clone(self), address })
    }

    /// Does the client have more than it may?
    fn over(&self, address: IpAddr) -> bool {
        self.lock().get(&address).is_some_and(|count| *count > self.most)
    }

    /// At most so many each.
    #[must_use]
    pub fn most(&self) -> usize {
        self.most
    }

    fn lock(&self) -> MutexGuard<'_, HashMap<IpAddr, usize>> {
        self.counts.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Drop for Share {
    fn drop(&mut self) {
        let mut counts = self.owner.lock();
        if let Some(count) = counts.get_mut(&self.address) {
            *count -= 1;
            if *count == 0 {
                counts.remove(&self.address);
            }
        }
    }
}

/// A new connection of a client, and its share of the connections. `None`: close it, the client has been told often enough.
#[must_use]
pub fn connected(connections: &Arc<PerClient>, address: IpAddr) -> Option<(Client, Share)> {
    let address = network(address);
    let share = connections.take(address, TOLD);
    let refused = share.is_none() || connections.over(address);
    if refused {
        limit_hit(setting::CONNECTIONS_PER_CLIENT);
    }
    let activity = Activity {
        under_way: AtomicUsize::new(0),
        since: Mutex::new(Instant::now()),
        quiet: Notify::new(),
        offered: Mutex::default(),
        next: AtomicU64::new(0),
    };
    share.map(|share| (Client { address, activity: Arc::new(activity), refused }, share))
}

/// What a client is told on a connection too many.
#[must_use]
pub fn too_many_connections(most: usize) -> ServiceError {
    let detail = format!(
        "this client has more than {most} connections open, the limit: close some, then try again (setting {})",
        setting::CONNECTIONS_PER_CLIENT
    );
    ServiceError::new(crate::service::ErrorKind::Busy, detail)
}

fn network(address: IpAddr) -> IpAddr {
    match address.to_canonical() {
        IpAddr::V6(address) => IpAddr::V6(Ipv6Addr::from_bits(address.to_bits() & !u128::from(u64::MAX))),
        address @ IpAddr::V4(_) => address,
    }
}

#[cfg(test)]
#[path = "client_tests.rs"]
mod tests;
