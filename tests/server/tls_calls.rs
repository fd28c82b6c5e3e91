//! TLS on the listener of REST and gRPC: what is spoken over it, whose certificate opens it, and what is read anew.

#![allow(clippy::unwrap_used, reason = "a test may end where its ground is not as it should be")]

use crate::grpc_support::{message, ring};
use crate::http_support::Site;
use crate::tls_support::{Authority, Leaf, Office, Pair, agent, client, replace, speak, status_line, until};
use rustls::{AlertDescription, CertificateError, Error as TlsFault};
use std::io::{Read, Write};
use std::net::TcpStream;
use std::sync::Arc;
use std::time::{Duration, SystemTime};
use tokio::sync::mpsc;
use tokio_stream::StreamExt;
use tokio_stream::wrappers::ReceiverStream;
use ubbmap::app::{AppError, Server};
use ubbmap::config::{ClientCertificates, Config, ConfigError};
use ubbmap::store::MemoryStore;
use ubbmap::transport::tls::Tls;
use ubbmap::wire::v1;

/// What TLS has against a connection, within what the standard library makes of it.
fn fault(error: &std::io::Error) -> Option<TlsFault> {
    error.get_ref()?.downcast_ref::<TlsFault>().cloned()
}

/// A GET on a new connection with this certificate: the status line, or what the server has against it. A server that refuses
/// a certificate says so after the client's side of the handshake is done.
fn try_with(site: &Site, office: &Office, own: Option<&Pair>) -> Result<String, Option<TlsFault>> {
    let asked = speak(site.address(), office.client(own, &["http/1.1"]))
        .and_then(|mut stream| status_line(&mut stream, "/healthz"));
    asked.map_err(|error| fault(&error))
}

fn metric(site: &Site, name: &str) -> f64 {
    let text = String::from_utf8(site.get("/metrics").body).unwrap();
    text.lines().find_map(|line| line.strip_prefix(&format!("{name} "))).map_or(0.0, |value| value.parse().unwrap())
}

#[test]
fn rest_and_grpc_and_its_streams_are_served_over_tls() {
    let office = Office::new();
    let site = office.site(ClientCertificates::Off).with_hall();
    assert!(site.url().starts_with("https://"), "{}", site.url());
    assert_eq!(site.get("/v1/maps/hall").json()["revision"], "0");
    site.run(async {
        let mut client = site.rpc_over(office.client(None, &["h2"])).await.unwrap();
        let list = client.list_maps(v1::ListMapsRequest {}).await.unwrap().into_inner();
        assert_eq!(list.maps[0].name, "hall");
        let (sender, receiver) = mpsc::channel(16);
        let mut answers = client.stream_scans(ReceiverStream::new(receiver)).await.unwrap().into_inner();
        for sequence in 0..5 {
            sender.send(message("hall", ring("amr-7", Some(sequence)))).await.unwrap();
            let answer = answers.next().await.unwrap().unwrap();
            assert_eq!((answer.sequence, answer.rejected), (Some(sequence), None));
        }
    });
}

#[test]
fn the_version_of_http_is_agreed_on_in_the_handshake() {
    let office = Office::new();
    let site = office.site(ClientCertificates::Off);
    for (offered, agreed) in [(&["h2", "http/1.1"][..], Some("h2")), (&["http/1.1"], Some("http/1.1")), (&[], None)] {
        let stream = speak(site.address(), office.client(None, offered)).unwrap();
        assert_eq!(stream.conn.alpn_protocol(), agreed.map(str::as_bytes), "{offered:?}");
    }
    // One that speaks neither is told so by TLS's own means.
    let refused = speak(site.address(), office.client(None, &["gopher"])).map(drop).unwrap_err();
    assert_eq!(fault(&refused), Some(TlsFault::AlertReceived(AlertDescription::NoApplicationProtocol)));
}

#[test]
fn a_client_does_not_take_another_server_for_this_one() {
    let office = Office::new();
    let site = office.site(ClientCertificates::Off);
    let stranger = Authority::new("stranger");
    let refused = speak(site.address(), client(&stranger.pem, None, &["h2"])).map(drop).unwrap_err();
    assert_eq!(fault(&refused), Some(TlsFault::InvalidCertificate(CertificateError::UnknownIssuer)));
}

#[test]
fn a_required_certificate_lets_in_those_of_the_authority_and_nobody_else() {
    let office = Office::new();
    let site = office.site(ClientCertificates::Required);
    let good = office.robots.sign(&Leaf::of(&["amr-7"]));
    assert_eq!(try_with(&site, &office, Some(&good)).unwrap(), "HTTP/1.1 200 OK");
    let alert = |own: Option<&Pair>| match try_with(&site, &office, own).unwrap_err() {
        Some(TlsFault::AlertReceived(alert)) => alert,
        other => panic!("{other:?}"),
    };
    assert_eq!(alert(None), AlertDescription::CertificateRequired);
    // Signed by the server's authority, which is not that of the clients.
    assert_eq!(alert(Some(&office.ca.sign(&Leaf::of(&["amr-7"])))), AlertDescription::UnknownCA);
    let late = office.robots.sign(&Leaf { years: (2020, 2021), ..Leaf::of(&["amr-7"]) });
    assert_eq!(alert(Some(&late)), AlertDescription::CertificateExpired);
    // gRPC comes in by the same door.
    site.run(async {
        let mut inside = site.rpc_over(office.client(Some(&good), &["h2"])).await.unwrap();
        inside.list_maps(v1::ListMapsRequest {}).await.unwrap();
        let outside = match site.rpc_over(office.client(None, &["h2"])).await {
            Ok(mut client) => {
                client.list_maps(v1::ListMapsRequest {}).await.map(drop).map_err(|status| status.to_string())
            }
            Err(error) => Err(error.to_string()),
        };
        outside.unwrap_err();
    });
}

#[test]
fn an_optional_certificate_may_be_left_out_but_not_be_bad() {
    let office = Office::new();
    let site = office.site(ClientCertificates::Optional);
    assert_eq!(try_with(&site, &office, None).unwrap(), "HTTP/1.1 200 OK");
    let good = office.robots.sign(&Leaf::of(&["amr-7"]));
    assert_eq!(try_with(&site, &office, Some(&good)).unwrap(), "HTTP/1.1 200 OK");
    let bad = Authority::new("stranger").sign(&Leaf::of(&["amr-7"]));
    let fault = try_with(&site, &office, Some(&bad)).unwrap_err();
    assert_eq!(fault, Some(TlsFault::AlertReceived(AlertDescription::UnknownCA)));
}

#[test]
fn a_session_that_is_taken_up_again_does_not_stand_for_a_certificate() {
    let office = Office::new();
    for (client_auth, resumed) in [
        (ClientCertificates::Off, rustls::HandshakeKind::Resumed),
        (ClientCertificates::Required, rustls::HandshakeKind::Full),
    ] {
        let site = office.site(client_auth);
        let good = office.robots.sign(&Leaf::of(&["amr-7"]));
        let config = office.client(Some(&good), &["http/1.1"]);
        let kinds: Vec<_> = (0..2)
            .map(|_| {
                let mut stream = speak(site.address(), Arc::clone(&config)).unwrap();
                status_line(&mut stream, "/healthz").unwrap();
                stream.conn.handshake_kind().unwrap()
            })
            .collect();
        assert_eq!(kinds, [rustls::HandshakeKind::Full, resumed], "{client_auth:?}");
    }
}

#[test]
fn plain_http_to_a_port_of_tls_is_told_so_and_closed() {
    let office = Office::new();
    let site = office.site(ClientCertificates::Off);
    let before = metric(&site, "ubbmap_tls_handshakes_total{outcome=\"plain\"}");
    let body = vec![b'x'; 5000];
    let head = format!("POST /v1/maps/hall/scans HTTP/1.1\r\nhost: x\r\ncontent-length: {}\r\n\r\n", body.len());
    let answer = String::from_utf8(site.raw(&[head.as_bytes(), &body].concat())).unwrap();
    let (head, body) = answer.split_once("\r\n\r\n").unwrap();
    assert!(head.starts_with("HTTP/1.1 400 ") && head.contains("application/problem+json"), "{answer}");
    let problem: serde_json::Value = serde_json::from_str(body).unwrap();
    assert_eq!((&problem["code"], &problem["status"]), (&"TLS_REQUIRED".into(), &400.into()));
    assert!(problem["detail"].as_str().unwrap().contains("https://"), "{problem}");
    // What is neither ends as well, and the server is there for others.
    let nonsense = site.raw(&[0; 100]);
    assert!(!nonsense.starts_with(b"\x16"), "{nonsense:?}");
    assert_eq!(site.get("/healthz").status, 200);
    assert!(metric(&site, "ubbmap_tls_handshakes_total{outcome=\"plain\"}") >= before + 2.0);
}

#[test]
fn handshakes_that_are_never_done_end_and_hold_up_nobody() {
    let office = Office::new();
    let mut site = Site::with(|config| {
        office.settings(config, ClientCertificates::Off);
        config.limits.header_seconds = 1.0;
        config.limits.connections = 4;
    });
    site.agent = agent(&office.ca.pem, None);
    let before = metric(&site, "ubbmap_tls_handshakes_total{outcome=\"late\"}");
    // As many as the server takes: the beginning of a handshake, or nothing, and then silence.
    let mut open: Vec<_> = (0..4)
        .map(|number| {
            let mut stream = TcpStream::connect(site.address()).unwrap();
            if number % 2 == 0 {
                stream.write_all(&[22, 3, 1, 2, 0, 1, 0]).unwrap();
            }
            stream.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
            stream
        })
        .collect();
    // It waits for a place, and gets it.
    assert_eq!(site.get("/healthz").status, 200);
    for stream in &mut open {
        let mut rest = Vec::new();
        // Reset or closed: in either case over.
        let ended = stream.read_to_end(&mut rest);
        let over = ended.as_ref().map_or_else(|error| error.kind() == std::io::ErrorKind::ConnectionReset, |_| true);
        assert!(over, "{ended:?}");
    }
    assert!(metric(&site, "ubbmap_tls_handshakes_total{outcome=\"late\"}") >= before + 4.0);
}

/// The serial number of the certificate that the server shows.
fn shown(site: &Site, office: &Office) -> Vec<u8> {
    let stream = speak(site.address(), office.client(None, &["http/1.1"])).unwrap();
    stream.conn.peer_certificates().unwrap()[0].to_vec()
}

#[test]
fn a_new_certificate_is_shown_to_new_connections_and_open_ones_go_on() {
    let office = Office::new();
    let site = office.site(ClientCertificates::Off).with_hall();
    let old = shown(&site, &office);
    let mut open = speak(site.address(), office.client(None, &["http/1.1"])).unwrap();
    assert_eq!(status_line(&mut open, "/healthz").unwrap(), "HTTP/1.1 200 OK");
    let (sender, receiver) = mpsc::channel(16);
    let mut answers = site.run(async {
        let mut client = site.rpc_over(office.client(None, &["h2"])).await.unwrap();
        client.stream_scans(ReceiverStream::new(receiver)).await.unwrap().into_inner()
    });
    let next = office.ca.sign(&Leaf::server());
    replace(&office.path("server.pem"), &next.cert);
    replace(&office.path("server.key"), &next.key);
    until("the new certificate", || shown(&site, &office) != old);
    assert_eq!(status_line(&mut open, "/healthz").unwrap(), "HTTP/1.1 200 OK");
    site.run(async {
        sender.send(message("hall", ring("amr-7", Some(1)))).await.unwrap();
        assert_eq!(answers.next().await.unwrap().unwrap().sequence, Some(1));
    });
}

#[test]
fn a_new_certificate_without_its_key_leaves_the_old_pair_in_use() {
    let office = Office::new();
    let site = office.site(ClientCertificates::Off);
    let old = shown(&site, &office);
    let failed = |site: &Site| metric(site, "ubbmap_reloads_total{what=\"tls\",outcome=\"failed\"}");
    let before = failed(&site);
    let next = office.ca.sign(&Leaf::server());
    replace(&office.path("server.pem"), &next.cert);
    until("a failed reading", || failed(&site) > before);
    assert_eq!(shown(&site, &office), old);
    replace(&office.path("server.key"), &next.key);
    until("the new pair", || shown(&site, &office) != old);
}

#[test]
fn an_authority_that_is_taken_away_lets_in_no_more_of_its_clients() {
    let office = Office::new();
    let site = office.site(ClientCertificates::Required);
    let good = office.robots.sign(&Leaf::of(&["amr-7"]));
    assert!(try_with(&site, &office, Some(&good)).is_ok());
    let next = Authority::new("robots of next year");
    replace(&office.path("robots.pem"), &next.pem);
    until("the old authority is gone", || try_with(&site, &office, Some(&good)).is_err());
    assert!(try_with(&site, &office, Some(&next.sign(&Leaf::of(&["amr-7"])))).is_ok());
}

#[test]
fn the_time_that_a_certificate_has_left_is_told() {
    let office = Office::new();
    office.put(&office.ca.sign(&Leaf { years: (2020, 2021), ..Leaf::server() }));
    // It starts all the same: a server that does not come back after a power cut would be worse.
    let late = Site::with(|config| office.settings(config, ClientCertificates::Off));
    let refused = speak(late.address(), office.client(None, &["http/1.1"])).map(drop).unwrap_err();
    assert!(matches!(fault(&refused), Some(TlsFault::InvalidCertificate(CertificateError::ExpiredContext { .. }))));
    let mut config = Config::default();
    office.settings(&mut config, ClientCertificates::Off);
    let year = 365.25 * 86_400.0;
    let tls = Tls::load(config.tls_settings().unwrap()).unwrap();
    assert!(tls.seconds_left() < -year, "{}", tls.seconds_left());
    // What stands between it and an authority counts as well.
    let between = office.ca.sign(&Leaf { years: (2020, 2089), ..Leaf::of(&["between"]) });
    let own = office.ca.sign(&Leaf::server());
    office.put(&Pair { cert: format!("{}{}", own.cert, between.cert), key: own.key });
    tls.reload().unwrap();
    let now = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap().as_secs_f64();
    let last = 1970.0 + (now + tls.seconds_left()) / year;
    assert!((last - 2089.0).abs() < 0.1, "{last}");
}

/// Why a server with these settings does not start.
fn start_error(change: impl FnOnce(&mut Config)) -> (String, String) {
    let mut config = Config { listen: "127.0.0.1:0".parse().unwrap(), ..Config::default() };
    change(&mut config);
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    match runtime.block_on(Server::start(&config, Arc::new(MemoryStore::new()))).unwrap_err() {
        AppError::Config(ConfigError::Value { key, problem }) => (key, problem),
        other => panic!("{other}"),
    }
}

#[test]
fn files_that_cannot_be_used_are_refused_by_setting_and_file() {
    let office = Office::new();
    let other = office.ca.sign(&Leaf::server());
    office.write("other.key", &other.key);
    office.write(
        "both.pem",
        &format!("{}{}", office.ca.pem, std::fs::read_to_string(office.path("server.pem")).unwrap()),
    );
    office.write("empty.pem", "\n");
    office.write("text.pem", "hello");
    let locked = "-----BEGIN ENCRYPTED PRIVATE KEY-----\nMIIB\n-----END ENCRYPTED PRIVATE KEY-----\n";
    office.write("locked.key", locked);
    let old = "-----BEGIN RSA PRIVATE KEY-----\nProc-Type: 4,ENCRYPTED\nDEK-Info: AES-256-CBC,00\n\nMIIB\n-----END RSA PRIVATE KEY-----\n";
    office.write("locked-old.key", old);
    office.write("damaged.pem", "-----BEGIN CERTIFICATE-----\nMIIB\n-----END CERTIFICATE-----\n");
    office.write("cut.pem", "-----BEGIN CERTIFICATE-----\nMIIB\n");
    std::fs::write(office.path("server.der"), [0x30, 0x82, 1, 0]).unwrap();
    std::fs::write(office.path("large.pem"), vec![b'\n'; (1 << 20) + 1]).unwrap();
    for (cert, key, setting, words) in [
        ("none.pem", "server.key", "tls.cert", "cannot read"),
        ("server.pem", "none.key", "tls.key", "cannot read"),
        (".", "server.key", "tls.cert", "is not a file"),
        ("empty.pem", "server.key", "tls.cert", "is empty"),
        ("text.pem", "server.key", "tls.cert", "BEGIN CERTIFICATE"),
        ("damaged.pem", "server.key", "tls.cert", "certificate 1 of 1 cannot be read"),
        ("cut.pem", "server.key", "tls.cert", "not in PEM"),
        ("server.der", "server.key", "tls.cert", "openssl x509 -inform der"),
        ("large.pem", "server.key", "tls.cert", "at most 1048576"),
        ("server.key", "server.pem", "tls.cert", "mixed up"),
        ("server.pem", "server.pem", "tls.key", "holds a certificate and no key"),
        ("server.pem", "text.pem", "tls.key", "BEGIN PRIVATE KEY"),
        ("server.pem", "other.key", "tls.key", "is not the key of the certificate in"),
        ("both.pem", "server.key", "tls.key", "put that one first"),
        ("server.pem", "locked.key", "tls.key", "openssl pkey -in"),
        ("server.pem", "locked-old.key", "tls.key", "passphrase"),
    ] {
        let (named, problem) = start_error(|config| {
            config.tls.cert = office.text(cert);
            config.tls.key = office.text(key);
        });
        assert_eq!(named, setting, "{cert} {key}: {problem}");
        assert!(problem.contains(words), "{cert} {key}: {problem}");
        let file = if setting == "tls.cert" { cert } else { key };
        assert!(problem.contains(&office.text(file)), "{problem} does not name {file}");
    }
    for (authority, words) in [("none.pem", "cannot read"), ("empty.pem", "is empty"), ("server.key", "holds a key")] {
        let (named, problem) = start_error(|config| {
            office.settings(config, ClientCertificates::Optional);
            config.tls.client_ca = office.text(authority);
        });
        assert_eq!(named, "tls.client_ca", "{problem}");
        assert!(problem.contains(words), "{problem}");
    }
}
