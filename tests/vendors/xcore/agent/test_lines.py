"""Lines and objects: what is written, what is refused, what is skipped."""
# ruff: noqa: ANN401 - the stand-in is typed as little as the SDK

from __future__ import annotations

import datetime as dt
import enum
import json
import math
from typing import Any

import pytest
from robot_gateway_xcore_agent.lines import MAX_LINE, LineReader, TooLongError, line, number, plain
from robot_gateway_xcore_agent.objects import KINDS, OBJECTS, UnknownClassError, encode, snapshot
from robot_gateway_xcore_agent.outbox import Limits, Outbox, OverflowedError


class Power(enum.Enum):
    on = 0


class ErrorCode:
    def value(self) -> int:
        return 257

    def message(self) -> str:
        return "refused"


def test_a_line_of_exactly_the_limit_is_written_and_read_and_one_byte_more_is_neither() -> None:
    room = MAX_LINE - len(line({"a": ""}))
    longest = line({"a": "x" * room})
    assert len(longest) == MAX_LINE
    assert LineReader().feed(longest).objects == ({"a": "x" * room},)
    with pytest.raises(TooLongError):
        line({"a": "x" * (room + 1)})
    found = LineReader().feed(longest[:-1] + b" \n" + b"{}\n")
    assert (found.objects, found.n_rejected) == (({},), 1)


@pytest.mark.parametrize("bad", [b"nonsense", b"[1]", b'{"a": NaN}', b'"text"', b"\xff", b"[" * 5000, b'{"a":1'])
def test_a_bad_line_is_counted_and_the_next_is_read(bad: bytes) -> None:
    found = LineReader().feed(bad + b'\r\n\r\n\n{"a":1}\r\n')
    assert (found.objects, found.n_rejected) == (({"a": 1},), 1)


def test_lines_come_the_same_byte_by_byte_and_a_long_one_is_counted_once() -> None:
    data = b'{"a":1}\n' + b"x" * 200 + b'\n{"b":2}\n'
    reader = LineReader(max_line=100)
    found = [reader.feed(data[place : place + 1]) for place in range(len(data))]
    assert [thing for lines in found for thing in lines.objects] == [{"a": 1}, {"b": 2}]
    assert sum(lines.n_rejected for lines in found) == 1


def test_values_of_events_become_json() -> None:
    nested: Any = {"deep": None}
    for _ in range(20):
        nested = {"deep": nested}
    found = plain(
        {
            1: math.inf,
            "power": Power.on,
            "wait": dt.timedelta(milliseconds=5),
            "code": ErrorCode(),
            "what": object(),
            "list": (1, "a"),
        }
    )
    assert found == {
        "1": None,
        "power": "on",
        "wait": 0.005,
        "code": {"ec": 257, "message": "refused"},
        "what": None,
        "list": [1, "a"],
    }
    assert json.dumps(plain(nested))
    assert line({"text": "\ud800 ä"}) == '{"text":"? ä"}\n'.encode()
    assert (number(value=True), number("1"), number(10**400), number(math.nan)) == (None, None, 10**400, None)


def test_the_tables_are_sound() -> None:
    for fields in OBJECTS.values():
        names = [field.name for field in fields]
        assert len(set(names)) == len(names)
        assert all(field.kind in KINDS or field.kind in OBJECTS for field in fields)


def test_objects_are_encoded_with_their_attribute_names(sdk: Any) -> None:
    move = sdk.MoveLCommand(sdk.CartesianPosition([0.4, 0, 0.5, 3.1, 0, float("nan")]), 200, 10)
    move.offset.type = sdk.CartesianPositionOffsetType.relTool
    move.target.confData = [1.0, 2, 0, 0, 0, 0, 0, -1]
    assert snapshot(move).encoded(omit_defaults=True) == {
        "target": {"trans": [0.4, 0, 0.5], "rpy": [3.1, 0, None], "confData": [1, 2, 0, 0, 0, 0, 0, -1]},
        "speed": 200,
        "zone": 10,
        "offset": {"type": "relTool"},
    }
    assert snapshot(sdk.MoveLCommand(sdk.CartesianPosition())).encoded(omit_defaults=True) == {"target": {}}
    joints = sdk.MoveAbsJCommand(sdk.JointPosition([1, 2, 3]))
    assert snapshot(joints).encoded(omit_defaults=True) == {"target": {"joints": [1, 2, 3]}}
    wait = sdk.MoveWaitCommand(dt.timedelta(seconds=2))
    assert snapshot(wait).encoded(omit_defaults=True) == {"duration_": 2.0}
    spiral = sdk.MoveSPCommand(sdk.CartesianPosition(), 0.1, direction=False)
    assert snapshot(spiral).encoded(omit_defaults=True) == {"target": {}, "radius": 0.1, "direction": False}
    circle = sdk.MoveCFCommand(6.28)
    assert snapshot(circle).encoded(omit_defaults=True) == {"angle": 6.28, "rotType": "rotAxis"}
    full = encode(sdk.Toolset())
    assert full["load"] == {"mass": 1.5, "cog": [0, 0, 0.1], "inertia": [0, 0, 0]}
    assert full["end"] == {"trans": [0, 0, 0], "rpy": [0, 0, 0]}


def test_a_snapshot_does_not_change_with_its_object(sdk: Any) -> None:
    move = sdk.MoveLCommand(sdk.CartesianPosition([1, 2, 3, 0, 0, 0]), 100)
    copied = snapshot(move)
    move.target.trans[0], move.speed, move.target.rpy = 9, 9, [9, 9, 9]
    assert copied.encoded(omit_defaults=True) == {"target": {"trans": [1, 2, 3]}, "speed": 100}


def test_an_object_that_lacks_what_others_of_its_class_have_is_encoded_without(sdk: Any) -> None:
    snapshot(sdk.MoveLCommand(sdk.CartesianPosition()))
    poor = sdk.MoveLCommand(None, 5)
    assert snapshot(poor).encoded(omit_defaults=True) == {"speed": 5}


def test_an_unknown_class_is_refused_and_a_subclass_is_known(sdk: Any) -> None:
    class Mine(sdk.MoveWaitCommand):  # type: ignore[misc]
        pass

    assert snapshot(Mine(dt.timedelta(seconds=1))).name == "MoveWaitCommand"
    with pytest.raises(UnknownClassError):
        snapshot(object())


def test_an_outbox_leaves_out_state_and_never_anything_else() -> None:
    box = Outbox(Limits(state_bytes=100, owed_bytes=400))
    box.numbered("event", {"data": "x" * 100}, 1)
    box.state({}, 2)
    assert (box.seq, box.n_state_dropped) == (2, 1)
    box.numbered("event", {"data": "y" * 100}, 3)
    sent = b""
    while box.n_owed:
        sent += box.chunk()[:7]
        box.sent(len(box.chunk()[:7]))
    assert [json.loads(text)["seq"] for text in sent.splitlines()] == [1, 3]
    box.numbered("log", {"data": "z" * 200}, 4)
    with pytest.raises(OverflowedError):
        box.numbered("log", {"data": "z" * 200}, 5)


def test_what_cannot_be_said_uses_no_number() -> None:
    box = Outbox(Limits())
    for wrong in ({"a": math.nan}, {"a": object()}, {"a": "x" * MAX_LINE}):
        with pytest.raises((ValueError, TypeError)):
            box.numbered("event", wrong, 1)
    assert (box.seq, box.n_owed) == (0, 0)
