"""The xCore objects: names, defaults and ranges of the vendor's page, and that codec and JSON Schema say the same."""

from __future__ import annotations

import copy
import json
import math
import time
from collections.abc import Iterator

import jsonschema
import pytest
from hypothesis import given
from hypothesis import strategies as st
from jsonschema import Draft202012Validator

from vendors.xcore import enums
from vendors.xcore.checking import (
    CLASSES,
    ObjectError,
    class_named,
    command_of,
    commands_of,
    list_problems_of,
    object_of,
    problems_of,
)
from vendors.xcore.commands import COMMAND_CLASSES, MoveAbsJCommand, MoveLCommand, MoveWaitCommand
from vendors.xcore.encoding import SCHEMAS, schemas, to_builtins
from vendors.xcore.enums import CartesianPositionOffsetType, OperateMode, PowerState, WorkType
from vendors.xcore.objects import CartesianPosition, CartesianPositionOffset, Frame

Json = dict[str, object]
Path = tuple[str | int, ...]

# Every member of every object, written down from the page (and, for StateList and the base of the moves, from the SDK).
FRAME: Json = {"trans": [0.1, -0.2, 0.3], "rpy": [0.0, 1.5, -3.1], "pos": [float(n) for n in range(16)]}
POSE: Json = {**FRAME, "elbow": 0.4, "hasElbow": True, "confData": [0, -1, 0, 0, 1, 0, 2, 3], "external": [0.7]}
OFFSET: Json = {"type": "relTool", "frame": FRAME}
JOINTS: Json = {"joints": [0.0, 0.5, -0.5, 0.0, 1.5, 0.0], "external": [0.1, 0.2]}
LOAD: Json = {"mass": 2.5, "cog": [0.0, 0.0, 0.1], "inertia": [0.01, 0.02, 0.03]}
MOVE: Json = {"speed": 200.0, "zone": 10.0, "customInfo": "p1"}
ARC: Json = {"target": POSE, "aux": POSE, "targetOffset": OFFSET, "auxOffset": OFFSET, "rotSpeed": 0.5}
_EXAMPLES: dict[str, Json] = {
    "Info": {"id": "demo", "mac": "00:11", "version": "3.2.1", "type": "CR7", "joint_num": 6},
    "StateList": {
        "joint_pos": [0.0, 0.5, -0.5, 0.0, 1.5, 0.0, 0.1],
        "cart_pos": POSE,
        "digital_signals": [["DI0_0", True]],
        "analog_signals": [["AI0_0", 1.5]],
        "operation_mode": "automatic",
        "speed_override": 1.0,
    },
    "Frame": FRAME,
    "CartesianPosition": POSE,
    "CartesianPositionOffset": OFFSET,
    "JointPosition": JOINTS,
    "Torque": {"tau": [1.0, 2.0, 3.0]},
    "Load": LOAD,
    "Toolset": {"load": LOAD, "end": FRAME, "ref": FRAME},
    "FrameCalibrationResult": {"frame": FRAME, "errors": [0.0001, 0.0002, 0.0003]},
    "RLProjectInfo": {"name": "weld", "taskList": ["task0", "task1"]},
    "WorkToolInfo": {"name": "g_tool_0", "alias": "torch", "robotHeld": True, "pos": FRAME, "load": LOAD},
    "MoveAbsJCommand": {**MOVE, "target": JOINTS, "jointSpeed": 0.5},
    "MoveJCommand": {**MOVE, "target": POSE, "offset": OFFSET, "jointSpeed": 0.5},
    "MoveLCommand": {**MOVE, "target": POSE, "offset": OFFSET, "rotSpeed": 0.5},
    "MoveCCommand": {**MOVE, **ARC},
    "MoveCFCommand": {**MOVE, **ARC, "angle": 6.28, "rotType": "rotAxis"},
    "MoveSPCommand": {
        **MOVE, "target": POSE, "targetOffset": OFFSET, "radius": 0.01, "radius_step": 0.001, "angle": 12.0,
        "direction": True, "rotSpeed": 0.5,
    },
    "MoveWaitCommand": {"duration_": 0.5},
    "LogInfo": {"id": 50002, "timestamp": "2024-01-01", "content": "stopped", "repair": "start"},
    "KeyPadState": {f"key{n}_state": True for n in range(1, 8)},
}  # fmt: skip
EXAMPLES: dict[str, Json] = json.loads(json.dumps(_EXAMPLES))  # no two objects share a part
VALIDATORS = {name: Draft202012Validator(schema) for name, schema in schemas().items()}
NOT_FINITE = (math.nan, math.inf, -math.inf, 10**400)


def leaves(value: object, path: Path = ()) -> Iterator[tuple[Path, object]]:
    """Every member and element below a value, objects and arrays too."""
    if path:
        yield path, value
    if isinstance(value, dict):
        for name, item in value.items():
            yield from leaves(item, (*path, name))
    elif isinstance(value, list):
        for index, item in enumerate(value):
            yield from leaves(item, (*path, index))


def put(value: Json, path: Path, new: object) -> Json:
    """A copy with something else in one place."""
    changed = copy.deepcopy(value)
    at: object = changed
    for step in path[:-1]:
        at = at[step] if isinstance(at, dict | list) else None  # type: ignore[index]
    assert isinstance(at, dict | list)
    at[path[-1]] = new  # type: ignore[index]
    return changed


def spelt(path: Path) -> str:
    """A path as errors have it."""
    return "".join(f"[{step}]" if isinstance(step, int) else f".{step}" for step in path).removeprefix(".")


def wrong_for(value: object) -> tuple[object, ...]:
    """What may not stand where this value may."""
    match value:
        case bool():
            return (1, 0, "true", None, [], {})
        case int() | float():
            return (True, False, "1", None, [], {}, *NOT_FINITE)
        case str() if value in {"relTool", "automatic", "rotAxis"}:
            return (2, True, None, "nonsense", "", [], {})
        case str():
            return (1, True, None, [], {})
        case list():
            return ("x", 1, True, None, {})
        case _:
            return ("x", 1, True, None, [])


def test_every_object_of_the_page_is_there() -> None:
    assert set(EXAMPLES) == set(CLASSES) == set(SCHEMAS)


@pytest.mark.parametrize("name", EXAMPLES)
def test_every_member_comes_back_as_it_went_in(name: str) -> None:
    made = object_of(name, EXAMPLES[name])
    assert type(made).__name__ == name
    assert to_builtins(made) == EXAMPLES[name]
    again = json.loads(json.dumps(to_builtins(made, omit_defaults=True)))
    assert object_of(name, again) == made
    VALIDATORS[name].validate(EXAMPLES[name])
    assert problems_of(name, EXAMPLES[name]) == ()


def test_values_stand_in_the_members_of_the_sdks_names() -> None:
    move = command_of("MoveL", EXAMPLES["MoveLCommand"])
    assert isinstance(move, MoveLCommand)
    assert move.target.trans == (0.1, -0.2, 0.3)
    assert move.target.confData[7] == 3
    assert move.offset.type is CartesianPositionOffsetType.relTool
    assert (move.speed, move.zone, move.rotSpeed, move.customInfo) == (200.0, 10.0, 0.5, "p1")


def test_what_is_left_out_has_the_sdks_default() -> None:
    move = command_of("MoveL", {"target": {}})
    assert isinstance(move, MoveLCommand)
    assert (move.speed, move.zone, move.rotSpeed, move.customInfo) == (-1, -1, -1, "")
    assert move.target == CartesianPosition(trans=(0.0, 0.0, 0.0), rpy=(0.0, 0.0, 0.0), pos=(), elbow=0.0)
    assert move.offset == CartesianPositionOffset(type=CartesianPositionOffsetType.none, frame=Frame())
    assert to_builtins(move, omit_defaults=True) == {"target": {}}
    assert to_builtins(object_of("Load", {}))["inertia"] == [0.0, 0.0, 0.0]


@pytest.mark.parametrize("name", EXAMPLES)
def test_a_value_of_another_kind_is_refused_by_its_path(name: str) -> None:
    for path, value in leaves(EXAMPLES[name]):
        for wrong in wrong_for(value):
            changed = put(EXAMPLES[name], path, wrong)
            found = problems_of(name, changed)
            assert [problem.path for problem in found] == [spelt(path)], wrong
            with pytest.raises(ObjectError) as caught:
                object_of(name, changed)
            assert caught.value.path == spelt(path)
            assert caught.value.found
            assert caught.value.allowed
            assert spelt(path) in str(caught.value)


RANGES: list[tuple[str, str, list[object], list[object]]] = [
    # class, member, allowed, refused
    ("Info", "joint_num", [3, 7, 6.0], [2, 8, 6.5]),
    ("Frame", "trans", [[0, 0, 0]], [[], [0, 0], [0, 0, 0, 0]]),
    ("Frame", "rpy", [[0, 0, 0]], [[], [0, 0], [0, 0, 0, 0]]),
    ("Frame", "pos", [[], [0] * 16], [[0], [0] * 12, [0] * 15, [0] * 17]),
    ("CartesianPosition", "confData", [[], [0] * 8, [0.0] * 8], [[0], [0] * 6, [0] * 7, [0] * 9]),
    ("CartesianPosition", "external", [[], [0.1] * 9], []),
    ("CartesianPositionOffset", "type", ["none", "offs", "relTool", "Offs", "RelTool"], ["reltool", "OFFS"]),
    ("JointPosition", "joints", [[0] * 3, [0] * 7], [[], [0] * 2, [0] * 8]),
    ("Torque", "tau", [[0] * 3, [0] * 7], [[], [0] * 2, [0] * 8]),
    ("Load", "mass", [0, 0.0, 900], [-0.001, -1]),
    ("Load", "cog", [[0, 0, -0.1]], [[0], [0] * 4]),
    ("Load", "inertia", [[0, 0, 0.1]], [[0], [0] * 4]),
    ("FrameCalibrationResult", "errors", [[0, 0, 0]], [[], [0] * 2, [0] * 4]),
    ("MoveLCommand", "speed", [-1, 5, 4000, 7000, 5.5], [0, 4.999, 7000.5, -2, -0.5]),
    ("MoveLCommand", "zone", [-1, 0, 200], [-0.1, 200.1, -2]),
    ("MoveLCommand", "rotSpeed", [-1, 0, 100], [-0.5, -2]),
    ("MoveSPCommand", "rotSpeed", [-1, 0, 100], [-0.5, -2]),
    ("MoveAbsJCommand", "jointSpeed", [-1, 0, 1, 0.3], [-0.1, 1.5, -2, 100]),
    ("MoveJCommand", "jointSpeed", [-1, 0, 1, 0.3], [-0.1, 1.5, -2, 100]),
    ("MoveWaitCommand", "duration_", [0.001, 1, 3600], [0, 0.0009, -1]),
    ("LogInfo", "id", [0, -5, 2**31 - 1], [2**31, 1.5]),
]


@pytest.mark.parametrize(("name", "member", "allowed", "refused"), RANGES)
def test_ranges_are_those_of_the_protocol(name: str, member: str, allowed: list[object], refused: list[object]) -> None:
    for value in allowed:
        made = {**EXAMPLES[name], member: value}
        assert problems_of(name, made) == ()
        object_of(name, made)
        assert VALIDATORS[name].is_valid(made)
    for value in refused:
        made = {**EXAMPLES[name], member: value}
        assert [problem.path for problem in problems_of(name, made)] == [member], value
        assert not VALIDATORS[name].is_valid(made), value


def test_a_collaborative_robot_is_slower() -> None:
    fast = {"target": {}, "speed": 4000.5}
    assert problems_of("MoveL", fast, work_type=WorkType.industrial) == ()
    (problem,) = problems_of("MoveL", fast, work_type=WorkType.collaborative)
    assert str(problem) == "speed: 4000.5 is not -1 or a number from 5 to 4000"
    with pytest.raises(ObjectError, match=r"MoveLCommand: speed: 4000.5"):
        command_of("MoveL", fast, work_type=WorkType.collaborative)
    command_of("MoveL", {"target": {}, "speed": 4000}, work_type=WorkType.collaborative)


@pytest.mark.parametrize(
    ("name", "value", "path"),
    [
        ("MoveAbsJ", {"target": {"joints": [0] * 6}}, "target.joints"),
        ("JointPosition", {"joints": [0] * 6}, "joints"),
        ("Torque", {"tau": [0] * 6}, "tau"),
        ("StateList", {"joint_pos": [0] * 6, "operation_mode": "manual", "speed_override": 1}, "joint_pos"),
    ],
)
def test_joints_are_as_many_as_the_robot_has_axes(name: str, value: Json, path: str) -> None:
    assert problems_of(name, value, axes=6) == ()
    assert problems_of(name, value) == ()
    (problem,) = problems_of(name, value, axes=7)
    assert str(problem) == f"{path}: has 6 elements; the robot has 7 axes"
    with pytest.raises(ObjectError, match="7 axes"):
        object_of(name, value, axes=7)


@pytest.mark.parametrize(
    ("name", "missing"),
    [
        ("MoveAbsJCommand", {"target"}),
        ("MoveCCommand", {"target", "aux"}),
        ("MoveSPCommand", {"target", "direction"}),
        ("MoveWaitCommand", {"duration_"}),
        ("JointPosition", {"joints"}),
        ("LogInfo", {"id"}),
        ("Frame", set()),
    ],
)
def test_what_has_no_default_must_be_given(name: str, missing: set[str]) -> None:
    found = problems_of(name, {})
    assert {problem.path for problem in found} == missing
    assert all(problem.message == "is missing" for problem in found)
    assert VALIDATORS[name].is_valid({}) is not bool(missing)


def test_an_unknown_member_is_refused_with_the_nearest_name_and_all_problems_are_told() -> None:
    found = problems_of("MoveL", {"targt": {}, "speed": 4, "zone": True, "offset": {"frame": {"tarns": []}}})
    assert [str(problem) for problem in found] == [
        'targt: is no known member; did you mean "target"?',
        "speed: 4 is not -1 or a number from 5 to 7000",
        "zone: true is not -1 or a number from 0 to 200",
        'offset.frame.tarns: is no known member; did you mean "trans"?',
    ]
    assert "the members are" in problems_of("Frame", {"qqq": 1})[0].message


def test_unknown_members_of_a_later_agent_are_passed_over_on_request() -> None:
    later = {"trans": [1, 2, 3], "new": {"x": 1}}
    assert object_of("Frame", later, lenient=True) == Frame(trans=(1.0, 2.0, 3.0))
    with pytest.raises(ObjectError, match="new: is no known member"):
        object_of("Frame", later)
    with pytest.raises(ObjectError, match=r"trans\[0\]"):
        object_of("Frame", {"trans": [None, 2, 3], "new": 1}, lenient=True)


def test_thousands_of_problems_are_counted_not_told() -> None:
    found = problems_of("Frame", {f"m{n}": n for n in range(5000)})
    assert len(found) == 101
    assert found[-1].message == "4900 more problems"
    assert len(problems_of("CartesianPosition", {"external": ["x"] * 5000})) == 101


@pytest.mark.parametrize("value", [None, [], "x", 1, True])
def test_what_is_no_object_is_one_problem(value: object) -> None:
    (problem,) = problems_of("MoveL", value)
    assert problem.path == ""
    assert problem.message.endswith("is not an object")


def test_the_spellings_of_the_page_are_taken() -> None:
    assert class_named("WorkToollnfo") is class_named("WorkToolInfo")
    assert class_named("Loglnfo") is class_named("LogInfo")
    for name, found in COMMAND_CLASSES.items():
        assert class_named(name.removesuffix("Command")) is found
    for page, sdk in (("Offs", "offs"), ("RelTool", "relTool")):
        made = object_of("CartesianPositionOffset", {"type": page})
        assert to_builtins(made)["type"] == sdk
    assert command_of("MoveWait", {"duration_": 1}) == MoveWaitCommand(duration_=1.0)
    ints = command_of("MoveAbsJ", {"target": {"joints": [0, 1, 2]}, "speed": 100, "zone": 5})
    assert isinstance(ints, MoveAbsJCommand)
    assert (ints.speed, ints.zone) == (100.0, 5.0)


def test_an_unknown_class_is_told_with_the_nearest_one() -> None:
    with pytest.raises(ObjectError, match='"MovL" is no known class; did you mean "MoveL"'):
        command_of("MovL", {})
    with pytest.raises(ObjectError, match="known are MoveAbsJCommand, "):
        command_of("Frame", {})
    assert problems_of("Loadd", {})[0].message.endswith('did you mean "Load"?')


def test_half_a_surrogate_pair_is_no_text() -> None:
    text = json.loads('"\\ud800"')
    (problem,) = problems_of("MoveL", {"target": {}, "customInfo": text})
    assert str(problem) == 'customInfo: "\\ud800" is not text'
    assert problems_of("MoveL", {"target": {}, "customInfo": "\N{ROBOT FACE}"}) == ()


def test_a_moveappend_has_1_to_100_commands_of_one_class_and_a_wait_stands_alone() -> None:
    one: Json = {"target": {"joints": [0] * 6}}
    assert len(commands_of("MoveAbsJ", [one] * 100, axes=6)) == 100
    assert len(commands_of("MoveAbsJ", [{**one, "class": "MoveAbsJCommand"}])) == 1
    assert commands_of("MoveWait", [{"duration_": 1}]) == (MoveWaitCommand(duration_=1.0),)
    wrong: list[tuple[str, list[Json], str]] = [
        ("MoveAbsJ", [], "commands: is empty; allowed: 1 to 100 commands"),
        ("MoveAbsJ", [one] * 101, "commands: has 101 commands; allowed: 1 to 100 commands"),
        ("MoveWait", [{"duration_": 1}] * 2, "commands: has 2 commands; allowed: 1 command, because MoveWait stands"),
        ("MoveAbsJ", [one, {**one, "speed": 1}], "commands[1].speed: 1 is not -1 or a number from 5 to 7000"),
        ("MoveAbsJ", [{**one, "class": "MoveL"}], 'commands[0].class: "MoveL" is not "MoveAbsJ", the one class'),
        ("MoveX0", [one], 'class: "MoveX0" is no known class'),
    ]
    for name, values, says in wrong:
        with pytest.raises(ObjectError) as caught:
            commands_of(name, values)
        assert str(caught.value.problems[0]).startswith(says)
    assert str(list_problems_of(3, "x")[0]) == "class: 3 is not the name of a command class"
    assert str(list_problems_of(3, "x")[1]) == 'commands: "x" is not an array of commands'


NUMBERS = {
    "PowerState": {"on": 0, "off": 1, "estop": 2, "gstop": 3, "unknown": -1},
    "OperateMode": {"manual": 0, "automatic": 1, "unknown": -1},
    "OperationState": {
        "idle": 0, "jog": 1, "rtControlling": 2, "drag": 3, "rlProgram": 4, "demo": 5, "dynamicIdentify": 6,
        "frictionIdentify": 7, "loadIdentify": 8, "moving": 9, "jogging": 10, "unknown": -1,
    },
    "MotionControlMode": {"Idle": 0, "NrtCommandMode": 1, "NrtRLTask": 2, "RtCommandMode": 3},
    "CartesianPositionOffsetType": {"none": 0, "offs": 1, "relTool": 2},
    "MoveCFCommandRotType": {"constPose": 0, "rotAxis": 1, "fixedAxis": 2},
    "CoordinateType": {"flangeInBase": 0, "endInRef": 1},
    "Event": {"moveExecution": 0, "safety": 1, "rlExecution": 2, "logReporter": 3},
    "LogInfoLevel": {"info": 0, "warning": 1, "error": 2},
    "StopLevel": {"stop0": 0, "stop1": 1, "stop2": 2, "suppleStop": 3},
    "FrameType": {"world": 0, "base": 1, "flange": 2, "tool": 3, "wobj": 4, "path": 5, "rail": 6},
    "JogOptSpace": {
        "world": 0, "flange": 1, "baseFrame": 2, "toolFrame": 3, "wobjFrame": 4, "jointSpace": 5,
        "singularityAvoidMode": 6, "baseParallelMode": 7,
    },
    "WorkType": {"industrial": 0, "collaborative": 1},
    "RtControllerMode": {
        "jointPosition": 0, "cartesianPosition": 1, "jointImpedance": 2, "cartesianImpedance": 3, "torque": 4,
    },
    "AvoidSingularityMethod": {"lockAxis4": 0, "wrist": 1, "jointWay": 2},
    "DragParameterSpace": {"jointSpace": 0, "cartesianSpace": 1},
    "DragParameterType": {"translationOnly": 0, "rotationOnly": 1, "freely": 2},
    "xPanelOptVout": {"off": 0, "reserve": 1, "supply12v": 2, "supply24v": 3},
}  # fmt: skip


def test_enumerations_have_the_sdks_names_and_numbers() -> None:
    assert {name: {str(member.value): member.number for member in found} for name, found in enums.ENUMS.items()} == (
        NUMBERS
    )
    for found in enums.ENUMS.values():
        assert all(found.of_number(member.number) is member and member.name == member.value for member in found)
    assert PowerState.of_number(0) is PowerState.on
    assert OperateMode("automatic").number == 1
    with pytest.raises(ValueError, match="PowerState has no number 7"):
        PowerState.of_number(7)
    with pytest.raises(ValueError, match="nonsense"):
        PowerState("nonsense")


@pytest.mark.parametrize("name", EXAMPLES)
def test_schemas_are_valid_and_tell_units(name: str) -> None:
    Draft202012Validator.check_schema(SCHEMAS[name])
    jsonschema.validate(json.loads(json.dumps(EXAMPLES[name])), json.loads(json.dumps(SCHEMAS[name])))
    found = SCHEMAS["Load"]["$defs"]
    assert isinstance(found, dict)
    assert found["Load"]["properties"]["mass"]["unit"] == "kg"
    assert found["MoveLCommand"]["properties"]["speed"]["unit"] == "mm/s"


JUNK = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(-10, 10_000),
    st.integers(),
    st.floats(allow_nan=False, allow_infinity=False),
    st.sampled_from([-1, -1.0, 0, 0.5, 1, 4.9, 5, 200, 200.5, 7000, 7001, 0.001, 0.0009]),
    st.sampled_from(["Offs", "RelTool", "offs", "none", "rotAxis", "automatic", ""]),
    st.text(st.characters(codec="utf-8"), max_size=3),
    st.lists(st.floats(-10, 10), max_size=17),
    st.lists(st.integers(-3, 3), max_size=17),
    st.lists(st.booleans(), max_size=3),
    st.dictionaries(st.sampled_from(["trans", "joints", "x"]), st.lists(st.integers(0, 3), max_size=4), max_size=2),
)


@st.composite
def changed_examples(draw: st.DrawFn) -> tuple[str, Json]:
    """An object with some members gone, and perhaps junk in some places or a member that nobody knows."""
    name = draw(st.sampled_from(list(EXAMPLES)))
    value = copy.deepcopy(EXAMPLES[name])
    for _ in range(draw(st.integers(0, 3))):
        paths = [path for path, _ in leaves(value)]
        if not paths:
            break
        path = draw(st.sampled_from(paths))
        kind = draw(st.sampled_from(["junk", "junk", "gone", "more"]))
        if kind == "junk":
            value = put(value, path, draw(JUNK))
        elif kind == "more":
            more = (*path[:-1], "more") if isinstance(path[-1], str) else path
            value = put(value, more, draw(JUNK))
        else:
            at: object = value
            for step in path[:-1]:
                at = at[step] if isinstance(at, dict | list) else None  # type: ignore[index]
            assert isinstance(at, dict | list)
            del at[path[-1]]  # type: ignore[arg-type]
    return name, value


@given(changed_examples())
def test_codec_list_of_problems_and_schema_agree(found: tuple[str, Json]) -> None:
    name, value = found
    valid = VALIDATORS[name].is_valid(value)
    assert (problems_of(name, value) == ()) is valid
    if valid:
        made = object_of(name, value)
        assert object_of(name, to_builtins(made)) == made
        assert object_of(name, to_builtins(made, omit_defaults=True)) == made
        assert VALIDATORS[name].is_valid(to_builtins(made, omit_defaults=True))
    else:
        with pytest.raises(ObjectError):
            object_of(name, value)


def test_a_thousand_objects_a_second_are_next_to_nothing() -> None:
    move = EXAMPLES["MoveLCommand"]
    began = time.process_time()
    for _ in range(1000):
        command_of("MoveL", move, axes=6, work_type=WorkType.industrial)
    assert time.process_time() - began < 0.1
