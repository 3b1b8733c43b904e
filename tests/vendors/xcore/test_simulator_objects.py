"""The virtual agent's stream `xcore-objects/1`: lines by the schema, complete lists of commands, results."""

from __future__ import annotations

import itertools
import json
import time
from collections import Counter
from collections.abc import Iterable, Sequence
from typing import Any

import msgspec
import pytest

from gateway.api.model import Power, ProgramState
from gateway.sim.scenario import Fault, FaultKind, Phase, Scenario, find_scenario
from gateway.sim.simulator import VirtualRobot
from vendors.xcore.simulator.objects import ObjectsSession
from vendors.xcore.simulator.options import XcoreOptions

Line = dict[str, Any]

LONGEST = 65_536
INFO = {"id", "mac", "version", "type", "joint_num"}
UNITS = {
    "length": "m", "angle": "rad", "speed": "mm/s", "zone": "mm", "rotSpeed": "rad/s", "torque": "Nm", "mass": "kg",
    "time": "s",
}  # fmt: skip
STATE = {
    "jointPos", "jointVel", "jointTorque", "external", "posture", "cartPosture", "powerState", "operateMode",
    "operationState", "keypad", "di", "do", "ai", "errors",
}  # fmt: skip
CLASSES = (
    "MoveAbsJCommand", "MoveJCommand", "MoveLCommand", "MoveCCommand", "MoveCFCommand", "MoveSPCommand",
    "MoveWaitCommand",
)  # fmt: skip
COMMON = {"speed", "zone", "customInfo"}
MEMBERS = {
    "MoveAbsJCommand": COMMON | {"target", "jointSpeed"},
    "MoveJCommand": COMMON | {"target", "offset", "jointSpeed"},
    "MoveLCommand": COMMON | {"target", "offset", "rotSpeed"},
    "MoveCCommand": COMMON | {"target", "aux", "targetOffset", "auxOffset", "rotSpeed"},
    "MoveCFCommand": COMMON | {"target", "aux", "targetOffset", "auxOffset", "rotSpeed", "angle", "rotType"},
    "MoveSPCommand": COMMON | {"target", "targetOffset", "radius", "radius_step", "angle", "direction", "rotSpeed"},
    "MoveWaitCommand": {"duration_"},
}


def robot(scenario: str | Scenario = "steady", keep: int = 0) -> VirtualRobot:
    return VirtualRobot(find_scenario(scenario) if isinstance(scenario, str) else scenario, keep=keep)


def session(of: VirtualRobot, **options: object) -> ObjectsSession:
    return ObjectsSession(of, msgspec.convert(options, XcoreOptions))


def parsed(segments: Iterable[bytes]) -> list[Line]:
    """Every line, strictly: UTF-8, one object each, no NaN, the length of the schema."""

    def refuse(constant: str) -> None:
        raise AssertionError(constant)

    stream = b"".join(segments)
    assert stream.endswith(b"\n")
    lines = stream.splitlines(keepends=True)
    assert max(map(len, lines)) <= LONGEST
    found = [json.loads(line.decode("utf-8"), parse_constant=refuse) for line in lines]
    assert all(isinstance(line, dict) for line in found)
    return found


def played(of: ObjectsSession, seconds: float, *, begin_s: float = 0.0, step_s: float = 0.02) -> list[Line]:
    steps = range(round(seconds / step_s))
    return parsed(segment for step in steps for segment in of.due(begin_s + step * step_s))


def only(lines: Iterable[Line], *kinds: str) -> list[Line]:
    """The messages of some types, or events of some names."""
    return [line for line in lines if line["type"] in kinds or line.get("event") in kinds]


def phases(*rows: Phase) -> Scenario:
    return Scenario("made up", "", (*rows, Phase(name="rest", seconds=1000)))


def program(seconds: float) -> Phase:
    return Phase(name="program runs", seconds=seconds, rate=1.0, program=ProgramState.RUNNING)


def test_the_first_line_is_a_hello_with_the_info_and_comes_once() -> None:
    first, *rest = played(session(robot(), axes=7), 1.0)
    assert (first["type"], first["schema"], first["readOnly"], first["units"]) == (
        "hello",
        "xcore-objects/1",
        True,
        UNITS,
    )
    assert set(first) == {"type", "schema", "agent", "sdkVersion", "readOnly", "units", "info"}
    assert set(first["info"]) == INFO
    assert first["info"]["joint_num"] == 7
    assert only(rest, "hello") == []


def test_a_hello_comes_before_a_result_too() -> None:
    answers = session(robot()).received(b'{"type":"command","id":"a","name":"baseFrame"}\n', 1.0)
    assert [line["type"] for line in parsed(answers)] == ["hello", "result"]


def test_messages_are_numbered_without_a_gap_and_stamped_in_order() -> None:
    lines = played(session(robot("cell"), commands_hz=200), 75.0)[1:]
    assert [line["seq"] for line in lines] == list(range(1, len(lines) + 1))
    stamps = [line["ts"] for line in lines]
    assert all(isinstance(stamp, int) for stamp in stamps)
    assert stamps == sorted(stamps)
    assert (stamps[-1] - stamps[0]) / 1e6 == pytest.approx(75, abs=0.1)
    assert stamps[0] > 1_700_000_000_000_000
    assert {line["type"] for line in lines} == {"state", "event", "log", "issued"}


@pytest.mark.parametrize("hz", [1, 50, 1000])
def test_a_state_comes_with_every_period(hz: int) -> None:
    of = session(robot(), objects_hz=hz)
    assert of.period_s == pytest.approx(1 / hz)
    assert len(only(played(of, 5, step_s=1 / hz), "state")) == 5 * hz


def test_a_state_has_the_members_of_the_schema_in_its_shapes() -> None:
    states = only(played(session(robot("cell"), extra_joints=2), 75.0), "state")
    assert {name for state in states for name in state} == STATE | {"type", "seq", "ts"}
    powered = states[100]
    assert [len(powered[name]) for name in ("jointPos", "jointVel", "jointTorque", "external")] == [6, 6, 6, 2]
    assert {name: len(pose) for name, pose in powered["posture"].items()} == {"flangeInBase": 6, "endInRef": 6}
    assert set(powered["cartPosture"]) == {"trans", "rpy", "pos", "elbow", "hasElbow", "confData", "external"}
    assert set(powered["keypad"]) == {f"key{key}_state" for key in range(1, 8)}
    assert all(isinstance(value, bool) for value in (*powered["di"].values(), *powered["do"].values()))
    assert all(isinstance(value, float) for value in powered["ai"].values())


def test_what_cannot_be_read_is_null_and_says_why() -> None:
    (state,) = only(parsed(session(robot(phases(Phase(name="up", seconds=9, power=Power.BOOTING)))).due(1.0)), "state")
    assert state["jointTorque"] is None
    assert set(state["errors"]) == {"jointTorque"}
    assert set(state["errors"]["jointTorque"]) == {"ec", "message"}
    assert state["errors"]["jointTorque"]["ec"] != 0


@pytest.mark.parametrize(
    ("phase", "told"),
    [
        (Phase(name="idle", seconds=9), ("on", "automatic", "idle", False)),
        (program(9), ("on", "automatic", "rlProgram", False)),
        (Phase(name="pause", seconds=9, program=ProgramState.PAUSED), ("on", "automatic", "idle", False)),
        (Phase(name="by hand", seconds=9, freedrive=True), ("on", "manual", "drag", True)),
        (Phase(name="estop", seconds=9, power=Power.OFF, estop=True), ("estop", "automatic", "idle", False)),
        (Phase(name="off", seconds=9, power=Power.OFF), ("off", "automatic", "idle", False)),
        (Phase(name="up", seconds=9, power=Power.BOOTING), ("off", "automatic", "idle", False)),
    ],
)
def test_each_phase_is_told_in_the_sdks_words(phase: Phase, told: tuple[object, ...]) -> None:
    (state,) = only(parsed(session(robot(phases(phase))).due(5.0)), "state")
    words = (state["powerState"], state["operateMode"], state["operationState"], state["keypad"]["key1_state"])
    assert words == told


def test_every_line_that_tells_of_the_state_is_counted_with_what_it_means() -> None:
    of = robot(keep=50)
    state_lines = only(played(session(of), 1.0), "state", "rlExecution", "connection")
    assert of.frames == len(state_lines) == 52
    assert [json.loads(sent.frame) for sent in of.sent] == state_lines[-50:]
    for sent in of.sent:
        line = json.loads(sent.frame)
        assert {name: line[name] for name in sent.values()} == sent.values()
        assert set(line) - set(sent.values()) == {"type", "seq", "ts"}


def test_results_with_a_value_are_counted_too() -> None:
    of = robot(keep=5)
    asked_of = session(of)
    assert asked("toolset", of=asked_of)["ok"]
    assert not asked("moveStart", of=asked_of)["ok"]
    assert (of.frames, of.requests) == (1, 2)
    assert set(of.sent[0].values()) == {"id", "ok", "ec", "message", "value"}


@pytest.mark.parametrize("size", [1, 5, 100])
@pytest.mark.parametrize("hz", [40, 1000, 5000])
def test_every_command_object_is_issued_in_order_and_all_are_told(size: int, hz: int) -> None:
    lines = played(session(robot(), commands_hz=hz, commands_per_list=size), 3.0)
    lists = only(lines, "issued")
    assert [found["cmdID"] for found in lists] == [f"cmd-{number}" for number in range(1, len(lists) + 1)]
    assert [found["class"] for found in lists] == list(itertools.islice(itertools.cycle(CLASSES), len(lists)))
    number = 0
    moves = {}
    for found in lists:
        waits = found["class"] == "MoveWaitCommand"
        assert len(found["commands"]) == (1 if waits else size)
        for place, command in enumerate(found["commands"]):
            number += 1
            if not waits:
                assert command["customInfo"] == f"n-{number}"
                moves[number] = (found["cmdID"], place, f"n-{number}")
    assert number == pytest.approx(hz * 2.98, abs=size + 1)
    assert_feedback(only(lines, "moveExecution"), list(moves.values()), outstanding=size)
    assert only(lines, "lost") == []


def assert_feedback(events: Sequence[Line], moves: Sequence[tuple[str, int, str]], outstanding: int) -> None:
    """Each waypoint is heard of once, in order, and the last ones later."""
    told = [event["data"] for event in events]
    heard = [(data["cmdID"], data["wayPointIndex"], data["customInfo"]) for data in told]
    assert heard == moves[: len(heard)]
    assert len(moves) - len(heard) <= outstanding
    keys = {"cmdID", "reachTarget", "wayPointIndex", "error", "remark", "customInfo"}
    assert all(set(data) == keys and data["reachTarget"] is True for data in told)
    assert all(data["error"] == {"ec": 0, "message": ""} for data in told)


def test_an_issued_list_is_heard_of_before_its_feedback() -> None:
    known: set[str] = set()
    for line in played(session(robot(), commands_hz=700), 5.0):
        if line["type"] == "issued":
            known.add(line["cmdID"])
        if line.get("event") == "moveExecution":
            assert line["data"]["cmdID"] in known


@pytest.mark.parametrize("axes", [6, 7])
def test_commands_have_the_members_of_their_class_in_their_ranges(axes: int) -> None:
    lists = only(played(session(robot(), commands_hz=500, axes=axes), 3.0), "issued")
    seen: Counter[str] = Counter()
    for found in lists:
        assert set(found) == {"type", "seq", "ts", "cmdID", "class", "commands"}
        for command in found["commands"]:
            seen[found["class"]] += 1
            assert set(command) <= MEMBERS[found["class"]]
            assert_plausible(found["class"], command, axes)
    assert set(seen) == set(CLASSES)
    assert min(seen.values()) > 20


def assert_plausible(kind: str, command: Line, axes: int) -> None:
    if kind == "MoveWaitCommand":
        assert command["duration_"] >= 0.001
        return
    assert 5 <= command.get("speed", 100) <= 4000
    assert 0 <= command.get("zone", 0) <= 200
    if kind == "MoveAbsJCommand":
        assert len(command["target"]["joints"]) == axes
        assert all(abs(angle) < 3.2 for angle in command["target"]["joints"])
    for name in {"target", "aux"} & set(command) if kind != "MoveAbsJCommand" else ():
        assert len(command[name]["trans"]) == len(command[name]["rpy"]) == 3
        assert sum(part * part for part in command[name]["trans"]) < 1.5
    for name in {"offset", "targetOffset", "auxOffset"} & set(command):
        assert command[name]["type"] in {"offs", "relTool"}
    if kind == "MoveSPCommand":
        assert isinstance(command["direction"], bool)
    if kind == "MoveCFCommand":
        assert command.get("rotType", "constPose") in {"constPose", "rotAxis", "fixedAxis"}


def test_no_commands_come_unless_the_program_runs_and_they_are_wanted() -> None:
    assert only(played(session(robot("idle"), commands_hz=100), 5.0), "issued") == []
    assert only(played(session(robot(), commands_hz=0), 5.0), "issued", "moveExecution") == []


def test_by_default_a_list_comes_as_soon_as_the_program_runs() -> None:
    (found,) = only(played(session(robot()), 8.0), "issued")
    assert len(found["commands"]) == 5


def test_a_second_connection_goes_on_with_the_numbers_and_hears_what_was_lost() -> None:
    of = robot()
    before = only(played(session(of, commands_hz=1000), 2.0), "issued")
    after = played(session(of, commands_hz=1000), 2.0, begin_s=62.0)
    assert after[1]["type"] == "lost"
    assert (after[1]["seq"], after[1]["count"] > 60_000) == (1, True)
    first = int(only(after, "issued")[0]["cmdID"].removeprefix("cmd-"))
    assert first > int(before[-1]["cmdID"].removeprefix("cmd-")) + 10_000
    assert (first - 1) % len(CLASSES) == CLASSES.index(only(after, "issued")[0]["class"])


def test_two_connections_at_once_hear_of_the_same_commands() -> None:
    of = robot()
    one, other = session(of, commands_hz=100), session(of, commands_hz=100)
    heard: list[list[Line]] = [[], []]
    for step in range(100):
        for lines, each in zip(heard, (one, other), strict=True):
            lines.extend(parsed(each.due(step * 0.02)))
    lists = [[(line["cmdID"], line["commands"]) for line in only(lines, "issued")] for lines in heard]
    assert lists[0] == lists[1]
    assert len(lists[0]) > 20


def test_a_pause_holds_back_the_feedback() -> None:
    pause = Phase(name="pause", seconds=5, program=ProgramState.PAUSED)
    lines = played(session(robot(phases(program(2), pause, program(20)))), 20.0)
    told = only(lines, "moveExecution")
    stamps = [(event["ts"] - lines[1]["ts"]) / 1e6 for event in told[:5]]
    assert stamps == pytest.approx([1.5, 8.0, 9.5, 11.0, 12.5], abs=0.05)


@pytest.mark.parametrize(
    ("phase", "number"),
    [
        (Phase(name="fault", seconds=5, fault=Fault(FaultKind.OVER_CURRENT, 2)), 50002),
        (Phase(name="estop", seconds=5, power=Power.OFF, estop=True), 50101),
        (Phase(name="collision", seconds=5, program=ProgramState.PAUSED, collision=True), 50201),
    ],
)
def test_what_is_interrupted_has_not_reached_its_target(phase: Phase, number: int) -> None:
    told = only(played(session(robot(phases(program(2), phase))), 6.0), "moveExecution")
    assert [event["data"]["reachTarget"] for event in told] == [True, False, False, False, False]
    assert [event["data"]["error"]["ec"] for event in told] == [0, *[number] * 4]
    assert told[-1]["data"]["error"]["message"]


@pytest.mark.parametrize(
    ("phase", "level", "number", "word"),
    [
        (Phase(name="fault", seconds=5, fault=Fault(FaultKind.ENCODER, 0)), "error", 50003, "joint 1"),
        (Phase(name="fault", seconds=5, fault=Fault(FaultKind.FOLLOWING_ERROR, 5)), "error", 50004, "joint 6"),
        (Phase(name="fault", seconds=5, fault=Fault(FaultKind.OVER_TEMPERATURE, 3)), "error", 50005, "joint 4"),
        (Phase(name="estop", seconds=5, power=Power.OFF, estop=True), "error", 50101, "emergency stop"),
        (Phase(name="collision", seconds=5, collision=True), "warning", 50201, "collision"),
        (Phase(name="off", seconds=5, power=Power.OFF), "warning", 10101, "no power"),
    ],
)
def test_what_goes_wrong_is_logged_once_with_a_remedy(phase: Phase, level: str, number: int, word: str) -> None:
    logs = only(played(session(robot(phases(Phase(name="idle", seconds=1), phase))), 5.0), "log")
    (found,) = [line for line in logs if line["level"] != "info"]
    assert set(found) == {"type", "seq", "ts", "level", "log"}
    assert set(found["log"]) == {"id", "timestamp", "content", "repair"}
    assert (found["level"], found["log"]["id"]) == (level, number)
    assert word in found["log"]["content"]
    assert "irtual" in found["log"]["content"]
    assert found["log"]["repair"]


def test_a_collision_a_power_up_and_the_program_are_events() -> None:
    lines = played(session(robot("cell")), 75.0)
    assert [event["data"] for event in only(lines, "safety")] == [{"collided": True}, {"collided": False}]
    connected = [event["data"]["connected"] for event in only(lines, "connection")]
    assert connected == [True, False, True]
    programs = [event["data"] for event in only(lines, "rlExecution")]
    keys = {"taskName", "lookaheadLine", "lookaheadFile", "executeLine", "executeFile"}
    assert len(programs) > 15
    assert all(set(data) == keys for data in programs)
    assert all(data["lookaheadLine"] > data["executeLine"] > 0 for data in programs)


def asked(name: object, args: object = None, of: ObjectsSession | None = None, **others: object) -> Line:
    command = {"type": "command", "id": "c", "name": name, **({} if args is None else {"args": args}), **others}
    answers = (of or session(robot("idle"))).received(json.dumps(command).encode() + b"\n", 5.0)
    *_, found = parsed(answers)
    assert (found["type"], found["id"]) == ("result", "c")
    return found


PORT = {"board": 0, "port": 0}


@pytest.mark.parametrize(
    ("name", "args", "form"),
    [
        ("robotInfo", None, dict),
        ("jointPos", {}, dict),
        ("posture", {"ct": "flangeInBase"}, list),
        ("cartPosture", {"ct": "endInRef"}, dict),
        ("baseFrame", None, list),
        ("toolset", None, dict),
        ("toolsInfo", None, list),
        ("wobjsInfo", None, list),
        ("projectsInfo", None, list),
        ("getDI", PORT, bool),
        ("getDO", PORT, bool),
        ("getAI", PORT, float),
        ("readRegister", {"name": "virtual_count", "type": "int"}, int),
        ("readRegister", {"name": "virtual_level", "type": "float", "array": True}, list),
        ("getSoftLimit", None, dict),
        ("getKeypadState", None, dict),
        ("queryControllerLog", {"count": 3, "level": ["error"]}, list),
    ],
)
def test_a_reading_command_has_a_value(name: str, args: object, form: type) -> None:
    found = asked(name, args)
    assert set(found) == {"type", "id", "ok", "ec", "message", "value"}
    assert (found["ok"], found["ec"]) == (True, 0)
    assert type(found["value"]) is form


def test_commands_and_state_agree() -> None:
    of = session(robot("cell"), extra_joints=1)
    (state,) = only(parsed(of.due(5.0)), "state")
    joints = asked("jointPos", of=of)["value"]
    assert (joints["joints"], joints["external"]) == (state["jointPos"], state["external"])
    assert asked("posture", {"ct": "endInRef"}, of)["value"] == state["posture"]["endInRef"]
    assert asked("cartPosture", {"ct": "endInRef"}, of)["value"] == state["cartPosture"]
    assert asked("getDO", PORT, of)["value"] == state["do"]["gripper"]
    assert asked("projectsInfo", of=of)["value"][0] == {"name": "virtual_cell", "taskList": ["task_main"]}


def test_the_log_can_be_read_back_newest_first() -> None:
    of = session(robot("cell"))
    logs = [line["log"] for line in only(played(of, 75.0), "log") if line["level"] == "error"]
    assert asked("queryControllerLog", {"level": ["error"]}, of)["value"] == logs[::-1]
    assert asked("queryControllerLog", {"level": ["error"], "count": 1, "offset": 1}, of)["value"] == [logs[-2]]


@pytest.mark.parametrize(
    "name",
    [
        "setOperateMode", "setPowerState", "setMotionControlMode", "setDefaultSpeed", "setDefaultZone", "moveReset",
        "moveAppend", "moveStart", "stop", "clearServoAlarm",
    ],
)  # fmt: skip
def test_what_is_reserved_is_refused(name: str) -> None:
    assert asked(name, {"class": "MoveLCommand", "commands": []}) == {
        "type": "result",
        "id": "c",
        "ok": False,
        "ec": 0,
        "message": "agent is read-only",
        "error": "read_only",
    }


@pytest.mark.parametrize(
    ("name", "args", "error"),
    [
        ("reboot", None, "unsupported"),
        (7, None, "bad_request"),
        ("jointPos", [], "bad_request"),
        ("jointPos", {"n": 1}, "bad_request"),
        ("posture", {}, "bad_request"),
        ("posture", {"ct": "world"}, "bad_request"),
        ("getDI", {"board": 0}, "bad_request"),
        ("getDI", {"board": True, "port": 0}, "bad_request"),
        ("getDI", {"board": -1, "port": 0}, "range"),
        ("readRegister", {"name": "virtual_count", "type": "text"}, "bad_request"),
        ("readRegister", {"name": "", "type": "int"}, "bad_request"),
        ("readRegister", {"name": "virtual_count", "type": "int", "array": 1}, "bad_request"),
        ("queryControllerLog", {"count": 11}, "range"),
        ("queryControllerLog", {"level": "error"}, "bad_request"),
        ("queryControllerLog", {"level": ["fatal"]}, "bad_request"),
        ("queryControllerLog", {"level": [["error"]]}, "bad_request"),
    ],
)
def test_what_is_asked_wrongly_is_refused(name: object, args: object, error: str) -> None:
    found = asked(name, args)
    assert (found["ok"], found["ec"], found["error"]) == (False, 0, error)
    assert found["message"]
    assert "value" not in found


def test_an_unknown_member_of_a_command_is_refused() -> None:
    assert asked("jointPos", more=1)["error"] == "bad_request"


@pytest.mark.parametrize(
    ("name", "args"),
    [
        ("getDI", {"board": 1, "port": 0}),
        ("getAI", {"board": 0, "port": 1}),
        ("readRegister", {"name": "other", "type": "int"}),
        ("readRegister", {"name": "virtual_count", "type": "bool"}),
        ("readRegister", {"name": "virtual_count", "type": "int", "index": 4}),
    ],
)
def test_what_the_sdk_fails_at_has_a_number_and_no_word_of_the_agent(name: str, args: object) -> None:
    found = asked(name, args)
    assert set(found) == {"type", "id", "ok", "ec", "message"}
    assert not found["ok"]
    assert found["ec"] != 0


@pytest.mark.parametrize("wrong", [{}, {"id": 7}, {"id": None}, {"id": "x" * 257}])
def test_a_command_without_a_proper_id_is_refused_without_one(wrong: Line) -> None:
    line = json.dumps({"type": "command", "name": "jointPos", **wrong}).encode() + b"\n"
    *_, found = parsed(session(robot()).received(line, 1.0))
    assert (found["id"], found["ok"], found["error"]) == ("", False, "bad_request")


@pytest.mark.parametrize(
    "line",
    [
        b"no json", b"[]", b"7", b"{}", b'{"type":"state"}', b'{"type":"command","id":"a","name":NaN}', b"\xff\xfe",
        b"[" * 60_000, b'{"type":"command","id":"a","name":"jointPos","args":{}', b"x" * LONGEST, b"x" * 3 * LONGEST,
    ],
)  # fmt: skip
def test_a_line_that_is_no_command_is_counted_and_the_next_one_answered(line: bytes) -> None:
    of = robot()
    answers = session(of).received(line + b'\n\n \r\n{"type":"command","id":"b","name":"baseFrame"}\r\n', 1.0)
    assert [found.get("id") for found in parsed(answers)] == [None, "b"]
    assert of.settings["rejected_lines"] == 1
    assert of.requests == 1


def test_commands_are_answered_however_they_are_cut() -> None:
    names = ("robotInfo", "jointPos", "moveStart", "getDI", "fly")
    stream = b"".join(
        json.dumps({"type": "command", "id": str(number), "name": name}).encode() + b"\n"
        for number, name in enumerate(names)
    )
    whole = session(robot()).received(stream, 2.0)
    single = session(robot())
    assert [found for byte in stream for found in single.received(bytes([byte]), 2.0)] == whole
    assert [line["id"] for line in only(parsed(whole), "result")] == ["0", "1", "2", "3", "4"]


def test_lines_that_are_too_long_come_when_they_are_asked_for() -> None:
    of = session(robot("idle"), overlong_s=1.0)
    segments = [segment for step in range(205) for segment in of.due(step * 0.02)]
    long = [line for line in b"".join(segments).splitlines(keepends=True) if len(line) > LONGEST]
    assert len(long) == 4


def test_a_list_of_100_commands_fits_into_a_line() -> None:
    lists = [
        line
        for segment in session(robot(), commands_hz=5000, commands_per_list=100).due(0.0)
        for line in segment.splitlines()
    ]
    of = session(robot(), commands_hz=5000, commands_per_list=100, axes=7)
    lists += [line for step in range(50) for segment in of.due(step * 0.02) for line in segment.splitlines()]
    assert 20_000 < max(map(len, lists)) < LONGEST


def test_1000_commands_a_second_cost_no_more_than_reading_them() -> None:
    of = session(robot(), commands_hz=1000)
    of.due(0.0)
    ratios = []
    for turn in range(3):
        begin = time.perf_counter()
        segments = [segment for step in range(1, 251) for segment in of.due(turn * 5.0 + step * 0.02)]
        made = time.perf_counter()
        lines = b"".join(segments).splitlines()
        begin_reading = time.perf_counter()
        for line in lines:
            json.loads(line)
        ratios.append((made - begin) / (time.perf_counter() - begin_reading))
    assert min(ratios) < 2.0
