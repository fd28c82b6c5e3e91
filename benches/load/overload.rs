//! Five times what the server can carry, from many robots of which one sends half of it all: who is answered and who is
//! refused, how fast, how fairly, what reads feel of it, what memory it takes, and how long it lasts when it is over.
//!
//! Robots call `InsertScans` with several scans a request and do not wait for answers, as a fleet does whose clients have no
//! patience. A refused request is not sent again.

use crate::figures::{Latencies, percentile};
use crate::planners;
use crate::robots::Fleet;
use crate::server::{Server, Usage};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};
use std::time::{Duration, Instant};
use tokio::sync::Semaphore;
use tokio::task::JoinSet;
use tonic::Code;
use tonic::transport::Channel;
use ubbmap::transport::grpc::generated::map_service_client::MapServiceClient;
use ubbmap::wire::v1;

type Client = MapServiceClient<Channel>;

/// Scans of one request.
const SCANS: u64 = 20;

/// Requests under way that find the capacity.
const CLOSED: usize = 64;

/// How many times the capacity is offered.
const TIMES: f64 = 5.0;

/// The greedy robot's part of what is offered.
const GREEDY: f64 = 0.5;

/// Requests of one robot without an answer at most; one that would be too many is not sent, and is counted. Their scans have to
/// fit into the robot's window of 1,024 numbers, since they overtake each other.
const WAITING: usize = 40;

/// Planners' tiles a second, and as many guaranteed-free queries.
const QUERIES: f64 = 50.0;

/// How often a robot of its own sends one scan, before, while and after.
const PROBE: Duration = Duration::from_millis(20);

/// What became of one robot's requests.
#[derive(Debug, Default)]
struct Fate {
    answered: AtomicU64,
    refused: AtomicU64,
    unsent: AtomicU64,
}

/// What all robots share.
#[derive(Debug, Default, Clone)]
struct Times {
    answered: Latencies,
    refused: Latencies,
}

/// Runs it and prints its figures.
pub async fn run(robots: usize, seconds: f64, fleet: &Arc<Fleet>) {
    let server = Server::start();
    server.create_map().await;
    let capacity = capacity(&server, fleet, Duration::from_secs_f64(seconds)).await;
    let idle = server.usage().memory_bytes;
    println!("carries {:.0} scans/s in requests of {SCANS}, {CLOSED} under way; {:.0} MB", capacity, idle / 1e6);

    let done = Arc::new(AtomicBool::new(false));
    let (probe, peak) = (Arc::clone(&done), Arc::new(AtomicUsize::new(0)));
    let probing = tokio::spawn(probes(client(&server).await, Arc::clone(fleet), probe));
    let begin = Instant::now() + Duration::from_secs(1);
    let end = begin + Duration::from_secs_f64(seconds);
    let (fates, times) = ((0..robots).map(|_| Arc::new(Fate::default())).collect::<Vec<_>>(), Times::default());
    let mut work = JoinSet::new();
    for (robot, fate) in fates.iter().enumerate() {
        let share = if robot == 0 { GREEDY } else { (1.0 - GREEDY) / (robots - 1) as f64 };
        let rate = capacity * TIMES * share / SCANS as f64;
        let offer = Offer { robot, rate, begin, end };
        work.spawn(offer.send(client(&server).await, Arc::clone(fleet), Arc::clone(fate), times.clone()));
    }
    let (before, own_before) = (server.usage().cpu_seconds, Usage::own().cpu_seconds);
    let asked = planners::Asked::default();
    planners::ask(&server, QUERIES, fleet, &asked, begin, end, &mut work).await;
    while Instant::now() < end {
        peak.fetch_max(server.usage().memory_bytes as usize, Ordering::Relaxed);
        tokio::time::sleep(Duration::from_millis(100)).await;
    }
    let (after, own_after) = (server.usage().cpu_seconds, Usage::own().cpu_seconds);
    tokio::time::sleep(Duration::from_secs(5)).await;
    done.store(true, Ordering::Relaxed);
    let probes = probing.await.unwrap();
    while let Some(ended) = work.join_next().await {
        ended.unwrap();
    }
    tell(&fates, &times, &asked, seconds);
    // Both share the machine: a client that has no processor left sees its own delay in every answer.
    let share = |after: f64, before: f64| 100.0 * (after - before) / (end - begin).as_secs_f64();
    println!("CPU of the server {:.0} %, of the clients {:.0} %", share(after, before), share(own_after, own_before));
    println!(
        "memory at most {:.0} MB, {:.0} MB after",
        peak.load(Ordering::Relaxed) as f64 / 1e6,
        server.usage().memory_bytes / 1e6
    );
    recovery(&probes, begin, end);
    server.stop().await;
}

/// Scans a second that are acknowledged when so many requests are always under way.
async fn capacity(server: &Server, fleet: &Arc<Fleet>, time: Duration) -> f64 {
    let end = Instant::now() + time;
    let applied = Arc::new(AtomicU64::new(0));
    let mut work = JoinSet::new();
    for robot in 0..CLOSED {
        let (mut client, fleet, applied) = (client(server).await, Arc::clone(fleet), Arc::clone(&applied));
        work.spawn(async move {
            for turn in 0.. {
                if Instant::now() >= end {
                    break;
                }
                if let Ok(answer) = client.insert_scans(request(&fleet, robot, turn, SCANS, "closed")).await {
                    applied.fetch_add(answer.into_inner().applied.into(), Ordering::Relaxed);
                }
            }
        });
    }
    while let Some(ended) = work.join_next().await {
        ended.unwrap();
    }
    applied.load(Ordering::Relaxed) as f64 / time.as_secs_f64()
}

async fn client(server: &Server) -> Client {
    MapServiceClient::connect(server.url.clone()).await.unwrap()
}

/// Scans of one robot under names and numbers of their own.
fn request(fleet: &Fleet, robot: usize, turn: u64, scans: u64, name: &str) -> v1::InsertScansRequest {
    let scan = |at| v1::Scan { robot: format!("{name}-{robot}"), ..fleet.scan(robot, turn * scans + at) };
    v1::InsertScansRequest { map: "hall".to_owned(), scans: (0..scans).map(scan).collect() }
}

/// What one robot sends.
struct Offer {
    robot: usize,
    /// Requests a second.
    rate: f64,
    begin: Instant,
    end: Instant,
}

impl Offer {
    async fn send(self, client: Client, fleet: Arc<Fleet>, fate: Arc<Fate>, times: Times) {
        let Self { robot, rate, begin, end } = self;
        let waiting = Arc::new(Semaphore::new(WAITING));
        let period = Duration::from_secs_f64(1.0 / rate);
        let mut due = begin + period.mul_f64(robot as f64 / 100.0);
        for turn in 0.. {
            if due >= end {
                break;
            }
            tokio::time::sleep_until(due.into()).await;
            due += period;
            let Ok(place) = Arc::clone(&waiting).try_acquire_owned() else {
                fate.unsent.fetch_add(1, Ordering::Relaxed);
                continue;
            };
            let (mut client, fate, times) = (client.clone(), Arc::clone(&fate), times.clone());
            let request = request(&fleet, robot, turn, SCANS, "robot");
            tokio::spawn(async move {
                let begun = Instant::now();
                match client.insert_scans(request).await {
                    Ok(answer) => {
                        assert_eq!(u64::from(answer.into_inner().applied), SCANS);
                        times.answered.record(begun.elapsed());
                        fate.answered.fetch_add(1, Ordering::Relaxed);
                    }
                    Err(status) => {
                        assert_eq!(status.code(), Code::ResourceExhausted, "{status:?}");
                        times.refused.record(begun.elapsed());
                        fate.refused.fetch_add(1, Ordering::Relaxed);
                    }
                }
                drop(place);
            });
        }
        drop(waiting.acquire_many(WAITING as u32).await.unwrap());
    }
}

/// When each of a lone robot's scans was sent, and how long its acknowledgement took; none where it was refused.
type Probes = Vec<(Instant, Option<Duration>)>;

async fn probes(client: Client, fleet: Arc<Fleet>, done: Arc<AtomicBool>) -> Probes {
    let (sender, mut receiver) = tokio::sync::mpsc::unbounded_channel();
    for turn in 0.. {
        if done.load(Ordering::Relaxed) {
            break;
        }
        let (mut client, sender, request) = (client.clone(), sender.clone(), request(&fleet, 1, turn, 1, "probe"));
        tokio::spawn(async move {
            let begun = Instant::now();
            let fate = client.insert_scans(request).await.is_ok().then(|| begun.elapsed());
            sender.send((begun, fate)).unwrap();
        });
        tokio::time::sleep(PROBE).await;
    }
    drop(sender);
    let mut all = Vec::new();
    while let Some(probe) = receiver.recv().await {
        all.push(probe);
    }
    all.sort_by_key(|(begun, _)| *begun);
    all
}

fn ms(times: &[f64], share: f64) -> String {
    format!("{:.1} ms", 1000.0 * percentile(times, share))
}

fn tell(fates: &[Arc<Fate>], times: &Times, asked: &planners::Asked, seconds: f64) {
    let (answered, refused) = (times.answered.take(), times.refused.take());
    let unsent: u64 = fates.iter().map(|fate| fate.unsent.load(Ordering::Relaxed)).sum();
    let total = (answered.len() + refused.len()) as f64 + unsent as f64;
    println!(
        "offered {:.0} scans/s, answered {:.0}, refused {:.0}, not sent for want of patience {:.0}",
        total * SCANS as f64 / seconds,
        answered.len() as f64 * SCANS as f64 / seconds,
        refused.len() as f64 * SCANS as f64 / seconds,
        unsent as f64 * SCANS as f64 / seconds,
    );
    println!(
        "answers p50 {} p99 {}; refusals p50 {} p99 {}",
        ms(&answered, 0.5),
        ms(&answered, 0.99),
        ms(&refused, 0.5),
        ms(&refused, 0.99)
    );
    let of = |fate: &Arc<Fate>| fate.answered.load(Ordering::Relaxed) as f64 * SCANS as f64 / seconds;
    let mut others: Vec<f64> = fates[1..].iter().map(of).collect();
    others.sort_by(f64::total_cmp);
    let asked_each = |fate: &Arc<Fate>| {
        let count = |of: &AtomicU64| of.load(Ordering::Relaxed) as f64;
        (count(&fate.answered) + count(&fate.refused) + count(&fate.unsent)) * SCANS as f64 / seconds
    };
    println!(
        "the greedy robot: {:.0} of {:.0} scans/s; the {} others: least {:.0}, median {:.0}, most {:.0} of {:.0} each",
        of(&fates[0]),
        asked_each(&fates[0]),
        others.len(),
        others[0],
        percentile(&others, 0.5),
        others[others.len() - 1],
        asked_each(&fates[1]),
    );
    let (tiles, free) = (asked.tiles.take(), asked.free.take());
    println!(
        "tiles p50 {} p99 {}; guaranteed-free p50 {} p99 {} ({:.0} of {:.0} answered)",
        ms(&tiles, 0.5),
        ms(&tiles, 0.99),
        ms(&free, 0.5),
        ms(&free, 0.99),
        (tiles.len() + free.len()) as f64,
        2.0 * QUERIES * seconds,
    );
}

/// How long after the end until the lone robot is acknowledged as fast as before.
fn recovery(probes: &Probes, begin: Instant, end: Instant) {
    let before: Vec<f64> = {
        let calm = probes.iter().filter(|(at, _)| *at < begin);
        let mut times: Vec<f64> = calm.filter_map(|(_, took)| took.map(|took| took.as_secs_f64())).collect();
        times.sort_by(f64::total_cmp);
        times
    };
    let usual = percentile(&before, 0.99).max(0.01);
    // The first from which on all are as fast.
    let slow = |took: &Option<Duration>| took.is_none_or(|took| took.as_secs_f64() > 2.0 * usual);
    let last = probes.iter().rev().find(|(at, took)| *at >= end && slow(took));
    let recovered = last.map_or(0.0, |(at, took)| (*at - end + took.unwrap_or_default()).as_secs_f64());
    let during = probes.iter().filter(|(at, _)| *at >= begin && *at < end);
    let refused = during.clone().filter(|(_, took)| took.is_none()).count();
    let mut waited: Vec<f64> = during.clone().filter_map(|(_, took)| took.map(|took| took.as_secs_f64())).collect();
    waited.sort_by(f64::total_cmp);
    println!(
        "a lone robot with one scan each {} ms: p99 {} before, p50 {} p99 {} during ({refused} of {} refused), as before {recovered:.2} s after the end",
        PROBE.as_millis(),
        ms(&before, 0.99),
        ms(&waited, 0.5),
        ms(&waited, 0.99),
        during.count(),
    );
}
