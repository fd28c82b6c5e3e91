//! The settings: layers, defaults held to the file, and errors that name the key.
#![allow(clippy::unwrap_used, clippy::panic, reason = "tests")]

use super::{Config, ConfigError, LogFormat, StoreKind};
use crate::transport::tls::ClientAuth;
use std::io::Write;
use std::path::Path;

fn file(text: &str) -> tempfile::NamedTempFile {
    let mut file = tempfile::NamedTempFile::new().unwrap();
    file.write_all(text.as_bytes()).unwrap();
    file
}

fn load(text: &str, env: &[(&str, &str)], overrides: &[(&str, &str)]) -> Result<Config, ConfigError> {
    let file = file(text);
    let overrides: Vec<_> = overrides.iter().map(|(key, value)| (*key, (*value).to_owned())).collect();
    Config::load(Some(file.path()), env.iter().map(|(key, value)| ((*key).to_owned(), (*value).to_owned())), &overrides)
}

fn message(text: &str, env: &[(&str, &str)]) -> String {
    load(text, env, &[]).unwrap_err().to_string()
}

#[test]
fn nothing_given_is_the_default() {
    assert_eq!(Config::load(None, [], &[]).unwrap(), Config::default());
}

#[test]
fn the_default_file_holds_every_setting_with_its_default() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("config/default.toml");
    assert_eq!(Config::load(Some(&path), [], &[]).unwrap(), Config::default());
    let text = std::fs::read_to_string(path).unwrap();
    let mut table = String::new();
    let mut keys = Vec::new();
    for line in text.lines() {
        if let Some(name) = line.strip_prefix('[') {
            table = format!("{}.", name.trim_end_matches(']'));
        } else if let Some((key, _)) = line.split_once(" = ").filter(|_| !line.starts_with('#')) {
            keys.push(format!("{table}{key}"));
        }
    }
    keys.sort();
    let known: Vec<_> = super::load::known_keys().unwrap().into_iter().collect();
    assert_eq!(keys, known);
}

#[test]
fn every_setting_of_the_file_is_read() {
    // Each value of the default file, changed, must change the configuration.
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("config/default.toml");
    let text = std::fs::read_to_string(path).unwrap();
    let lines: Vec<_> = text.lines().collect();
    for (at, line) in lines.iter().enumerate() {
        let Some((key, value)) = line.split_once(" = ").filter(|_| !line.starts_with('#')) else { continue };
        if ["cert", "key", "client_ca", "client_auth"].contains(&key) {
            // One alone is refused: the next test has them together.
            continue;
        }
        if key == "otlp_endpoint" && !cfg!(feature = "otel") {
            // Refused by a binary that cannot send traces, so it is read.
            let refused = load(&text.replace(line, "otlp_endpoint = \"http://127.0.0.1:4317\""), &[], &[]).unwrap_err();
            assert!(refused.to_string().contains(key), "{refused}");
            continue;
        }
        let other = match value {
            "\"127.0.0.1:8080\"" => "\"127.0.0.1:9\"",
            "\"ubbmap-data\"" => "\"elsewhere\"",
            "\"sled\"" => "\"memory\"",
            "\"info\"" => "\"debug\"",
            "\"text\"" => "\"json\"",
            "\"off\"" => "\"router\"",
            "\"tcp/127.0.0.1:7447\"" => "\"tcp/127.0.0.1:7448\"",
            "\"ubbmap\"" => "\"site/ubbmap\"",
            "\"\"" if key == "admin_listen" => "\"127.0.0.1:7449\"",
            "\"\"" if key == "cors_origins" => "\"https://a.example\"",
            "\"\"" if key == "otlp_endpoint" => "\"http://127.0.0.1:4317\"",
            "\"\"" => "\"tcp/127.0.0.1:7449\"",
            "false" => "true",
            "8.0" => "5.0",
            "536870912" => "536870913",
            "1073741824" | "67108864" => "1048576",
            number if number.contains('.') => "1.5",
            _ => "77",
        };
        // A number beside its own where that one is out of its range.
        let beside = value.parse::<u64>().map(|number| [number + 1, number.saturating_sub(1)]).unwrap_or_default();
        let mut others = vec![other.to_owned()];
        others.extend(beside.iter().map(u64::to_string));
        let is_read = |other: &String| {
            let mut changed: Vec<_> = lines.iter().map(|line| (*line).to_owned()).collect();
            changed[at] = format!("{key} = {other}");
            load(&changed.join("\n"), &[], &[]).is_ok_and(|config| config != Config::default())
        };
        assert!(others.iter().any(is_read), "{key}");
    }
}

#[test]
fn every_setting_of_tls_is_read() {
    let table = |cert: &str, key: &str, ca: &str, auth: &str| {
        let text = format!("[tls]\ncert = {cert:?}\nkey = {key:?}\nclient_ca = {ca:?}\nclient_auth = {auth:?}");
        load(&text, &[], &[]).unwrap().tls_settings().unwrap()
    };
    let usual = table("a", "b", "c", "required");
    assert_eq!((usual.cert.to_str(), usual.key.to_str()), (Some("a"), Some("b")));
    assert_eq!((usual.client_ca.as_deref(), usual.client_auth), (Some(Path::new("c")), ClientAuth::Required));
    assert_eq!(table("a", "b", "c", "optional").client_auth, ClientAuth::Optional);
    let off = table("a", "b", "", "off");
    assert_eq!((off.client_ca, off.client_auth), (None, ClientAuth::Off));
    assert!(Config::default().tls_settings().is_none());
}

#[test]
fn flags_stand_above_the_environment_above_the_file() {
    let text = "listen = \"127.0.0.1:1\"\ndata_dir = \"a\"\nlog_format = \"json\"\n[limits]\nmaps = 5\nrequests = 6\n";
    let env = [
        ("UBBMAP_LISTEN", "127.0.0.1:2"),
        ("UBBMAP_LIMITS__MAPS", "7"),
        ("UBBMAP_STORE", "memory"),
        ("UBBMAP_INSECURE", "true"),
        ("UBBMAP_LIMITS__POSE_WIDTH", "0.5"),
        ("UBBMAP_REWRITE__FACTOR", "4.5"),
        ("UBBMAP_REWRITE__CHECK_SECONDS", "0.5"),
        ("HOME", "/"),
    ];
    let config = load(text, &env, &[("listen", "127.0.0.1:3")]).unwrap();
    assert_eq!(config.listen.port(), 3);
    assert_eq!(config.data_dir, Path::new("a"));
    assert_eq!((config.limits.maps, config.limits.requests), (7, 6));
    assert_eq!((config.store, config.log_format), (StoreKind::Memory, LogFormat::Json));
    assert!(config.insecure);
    assert_eq!(config.service_settings().pose.max_position_width, 0.5);
    assert_eq!(config.service_settings().max_maps, 7);
    let rewrite = config.rewrite_options();
    assert_eq!((rewrite.factor, rewrite.check.as_millis()), (4.5, 500));
}

#[test]
fn unknown_keys_name_the_nearest() {
    let text = message("[limits]\nbody_byte = 3\n", &[]);
    assert!(text.contains("`limits.body_byte`") && text.contains("did you mean `limits.body_bytes`?"), "{text}");
    let text = message("body_bytes = 3\n", &[]);
    assert!(text.contains("did you mean `limits.body_bytes`?"), "{text}");
    let text = message("", &[("UBBMAP_LISTN", "127.0.0.1:2")]);
    assert!(text.contains("UBBMAP_LISTN") && text.contains("did you mean `listen`?"), "{text}");
    let text = message("[quux]\nzzz = 1\n", &[]);
    assert!(text.contains("`quux.zzz`") && !text.contains("did you mean"), "{text}");
    let text = message("limits = 3\n", &[]);
    assert!(text.contains("`limits`") && text.contains("table"), "{text}");
    let text = load("", &[], &[("data_di", "x")]).unwrap_err().to_string();
    assert!(text.contains("on the command line") && text.contains("`data_dir`"), "{text}");
}

#[test]
fn bad_values_name_their_setting() {
    for (text, key) in [
        ("listen = \"nowhere\"", "listen"),
        ("listen = 8080", "listen"),
        ("store = \"postgres\"", "store"),
        ("insecure = \"perhaps\"", "insecure"),
        ("log = \"a=b=c\"", "log"),
        ("[limits]\nmaps = \"many\"", "limits.maps"),
        ("[limits]\nmaps = -1", "limits.maps"),
        ("[limits]\nrequests = 0", "limits.requests"),
        ("[limits]\nheader_bytes = 1023", "limits.header_bytes"),
        ("[limits]\nheader_bytes = 65537", "limits.header_bytes"),
        ("[limits]\ndepth = 25", "limits.depth"),
        ("[limits]\nname_bytes = 64", "limits.name_bytes"),
        ("[limits]\nincoming_bytes = 16777215", "limits.incoming_bytes"),
        ("[limits]\nidle_seconds = 0.0", "limits.idle_seconds"),
        ("cors_origins = \"app.example.org\"", "cors_origins"),
        ("cors_origins = \"https://a.example, https://b.example/app\"", "cors_origins"),
        ("[limits]\npose_width = nan", "limits.pose_width"),
        ("[limits]\nrequest_seconds = inf", "limits.request_seconds"),
        ("[shutdown]\ngrace_seconds = -1.0", "shutdown.grace_seconds"),
        ("[rewrite]\nfactor = 3.9", "rewrite.factor"),
        ("[rewrite]\nfactor = nan", "rewrite.factor"),
        ("[rewrite]\nleast_bytes = 1000", "rewrite.least_bytes"),
        ("[rewrite]\ncheck_seconds = 0.0", "rewrite.check_seconds"),
        ("[zenoh]\nmode = \"mesh\"", "zenoh.mode"),
        ("[zenoh]\nprefix = \"a/*\"", "zenoh.prefix"),
        ("[zenoh]\nprefix = \"\"", "zenoh.prefix"),
        ("[zenoh]\nmode = \"client\"", "zenoh.connect"),
        ("[zenoh]\nmode = \"router\"\nlisten = \" , \"", "zenoh.listen"),
    ] {
        let text = message(text, &[]);
        assert!(text.contains(&format!("`{key}`")), "{text}");
    }
    let text = message("", &[("UBBMAP_LIMITS__MAPS", "many")]);
    assert!(text.contains("`limits.maps`"), "{text}");
}

#[test]
fn files_that_cannot_be_read_are_named() {
    let text = Config::load(Some(Path::new("/no/such/file.toml")), [], &[]).unwrap_err().to_string();
    assert!(text.contains("/no/such/file.toml"), "{text}");
    assert!(matches!(load("listen = ", &[], &[]), Err(ConfigError::Syntax { .. })));
}

#[test]
fn an_address_beyond_loopback_needs_a_word() {
    for address in ["0.0.0.0:80", "[::]:80", "192.168.1.2:80"] {
        let text = format!("listen = \"{address}\"");
        assert!(matches!(load(&text, &[], &[]), Err(ConfigError::NotLoopback(_))), "{address}");
        assert!(load(&text, &[], &[("insecure", "true")]).is_ok());
    }
    for address in ["[::1]:80", "127.1.2.3:80", "[::ffff:127.0.0.1]:80"] {
        assert!(load(&format!("listen = \"{address}\""), &[], &[]).is_ok(), "{address}");
    }
}

const CERTIFICATE: &str = "\n[tls]\ncert = \"a\"\nkey = \"b\"\n";

#[test]
fn zenoh_opens_beyond_loopback_to_users_and_to_certificates_that_are_required() {
    let zenoh = |more: &str| format!("[zenoh]\nmode = \"router\"\n{more}\n");
    let open = |text: &str| load(text, &[], &[]);
    assert!(open(&zenoh("listen = \"tcp/0.0.0.0:7447\"\nusers = \"u\"")).is_ok());
    let tls = zenoh("listen = \"tls/0.0.0.0:7447\"") + CERTIFICATE;
    assert!(open(&tls).is_err());
    assert!(open(&(tls.clone() + "client_ca = \"c\"\nclient_auth = \"optional\"")).is_err());
    let required = open(&(tls + "client_ca = \"c\"\nclient_auth = \"required\"")).unwrap();
    let files = required.zenoh_settings().unwrap().tls.unwrap();
    assert_eq!((files.cert.as_path(), files.client_ca.as_deref()), (Path::new("a"), Some(Path::new("c"))));
    // One endpoint that asks for nothing is enough to be refused.
    let both = zenoh("listen = \"tls/0.0.0.0:7447,tcp/0.0.0.0:7448\"") + CERTIFICATE;
    let problem = open(&(both + "client_ca = \"c\"\nclient_auth = \"required\"")).unwrap_err().to_string();
    assert!(problem.contains("tcp/0.0.0.0:7448") && problem.contains("zenoh.users"), "{problem}");
    for (more, key, words) in [
        ("listen = \"tls/127.0.0.1:7447\"", "zenoh.listen", "tls.cert"),
        ("users = \"u\"\nfile = \"f\"", "zenoh.users", "leave one out"),
        ("users = \"u\"\nconnect = \"tcp/127.0.0.1:1\"", "zenoh.users", "zenoh.file"),
    ] {
        let problem = open(&zenoh(more)).unwrap_err().to_string();
        assert!(problem.contains(&format!("`{key}`")) && problem.contains(words), "{problem}");
    }
}

#[test]
fn zenoh_beyond_loopback_needs_a_word_or_a_file_of_its_own() {
    for endpoint in
        ["tcp/0.0.0.0:7447", "tcp/[::]:7447", "tls/router.example:7447", "tcp/10.0.0.1:7447#iface=eth0", "x"]
    {
        for setting in ["listen", "connect"] {
            let text = format!("[zenoh]\nmode = \"peer\"\n{setting} = \"tcp/127.0.0.1:1, {endpoint}\"{CERTIFICATE}");
            let refused = load(&text, &[], &[]).unwrap_err().to_string();
            assert!(refused.contains(&format!("`zenoh.{setting}`")) && refused.contains("--insecure"), "{refused}");
            assert!(load(&text, &[], &[("insecure", "true")]).is_ok());
            assert!(load(&text, &[("UBBMAP_ZENOH__FILE", "zenoh.json5")], &[]).is_ok());
        }
    }
    for endpoint in ["tcp/127.0.0.1:0", "tcp/[::1]:7447", "tls/localhost:7447?x=1"] {
        let config =
            load(&format!("[zenoh]\nmode = \"router\"\nlisten = \"{endpoint}\"{CERTIFICATE}"), &[], &[]).unwrap();
        assert_eq!(config.zenoh_settings().unwrap().listen, [endpoint]);
    }
    assert!(Config::default().zenoh_settings().is_none());
}

#[test]
fn the_variable_of_the_recorded_logs_named_the_store_too() {
    let config = load("", &[("UBBMAP_DATA", "logs"), ("UBBMAP_DATA_DIR", "maps")], &[]).unwrap();
    assert_eq!(config.data_dir, Path::new("maps"));
}

#[test]
fn the_switch_of_the_build_is_no_setting() {
    assert_eq!(load("", &[("UBBMAP_VIEWER", "off")], &[]).unwrap(), Config::default());
}
