//! The description put together: operations, schemas, errors, examples.

use super::operation::{Body, Content, Operation};
use super::parameter::{Kind, Parameter, Place};
use super::problems;
use super::schema::Messages;
use super::table::{OPERATIONS, TAGS};
use crate::service::ErrorKind;
use crate::transport::http::{accept, lines, rasters};
use crate::transport::status::status;
use crate::wire;
use serde_json::{Map, Value, json};
use std::collections::BTreeMap;

/// Examples of messages, by name.
const EXAMPLES: &str = include_str!("examples.json");

const ABOUT: &str = "Robots send 2-D laser scans with interval poses; the server keeps k-class occupancy quadtrees \
    and says what in them is guaranteed to be free.\n\nJSON is the proto3 JSON of the messages of `proto/ubbmap/v1`, \
    which gRPC (on this port) and Zenoh carry too: fields with default values are written out, integers of 64 bits \
    are texts, bytes are base64, a field that is not known is refused by its name. Requests may also write names in \
    camelCase, numbers as texts and integers of 64 bits as numbers. Bodies may come as `gzip`.\n\nErrors are RFC \
    9457 problems; `code` is a stable word for programs, `detail` is for people, `field` names what is at fault. \
    Where the same may succeed later, `Retry-After` says when.";

/// Statuses whose errors any operation of the interface may have: no operation lists them.
pub const ANYWHERE: [u16; 6] = [401, 403, 429, 431, 500, 503];

/// The description as OpenAPI 3.0.3: what generators and testers of all kinds read.
///
/// # Errors
/// When the interface's descriptors or the examples cannot be read, which a test holds them to.
pub fn document() -> Result<Value, Box<dyn std::error::Error>> {
    let messages = Messages::read(wire::DESCRIPTORS)?;
    let examples: Map<String, Value> = serde_json::from_str(EXAMPLES)?;
    let mut schemas = messages.schemas(&requests(), &answers());
    schemas.insert("Problem".to_owned(), problems::schema());
    schemas.insert(
        "Health".to_owned(),
        json!({
            "type": "object",
            "required": ["status"],
            "properties": {
                "status": { "type": "string", "enum": ["ok", "ready"] },
                "insecure": { "type": "boolean", "description": "Strangers reach the server and may do all." },
                "warning": { "type": "string" },
            },
        }),
    );
    schemas.insert(
        "Index".to_owned(),
        json!({
            "type": "object",
            "required": ["name", "version", "routes"],
            "properties": {
                "name": { "type": "string" },
                "version": { "type": "string" },
                "routes": { "type": "array", "items": { "type": "string" } },
            },
        }),
    );
    schemas.insert("Description".to_owned(), json!({ "type": "object", "description": "An OpenAPI description." }));
    let mut paths = Map::new();
    for operation in OPERATIONS {
        let path = paths.entry(operation.shown_path()).or_insert_with(|| json!({}));
        path[operation.method.word().to_lowercase()] = described(operation, &examples);
    }
    let tags: Vec<Value> = TAGS.iter().map(|(name, text)| json!({ "name": name, "description": text })).collect();
    Ok(json!({
        "openapi": "3.0.3",
        "info": {
            "title": "ubbmap",
            "version": env!("CARGO_PKG_VERSION"),
            "description": ABOUT,
            "license": { "name": "MIT OR Apache-2.0" },
        },
        "tags": tags,
        "paths": paths,
        "components": {
            "schemas": schemas,
            "responses": problems::shared(),
            "securitySchemes": { "token": {
                "type": "http",
                "scheme": "bearer",
                "description": "Where the server has tokens: `Authorization: Bearer TOKEN`.",
            } },
        },
        // With a token or without: which of the two is the server's to say.
        "security": [{}, { "token": [] }],
    }))
}

/// Messages that bodies of requests are.
fn requests() -> Vec<&'static str> {
    let of = |operation: &&Operation| match operation.body {
        Body::Message(name) | Body::Maybe(name) => vec![name],
        Body::Config => vec!["CreateMapRequest", "MapConfig"],
        Body::Scans => vec!["InsertScansRequest", "Scan"],
        Body::None | Body::File => vec![],
    };
    OPERATIONS.iter().flat_map(of).collect()
}

/// Messages that answers are.
fn answers() -> Vec<&'static str> {
    let of = |content: &Content| match content {
        Content::Message(name) => vec![*name],
        Content::Acknowledgements => vec!["InsertScansResponse", "StreamScansResponse"],
        Content::Raster => vec!["GetGridResponse"],
        Content::Tile => vec!["GetTileResponse"],
        Content::Events => vec!["WatchMapResponse"],
        _ => vec![],
    };
    OPERATIONS.iter().flat_map(|operation| operation.answers).flat_map(|(_, content)| of(content)).collect()
}

fn described(operation: &Operation, examples: &Map<String, Value>) -> Value {
    let mut all = json!({
        "operationId": operation.id,
        "tags": [operation.tag],
        "summary": operation.summary,
        "responses": responses(operation, examples),
    });
    if !operation.text.is_empty() {
        all["description"] = json!(operation.text);
    }
    if !operation.parameters.is_empty() {
        all["parameters"] = operation.parameters.iter().map(parameter).collect();
    }
    if let Some(body) = request_body(operation, examples) {
        all["requestBody"] = body;
    }
    if !operation.versioned() && !operation.refused.contains(&ErrorKind::Unauthenticated) {
        // Health, metrics and this description are for all who reach the server.
        all["security"] = json!([]);
    }
    all
}

fn parameter(parameter: &Parameter) -> Value {
    let (place, example) = (parameter.place, parameter.example);
    let schema = match parameter.kind {
        Kind::Metres => json!({ "type": "number", "format": "double" }),
        Kind::Whole(least, most) => {
            json!({ "type": "integer", "format": "int64", "minimum": least, "maximum": most })
        }
        Kind::Revision => json!({ "type": "integer", "minimum": 0, "maximum": u64::MAX }),
        Kind::Flag => json!({ "type": "boolean", "default": false }),
        Kind::Word(words) => json!({ "type": "string", "enum": words }),
        Kind::Name(rule) => json!({ "type": "string", "pattern": rule }),
        Kind::Text => json!({ "type": "string" }),
    };
    let mut all = json!({
        "name": parameter.name,
        "in": match place { Place::Path => "path", Place::Query => "query", Place::Header => "header" },
        "required": parameter.required,
        "description": parameter.text,
        "schema": schema,
    });
    if let Some(example) = example {
        // As a number where it is one.
        all["example"] = match parameter.kind {
            Kind::Whole(..) | Kind::Revision => example.parse::<u64>().map_or(json!(example), |number| json!(number)),
            _ => json!(example),
        };
    }
    all
}

/// A reference to a schema.
pub fn reference(name: &str) -> Value {
    json!({ "$ref": format!("#/components/schemas/{name}") })
}

fn binary() -> Value {
    json!({ "schema": { "type": "string", "format": "binary" } })
}

fn request_body(operation: &Operation, examples: &Map<String, Value>) -> Option<Value> {
    let example = |name: &str| examples.get(name).cloned().unwrap_or_default();
    let named = |name: &str| json!({ "value": example(name) });
    let (required, content) = match operation.body {
        Body::None => return None,
        Body::Message(name) | Body::Maybe(name) => (
            matches!(operation.body, Body::Message(_)),
            json!({
                accept::JSON: { "schema": reference(name), "example": example(name) },
                accept::PROTOBUF: binary(),
            }),
        ),
        Body::Config => (
            false,
            json!({
                accept::JSON: {
                    "schema": { "anyOf": [reference("MapConfig"), reference("CreateMapRequest")] },
                    "examples": { "configuration": named("MapConfig"), "request": named("CreateMapRequest") },
                },
                accept::PROTOBUF: binary(),
            }),
        ),
        Body::Scans => (
            true,
            json!({
                accept::JSON: {
                    "schema": { "anyOf": [reference("InsertScansRequest"), reference("Scan")] },
                    "examples": { "scans": named("InsertScansRequest"), "scan": named("Scan") },
                },
                lines::NDJSON: {
                    "schema": { "type": "string", "description": "One `Scan` a line." },
                    "example": format!("{}\n", example("Scan")),
                },
                accept::PROTOBUF: binary(),
            }),
        ),
        Body::File => (true, json!({ "application/octet-stream": binary() })),
    };
    Some(json!({ "required": required, "content": content }))
}

fn responses(operation: &Operation, examples: &Map<String, Value>) -> Value {
    let mut all = Map::new();
    for (code, content) in operation.answers {
        all.insert(code.to_string(), answer(*code, *content, examples));
    }
    let mut by_status: BTreeMap<u16, Vec<ErrorKind>> = BTreeMap::new();
    for kind in operation.refused {
        by_status.entry(status(*kind).http).or_default().push(*kind);
    }
    for (code, kinds) in by_status {
        all.insert(code.to_string(), problems::response(&kinds));
    }
    let anywhere = if operation.versioned() { &ANYWHERE[..] } else { &[429, 431, 500, 503] };
    for code in anywhere.iter().filter(|code| !problems::kinds(**code).is_empty()) {
        all.insert(code.to_string(), json!({ "$ref": format!("#/components/responses/{}", problems::name(*code)) }));
    }
    Value::Object(all)
}

fn answer(code: u16, content: Content, examples: &Map<String, Value>) -> Value {
    let json_of = |name: &str| {
        let mut media = json!({ "schema": reference(name) });
        if let Some(example) = examples.get(name) {
            media["example"] = example.clone();
        }
        media
    };
    let text = || json!({ "schema": { "type": "string" } });
    let told = |text: &str| json!({ "schema": { "type": "string", "description": text } });
    let content = match content {
        Content::None => None,
        Content::Message(name) => Some(json!({ accept::JSON: json_of(name), accept::PROTOBUF: binary() })),
        Content::Json(name) => Some(json!({ accept::JSON: json_of(name) })),
        Content::Acknowledgements => Some(json!({
            accept::JSON: json_of("InsertScansResponse"),
            accept::PROTOBUF: binary(),
            lines::NDJSON: told("One `StreamScansResponse` a scan; a `Problem` where an error ends the stream."),
        })),
        Content::Raster => Some(json!({
            accept::JSON: json_of("GetGridResponse"),
            accept::PROTOBUF: binary(),
            rasters::NPY: binary(),
            rasters::PNG: binary(),
        })),
        Content::Tile => Some(json!({ rasters::PNG: binary(), rasters::NPY: binary(), accept::PROTOBUF: binary() })),
        Content::Events => {
            let events = "Events `changes`, each with a `WatchMapResponse` as JSON and the revision as its id; an \
                event `end` with a `Problem` where the server ends the stream.";
            Some(json!({
                "text/event-stream": told(events),
                lines::NDJSON: told("One `WatchMapResponse` a line."),
            }))
        }
        Content::File => Some(json!({ "application/octet-stream": binary(), "application/zip": binary() })),
        Content::Metrics => Some(json!({ "text/plain": text() })),
        Content::Page => Some(json!({ "text/html": text() })),
        Content::Index => Some(json!({ accept::JSON: json_of("Index"), "text/html": text() })),
    };
    let description = match code {
        201 => "Made.",
        204 => "Done.",
        304 => "The client has it.",
        _ => "The answer.",
    };
    let mut all = json!({ "description": description });
    if let Some(content) = content {
        all["content"] = content;
    }
    all
}
