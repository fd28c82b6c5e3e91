//! gRPC beside the operations: health, reflection, gRPC-Web and limits.

#![allow(clippy::unwrap_used, reason = "a test may end where its ground is not as it should be")]

use crate::grpc_support::{refused, ring};
use crate::http_support::Site;
use crate::service_support::Writes;
use prost::Message;
use std::sync::atomic::Ordering;
use std::time::Duration;
use tokio_stream::StreamExt;
use tonic::Code;
use tonic::transport::Channel;
use tonic_health::pb::HealthCheckRequest;
use tonic_health::pb::health_check_response::ServingStatus;
use tonic_health::pb::health_client::HealthClient;
use tonic_types::StatusExt;
use ubbmap::wire::v1;

fn channel(site: &Site) -> Channel {
    site.run(Channel::from_shared(site.url()).unwrap().connect()).unwrap()
}

fn insertion(robot: &str, sequence: u64) -> v1::InsertScansRequest {
    v1::InsertScansRequest { map: "hall".to_owned(), scans: vec![ring(robot, Some(sequence))] }
}

#[test]
fn health_says_whether_the_server_takes_work() {
    let mut site = Site::hall();
    let mut client = HealthClient::new(channel(&site));
    let names = ["", "ubbmap.v1.MapService"];
    for name in names {
        let request = HealthCheckRequest { service: name.to_owned() };
        let answer = site.run(client.check(request)).unwrap().into_inner();
        assert_eq!(answer.status(), ServingStatus::Serving, "{name:?}");
    }
    let unknown = site.run(client.check(HealthCheckRequest { service: "other".to_owned() }));
    assert_eq!(unknown.unwrap_err().code(), Code::NotFound);
    let mut watch = site.run(client.watch(HealthCheckRequest::default())).unwrap().into_inner();
    assert_eq!(site.run(watch.next()).unwrap().unwrap().status(), ServingStatus::Serving);
    site.store.set_writes(Writes::FailStop);
    assert_eq!(site.run(watch.next()).unwrap().unwrap().status(), ServingStatus::NotServing);
    site.store.set_writes(Writes::Work);
    assert_eq!(site.run(watch.next()).unwrap().unwrap().status(), ServingStatus::Serving);
    drop((watch, client));
    site.shut_down();
}

#[test]
fn reflection_tells_the_interface_in_both_versions() {
    use tonic_reflection::pb::{v1 as current, v1alpha};
    let site = Site::new();
    let channel = channel(&site);
    let expected = ["grpc.health.v1.Health", "ubbmap.v1.MapService"];

    let list = current::server_reflection_request::MessageRequest::ListServices(String::new());
    let file = current::server_reflection_request::MessageRequest::FileContainingSymbol("ubbmap.v1.MapService".into());
    let requests = [list, file]
        .map(|message| current::ServerReflectionRequest { host: String::new(), message_request: Some(message) });
    let mut client = current::server_reflection_client::ServerReflectionClient::new(channel.clone());
    let answers = site.run(client.server_reflection_info(tokio_stream::iter(requests))).unwrap().into_inner();
    let answers: Vec<_> = site.run(answers.map(|answer| answer.unwrap().message_response.unwrap()).collect());
    use current::server_reflection_response::MessageResponse as Current;
    let Current::ListServicesResponse(list) = &answers[0] else { panic!("{answers:?}") };
    let names: Vec<_> = list.service.iter().map(|service| service.name.as_str()).collect();
    assert!(expected.iter().all(|name| names.contains(name)), "{names:?}");
    let Current::FileDescriptorResponse(files) = &answers[1] else { panic!("{answers:?}") };
    assert!(files.file_descriptor_proto.iter().any(|file| String::from_utf8_lossy(file).contains("StreamScans")));

    let list = v1alpha::server_reflection_request::MessageRequest::ListServices(String::new());
    let request = v1alpha::ServerReflectionRequest { host: String::new(), message_request: Some(list) };
    let mut client = v1alpha::server_reflection_client::ServerReflectionClient::new(channel);
    let mut answers = site.run(client.server_reflection_info(tokio_stream::iter([request]))).unwrap().into_inner();
    let answer = site.run(answers.next()).unwrap().unwrap().message_response.unwrap();
    use v1alpha::server_reflection_response::MessageResponse as Alpha;
    let Alpha::ListServicesResponse(list) = answer else { panic!("{answer:?}") };
    assert!(list.service.iter().any(|service| service.name == "ubbmap.v1.MapService"));
}

#[test]
fn grpc_web_speaks_over_http_1() {
    let site = Site::hall();
    let (payload, trailers) = site.web("ListMaps", b"");
    assert_eq!(trailers["grpc-status"], "0");
    assert_eq!(v1::ListMapsResponse::decode(&payload[..]).unwrap().maps[0].name, "hall");
    let request = v1::GetMapRequest { map: "nowhere".to_owned() }.encode_to_vec();
    let (payload, trailers) = site.web("GetMap", &request);
    assert_eq!((payload.len(), trailers["grpc-status"].as_str()), (0, "5"));
    assert!(trailers.contains_key("grpc-status-details-bin"));
}

#[test]
fn bytes_that_are_no_message_are_refused_as_such() {
    let site = Site::hall();
    // A length that reaches beyond the end.
    let (_, trailers) = site.web("GetMap", &[0x0a, 0x7f, b'h']);
    assert_eq!(trailers["grpc-status"], "3", "{trailers:?}");
    // A list of more empty elements than anything needs: two bytes each on the wire, a hundred in memory.
    let (_, trailers) = site.web("InsertScans", &[0x12, 0].repeat(1 << 18));
    assert_eq!(trailers["grpc-status"], "3", "{trailers:?}");
    let (_, trailers) = site.web("Nothing", b"");
    assert_eq!(trailers["grpc-status"], "12", "{trailers:?}");
    assert_eq!(site.get("/v1/maps/hall").json()["revision"], "0");
}

#[test]
fn errors_carry_the_word_the_field_and_when_to_try_again() {
    let site = Site::with(|config| config.limits.requests = 1);
    site.make_hall();
    let mut client = site.rpc();
    let missing = v1::GetMapRequest { map: "nowhere".to_owned() };
    let (field, detail) = refused(site.run(client.get_map(missing)), Code::NotFound, "MAP_NOT_FOUND");
    assert_eq!((field.as_str(), detail.as_str()), ("map", "there is no map \"nowhere\""));

    site.store.hold();
    let mut other = client.clone();
    let under_way = site.runtime.spawn(async move { other.insert_scans(insertion("a", 1)).await });
    while site.store.waiting.load(Ordering::SeqCst) == 0 {
        std::thread::sleep(Duration::from_millis(5));
    }
    let busy = site.run(client.list_maps(v1::ListMapsRequest {})).unwrap_err();
    assert_eq!(busy.code(), Code::ResourceExhausted);
    let details = busy.get_error_details();
    assert_eq!(details.error_info().unwrap().reason, "BUSY");
    assert_eq!(details.retry_info().unwrap().retry_delay, Some(Duration::from_secs(1)));
    // Health answers also when the server is full.
    assert!(site.run(HealthClient::new(channel(&site)).check(HealthCheckRequest::default())).is_ok());
    site.store.release();
    assert_eq!(site.run(under_way).unwrap().unwrap().into_inner().applied, 1);
}

#[test]
fn messages_and_times_have_their_limits() {
    let site = Site::with(|config| {
        config.limits.body_bytes = 100_000;
        config.limits.request_seconds = 0.3;
    });
    site.make_hall();
    let mut client = site.rpc();
    let mut long = insertion("a", 1);
    long.scans[0].ranges = vec![3.0; 50_000];
    let (field, detail) = refused(site.run(client.insert_scans(long)), Code::ResourceExhausted, "BODY_TOO_LARGE");
    assert_eq!(field, "body");
    assert!(detail.contains("100000 bytes"), "{detail}");
    site.store.hold();
    refused(site.run(client.insert_scans(insertion("a", 1))), Code::DeadlineExceeded, "TIMEOUT");
    site.store.release();
    let again = site.run(client.insert_scans(insertion("a", 1))).unwrap().into_inner();
    assert_eq!(again.applied + again.duplicates, 1);
}
