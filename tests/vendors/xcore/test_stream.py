"""The decoder of `xcore-objects/1`: its lines, its hello, its states and events. Source: docs/xcore-objects.md."""

from __future__ import annotations

import json
import random
import re

import msgspec
import pytest

from gateway.api.decoder import Event, Frame, Occurrence, Refused, Reject, Skipped
from gateway.api.model import CommandsMissed
from gateway.core.controller_clock import ControllerClock
from tests.vendors.xcore.stream_kit import HELLO, INFO, STATE, TS, UNITS, Json, Stream, line
from vendors.xcore import VENDOR
from vendors.xcore.objects import CartesianPosition, KeyPadState, LogInfo
from vendors.xcore.stream import ObjectsDecoder, ObjectsOptions
from vendors.xcore.stream_record import Entry, Execution, ReadError

OBJECTS = VENDOR.protocol("objects")


def one_reject(decoder: ObjectsDecoder, data: bytes) -> Reject:
    event, *missed = decoder.feed(data)
    assert isinstance(event, Reject)
    assert event.raw == data
    # It may have held commands: the topic says that something is missing, and that nobody knows how much.
    assert [one.entries[0].data for one in missed if isinstance(one, Occurrence)] == [CommandsMissed()] * len(missed)
    assert len(missed) == (event.reason in {"json", "too_long"} and decoder.ready)
    return event


def test_the_examples_of_the_document_are_read() -> None:
    found = Stream()
    (event,) = found.decoder.feed(STATE)
    assert isinstance(event, Frame)
    assert event.raw == STATE
    assert event.values == {
        "ts": TS,
        "jointPos": [0, 0.5, -0.5, 0, 1.5, 0],
        "powerState": "on",
        "operateMode": "automatic",
        "operationState": "idle",
    }
    log = line({"type": "log", "seq": 2, "ts": 1, "level": "error", "log": {"id": 50002, "timestamp": "", "content": "", "repair": ""}})  # fmt: skip # noqa: E501
    (event,) = found.decoder.feed(log)
    assert isinstance(event, Frame)
    assert event.values["log"] == Entry("error", LogInfo(id=50002))


def test_the_hello_opens_the_session() -> None:
    found = Stream()
    assert [type(event) for event in found.hello] == [Skipped]
    assert found.decoder.ready
    assert found.decoder.notes == []
    assert Stream({**HELLO, "info": None}).decoder.ready
    assert Stream({**HELLO, "later": [1], "units": {**UNITS, "force": "N"}}).decoder.ready


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"schema": "xcore-objects/2"}, "xcore-objects/2"),
        ({"schema": None}, "None"),
        ({"schema": {"a": 1}}, "{'a': 1}"),
        ({"units": {**UNITS, "length": "mm"}}, "'length': 'mm'"),
        ({"units": {"length": "m"}}, "its units are {'length': 'm'}"),
        ({"units": None}, "its units are None"),
        ({"units": ["m"]}, "its units are ['m']"),
    ],
)
def test_a_hello_of_another_language_is_incompatible(changes: Json, told: str) -> None:
    skipped, refused = Stream({**HELLO, **changes}).hello
    assert isinstance(skipped, Skipped)
    assert isinstance(refused, Refused)
    assert refused.kind == "incompatible"
    assert told in refused.reason


def test_a_second_hello_is_rejected_and_changes_nothing() -> None:
    found = Stream()
    other = {**HELLO, "info": {**INFO, "joint_num": 7}}
    assert one_reject(found.decoder, line(other)).reason == "hello"
    assert one_reject(found.decoder, line({**HELLO, "schema": "other"})).reason == "hello"
    assert "jointPos" in found.values("state", jointPos=[0, 0, 0, 0, 0, 0])


def test_nothing_is_read_before_the_hello() -> None:
    decoder = ObjectsDecoder(ObjectsOptions(ask={"toolset": 10.0}))
    for message in (STATE, line({"type": "log", "seq": 1}), line({"type": "remark"})):
        assert one_reject(decoder, message).reason == "no_hello"
    assert [decoder.tick() for _ in range(100)] == [b""] * 100
    assert not decoder.ready
    assert "no hello came" in decoder.notes[0]
    assert decoder.gaps is None


@pytest.mark.parametrize("info", [{**INFO, "joint_num": 8}, {**INFO, "joint_num": "six"}, {"id": 1}, [], "demo"])
def test_a_hello_whose_robot_cannot_be_read_says_so(info: object) -> None:
    found = Stream({**HELLO, "info": info})
    assert isinstance(found.hello[0], Reject)
    assert not found.decoder.ready
    assert found.decoder.notes[0].startswith("the agent's hello cannot be used: info")
    found.decoder.feed(line(HELLO))
    assert found.decoder.notes == []


def test_members_that_are_absent_stay_and_null_is_told() -> None:
    values = Stream().values("state", jointPos=None, posture={"flangeInBase": None}, di={"DI0": None}, errors={})
    assert values.pop("ts") == TS + 1
    assert values["jointPos"] is None
    assert set(values) == {"jointPos", "posture", "di", "errors"}


def test_every_member_of_a_state_is_read() -> None:
    values = Stream().values(
        "state",
        jointVel=[0, 1, 2, 3, 4, 5],
        jointTorque=[1.5, 0, 0, 0, 0, 0],
        external=[0.5],
        cartPosture={"trans": [1, 2, 3], "rpy": [0.1, 0.2, 0.3], "elbow": 0.5, "hasElbow": True, "confData": [0] * 8},
        keypad={"key1_state": True},
        di={"DI0_0": True},
        do={"DO0_0": False},
        ai={"AI0_0": 1.5},
        errors={"jointTorque": {"ec": -1, "message": "no"}},
    )
    assert values["cartPosture"] == CartesianPosition(
        trans=(1.0, 2.0, 3.0), rpy=(0.1, 0.2, 0.3), elbow=0.5, hasElbow=True, confData=(0,) * 8
    )
    assert values["keypad"] == KeyPadState(key1_state=True)
    assert values["errors"] == {"jointTorque": ReadError(-1, "no")}
    assert (values["di"], values["do"], values["ai"]) == ({"DI0_0": True}, {"DO0_0": False}, {"AI0_0": 1.5})


@pytest.mark.parametrize(
    ("members", "told"),
    [
        ({"jointPos": [0, 0, 0, 0, 0]}, "jointPos: 5 values for a robot of 6 axes"),
        ({"jointVel": [0] * 7}, "jointVel: 7 values for a robot of 6 axes"),
        ({"jointTorque": [0] * 3}, "jointTorque: 3 values"),
        ({"jointPos": [True, 0, 0, 0, 0, 0]}, "Expected `float`, got `bool`"),
        ({"jointPos": ["0", 0, 0, 0, 0, 0]}, "Expected `float`, got `str`"),
        ({"jointPos": [None, 0, 0, 0, 0, 0]}, "jointPos"),
        ({"jointPos": 1}, "jointPos"),
        ({"jointPos": [1e10, 0, 0, 0, 0, 0]}, "jointPos"),
        ({"posture": {"flangeInBase": [0, 0, 0]}}, "posture"),
        ({"powerState": 0}, "powerState"),
        ({"di": {"a": 1}}, "di"),
        ({"ai": {"a": True}}, "ai"),
        ({"cartPosture": [1]}, "cartPosture is no object"),
        ({"cartPosture": {"trans": [1, 2]}}, "cartPosture"),
        ({"keypad": {"key1_state": 1}}, "keypad"),
        ({"errors": {"a": {"ec": 10**18}}}, "errors"),
    ],
)
def test_a_state_with_a_value_that_is_none_is_rejected_and_named(members: Json, told: str) -> None:
    found = Stream().reject("state", **members)
    assert found.reason == "value"
    assert told in found.detail


@pytest.mark.parametrize("number", ["NaN", "Infinity", "-Infinity", "1e999", "1" * 400, "18446744073709551616"])
def test_numbers_that_are_none_or_too_large_never_pass(number: str) -> None:
    text = STATE.replace(b"0.5", number.encode(), 1)
    assert one_reject(Stream().decoder, text).reason == "json"
    assert one_reject(Stream().decoder, STATE.replace(b"}", f',"later":[{number}]}}'.encode())).reason == "json"


def test_unknown_members_are_ignored_also_inside() -> None:
    values = Stream().values(
        "state", later={"a": [1]}, keypad={"key8_state": True}, cartPosture={"trans": [1, 2, 3], "later": 1}
    )
    assert values["keypad"] == KeyPadState()
    assert "later" not in values


def test_unknown_types_and_events_are_skipped_numbered_or_not() -> None:
    found = Stream()
    assert [type(event) for event in found.tell("remark", text="x")] == [Skipped]
    assert [type(event) for event in found.decoder.feed(line({"type": "remark"}))] == [Skipped]
    assert [type(event) for event in found.tell("event", event="later", data={})] == [Skipped]
    found.tell("state")
    assert found.decoder.gaps == 0


def test_gaps_are_counted_from_one() -> None:
    assert Stream().decoder.gaps is None
    found = Stream()
    found.tell("state")
    assert found.decoder.gaps == 0
    found.seq += 3
    found.tell("state")
    assert found.decoder.gaps == 3
    late = Stream()
    late.seq = 4
    late.tell("state")
    assert late.decoder.gaps == 4


@pytest.mark.parametrize("seq", [0, -1, 1.5, "1", None, True, [1], 10**17])
def test_a_number_that_is_none_is_rejected(seq: object) -> None:
    found = Stream()
    message = json.loads(STATE) | {"seq": seq}
    assert "seq is" in one_reject(found.decoder, line(message)).detail
    assert found.decoder.gaps is None


def test_the_agents_clock_is_the_source_time() -> None:
    clock = ControllerClock(OBJECTS.wall_clock, None)  # type: ignore[arg-type] # it has one
    assert clock.zone_is_known
    found = Stream()
    (event,) = found.decoder.feed(STATE.replace(b"1700000000000000", b"1700000000123456"))
    assert isinstance(event, Frame)
    assert clock.utc_us(event) == 1_700_000_000_123_456
    for wrong in (b"null", b"-1", b"0", b"1.5", b'"now"', b"999999999999999999"):
        (event,) = Stream().decoder.feed(STATE.replace(b"1700000000000000", wrong))
        assert isinstance(event, Frame)
        assert clock.utc_us(event) is None


def test_what_an_event_told_is_told_again_by_every_state() -> None:
    found = Stream()
    assert found.event("safety", collided=True)["collided"] is True
    task = found.event("rlExecution", taskName="weld", executeLine=12, executeFile="m", later=1)
    assert task["rlExecution"] == Execution(taskName="weld", executeLine=12, executeFile="m")
    for _ in range(3):
        state = found.values("state", powerState="on")
        assert (state["collided"], state["rlExecution"]) == (True, task["rlExecution"])
    found.event("safety", collided=False)
    assert found.values("state")["collided"] is False
    assert found.event("safety", collided=None)["collided"] is None
    assert "collided" not in found.values("state")
    assert "rlExecution" not in Stream().values("state")  # another session


@pytest.mark.parametrize(
    ("name", "data"),
    [
        ("safety", {"collided": 1}),
        ("safety", []),
        ("rlExecution", {"executeLine": "12"}),
        ("rlExecution", {"executeLine": True}),
        ("rlExecution", {"executeLine": 10**18}),
        ("connection", {"connected": "yes"}),
        ("safety", None),
    ],
)
def test_events_with_bad_data_are_rejected_and_hold_nothing(name: str, data: object) -> None:
    found = Stream()
    assert found.reject("event", event=name, data=data).reason == "value"
    assert set(found.values("state")) == {"ts"}


def test_a_lost_controller_makes_everything_null_and_is_noted() -> None:
    found = Stream()
    found.event("safety", collided=True)
    found.tell("log", level="error", log={"id": 1})
    values = found.event("connection", connected=False)
    assert values.pop("connected") is False
    assert values.pop("ts")
    assert values == dict.fromkeys(set(OBJECTS.records[0].by_name) - {"connected", "ts"})
    assert found.decoder.notes == ["the agent says that its SDK has lost the controller"]
    assert set(found.values("state")) == {"ts", "connected"}
    found.event("connection", connected=True)
    assert found.decoder.notes == []
    assert "faults" not in found.values("state")
    assert found.values("log", level="error", log={"id": 1})["faults"]  # known again by its repetition


def test_the_agent_says_why_it_closes() -> None:
    found = Stream()
    assert [type(event) for event in found.tell("closing", reason="the agent ends")] == [Skipped]
    assert "the agent ends" in found.decoder.notes[0]
    early = ObjectsDecoder(ObjectsOptions())
    skipped, refused = early.feed(line({"type": "closing", "seq": 1, "reason": "one gateway at a time"}))
    assert isinstance(skipped, Skipped)
    assert isinstance(refused, Refused)
    assert "one gateway at a time" in refused.reason


@pytest.mark.parametrize(
    ("told", "reason"),
    [
        (b"{\n", "json"),
        (b"[]\n", "json"),
        (b"null\n", "json"),
        (b'{"type":"state","seq":1} x\n', "json"),
        (b'{"type":"sta\xffte"}\n', "json"),
        (b'{"type":"\\ud800"}\n', "json"),
        (b"[" * 60_000 + b"]\n", "json"),
        (b'{"a":' * 10_000 + b"1" + b"}" * 10_000 + b"\n", "json"),
        (b"{}\n", "no_type"),
        (b'{"type":1}\n', "no_type"),
        (b'{"type":null,"seq":1}\n', "no_type"),
        (b"\xef\xbb\xbf{}\n", "json"),
    ],
)
def test_a_line_that_is_no_message_is_rejected_and_the_next_is_read(told: bytes, reason: str) -> None:
    found = Stream()
    assert one_reject(found.decoder, told).reason == reason
    assert [type(event) for event in found.decoder.feed(STATE)] == [Frame]


def test_of_members_that_stand_twice_the_last_counts() -> None:
    (event,) = Stream().decoder.feed(b'{"type":"state","seq":1,"powerState":"on","powerState":"off"}\n')
    assert isinstance(event, Frame)
    assert event.values["powerState"] == "off"


def test_lines_may_end_with_cr_lf_and_be_empty() -> None:
    events = Stream().decoder.feed(b"\n\r\n" + STATE.replace(b"\n", b"\r\n") + b"\n")
    assert [type(event) for event in events] == [Skipped, Skipped, Frame, Skipped]


@pytest.mark.parametrize("extra", [-1, 0, 1, 100, 200_000])
@pytest.mark.parametrize("chunk", [1000, 10_000_000])
def test_a_line_has_at_most_65536_bytes(extra: int, chunk: int) -> None:
    found = Stream()
    pad = 65_536 + extra - len(STATE) - len(',"pad":""')
    stream = STATE.replace(b"}", b',"pad":"' + b"x" * pad + b'"}')
    assert len(stream) == 65_536 + extra
    events: list[Event] = []
    for at in range(0, len(stream), chunk):
        events += found.decoder.feed(stream[at : at + chunk])
        assert found.decoder.pending <= 65_536
    if extra <= 0:
        assert [type(event) for event in events] == [Frame]
    else:
        assert isinstance(events[0], Reject)
        assert events[0].reason == "too_long"
        assert isinstance(events[1], Occurrence)
        assert events[1].entries[0].data == CommandsMissed()
        assert {type(event) for event in events[2:]} <= {Skipped}
    assert [type(event) for event in found.decoder.feed(STATE.replace(b'"seq":1', b'"seq":2'))] == [Frame]


def test_every_cut_tells_the_same() -> None:
    events = [
        HELLO,
        {"type": "event", "seq": 1, "ts": TS, "event": "safety", "data": {"collided": True}},
        {"type": "log", "seq": 2, "ts": TS, "level": "warning", "log": {"id": 7, "content": "焊接"}},
        {"type": "remark"},
        {"type": "issued", "seq": 3, "cmdID": "a", "class": "MoveWait", "commands": [{"duration_": 1}]},
        {"type": "state", "seq": 4, "powerState": "on"},
    ]
    stream = b"".join(map(line, events)) + b"junk\n\r\n" + STATE
    whole = ObjectsDecoder(ObjectsOptions()).feed(stream)
    chance = random.Random(2)  # noqa: S311 - test data
    for size in (1, 2, 7, 0, 0, 0):
        decoder, found, at = ObjectsDecoder(ObjectsOptions()), list[Event](), 0
        while at < len(stream):
            step = size or chance.randint(1, 120)
            found += decoder.feed(stream[at : at + step])
            at += step
        assert found == whole
        assert decoder.end() == []


def test_the_end_of_the_stream_rejects_what_is_not_whole() -> None:
    found = Stream()
    found.decoder.feed(STATE[:50])
    (left,) = found.decoder.end()
    assert (left.raw, left.reason) == (STATE[:50], "truncated")


def test_nothing_is_asked_unless_it_is_configured() -> None:
    found = Stream()
    assert [found.decoder.tick() for _ in range(200)] == [b""] * 200
    assert (found.decoder.outgoing(), found.decoder.goodbye()) == (b"", b"")


@pytest.mark.parametrize("name", ["moveStart", "moveAppend", "stop", "setPowerState", "jointPos", "Toolset", ""])
def test_only_reading_commands_whose_result_is_used_may_be_configured(name: str) -> None:
    with pytest.raises(ValueError, match="is no reading command whose result is used"):
        ObjectsOptions(ask={name: 1.0})
    sent = line({"type": "command", "id": "g1", "name": name, "args": {}})
    assert re.fullmatch(OBJECTS.outgoing[0], sent, re.DOTALL) is None


def asked(found: Stream, ticks: int) -> list[Json]:
    sent = [found.decoder.tick() for _ in range(ticks)]
    questions = [one for one in sent if isinstance(one, bytes) and one]
    assert all(re.fullmatch(OBJECTS.outgoing[0], one, re.DOTALL) for one in questions)
    return [json.loads(one) for one in questions]


def test_a_question_is_answered_once() -> None:
    found = Stream(ask={"toolset": 10.0})
    (question,) = asked(found, 30)  # never two at once
    assert question == {"type": "command", "id": "g1", "name": "toolset", "args": {}}
    value = {"load": {"mass": 2.5, "cog": [0, 0, 0.1], "inertia": [0, 0, 0]}, "end": {}, "ref": {}}
    result = line({"type": "result", "id": "g1", "ok": True, "ec": 0, "message": "", "value": value})
    (event,) = found.decoder.feed(result)
    assert isinstance(event, Frame)
    toolset = event.values["toolset"]
    assert msgspec.to_builtins(toolset)["load"]["mass"] == 2.5
    assert one_reject(found.decoder, result).reason == "unrequested"
    assert found.decoder.gaps is None  # results have no number
    assert asked(found, 10)[0]["id"] == "g2"


@pytest.mark.parametrize("identifier", ["g7", "", None, 1, ["g1"], {"a": 1}])
def test_a_result_that_nobody_waits_for_is_rejected(identifier: object) -> None:
    found = Stream(ask={"toolset": 10.0})
    asked(found, 10)
    message = line({"type": "result", "id": identifier, "ok": True, "value": None})
    assert one_reject(found.decoder, message).reason == "unrequested"


def test_a_question_without_a_result_is_given_up_and_counted() -> None:
    found = Stream(ask={"toolset": 10.0})
    assert len(asked(found, 53)) == 2  # the second after five seconds
    assert found.decoder.notes == ["1 reading commands were not answered within 5 s"]
    late = line({"type": "result", "id": "g1", "ok": True, "value": None})
    assert one_reject(found.decoder, late).reason == "unrequested"


def test_a_refusal_is_noted_until_an_answer_comes() -> None:
    found = Stream(ask={"toolset": 10.0})
    for number, told, note in (
        (1, {"ok": False, "ec": 0, "message": "agent is busy", "error": "busy"}, ["the agent refuses toolset: busy"]),
        (2, {"ok": False, "ec": -5, "message": "no"}, ["the agent refuses toolset: ec -5, no"]),
        (3, {"ok": True, "ec": 0, "message": "", "value": None}, []),
    ):
        asked(found, 1)
        found.decoder.feed(line({"type": "result", "id": f"g{number}", **told}))
        assert found.decoder.notes == note


def test_a_reader_is_told_of_the_questions() -> None:
    found = Stream()
    found.decoder.asked(b'{"type":"command","id":"x","name":"toolset","args":{}}\n')
    (event,) = found.decoder.feed(line({"type": "result", "id": "x", "ok": True, "value": {}}))
    assert isinstance(event, Frame)
    for wrong in (b"toolset\n", b'{"id":"x","name":"moveStart"}\n', b'{"id":1,"name":"toolset"}\n'):
        with pytest.raises(ValueError, match=r".+"):
            found.decoder.asked(wrong)


def test_whatever_comes_can_be_sent_on() -> None:
    """Damage in every byte of each kind of message: no exception, and nothing that an encoding cannot hold."""
    messages = [
        STATE,
        line(
            {"type": "event", "seq": 1, "ts": TS, "event": "moveExecution", "data": {"cmdID": "a", "error": {"ec": 1}}}
        ),
        line({"type": "issued", "seq": 1, "ts": TS, "cmdID": "a", "class": "MoveWait", "commands": [{"duration_": 1}]}),
        line({"type": "log", "seq": 1, "ts": TS, "level": "error", "log": {"id": 1, "content": "x"}}),
    ]
    for message in messages:
        for at in range(len(message)):
            for byte in (*b'0"\\,:{}[]-x\n', 0xFF, 0):
                hurt = message[:at] + bytes([byte]) + message[at + 1 :]
                found = Stream()
                for event in found.decoder.feed(hurt + b"\n"):
                    if isinstance(event, Frame):
                        msgspec.msgpack.encode(dict(event.values))
                    elif isinstance(event, Occurrence):
                        msgspec.json.encode(event.entries)
                        msgspec.msgpack.encode(event.entries)
                assert [type(event) for event in found.decoder.feed(STATE)] == [Frame]
