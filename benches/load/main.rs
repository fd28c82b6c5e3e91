//! A fleet at full load: robots that send scans and wait for durable acknowledgements, and planners that ask beside them. The
//! server is a process of its own on this machine, its store on this disk.
//!
//! `cargo bench --bench load -- [grpc] [zenoh] [--robots 100] [--rate 5000] [--seconds 10] [--window 32] [--queries 1000]`
//!
//! `cargo bench --bench load -- overload [--robots 40] [--seconds 20]`: five times what it can carry (`overload.rs`).
//!
//! `cargo bench --bench load -- soak [--minutes 60] [--robots 24]`: an hour with restarts, held to its bounds (`soak/mod.rs`).
//!
//! `--rate`: scans a second of all robots together; `--window`: scans of one robot under way at most; `--queries`: tiles, and as
//! many guaranteed-free queries, a second. A scan's latency is from its sending to its acknowledgement, a query's from when it
//! was due to its answer.

#![allow(
    clippy::panic,
    clippy::print_stdout,
    clippy::unwrap_used,
    reason = "a benchmark prints its figures and may end loudly"
)]

mod figures;
mod overload;
mod planners;
mod robots;
mod server;
mod soak;

use figures::{Latencies, percentile};
use robots::Fleet;
use server::{Server, Usage};
use std::sync::Arc;
use std::time::{Duration, Instant};

/// What is sent before the measurement begins.
const WARM_UP: Duration = Duration::from_secs(2);

/// Robots of a soak where their number is not given.
const SOAKED: usize = 24;

/// What is asked for on the command line.
#[derive(Debug, Clone)]
pub struct Options {
    transports: Vec<Transport>,
    robots: usize,
    rate: f64,
    seconds: f64,
    window: usize,
    queries: f64,
    minutes: f64,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Transport {
    Grpc,
    Zenoh,
    /// Not a transport: five times what gRPC carries.
    Overload,
    /// Nor this: an hour at half load.
    Soak,
}

fn options() -> Options {
    let mut options = Options {
        transports: Vec::new(),
        robots: 100,
        rate: 5000.0,
        seconds: 10.0,
        window: 32,
        queries: 1000.0,
        minutes: 60.0,
    };
    let mut words = std::env::args().skip(1);
    while let Some(word) = words.next() {
        let mut number = || words.next().and_then(|text| text.parse::<f64>().ok()).expect("a number after the option");
        match word.as_str() {
            "grpc" => options.transports.push(Transport::Grpc),
            "zenoh" => options.transports.push(Transport::Zenoh),
            "overload" => options.transports.push(Transport::Overload),
            "soak" => {
                options.transports.push(Transport::Soak);
                options.robots = SOAKED;
            }
            "--minutes" => options.minutes = number(),
            "--robots" => options.robots = number() as usize,
            "--rate" => options.rate = number(),
            "--seconds" => options.seconds = number(),
            "--window" => options.window = number() as usize,
            "--queries" => options.queries = number(),
            // What cargo itself adds.
            "--bench" => {}
            other => panic!("unknown option {other}"),
        }
    }
    if options.transports.is_empty() {
        options.transports = vec![Transport::Grpc, Transport::Zenoh];
    }
    options
}

fn main() {
    let options = options();
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build().unwrap();
    if options.transports == [Transport::Soak] {
        return runtime.block_on(soak::run(options.minutes, options.robots));
    }
    let fleet = Arc::new(Fleet::new(options.robots));
    if options.transports == [Transport::Overload] {
        return runtime.block_on(overload::run(options.robots, options.seconds, &fleet));
    }
    println!(
        "{} robots, {:.0} scans/s of 360 beams offered, {} under way a robot; {:.0} tiles/s and {:.0} guaranteed-free/s",
        options.robots, options.rate, options.window, options.queries, options.queries
    );
    println!(
        "{:<6} {:>9} {:>8} {:>8} {:>9} {:>9} {:>9} {:>9} {:>8} {:>8} {:>9}",
        "", "scans/s", "ack p50", "ack p99", "tile p50", "tile p99", "free p50", "free p99", "CPU", "clients", "memory"
    );
    for transport in options.transports.clone() {
        runtime.block_on(async {
            match transport {
                Transport::Overload => overload::run(options.robots, options.seconds, &fleet).await,
                Transport::Soak => soak::run(options.minutes, options.robots).await,
                _ => measure(transport, &options, &fleet).await,
            }
        });
    }
}

async fn measure(transport: Transport, options: &Options, fleet: &Arc<Fleet>) {
    let server = Server::start();
    server.create_map().await;
    let acknowledged = Latencies::default();
    let planners = planners::Asked::default();
    let begin = Instant::now() + Duration::from_millis(500);
    let end = begin + WARM_UP + Duration::from_secs_f64(options.seconds);
    let mut work = tokio::task::JoinSet::new();
    match transport {
        Transport::Grpc => robots::grpc(&server, options, fleet, &acknowledged, begin, end, &mut work).await,
        Transport::Zenoh => robots::zenoh(&server, options, fleet, &acknowledged, begin, end, &mut work).await,
        Transport::Overload | Transport::Soak => return,
    }
    planners::ask(&server, options.queries, fleet, &planners, begin, end, &mut work).await;
    tokio::time::sleep_until((begin + WARM_UP).into()).await;
    acknowledged.forget();
    planners.forget();
    let (before, own_before) = (server.usage(), Usage::own());
    tokio::time::sleep_until(end.into()).await;
    let (after, own_after) = (server.usage(), Usage::own());
    let acks = acknowledged.take();
    let (tiles, free) = (planners.tiles.take(), planners.free.take());
    let seconds = options.seconds;
    while let Some(ended) = work.join_next().await {
        ended.unwrap();
    }
    let name = if transport == Transport::Grpc { "grpc" } else { "zenoh" };
    let ms = |times: &[f64], share: f64| format!("{:.1} ms", 1000.0 * percentile(times, share));
    println!(
        "{name:<6} {:>9.0} {:>8} {:>8} {:>9} {:>9} {:>9} {:>9} {:>7.0}% {:>7.0}% {:>6.0} MB",
        acks.len() as f64 / seconds,
        ms(&acks, 0.5),
        ms(&acks, 0.99),
        ms(&tiles, 0.5),
        ms(&tiles, 0.99),
        ms(&free, 0.5),
        ms(&free, 0.99),
        100.0 * (after.cpu_seconds - before.cpu_seconds) / seconds,
        100.0 * (own_after.cpu_seconds - own_before.cpu_seconds) / seconds,
        after.memory_bytes / 1e6,
    );
    println!(
        "       {:.0} tiles/s and {:.0} guaranteed-free/s answered",
        tiles.len() as f64 / seconds,
        free.len() as f64 / seconds
    );
    server.stop().await;
}
