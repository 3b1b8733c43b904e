"""xCore objects as plain JSON data, and their JSON Schema."""

from __future__ import annotations

import json
from enum import Enum
from functools import cache

import msgspec

from vendors.xcore.checking import CLASSES
from vendors.xcore.enums import ALIASES, ENUMS
from vendors.xcore.rules import XcoreObject

DIALECT = "https://json-schema.org/draft/2020-12/schema"
Json = dict[str, object]


def to_builtins(made: XcoreObject, *, omit_defaults: bool = False) -> Json:
    """An object as JSON data.

    Args:
        made: The object.
        omit_defaults: Members that have their default value are left out, those of nested objects too.
    """
    values = ((name, getattr(made, name), default) for name, default in _defaults(type(made)))
    return {
        name: _plain(value, omit_defaults=omit_defaults)
        for name, value, default in values
        if not (omit_defaults and value == default)
    }


def schemas() -> dict[str, Json]:
    """The JSON Schema (2020-12) of each object, by the SDK's name; each stands alone."""
    found = definitions()
    return {name: {"$schema": DIALECT, "$ref": f"#/$defs/{name}", "$defs": found} for name in CLASSES}


def definitions() -> Json:
    """The `$defs` of every object and enumeration, by the SDK's name."""
    _, components = msgspec.json.schema_components([*CLASSES.values(), *ENUMS.values()])
    found: dict[str, Json] = json.loads(json.dumps(components))  # arrays for tuples
    for name, words in ALIASES.items():
        allowed = found[name]["enum"]
        found[name]["enum"] = [*(allowed if isinstance(allowed, list) else ()), *words]
    return {**found}


def _plain(value: object, *, omit_defaults: bool) -> object:
    if isinstance(value, XcoreObject):
        return to_builtins(value, omit_defaults=omit_defaults)
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, tuple):
        return [_plain(item, omit_defaults=omit_defaults) for item in value]
    return value


@cache
def _defaults(struct: type[XcoreObject]) -> tuple[tuple[str, object], ...]:
    """The members of an object with their defaults, `NODEFAULT` where there is none."""
    return tuple((field.encode_name, field.default) for field in msgspec.structs.fields(struct))


SCHEMAS = schemas()
