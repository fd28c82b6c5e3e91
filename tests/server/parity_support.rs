//! One call on any transport: the request is a message, and so is the answer; an error is its code, field and words.

#![allow(clippy::unwrap_used, clippy::panic, reason = "tests")]

use crate::grpc_support::Client;
use crate::http_support::Site;
use crate::zenoh_support::ask;
use prost::Message;
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::Value;
use tonic::{Code, Status};
use tonic_types::StatusExt;
use ubbmap::transport::http::Problem;
use ubbmap::wire::v1;
use zenoh::Session;

/// A request of the interface.
#[derive(Debug, Clone)]
pub enum Call {
    CreateMap(v1::CreateMapRequest),
    GetMap(v1::GetMapRequest),
    ListMaps,
    DeleteMap(v1::DeleteMapRequest),
    InsertScans(v1::InsertScansRequest),
    GetClasses(v1::GetClassesRequest),
    GetRegion(v1::GetRegionRequest),
    GetGrid(v1::GetGridRequest),
    GetTile(v1::GetTileRequest),
    CheckGuaranteedFree(v1::CheckGuaranteedFreeRequest),
    GetChanges(v1::GetChangesRequest),
    ListRobots(v1::ListRobotsRequest),
    /// Bytes that are no message, where classes are asked for.
    Broken(Vec<u8>),
    CreateSnapshot(v1::CreateSnapshotRequest),
    ListSnapshots(v1::ListSnapshotsRequest),
    RestoreSnapshot(v1::RestoreSnapshotRequest),
    DeleteSnapshot(v1::DeleteSnapshotRequest),
    /// Told as its revision, its length and the sum of its bytes.
    ExportMap(v1::ExportMapRequest),
    ImportMap(String, Vec<u8>),
    /// What is not in the interface.
    Nothing,
}

impl Call {
    /// Snapshots and files are not on Zenoh.
    pub fn is_on(&self, kind: Kind) -> bool {
        let kept = matches!(
            self,
            Self::CreateSnapshot(_)
                | Self::ListSnapshots(_)
                | Self::RestoreSnapshot(_)
                | Self::DeleteSnapshot(_)
                | Self::ExportMap(_)
                | Self::ImportMap(..)
        );
        kind != Kind::Zenoh || !kept
    }
}

#[derive(Debug, Clone, PartialEq)]
pub struct Refusal {
    pub code: String,
    pub field: String,
    /// Nothing where each transport has words of its own.
    pub detail: String,
    /// After how many seconds it may be tried again.
    pub retry_after: Option<u64>,
}

/// The answer's message as JSON, what differs between servers taken out.
pub type Outcome = Result<Value, Refusal>;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    Rest,
    Grpc,
    Zenoh,
}

pub const TRANSPORTS: [Kind; 3] = [Kind::Rest, Kind::Grpc, Kind::Zenoh];

/// A client of one transport.
pub enum Transport {
    Rest,
    Grpc(Client),
    Zenoh(Session),
}

impl Transport {
    pub fn new(kind: Kind, site: &Site) -> Self {
        match kind {
            Kind::Rest => Self::Rest,
            Kind::Grpc => Self::Grpc(site.rpc()),
            Kind::Zenoh => Self::Zenoh(site.session()),
        }
    }

    pub fn call(&self, site: &Site, call: &Call) -> Outcome {
        match self {
            Self::Rest => rest(site, call),
            Self::Grpc(client) => grpc(site, client.clone(), call),
            Self::Zenoh(session) => site.run(over_zenoh(session, call)),
        }
    }
}

fn told<M: Serialize>(message: &M) -> Value {
    let mut value = serde_json::to_value(message).unwrap();
    forget_times(&mut value);
    value
}

/// When a map was created and changed differs from server to server.
fn forget_times(value: &mut Value) {
    match value {
        Value::Object(fields) => {
            for time in ["created", "changed", "last_change", "received"] {
                fields.remove(time);
            }
            fields.values_mut().for_each(forget_times);
        }
        Value::Array(values) => values.iter_mut().for_each(forget_times),
        _ => {}
    }
}

fn refusal(code: String, field: Option<String>, detail: String, retry_after: Option<u64>) -> Refusal {
    // What is not there, and what is broken before it is a message, each transport says in its own words.
    let own = ["ROUTE_NOT_FOUND", "BODY_TOO_LARGE"].contains(&code.as_str());
    Refusal { code, field: field.unwrap_or_default(), detail: if own { String::new() } else { detail }, retry_after }
}

fn rest(site: &Site, call: &Call) -> Outcome {
    match call {
        Call::CreateMap(r) => {
            let body = r.config.clone().map(|config| serde_json::to_string(&config).unwrap()).unwrap_or_default();
            rest_json::<v1::CreateMapResponse>(site, "PUT", &format!("/v1/maps/{}", r.map), &body)
        }
        Call::GetMap(r) => rest_json::<v1::GetMapResponse>(site, "GET", &format!("/v1/maps/{}", r.map), ""),
        Call::ListMaps => rest_json::<v1::ListMapsResponse>(site, "GET", "/v1/maps", ""),
        Call::DeleteMap(r) => rest_json::<v1::DeleteMapResponse>(site, "DELETE", &format!("/v1/maps/{}", r.map), ""),
        Call::InsertScans(r) => rest_post::<v1::InsertScansResponse>(site, &r.map, "scans", r),
        Call::GetClasses(r) => rest_post::<v1::GetClassesResponse>(site, &r.map, "classes", r),
        Call::CheckGuaranteedFree(r) => {
            rest_post::<v1::CheckGuaranteedFreeResponse>(site, &r.map, "guaranteed-free", r)
        }
        Call::GetRegion(r) => rest_query::<v1::GetRegionResponse>(site, &r.map, "region", r),
        Call::GetGrid(r) => rest_query::<v1::GetGridResponse>(site, &r.map, "grid", r),
        Call::GetChanges(r) => rest_query::<v1::GetChangesResponse>(site, &r.map, "changes", r),
        Call::ListRobots(r) => {
            rest_json::<v1::ListRobotsResponse>(site, "GET", &format!("/v1/maps/{}/robots", r.map), "")
        }
        Call::GetTile(r) => {
            let snapshot = if r.snapshot.is_empty() { String::new() } else { format!("?snapshot={}", r.snapshot) };
            let path = format!("/v1/maps/{}/tiles/{}/{}/{}.pb{snapshot}", r.map, r.z, r.x, r.y);
            let answer = site.get(&path);
            if answer.status == 200 {
                return Ok(told(&v1::GetTileResponse::decode(&answer.body[..]).unwrap()));
            }
            rest_json::<v1::GetTileResponse>(site, "GET", &path, "")
        }
        Call::Broken(bytes) => {
            let headers = [("content-type", "application/x-protobuf")];
            outcome::<v1::GetClassesResponse>(&site.send("POST", "/v1/maps/hall/classes", &headers, bytes))
        }
        Call::Nothing => rest_json::<v1::ListSnapshotsResponse>(site, "GET", "/v1/maps/hall/nothing", ""),
        kept => rest_kept(site, kept),
    }
}

/// Snapshots and files.
fn rest_kept(site: &Site, call: &Call) -> Outcome {
    match call {
        Call::CreateSnapshot(r) => rest_post::<v1::CreateSnapshotResponse>(site, &r.map, "snapshots", r),
        Call::ListSnapshots(r) => {
            rest_json::<v1::ListSnapshotsResponse>(site, "GET", &format!("/v1/maps/{}/snapshots", r.map), "")
        }
        Call::RestoreSnapshot(r) => {
            rest_post::<v1::RestoreSnapshotResponse>(site, &r.map, &format!("snapshots/{}/restore", r.name), r)
        }
        Call::DeleteSnapshot(r) => {
            let path = format!("/v1/maps/{}/snapshots/{}", r.map, r.name);
            rest_json::<v1::DeleteSnapshotResponse>(site, "DELETE", &path, "")
        }
        Call::ExportMap(r) => {
            let mut path = format!("/v1/maps/{}/export?", r.map);
            if r.format() == v1::ExportFormat::Nav2 {
                path.push_str("format=nav2");
            }
            if r.mode() == v1::ExportMode::Scale {
                path.push_str("&mode=scale");
            }
            if let Some(depth) = r.depth {
                path.push_str(&format!("&depth={depth}"));
            }
            if !r.snapshot.is_empty() {
                path.push_str(&format!("&snapshot={}", r.snapshot));
            }
            let answer = site.get(&path.replace("?&", "?"));
            if answer.status != 200 {
                return outcome::<v1::ImportMapResponse>(&answer);
            }
            Ok(told_file(answer.header("ubbmap-revision").unwrap().parse().unwrap(), &answer.body))
        }
        Call::ImportMap(map, file) => {
            outcome::<v1::ImportMapResponse>(&site.send("PUT", &format!("/v1/maps/{map}/import"), &[], file))
        }
        other => panic!("{other:?}"),
    }
}

fn told_file(revision: u64, bytes: &[u8]) -> Value {
    serde_json::json!({"revision": revision, "length": bytes.len(), "sum": crc32c::crc32c(bytes)})
}

fn rest_post<T: DeserializeOwned + Serialize>(site: &Site, map: &str, what: &str, request: &impl Serialize) -> Outcome {
    let body = serde_json::to_string(request).unwrap();
    rest_json::<T>(site, "POST", &format!("/v1/maps/{map}/{what}"), &body)
}

/// The fields of a request as a query string.
fn rest_query<T: DeserializeOwned + Serialize>(
    site: &Site,
    map: &str,
    what: &str,
    request: &impl Serialize,
) -> Outcome {
    let Value::Object(fields) = serde_json::to_value(request).unwrap() else { panic!("no object") };
    let text = |value: &Value| value.as_str().map_or_else(|| value.to_string(), str::to_owned);
    let query: Vec<String> = fields
        .iter()
        // An empty text is one that was left out.
        .filter(|(name, value)| *name != "map" && *value != "")
        .map(|(name, value)| format!("{name}={}", text(value)))
        .collect();
    rest_json::<T>(site, "GET", &format!("/v1/maps/{map}/{what}?{}", query.join("&")), "")
}

fn rest_json<T: DeserializeOwned + Serialize>(site: &Site, method: &str, path: &str, body: &str) -> Outcome {
    outcome::<T>(&site.send(method, path, &[("content-type", "application/json")], body.as_bytes()))
}

fn outcome<T: DeserializeOwned + Serialize>(answer: &crate::http_support::Answer) -> Outcome {
    if answer.status < 300 {
        let body = if answer.body.is_empty() { &b"{}"[..] } else { &answer.body };
        return Ok(told(&serde_json::from_slice::<T>(body).unwrap()));
    }
    let problem: Problem = serde_json::from_slice(&answer.body).unwrap();
    let retry = answer.header("retry-after").map(|seconds| seconds.parse().unwrap());
    Err(refusal(problem.code, problem.field, problem.detail, retry))
}

fn grpc(site: &Site, mut client: Client, call: &Call) -> Outcome {
    fn of<T: Serialize>(answer: Result<tonic::Response<T>, Status>) -> Outcome {
        answer.map(|response| told(response.get_ref())).map_err(|status| of_status(&status))
    }
    if let Call::Broken(bytes) = call {
        let (_, trailers) = site.web("GetClasses", bytes);
        let pairs = trailers.iter().map(|(name, value)| (name.parse().unwrap(), value.parse().unwrap()));
        let headers: tonic::codegen::http::HeaderMap = pairs.collect();
        return Err(of_status(&Status::from_header_map(&headers).unwrap()));
    }
    if let Call::Nothing = call {
        let (_, trailers) = site.web("Nothing", b"");
        let pairs = trailers.iter().map(|(name, value)| (name.parse().unwrap(), value.parse().unwrap()));
        let headers: tonic::codegen::http::HeaderMap = pairs.collect();
        return Err(of_status(&Status::from_header_map(&headers).unwrap()));
    }
    site.run(async {
        match call.clone() {
            Call::CreateMap(r) => of(client.create_map(r).await),
            Call::GetMap(r) => of(client.get_map(r).await),
            Call::ListMaps => of(client.list_maps(v1::ListMapsRequest {}).await),
            Call::DeleteMap(r) => of(client.delete_map(r).await),
            Call::InsertScans(r) => of(client.insert_scans(r).await),
            Call::GetClasses(r) => of(client.get_classes(r).await),
            Call::GetRegion(r) => of(client.get_region(r).await),
            Call::GetGrid(r) => of(client.get_grid(r).await),
            Call::GetTile(r) => of(client.get_tile(r).await),
            Call::CheckGuaranteedFree(r) => of(client.check_guaranteed_free(r).await),
            Call::GetChanges(r) => of(client.get_changes(r).await),
            Call::ListRobots(r) => of(client.list_robots(r).await),
            Call::CreateSnapshot(r) => of(client.create_snapshot(r).await),
            Call::ListSnapshots(r) => of(client.list_snapshots(r).await),
            Call::RestoreSnapshot(r) => of(client.restore_snapshot(r).await),
            Call::DeleteSnapshot(r) => of(client.delete_snapshot(r).await),
            Call::ExportMap(r) => {
                let mut pieces = client.export_map(r).await.map_err(|status| of_status(&status))?.into_inner();
                let (mut revision, mut file) = (0, Vec::new());
                while let Some(piece) = pieces.message().await.unwrap() {
                    assert!(!piece.data.is_empty() && piece.data.len() <= 65_536, "{}", piece.data.len());
                    revision = piece.revision;
                    file.extend_from_slice(&piece.data);
                }
                Ok(told_file(revision, &file))
            }
            Call::ImportMap(map, file) => of(client.import_map(tokio_stream::iter(pieces(&map, &file))).await),
            Call::Broken(_) | Call::Nothing => panic!("taken above"),
        }
    })
}

/// A file as messages; only the first names the map.
pub fn pieces(map: &str, file: &[u8]) -> Vec<v1::ImportMapRequest> {
    let mut pieces = vec![v1::ImportMapRequest { map: map.to_owned(), data: Vec::new() }];
    pieces.extend(file.chunks(8192).map(|data| v1::ImportMapRequest { map: String::new(), data: data.to_vec() }));
    pieces
}

fn of_status(status: &Status) -> Refusal {
    assert_ne!(status.code(), Code::Ok);
    let details = status.get_error_details();
    let violations = details.bad_request().map(|request| request.field_violations.clone()).unwrap_or_default();
    let field = violations.first().map(|violation| violation.field.clone());
    let retry = details.retry_info().and_then(|info| info.retry_delay).map(|delay| delay.as_secs());
    refusal(details.error_info().unwrap().reason.clone(), field, status.message().to_owned(), retry)
}

async fn over_zenoh(session: &Session, call: &Call) -> Outcome {
    let map = |name: &str, rest: &str| format!("ubbmap/{name}{rest}");
    match call {
        Call::CreateMap(r) => zenoh_call::<v1::CreateMapResponse>(session, &map(&r.map, "/create"), r).await,
        Call::GetMap(r) => zenoh_call::<v1::GetMapResponse>(session, &map(&r.map, ""), r).await,
        Call::ListMaps => zenoh_call::<v1::ListMapsResponse>(session, "ubbmap/*", &v1::ListMapsRequest {}).await,
        Call::DeleteMap(r) => zenoh_call::<v1::DeleteMapResponse>(session, &map(&r.map, "/delete"), r).await,
        Call::InsertScans(r) => {
            let robot = r.scans.first().map_or("amr-7", |scan| scan.robot.as_str());
            zenoh_call::<v1::InsertScansResponse>(session, &map(&r.map, &format!("/insert/{robot}")), r).await
        }
        Call::GetClasses(r) => zenoh_call::<v1::GetClassesResponse>(session, &map(&r.map, "/classes"), r).await,
        Call::GetRegion(r) => zenoh_call::<v1::GetRegionResponse>(session, &map(&r.map, "/region"), r).await,
        Call::GetGrid(r) => zenoh_call::<v1::GetGridResponse>(session, &map(&r.map, "/grid"), r).await,
        Call::GetTile(r) => {
            let rest = format!("/tiles/{}/{}/{}", r.z, r.x, r.y);
            let snapshot = if r.snapshot.is_empty() { String::new() } else { format!("?snapshot={}", r.snapshot) };
            zenoh_bytes::<v1::GetTileResponse>(session, &map(&r.map, &(rest + &snapshot)), b"").await
        }
        Call::CheckGuaranteedFree(r) => {
            zenoh_call::<v1::CheckGuaranteedFreeResponse>(session, &map(&r.map, "/guaranteed-free"), r).await
        }
        Call::GetChanges(r) => zenoh_call::<v1::GetChangesResponse>(session, &map(&r.map, "/changes"), r).await,
        Call::ListRobots(r) => zenoh_call::<v1::ListRobotsResponse>(session, &map(&r.map, "/robots"), r).await,
        Call::Broken(bytes) => zenoh_bytes::<v1::GetClassesResponse>(session, &map("hall", "/classes"), bytes).await,
        Call::Nothing => zenoh_bytes::<v1::ListSnapshotsResponse>(session, &map("hall", "/nothing"), b"").await,
        other => panic!("not on Zenoh: {other:?}"),
    }
}

async fn zenoh_call<T: Message + Default + Serialize>(
    session: &Session,
    selector: &str,
    request: &impl Message,
) -> Outcome {
    zenoh_bytes::<T>(session, selector, &request.encode_to_vec()).await
}

async fn zenoh_bytes<T: Message + Default + Serialize>(session: &Session, selector: &str, payload: &[u8]) -> Outcome {
    match ask(session, selector, payload).await.expect("nobody answered") {
        Ok(bytes) => Ok(told(&T::decode(&bytes[..]).unwrap())),
        Err(error) => Err(refusal(error.code, error.field, error.detail, error.retry_after.map(u64::from))),
    }
}
