//! Robots that send until they are answered, over every transport, through any number of restarts.

use super::Shared;
use super::ledger::Applied;
use crate::robots::Fleet;
use prost::Message;
use std::time::{Duration, Instant};
use tokio::sync::mpsc;
use tokio_stream::StreamExt;
use tokio_stream::wrappers::ReceiverStream;
use tonic::Streaming;
use tonic::transport::{Channel, Endpoint};
use ubbmap::transport::grpc::generated::map_service_client::MapServiceClient;
use ubbmap::wire::v1;
use zenoh::Session;

/// Scans of one request; a robot with a stream sends as many before it waits.
pub const SCANS: u64 = 8;

/// After how many scans a robot goes on to the next of its buildings.
const STAY: u64 = 150;

/// Buildings of each robot, all its own.
const BUILDINGS: u64 = 4;

/// Places of each building, a little apart: all of it is elsewhere when the robot comes back.
const LAPS: (u64, u64) = (5, 3);

/// After so many steps a robot sees again what it saw.
pub const PERIOD: u64 = STAY * BUILDINGS * LAPS.0 * LAPS.1;

/// From one building to the next, metres: farther than two lasers reach.
const APART: f64 = 80.0;

/// Buildings side by side.
const ACROSS: u64 = 12;

/// How long a robot waits for an answer before it sends again.
const PATIENCE: Duration = Duration::from_secs(20);

/// How a robot sends.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// A stream of gRPC. The robot stands still and sends `SCANS` times what it sees, so the order in which scans that are
    /// under way together are applied does not matter.
    Stream,
    Unary,
    RestJson,
    RestBytes,
    Zenoh,
}

pub const KINDS: [Kind; 8] =
    [Kind::Stream, Kind::Unary, Kind::Zenoh, Kind::RestBytes, Kind::Stream, Kind::Unary, Kind::Zenoh, Kind::RestJson];

impl Kind {
    pub fn of(robot: usize) -> Self {
        KINDS[robot % KINDS.len()]
    }
}

/// What a robot sees at one of its steps.
pub fn scan_of(fleet: &Fleet, robot: usize, step: u64) -> v1::Scan {
    let mut scan = fleet.scan(robot, step);
    let visit = step % PERIOD / STAY;
    let (building, lap) = (robot as u64 * BUILDINGS + visit % BUILDINGS, visit / BUILDINGS);
    let shift = |number: u64, half: f64| (number as f64 - half) * APART;
    let (east, north) = (shift(building % ACROSS, 6.0), shift(building / ACROSS, 4.0));
    // The world changes, so the map does: else every leaf would soon be as free or as occupied as can be.
    let (east, north) = (east + 1.3 * (lap % LAPS.0) as f64, north + 0.9 * (lap % LAPS.1) as f64);
    let moved = |side: Option<v1::Interval>, by: f64| {
        side.map(|side| v1::Interval { min: side.min.map(|min| min + by), max: side.max.map(|max| max + by) })
    };
    if let Some(pose) = scan.pose.as_mut() {
        (pose.x, pose.y) = (moved(pose.x, east), moved(pose.y, north));
    }
    scan.sequence = None;
    scan
}

/// One request's scans by number, and the step that each is of.
fn next(kind: Kind, turn: u64) -> Vec<(u64, u64)> {
    let step = |number| if kind == Kind::Stream { turn } else { number };
    (turn * SCANS..(turn + 1) * SCANS).map(|number| (number, step(number))).collect()
}

/// What became of the scans of a request: the place and revision of those that are in the map, the codes of the others.
#[derive(Debug, Default)]
struct Fates {
    applied: Vec<(usize, u64)>,
    refused: Vec<String>,
}

/// Sends until told to stop, and goes on until the last is acknowledged.
pub async fn drive(shared: Shared, robot: usize, period: Duration) {
    let kind = Kind::of(robot);
    let mut link = Link::new(kind, &shared);
    let mut due = Instant::now() + period.mul_f64(robot as f64 / shared.robots as f64);
    for turn in 0.. {
        if shared.is_over() {
            break;
        }
        tokio::time::sleep_until(due.into()).await;
        // A robot that was held up does not catch up.
        due = (due + period).max(Instant::now());
        let mut left = next(kind, turn);
        let (mut again, begun) = (false, Instant::now());
        shared.ledger.begin(robot);
        loop {
            let scans = left.iter().map(|(number, step)| v1::Scan {
                robot: format!("robot-{robot}"),
                sequence: Some(*number),
                ..scan_of(&shared.fleet, robot, *step)
            });
            match link.send(robot, scans.collect()).await {
                Ok(fates) => {
                    for (at, revision) in &fates.applied {
                        shared.ledger.applied(
                            robot,
                            Applied {
                                revision: u32::try_from(*revision).unwrap(),
                                step: u32::try_from(left[*at].1).unwrap(),
                            },
                        );
                    }
                    let done: Vec<usize> = fates.applied.iter().map(|(at, _)| *at).collect();
                    left = left
                        .into_iter()
                        .enumerate()
                        .filter(|(at, _)| !done.contains(at))
                        .map(|(_, scan)| scan)
                        .collect();
                    for code in fates.refused.iter().filter(|code| *code != "MAP_RESTORED") {
                        shared.trouble(&format!("{kind:?}: {code}"));
                    }
                }
                Err(what) => {
                    shared.trouble(&format!("{kind:?}: {what}"));
                    link.reset();
                }
            }
            if left.is_empty() {
                break;
            }
            again = true;
            tokio::time::sleep(Duration::from_millis(100)).await;
        }
        shared.ledger.end(robot, again);
        if !again {
            shared.acknowledged.record(begun.elapsed());
        }
    }
}

type Client = MapServiceClient<Channel>;

#[expect(clippy::large_enum_variant, reason = "there is one a robot")]
enum Link {
    Stream(Client, Option<(mpsc::Sender<v1::StreamScansRequest>, Streaming<v1::StreamScansResponse>)>),
    Unary(Client),
    Rest { agent: ureq::Agent, url: String, json: bool },
    Zenoh { endpoint: String, session: Option<Session>, failures: u32 },
}

/// A client that connects when it is first used, and again when it has lost its connection.
pub fn lazy(url: &str) -> Client {
    let endpoint =
        Endpoint::from_shared(url.to_owned()).unwrap().connect_timeout(Duration::from_secs(5)).timeout(PATIENCE * 2);
    MapServiceClient::new(endpoint.connect_lazy()).max_decoding_message_size(64 << 20)
}

pub fn agent() -> ureq::Agent {
    let config = ureq::Agent::config_builder().http_status_as_error(false).timeout_global(Some(PATIENCE));
    config.build().into()
}

impl Link {
    fn new(kind: Kind, shared: &Shared) -> Self {
        match kind {
            Kind::Stream => Self::Stream(lazy(&shared.url), None),
            Kind::Unary => Self::Unary(lazy(&shared.url)),
            Kind::RestJson | Kind::RestBytes => {
                let url = format!("{}/v1/maps/hall/scans", shared.url);
                Self::Rest { agent: agent(), url, json: kind == Kind::RestJson }
            }
            Kind::Zenoh => Self::Zenoh { endpoint: shared.zenoh.clone(), session: None, failures: 0 },
        }
    }

    /// Forgets what may be broken. A session of Zenoh finds its router again by itself, so it gets its chance.
    fn reset(&mut self) {
        match self {
            Self::Stream(_, stream) => *stream = None,
            Self::Zenoh { session, failures, .. } => {
                *failures += 1;
                if failures.is_multiple_of(5) {
                    *session = None;
                }
            }
            Self::Unary(_) | Self::Rest { .. } => {}
        }
    }

    async fn send(&mut self, robot: usize, scans: Vec<v1::Scan>) -> Result<Fates, String> {
        let count = scans.len();
        let request = v1::InsertScansRequest { map: "hall".to_owned(), scans };
        match self {
            Self::Stream(client, stream) => tokio::time::timeout(PATIENCE, over_stream(client, stream, request))
                .await
                .map_err(|_| "no answer".to_owned())?,
            Self::Unary(client) => {
                let answer = client
                    .insert_scans(request)
                    .await
                    .map_err(|status| format!("{:?} {}", status.code(), status.message()))?;
                fates(&answer.into_inner(), count)
            }
            Self::Rest { agent, url, json } => {
                let (agent, url, json) = (agent.clone(), url.clone(), *json);
                let answer =
                    tokio::task::spawn_blocking(move || over_rest(&agent, &url, json, &request)).await.unwrap()?;
                fates(&answer, count)
            }
            Self::Zenoh { endpoint, session, .. } => {
                if session.is_none() {
                    *session = Some(open(endpoint).await?);
                }
                let session = session.as_ref().ok_or("no session")?;
                let key = format!("ubbmap/hall/insert/robot-{robot}");
                let payload = v1::InsertScansRequest { map: String::new(), ..request }.encode_to_vec();
                let replies =
                    session.get(&key).payload(payload).timeout(PATIENCE).await.map_err(|error| error.to_string())?;
                let reply = replies.recv_async().await.map_err(|_| "no reply".to_owned())?;
                let sample = reply
                    .result()
                    .map_err(|error| String::from_utf8_lossy(&error.payload().to_bytes()).into_owned())?;
                let answer = v1::InsertScansResponse::decode(&*sample.payload().to_bytes())
                    .map_err(|error| error.to_string())?;
                fates(&answer, count)
            }
        }
    }
}

/// What an answer says of each scan; an error where its numbers do not add up.
fn fates(answer: &v1::InsertScansResponse, count: usize) -> Result<Fates, String> {
    let refused: Vec<usize> = answer.rejected.iter().map(|one| one.index as usize).collect();
    let applied: Vec<(usize, u64)> =
        (0..count).filter(|at| !refused.contains(at)).map(|at| (at, answer.revision)).collect();
    if (answer.applied + answer.duplicates) as usize != applied.len() {
        return Err(format!("WRONG ANSWER to {count} scans: {answer:?}"));
    }
    Ok(Fates { applied, refused: answer.rejected.iter().map(|one| one.code.clone()).collect() })
}

async fn over_stream(
    client: &mut Client,
    stream: &mut Option<(mpsc::Sender<v1::StreamScansRequest>, Streaming<v1::StreamScansResponse>)>,
    request: v1::InsertScansRequest,
) -> Result<Fates, String> {
    let count = request.scans.len();
    let messages = request.scans.into_iter();
    let messages = messages.map(|scan| v1::StreamScansRequest { map: "hall".to_owned(), scan: Some(scan) });
    if let Some((sender, _)) = stream {
        for message in messages {
            sender.send(message).await.map_err(|_| "the stream is closed".to_owned())?;
        }
    } else {
        // The server answers when it has the first message.
        let (sender, receiver) = mpsc::channel(SCANS as usize);
        for message in messages {
            sender.send(message).await.map_err(|_| "no room".to_owned())?;
        }
        let answers = client.stream_scans(ReceiverStream::new(receiver)).await;
        let answers = answers.map_err(|status| format!("{:?} {}", status.code(), status.message()))?;
        *stream = Some((sender, answers.into_inner()));
    }
    let (_, answers) = stream.as_mut().ok_or("no stream")?;
    let mut fates = Fates::default();
    for at in 0..count {
        let answer = answers.next().await.ok_or("the stream ended")?;
        let answer = answer.map_err(|status| format!("{:?} {}", status.code(), status.message()))?;
        match answer.rejected {
            Some(rejected) => fates.refused.push(rejected.code),
            None => fates.applied.push((at, answer.revision)),
        }
    }
    Ok(fates)
}

fn over_rest(
    agent: &ureq::Agent,
    url: &str,
    json: bool,
    request: &v1::InsertScansRequest,
) -> Result<v1::InsertScansResponse, String> {
    let (kind, body) = if json {
        ("application/json", as_json(request)?)
    } else {
        ("application/x-protobuf", request.encode_to_vec())
    };
    let sent = agent.post(url).header("content-type", kind).header("accept", kind).send(&body);
    let mut answer = sent.map_err(|error| error.to_string())?;
    let bytes = answer.body_mut().read_to_vec().map_err(|error| error.to_string())?;
    if !answer.status().is_success() {
        return Err(format!("{} {}", answer.status(), String::from_utf8_lossy(&bytes)));
    }
    if json {
        serde_json::from_slice(&bytes).map_err(|error| error.to_string())
    } else {
        v1::InsertScansResponse::decode(&*bytes).map_err(|error| error.to_string())
    }
}

async fn open(endpoint: &str) -> Result<Session, String> {
    let mut config = zenoh::Config::default();
    config.insert_json5("mode", "\"client\"").unwrap();
    config.insert_json5("connect/endpoints", &format!("[{endpoint:?}]")).unwrap();
    config.insert_json5("scouting/multicast/enabled", "false").unwrap();
    zenoh::open(config).await.map_err(|error| error.to_string())
}

/// With the words that JSON has not for ranges that are no numbers.
fn as_json(request: &v1::InsertScansRequest) -> Result<Vec<u8>, String> {
    let mut message = serde_json::to_value(request).map_err(|error| error.to_string())?;
    for (at, scan) in request.scans.iter().enumerate() {
        let range = |range: &f32| match range {
            range if range.is_nan() => "NaN".into(),
            range if range.is_infinite() => if *range > 0.0 { "Infinity" } else { "-Infinity" }.into(),
            range => serde_json::Value::from(*range),
        };
        message["scans"][at]["ranges"] = scan.ranges.iter().map(range).collect();
    }
    Ok(message.to_string().into_bytes())
}
