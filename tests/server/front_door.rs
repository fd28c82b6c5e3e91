//! Clients that hold what is others': messages that do not end, answers that are not taken, streams that are not read.

#![allow(clippy::unwrap_used, reason = "a test may end where its ground is not as it should be")]

use crate::access_support::Gate;
use crate::cli_support::until;
use crate::http_support::{Site, ring};
use crate::limits_support::{answers, hits, incoming};
use bytes::Bytes;
use h2::client::{ResponseFuture, SendRequest};
use h2::{RecvStream, SendStream};
use std::io::{Read, Write};
use std::net::TcpStream;
use std::time::{Duration, Instant};
use ubbmap::app::Server;

const REFLECTION: &str = "/grpc.reflection.v1.ServerReflection/ServerReflectionInfo";
const HEALTH: &str = "/grpc.health.v1.Health/Watch";
const MIB: usize = 1 << 20;

/// A connection of HTTP/2 whose window for each answer is so many bytes.
struct Connection {
    client: SendRequest<Bytes>,
    driver: tokio::task::JoinHandle<()>,
}

impl Connection {
    async fn open(address: std::net::SocketAddr, window: u32) -> Self {
        let stream = tokio::net::TcpStream::connect(address).await.unwrap();
        let (client, connection) =
            h2::client::Builder::new().initial_window_size(window).handshake(stream).await.unwrap();
        let driver = tokio::spawn(async move {
            let _ = connection.await;
        });
        Self { client: client.ready().await.unwrap(), driver }
    }

    /// A request whose body is still to be sent.
    async fn ask(&mut self, method: &str, path: &str, token: Option<&str>) -> (ResponseFuture, SendStream<Bytes>) {
        let mut request = axum::http::Request::builder().method(method).uri(format!("http://x{path}"));
        if path.contains(".v1.") {
            request = request.header("content-type", "application/grpc").header("te", "trailers");
        }
        if let Some(token) = token {
            request = request.header("authorization", format!("Bearer {token}"));
        }
        self.client = self.client.clone().ready().await.unwrap();
        self.client.send_request(request.body(()).unwrap(), method == "GET").unwrap()
    }
}

/// The beginning of a message of gRPC: `sent` bytes of `length`.
fn beginning(length: usize, sent: usize) -> Bytes {
    let prefix = [&[0], &u32::try_from(length).unwrap().to_be_bytes()[..]].concat();
    Bytes::from([prefix, vec![7; sent]].concat())
}

/// Sends all that the window takes.
async fn push(stream: &mut SendStream<Bytes>, mut bytes: Bytes) {
    while !bytes.is_empty() {
        stream.reserve_capacity(bytes.len());
        let room = std::future::poll_fn(|context| stream.poll_capacity(context));
        match tokio::time::timeout(Duration::from_millis(200), room).await {
            Ok(Some(Ok(room))) => stream.send_data(bytes.split_to(room.min(bytes.len())), false).unwrap(),
            _ => break,
        }
    }
}

fn server(site: &Site) -> &Server {
    site.server.as_ref().unwrap()
}

#[test]
fn unfinished_messages_to_reflection_held_the_memory_of_insertions() {
    let site = Site::with(|config| {
        config.limits.incoming_bytes = MIB;
        config.limits.body_bytes = MIB;
    });
    site.make_hall();
    let held = site.run(async {
        let mut held = Vec::new();
        for _ in 0..4 {
            let mut connection = Connection::open(server(&site).address(), 65_535).await;
            let (answer, mut body) = connection.ask("POST", REFLECTION, None).await;
            push(&mut body, beginning(900_000, 600_000)).await;
            held.push((connection, answer, body));
        }
        held
    });
    assert_eq!(incoming(&site), 0);
    assert_eq!(site.post("/v1/maps/hall/scans", &ring("r", Some(1)).to_string()).status, 200);
    drop(held);
}

#[test]
fn a_message_that_does_not_end_had_no_time_to_end_in() {
    let site = Site::with(|config| {
        config.limits.incoming_bytes = MIB;
        config.limits.body_bytes = MIB;
        config.limits.request_seconds = 1.5;
    });
    site.make_hall();
    for method in ["GetMap", "StreamScans"] {
        let path = format!("/ubbmap.v1.MapService/{method}");
        let (answer, _body, connection) = site.run(async {
            let mut connection = Connection::open(server(&site).address(), 65_535).await;
            let (answer, mut body) = connection.ask("POST", &path, None).await;
            push(&mut body, beginning(900_000, 60_000)).await;
            (answer, body, connection)
        });
        until("what came is counted", || incoming(&site) > 50_000);
        let mut answer = site.run(answer).unwrap();
        let status = site.run(async {
            // The status is in the head where nothing was answered before, else in the trailers.
            let head = answer.headers().get("grpc-status").cloned();
            while let Some(piece) = answer.body_mut().data().await {
                drop(piece.unwrap());
            }
            head.or(answer.body_mut().trailers().await.unwrap().and_then(|all| all.get("grpc-status").cloned()))
        });
        assert_eq!(status.unwrap(), "4", "{method}: DEADLINE_EXCEEDED");
        until("it is given back", || incoming(&site) == 0);
        drop(connection);
    }
    // So has a line of REST.
    let mut slow = TcpStream::connect(server(&site).address()).unwrap();
    slow.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
    let head = "POST /v1/maps/hall/scans HTTP/1.1\r\nHost: x\r\nContent-Type: application/x-ndjson\r\nAccept: application/x-ndjson\r\n\
        Content-Length: 500000\r\n\r\n    ";
    slow.write_all(head.as_bytes()).unwrap();
    let mut answer = String::new();
    let _ = slow.read_to_string(&mut answer);
    assert!(answer.contains("\"TIMEOUT\"") && answer.contains("did not end within 1.5 s"), "{answer}");
}

#[test]
fn scans_that_only_said_to_be_lines_were_not_counted() {
    let gate = Gate::with(|config| {
        config.limits.incoming_bytes = MIB;
        config.limits.body_bytes = MIB;
    });
    let mut slow = TcpStream::connect(server(&gate.site).address()).unwrap();
    let head = format!(
        "POST /v1/maps/hall/scans HTTP/1.1\r\nHost: x\r\nContent-Type: application/json\r\nAccept: application/x-ndjson\r\n\
         Authorization: Bearer {}\r\nContent-Length: 700000\r\n\r\n",
        gate.token("writer")
    );
    slow.write_all(head.as_bytes()).unwrap();
    slow.write_all("\n".repeat(600_000).as_bytes()).unwrap();
    until("what came is counted", || incoming(&gate.site) >= 600_000);
    drop(slow);
    // Of one who may not send scans nothing is kept, and it sees why it is refused.
    let body = vec![b'\n'; 900_000];
    let refused = gate.send("reader", "POST", "/v1/maps/hall/scans", &body);
    refused.problem(403, "PERMISSION_DENIED");
    until("nothing is held", || incoming(&gate.site) == 0);
}

#[test]
fn what_was_thrown_away_of_a_body_stayed_counted() {
    let gate = Gate::with(|config| {
        config.limits.incoming_bytes = 2 * MIB;
        config.limits.body_bytes = MIB;
    });
    let begin = |token: &str, sent: usize| {
        let mut slow = TcpStream::connect(server(&gate.site).address()).unwrap();
        let head = format!(
            "POST /v1/maps/hall/classes HTTP/1.1\r\nHost: x\r\nContent-Type: application/json\r\nAuthorization: Bearer {token}\r\n\
             Content-Length: 4000000\r\n\r\n"
        );
        slow.write_all(head.as_bytes()).unwrap();
        slow.write_all(&vec![b' '; sent]).unwrap();
        slow
    };
    // One that is too large, and one whose sender is not known: both are read on for a while, so that the answer is seen.
    for (token, sent) in [(gate.token("reader"), 1_500_000), ("nobody", 900_000)] {
        let slow = begin(token, sent);
        std::thread::sleep(Duration::from_millis(300));
        let held = incoming(&gate.site);
        assert!(held < 200_000, "{held}");
        drop(slow);
    }
}

#[test]
fn a_client_of_http_2_that_takes_no_answer_held_the_memory_of_answers() {
    let site = Site::with(|config| {
        config.limits.answer_bytes = 40 * MIB;
        config.limits.idle_seconds = 2.0;
        config.limits.cells_per_answer = 1 << 25;
    });
    assert_eq!(site.put("/v1/maps/wide", r#"{"depth": 12}"#).status, 201);
    let (path, before) = ("/v1/maps/wide/grid", hits(&site, "limits.idle_seconds"));
    let length = site.get(path).body.len();
    let (connection, answer) = site.run(async {
        let mut connection = Connection::open(server(&site).address(), 0).await;
        let (answer, _) = connection.ask("GET", path, None).await;
        (connection, answer.await.unwrap())
    });
    assert_eq!(answer.status(), 200);
    assert!(answers(&site) >= length);
    assert_eq!(site.get(path).status, 429);
    site.run(connection.driver).unwrap();
    assert!(hits(&site, "limits.idle_seconds") > before);
    until("it is given back", || answers(&site) == 0);
    assert_eq!(site.get(path).body.len(), length);
    drop(answer);
}

#[test]
fn a_client_of_http_2_that_takes_its_answer_slowly_is_not_cut_off() {
    let site = Site::with(|config| config.limits.idle_seconds = 4.0);
    assert_eq!(site.put("/v1/maps/wide", r#"{"depth": 10}"#).status, 201);
    let path = "/v1/maps/wide/grid";
    let length = site.get(path).body.len();
    let (taken, time) = site.run(async {
        let mut connection = Connection::open(server(&site).address(), 65_535).await;
        let (answer, _) = connection.ask("GET", path, None).await;
        let mut body: RecvStream = answer.await.unwrap().into_body();
        let (mut taken, begun) = (0, Instant::now());
        while let Some(piece) = body.data().await {
            let piece = piece.unwrap();
            taken += piece.len();
            body.flow_control().release_capacity(piece.len()).unwrap();
            // Longer as a whole than a client may leave it lie, and each piece shorter.
            tokio::time::sleep(Duration::from_millis(100)).await;
        }
        (taken, begun.elapsed())
    });
    assert_eq!(taken, length);
    assert!(time > Duration::from_secs(6), "it was slow: {time:?}");
}

#[test]
fn a_watch_whose_client_does_not_read_outlived_its_token() {
    let gate = Gate::new();
    let token = gate.token("visitor").to_owned();
    let address = server(&gate.site).address();
    let watches = gate.site.run(async {
        let mut connection = Connection::open(address, 0).await;
        let mut watches = Vec::new();
        for _ in 0..5 {
            let (answer, _) = connection.ask("GET", "/v1/maps/hall/events", Some(&token)).await;
            watches.push(answer.await.unwrap());
        }
        (connection, watches)
    });
    assert_eq!(server(&gate.site).door().streams_open(), 5);
    // Changes, so that there is a message that nobody takes.
    for sequence in 0..4 {
        let body = ring("r", Some(sequence)).to_string();
        assert_eq!(gate.send("writer", "POST", "/v1/maps/hall/scans", body.as_bytes()).status, 200);
        std::thread::sleep(Duration::from_millis(50));
    }
    gate.keep(&["reader", "writer", "admin"]);
    until("the watches end with the token", || server(&gate.site).door().streams_open() == 0);
    drop(watches);
}

#[test]
fn a_watch_that_nobody_reads_is_given_up() {
    let site = Site::with(|config| config.limits.idle_seconds = 2.0).with_hall();
    let (connection, _watch) = site.run(async {
        let mut connection = Connection::open(server(&site).address(), 0).await;
        let (answer, _) = connection.ask("GET", "/v1/maps/hall/events", None).await;
        (connection, answer.await.unwrap())
    });
    assert_eq!(server(&site).door().streams_open(), 1);
    site.run(connection.driver).unwrap();
    until("its place is free", || server(&site).door().streams_open() == 0);
}

#[test]
fn an_open_watch_of_the_health_held_up_the_end_of_the_server() {
    let mut site = Site::new();
    let open = site.run(async {
        let mut connection = Connection::open(server(&site).address(), 65_535).await;
        let (health, mut body) = connection.ask("POST", HEALTH, None).await;
        body.send_data(beginning(0, 0), true).unwrap();
        let mut health = health.await.unwrap();
        assert!(health.body_mut().data().await.unwrap().is_ok());
        (connection, health)
    });
    let weak = std::sync::Arc::downgrade(&site.store);
    let begun = Instant::now();
    site.shut_down();
    // The grace is ten seconds.
    assert!(begun.elapsed() < Duration::from_secs(6), "{:?}", begun.elapsed());
    let last = site.run(async move {
        let (_connection, mut health) = open;
        let mut told = Vec::new();
        while let Some(piece) = health.body_mut().data().await {
            told.extend_from_slice(&piece.unwrap());
        }
        let trailers = health.body_mut().trailers().await.unwrap().unwrap();
        assert_eq!(trailers["grpc-status"], "0");
        told
    });
    // A message of two bytes: field 1 is 2, NOT_SERVING.
    assert_eq!(last, [0, 0, 0, 0, 2, 8, 2]);
    assert!(weak.upgrade().is_some(), "the site's own");
}

#[test]
fn a_connection_that_does_not_end_outlived_the_server_and_held_its_store() {
    let mut site = Site::with(|config| config.shutdown.grace_seconds = 1.0);
    let open = site.run(async {
        let mut connection = Connection::open(server(&site).address(), 65_535).await;
        let reflection = connection.ask("POST", REFLECTION, None).await;
        (connection, reflection)
    });
    site.shut_down();
    site.run(open.0.driver).unwrap();
    let store = std::sync::Arc::clone(&site.store);
    until("nobody but the test has the store", || std::sync::Arc::strong_count(&store) == 2);
}

#[test]
fn calls_of_health_and_reflection_have_a_share_of_their_own() {
    let site = Site::with(|config| config.limits.streams_per_client = 3);
    site.make_hall();
    let open = site.run(async {
        let mut connection = Connection::open(server(&site).address(), 65_535).await;
        let mut open = Vec::new();
        for _ in 0..3 {
            let (health, mut body) = connection.ask("POST", HEALTH, None).await;
            body.send_data(beginning(0, 0), true).unwrap();
            open.push(health.await.unwrap());
        }
        let (health, mut body) = connection.ask("POST", HEALTH, None).await;
        body.send_data(beginning(0, 0), true).unwrap();
        let refused = health.await.unwrap();
        assert_eq!(refused.headers()["grpc-status"], "8", "RESOURCE_EXHAUSTED");
        (connection, open)
    });
    assert!(hits(&site, "limits.streams_per_client") >= 1);
    // They took nothing of what the streams of maps may have.
    let (_more, watch) = site.run(async {
        let mut connection = Connection::open(server(&site).address(), 65_535).await;
        let (answer, _) = connection.ask("GET", "/v1/maps/hall/events", None).await;
        (connection, answer.await.unwrap())
    });
    assert_eq!(watch.status(), 200);
    drop(open);
}
