//! Robots that send numbered scans at a steady rate and wait for their acknowledgements, over gRPC streams and Zenoh.

use crate::Options;
use crate::figures::Latencies;
use crate::server::Server;
use prost::Message;
use std::sync::Arc;
use std::time::{Duration, Instant};
use tokio::sync::{Semaphore, mpsc};
use tokio::task::JoinSet;
use tokio_stream::StreamExt;
use tokio_stream::wrappers::ReceiverStream;
use ubbmap::sensor::Angles;
use ubbmap::simulation::{Fleet as Simulation, SimulatedScan};
use ubbmap::transport::grpc::generated::map_service_client::MapServiceClient;
use ubbmap::wire::v1;
use zenoh::Session;

/// Scans of each robot that are simulated; it sends them over and over, under new numbers.
const SCANS: usize = 40;

/// Robots of one session of Zenoh.
const ROBOTS_PER_SESSION: usize = 10;

/// How long a robot waits for an acknowledgement over Zenoh before it sends again.
const PATIENCE: Duration = Duration::from_secs(10);

/// The scans of all robots.
pub struct Fleet {
    robots: Vec<Vec<v1::Scan>>,
    places: Vec<(f64, f64)>,
}

impl Fleet {
    pub fn new(robots: usize) -> Self {
        Self::with_scans(robots, SCANS)
    }

    /// With so many different scans of each robot.
    pub fn with_scans(robots: usize, count: usize) -> Self {
        let mut simulation = Simulation::new(1, robots);
        let (mut scans, mut places) = (vec![Vec::new(); robots], Vec::new());
        for _ in 0..count {
            for (robot, scan) in simulation.step().into_iter().enumerate() {
                places.push((scan.truth.x, scan.truth.y));
                scans[robot % robots].push(message(&scan));
            }
        }
        Self { robots: scans, places }
    }

    /// Where some robot once was.
    pub fn place(&self, turn: usize) -> (f64, f64) {
        self.places[turn * 31 % self.places.len()]
    }

    /// A robot's scan under a number; robots beyond those of the fleet send what others do.
    pub fn scan(&self, robot: usize, sequence: u64) -> v1::Scan {
        let scans = &self.robots[robot % self.robots.len()];
        v1::Scan { sequence: Some(sequence), ..scans[sequence as usize % scans.len()].clone() }
    }
}

fn message(scan: &SimulatedScan) -> v1::Scan {
    let spec = &scan.scan;
    let interval = |i: ubbmap::interval::Interval| Some(v1::Interval { min: Some(i.lo()), max: Some(i.hi()) });
    let Angles::Uniform { min, increment } = spec.angles else { panic!("the fleet's steps are even") };
    v1::Scan {
        robot: scan.robot.clone(),
        pose: Some(v1::PoseBox {
            x: interval(spec.pose.x()),
            y: interval(spec.pose.y()),
            theta: interval(spec.pose.theta()),
        }),
        angle_min: Some(min),
        angle_increment: Some(increment),
        ranges: spec.ranges.clone(),
        footprint_radius: spec.footprint_radius,
        ..v1::Scan::default()
    }
}

/// When a robot's scans are due.
struct Pace {
    next: Instant,
    period: Duration,
    end: Instant,
}

impl Pace {
    /// The robots begin one after another, so that they do not all send at once.
    fn new(robot: usize, options: &Options, begin: Instant, end: Instant) -> Self {
        let period = Duration::from_secs_f64(options.robots as f64 / options.rate);
        Self { next: begin + period.mul_f64(robot as f64 / options.robots as f64), period, end }
    }

    /// Waits for the next one; false at the end. A robot that was held up for more than a period does not catch up.
    async fn wait(&mut self) -> bool {
        if self.next >= self.end {
            return false;
        }
        tokio::time::sleep_until(self.next.into()).await;
        self.next = (self.next + self.period).max(Instant::now() - self.period);
        true
    }
}

/// One connection and one stream a robot.
pub async fn grpc(
    server: &Server,
    options: &Options,
    fleet: &Arc<Fleet>,
    acknowledged: &Latencies,
    begin: Instant,
    end: Instant,
    work: &mut JoinSet<()>,
) {
    for robot in 0..options.robots {
        let mut client = MapServiceClient::connect(server.url.clone()).await.unwrap();
        let mut pace = Pace::new(robot, options, begin, end);
        let (fleet, acknowledged, window) = (Arc::clone(fleet), acknowledged.clone(), options.window);
        work.spawn(async move {
            let (sender, receiver) = mpsc::channel(window);
            let (sent, mut times) = mpsc::unbounded_channel();
            let places = Arc::new(Semaphore::new(window));
            let free = Arc::clone(&places);
            let send = async move {
                for sequence in 0.. {
                    if !pace.wait().await {
                        break;
                    }
                    places.acquire().await.unwrap().forget();
                    let request =
                        v1::StreamScansRequest { map: "hall".to_owned(), scan: Some(fleet.scan(robot, sequence)) };
                    sent.send(Instant::now()).unwrap();
                    sender.send(request).await.unwrap();
                }
            };
            let receive = async move {
                let mut answers = client.stream_scans(ReceiverStream::new(receiver)).await.unwrap().into_inner();
                while let Some(answer) = answers.next().await {
                    let answer = answer.unwrap();
                    assert!(answer.rejected.is_none() && !answer.duplicate, "{answer:?}");
                    acknowledged.record(times.recv().await.unwrap().elapsed());
                    free.add_permits(1);
                }
            };
            tokio::join!(send, receive);
        });
    }
}

/// One session for some robots; each has so many insertions under way.
pub async fn zenoh(
    server: &Server,
    options: &Options,
    fleet: &Arc<Fleet>,
    acknowledged: &Latencies,
    begin: Instant,
    end: Instant,
    work: &mut JoinSet<()>,
) {
    let mut session = open(server).await;
    for robot in 0..options.robots {
        if robot > 0 && robot % ROBOTS_PER_SESSION == 0 {
            session = open(server).await;
        }
        let mut pace = Pace::new(robot, options, begin, end);
        let (fleet, acknowledged, session) = (Arc::clone(fleet), acknowledged.clone(), session.clone());
        let window = options.window;
        work.spawn(async move {
            let places = Arc::new(Semaphore::new(window));
            for sequence in 0.. {
                if !pace.wait().await {
                    break;
                }
                let place = Arc::clone(&places).acquire_owned().await.unwrap();
                let request = v1::InsertScansRequest { map: String::new(), scans: vec![fleet.scan(robot, sequence)] };
                let (session, acknowledged) = (session.clone(), acknowledged.clone());
                tokio::spawn(async move {
                    let begun = Instant::now();
                    insert(&session, &format!("ubbmap/hall/insert/robot-{robot}"), &request.encode_to_vec()).await;
                    acknowledged.record(begun.elapsed());
                    drop(place);
                });
            }
            drop(places.acquire_many(window as u32).await.unwrap());
        });
    }
}

async fn open(server: &Server) -> Session {
    let mut config = zenoh::Config::default();
    config.insert_json5("mode", "\"client\"").unwrap();
    config.insert_json5("connect/endpoints", &format!("[{:?}]", server.zenoh)).unwrap();
    config.insert_json5("scouting/multicast/enabled", "false").unwrap();
    zenoh::open(config).await.unwrap()
}

/// Sends until it is acknowledged.
async fn insert(session: &Session, key: &str, payload: &[u8]) {
    loop {
        let replies = session.get(key).payload(payload).timeout(PATIENCE).await.unwrap();
        if let Ok(reply) = replies.recv_async().await
            && let Ok(sample) = reply.result()
        {
            let answer = v1::InsertScansResponse::decode(&*sample.payload().to_bytes()).unwrap();
            assert_eq!(answer.applied + answer.duplicates, 1, "{answer:?}");
            return;
        }
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
}
