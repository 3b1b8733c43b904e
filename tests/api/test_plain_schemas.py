"""The schemas of the Foxglove door: what Foxglove refuses is not in them, and what the robots say fits them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated

import msgspec
import pytest
from jsonschema import Draft202012Validator
from msgspec import Meta

from gateway.api import plain_schemas as schemas
from gateway.api.describe import group_schema, vendor_schema
from gateway.api.model import GROUPS, EventKind, Fault, Severity
from gateway.api.plain_schemas import Schema
from gateway.api.vendor import Protocol
from gateway.core.bus import Bus
from gateway.core.events import EventRing
from gateway.core.registry import Registry
from gateway.server.foxglove import payloads
from tests.server.kit import T

PLAIN = {"boolean", "integer", "number", "string", "object", "array"}


def protocols() -> Iterator[Protocol]:
    """Every protocol of every vendor here."""
    registry = Registry()
    for name in registry.names():
        yield from registry.vendor(name).protocols


def faults(schema: Schema, path: str = "") -> Iterator[str]:
    """What Foxglove would refuse a channel for; by packages/mcap-support/src/parseJsonSchema.ts of Foxglove Studio."""
    if schema.get("type") != "object":
        yield f"{path}: {schema.get('type')} where an object is due"
    properties = schema.get("properties")
    if not isinstance(properties, dict):
        yield f"{path}: no properties"
        return
    for name, part in properties.items():
        yield from faults_of_part(part, f"{path}.{name}")


def faults_of_part(part: Schema, at: str) -> Iterator[str]:
    """The same of one property."""
    numbers, items = part.get("oneOf"), part.get("items")
    if isinstance(numbers, list):
        if not all(isinstance(one["const"], int) for one in numbers):
            yield f"{at}: oneOf of no numbers"
    elif part.get("type") not in PLAIN:
        yield f"{at}: type {part.get('type')}"
    elif part["type"] == "object":
        yield from faults(part, at)
    elif isinstance(items, dict):
        if items.get("type") not in PLAIN - {"array"}:
            yield f"{at}: items {items.get('type')}"
        elif items["type"] == "object":
            yield from faults(items, f"{at}[]")
    elif part["type"] == "array":
        yield f"{at}: no items"


@pytest.mark.parametrize("group", [name for name, group in GROUPS.items() if group.delivery != "event"])
def test_foxglove_can_read_the_schema_of_every_group(group: str) -> None:
    schema = schemas.sample_schema(group)
    Draft202012Validator.check_schema(schema)
    assert list(faults(schema)) == []


@pytest.mark.parametrize("protocol", list(protocols()), ids=lambda one: str(one.name))
def test_foxglove_can_read_the_schema_of_every_vendor(protocol: Protocol) -> None:
    schema = schemas.envelope("vendor", vendor_schema(protocol.longest))
    Draft202012Validator.check_schema(schema)
    assert list(faults(schema)) == []
    data = schema["properties"]["data"]["properties"]  # type: ignore[index]
    assert set(data) == set(vendor_schema(protocol.longest)["properties"])  # type: ignore[call-overload]


@pytest.mark.parametrize(
    "schema",
    [schemas.event_schema("commands"), schemas.LOG, schemas.POSE_IN_FRAME, schemas.FRAME_TRANSFORMS],
)
def test_foxglove_can_read_the_other_schemas(schema: Schema) -> None:
    assert list(faults(schema)) == []


@pytest.mark.parametrize("group", [name for name, group in GROUPS.items() if group.struct is not None])
def test_the_models_own_schema_is_one_that_foxglove_would_refuse(group: str) -> None:
    assert list(faults(group_schema(group))) != []


def test_units_and_meanings_stay() -> None:
    data = schemas.sample_schema("joints")["properties"]["data"]["properties"]  # type: ignore[index]
    position = {"type": "array", "description": "Measured position.", "unit": "rad", "nullable": True}
    assert data["position"] == {**position, "items": {"type": "number", "nullable": True}}


class Tree(msgspec.Struct):
    """Holds itself, and much that has no plain type."""

    left: Tree | None = None
    either: int | str | None = None
    table: list[list[int]] = []
    anything: Annotated[object, Meta(description="x")] = None
    named: dict[str, int] = {}
    size: float | None = None


def test_what_has_no_plain_type_is_left_out() -> None:
    found = schemas.plain(msgspec.json.schema(Tree))
    assert found["properties"] == {
        "named": {"type": "object", "properties": {}},
        "size": {"type": "number", "nullable": True},
    }


@pytest.mark.parametrize("kind", [int, list[int], int | str])
def test_a_channel_of_something_else_than_an_object_is_a_mistake(kind: object) -> None:
    with pytest.raises(ValueError, match="object"):
        schemas.plain(msgspec.json.schema(kind))


def test_a_pointer_finds_names_with_slashes() -> None:
    inner: Schema = {"type": "boolean"}
    schema: Schema = {
        "type": "object",
        "properties": {"x": {"$ref": "#/$defs/a~1b~0c"}},
        "$defs": {"a/b~c": inner},
    }
    assert schemas.plain(schema)["properties"] == {"x": inner}


def test_a_fault_has_its_own_severity_and_words() -> None:
    bus = Bus(EventRing(10, "b"))
    bus.add("r1", ["events"])
    fault = Fault(code="main_code", main=5, sub=2, severity=Severity.FATAL, text="drive off")
    bus.raise_event(bus.topics["r1/events"], T, EventKind.FAULT_RAISED, None, fault, {"main_code": 5})
    bus.raise_event(bus.topics["r1/events"], T, EventKind.FAULT_CLEARED, fault, None, {"main_code": 0})
    bus.raise_event(bus.topics["r1/events"], T, EventKind.FAULT_RAISED, None, Fault(code="x"), {})
    bus.raise_event(bus.topics["r1/events"], T, EventKind.POWER_CHANGED, "OFF", {"odd": 1}, {})
    events, _ = bus.events.since(None, 10)
    assert [payloads.log_level(event) for event in events] == [5, 2, 3, 2]
    assert [payloads.log_text(event) for event in events] == [
        "fault.raised: main_code 5/2 drive off",
        "fault.cleared: main_code 5/2 drive off",
        "fault.raised: x",
        'power.changed: OFF → {"odd":1}',
    ]
    for event in events:
        Draft202012Validator(schemas.LOG).validate(msgspec.json.decode(payloads.log(event)))


def test_an_event_is_encoded_once_however_many_read_it() -> None:
    bus = Bus(EventRing(10, "b"))
    bus.add("r1", ["events"])
    for _ in range(2):
        bus.raise_event(bus.topics["r1/events"], T, EventKind.LINK_LOST, None, None, {})
    one, other = bus.events.since(None, 10)[0]
    assert payloads.log(one) is payloads.log(one)
    assert payloads.as_it_is(one) is payloads.as_it_is(one)
    assert payloads.log(one) != payloads.log(other)
    assert payloads.Same(one) != one
