//! Requests from their bytes, each list held to its limit before memory is spent on it.

use super::{json, v1};
use crate::service::{ErrorKind, ServiceError, setting};
use prost::Message;
use serde::de::DeserializeOwned;

/// Bodies up to this many bytes are decoded without counting first: what they can unfold to is small.
const COUNT_ABOVE: usize = 64 * 1024;

/// Most elements that the lists of a larger message may have together, whatever is configured: an empty element takes
/// two bytes on the wire and some hundred in memory.
const MOST_ELEMENTS: usize = 1 << 17;

/// How a request is encoded.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Encoding {
    /// proto3 JSON.
    Json,
    /// The message's own bytes.
    Protobuf,
}

/// A list of a request and how long it may be.
#[derive(Debug, Clone, Copy)]
struct Limit {
    field: &'static str,
    number: u32,
    most: usize,
    kind: ErrorKind,
    setting: &'static str,
}

/// The request of `InsertScans`; in JSON also one bare scan.
///
/// # Errors
/// [`ErrorKind::InvalidRequest`] at the field, [`ErrorKind::TooManyScans`].
pub fn insert_request(bytes: &[u8], encoding: Encoding, most: usize) -> Result<v1::InsertScansRequest, ServiceError> {
    if encoding == Encoding::Json && !matches!(json::first_key(bytes), Some(b"scans" | b"map")) {
        let scan = json::from_slice(bytes, "")?;
        return Ok(v1::InsertScansRequest { map: String::new(), scans: vec![scan] });
    }
    let limit =
        Limit { field: "scans", number: 2, most, kind: ErrorKind::TooManyScans, setting: setting::SCANS_PER_REQUEST };
    limited(bytes, encoding, limit, |request: &v1::InsertScansRequest| request.scans.len())
}

/// Scans from lines of JSON; blank lines are passed over.
///
/// # Errors
/// [`ErrorKind::InvalidRequest`] naming the line, [`ErrorKind::TooManyScans`].
pub fn scan_lines(bytes: &[u8], most: usize) -> Result<Vec<v1::Scan>, ServiceError> {
    let mut scans = Vec::new();
    for (number, line) in bytes.split(|b| *b == b'\n').enumerate() {
        if line.trim_ascii().is_empty() {
            continue;
        }
        if scans.len() == most {
            let (kind, setting) = (ErrorKind::TooManyScans, setting::SCANS_PER_REQUEST);
            return Err(too_many(kind, setting, "scans", format!("more than {most}"), most));
        }
        scans.push(scan_line(line, number, scans.len())?);
    }
    Ok(scans)
}

/// One line of JSON as a scan. `number` is the line's, `index` the scan's, from 0.
///
/// # Errors
/// [`ErrorKind::InvalidRequest`] naming the line.
pub fn scan_line(line: &[u8], number: usize, index: usize) -> Result<v1::Scan, ServiceError> {
    json::from_slice(line, &format!("scans[{index}]")).map_err(|mut error: ServiceError| {
        // Each line is a document of its own to the parser: its line number would contradict ours.
        let detail = error.detail.replace(" at line 1 column ", " at column ");
        error.detail = format!("line {}: {detail}", number + 1);
        error
    })
}

/// A message from its bytes.
///
/// # Errors
/// [`ErrorKind::InvalidRequest`] where they are no such message, or one with more elements than anything needs.
pub fn message<T: Message + Default>(bytes: &[u8]) -> Result<T, ServiceError> {
    if bytes.len() > COUNT_ABOVE && count_all_fields(bytes) > MOST_ELEMENTS {
        let detail = format!("the lists of the message have more than {MOST_ELEMENTS} elements, the limit");
        return Err(ServiceError::new(ErrorKind::InvalidRequest, detail));
    }
    protobuf(bytes)
}

/// A small request from its bytes.
///
/// # Errors
/// [`ErrorKind::InvalidRequest`] at the field.
pub fn request<T: Message + Default + DeserializeOwned>(bytes: &[u8], encoding: Encoding) -> Result<T, ServiceError> {
    match encoding {
        Encoding::Json => json::from_slice(bytes, ""),
        Encoding::Protobuf => message(bytes),
    }
}

/// The request of `CreateMap`; in JSON also the bare configuration, and nothing at all for the default one.
///
/// # Errors
/// [`ErrorKind::InvalidRequest`] at the field.
pub fn create_request(bytes: &[u8], encoding: Encoding) -> Result<v1::CreateMapRequest, ServiceError> {
    if encoding == Encoding::Protobuf {
        return protobuf(bytes);
    }
    if bytes.trim_ascii().is_empty() {
        return Ok(v1::CreateMapRequest::default());
    }
    if matches!(json::first_key(bytes), Some(b"config" | b"map")) {
        return json::from_slice(bytes, "");
    }
    Ok(v1::CreateMapRequest { map: String::new(), config: Some(json::from_slice(bytes, "config")?) })
}

/// The request of `GetClasses`.
///
/// # Errors
/// [`ErrorKind::InvalidRequest`] at the field, [`ErrorKind::TooManyPoints`].
pub fn classes_request(bytes: &[u8], encoding: Encoding, most: usize) -> Result<v1::GetClassesRequest, ServiceError> {
    let limit =
        Limit { field: "points", number: 2, most, kind: ErrorKind::TooManyPoints, setting: setting::POINTS_PER_QUERY };
    limited(bytes, encoding, limit, |request: &v1::GetClassesRequest| request.points.len())
}

/// The request of `CheckGuaranteedFree`.
///
/// # Errors
/// [`ErrorKind::InvalidRequest`] at the field, [`ErrorKind::TooManyRegions`].
pub fn free_request(
    bytes: &[u8],
    encoding: Encoding,
    most: usize,
) -> Result<v1::CheckGuaranteedFreeRequest, ServiceError> {
    let limit = Limit {
        field: "regions",
        number: 2,
        most,
        kind: ErrorKind::TooManyRegions,
        setting: setting::REGIONS_PER_QUERY,
    };
    limited(bytes, encoding, limit, |request: &v1::CheckGuaranteedFreeRequest| request.regions.len())
}

fn limited<T: Message + Default + DeserializeOwned>(
    bytes: &[u8],
    encoding: Encoding,
    limit: Limit,
    length: impl Fn(&T) -> usize,
) -> Result<T, ServiceError> {
    // A list of empty messages takes two or three bytes a message on the wire and some hundred in memory.
    if bytes.len() > COUNT_ABOVE {
        let count = match encoding {
            Encoding::Json => json::count_elements(bytes, limit.field),
            Encoding::Protobuf => count_fields(bytes, limit.number),
        };
        limit.check(count)?;
    }
    let request = match encoding {
        Encoding::Json => json::from_slice(bytes, "")?,
        Encoding::Protobuf => protobuf(bytes)?,
    };
    limit.check(length(&request))?;
    Ok(request)
}

impl Limit {
    fn check(self, count: usize) -> Result<(), ServiceError> {
        if count <= self.most {
            return Ok(());
        }
        Err(too_many(self.kind, self.setting, self.field, count.to_string(), self.most))
    }
}

fn too_many(
    kind: ErrorKind,
    setting: &'static str,
    field: &str,
    count: impl std::fmt::Display,
    most: usize,
) -> ServiceError {
    ServiceError::over(kind, setting, format!("the request has {count} {field}, the limit is {most}")).at(field)
}

fn protobuf<T: Message + Default>(bytes: &[u8]) -> Result<T, ServiceError> {
    T::decode(bytes).map_err(|error| {
        ServiceError::new(ErrorKind::InvalidRequest, format!("the protobuf message is not valid: {error}"))
    })
}

/// How often a length-delimited field stands at the top of a message; counts up to where the message is broken.
fn count_fields(bytes: &[u8], number: u32) -> usize {
    count_where(bytes, |tag| tag == number)
}

/// How many length-delimited fields stand at the top of a message.
fn count_all_fields(bytes: &[u8]) -> usize {
    count_where(bytes, |_| true)
}

fn count_where(mut bytes: &[u8], counted: impl Fn(u32) -> bool) -> usize {
    use prost::encoding::{DecodeContext, WireType, decode_key, skip_field};
    let mut count = 0;
    while !bytes.is_empty() {
        let Ok((tag, wire_type)) = decode_key(&mut bytes) else { return count };
        if counted(tag) && wire_type == WireType::LengthDelimited {
            count += 1;
        }
        if skip_field(wire_type, tag, &mut bytes, DecodeContext::default()).is_err() {
            return count;
        }
    }
    count
}
