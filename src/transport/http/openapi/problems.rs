//! Errors in the description, all from the one error table.

use super::document::{ANYWHERE, reference};
use crate::service::ErrorKind;
use crate::transport::http::problem::{PROBLEM_JSON, Problem};
use crate::transport::status::status;
use serde_json::{Map, Value, json};

/// The schema of a problem; `code` is one of the words of the error table.
pub fn schema() -> Value {
    let codes: Vec<_> = ErrorKind::ALL.iter().map(|kind| kind.code()).collect();
    let word = |text: &str| json!({ "type": "string", "description": text });
    json!({
        "type": "object",
        "description": "An error (RFC 9457).",
        "required": ["type", "title", "status", "detail", "code"],
        "properties": {
            "type": word("Names the kind of problem: `urn:ubbmap:problem:map-not-found`."),
            "title": word("The same for every occurrence of the kind."),
            "status": { "type": "integer", "format": "int32", "description": "The status code of HTTP." },
            "detail": word("What is wrong here, for people."),
            "code": { "type": "string", "enum": codes, "description": "A stable word, for programs." },
            "field": word("The field at fault, in the request's own words."),
        },
    })
}

/// A response that is one of these errors.
pub fn response(kinds: &[ErrorKind]) -> Value {
    let lines: Vec<_> = kinds.iter().map(|kind| format!("- `{}`: {}.", kind.code(), status(*kind).title)).collect();
    let mut all = json!({
        "description": lines.join("\n"),
        "content": { PROBLEM_JSON: { "schema": reference("Problem"), "examples": examples(kinds) } },
    });
    if kinds.iter().any(|kind| status(*kind).retry_after.is_some()) {
        all["headers"] = json!({ "Retry-After": {
            "description": "After how many seconds the same may be tried again.",
            "schema": { "type": "integer", "format": "int32", "minimum": 1 },
        } });
    }
    all
}

fn examples(kinds: &[ErrorKind]) -> Value {
    let example = |kind: &ErrorKind| {
        let problem = Problem::example(*kind);
        (kind.code().to_owned(), json!({ "value": problem }))
    };
    Value::Object(kinds.iter().map(example).collect())
}

/// The responses that any operation may have, by name.
pub fn shared() -> Value {
    let shared = ANYWHERE.iter().map(|code| (name(*code).to_owned(), kinds(*code)));
    Value::Object(
        shared
            .filter(|(_, kinds)| !kinds.is_empty())
            .map(|(name, kinds)| (name, response(&kinds)))
            .collect::<Map<_, _>>(),
    )
}

/// The errors of a status.
pub fn kinds(code: u16) -> Vec<ErrorKind> {
    ErrorKind::ALL.iter().copied().filter(|kind| status(*kind).http == code).collect()
}

/// What a response of all operations is called.
pub fn name(code: u16) -> &'static str {
    match code {
        401 => "Unauthenticated",
        403 => "Forbidden",
        429 => "Busy",
        431 => "HeadersTooLarge",
        503 => "Unavailable",
        _ => "Failed",
    }
}
