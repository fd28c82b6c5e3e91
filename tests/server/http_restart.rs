//! A server on a directory: stopped and started again, and what keeps it from starting.

#![allow(clippy::unwrap_used, reason = "a test may end where its ground is not as it should be")]

use crate::http_support::{agent, ring, send};
use serde_json::json;
use std::sync::Arc;
use std::thread;
use std::time::{Duration, Instant};
use ubbmap::app::{AppError, Server, serve};
use ubbmap::config::{Config, ConfigError, StoreKind};
use ubbmap::store::{MemoryStore, SledOptions, SledStore, StoreError};

fn local() -> Config {
    Config { listen: "127.0.0.1:0".parse().unwrap(), ..Config::default() }
}

#[test]
fn a_map_outlives_its_server() {
    let directory = tempfile::tempdir().unwrap();
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build().unwrap();
    let start = || {
        // The writers of the server before let go of the store a little after its end.
        let begun = Instant::now();
        let store = loop {
            match SledStore::open(directory.path(), SledOptions::default()) {
                Ok(store) => break store,
                Err(StoreError::Locked { .. }) if begun.elapsed().as_secs() < 10 => {}
                Err(error) => panic!("{error}"),
            }
            thread::sleep(Duration::from_millis(5));
        };
        runtime.block_on(Server::start(&local(), Arc::new(store))).unwrap()
    };
    let insert = |server: &Server, sequence| {
        let body = ring("a", Some(sequence)).to_string();
        send(&agent(), "POST", &format!("{}/v1/maps/hall/scans", server.url()), &[], body.as_bytes()).json()
    };
    let seen = |server: &Server| {
        let get = |path: &str| send(&agent(), "GET", &format!("{}/v1/maps/hall{path}", server.url()), &[], b"").json();
        (get(""), get("/region"))
    };

    let server = start();
    let config = br#"{"depth": 8, "sensors": {"default": {"range_max": 10}}}"#;
    let created = send(&agent(), "PUT", &format!("{}/v1/maps/hall", server.url()), &[], config);
    assert_eq!(created.status, 201);
    for sequence in 1..4 {
        assert_eq!(insert(&server, sequence)["applied"], 1);
    }
    let before = seen(&server);
    runtime.block_on(server.shutdown()).unwrap();

    let server = start();
    assert_eq!(seen(&server), before);
    let again = insert(&server, 3);
    assert_eq!((&again["duplicates"], &again["revision"]), (&json!(1), &json!("3")));
    assert_eq!(insert(&server, 4)["revision"], "4");
    runtime.block_on(server.shutdown()).unwrap();
}

#[tokio::test]
async fn a_server_that_cannot_start_says_why() {
    let config = Config { listen: "0.0.0.0:0".parse().unwrap(), ..Config::default() };
    let error = Server::start(&config, Arc::new(MemoryStore::new())).await.unwrap_err();
    assert!(matches!(error, AppError::Config(ConfigError::NotLoopback(_))), "{error}");
    assert!(error.to_string().contains("--insecure"), "{error}");

    let first = Server::start(&local(), Arc::new(MemoryStore::new())).await.unwrap();
    let taken = Config { listen: first.address(), ..Config::default() };
    let error = Server::start(&taken, Arc::new(MemoryStore::new())).await.unwrap_err();
    assert!(error.to_string().contains(&first.address().to_string()), "{error}");
    first.shutdown().await.unwrap();
}

#[cfg(unix)]
#[test]
fn a_signal_ends_the_server_in_order() {
    let directory = tempfile::tempdir().unwrap();
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build().unwrap();
    let config = Config { store: StoreKind::Sled, data_dir: directory.path().join("maps"), ..local() };
    let data = config.data_dir.clone();
    let (tell, told) = std::sync::mpsc::channel();
    let served = runtime.spawn(serve(config, move |address| tell.send(address).unwrap()));
    let address = told.recv_timeout(Duration::from_secs(20)).unwrap();
    assert_eq!(send(&agent(), "PUT", &format!("http://{address}/v1/maps/hall"), &[], b"").status, 201);
    // The server takes the signal, so it does not end the tests.
    let process = std::process::id().to_string();
    assert!(std::process::Command::new("kill").args(["-TERM", &process]).status().unwrap().success());
    runtime.block_on(served).unwrap().unwrap();
    assert!(std::net::TcpStream::connect(address).is_err());
    // The store is closed when it returns.
    let store = SledStore::open(&data, SledOptions::default()).unwrap();
    assert_eq!(ubbmap::store::MapStore::list(&store).unwrap().len(), 1);
}
