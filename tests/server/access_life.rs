//! Tokens over their life: read again, changed, revoked, expired; robots, listeners, and what is listed.

#![allow(clippy::unwrap_used, reason = "a test may end where its ground is not as it should be")]

use crate::access_support::{Gate, holder};
use crate::cli_support::until;
use crate::grpc_support::{message, refused};
use crate::http_support::ring;
use std::io::{BufRead, BufReader, Write};
use std::net::TcpStream;
use std::time::{Duration, SystemTime};
use tokio::sync::mpsc;
use tokio_stream::StreamExt;
use tokio_stream::wrappers::ReceiverStream;
use tonic::metadata::MetadataValue;
use tonic::{Code, Request};
use ubbmap::wire::v1;

const SCANS: &str = "/v1/maps/hall/scans";

fn metric(gate: &Gate, start: &str) -> f64 {
    let text = String::from_utf8(gate.send("reader", "GET", "/metrics", b"").body).unwrap();
    let line = text.lines().find(|line| line.starts_with(start));
    line.map_or(0.0, |line| line.rsplit(' ').next().unwrap().parse().unwrap())
}

/// A call of gRPC by a holder.
fn by<T>(gate: &Gate, name: &str, message: T) -> Request<T> {
    let mut request = Request::new(message);
    let value = MetadataValue::try_from(format!("Bearer {}", gate.token(name))).unwrap();
    request.metadata_mut().insert("authorization", value);
    request
}

#[test]
fn lists_hold_the_maps_that_the_token_may_see() {
    let gate = Gate::new();
    let listed = |name: &str| -> Vec<String> {
        let list = gate.send(name, "GET", "/v1/maps", b"").json();
        list["maps"].as_array().unwrap().iter().map(|map| map["name"].as_str().unwrap().to_owned()).collect()
    };
    assert_eq!(listed("reader"), ["attic", "cellar-1", "hall"]);
    assert_eq!(listed("elsewhere"), ["attic", "cellar-1"]);
    assert_eq!(listed("amr-7"), ["hall"]);
    // A map that is not there is refused in the same words: nobody learns which names are taken.
    let told = |map: &str| {
        let (_, detail) =
            gate.send("elsewhere", "GET", &format!("/v1/maps/{map}"), b"").problem(403, "PERMISSION_DENIED");
        detail.replace(map, "")
    };
    assert_eq!(told("hall"), told("nowhere"));
}

#[test]
fn a_token_of_one_robot_sends_its_scans_alone() {
    let gate = Gate::new();
    let send = |scan: serde_json::Value| gate.send("amr-7", "POST", SCANS, scan.to_string().as_bytes());
    assert_eq!(send(ring("amr-7", Some(1))).json()["applied"], 1);
    let (field, detail) = send(ring("amr-8", Some(1))).problem(403, "PERMISSION_DENIED");
    assert_eq!((field.as_str(), detail.contains("\"amr-7\" alone, not of \"amr-8\"")), ("robot", true), "{detail}");
    send(ring("", None)).problem(403, "PERMISSION_DENIED");
    // Nothing of a batch is applied that holds another's.
    let both = serde_json::json!({"scans": [ring("amr-7", Some(2)), ring("amr-8", Some(2))]});
    send(both).problem(403, "PERMISSION_DENIED");
    assert_eq!(gate.send("reader", "GET", "/v1/maps/hall", b"").json()["robots"][0]["applied"], "1");
    let mut client = gate.site.rpc();
    gate.site.run(async {
        let scans = [
            message("hall", crate::grpc_support::ring("amr-7", Some(3))),
            message("hall", crate::grpc_support::ring("amr-8", Some(3))),
        ];
        let mut answers =
            client.stream_scans(by(&gate, "amr-7", tokio_stream::iter(scans))).await.unwrap().into_inner();
        assert_eq!(answers.next().await.unwrap().unwrap().sequence, Some(3));
        refused(answers.next().await.unwrap(), Code::PermissionDenied, "PERMISSION_DENIED");
    });
}

#[test]
fn what_is_shown_and_is_no_good_is_named() {
    let gate = Gate::new();
    let ask = |value: &str| {
        let answer = gate.site.send("GET", "/v1/maps", &[("authorization", value)], b"");
        let told = answer.problem(401, "UNAUTHENTICATED");
        assert_eq!(answer.header("www-authenticate"), Some("Bearer realm=\"ubbmap\", error=\"invalid_token\""));
        assert!(!String::from_utf8_lossy(&answer.body).contains("c2VjcmV0"), "{answer:?}");
        told
    };
    for (value, words) in [
        ("Bearer ubbmap_c2VjcmV0", "not known"),
        ("Basic c2VjcmV0", "\"Bearer ubbmap_...\""),
        ("Bearer", "\"Bearer ubbmap_...\""),
        ("Bearer c2VjcmV0 c2VjcmV0", "\"Bearer ubbmap_...\""),
    ] {
        let (field, detail) = ask(value);
        assert!(field == "authorization" && detail.contains(words), "{value}: {detail}");
    }
    let token = gate.token("reader");
    // Letters of the scheme do not matter; those of the token do, and so does being there once.
    let status = |headers: &[(&str, &str)]| gate.site.send("GET", "/v1/maps", headers, b"").status;
    assert_eq!(status(&[("authorization", &format!("bearer {token}"))]), 200);
    assert_eq!(status(&[("authorization", &format!("Bearer {}", token.to_uppercase()))]), 401);
    let twice = format!("Bearer {token}");
    assert_eq!(status(&[("authorization", &twice), ("authorization", &twice)]), 401);
    // A token in the path would be in the logs of every proxy.
    assert_eq!(gate.site.get(&format!("/v1/maps?access_token={token}")).status, 401);
    assert!(metric(&gate, "ubbmap_access_refused_total{reason=\"unknown\"}") >= 1.0);
}

#[test]
fn a_refused_body_is_not_kept_and_its_sender_reads_why() {
    let gate = Gate::new();
    let body = vec![b' '; 8 << 20];
    for (name, status) in [("", 401), ("late", 401), ("reader", 403)] {
        assert_eq!(gate.send(name, "POST", SCANS, &body).status, status, "{name}");
        assert_eq!(gate.send(name, "PUT", "/v1/maps/new/import", &body).status, status, "{name}");
    }
}

#[test]
fn a_revoked_token_is_refused_and_its_streams_end_while_others_go_on() {
    let gate = Gate::new();
    let mut client = gate.site.rpc();
    let url = gate.site.server.as_ref().unwrap().address();
    let events = |name: &str| {
        let mut stream = TcpStream::connect(url).unwrap();
        stream.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
        let head = format!(
            "GET /v1/maps/hall/events HTTP/1.1\r\nHost: x\r\nAuthorization: Bearer {}\r\n\r\n",
            gate.token(name)
        );
        stream.write_all(head.as_bytes()).unwrap();
        let mut lines = BufReader::new(stream).lines().map_while(Result::ok);
        assert!(lines.next().unwrap().contains("200"));
        lines
    };
    let (mut revoked, mut kept) = (events("visitor"), events("reader"));
    gate.site.run(async {
        let (sender, receiver) = mpsc::channel(4);
        let call = by(&gate, "writer", ReceiverStream::new(receiver));
        let mut answers = client.stream_scans(call).await.unwrap().into_inner();
        let mut watch = client
            .watch_map(by(&gate, "visitor", v1::WatchMapRequest { map: "hall".to_owned(), ..Default::default() }))
            .await
            .unwrap()
            .into_inner();
        sender.send(message("hall", crate::grpc_support::ring("a", Some(1)))).await.unwrap();
        assert_eq!(answers.next().await.unwrap().unwrap().sequence, Some(1));
        assert!(watch.next().await.unwrap().is_ok());

        gate.keep(&["reader", "admin"]);

        let (_, detail) = refused(answers.next().await.unwrap(), Code::Unauthenticated, "UNAUTHENTICATED");
        assert!(detail.contains("\"writer\" was revoked or changed"), "{detail}");
        refused(watch.next().await.unwrap(), Code::Unauthenticated, "UNAUTHENTICATED");
        let again = by(&gate, "writer", v1::GetMapRequest { map: "hall".to_owned() });
        refused(client.get_map(again).await, Code::Unauthenticated, "UNAUTHENTICATED");
    });
    assert!(revoked.any(|line| line.starts_with("data: ") && line.contains("UNAUTHENTICATED")));
    // The entry of this one is as it was: its stream goes on.
    let mut scan = ring("b", Some(1));
    scan["pose"]["x"] = serde_json::json!({"min": 1, "max": 1});
    assert_eq!(gate.send("admin", "POST", SCANS, scan.to_string().as_bytes()).status, 200);
    assert!(kept.any(|line| line == "id: 2"));
}

#[test]
fn a_stream_ends_when_its_token_expires() {
    let gate = Gate::new();
    let mut client = gate.site.rpc();
    // On a machine that is busy the token may have expired before it is shown: then again with more time.
    let told = [2, 10, 60].into_iter().find_map(|seconds| {
        let expiry = SystemTime::now() + Duration::from_secs(seconds);
        let expires = format!("expires = \"{}\"", humantime::format_rfc3339_millis(expiry));
        let brief = holder("brief", "read", "\"*\"", &expires);
        std::fs::write(gate.file(), &brief.entry).unwrap();
        gate.site.server.as_ref().unwrap().access().reload().unwrap();
        gate.site.run(async {
            let mut request = Request::new(v1::WatchMapRequest { map: "hall".to_owned(), ..Default::default() });
            let value = MetadataValue::try_from(format!("Bearer {}", brief.token)).unwrap();
            request.metadata_mut().insert("authorization", value);
            let mut watch = client.watch_map(request).await.ok()?.into_inner();
            loop {
                if let Err(status) = watch.next().await.unwrap() {
                    // The file has the time in whole milliseconds.
                    assert!(SystemTime::now() + Duration::from_millis(1) >= expiry, "before its time");
                    return Some(status);
                }
            }
        })
    });
    let (_, detail) = refused(Err::<(), _>(told.unwrap()), Code::Unauthenticated, "UNAUTHENTICATED");
    assert!(detail.contains("expired at"), "{detail}");
}

#[test]
fn a_broken_file_leaves_the_tokens_as_they_were_and_is_told() {
    let gate = Gate::new();
    let status = |name: &str| gate.send(name, "GET", "/v1/maps", b"").status;
    let whole = std::fs::read_to_string(gate.file()).unwrap();
    let reload = || gate.site.server.as_ref().unwrap().access().reload();
    for (broken, words) in [
        ("[[token]]\nname = ", "line 2"),
        ("[[token]]\nname = \"reader\"", "missing field"),
        ("nonsense", "line 1"),
        ("\u{0}", "line 1"),
    ] {
        std::fs::write(gate.file(), broken).unwrap();
        let problem = reload().unwrap_err();
        assert!(problem.contains("is not valid") && problem.contains(words), "{broken:?}: {problem}");
        assert_eq!((status("reader"), status("writer"), status("late")), (200, 200, 401), "{broken:?}");
    }
    std::fs::remove_file(gate.file()).unwrap();
    assert!(reload().unwrap_err().contains("cannot read"));
    assert_eq!(status("writer"), 200);
    std::fs::write(gate.file(), whole.replace("reader", "lector")).unwrap();
    assert!(reload().unwrap().starts_with("7 entries"));
    assert_eq!((status("reader"), status("writer")), (200, 200));
    let (_, detail) = gate.send("reader", "DELETE", "/v1/maps/hall", b"").problem(403, "PERMISSION_DENIED");
    assert!(detail.starts_with("\"lector\""), "{detail}");
}

#[test]
fn the_file_is_read_again_without_being_told() {
    let gate = Gate::new();
    let kept = &gate.holders.iter().find(|holder| holder.name == "writer").unwrap().entry;
    std::fs::write(gate.file(), kept).unwrap();
    until("the token is refused", || gate.send("reader", "GET", "/v1/maps", b"").status == 401);
    assert_eq!(gate.send("writer", "GET", "/v1/maps", b"").status, 200);
}

#[test]
fn administration_has_an_address_of_its_own_where_it_is_set() {
    let gate = Gate::with(|config| config.admin_listen = "127.0.0.1:0".to_owned());
    let (public, own) = (gate.site.url(), gate.administration());
    assert_ne!(public, own);
    let status =
        |url: &str, name: &str, method: &str, path: &str| gate.send_to(url, name, method, path, &[], b"").status;
    // Metrics are there alone, and ask for nothing.
    assert_eq!(status(&public, "admin", "GET", "/metrics"), 404);
    assert_eq!(status(&own, "", "GET", "/metrics"), 200);
    let answer = gate.send_to(&public, "admin", "DELETE", "/v1/maps/attic", &[], b"");
    let (_, detail) = answer.problem(403, "PERMISSION_DENIED");
    assert!(detail.contains("admin_listen"), "{detail}");
    assert_eq!(status(&own, "", "DELETE", "/v1/maps/attic"), 401);
    assert_eq!(status(&own, "writer", "DELETE", "/v1/maps/attic"), 403);
    assert_eq!(status(&own, "admin", "DELETE", "/v1/maps/attic"), 204);
    for url in [&public, &own] {
        assert_eq!(status(url, "reader", "GET", "/v1/maps/hall"), 200);
        assert_eq!(status(url, "", "GET", "/readyz"), 200);
    }
    let mut client = gate.site.rpc();
    gate.site.run(async {
        let request = by(&gate, "admin", v1::DeleteMapRequest { map: "hall".to_owned() });
        refused(client.delete_map(request).await, Code::PermissionDenied, "PERMISSION_DENIED");
    });
}
