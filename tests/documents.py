"""Pages of docs/ that are made of the structs, so that they cannot fall behind; written by `make generated`."""

from __future__ import annotations

from collections.abc import Iterator
from enum import StrEnum

from msgspec import inspect

from gateway.api import model
from gateway.api.model import GROUPS, Group, Sample

_HEAD = f"""# The model

What the topics hold. This page is made of the structs in `gateway/api/model.py` by `make generated`.

SI units everywhere: m, rad, s, kg, N, N·m, A, V, K. A pose is a position and a unit quaternion (x, y, z, w). Arrays are
ordered from base to flange. **Every leaf may be null, and null means "this source cannot tell": null is never 0, and 0
is never null.** UNKNOWN in an enumeration means that the source sent a value that nobody documents.

{model.SAFETY_NOTICE}

## Delivery

| class | promise |
|---|---|
| state | latched: a new subscriber gets the value at once, and the newest always arrives; values in between may merge |
| event | lossless inside a bounded ring, named `boot:seq`, readable from any point; a loss is said |
| sample | the newest value at the client's own rate; every one with `mode: "all"`, up to a bound; a loss is said |

When a link goes stale or is lost, every topic gets one last sample: q set, all leaves null, `t_last` the time of the
last frame.
"""


def model_page() -> str:
    """The page `docs/model.md`."""
    parts = [_HEAD, "## The envelope of every sample\n", *_table(Sample)]
    for group in GROUPS.values():
        parts += ["", f"## {group.name}\n", f"{group.text} Delivery: {group.delivery}.\n", *_rows_of(group)]
    parts += ["", "## Enumerations\n", "| name | values |", "|---|---|"]
    parts += [f"| {name} | {' '.join(values)} |" for name, values in _enumerations()]
    return "\n".join(parts) + "\n"


def _rows_of(group: Group) -> Iterator[str]:
    if group.struct is not None:
        yield from _table(group.struct)
    else:
        yield "The keys and units are the manual's own; a word of bit fields is an object of `raw` and its bits."


def _table(struct: type) -> Iterator[str]:
    yield "| key | type | unit | meaning |"
    yield "|---|---|---|---|"
    found = inspect.type_info(struct)
    if isinstance(found, inspect.StructType):
        yield from _rows(found, "")


def _rows(struct: inspect.StructType, path: str) -> Iterator[str]:
    for field in struct.fields:
        schema, inner = _plain(field.type)
        name = f"{path}{field.encode_name}"
        text = str(schema.get("description", "")).replace("|", "\\|")
        yield f"| `{name}` | {_word(inner)} | {_unit(schema)} | {text} |"
        below = inner.item_type if isinstance(inner, inspect.ListType) else inner
        below = inner.value_type if isinstance(inner, inspect.DictType) else below
        _, below = _plain(below)
        if isinstance(below, inspect.StructType):
            suffix = {inspect.ListType: "[]", inspect.DictType: ".*"}.get(type(inner), "")
            yield from _rows(below, f"{name}{suffix}.")


def _plain(type_: inspect.Type) -> tuple[dict[str, object], inspect.Type]:
    """The schema of a type, and the type without metadata and null."""
    schema: dict[str, object] = {}
    while True:
        if isinstance(type_, inspect.Metadata):
            schema |= type_.extra_json_schema or {}
            type_ = type_.type
        elif isinstance(type_, inspect.UnionType):
            type_ = next(one for one in type_.types if not isinstance(one, inspect.NoneType))
        else:
            return schema, type_


def _unit(schema: dict[str, object]) -> str:
    return str(schema.get("unit", ""))


def _word(type_: inspect.Type) -> str:
    words = {
        inspect.FloatType: "number",
        inspect.IntType: "integer",
        inspect.StrType: "text",
        inspect.BoolType: "boolean",
        inspect.StructType: "object",
        inspect.AnyType: "any",
        inspect.LiteralType: "text",
    }
    if isinstance(type_, inspect.EnumType):
        return type_.cls.__name__
    if isinstance(type_, inspect.ListType):
        return f"array of {_word(_plain(type_.item_type)[1])}"
    if isinstance(type_, inspect.DictType):
        return f"object of {_word(_plain(type_.value_type)[1])} by name"
    return words.get(type(type_), "any")


def _enumerations() -> Iterator[tuple[str, list[str]]]:
    for name in dir(model):
        found = getattr(model, name)
        if isinstance(found, type) and issubclass(found, StrEnum) and found is not StrEnum:
            yield name, [member.value for member in found]
