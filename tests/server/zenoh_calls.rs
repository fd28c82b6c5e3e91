//! Zenoh: queries, acknowledged and best-effort scans, changes, liveliness, and what goes wrong.

#![allow(clippy::unwrap_used, reason = "a test may end where its ground is not as it should be")]

use crate::grpc_support::ring;
use crate::http_support::Site;
use crate::service_support::map_name;
use crate::zenoh_support::{answer, ask, client_config, open, refusal, router};
use prost::Message;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;
use ubbmap::app::{AppError, Server};
use ubbmap::config::{Config, ZenohMode};
use ubbmap::store::MemoryStore;
use ubbmap::transport::zenoh::ZenohError;
use ubbmap::wire::v1;

fn scans(sequences: impl IntoIterator<Item = u64>) -> v1::InsertScansRequest {
    let scan = |sequence: u64| {
        let mut scan = ring("", Some(sequence));
        let place = 0.05 * (sequence % 100) as f64;
        scan.pose.as_mut().unwrap().x = Some(v1::Interval { min: Some(place), max: Some(place) });
        scan
    };
    v1::InsertScansRequest { map: String::new(), scans: sequences.into_iter().map(scan).collect() }
}

/// Waits until a robot of the hall has so many scans applied; it must within some seconds.
fn until_applied(site: &Site, applied: &str) {
    for _ in 0..1000 {
        if site.get("/v1/maps/hall").json()["robots"][0]["applied"] == applied {
            return;
        }
        std::thread::sleep(Duration::from_millis(10));
    }
    panic!("never {applied}: {}", site.get("/v1/maps/hall").json()["robots"]);
}

fn metric(site: &Site, name: &str) -> u64 {
    let text = String::from_utf8(site.get("/metrics").body).unwrap();
    let line = text.lines().find_map(|line| line.strip_prefix(&format!("{name} "))).unwrap_or("0");
    line.parse().unwrap()
}

#[test]
fn an_acknowledged_scan_is_durable_and_its_robot_is_the_keys() {
    let site = Site::on_zenoh(|_| {});
    let session = site.session();
    site.run(async {
        let key = "ubbmap/hall/insert/amr-7";
        let first: v1::InsertScansResponse = answer(&session, key, &scans(0..3)).await;
        assert_eq!((first.applied, first.duplicates, first.revision), (3, 0, 1));
        assert_eq!(site.store.revision(&map_name("hall")), Some(1));
        let again: v1::InsertScansResponse = answer(&session, key, &scans(1..4)).await;
        assert_eq!((again.applied, again.duplicates), (1, 2));
        // A scan that says another robot's name is not taken for it, and good ones are.
        let mut mixed = scans([7, 8, 9]);
        mixed.scans[0].robot = "amr-8".to_owned();
        mixed.scans[1].robot = "amr-7".to_owned();
        let mixed: v1::InsertScansResponse = answer(&session, key, &mixed).await;
        assert_eq!((mixed.applied, mixed.rejected.len()), (2, 1));
        assert_eq!((mixed.rejected[0].index, mixed.rejected[0].code.as_str()), (0, "INVALID_ROBOT"));
    });
    let robots = site.get("/v1/maps/hall").json()["robots"].clone();
    assert_eq!(robots.as_array().unwrap().len(), 1);
    assert_eq!((&robots[0]["robot"], &robots[0]["highest_sequence"]), (&"amr-7".into(), &"9".into()));
}

#[test]
fn best_effort_scans_are_applied_and_what_did_not_come_is_counted() {
    let site = Site::on_zenoh(|_| {});
    let session = site.session();
    let missing = metric(&site, "ubbmap_zenoh_scans_missing_total");
    site.run(async {
        let key = "ubbmap/hall/scans/amr-7";
        for sequences in [0..2, 2..3, 10..11, 5..6, 20..21] {
            session.put(key, scans(sequences).encode_to_vec()).await.unwrap();
        }
        // Nothing that is no scan of the interface does any harm.
        session.put("ubbmap/hall/scans/amr-7", "nonsense").await.unwrap();
        session.put("ubbmap/nowhere/scans/amr-7", scans(0..1).encode_to_vec()).await.unwrap();
    });
    until_applied(&site, "6");
    // 3 to 9, and 11 to 19.
    assert!(metric(&site, "ubbmap_zenoh_scans_missing_total") >= missing + 16);
}

#[test]
fn what_every_commit_changed_is_published() {
    let site = Site::on_zenoh(|_| {});
    let session = site.session();
    site.run(async {
        let subscriber = session.declare_subscriber("ubbmap/hall/changes").await.unwrap();
        // The subscription takes a moment to reach the server.
        let mut sequence = 0;
        let first = loop {
            let _: v1::InsertScansResponse = answer(&session, "ubbmap/hall/insert/a", &scans([sequence])).await;
            sequence += 1;
            if let Ok(Ok(sample)) = tokio::time::timeout(Duration::from_millis(300), subscriber.recv_async()).await {
                break v1::WatchMapResponse::decode(&*sample.payload().to_bytes()).unwrap();
            }
        };
        let mut last = first;
        for step in sequence..sequence + 10 {
            let inserted: v1::InsertScansResponse = answer(&session, "ubbmap/hall/insert/a", &scans([step])).await;
            let sample = subscriber.recv_async().await.unwrap();
            assert_eq!(sample.encoding().to_string(), "application/protobuf;ubbmap.v1.WatchMapResponse");
            let change = v1::WatchMapResponse::decode(&*sample.payload().to_bytes()).unwrap();
            assert_eq!((change.since, change.revision), (last.revision, inserted.revision));
            assert!(!change.blocks.is_empty());
            let robot = change.robots.first().unwrap();
            assert_eq!((robot.robot.as_str(), robot.sequence, robot.revision), ("a", Some(step), change.revision));
            let selector = format!("ubbmap/hall/changes?since={}", last.revision);
            let told: v1::GetChangesResponse = answer(&session, &selector, &v1::GetMapRequest::default()).await;
            assert_eq!(told.blocks, change.blocks);
            last = change;
        }
    });
}

#[test]
fn a_server_shows_that_it_lives_and_tells_how_it_is() {
    let mut site = Site::on_zenoh(|_| {});
    let session = site.session();
    let id = site.server.as_ref().unwrap().zenoh().unwrap().id().to_owned();
    let token = format!("ubbmap/@server/{id}");
    let seen = |session: &zenoh::Session| {
        site.run(async {
            let replies = session.liveliness().get("ubbmap/@server/*").await.unwrap();
            let mut seen = Vec::new();
            while let Ok(reply) = replies.recv_async().await {
                seen.push(reply.result().unwrap().key_expr().to_string());
            }
            seen
        })
    };
    assert_eq!(seen(&session), std::slice::from_ref(&token));
    assert_eq!(site.run(ask(&session, &format!("{token}/health"), b"")), Some(Ok(Vec::new())));
    site.store.set_writes(crate::service_support::Writes::FailStop);
    let sick = site.run(refusal(&session, &format!("{token}/health"), b""));
    assert_eq!((sick.code.as_str(), sick.advice()), ("STORE_FAILED", v1::Advice::Failed));
    site.store.set_writes(crate::service_support::Writes::Work);
    assert_eq!(site.get("/readyz").status, 200);
    site.shut_down();
}

#[test]
fn full_queues_answer_busy_and_lose_nothing_that_was_taken() {
    let site = Site::on_zenoh(|config| {
        config.zenoh.queue = 2;
        config.zenoh.in_flight = 1;
    });
    let session = site.session();
    site.store.hold();
    let (done, busy) = site.run(async {
        let asking: Vec<_> = (0..12)
            .map(|sequence| {
                let session = session.clone();
                tokio::spawn(async move {
                    ask(&session, "ubbmap/hall/insert/a", &scans([sequence]).encode_to_vec()).await.unwrap()
                })
            })
            .collect();
        while site.store.waiting.load(Ordering::SeqCst) == 0 {
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
        // Queries have a queue of their own.
        let _: v1::ListMapsResponse = answer(&session, "ubbmap/*", &v1::ListMapsRequest {}).await;
        tokio::time::sleep(Duration::from_millis(300)).await;
        site.store.release();
        let (mut done, mut busy) = (0, 0);
        for task in asking {
            match task.await.unwrap() {
                Ok(_) => done += 1,
                Err(error) => {
                    assert_eq!((error.code.as_str(), error.advice()), ("BUSY", v1::Advice::Retry));
                    assert_eq!(error.retry_after, Some(1));
                    busy += 1;
                }
            }
        }
        (done, busy)
    });
    assert!(busy > 0 && done >= 2, "{done} done, {busy} busy");
    until_applied(&site, &done.to_string());
}

#[test]
fn what_is_no_query_of_the_interface_is_refused_by_name() {
    let site = Site::on_zenoh(|config| config.limits.body_bytes = 50_000);
    let session = site.session();
    site.run(async {
        for (selector, payload, code, field) in [
            ("ubbmap/hall/nothing", &b""[..], "ROUTE_NOT_FOUND", None),
            ("ubbmap/Hall", b"", "INVALID_NAME", Some("map")),
            ("ubbmap/hall?colour=red", b"", "INVALID_REQUEST", Some("colour")),
            ("ubbmap/hall/region?min_x=left", b"", "INVALID_REQUEST", Some("min_x")),
            ("ubbmap/hall/region?depth=1;depth=2", b"", "INVALID_REQUEST", Some("depth")),
            ("ubbmap/hall/tiles/1/x/0", b"", "INVALID_REQUEST", Some("x")),
            ("ubbmap/hall/classes", &[0x0a, 0x7f], "INVALID_REQUEST", None),
            ("ubbmap/hall", &[0x0a, 2, b'n', b'o'], "INVALID_REQUEST", Some("map")),
            ("ubbmap/hall/insert/a", &[0; 60_000], "BODY_TOO_LARGE", Some("body")),
        ] {
            let error = refusal(&session, selector, payload).await;
            assert_eq!((error.code.as_str(), error.field.as_deref()), (code, field), "{selector}");
        }
        // A question to all the world is not one to this server.
        assert!(ask(&session, "**", b"").await.is_none());
        // Parameters of a URL are understood, and those that are Zenoh's own are passed over.
        let depth: v1::GetRegionResponse =
            answer(&session, "ubbmap/hall/region?min_x=0&depth=3;_time=[now()]", &v1::GetMapRequest::default()).await;
        assert_eq!(depth.depth, 3);
    });
    assert_eq!(site.get("/v1/maps/hall").json()["revision"], "0");
}

#[test]
fn clients_of_a_server_that_is_restarted_go_on_and_nothing_is_applied_twice() {
    let mut site = Site::on_zenoh(|_| {});
    let endpoint = site.endpoint();
    let session = site.session();
    let stop = Arc::new(std::sync::atomic::AtomicBool::new(false));
    let (robot, stopping) = (session.clone(), Arc::clone(&stop));
    // A robot that sends each scan until it is acknowledged.
    let client = site.runtime.spawn(async move {
        let (mut sequence, mut unanswered) = (0, 0);
        while !stopping.load(Ordering::SeqCst) || sequence < 50 {
            let request = v1::InsertScansRequest { map: "hall".to_owned(), ..scans([sequence]) };
            let replies = robot
                .get("ubbmap/hall/insert/a")
                .payload(request.encode_to_vec())
                .timeout(Duration::from_millis(500))
                .await
                .unwrap();
            match replies.recv_async().await.map(zenoh::query::Reply::into_result) {
                Ok(Ok(sample)) => {
                    let answer = v1::InsertScansResponse::decode(&*sample.payload().to_bytes()).unwrap();
                    assert_eq!(answer.applied + answer.duplicates, 1);
                    sequence += 1;
                }
                Ok(Err(_)) | Err(_) => {
                    unanswered += 1;
                    tokio::time::sleep(Duration::from_millis(20)).await;
                }
            }
        }
        (sequence, unanswered)
    });
    for _ in 0..2 {
        let before = site.store.commits().len();
        while site.store.commits().len() < before + 20 {
            std::thread::sleep(Duration::from_millis(5));
        }
        site.shut_down();
        let mut config = Config { listen: "127.0.0.1:0".parse().unwrap(), ..Config::default() };
        router(&mut config);
        config.zenoh.listen.clone_from(&endpoint);
        std::thread::sleep(Duration::from_millis(300));
        let store = Arc::clone(&site.store) as Arc<dyn ubbmap::store::MapStore>;
        site.server = Some(site.run(Server::start(&config, store)).unwrap());
    }
    let before = site.store.commits().len();
    while site.store.commits().len() < before + 20 {
        std::thread::sleep(Duration::from_millis(5));
    }
    stop.store(true, Ordering::SeqCst);
    let (acknowledged, unanswered) = site.run(client).unwrap();
    assert!(unanswered > 0, "the restart was not noticed");
    let map: v1::GetMapResponse = site.run(answer(&session, "ubbmap/hall", &v1::GetMapRequest::default()));
    // Every number was acknowledged once and applied once: the map changed as often as that.
    assert_eq!((map.robots[0].applied, map.robots[0].highest_sequence), (acknowledged, Some(acknowledged - 1)));
    assert_eq!(map.revision, acknowledged);
}

#[test]
fn a_second_server_on_the_same_keys_does_not_start() {
    let site = Site::on_zenoh(|_| {});
    let mut config = Config { listen: "127.0.0.1:0".parse().unwrap(), ..Config::default() };
    config.zenoh.mode = ZenohMode::Client;
    config.zenoh.connect = site.endpoint();
    let error = site.run(Server::start(&config, Arc::new(MemoryStore::new()))).unwrap_err();
    assert!(matches!(error, AppError::Zenoh(ZenohError::AnotherServer(_))), "{error}");
    assert!(error.to_string().contains("zenoh.prefix"), "{error}");
    // Told apart by a prefix, both are there.
    config.zenoh.prefix = "second".to_owned();
    let second = site.run(Server::start(&config, Arc::new(MemoryStore::new()))).unwrap();
    let session = site.session();
    site.run(async {
        let request = v1::CreateMapRequest::default();
        let _: v1::CreateMapResponse = answer(&session, "second/yard/create", &request).await;
        let first: v1::ListMapsResponse = answer(&session, "ubbmap", &v1::ListMapsRequest {}).await;
        let other: v1::ListMapsResponse = answer(&session, "second/*", &v1::ListMapsRequest {}).await;
        let names = |list: v1::ListMapsResponse| list.maps.into_iter().map(|map| map.name).collect::<Vec<_>>();
        assert_eq!((names(first), names(other)), (vec!["hall".to_owned()], vec!["yard".to_owned()]));
        second.shutdown().await.unwrap();
    });
}

#[test]
fn servers_that_find_each_other_later_both_stop_answering() {
    let site = Site::on_zenoh(|_| {});
    let session = site.session();
    // What a server of a network that was cut off would show once it is back.
    let other = site.run(open(&site.endpoint()));
    let token = site.run(async { other.liveliness().declare_token("ubbmap/@server/other").await }).unwrap();
    let answers = |wanted: bool| {
        for _ in 0..500 {
            let answer = site.run(ask(&session, "ubbmap/hall", b"")).unwrap();
            if answer.is_ok() == wanted {
                return answer;
            }
            std::thread::sleep(Duration::from_millis(10));
        }
        panic!("never {wanted}");
    };
    let error = answers(false).unwrap_err();
    assert_eq!((error.code.as_str(), error.advice()), ("ANOTHER_SERVER", v1::Advice::Retry));
    let refused = site.run(refusal(&session, "ubbmap/hall/insert/a", &scans([0]).encode_to_vec()));
    assert_eq!(refused.code, "ANOTHER_SERVER");
    assert_eq!(site.get("/v1/maps/hall").json()["revision"], "0");
    site.run(async { token.undeclare().await }).unwrap();
    answers(true).unwrap();
}

#[test]
fn a_server_takes_zenohs_own_settings_for_users_and_keeps_others_out() {
    let folder = tempfile::tempdir().unwrap();
    let users = folder.path().join("users.txt");
    std::fs::write(&users, "server:secret\nrobot:word\n").unwrap();
    let file = folder.path().join("zenoh.json5");
    let auth = format!(
        "{{ transport: {{ auth: {{ usrpwd: {{ user: \"server\", password: \"secret\", dictionary_file: {users:?} }} }} }},\n\
         scouting: {{ multicast: {{ enabled: false }} }} }}"
    );
    std::fs::write(&file, auth).unwrap();
    let site = Site::on_zenoh(|config| config.zenoh.file = file.to_str().unwrap().to_owned());
    let connect = |user: Option<(&str, &str)>| {
        let mut config = client_config(&site.endpoint());
        config.insert_json5("connect/timeout_ms", "1500").unwrap();
        if let Some((user, password)) = user {
            config.insert_json5("transport/auth/usrpwd/user", &format!("{user:?}")).unwrap();
            config.insert_json5("transport/auth/usrpwd/password", &format!("{password:?}")).unwrap();
        }
        site.run(async { zenoh::open(config).await })
    };
    let session = connect(Some(("robot", "word"))).unwrap();
    let _: v1::GetMapResponse = site.run(answer(&session, "ubbmap/hall", &v1::GetMapRequest::default()));
    assert!(connect(Some(("robot", "other"))).is_err());
    assert!(connect(None).is_err());
}
