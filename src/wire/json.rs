//! proto3 JSON with errors that name the field.

use crate::service::{ErrorKind, ServiceError};
use serde::de::{DeserializeOwned, Deserializer, IgnoredAny, MapAccess, SeqAccess, Visitor};
use serde_path_to_error::{Path, Segment};
use std::fmt;

/// Longest message of a parser that is passed on, characters: it may quote what was sent.
const MAX_DETAIL: usize = 500;

/// A message from its JSON. `prefix` stands before the field's path in errors; may be empty.
///
/// # Errors
/// [`ErrorKind::InvalidRequest`] at the field where the text is not JSON, a field is unknown or a value does not fit.
pub fn from_slice<T: DeserializeOwned>(bytes: &[u8], prefix: &str) -> Result<T, ServiceError> {
    // The path costs time at every value, so it is looked for only once there is an error.
    let plain = match serde_json::from_slice(bytes) {
        Ok(value) => return Ok(value),
        Err(error) => error,
    };
    let mut parser = serde_json::Deserializer::from_slice(bytes);
    let path = match serde_path_to_error::deserialize::<_, T>(&mut parser) {
        Ok(_) => String::new(),
        Err(error) => display(error.path()),
    };
    let detail: String = format!("the JSON is not valid: {plain}").chars().take(MAX_DETAIL).collect();
    let error = ServiceError::new(ErrorKind::InvalidRequest, detail);
    Err(match (prefix, path.as_str()) {
        ("", "") => error,
        (prefix, "") => error.at(prefix),
        ("", path) => error.at(path),
        (prefix, path) => error.at(format!("{prefix}.{path}")),
    })
}

/// The first key of a JSON object, as written; `None` where there is none.
pub fn first_key(bytes: &[u8]) -> Option<&[u8]> {
    let rest = bytes.trim_ascii_start().strip_prefix(b"{")?.trim_ascii_start().strip_prefix(b"\"")?;
    let end = rest.iter().position(|b| *b == b'"')?;
    Some(&rest[..end])
}

/// How many elements the list at a top-level key has; 0 where there is no such list or the JSON is broken, which
/// the parser proper will say.
pub fn count_elements(bytes: &[u8], key: &str) -> usize {
    let mut parser = serde_json::Deserializer::from_slice(bytes);
    parser.deserialize_map(CountIn(key)).unwrap_or(0)
}

struct CountIn<'a>(&'a str);

impl<'de> Visitor<'de> for CountIn<'_> {
    type Value = usize;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("an object")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<usize, A::Error> {
        let mut count = 0;
        while let Some(key) = map.next_key::<String>()? {
            if key == self.0 {
                count += map.next_value::<Count>()?.0;
            } else {
                map.next_value::<IgnoredAny>()?;
            }
        }
        Ok(count)
    }
}

/// The length of a list, its elements passed over.
struct Count(usize);

impl<'de> serde::Deserialize<'de> for Count {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_seq(Count(0))
    }
}

impl<'de> Visitor<'de> for Count {
    type Value = Self;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a list")
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut seq: A) -> Result<Self, A::Error> {
        let mut count = 0;
        while seq.next_element::<IgnoredAny>()?.is_some() {
            count += 1;
        }
        Ok(Self(count))
    }
}

/// A path as the interface writes it: `scans[2].pose.x`, `sensors[default].range_max`.
fn display(path: &Path) -> String {
    let mut text = String::new();
    let mut named = false;
    for segment in path {
        match segment {
            Segment::Seq { index } => text.push_str(&format!("[{index}]")),
            Segment::Map { key } => {
                let key: String = key.chars().take(80).collect();
                if named {
                    text.push_str(&format!("[{key}]"));
                } else {
                    if !text.is_empty() {
                        text.push('.');
                    }
                    text.push_str(&key);
                }
                // Sensors are the one map of names.
                named = key == "sensors" && !named;
            }
            Segment::Enum { .. } | Segment::Unknown => {}
        }
    }
    text
}
