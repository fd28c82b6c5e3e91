//! Snapshots, exports and imports over gRPC, message by message.

#![allow(clippy::unwrap_used, reason = "a test may end where its ground is not as it should be")]

use crate::grpc_support::{refused, ring};
use crate::http_support::Site;
use crate::parity_support::pieces;
use std::time::Duration;
use tokio_stream::StreamExt;
use tonic::Code;
use ubbmap::wire::v1;

/// A server with a map of a scan, and the map as a file.
fn exported() -> (Site, Vec<u8>) {
    let site = Site::with(|config| {
        config.limits.import_bytes = 100_000;
        config.limits.body_bytes = 20_000;
    });
    site.make_hall();
    let mut client = site.rpc();
    let scans = v1::InsertScansRequest { map: "hall".to_owned(), scans: vec![ring("a", Some(1))] };
    site.run(client.insert_scans(scans)).unwrap();
    let request = v1::ExportMapRequest { map: "hall".to_owned(), ..v1::ExportMapRequest::default() };
    let messages = site.run(client.export_map(request)).unwrap().into_inner();
    let messages: Vec<_> = site.run(messages.map(Result::unwrap).collect());
    assert!(messages.iter().all(|message| message.revision == 1));
    (site, messages.into_iter().flat_map(|message| message.data).collect())
}

#[test]
fn a_map_comes_in_piece_by_piece() {
    let (site, file) = exported();
    assert_eq!(file, site.get("/v1/maps/hall/export").body);
    let mut client = site.rpc();
    let tiny: Vec<_> = file.chunks(7).map(<[u8]>::to_vec).collect();
    let messages = tiny
        .into_iter()
        .enumerate()
        .map(|(at, data)| v1::ImportMapRequest { map: if at == 0 { "copy".to_owned() } else { String::new() }, data });
    let imported = site.run(client.import_map(tokio_stream::iter(messages.collect::<Vec<_>>()))).unwrap().into_inner();
    assert_eq!((imported.name.as_str(), imported.revision), ("copy", 1));
    assert_eq!(site.get("/v1/maps/copy/region").json()["leaves"], site.get("/v1/maps/hall/region").json()["leaves"]);
}

#[test]
fn imports_that_make_no_sense_leave_nothing() {
    let (site, file) = exported();
    let mut client = site.rpc();
    let mut refusal = |messages: Vec<v1::ImportMapRequest>, code, word| {
        refused(site.run(client.import_map(tokio_stream::iter(messages))), code, word)
    };
    let none = refusal(Vec::new(), Code::InvalidArgument, "INVALID_NAME");
    assert_eq!(none.0, "map");
    let unnamed = pieces("", &file);
    assert_eq!(refusal(unnamed, Code::InvalidArgument, "INVALID_NAME").0, "map");
    let mut twice = pieces("copy", &file);
    twice[1].map = "other".to_owned();
    assert_eq!(refusal(twice, Code::InvalidArgument, "INVALID_REQUEST").0, "map");
    let large = pieces("copy", &[0; 100_001]);
    assert_eq!(refusal(large, Code::ResourceExhausted, "BODY_TOO_LARGE").0, "body");
    // One message that is larger than a message may be.
    let long = vec![v1::ImportMapRequest { map: "copy".to_owned(), data: vec![0; 30_000] }];
    assert_eq!(refusal(long, Code::ResourceExhausted, "BODY_TOO_LARGE").0, "body");
    let cut = pieces("copy", &file[..file.len() - 1]);
    assert!(refusal(cut, Code::InvalidArgument, "INVALID_FILE").1.contains("it is cut"));
    assert_eq!(refusal(pieces("hall", &file), Code::AlreadyExists, "MAP_EXISTS").0, "map");
    // A client that goes away in the middle, and one behind the last piece without saying that it was the last: their
    // ends of the streams stay open, for a stream that ends is a whole file.
    let mut open = Vec::new();
    for count in [1, pieces("copy", &file).len()] {
        let (sender, receiver) = tokio::sync::mpsc::channel(8);
        let stream = tokio_stream::wrappers::ReceiverStream::new(receiver);
        let mut other = site.rpc();
        let call = site.runtime.spawn(async move { other.import_map(stream).await });
        for piece in pieces("copy", &file).into_iter().take(count) {
            site.run(sender.send(piece)).unwrap();
        }
        std::thread::sleep(Duration::from_millis(200));
        call.abort();
        open.push(sender);
    }
    std::thread::sleep(Duration::from_millis(200));
    assert_eq!(site.get("/v1/maps").json()["maps"].as_array().unwrap().len(), 1);
}

#[test]
fn a_watch_is_told_of_a_restore() {
    let (site, _) = exported();
    let mut client = site.rpc();
    let named = |name: &str| v1::CreateSnapshotRequest { map: "hall".to_owned(), name: name.to_owned() };
    assert_eq!(site.run(client.create_snapshot(named("one"))).unwrap().into_inner().revision, 1);
    let mut moved = ring("a", Some(2));
    moved.pose.as_mut().unwrap().x.as_mut().unwrap().min = Some(-0.5);
    let scans = v1::InsertScansRequest { map: "hall".to_owned(), scans: vec![moved] };
    site.run(client.insert_scans(scans)).unwrap();
    let watch = v1::WatchMapRequest { map: "hall".to_owned(), since: Some(2), ..v1::WatchMapRequest::default() };
    let mut watch = site.run(client.watch_map(watch)).unwrap().into_inner();
    assert_eq!(site.run(watch.message()).unwrap().unwrap().revision, 2);
    let restore = v1::RestoreSnapshotRequest { map: "hall".to_owned(), name: "one".to_owned() };
    assert_eq!(site.run(client.restore_snapshot(restore)).unwrap().into_inner().revision, 3);
    let told = site.run(watch.message()).unwrap().unwrap();
    assert_eq!((told.since, told.revision, told.everything), (2, 3, false));
    assert!(!told.blocks.is_empty() && told.blocks.iter().all(|block| block.revision == 3 && block.changed.is_some()));
    let delete = v1::DeleteSnapshotRequest { map: "hall".to_owned(), name: "one".to_owned() };
    site.run(client.delete_snapshot(delete)).unwrap();
    let list = site.run(client.list_snapshots(v1::ListSnapshotsRequest { map: "hall".to_owned() })).unwrap();
    assert!(list.into_inner().snapshots.is_empty());
    drop(watch);
}
