"""What a topic holds, as JSON Schema with units, and where each value comes from."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import msgspec

from gateway.api.decoder import Table
from gateway.api.layout import Field
from gateway.api.messages import Description, SourceInfo
from gateway.api.model import FRAME_GROUPS, GROUPS, SAFETY_NOTICE
from gateway.api.readers import unit_of
from gateway.api.record import Record, Value
from gateway.api.signals import Signal, keys_of


def describe(topic: str, group: str, layout: Table, signals: Iterable[Signal]) -> Description:
    """Describe a topic of a robot.

    Args:
        topic: Its name.
        group: Its group.
        layout: The longest table of the robot's protocol.
        signals: The protocol's rows.
    """
    rows = [signal for signal in signals if signal.group == group]
    return Description(
        topic=topic,
        delivery=GROUPS[group].delivery,
        schema=vendor_schema(layout) if group == "vendor" else group_schema(group),
        sources={".".join(row.path): _source(row, layout) for row in rows},
        never=never_told(group, rows),
    )


def group_schema(group: str) -> dict[str, object]:
    """The JSON Schema of a group of the model, with units and the safety notice.

    Raises:
        KeyError: The model has no such group.
    """
    struct = GROUPS[group].struct
    schema: dict[str, object] = msgspec.json.schema(struct) if struct else {"type": "object"}
    return {**schema, "$comment": SAFETY_NOTICE}


def vendor_schema(layout: Table) -> dict[str, object]:
    """The JSON Schema of the `vendor` group: every field under its manual name, in the manual's unit."""
    return {
        "type": "object",
        "title": "vendor",
        "description": f"Every field of the frame. Source: {layout.source}.",
        "$comment": SAFETY_NOTICE,
        "properties": _properties(layout),
    }


def never_told(group: str, rows: Sequence[Signal]) -> list[str]:
    """The keys of a group that no row fills: they are always null."""
    struct = GROUPS[group].struct
    if struct is None or group not in FRAME_GROUPS:
        return []
    told = [".".join(row.path) for row in rows]
    return [
        key for key in keys_of(struct) if key != "substituted" and not any(_same_branch(key, known) for known in told)
    ]


def _same_branch(key: str, told: str) -> bool:
    return key == told or key.startswith(f"{told}.") or told.startswith(f"{key}.")


def _source(row: Signal, table: Table) -> SourceInfo:
    units = [unit_of(table, source) for source in row.sources]
    return SourceInfo(fields=list(row.sources), units=units, quality=row.quality.value)


def _properties(table: Table) -> dict[str, object]:
    if isinstance(table, Record):
        return {value.name: _value_schema(value) for value in table.fields}
    return {field.name: _field_schema(field) for field in table.fields}


def _value_schema(value: Value) -> dict[str, object]:
    """The schema of a value of a record, whole in itself: what it refers to stands inside it."""
    (found,), parts = msgspec.json.schema_components(
        [value.type], ref_template="#/properties/" + value.name + "/$defs/{name}"
    )
    unit = {} if value.unit is None else {"unit": value.unit}
    below = {"$defs": parts} if parts else {}
    return {"anyOf": [found, {"type": "null"}], **below, **unit, "description": value.meaning}


def _field_schema(field: Field) -> dict[str, object]:
    kind = "string" if field.is_opaque else "number" if field.is_float else "integer"
    element: dict[str, object] = {"type": [kind, "null"]}
    if field.flags:
        flags = {flag.name: _flag_schema(flag.meaning, flag.note, flag.since, flag.mask) for flag in field.flags}
        element = {"type": ["object", "null"], "properties": {"raw": {"type": "integer"}, **flags}}
    shown = element if field.count is None else {"type": "array", "items": element}
    unit = {} if field.unit is None else {"unit": field.unit}
    return {**shown, **unit, "description": field.meaning}


def _flag_schema(meaning: str, note: str, since: str, largest: int) -> dict[str, object]:
    parts = [meaning, note, f"since v{since}" if since else ""]
    text = "; ".join(part for part in parts if part)
    return {"type": "integer", "minimum": 0, "maximum": largest, "description": text}
