"""What `xcore-objects/1` says of command objects: each one in order, what was lost, and how it was carried out."""

from __future__ import annotations

import json
import sys
from time import perf_counter

import msgspec
import pytest

from gateway.api.decoder import Event, Occurrence, Reject
from gateway.api.model import Command, CommandFeedback, CommandsMissed, EventKind
from tests.vendors.xcore.stream_kit import HELLO, INFO, TS, Json, Stream, line
from vendors.xcore.stream import ObjectsDecoder

SEVEN = {"joints": [0.0, 0.5, -0.5, 0.0, 1.5, 0.0, 0.25]}
POSE = {"trans": [0.4, 0.0, 0.5], "rpy": [3.14, 0.0, 3.14]}


def opened() -> ObjectsDecoder:
    return Stream({**HELLO, "info": {**INFO, "joint_num": 7}}).decoder


def tell(kind: str, **members: object) -> list[Event]:
    return opened().feed(line({"type": kind, "seq": 1, "ts": TS, **members}))


def issued(kind: object, commands: object, **more: object) -> list[Event]:
    return tell("issued", **{"cmdID": "c1", "class": kind, "commands": commands, **more})


def entries(events: list[Event]) -> list[tuple[EventKind, object]]:
    return [(entry.kind, entry.data) for event in events if isinstance(event, Occurrence) for entry in event.entries]


def test_each_object_of_a_list_is_an_entry_in_order() -> None:
    commands: list[Json] = [
        {"target": SEVEN, "jointSpeed": 0.5},
        {"target": SEVEN, "customInfo": "p2"},
        {"target": SEVEN},
    ]
    events = issued("MoveAbsJCommand", commands)
    assert len(events) == 1
    assert entries(events) == [
        (
            EventKind.COMMAND_ISSUED,
            Command(id="c1", type="MoveAbsJCommand", index=index, total=3, object=one),
        )
        for index, one in enumerate(commands)
    ]
    assert isinstance(events[0], Occurrence)
    assert {tuple(entry.raw.items()) for entry in events[0].entries} == {(("seq", 1), ("ts", TS))}


@pytest.mark.parametrize(
    ("kind", "command"),
    [
        ("MoveAbsJ", {"target": SEVEN}),
        ("MoveJ", {"target": POSE, "jointSpeed": 1}),
        ("MoveL", {"target": POSE, "speed": 5, "zone": 0, "rotSpeed": 0}),
        ("MoveC", {"target": POSE, "aux": POSE}),
        ("MoveCF", {"target": POSE, "aux": POSE, "angle": 6.28, "rotType": "fixedAxis"}),
        ("MoveSP", {"target": POSE, "direction": True, "radius_step": 0.01}),
        ("MoveWait", {"duration_": 0.001}),
    ],
)
def test_every_class_is_told_by_the_vendors_name(kind: str, command: Json) -> None:
    for name in (kind, f"{kind}Command"):
        ((what, data),) = entries(issued(name, [command]))
        assert what is EventKind.COMMAND_ISSUED
        assert data == Command(id="c1", type=f"{kind}Command", index=0, total=1, object=command)


def test_a_list_that_comes_in_pieces_keeps_its_numbers() -> None:
    events = issued("MoveL", [{"target": POSE}, {"target": POSE}], firstIndex=3, total=9)
    found = [data for _, data in entries(events)]
    assert [(one.index, one.total) for one in found if isinstance(one, Command)] == [(3, 9), (4, 9)]


@pytest.mark.parametrize(
    ("kind", "commands", "more", "told", "count"),
    [
        ("MoveAbsJ", [{"target": {"joints": [0] * 6}}], {}, "commands[0].target.joints", 1),
        ("MoveJ", [{"target": POSE}, {"target": POSE, "jointSpeed": 1.5}], {}, "commands[1].jointSpeed", 2),
        ("MoveL", [{"target": POSE, "speed": 4}], {}, "commands[0].speed", 1),
        ("MoveL", [{"target": POSE, "zone": 201}], {}, "commands[0].zone", 1),
        ("MoveL", [{"target": POSE, "sped": 200}], {}, "commands[0].sped", 1),
        ("MoveL", [], {}, "commands: is empty", 1),
        ("MoveL", [{"target": POSE}] * 101, {}, "101 commands", 101),
        ("MoveL", [{"target": POSE}, {"class": "MoveJCommand", "target": POSE}], {}, "commands[1].class", 2),
        ("MoveWait", [{"duration_": 1}] * 2, {}, "MoveWait stands alone", 2),
        ("MoveSP", [{"target": POSE}], {}, "commands[0].direction", 1),
        ("MoveX", [{}], {}, "class", 1),
        (None, [{"target": POSE}], {}, "class", 1),
        ("MoveL", {"target": POSE}, {}, "commands", 1),
        ("MoveL", None, {}, "commands", 1),
        ("MoveL", [None], {}, "commands[0]", 1),
        ("MoveL", [{"target": POSE}], {"cmdID": 7}, "cmdID is no text", 1),
        ("MoveL", [{"target": POSE}], {"seq": 0}, "seq is 0", 1),
        ("MoveL", [{"target": POSE}], {"firstIndex": -1}, "firstIndex is -1", 1),
        ("MoveL", [{"target": POSE}], {"total": 0}, "total is 0, but 1 came", 1),
    ],
)
def test_a_bad_list_is_rejected_with_its_path_and_announced_as_missed(
    kind: object, commands: object, more: Json, told: str, count: int
) -> None:
    reject, missed = issued(kind, commands, **more)
    assert isinstance(reject, Reject)
    assert told in reject.detail
    assert entries([missed]) == [(EventKind.COMMAND_MISSED, CommandsMissed(count=count))]


def test_a_number_that_no_encoding_can_carry_is_rejected() -> None:
    text = line({"type": "issued", "seq": 1, "cmdID": "c", "class": "MoveL", "commands": [{"target": {"trans": [10**30, 0, 0]}}]})  # fmt: skip # noqa: E501
    event, missed = opened().feed(text)
    assert isinstance(event, Reject)
    assert entries([missed]) == [(EventKind.COMMAND_MISSED, CommandsMissed())]


def test_what_the_agent_has_lost_is_told() -> None:
    assert entries(tell("lost", count=12)) == [(EventKind.COMMAND_MISSED, CommandsMissed(count=12))]
    for count in (0, -1, 1.5, "1", None, True, 10**17):
        reject, missed = tell("lost", count=count)
        assert isinstance(reject, Reject)
        assert entries([missed]) == [(EventKind.COMMAND_MISSED, CommandsMissed(count=1))]


def feedback(**data: object) -> list[Event]:
    return tell("event", event="moveExecution", data={"cmdID": "c1", **data})


@pytest.mark.parametrize(
    ("data", "expected"),
    [
        ({}, CommandFeedback(id="c1")),
        ({"reachTarget": False, "wayPointIndex": 0}, CommandFeedback(id="c1", index=0, reached=False)),
        (
            {"reachTarget": True, "wayPointIndex": 3, "error": {"ec": 0, "message": ""}, "customInfo": "p"},
            CommandFeedback(id="c1", index=3, reached=True, custom="p"),
        ),
        (
            {"error": {"ec": -50021, "message": "no"}, "remark": "stopped"},
            CommandFeedback(id="c1", error={"ec": -50021, "message": "no"}, text="stopped"),
        ),
        ({"error": "out of reach"}, CommandFeedback(id="c1", error="out of reach")),
        ({"error": None, "remark": "", "later": [1]}, CommandFeedback(id="c1")),
    ],
)
def test_feedback_says_how_far_a_list_was_carried_out(data: Json, expected: CommandFeedback) -> None:
    assert entries(feedback(**data)) == [(EventKind.COMMAND_EXECUTED, expected)]


@pytest.mark.parametrize(
    "data",
    [
        {"cmdID": None},
        {"cmdID": 1},
        {"wayPointIndex": "1"},
        {"wayPointIndex": True},
        {"wayPointIndex": 1.0},
        {"reachTarget": 1},
        {"remark": 1},
        {"customInfo": ["p"]},
        {"error": [[1]]},
        {"error": {"ec": {"a": 1}}},
    ],
)
def test_bad_feedback_is_rejected_and_announced_as_missed(data: Json) -> None:
    reject, missed = feedback(**data)
    assert isinstance(reject, Reject)
    assert reject.reason == "value"
    assert entries([missed]) == [(EventKind.COMMAND_MISSED, CommandsMissed(count=1))]


def test_what_tells_of_no_command_is_not_announced_as_missed() -> None:
    for kind, members in (("state", {"jointPos": 1}), ("log", {"log": 1}), ("event", {"event": "safety", "data": 1})):
        assert [type(event) for event in tell(kind, **members)] == [Reject]


def test_every_entry_can_be_sent_on() -> None:
    for events in (issued("MoveL", [{"target": POSE}]), feedback(error={"ec": 1}), tell("lost", count=1)):
        for event in events:
            assert isinstance(event, Occurrence)
            assert msgspec.msgpack.decode(msgspec.msgpack.encode(event.entries))
            assert msgspec.json.decode(msgspec.json.encode(event.entries))


def test_a_thousand_commands_a_second_cost_little() -> None:
    """Lists of a hundred and single commands cost less than six times `json.loads` of the same bytes."""
    many = [{"target": POSE, "speed": 200.0 + index, "zone": 5.0} for index in range(100)]
    members = {"type": "issued", "ts": TS, "cmdID": "c", "class": "MoveLCommand"}
    listed = [line({**members, "seq": 1, "commands": many})]
    single = [line({**members, "seq": index + 1, "commands": [one]}) for index, one in enumerate(many)]
    for lines in (listed, single):
        traced = sys.gettrace()
        sys.settrace(None)  # coverage slows Python down, but not json
        try:
            ratio = min(_ratio(lines) for _ in range(20))
        finally:
            sys.settrace(traced)
        print(f"{len(lines)} lines of {len(lines[0])} bytes: {ratio:.1f} times json.loads")
        assert ratio < 6


def _ratio(lines: list[bytes]) -> float:
    decoder = opened()
    start = perf_counter()
    for one in lines:
        decoder.feed(one)
    middle = perf_counter()
    for one in lines:
        json.loads(one)
    return (middle - start) / (perf_counter() - middle)
