"""The JSON Schemas of the channels, in the dialect that Foxglove reads.

Foxglove refuses a channel whose schema has a `$ref`, an `anyOf`, a list of types or an array in an array: every
property must have one plain `type`. So references are resolved, and null is said by `nullable`, which validators pass
over: any value of a gateway's sample may be null. What has no plain type is left out of the schema, not of the message.
Source: packages/mcap-support/src/parseJsonSchema.ts of github.com/foxglove/studio.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache

import msgspec

from gateway.api.describe import group_schema
from gateway.api.model import SAFETY_NOTICE, Sample

Schema = dict[str, object]
_KEPT = ("description", "unit", "enum")
_NULLS = "Any value may be null: this source cannot tell. It is never 0, and 0 is never null."


def plain(schema: Schema) -> Schema:
    """Say a schema in Foxglove's dialect.

    Args:
        schema: Of an object.

    Raises:
        ValueError: It is of something else.
    """
    found = _plain(schema, schema, ())
    if found is None or found["type"] != "object":
        raise ValueError("a channel holds an object")
    return found


@cache
def sample_schema(group: str) -> Schema:
    """The schema of the samples of a group of the model: the envelope with the group as its data."""
    return envelope(group, group_schema(group))


@cache
def event_schema(group: str) -> Schema:
    """The schema of the events of a group."""
    return {**plain(group_schema(group)), "$comment": SAFETY_NOTICE}


def envelope(title: str, data: Schema) -> Schema:
    """The schema of samples whose data has a schema."""
    whole = plain(msgspec.json.schema(Sample))
    properties = {**_part(whole, "properties"), "data": plain(data)}
    return {**whole, "title": title, "description": _NULLS, "$comment": SAFETY_NOTICE, "properties": properties}


def as_text(schema: Schema) -> msgspec.Raw:
    """A schema as the JSON string that an advertisement carries."""
    return msgspec.Raw(msgspec.json.encode(msgspec.json.encode(schema).decode()))


def _plain(schema: Mapping[str, object], root: Schema, within: tuple[str, ...]) -> Schema | None:
    """One value in the dialect; None: it has no plain type."""
    found, nullable, within = _one(schema, root, within)
    if found is None:
        return None
    kind = found.get("type", "string" if "enum" in found else None)
    said: Schema = {"type": kind, **{key: found[key] for key in _KEPT if key in found}}
    if nullable:
        said["nullable"] = True
    if kind == "object":
        return {**said, **_members(found, root, within)}
    if kind == "array":
        items = _plain(_part(found, "items"), root, within)
        return None if items is None or items["type"] == "array" else {**said, "items": items}
    return said if kind in {"boolean", "integer", "number", "string"} else None


def _members(found: Schema, root: Schema, within: tuple[str, ...]) -> Schema:
    """The properties of an object, which Foxglove wants even where there are none."""
    parts = {name: _plain(_as_schema(part), root, within) for name, part in _part(found, "properties").items()}
    properties = {name: part for name, part in parts.items() if part is not None}
    required = found.get("required")
    if not isinstance(required, list):
        return {"properties": properties}
    return {"properties": properties, "required": [name for name in required if name in properties]}


def _one(
    schema: Mapping[str, object], root: Schema, within: tuple[str, ...]
) -> tuple[Schema | None, bool, tuple[str, ...]]:
    """Follow references and alternatives to the one type that is not null.

    Returns:
        The schema of it, or None where there is none or it holds itself; whether null is another; the references that
        were followed.
    """
    found, nullable = dict(schema), False
    while True:
        reference, options, kinds = found.pop("$ref", None), found.pop("anyOf", None), found.get("type")
        if isinstance(reference, str):
            if reference in within:
                return None, nullable, within
            within = (*within, reference)
            found = {**_pointed(reference, root), **found}
        elif isinstance(options, list):
            others = [option for option in options if option.get("type") != "null"]
            nullable = nullable or len(others) < len(options)
            if len(others) != 1:
                return None, nullable, within
            found = {**others[0], **found}
        elif isinstance(kinds, list):
            named = [kind for kind in kinds if kind != "null"]
            nullable = nullable or len(named) < len(kinds)
            return ({**found, "type": named[0]} if len(named) == 1 else None), nullable, within
        else:
            return found, nullable, within


def _pointed(reference: str, root: Schema) -> Schema:
    """What a JSON pointer into the schema itself names."""
    found: object = root
    for name in reference.removeprefix("#/").split("/"):
        found = _as_schema(found)[name.replace("~1", "/").replace("~0", "~")]
    return _as_schema(found)


def _part(schema: Mapping[str, object], name: str) -> Schema:
    return _as_schema(schema.get(name, {}))


def _as_schema(value: object) -> Schema:
    if not isinstance(value, dict):
        raise TypeError(f"{value!r} is no schema")
    return value


def _record(title: str, description: str, **properties: Schema) -> Schema:
    """An object all of whose properties are always there."""
    return {
        "title": title,
        "description": description,
        "type": "object",
        "properties": properties,
        "required": list(properties),
    }


_COUNT: Schema = {"type": "integer", "minimum": 0}
_NUMBER: Schema = {"type": "number"}
_TEXT: Schema = {"type": "string"}
_TIME: Schema = {
    "type": "object",
    "title": "time",
    "properties": {"sec": _COUNT, "nsec": {**_COUNT, "maximum": 999_999_999}},
}
_VECTOR = _record("foxglove.Vector3", "m", x=_NUMBER, y=_NUMBER, z=_NUMBER)
_QUATERNION = _record("foxglove.Quaternion", "Unit quaternion", x=_NUMBER, y=_NUMBER, z=_NUMBER, w=_NUMBER)
_LEVELS = ("UNKNOWN", "DEBUG", "INFO", "WARNING", "ERROR", "FATAL")

# Foxglove's own schemas, which its panels know by name. Source: npm @foxglove/schemas, jsonschema.
LOG = _record(
    "foxglove.Log",
    "An event of a robot; file and line are the two parts of its name boot:seq.",
    timestamp=_TIME,
    level={
        "title": "foxglove.LogLevel",
        "oneOf": [{"title": name, "const": number} for number, name in enumerate(_LEVELS)],
    },
    message=_TEXT,
    name=_TEXT,
    file=_TEXT,
    line=_COUNT,
)
POSE_IN_FRAME = _record(
    "foxglove.PoseInFrame",
    "Pose of the tool centre point in the base reference; sent only where the source tells it.",
    timestamp=_TIME,
    frame_id=_TEXT,
    pose=_record("foxglove.Pose", "Pose", position=_VECTOR, orientation=_QUATERNION),
)
FRAME_TRANSFORMS = _record(
    "foxglove.FrameTransforms",
    "Tool centre point and flange in the base reference; sent only where the source tells them.",
    transforms={
        "type": "array",
        "items": _record(
            "foxglove.FrameTransform",
            "Pose of the child in the parent",
            timestamp=_TIME,
            parent_frame_id=_TEXT,
            child_frame_id=_TEXT,
            translation=_VECTOR,
            rotation=_QUATERNION,
        ),
    },
)
