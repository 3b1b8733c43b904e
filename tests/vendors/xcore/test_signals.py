"""What the words of External Communication and the members of the stream become in the canonical model."""

from __future__ import annotations

from collections.abc import Mapping

import pytest

from gateway.api.decoder import Frame
from gateway.api.model import Quality
from gateway.api.normaliser import Normaliser
from gateway.testing.readings import Plain, read_group
from vendors.xcore import VENDOR
from vendors.xcore.external_words import RECORD as WORDS
from vendors.xcore.stream_record import RECORD as STREAM
from vendors.xcore.stream_record import Execution, Posture

EXTERNAL, OBJECTS = VENDOR.protocols
OPTIONS: dict[str, object] = {"estop_polarity": None, "axes": 6, "torque_unit": None}


def external(group: str, told: Mapping[str, object], **options: object) -> tuple[Plain, Quality]:
    reading = read_group(
        Normaliser(EXTERNAL.signals, {**OPTIONS, **options}), group, Frame(b"x", WORDS, values=dict(told))
    )
    return reading.data, reading.quality


def stream(group: str, **told: object) -> Plain:
    return read_group(
        Normaliser(OBJECTS.signals, {"estop_polarity": None}), group, Frame(b"x", STREAM, values=told)
    ).data


def at(data: Plain, path: str) -> object:
    found: object = data
    for name in path.split("."):
        assert isinstance(found, dict)
        found = found[name]
    return found


@pytest.mark.parametrize(
    ("polarity", "told", "pressed", "quality", "state"),
    [
        (None, True, None, "GOOD", None),
        (None, False, None, "GOOD", None),
        (None, None, None, "GOOD", None),
        ("active_high", True, True, "GOOD", "EMERGENCY_STOP"),
        ("active_high", False, None, "GOOD", None),  # released, or a query that has failed
        ("active_high", None, None, "GOOD", None),
        ("active_low", True, False, "GOOD", None),
        ("active_low", False, True, "UNCERTAIN", "EMERGENCY_STOP"),  # pressed, or a query that has failed
        ("active_low", None, None, "GOOD", None),
    ],
)
def test_the_emergency_stop_by_its_level(
    polarity: str | None,
    told: bool | None,  # noqa: FBT001 - a value of the table
    pressed: bool | None,  # noqa: FBT001
    quality: str,
    state: str | None,
) -> None:
    status, status_quality = external("status", {"estop_state": told}, estop_polarity=polarity)
    safety, safety_quality = external("safety", {"estop_state": told}, estop_polarity=polarity)
    assert status["e_stopped"] is pressed
    assert safety["state"] == state
    assert (status_quality, safety_quality) == (quality, quality)
    if told is None:
        assert safety["functions"] is None
        return
    assert isinstance(safety["functions"], list)
    estop = safety["functions"][0]
    assert (estop["name"], estop["kind"], estop["active"], estop["raw"]) == ("estop_state", "estop", pressed, told)


@pytest.mark.parametrize("polarity", [None, "active_high", "active_low"])
@pytest.mark.parametrize("collision", [None, False, True])
@pytest.mark.parametrize("estop", [None, False, True])
def test_external_communication_never_says_that_all_is_well(
    polarity: str | None,
    estop: bool | None,  # noqa: FBT001 - a value of the table
    collision: bool | None,  # noqa: FBT001
) -> None:
    told = {"estop_state": estop, "collision_state": collision, "fault_state": False, "motor_on_state": True}
    safety, _ = external("safety", told, estop_polarity=polarity)
    assert safety["state"] in {None, "EMERGENCY_STOP", "PROTECTIVE_STOP"}
    assert safety["collision"] in {None, True}
    assert (safety["collision"] is True) == (collision is True)
    status, _ = external("status", told, estop_polarity=polarity)
    assert (status["in_error"], status["faults"]) == (None, None)


@pytest.mark.parametrize(
    ("told", "path", "expected"),
    [
        ({"fault_state": True}, "in_error", True),
        ({"fault_state": False}, "in_error", None),
        ({"operating_mode": True}, "operating_mode", "AUTOMATIC"),
        ({"operating_mode": False}, "operating_mode", None),
        ({"motor_on_state": True}, "power", "ENABLED"),
        ({"motor_on_state": False}, "power", None),
        ({"motor_on_state": True}, "drives_powered", True),
        ({"motor_on_state": False}, "drives_powered", None),
        ({"robot_running_state": True}, "program.state", "RUNNING"),
        ({"robot_running_state": True, "task_state": "ready"}, "program.state", "RUNNING"),
        ({"robot_running_state": False}, "program.state", None),
        ({"robot_running_state": False, "task_state": "ready"}, "program.state", "STOPPED"),
        ({"robot_running_state": False, "task_state": "drag"}, "program.state", "STOPPED"),
        ({"robot_running_state": False, "task_state": "program"}, "program.state", None),
        ({"task_state": "ready"}, "program.state", None),
        ({"task_state": "ready"}, "motion", "STANDSTILL"),
        ({"task_state": "jog"}, "motion", "JOGGING"),
        ({"task_state": "drag"}, "motion", "HAND_GUIDING"),
        ({"task_state": "rci"}, "motion", "EXTERNAL_CONTROL"),
        ({"task_state": "load_identify"}, "motion", "MOVING"),
        ({"task_state": "dynamic_identify"}, "motion", "MOVING"),
        ({"task_state": "program"}, "motion", None),
        ({"task_state": "demo"}, "motion", None),
        ({"task_state": "debug"}, "motion", None),
        ({"task_state": "sleeping"}, "motion", "UNKNOWN"),
        ({"current_prog": "weld"}, "program.name", "weld"),
        ({"current_prog": None}, "program.name", None),
    ],
)
def test_words_of_the_status(told: dict[str, object], path: str, expected: object) -> None:
    data, quality = external("status", told)
    assert at(data, path) == expected
    assert quality == "GOOD"


def test_a_fault_has_the_words_name_and_no_invented_text() -> None:
    faults = external("status", {"fault_state": True})[0]["faults"]
    assert isinstance(faults, list)
    assert [(one["code"], one["main"], one["text"], one["remedy"]) for one in faults] == [
        ("fault_state", None, None, None)
    ]


@pytest.mark.parametrize(("unit", "effort"), [(None, None), ("permille", None), ("Nm", [1.0, 2.0, 3.0, 4.0, 5.0, 6.0])])
def test_torque_is_effort_only_in_newton_metres(unit: str | None, effort: object) -> None:
    told = {"jnt_trq": [1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0]}
    assert external("joints", told, torque_unit=unit)[0]["effort"] == effort
    assert external("vendor", told, torque_unit=unit)[0]["jnt_trq"] == told["jnt_trq"]


@pytest.mark.parametrize(
    ("axes", "external_axes"), [(3, [4.0, 5.0, 6.0, 7.0]), (4, [5.0, 6.0, 7.0]), (6, [7.0]), (7, None)]
)
def test_values_beyond_the_axes_are_external(axes: int, external_axes: object) -> None:
    seven = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0]
    joints, _ = external("joints", {"jnt_pos": seven, "jnt_vel": seven}, axes=axes)
    assert joints["position"] == joints["velocity"] == seven[:axes]
    assert joints["external_position"] == external_axes


def test_a_pose_is_metres_and_a_quaternion_of_the_three_angles() -> None:
    told = {"cart_pos": [450.0, -120.5, 600.25, -90.0, 0.0, 0.0, 9.0, 9.0, 9.0, 9.0]}
    pose = external("tcp", told)[0]["pose"]
    half = 0.7071067811865476
    assert pose == {
        "position": pytest.approx([0.45, -0.1205, 0.60025]),
        "orientation": pytest.approx([-half, 0.0, 0.0, half]),
    }


def test_what_was_never_answered_is_null_everywhere() -> None:
    for group in ("joints", "tcp", "safety"):
        data, quality = external(group, {})
        assert {name: value for name, value in data.items() if value not in (None, [])} == {}
        assert quality == "GOOD"


@pytest.mark.parametrize(
    ("told", "power", "powered", "e_stopped", "state"),
    [
        ("on", "ENABLED", True, False, "NORMAL"),
        ("off", "OFF", False, False, None),
        ("estop", "OFF", False, True, "EMERGENCY_STOP"),
        ("gstop", "OFF", False, False, "SAFEGUARD_STOP"),
        ("unknown", None, None, None, None),  # the controller cannot tell
        ("asleep", "UNKNOWN", None, None, None),  # a word that we do not know
        (None, None, None, None, None),
    ],
)
def test_power_of_the_stream_is_a_word_and_never_a_truth(
    told: str | None, power: str | None, powered: object, e_stopped: object, state: str | None
) -> None:
    status = stream("status", powerState=told)
    assert (status["power"], status["drives_powered"], status["e_stopped"]) == (power, powered, e_stopped)
    assert stream("safety", powerState=told)["state"] == state


@pytest.mark.parametrize(
    ("power", "collided", "state"),
    [
        ("on", True, "PROTECTIVE_STOP"),
        ("on", False, "NORMAL"),
        ("estop", True, "EMERGENCY_STOP"),
        ("gstop", True, "SAFEGUARD_STOP"),
        ("off", True, "PROTECTIVE_STOP"),
        ("off", False, None),
        (None, True, "PROTECTIVE_STOP"),
        (None, False, None),
    ],
)
def test_the_worse_of_power_and_collision_is_the_safety_state(
    power: str | None,
    collided: bool,  # noqa: FBT001 - a value of the table
    state: str | None,
) -> None:
    data = stream("safety", powerState=power, collided=collided)
    assert (data["state"], data["collision"]) == (state, collided)


@pytest.mark.parametrize(
    ("told", "motion", "program"),
    [
        ("idle", "STANDSTILL", "STOPPED"),
        ("jog", "JOGGING", "STOPPED"),
        ("jogging", "JOGGING", "STOPPED"),
        ("rtControlling", "EXTERNAL_CONTROL", None),
        ("drag", "HAND_GUIDING", "STOPPED"),
        ("rlProgram", None, "RUNNING"),
        ("demo", "MOVING", None),
        ("dynamicIdentify", "MOVING", None),
        ("frictionIdentify", "MOVING", None),
        ("loadIdentify", "MOVING", None),
        ("moving", "MOVING", None),
        ("unknown", None, None),
        ("dancing", "UNKNOWN", None),
    ],
)
def test_what_the_robot_is_busy_with(told: str, motion: str | None, program: str | None) -> None:
    status = stream("status", operationState=told)
    assert (status["motion"], at(status, "program.state")) == (motion, program)


@pytest.mark.parametrize(
    ("told", "mode"),
    [("manual", "MANUAL"), ("automatic", "AUTOMATIC"), ("unknown", None), ("other", "UNKNOWN"), (None, None)],
)
def test_the_mode_is_not_that_of_another_vendor(told: str | None, mode: str | None) -> None:
    assert stream("status", operateMode=told)["operating_mode"] == mode


def test_members_that_were_not_read_are_null() -> None:
    status = stream("status", rlExecution=Execution(taskName="", executeLine=0))
    assert at(status, "program") == {"state": None, "name": None, "line": 0, "total_lines": None, "run_time": None}
    tcp = stream("tcp", posture=Posture(flangeInBase=[1.0, 2.0, 3.0, 0.0, 0.0, 0.0]))
    assert (tcp["pose"], tcp["elbow"]) == (None, None)
    assert tcp["flange_pose"] == {"position": [1.0, 2.0, 3.0], "orientation": [0.0, 0.0, 0.0, 1.0]}
    assert stream("joints", external=[])["external_position"] is None
    assert stream("io", di={})["digital_in"] is None
