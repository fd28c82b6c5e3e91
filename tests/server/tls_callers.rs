//! Callers by their certificates: whose entry it is, whose scans they send, and until when.

#![allow(clippy::unwrap_used, reason = "a test may end where its ground is not as it should be")]

use crate::grpc_support::refused;
use crate::http_support::{Answer, Site, ring, send};
use crate::tls_support::{Leaf, Office, Pair, agent};
use std::time::{Duration, SystemTime};
use tonic::Code;
use ubbmap::config::{ClientCertificates, Config, ConfigError};
use ubbmap::transport::access::{Caller, Role, Roll};
use ubbmap::transport::tls::{Named, certificates, named};
use ubbmap::wire::v1;

const ENTRIES: &str = r#"
[[certificate]]
name = "operator"
role = "admin"
maps = ["*"]

[[certificate]]
name = "amr-*"
role = "write"
maps = ["hall"]

[[certificate]]
name = "gateway"
role = "write"
maps = ["*"]
robot = "*"
"#;

/// A server that knows callers by the entries above.
fn site(office: &Office, client_auth: ClientCertificates) -> Site {
    let entries = office.write("access.toml", ENTRIES);
    let site = Site::with(|config| {
        office.settings(config, client_auth);
        config.access.tokens = entries;
    });
    let made = call(&site, office, "operator", "PUT", "/v1/maps/hall", "{\"depth\": 8}");
    assert_eq!(made.status, 201, "{}", String::from_utf8_lossy(&made.body));
    site
}

fn robot(office: &Office, name: &'static str) -> Pair {
    office.robots.sign(&Leaf::of(&[name]))
}

fn call(site: &Site, office: &Office, name: &'static str, method: &str, path: &str, body: &str) -> Answer {
    let agent = agent(&office.ca.pem, Some(&robot(office, name)));
    let json = [("content-type", "application/json")];
    send(&agent, method, &format!("{}{path}", site.url()), &json, body.as_bytes())
}

#[test]
fn a_robot_sends_the_scans_of_its_certificates_name_and_no_others() {
    let office = Office::new();
    let site = site(&office, ClientCertificates::Required);
    let scan = |robot: &str| ring(robot, Some(1)).to_string();
    let sent = |name, robot: &str| call(&site, &office, name, "POST", "/v1/maps/hall/scans", &scan(robot));
    assert_eq!(sent("amr-7", "amr-7").json()["applied"], 1);
    let (field, detail) = sent("amr-7", "amr-8").problem(403, "PERMISSION_DENIED");
    assert!(field.contains("robot") && detail.contains("\"amr-7\" sends scans of robot"), "{field} {detail}");
    // A gateway sends for whomever it likes, as it is written.
    assert_eq!(sent("gateway", "amr-8").json()["applied"], 1);
    // What the role does not have stays shut.
    call(&site, &office, "amr-7", "DELETE", "/v1/maps/hall", "").problem(403, "PERMISSION_DENIED");
    let (_, detail) = call(&site, &office, "stranger", "GET", "/v1/maps/hall", "").problem(401, "UNAUTHENTICATED");
    assert!(detail.contains("\"stranger\""), "{detail}");
}

#[test]
fn a_robot_is_known_by_its_certificate_over_grpc_as_well() {
    let office = Office::new();
    let site = site(&office, ClientCertificates::Optional);
    let insert = |own: Option<Pair>, robot: &str| {
        let scan = crate::grpc_support::ring(robot, Some(1));
        let config = office.client(own.as_ref(), &["h2"]);
        site.run(async {
            let mut client = site.rpc_over(config).await.unwrap();
            client.insert_scans(v1::InsertScansRequest { map: "hall".to_owned(), scans: vec![scan] }).await
        })
    };
    assert_eq!(insert(Some(robot(&office, "amr-7")), "amr-7").unwrap().into_inner().applied, 1);
    refused(insert(Some(robot(&office, "amr-7")), "amr-8"), Code::PermissionDenied, "PERMISSION_DENIED");
    // Optional means that a token could be shown instead; nothing at all is not enough.
    refused(insert(None, "amr-7"), Code::Unauthenticated, "UNAUTHENTICATED");
}

#[test]
fn a_token_beside_a_certificate_is_what_counts() {
    let office = Office::new();
    let site = site(&office, ClientCertificates::Required);
    let agent = agent(&office.ca.pem, Some(&robot(&office, "operator")));
    let url = format!("{}/v1/maps", site.url());
    assert_eq!(send(&agent, "GET", &url, &[], b"").status, 200);
    let unknown = [("authorization", "Bearer ubbmap_unknown")];
    send(&agent, "GET", &url, &unknown, b"").problem(401, "UNAUTHENTICATED");
}

#[test]
fn without_entries_a_required_certificate_is_enough_for_everything() {
    let office = Office::new();
    let mut config = Config { listen: "0.0.0.0:0".parse().unwrap(), ..Config::default() };
    office.settings(&mut config, ClientCertificates::Optional);
    assert!(matches!(config.check(), Err(ConfigError::NotLoopback(_))));
    office.settings(&mut config, ClientCertificates::Required);
    config.check().unwrap();
    // Strangers stay out, so it is not open.
    assert!(!config.access().unwrap().is_insecure());
    let site = Site::with(|config| office.settings(config, ClientCertificates::Required));
    assert_eq!(call(&site, &office, "anybody", "PUT", "/v1/maps/yard", "{}").status, 201);
}

/// Who comes in by some entries with a certificate of this name that runs out then.
fn caller(entries: &str, name: &str, until: SystemTime) -> Option<ubbmap::transport::access::Caller> {
    Roll::parse(entries).unwrap().by_certificate(&Named { name: name.into(), until })
}

fn later() -> SystemTime {
    SystemTime::now() + Duration::from_secs(3600)
}

#[test]
fn a_certificate_opens_nothing_after_it_has_run_out() {
    assert!(caller(ENTRIES, "amr-7", later()).unwrap().live().is_ok());
    let late = caller(ENTRIES, "amr-7", SystemTime::now() - Duration::from_secs(1)).unwrap();
    let problem = format!("{:?}", late.live().unwrap_err());
    assert!(problem.contains("expired"), "{problem}");
    // The entry may end it before.
    let entry = format!(
        "{ENTRIES}\n[[certificate]]\nname = \"a\"\nrole = \"read\"\nmaps = [\"*\"]\nexpires = \"2021-01-01T00:00:00Z\"\n"
    );
    assert!(caller(&entry, "a", later()).unwrap().live().is_err());
}

#[test]
fn the_whole_name_goes_before_a_beginning_and_a_long_beginning_before_a_short_one() {
    let entry = |name: &str, role: &str| format!("[[certificate]]\nname = {name:?}\nrole = {role:?}\nmaps = [\"*\"]\n");
    let entries =
        [entry("a*", "read"), entry("amr-*", "write"), entry("amr-7", "admin"), entry("am*", "read")].concat();
    let of = |name: &str| caller(&entries, name, later()).map(|caller| (caller.name().to_owned(), caller.grant().role));
    assert_eq!(of("amr-7"), Some(("amr-7".to_owned(), Role::Admin)));
    assert_eq!(of("amr-70"), Some(("amr-70".to_owned(), Role::Write)));
    assert_eq!(of("amx"), Some(("amx".to_owned(), Role::Read)));
    assert_eq!(of("b"), None);
    let own = caller(&entries, "amr-70", later()).unwrap();
    assert!(own.may_send_for("amr-70").is_ok() && own.may_send_for("amr-7").is_err());
    // A name that no robot can have is let in by no entry that binds to it.
    assert_eq!(of("amr-7/8"), None);
    let problem = Roll::parse(&entry("amr 7", "write")).unwrap_err();
    assert!(problem.contains("robot"), "{problem}");
}

#[test]
fn an_entry_that_is_taken_away_ends_those_who_came_in_by_it() {
    let earlier = Roll::parse(ENTRIES).unwrap();
    let shown = Named { name: "amr-7".into(), until: later() };
    let (robot, operator) = (
        earlier.by_certificate(&shown).unwrap(),
        earlier.by_certificate(&Named { name: "operator".into(), until: later() }),
    );
    let mut next = Roll::parse(&ENTRIES.replace("amr-*", "amr-8*")).unwrap();
    next.succeed(&earlier).iter().for_each(Caller::revoke);
    assert!(robot.live().is_err());
    assert!(operator.unwrap().live().is_ok());
}

#[test]
fn a_certificate_names_its_first_dns_name_else_its_common_name() {
    let office = Office::new();
    let of = |leaf: &Leaf| {
        let path = office.write("one.pem", &office.robots.sign(leaf).cert);
        named(&certificates("tls.cert", &path).unwrap()[0]).map(|named| named.name.to_string())
    };
    let leaf = |names: &[&'static str], common| Leaf { common, ..Leaf::of(names) };
    assert_eq!(of(&leaf(&["amr-7", "amr-8"], Some("other"))).as_deref(), Some("amr-7"));
    assert_eq!(of(&leaf(&["10.0.0.1", "amr-7"], None)).as_deref(), Some("amr-7"));
    assert_eq!(of(&leaf(&["10.0.0.1"], Some("amr-9"))).as_deref(), Some("amr-9"));
    assert_eq!(of(&leaf(&[], Some("amr-9"))).as_deref(), Some("amr-9"));
    assert_eq!(of(&leaf(&["10.0.0.1"], None)), None);
    assert_eq!(of(&leaf(&[], Some("amr\n7"))), None);
}
