//! Who may do what over Zenoh: users, certificates, TLS, and what its access control lets pass.

#![allow(clippy::unwrap_used, reason = "a test may end where its ground is not as it should be")]

use crate::grpc_support::ring;
use crate::http_support::Site;
use crate::tls_support::{Leaf, Office, agent, until};
use crate::zenoh_support::{answer, ask, client_config, router};
use prost::Message;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;
use ubbmap::config::{ClientCertificates, Config};
use ubbmap::transport::zenoh::parse_users;
use ubbmap::wire::v1;
use zenoh::Session;

const USERS: &str = r#"
[[user]]
name = "amr-7"
password = "the robot's own words"
role = "write"
maps = ["hall*"]

[[user]]
name = "planner"
password = "only looking, thanks"
role = "read"
maps = ["hall"]

[[user]]
name = "operator"
password = "all doors, please!"
role = "admin"
maps = ["*"]
"#;

fn password(user: &str) -> &'static str {
    match user {
        "amr-7" => "the robot's own words",
        "planner" => "only looking, thanks",
        _ => "all doors, please!",
    }
}

type Opened = Result<Session, zenoh::Error>;

/// A client with more settings.
fn connect(site: &Site, endpoint: &str, more: &[(&str, String)]) -> Opened {
    connect_within(20_000, site, endpoint, more)
}

/// Is a client with these settings kept out? It goes on trying for a while.
fn kept_out(site: &Site, endpoint: &str, more: &[(&str, String)]) -> bool {
    connect_within(3000, site, endpoint, more).is_err()
}

fn connect_within(milliseconds: u32, site: &Site, endpoint: &str, more: &[(&str, String)]) -> Opened {
    let mut config = client_config(endpoint);
    config.insert_json5("connect/timeout_ms", &milliseconds.to_string()).unwrap();
    for (key, value) in more {
        config.insert_json5(key, value).unwrap();
    }
    site.run(async { zenoh::open(config).await })
}

fn login(user: &str, password: &str) -> [(&'static str, String); 2] {
    [("transport/auth/usrpwd/user", format!("{user:?}")), ("transport/auth/usrpwd/password", format!("{password:?}"))]
}

/// A session of one of the users.
fn session(site: &Site, user: &str) -> Session {
    connect(site, &site.endpoint(), &login(user, password(user))).unwrap()
}

/// A server with the users above and the maps `hall` and `yard`.
fn guarded(office: &Office, change: impl FnOnce(&mut Config)) -> Site {
    let users = office.write("users.toml", USERS);
    let site = Site::with(|config| {
        router(config);
        config.zenoh.users = users.to_str().unwrap().to_owned();
        change(config);
    });
    site.make_hall();
    assert_eq!(site.put("/v1/maps/yard", "{\"depth\": 8}").status, 201);
    site
}

fn scans(sequence: u64) -> v1::InsertScansRequest {
    v1::InsertScansRequest { map: String::new(), scans: vec![ring("", Some(sequence))] }
}

/// Nobody answers: what is not allowed is dropped on the way.
fn silent(site: &Site, session: &Session, selector: &str, payload: &[u8]) {
    let asked = async {
        let replies = session.get(selector).payload(payload).timeout(Duration::from_secs(2)).await.unwrap();
        while let Ok(reply) = replies.recv_async().await {
            // What Zenoh itself says when the time is up is no answer of the server.
            if let Ok(sample) = reply.result() {
                panic!("{selector}: {sample:?}");
            }
        }
    };
    site.run(asked);
}

fn robots(site: &Site, map: &str) -> Vec<String> {
    let shown = site.get(&format!("/v1/maps/{map}")).json();
    shown["robots"].as_array().unwrap().iter().map(|robot| robot["robot"].as_str().unwrap().to_owned()).collect()
}

#[test]
fn the_right_user_comes_in_and_nobody_else_does() {
    let office = Office::new();
    let site = guarded(&office, |_| {});
    let planner = session(&site, "planner");
    let hall: v1::GetMapResponse = site.run(answer(&planner, "ubbmap/hall", &v1::GetMapRequest::default()));
    assert_eq!(hall.name, "hall");
    let endpoint = site.endpoint();
    for wrong in [login("planner", "something else"), login("nobody", password("planner")), login("@server", "x")] {
        assert!(kept_out(&site, &endpoint, &wrong), "{wrong:?}");
    }
    assert!(kept_out(&site, &endpoint, &[]));
    // The server's own health check is one of them.
    assert_eq!(site.get("/readyz").status, 200);
}

#[test]
fn a_robot_inserts_as_itself_and_not_as_another() {
    let office = Office::new();
    let site = guarded(&office, |_| {});
    let robot = session(&site, "amr-7");
    let payload = scans(1).encode_to_vec();
    silent(&site, &robot, "ubbmap/hall/insert/amr-8", &payload);
    silent(&site, &robot, "ubbmap/yard/insert/amr-7", &payload);
    silent(&site, &robot, "ubbmap/*/insert/amr-7", &payload);
    site.run(async {
        for key in ["ubbmap/hall/scans/amr-8", "ubbmap/yard/scans/amr-7", "ubbmap/hall/scans/**", "**"] {
            robot.put(key, payload.clone()).await.unwrap();
        }
        robot.put("ubbmap/hall/scans/amr-7", payload.clone()).await.unwrap();
    });
    until("its own best-effort scan", || robots(&site, "hall") == ["amr-7"]);
    let own: v1::InsertScansResponse = site.run(answer(&robot, "ubbmap/hall/insert/amr-7", &scans(2)));
    assert_eq!(own.applied, 1);
    assert_eq!((robots(&site, "hall"), robots(&site, "yard")), (vec!["amr-7".to_owned()], Vec::new()));
    // Nor may it do what its role has not.
    silent(&site, &robot, "ubbmap/hall/delete", b"");
    assert_eq!(site.get("/v1/maps/hall").status, 200);
}

#[test]
fn a_reader_reads_its_maps_and_changes_nothing() {
    let office = Office::new();
    let site = guarded(&office, |_| {});
    let (planner, operator) = (session(&site, "planner"), session(&site, "operator"));
    for refused in ["ubbmap/hall/insert/planner", "ubbmap/hall/insert/amr-7"] {
        silent(&site, &planner, refused, &scans(1).encode_to_vec());
    }
    for refused in [
        "ubbmap/hall/delete",
        "ubbmap/new/create",
        "ubbmap/yard",
        "ubbmap/yard/region",
        "ubbmap/*",
        "ubbmap",
        "ubbmap/**",
    ] {
        silent(&site, &planner, refused, b"");
    }
    for selector in
        ["classes", "region?depth=3", "grid?depth=3", "tiles/0/0/0", "guaranteed-free", "changes?since=0", "robots"]
    {
        // An answer or an error of the server: it got there.
        let told = site.run(ask(&planner, &format!("ubbmap/hall/{selector}"), b""));
        assert!(told.is_some(), "{selector}");
    }
    let seen = Arc::new(AtomicU64::new(0));
    let noting = Arc::clone(&seen);
    let watch = site.run(async {
        let note = move |sample: zenoh::sample::Sample| {
            let change = v1::WatchMapResponse::decode(&*sample.payload().to_bytes()).unwrap();
            noting.store(change.revision, Ordering::SeqCst);
        };
        planner.declare_subscriber("ubbmap/hall/changes").callback(note).await.unwrap()
    });
    let mut sequence = 0;
    until("a change", || {
        sequence += 1;
        let told: v1::InsertScansResponse = site.run(answer(&operator, "ubbmap/hall/insert/amr-9", &scans(sequence)));
        assert_eq!(told.applied, 1);
        seen.load(Ordering::SeqCst) > 0
    });
    drop(watch);
    let list: v1::ListMapsResponse = site.run(answer(&operator, "ubbmap/*", &v1::ListMapsRequest {}));
    assert_eq!(list.maps.len(), 2);
    let made: v1::CreateMapResponse =
        site.run(answer(&operator, "ubbmap/new/create", &v1::CreateMapRequest::default()));
    assert!(!made.existed);
}

#[test]
fn nobody_stands_in_for_the_server() {
    let office = Office::new();
    let site = guarded(&office, |_| {});
    let (forger, planner) = (session(&site, "operator"), session(&site, "planner"));
    let heard = Arc::new(AtomicU64::new(0));
    let noting = Arc::clone(&heard);
    site.run(async {
        let _token = forger.liveliness().declare_token("ubbmap/@server/other").await.unwrap();
        let _answers = forger
            .declare_queryable("ubbmap/hall")
            .callback(|query| {
                let key = query.key_expr().clone();
                zenoh::Wait::wait(query.reply(key, "forged")).unwrap();
            })
            .await
            .unwrap();
        let _heard = planner
            .declare_subscriber("ubbmap/hall/changes")
            .callback(move |_| {
                noting.fetch_add(1, Ordering::SeqCst);
            })
            .await
            .unwrap();
        forger.put("ubbmap/hall/changes", "forged").await.unwrap();
        // Whatever came before this answer on the two connections has arrived.
        for _ in 0..3 {
            let hall: v1::GetMapResponse = answer(&planner, "ubbmap/hall", &v1::GetMapRequest::default()).await;
            assert_eq!(hall.name, "hall");
            let _: v1::GetMapResponse = answer(&forger, "ubbmap/hall", &v1::GetMapRequest::default()).await;
        }
    });
    assert_eq!(heard.load(Ordering::SeqCst), 0);
    assert_eq!(site.get("/readyz").status, 200);
}

#[test]
fn users_that_change_wait_for_a_restart_and_a_metric_says_so() {
    let office = Office::new();
    let site = guarded(&office, |_| {});
    let waiting = |site: &Site| {
        let text = String::from_utf8(site.get("/metrics").body).unwrap();
        let name = "ubbmap_reloads_total{what=\"zenoh users\",outcome=\"failed\"} ";
        text.lines().find_map(|line| line.strip_prefix(name)).unwrap().parse::<u64>().unwrap()
    };
    let before = waiting(&site);
    crate::tls_support::replace(&office.path("users.toml"), &USERS.replace("planner", "watcher"));
    until("the change is noticed", || waiting(&site) > before);
    // Those of the start are still the ones.
    session(&site, "planner");
    assert!(kept_out(&site, &site.endpoint(), &login("watcher", password("planner"))));
}

/// What a client of TLS has: the server's authority, and a certificate of its own.
fn trusting(office: &Office, own: Option<&str>) -> Vec<(&'static str, String)> {
    let path = |name: &str| format!("{:?}", office.text(name));
    let mut settings = vec![("transport/link/tls/root_ca_certificate", path("ca.pem"))];
    if let Some(own) = own {
        settings.extend([
            ("transport/link/tls/enable_mtls", "true".to_owned()),
            ("transport/link/tls/connect_certificate", path(&format!("{own}.pem"))),
            ("transport/link/tls/connect_private_key", path(&format!("{own}.key"))),
        ]);
    }
    settings
}

fn over_tls(config: &mut Config) {
    config.zenoh.listen = "tls/127.0.0.1:0".to_owned();
}

#[test]
fn users_come_in_over_tls_and_not_without_it() {
    let office = Office::new();
    let users = office.write("users.toml", USERS);
    let mut site = Site::with(|config| {
        router(config);
        office.settings(config, ClientCertificates::Off);
        over_tls(config);
        config.zenoh.users = users.to_str().unwrap().to_owned();
    });
    site.agent = agent(&office.ca.pem, None);
    site.make_hall();
    let endpoint = site.endpoint();
    assert!(endpoint.starts_with("tls/"), "{endpoint}");
    let with = |user: &str, word: &str| [&trusting(&office, None)[..], &login(user, word)].concat();
    let robot = connect(&site, &endpoint, &with("amr-7", password("amr-7"))).unwrap();
    let own: v1::InsertScansResponse = site.run(answer(&robot, "ubbmap/hall/insert/amr-7", &scans(1)));
    assert_eq!(own.applied, 1);
    silent(&site, &robot, "ubbmap/hall/insert/amr-8", &scans(1).encode_to_vec());
    assert!(kept_out(&site, &endpoint, &with("amr-7", "something else")));
    // Without TLS, and with an authority that did not sign the server's certificate.
    let plain = endpoint.replace("tls/", "tcp/");
    assert!(kept_out(&site, &plain, &login("amr-7", password("amr-7"))));
    let mut strange = with("amr-7", password("amr-7"));
    strange[0].1 = format!("{:?}", office.text("robots.pem"));
    assert!(kept_out(&site, &endpoint, &strange));
    // The server asks itself how it is by an endpoint of its own, which it tells nobody of.
    assert_eq!(site.server.as_ref().unwrap().zenoh().unwrap().locators().len(), 1);
    assert_eq!(site.get("/readyz").status, 200);
}

#[test]
fn certificates_say_who_comes_by_their_common_names() {
    let office = Office::new();
    for (file, name) in [("robot", "amr-7"), ("operator", "operator"), ("stranger", "stranger")] {
        let pair = office.robots.sign(&Leaf { common: Some(name), ..Leaf::of(&[name]) });
        office.write(&format!("{file}.pem"), &pair.cert);
        office.write(&format!("{file}.key"), &pair.key);
    }
    let entry = |name: &str, role: &str| format!("[[certificate]]\nname = {name:?}\nrole = {role:?}\nmaps = [\"*\"]\n");
    let entries = office.write("access.toml", &[entry("amr-7", "write"), entry("operator", "admin")].concat());
    let site = Site::with(|config| {
        router(config);
        office.settings(config, ClientCertificates::Required);
        config.zenoh.listen = "tls/127.0.0.1:0,tcp/127.0.0.1:0".to_owned();
        config.access.tokens = entries;
    });
    let locators = site.server.as_ref().unwrap().zenoh().unwrap().locators().to_vec();
    let by = |kind: &str| locators.iter().find(|locator| locator.starts_with(kind)).unwrap().clone();
    let (tls, tcp) = (by("tls/"), by("tcp/"));
    let operator = connect(&site, &tls, &trusting(&office, Some("operator"))).unwrap();
    let _: v1::CreateMapResponse = site.run(answer(&operator, "ubbmap/hall/create", &v1::CreateMapRequest::default()));
    let robot = connect(&site, &tls, &trusting(&office, Some("robot"))).unwrap();
    let own: v1::InsertScansResponse = site.run(answer(&robot, "ubbmap/hall/insert/amr-7", &scans(1)));
    assert_eq!(own.applied, 1);
    silent(&site, &robot, "ubbmap/hall/insert/amr-8", &scans(1).encode_to_vec());
    // One whom no entry names comes in and gets nothing; one without a certificate does not come in.
    let stranger = connect(&site, &tls, &trusting(&office, Some("stranger"))).unwrap();
    silent(&site, &stranger, "ubbmap/hall", b"");
    assert!(kept_out(&site, &tls, &trusting(&office, None)));
    // By the endpoint without TLS anybody may ask how the server is, and nothing else.
    let anybody = connect(&site, &tcp, &[]).unwrap();
    silent(&site, &anybody, "ubbmap/hall", b"");
    silent(&site, &anybody, "ubbmap/hall/insert/amr-7", &scans(2).encode_to_vec());
    let health = format!("ubbmap/@server/{}/health", site.server.as_ref().unwrap().zenoh().unwrap().id());
    assert_eq!(site.run(ask(&anybody, &health, b"")), Some(Ok(Vec::new())));
}

#[test]
fn tls_alone_asks_for_nothing_and_hides_what_is_sent() {
    let office = Office::new();
    let mut site = Site::with(|config| {
        router(config);
        office.settings(config, ClientCertificates::Off);
        over_tls(config);
    });
    site.agent = agent(&office.ca.pem, None);
    site.make_hall();
    let session = connect(&site, &site.endpoint(), &trusting(&office, None)).unwrap();
    let own: v1::InsertScansResponse = site.run(answer(&session, "ubbmap/hall/insert/anybody", &scans(1)));
    assert_eq!(own.applied, 1);
    // The router carries what is not the server's as before.
    let other = connect(&site, &site.endpoint(), &trusting(&office, None)).unwrap();
    site.run(async {
        let subscriber = other.declare_subscriber("somewhere/else").await.unwrap();
        loop {
            session.put("somewhere/else", "hello").await.unwrap();
            if let Ok(Ok(sample)) = tokio::time::timeout(Duration::from_millis(200), subscriber.recv_async()).await {
                assert_eq!(&*sample.payload().to_bytes(), b"hello");
                break;
            }
        }
    });
}

#[test]
fn a_file_of_users_is_refused_by_user_and_reason_and_quotes_no_password() {
    let user = |more: &str| {
        format!("[[user]]\nname = \"a\"\npassword = \"Geheimnis1234\"\nrole = \"write\"\nmaps = [\"*\"]\n{more}")
    };
    assert_eq!(parse_users(&user("")).unwrap()[0].grant.robot.as_ref().unwrap().as_str(), "a");
    assert!(parse_users(&user("robot = \"*\"\n")).unwrap()[0].grant.robot.is_none());
    assert!(!format!("{:?}", parse_users(&user("")).unwrap()).contains("Geheimnis"));
    for (text, words) in [
        (String::new(), "names nobody"),
        (user("rule = 1\n"), "unknown field"),
        (user("").replace("password = ", "# "), "missing field"),
        (user("").replace("\"Geheimnis1234\"", "1234567890123"), "line 3"),
        (user("").replace("\"Geheimnis1234\"", "\"Geheimnis1234"), "line 3"),
        (user("").replace("Geheimnis1234", "Geheimnis"), "12 characters"),
        (user("").replace("Geheimnis1234", " Geheimnis1234"), "blank"),
        (user("").replace("\"a\"", "\"a:b\""), "name must be"),
        (user("").replace("\"a\"", "\"@server\""), "name must be"),
        (user("").replace("write", "boss"), "role must be"),
        (user("").replace("[\"*\"]", "[]"), "maps names no map"),
        (user("robot = \"a b\"\n"), "robot"),
        (user("").replace("write", "read") + "robot = \"a\"\n", "not for the role read"),
        (user("") + &user(""), "two users"),
        (user("Geheimnis1234 = 1\n"), "unknown field"),
        (user("").replace("write", "Geheimnis1234"), "role must be"),
    ] {
        let problem = parse_users(&text).unwrap_err();
        assert!(problem.contains(words), "{problem:?} has no {words:?}");
        assert!(!problem.contains("Geheimnis") && !problem.contains("1234567890123"), "{problem}");
    }
}

#[test]
fn a_pipe_or_a_device_for_a_file_of_users_was_read_without_end() {
    let problem = ubbmap::transport::zenoh::read_users(std::path::Path::new("/dev/zero")).unwrap_err();
    assert!(problem.contains("/dev/zero is no file"), "{problem}");
}
