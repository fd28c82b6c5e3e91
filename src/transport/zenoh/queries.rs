//! Queries: from a key, parameters and a payload to the operation, and back.

use super::keys::{Operation, Target};
use super::reply::Reply;
use crate::service::{ErrorKind, ServiceError};
use crate::store::MapName;
use crate::transport::access::OnBehalf;
use crate::transport::operations;
use crate::transport::parameters::{Parameters, parse};
use crate::wire::{self, v1};
use prost::Message;

/// Names of parameters that begin so are Zenoh's own, such as `_time`.
const RESERVED: char = '_';

const BOX: [&str; 6] = ["min_x", "min_y", "max_x", "max_y", "depth", "snapshot"];
const CHANGES: [&str; 7] = ["since", "min_x", "min_y", "max_x", "max_y", "depth", "contents"];

/// A query as it came.
#[derive(Debug)]
pub struct Asked<'a> {
    /// What its key names.
    pub target: Target,
    /// What stands behind the question mark.
    pub parameters: &'a str,
    /// Its payload; empty where it has none.
    pub payload: &'a [u8],
}

/// Answers a query.
///
/// # Errors
/// Those of the operations, and [`ErrorKind::InvalidRequest`] where the query is not one of the interface.
pub async fn answer(service: &OnBehalf, asked: Asked<'_>) -> Result<Reply, ServiceError> {
    match asked.target {
        Target::Maps => {
            parameters(asked.parameters, &[])?;
            Ok(Reply::new("ListMapsResponse", &operations::list_maps(service).await?))
        }
        Target::Map(map) => {
            parameters(asked.parameters, &[])?;
            let request: v1::GetMapRequest = wire::message(asked.payload)?;
            wire::same_map(&map, &request.map)?;
            let request = v1::GetMapRequest { map: map.to_string() };
            Ok(Reply::new("GetMapResponse", &operations::get_map(service, request).await?))
        }
        Target::Operation(map, operation) => operate(service, map, operation, asked.parameters, asked.payload).await,
    }
}

async fn operate(
    service: &OnBehalf,
    map: MapName,
    operation: Operation,
    text: &str,
    payload: &[u8],
) -> Result<Reply, ServiceError> {
    match operation {
        Operation::Tile(address) => tile(service, map, address, text).await,
        Operation::Region => region(service, map, text, payload).await,
        Operation::Grid => grid(service, map, text, payload).await,
        Operation::Changes => changes(service, map, text, payload).await,
        other => {
            parameters(text, &[])?;
            plain(service, map, other, payload).await
        }
    }
}

/// Operations without parameters.
async fn plain(service: &OnBehalf, map: MapName, operation: Operation, payload: &[u8]) -> Result<Reply, ServiceError> {
    match operation {
        Operation::Create => {
            let request = of_map(&map, payload, |request: &mut v1::CreateMapRequest| &mut request.map)?;
            Ok(Reply::new("CreateMapResponse", &operations::create_map(service, request).await?))
        }
        Operation::Delete => {
            let request = of_map(&map, payload, |request: &mut v1::DeleteMapRequest| &mut request.map)?;
            Ok(Reply::new("DeleteMapResponse", &operations::delete_map(service, request).await?))
        }
        Operation::Insert(robot) => {
            let request = of_map(&map, payload, |request: &mut v1::InsertScansRequest| &mut request.map)?;
            let most = service.settings().max_scans_per_request;
            if request.scans.len() > most {
                let detail = format!("the request has {} scans, the limit is {most}", request.scans.len());
                return Err(ServiceError::new(ErrorKind::TooManyScans, detail).at("scans"));
            }
            let mut batch = wire::Batch::of_robot(request.scans, &robot);
            let answer = service.insert(&map, batch.take_scans()).await?;
            Ok(Reply::new("InsertScansResponse", &batch.response(answer)))
        }
        Operation::Classes => {
            let request = of_map(&map, payload, |request: &mut v1::GetClassesRequest| &mut request.map)?;
            Ok(Reply::new("GetClassesResponse", &operations::get_classes(service, request).await?))
        }
        Operation::GuaranteedFree => {
            let request = of_map(&map, payload, |request: &mut v1::CheckGuaranteedFreeRequest| &mut request.map)?;
            let response = operations::check_guaranteed_free(service, request).await?;
            Ok(Reply::new("CheckGuaranteedFreeResponse", &response))
        }
        Operation::Robots => {
            let request = of_map(&map, payload, |request: &mut v1::ListRobotsRequest| &mut request.map)?;
            Ok(Reply::new("ListRobotsResponse", &operations::list_robots(service, request).await?))
        }
        // The match above takes these.
        Operation::Tile(_) | Operation::Region | Operation::Grid | Operation::Changes => {
            Err(ServiceError::new(ErrorKind::Internal, "the server failed to answer the query"))
        }
    }
}

async fn tile(service: &OnBehalf, map: MapName, [z, x, y]: [String; 3], text: &str) -> Result<Reply, ServiceError> {
    let snapshot = parameters(text, &["snapshot"])?.snapshot()?.to_owned();
    let number = |name: &str, text: &str| parse(name, text, "a whole number");
    let (z, x, y) = (number("z", &z)?, number("x", &x)?, number("y", &y)?);
    let request = v1::GetTileRequest { map: map.to_string(), z, x, y, snapshot };
    Ok(Reply::new("GetTileResponse", &operations::get_tile(service, request).await?))
}

async fn region(service: &OnBehalf, map: MapName, text: &str, payload: &[u8]) -> Result<Reply, ServiceError> {
    let mut request = of_map(&map, payload, |request: &mut v1::GetRegionRequest| &mut request.map)?;
    let parameters = parameters(text, &BOX)?;
    let given = parameters.box_query()?;
    request.min_x = given.min_x.or(request.min_x);
    request.min_y = given.min_y.or(request.min_y);
    request.max_x = given.max_x.or(request.max_x);
    request.max_y = given.max_y.or(request.max_y);
    request.depth = given.depth.or(request.depth);
    over(&mut request.snapshot, parameters.snapshot()?);
    Ok(Reply::new("GetRegionResponse", &operations::get_region(service, request).await?))
}

async fn grid(service: &OnBehalf, map: MapName, text: &str, payload: &[u8]) -> Result<Reply, ServiceError> {
    let mut request = of_map(&map, payload, |request: &mut v1::GetGridRequest| &mut request.map)?;
    let parameters = parameters(text, &BOX)?;
    let given = parameters.box_query()?;
    request.min_x = given.min_x.or(request.min_x);
    request.min_y = given.min_y.or(request.min_y);
    request.max_x = given.max_x.or(request.max_x);
    request.max_y = given.max_y.or(request.max_y);
    request.depth = given.depth.or(request.depth);
    over(&mut request.snapshot, parameters.snapshot()?);
    Ok(Reply::new("GetGridResponse", &operations::get_grid(service, request).await?))
}

async fn changes(service: &OnBehalf, map: MapName, text: &str, payload: &[u8]) -> Result<Reply, ServiceError> {
    let mut request = of_map(&map, payload, |request: &mut v1::GetChangesRequest| &mut request.map)?;
    let parameters = parameters(text, &CHANGES)?;
    let given = parameters.box_query()?;
    request.since = parameters.number("since", "a revision, a whole number")?.unwrap_or(request.since);
    request.min_x = given.min_x.or(request.min_x);
    request.min_y = given.min_y.or(request.min_y);
    request.max_x = given.max_x.or(request.max_x);
    request.max_y = given.max_y.or(request.max_y);
    request.depth = given.depth.or(request.depth);
    request.contents |= parameters.flag("contents")?;
    Ok(Reply::new("GetChangesResponse", &operations::get_changes(service, request).await?))
}

/// What a parameter says stands above what the message says.
fn over(field: &mut String, given: &str) {
    if !given.is_empty() {
        given.clone_into(field);
    }
}

/// A request message whose map is the key's.
fn of_map<T: Message + Default>(
    map: &MapName,
    payload: &[u8],
    field: impl Fn(&mut T) -> &mut String,
) -> Result<T, ServiceError> {
    let mut request: T = wire::message(payload)?;
    let named = field(&mut request);
    wire::same_map(map, named)?;
    *named = map.to_string();
    Ok(request)
}

/// Parameters as Zenoh writes them (`a=1;b=2`), or as a URL does (`a=1&b=2`).
fn parameters(text: &str, known: &[&str]) -> Result<Parameters, ServiceError> {
    let pairs = text
        .split([';', '&'])
        .filter(|pair| !pair.is_empty() && !pair.starts_with(RESERVED))
        .map(|pair| pair.split_once('=').unwrap_or((pair, "")))
        .map(|(name, value)| (name.to_owned(), value.to_owned()));
    Parameters::new(pairs.collect(), known)
}
