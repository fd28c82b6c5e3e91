//! Clients that mean no good, over HTTP/1.1 and over connections as such: slow ones, such as go in the middle, such as send
//! without an end, and many that do nothing. Each time the server serves others at once and is none the worse afterwards.

use crate::access_support::Gate;
use crate::hostile_support::{Target, flood, rest};
use crate::http_support::{Site, gzip, ring};
use std::io::{Read, Write};
use std::net::TcpStream;
use std::time::Duration;

fn post(path: &str, length: usize, more: &str) -> String {
    format!(
        "POST {path} HTTP/1.1\r\nHost: x\r\nContent-Type: application/json\r\nContent-Length: {length}\r\n{more}\r\n"
    )
}

/// The head of the next answer.
fn head(stream: &mut TcpStream) -> String {
    let (mut head, mut byte) = (Vec::new(), [0]);
    while !head.ends_with(b"\r\n\r\n") {
        stream
            .read_exact(&mut byte)
            .unwrap_or_else(|error| panic!("{error} after {:?}", String::from_utf8_lossy(&head)));
        head.push(byte[0]);
    }
    let head = String::from_utf8(head).unwrap();
    let length = head.to_lowercase().lines().find_map(|line| line.strip_prefix("content-length: ")?.parse().ok());
    let mut body = vec![0; length.unwrap_or(0)];
    stream.read_exact(&mut body).unwrap();
    head
}

/// More than the buffers of a connection hold, so that it is not sent before somebody reads.
const LONG: usize = 24 << 20;

/// Refused by its head alone, sends all of its body, reads its refusal and goes on with the same connection.
#[track_caller]
fn is_told(mut stream: TcpStream, head_sent: &str, status: &str) {
    stream.write_all(head_sent.as_bytes()).unwrap();
    stream.write_all(&vec![b' '; LONG]).unwrap();
    let answer = head(&mut stream);
    assert!(answer.starts_with(&format!("HTTP/1.1 {status}")), "{answer}");
    stream.write_all(b"GET /healthz HTTP/1.1\r\nHost: x\r\n\r\n").unwrap();
    let answer = head(&mut stream);
    assert!(answer.starts_with("HTTP/1.1 200"), "{answer}");
}

#[test]
fn a_refusal_reaches_a_client_that_is_still_sending() {
    let target = Target::with(&[("LIMITS__BODY_BYTES", "1000000"), ("LIMITS__INCOMING_BYTES", "2000000")]);
    is_told(target.connect(), &post("/v1/maps/hall/classes", LONG, ""), "413");
    is_told(target.connect(), &post("/v1/maps/none/scans", LONG, ""), "4");
    is_told(target.connect(), &post("/nowhere", LONG, ""), "404");
    is_told(target.connect(), &post("/v1/maps", LONG, ""), "405");
    target.is_none_the_worse();
}

#[test]
fn a_refusal_reaches_a_client_that_is_still_sending_and_is_not_known() {
    let gate = Gate::new();
    let stream = TcpStream::connect(gate.site.server.as_ref().unwrap().address()).unwrap();
    is_told(stream, &post("/v1/maps/hall/scans", LONG, ""), "401");
}

#[test]
fn what_comes_after_a_refusal_is_read_for_a_while_and_no_longer() {
    let target = Target::with(&[]);
    let mut endless = target.send(post("/nowhere", usize::MAX / 4, "").as_bytes());
    let most = 200 << 20;
    let taken = flood(&mut endless, &vec![b' '; 1 << 20], most, Duration::from_secs(10));
    assert!(taken < most, "a body without an end is read");
    target.is_none_the_worse();
    // Slowly, too: it is not waited for longer than a body that came at once.
    let mut slow = target.send(post("/nowhere", 1000, "").as_bytes());
    assert!(head(&mut slow).starts_with("HTTP/1.1 404"));
    assert_eq!(rest(slow), b"");
    target.is_none_the_worse();
}

#[test]
fn who_asks_before_sending_is_refused_before_sending() {
    let target = Target::with(&[]);
    // Not told to go on: what is refused is not asked for.
    let mut careful = target.send(post("/nowhere", 5000, "Expect: 100-continue\r\n").as_bytes());
    let answer = head(&mut careful);
    assert!(answer.starts_with("HTTP/1.1 404"), "{answer}");
    target.is_none_the_worse();
}

/// Sends a byte now and then until the server closes; what it said.
fn drip(mut stream: TcpStream, byte: &[u8]) -> String {
    for _ in 0..2000 {
        if stream.write_all(byte).is_err() {
            break;
        }
        std::thread::sleep(Duration::from_millis(10));
        stream.set_nonblocking(true).unwrap();
        let open = matches!(stream.peek(&mut [0]), Err(error) if error.kind() == std::io::ErrorKind::WouldBlock);
        stream.set_nonblocking(false).unwrap();
        if !open {
            break;
        }
    }
    String::from_utf8_lossy(&rest(stream)).into_owned()
}

#[test]
fn a_head_that_comes_byte_by_byte_is_cut_off_by_its_time() {
    let target = Target::with(&[("LIMITS__HEADER_SECONDS", "0.5")]);
    let before = target.hits("limits.header_seconds");
    let slow: Vec<_> = (0..20).map(|_| target.send(b"GET / HTTP/1.1\r\nX: ")).collect();
    assert!(target.is_served());
    std::thread::scope(|scope| slow.into_iter().for_each(|slow| drop(scope.spawn(|| drip(slow, b"a")))));
    assert!(target.hits("limits.header_seconds") >= before + 20.0);
    target.is_none_the_worse();
}

#[test]
fn a_body_that_comes_byte_by_byte_is_cut_off_by_the_time_of_its_request() {
    let target = Target::with(&[("LIMITS__REQUEST_SECONDS", "0.5"), ("LIMITS__REQUESTS", "32")]);
    let slow: Vec<_> = (0..20).map(|_| target.send(post("/v1/maps/hall/classes", 100_000, "").as_bytes())).collect();
    assert!(target.is_served());
    let answers: Vec<String> = std::thread::scope(|scope| {
        let all: Vec<_> = slow.into_iter().map(|slow| scope.spawn(|| drip(slow, b" "))).collect();
        all.into_iter().map(|one| one.join().unwrap()).collect()
    });
    assert!(answers.iter().all(|answer| answer.contains("TIMEOUT")), "{answers:?}");
    target.is_none_the_worse();
}

#[test]
fn a_preface_that_stops_half_way_is_cut_off() {
    let target = Target::with(&[("LIMITS__IDLE_SECONDS", "0.5")]);
    let mut half = target.send(b"PRI * HTTP");
    assert_eq!(half.read(&mut [0; 10]).unwrap_or(0), 0);
    target.is_none_the_worse();
}

#[test]
fn connections_that_are_reset_leave_nothing_behind() {
    let target = Target::with(&[]);
    assert!(target.is_served());
    for _ in 0..20 {
        // In a head, in a body, in the line of a stream, while it waits for an answer, and in a long answer.
        Target::reset(target.send(b"GET /v1/maps HTTP/1.1\r\nHo"));
        let mut body = target.send(post("/v1/maps/hall/scans", 1_000_000, "Expect: 100-continue\r\n").as_bytes());
        assert!(head(&mut body).starts_with("HTTP/1.1 100"));
        body.write_all(&[b' '; 1000]).unwrap();
        Target::reset(body);
        let lines = "POST /v1/maps/hall/scans HTTP/1.1\r\nHost: x\r\nContent-Type: application/x-ndjson\r\n\
            Accept: application/x-ndjson\r\nContent-Length: 5000000\r\n\r\n";
        let scan = ring("r", None).to_string();
        Target::reset(target.send(format!("{lines}{scan}\n{}", &scan[..100]).as_bytes()));
        Target::reset(target.send(format!("{}{scan}", post("/v1/maps/hall/scans", scan.len(), "")).as_bytes()));
        let mut answer = target.send(b"GET /v1/maps/hall/grid?format=json HTTP/1.1\r\nHost: x\r\n\r\n");
        answer.read_exact(&mut [0; 100]).unwrap();
        Target::reset(answer);
        let mut watch =
            target.send(b"GET /v1/maps/hall/events HTTP/1.1\r\nHost: x\r\nAccept: text/event-stream\r\n\r\n");
        watch.read_exact(&mut [0; 100]).unwrap();
        Target::reset(watch);
    }
    target.is_none_the_worse();
}

#[test]
fn bombs_of_gzip_are_refused_and_cost_no_memory() {
    let target = Target::with(&[]);
    assert!(target.is_served());
    let before = target.memory();
    // A thousand times what was sent, and a bomb within a bomb.
    let bomb = gzip(&vec![b' '; 256 << 20]);
    let nested = gzip(&bomb);
    std::thread::scope(|scope| {
        for _ in 0..8 {
            scope.spawn(|| {
                for body in [&bomb, &nested] {
                    let head_sent = post("/v1/maps/hall/scans", body.len(), "Content-Encoding: gzip\r\n");
                    let mut stream = target.send(head_sent.as_bytes());
                    stream.write_all(body).unwrap();
                    let answer = head(&mut stream);
                    assert!(answer.starts_with("HTTP/1.1 4"), "{answer}");
                }
            });
        }
    });
    // Eight bodies of 16 MiB at once, twice, since a buffer that grows is copied.
    let grown = target.memory() - before;
    assert!(grown < f64::from(8 * 3 * (16 << 20)), "{grown} bytes more");
    target.is_none_the_worse();
}

/// `cargo test --release --test server ten_thousand -- --ignored`; needs `ulimit -n 12000`, here and for the server.
#[test]
#[ignore = "needs more open files than some machines allow"]
fn ten_thousand_idle_connections_do_not_keep_a_robot_waiting() {
    const MANY: usize = 10_000;
    let target = Target::with(&[
        ("LIMITS__CONNECTIONS", "11000"),
        ("LIMITS__CONNECTIONS_PER_CLIENT", "11000"),
        ("LIMITS__IDLE_SECONDS", "60"),
        ("LIMITS__HEADER_SECONDS", "60"),
    ]);
    assert!(target.is_served());
    let before = target.memory();
    let mut idle: Vec<TcpStream> = (0..MANY).map(|_| target.connect()).collect();
    // Half of them have asked once, the others never.
    for stream in idle.iter_mut().step_by(2) {
        stream.write_all(b"GET /healthz HTTP/1.1\r\nHost: x\r\n\r\n").unwrap();
        assert!(head(stream).starts_with("HTTP/1.1 200"));
    }
    let begun = std::time::Instant::now();
    assert!((0..100).all(|_| target.is_served()));
    let (took, grown) = (begun.elapsed() / 100, target.memory() - before);
    eprintln!(
        "{} connections, {:.0} MB more, a scan and a question in {took:?}",
        target.metric("ubbmap_connections_open"),
        grown / 1e6
    );
    assert!(target.metric("ubbmap_connections_open") >= MANY as f64);
    // Of each, the stack of its task and the buffer of its reader.
    assert!(grown < MANY as f64 * 24.0 * 1024.0, "{grown} bytes more");
    drop(idle);
    target.is_none_the_worse();
}

#[test]
fn a_flood_of_connections_of_one_client_is_turned_away_and_the_others_stay() {
    let target = Target::with(&[("LIMITS__CONNECTIONS_PER_CLIENT", "20")]);
    assert!(target.is_served());
    let mut flooding: Vec<TcpStream> = (0..400).map(|_| target.connect()).collect();
    // Those beyond the limit and sixteen more are closed at once.
    let closed = flooding.iter_mut().filter_map(|stream| {
        stream.set_read_timeout(Some(Duration::from_millis(20))).unwrap();
        matches!(stream.read(&mut [0]), Ok(0)).then_some(())
    });
    assert!(closed.count() >= 400 - 20 - 16 - 1);
    drop(flooding);
    crate::limits_support::at_last(|| target.is_served());
    target.is_none_the_worse();
}

#[test]
fn a_site_of_the_tests_lets_its_clients_go() {
    // The gauge counts connections of every server of a process.
    let site = Site::new();
    assert_eq!(site.get("/healthz").status, 200);
    let text = String::from_utf8(site.get("/metrics").body).unwrap();
    assert!(text.contains("ubbmap_connections_open "), "{text}");
}
