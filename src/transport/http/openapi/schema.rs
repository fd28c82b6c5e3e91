//! The messages of the interface as schemas: their proto3 JSON, with the comments of `proto/` as descriptions.

use super::facts;
use prost::Message;
use prost_types::field_descriptor_proto::{Label, Type};
use prost_types::{
    DescriptorProto, EnumDescriptorProto, FieldDescriptorProto, FileDescriptorProto, FileDescriptorSet, MessageOptions,
};
use serde_json::{Map, Value, json};
use std::collections::{BTreeMap, BTreeSet};

/// What the path to a piece of a descriptor is made of (`descriptor.proto`).
mod number {
    pub const MESSAGE: i32 = 4;
    pub const ENUM: i32 = 5;
    pub const FIELD: i32 = 2;
    pub const VALUE: i32 = 2;
}

/// The messages and enums of the package, by name.
pub struct Messages {
    messages: BTreeMap<String, Described<DescriptorProto>>,
    enums: BTreeMap<String, Described<EnumDescriptorProto>>,
}

/// A piece of a file with the comments on it and on what is in it.
struct Described<T> {
    piece: T,
    text: String,
    /// One a field or value.
    parts: Vec<String>,
}

impl Messages {
    /// Reads the encoded descriptors.
    ///
    /// # Errors
    /// When they are none.
    pub fn read(descriptors: &[u8]) -> Result<Self, prost::DecodeError> {
        let set = FileDescriptorSet::decode(descriptors)?;
        let (mut messages, mut enums) = (BTreeMap::new(), BTreeMap::new());
        for file in set.file.iter().filter(|file| file.package() == "ubbmap.v1") {
            for (at, piece) in (0..).zip(&file.message_type) {
                let path = [number::MESSAGE, at];
                let parts = (0..).zip(&piece.field).map(|(part, _)| comment(file, &[path[0], at, number::FIELD, part]));
                let described = Described { piece: piece.clone(), text: comment(file, &path), parts: parts.collect() };
                messages.insert(piece.name().to_owned(), described);
            }
            for (at, piece) in (0..).zip(&file.enum_type) {
                let path = [number::ENUM, at];
                let parts = (0..).zip(&piece.value).map(|(part, _)| comment(file, &[path[0], at, number::VALUE, part]));
                let described = Described { piece: piece.clone(), text: comment(file, &path), parts: parts.collect() };
                enums.insert(piece.name().to_owned(), described);
            }
        }
        Ok(Self { messages, enums })
    }

    /// The schemas of these messages and of all that they hold. Those of `requests` say which fields there are and no
    /// others: the server refuses what it does not know.
    pub fn schemas(&self, requests: &[&str], answers: &[&str]) -> Map<String, Value> {
        let taken = self.reached(requests);
        let mut all = self.reached(answers);
        all.extend(taken.iter().cloned());
        let schema = |name: String| {
            let schema = match self.enums.get(&name) {
                Some(described) => enumeration(described),
                None => self.message(&name, taken.contains(&name)),
            };
            (name, schema)
        };
        all.into_iter().map(schema).collect()
    }

    /// Names of messages and enums that are in these, with these.
    fn reached(&self, roots: &[&str]) -> BTreeSet<String> {
        let mut found = BTreeSet::new();
        let mut next: Vec<String> = roots.iter().map(|name| (*name).to_owned()).collect();
        while let Some(name) = next.pop() {
            let Some(Described { piece, .. }) = self.messages.get(&name) else {
                found.insert(name);
                continue;
            };
            if found.insert(name) {
                let kind = |field: &FieldDescriptorProto| match entry(piece, field) {
                    Some(entry) => entry.field.iter().find_map(named_type),
                    None => named_type(field),
                };
                next.extend(piece.field.iter().filter_map(kind));
            }
        }
        found
    }

    fn message(&self, name: &str, taken: bool) -> Value {
        let Some(Described { piece, text, parts }) = self.messages.get(name) else { return json!({}) };
        let mut properties = Map::new();
        let mut required = Vec::new();
        for (field, text) in piece.field.iter().zip(parts) {
            let key = format!("{name}.{}", field.name());
            let mut schema = field_schema(piece, field);
            facts::add(&key, &mut schema);
            describe(&mut schema, text);
            properties.insert(field.name().to_owned(), schema);
            // What is not optional is written out in every answer; a request may leave it out.
            let written = !field.proto3_optional() && (field.r#type() != Type::Message || repeated(field));
            if facts::needed(&key) || (!taken && written && field.oneof_index.is_none()) {
                required.push(field.name().to_owned());
            }
        }
        let mut schema = json!({ "type": "object", "properties": properties });
        if !required.is_empty() {
            schema["required"] = json!(required);
        }
        if taken {
            schema["additionalProperties"] = json!(false);
        }
        if piece.field.iter().any(|field| field.oneof_index.is_some() && !field.proto3_optional()) {
            // Of a choice, exactly one.
            schema["minProperties"] = json!(1);
            schema["maxProperties"] = json!(1);
        }
        describe(&mut schema, text);
        schema
    }
}

/// The message that an entry of a map is, where the field is a map.
fn entry<'a>(message: &'a DescriptorProto, field: &FieldDescriptorProto) -> Option<&'a DescriptorProto> {
    let name = field.type_name().rsplit('.').next()?;
    let is_entry = |nested: &&DescriptorProto| {
        nested.name() == name && nested.options.as_ref().is_some_and(MessageOptions::map_entry)
    };
    message.nested_type.iter().find(is_entry)
}

fn named_type(field: &FieldDescriptorProto) -> Option<String> {
    field.type_name().rsplit('.').next().filter(|name| !name.is_empty()).map(str::to_owned)
}

fn repeated(field: &FieldDescriptorProto) -> bool {
    field.label() == Label::Repeated
}

fn field_schema(message: &DescriptorProto, field: &FieldDescriptorProto) -> Value {
    if let Some(entry) = entry(message, field) {
        let value = entry.field.iter().find(|field| field.name() == "value").map(single);
        return json!({ "type": "object", "additionalProperties": value });
    }
    if repeated(field) {
        return json!({ "type": "array", "items": single(field) });
    }
    single(field)
}

/// One value of a field's type (proto3 JSON).
fn single(field: &FieldDescriptorProto) -> Value {
    match field.r#type() {
        Type::Double => json!({ "type": "number", "format": "double" }),
        Type::Float => json!({ "type": "number", "format": "float" }),
        Type::Bool => json!({ "type": "boolean" }),
        Type::Bytes => json!({ "type": "string", "format": "byte" }),
        Type::Uint32 => json!({ "type": "integer", "format": "int64", "minimum": 0, "maximum": u32::MAX }),
        Type::Uint64 => json!({ "type": "string", "format": "uint64", "pattern": "^(0|[1-9][0-9]{0,19})$" }),
        Type::Message | Type::Enum => {
            json!({ "$ref": format!("#/components/schemas/{}", named_type(field).unwrap_or_default()) })
        }
        // The interface has no others; one that came without a row here would be shown as a text.
        _ => json!({ "type": "string" }),
    }
}

fn enumeration(described: &Described<EnumDescriptorProto>) -> Value {
    let names: Vec<&str> = described.piece.value.iter().map(prost_types::EnumValueDescriptorProto::name).collect();
    let mut text = described.text.clone();
    for (name, part) in names.iter().zip(&described.parts).filter(|(_, part)| !part.is_empty()) {
        text.push_str(&format!("\n- `{name}`: {part}"));
    }
    let mut schema = json!({ "type": "string", "enum": names });
    describe(&mut schema, &text);
    schema
}

/// Adds a description. OpenAPI 3.0 knows nothing beside a reference, so a described reference is one of one.
fn describe(schema: &mut Value, text: &str) {
    if text.is_empty() {
        return;
    }
    if schema.get("$ref").is_some() {
        *schema = json!({ "allOf": [schema.take()] });
    }
    schema["description"] = json!(text);
}

/// The comment before a piece of a file.
fn comment(file: &FileDescriptorProto, path: &[i32]) -> String {
    let locations = file.source_code_info.iter().flat_map(|info| &info.location);
    let text =
        locations.filter(|location| location.path == path).find_map(|location| location.leading_comments.clone());
    text.unwrap_or_default().lines().map(str::trim).collect::<Vec<_>>().join(" ").trim().to_owned()
}
