"""What schemathesis is told beside the description: maps that are there, and what proto3 JSON takes beside its canonical form."""

import random

import schemathesis

#: What is found at these names was put there by openapi_peer.py and is never deleted.
KEPT = {"map": "kept", "name": "kept"}

#: Operations that make or take away what their path names: any name but those that are kept.
CHANGING = {"CreateMap", "DeleteMap", "ImportMap", "DeleteSnapshot"}


def camel(name):
    head, *rest = name.split("_")
    return head + "".join(word.capitalize() for word in rest)


def lenient(schema):
    """A schema of a request with all that the server takes: numbers as texts, names in camelCase, nothing as null."""
    if "$ref" in schema:
        return {"anyOf": [schema, {"nullable": True, "enum": [None]}]}
    schema = dict(schema)
    for word in ("allOf", "anyOf", "oneOf"):
        if word in schema:
            schema[word] = [lenient(part) for part in schema[word]]
    if "properties" in schema:
        properties = {name: lenient(part) for name, part in schema["properties"].items()}
        schema["properties"] = {**{camel(name): part for name, part in properties.items()}, **properties}
        # A name in camelCase stands for the one that is needed.
        needed = schema.pop("required", [])
        spelled = [{"anyOf": [{"required": [name]}, {"required": [camel(name)]}]} for name in needed]
        if spelled:
            schema["allOf"] = [*schema.get("allOf", []), *spelled]
    if isinstance(schema.get("additionalProperties"), dict):
        schema["additionalProperties"] = lenient(schema["additionalProperties"])
    if "items" in schema:
        schema["items"] = lenient(schema["items"])
    kind = schema.get("type")
    if kind in ("number", "integer") or schema.get("format") == "uint64":
        return {"anyOf": [schema, {"type": "string"}, {"type": "number"}, {"nullable": True, "enum": [None]}]}
    if "enum" in schema:
        return {"anyOf": [schema, {"type": "integer"}, {"nullable": True, "enum": [None]}]}
    if kind:
        schema["nullable"] = True
    return schema


def strict(schema):
    """A schema of an answer with the fields that are told of and no others."""
    return {**schema, "additionalProperties": False} if schema.get("type") == "object" and "properties" in schema else schema


@schemathesis.serializer("application/x-ndjson")
def lines(context, value):
    """A line of JSON is a text to the description."""
    return value if isinstance(value, bytes) else str(value).encode()


@schemathesis.hook
def before_load_schema(context, raw_schema):
    schemas = raw_schema["components"]["schemas"]
    for name, schema in schemas.items():
        taken = schema.get("additionalProperties") is False or "enum" in schema
        schemas[name] = lenient(schema) if taken else strict(schema)


@schemathesis.hook
def map_path_parameters(context, path_parameters):
    """Names that are there, so that most requests get beyond the name. What is against the rules stays as it is."""
    operation = context.operation.definition.raw["operationId"]
    if path_parameters and operation not in CHANGING:
        for name, kept in KEPT.items():
            if name in path_parameters and random.Random(repr(path_parameters)).random() < 0.8:
                path_parameters[name] = kept
    return path_parameters


@schemathesis.hook
def filter_path_parameters(context, path_parameters):
    operation = context.operation.definition.raw["operationId"]
    return operation not in CHANGING or not any((path_parameters or {}).get(name) == kept for name, kept in KEPT.items())
