//! The file of tokens: what is in it, what is refused and how, and certificates beside tokens.

#![allow(clippy::unwrap_used, reason = "a test may end where its ground is not as it should be")]

use crate::service_support::map_name;
use std::time::{Duration, SystemTime};
use ubbmap::service::ErrorKind;
use ubbmap::transport::access::{
    Access, Caller, MapScope, Operation, Peer, Reach, Role, Roll, Secret, Shown, TokenHash,
};
use ubbmap::transport::tls::Named;

const HASH: &str = "2c26b46b68ffc68ff99b453c1d30413413422d706483bfa0f98a5e886266e7ae";

fn entry(name: &str, more: &str) -> String {
    format!("[[token]]\nname = \"{name}\"\nsha256 = \"{HASH}\"\nrole = \"read\"\nmaps = [\"*\"]\n{more}\n")
}

#[test]
fn tokens_are_known_by_the_sha_256_of_what_is_shown() {
    // A vector of everybody's: the SHA-256 of "foo".
    let roll = Roll::parse(&entry("a", "")).unwrap();
    assert_eq!(roll.by_token("foo").unwrap().name(), "a");
    assert!(roll.by_token("fop").is_none() && roll.by_token("").is_none() && roll.by_token(HASH).is_none());
    assert_eq!(TokenHash::of("foo").to_string(), HASH);
    let (one, two) = (Secret::generate().unwrap(), Secret::generate().unwrap());
    assert!(one.reveal() != two.reveal() && one.reveal().len() == "ubbmap_".len() + 43);
}

#[test]
fn what_is_wrong_with_a_file_is_named_and_no_token_is_quoted() {
    let secret = "ubbmap_c2VjcmV0";
    for (text, words) in [
        (entry("a", "role = \"write\""), "line 6: duplicate key"),
        (entry("a", "").replace("\"read\"", "\"root\""), "token 1 (\"a\"): role must be read, write or admin"),
        (entry("a", "").replace("[\"*\"]", "[]"), "maps names no map"),
        (entry("a", "").replace("\"*\"", "\"Hall\""), "\"Hall\" must be a map's name"),
        (entry("a", "").replace("\"*\"", "\"a*b\""), "must be a map's name"),
        (entry("a", "").replace("maps = [\"*\"]", ""), "missing field `maps`"),
        (entry("a", "").replace(HASH, "abc"), "64 digits of hex"),
        (entry("a", "").replace(HASH, &"é".repeat(32)), "64 digits of hex"),
        (entry("a", "").replace(HASH, secret), "holds the token itself"),
        (entry("a", &format!("token = \"{secret}\"")), "unknown field `token`"),
        (entry("a", secret), "line 6"),
        (entry("a", &format!("expires = \"{secret}")), "line 6"),
        (entry("a", "expires = \"soon\""), "2027-01-31T00:00:00Z"),
        (entry("a", "expires = 2027-01-31"), "2027-01-31T00:00:00Z"),
        (entry("a", "expires = 90"), "2027-01-31T00:00:00Z"),
        (entry("a", "robot = \"a/b\""), "robot"),
        (entry("", ""), "1 to 80 characters"),
        (entry("a\\nb", ""), "none of them for control"),
        (format!("{}{}", entry("a", ""), entry("a", "").replace("2c26", "2c27")), "two entries have the name \"a\""),
        (format!("{}{}", entry("a", ""), entry("b", "")), "\"a\" and \"b\" have the same sha256"),
        (entry("a", "").replace("[[token]]", "[[certificate]]"), "sha256 is for tokens"),
        ("tokens = []".to_owned(), "unknown field `tokens`"),
    ] {
        let problem = Roll::parse(&text).unwrap_err();
        assert!(problem.contains(words), "{text}: {problem}");
        assert!(!problem.contains(secret), "{problem}");
    }
    assert!(Roll::parse("").unwrap().entries().is_empty());
    let expires = |text: &str| Roll::parse(&entry("a", text)).unwrap().entries()[0].caller.grant().expires;
    assert_eq!(expires("expires = 2027-01-31T00:00:00Z"), expires("expires = \"2027-01-31T00:00:00Z\""));
    assert!(expires("expires = 2027-01-31T00:00:00Z").is_some());
}

#[test]
fn maps_are_named_or_begin_as_a_pattern_does() {
    let scope = MapScope::new(&["hall", "yard-*"]).unwrap();
    for (map, inside) in
        [("hall", true), ("hall-2", false), ("yard-1", true), ("yard-", true), ("yard", false), ("xhall", false)]
    {
        assert_eq!(scope.holds(&map_name(map)), inside, "{map}");
    }
    assert!(!scope.is_all() && MapScope::all().is_all() && MapScope::all().holds(&map_name("anything")));
    assert!(MapScope::new(&vec!["a"; 1001]).unwrap_err().contains("1000"));
}

#[test]
fn each_role_may_what_the_ones_below_may() {
    assert!(Role::Read < Role::Write && Role::Write < Role::Admin);
    let changing: Vec<_> = Operation::METHODS
        .into_iter()
        .filter(|operation| operation.needs().0 == Role::Admin)
        .map(Operation::method)
        .collect();
    let expected = ["CreateMap", "DeleteMap", "CreateSnapshot", "RestoreSnapshot", "DeleteSnapshot", "ImportMap"];
    assert_eq!(changing, expected);
    let sending: Vec<_> = Operation::METHODS
        .into_iter()
        .filter(|operation| operation.needs().0 == Role::Write)
        .map(Operation::method)
        .collect();
    assert_eq!(sending, ["InsertScans", "StreamScans"]);
    assert_eq!(Operation::ReadMetrics.needs(), (Role::Read, Reach::Everything));
    for operation in Operation::METHODS {
        assert_eq!(Operation::of_method(operation.method()), Some(operation));
    }
}

#[test]
fn a_certificate_is_known_by_its_name_where_no_token_is_shown() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("tokens.toml");
    let text = entry("a", "")
        + "[[certificate]]\nname = \"amr-7.fleet\"\nrole = \"write\"\nmaps = [\"hall\"]\nrobot = \"amr-7\"\n";
    std::fs::write(&file, text).unwrap();
    let access = Access::from_file(&file).unwrap();
    let shown = |name: &str, until| Peer { certificate: Some(Named { name: name.into(), until }), ..Peer::default() };
    let peer = |name: &str| shown(name, SystemTime::now() + Duration::from_secs(3600));
    let caller = access.identify(Shown::Nothing, &peer("amr-7.fleet")).unwrap();
    assert_eq!((caller.name(), caller.grant().role), ("amr-7.fleet", Role::Write));
    caller.may(Operation::InsertScans, &map_name("hall")).unwrap();
    assert!(caller.may(Operation::InsertScans, &map_name("attic")).is_err() && caller.may_send_for("amr-8").is_err());
    let unknown = access.identify(Shown::Nothing, &peer("other")).unwrap_err();
    assert!(unknown.kind == ErrorKind::Unauthenticated && unknown.detail.contains("\"other\""), "{unknown:?}");
    // What is shown on purpose stands above what the connection has; a wrong one is not passed over.
    assert_eq!(access.identify(Shown::Token("foo"), &peer("amr-7.fleet")).unwrap().name(), "a");
    assert!(access.identify(Shown::Token("bar"), &peer("amr-7.fleet")).is_err());
    // What it may do ends with the certificate.
    let over = access.identify(Shown::Nothing, &shown("amr-7.fleet", SystemTime::UNIX_EPOCH)).unwrap_err();
    assert!(over.detail.contains("expired"), "{over:?}");
    // A token does not come in as a certificate of its name, nor the other way round.
    assert!(access.identify(Shown::Nothing, &peer("a")).is_err());
    assert!(access.identify(Shown::Token("amr-7.fleet"), &Peer::default()).is_err());
}

#[test]
fn no_token_is_in_a_debug_form() {
    let roll = Roll::parse(&entry("a", "")).unwrap();
    let shown = format!("{:?} {:?}", Shown::Token("ubbmap_c2VjcmV0"), roll);
    assert!(!shown.contains("c2VjcmV0") && !shown.contains(HASH), "{shown}");
}

#[test]
fn a_token_in_the_wrong_place_was_quoted_in_what_is_wrong_with_the_file() {
    let secret = "ubbmap_c2VjcmV0LXNlY3JldC1zZWNyZXQtc2VjcmV0LTEyMw";
    for text in [
        entry("a", "").replace("\"read\"", &format!("\"{secret}\"")),
        entry("a", &format!("expires = \"{secret}\"")),
        entry("a", &format!("{secret} = 1")),
        entry("a", &format!("{}Aa = 1", &secret[7..])),
        entry("a", &format!("robot = \"{secret}/\"")),
        entry("a", "").replace("[\"*\"]", &format!("[\"{secret}*\", \"A{secret}\"]")),
        entry(secret, "").replace("\"read\"", "\"boss\""),
        format!("{}{}", entry(secret, ""), entry(secret, "").replace("2c26", "2c27")),
        format!("{}{secret} = 1\n{secret} = 2\n", entry("a", "")),
    ] {
        let problem = Roll::parse(&text).unwrap_err();
        // Seven characters of it tell nothing.
        for piece in 7..secret.len() - 6 {
            assert!(!problem.contains(&secret[piece..piece + 6]), "{problem}");
        }
    }
    assert!(
        Roll::parse(&entry("a", "rolle = 1"))
            .unwrap_err()
            .contains("unknown field `rolle`, expected one of `name`, `sha256`")
    );
}

#[test]
fn a_changed_entry_was_revoked_before_the_new_one_was_in_force() {
    let earlier = Roll::parse(&format!("{}{}", entry("a", ""), entry("b", "").replace("2c26", "2c27"))).unwrap();
    let mut next =
        Roll::parse(&format!("{}{}", entry("a", "").replace("read", "admin"), entry("b", "").replace("2c26", "2c27")))
            .unwrap();
    let gone = next.succeed(&earlier);
    let names: Vec<&str> = gone.iter().map(Caller::name).collect();
    assert_eq!(names, ["a"]);
    assert!(earlier.entries().iter().all(|entry| entry.caller.live().is_ok()), "the earlier roll is still in force");
    gone.iter().for_each(Caller::revoke);
    let live = |roll: &Roll| roll.entries().iter().map(|entry| entry.caller.live().is_ok()).collect::<Vec<_>>();
    assert_eq!((live(&earlier), live(&next)), (vec![false, true], vec![true, true]));
}
