"""From the Rainbow state frame to the model: every trap that a careless reading falls into."""

from __future__ import annotations

import math
from functools import lru_cache
from pathlib import Path
from typing import TypeVar

import msgspec
import pytest

from gateway.api.decoder import Frame
from gateway.api.layout import Layout
from gateway.api.model import (
    Controller,
    Fault,
    FunctionKind,
    Joints,
    Motion,
    Power,
    ProgramState,
    Quality,
    Safety,
    SafetyFunction,
    SafetyState,
    Status,
    Tcp,
    Wrench,
)
from gateway.api.normaliser import Normaliser
from gateway.testing.vectors import load
from vendors import rainbow
from vendors.rainbow.layouts import LAYOUTS, STATE_464, STATE_488, STATE_580
from vendors.rainbow.signals import SIGNALS

T = TypeVar("T", bound=msgspec.Struct)
UPPER = -(2**31) + 0x5A5A_5000  # bits above every mask, the sign bit among them
GROUPS: dict[type[msgspec.Struct], str] = {
    Joints: "joints",
    Tcp: "tcp",
    Wrench: "wrench",
    Status: "status",
    Safety: "safety",
    Controller: "controller",
}


@lru_cache
def normaliser_of(polarity: str | None, external_joints: int) -> Normaliser:
    """Compiling the readers takes longer than all that is read with them."""
    return Normaliser(SIGNALS, {"estop_polarity": polarity, "external_joints": external_joints})


def read(
    kind: type[T],
    values: dict[str, object],
    *,
    polarity: str | None = None,
    external_joints: int = 0,
    layout: Layout = STATE_580,
) -> T:
    """Read one group of a frame that holds some values and is 0 elsewhere."""
    found, _ = (
        normaliser_of(polarity, external_joints)
        .readers(layout)[GROUPS[kind]]
        .read(Frame(layout.encode(values), layout))
    )
    assert isinstance(found, kind)
    return found


def functions(values: dict[str, object], polarity: str | None = None) -> dict[str, SafetyFunction]:
    found = read(Safety, values, polarity=polarity).functions
    assert found is not None
    return {function.name: function for function in found}


def chunk(number: int, **flags: int) -> dict[str, object]:
    return {f"information_chunk_{number}": flags}


RELEASED = chunk(1, estop_1=1, estop_2=1)


def test_the_tool_pose_is_a_copy_of_the_reference_and_marked_as_substituted() -> None:
    normaliser = Normaliser(SIGNALS, {"estop_polarity": None, "external_joints": 0})
    _, quality = normaliser.readers(STATE_580)["tcp"].read(Frame(bytes(580), STATE_580))
    assert quality is Quality.SUBSTITUTED
    assert read(Tcp, {}).substituted == ["pose"]


def test_the_soft_estop_word_means_paused_and_is_no_emergency_stop() -> None:
    status = read(
        Status, {"op_stat_soft_estop_occur": 1, "task_state": 3, "robot_state": 3} | RELEASED, polarity="active_low"
    )
    assert status.program is not None
    assert status.program.state is ProgramState.PAUSED
    assert (status.motion, status.in_motion, status.e_stopped) == (Motion.HOLD, False, False)
    assert read(Safety, {"op_stat_soft_estop_occur": 1} | RELEASED, polarity="active_low").state is SafetyState.NORMAL


@pytest.mark.parametrize("code", [1, 2, 3, 4, 63])
def test_the_ems_word_is_a_kinematic_stop_and_no_emergency_stop_but_not_normal_either(code: int) -> None:
    values = {"op_stat_ems_flag": code} | RELEASED
    safety, status = read(Safety, values, polarity="active_low"), read(Status, values, polarity="active_low")
    assert (safety.state, safety.soft_limit, status.e_stopped) == (None, code in {2, 3}, False)
    assert status.in_error is True


def test_upper_bits_of_masked_words_are_other_data() -> None:
    words = (
        "is_freedrive_mode",
        "real_vs_simulation_mode",
        "init_error",
        "op_stat_collision_occur",
        "op_stat_sos_flag",
        "op_stat_ems_flag",
    )
    values: dict[str, object] = {**dict.fromkeys(words, UPPER), "robot_state": 1, "init_state_info": UPPER + 6}
    status, safety = read(Status, values | chunk(1, arm_power=1)), read(Safety, values)
    assert (status.motion, status.simulation, status.power) == (Motion.STANDSTILL, False, Power.ENABLED)
    assert (status.faults, status.in_error) == ([], False)
    assert (safety.collision, safety.soft_limit) == (False, False)


def test_a_self_collision_is_seen_behind_the_time_zone() -> None:
    zone = {"time_zone_raw": 0xABCDEF0, "last_out_collision_cause": 3}
    assert read(Safety, {"op_stat_self_collision": zone}).self_collision is False
    assert read(Safety, {"op_stat_self_collision": zone | {"self_collision": 1}}).self_collision is True


@pytest.mark.parametrize("value", [1, 2, 3])
def test_any_masked_value_but_zero_is_a_collision(value: int) -> None:
    assert read(Safety, {"op_stat_collision_occur": value}).collision is True
    assert read(Safety, {"op_stat_self_collision": value}).self_collision is True


def test_the_time_zone_never_makes_a_state_topic_change() -> None:
    key = Normaliser(SIGNALS, {"estop_polarity": None, "external_joints": 0}).readers(STATE_580)["safety"].key
    before = key(Frame(STATE_580.encode({}), STATE_580))
    assert key(Frame(STATE_580.encode({"op_stat_self_collision": {"time_zone_raw": 0xFFFFFFF}}), STATE_580)) == before
    assert key(Frame(STATE_580.encode(chunk(3, tcp_speed_x10=999)), STATE_580)) == before
    assert key(Frame(STATE_580.encode({"op_stat_self_collision": 1}), STATE_580)) != before


def test_run_time_and_temperatures_never_make_status_change() -> None:
    key = Normaliser(SIGNALS, {"estop_polarity": None, "external_joints": 0}).readers(STATE_580)["status"].key
    before = key(Frame(STATE_580.encode({}), STATE_580))
    assert key(Frame(STATE_580.encode({"task_run_time": 99} | chunk(1, cpu_temp_half=30)), STATE_580)) == before


def test_what_the_frame_does_not_have_is_null() -> None:
    joints, status = read(Joints, {}), read(Status, {})
    assert (joints.velocity, joints.acceleration, joints.effort, joints.target_effort) == (None, None, None, None)
    assert (status.operating_mode, status.motion_possible, status.payload, status.workobject_id) == (
        None,
        None,
        None,
        None,
    )
    assert (read(Tcp, {}).flange_pose, read(Tcp, {}).twist, read(Tcp, {}).speed) == (None, None, None)


def test_without_a_polarity_nothing_is_said_of_an_emergency_stop() -> None:
    for values in ({}, RELEASED):
        assert read(Status, values).e_stopped is None
        assert read(Safety, values).state is None
        assert functions(values)["estop_1"].active is None
    assert functions(chunk(1, estop_1=1))["estop_1"].raw == 1
    assert functions(chunk(1, estop_1=1))["estop_2"].raw == 0


@pytest.mark.parametrize(
    ("polarity", "first", "second", "pressed"),
    [
        ("active_low", 1, 1, False),
        ("active_low", 0, 1, True),
        ("active_low", 1, 0, True),
        ("active_low", 0, 0, True),
        ("active_high", 0, 0, False),
        ("active_high", 1, 0, True),
        ("active_high", 0, 1, True),
    ],
)
def test_either_channel_presses_the_emergency_stop(polarity: str, first: int, second: int, *, pressed: bool) -> None:
    values = chunk(1, estop_1=first, estop_2=second)
    state = SafetyState.EMERGENCY_STOP if pressed else SafetyState.NORMAL
    assert read(Status, values, polarity=polarity).e_stopped is pressed
    assert read(Safety, values, polarity=polarity).state is state
    assert functions(values, polarity)["estop_1"].active is (first == (polarity == "active_high"))


@pytest.mark.parametrize("polarity", [None, "active_low", "active_high"])
def test_ems2_is_documented_as_pressed_whatever_the_polarity_of_the_others(polarity: str | None) -> None:
    level = int(polarity != "active_high")
    values = chunk(1, estop_1=level, estop_2=level) | chunk(3, safety_ems2_pressed=1)
    assert read(Status, values, polarity=polarity).e_stopped is True
    assert read(Safety, values, polarity=polarity).state is SafetyState.EMERGENCY_STOP


def test_ems2_at_zero_says_nothing_of_an_emergency_stop() -> None:
    assert read(Status, RELEASED | chunk(3, safety_ems2_pressed=0)).e_stopped is None
    assert read(Status, chunk(3, safety_ems2_pressed=0), polarity="active_low").e_stopped is True


@pytest.mark.parametrize("name", ["safety_prs_pressed", "safety_hss_pressed", "safety_sss_pressed"])
def test_a_pressed_safety_input_of_unknown_meaning_is_not_normal(name: str) -> None:
    values = RELEASED | chunk(3, **{name: 1})
    assert read(Safety, values, polarity="active_low").state is None
    assert read(Status, values, polarity="active_low").e_stopped is False


@pytest.mark.parametrize("level", [0, 1, 2, 3])
def test_the_configurable_inputs_without_a_polarity_decide_nothing(level: int) -> None:
    values = RELEASED | chunk(2, config_di_16=level) | chunk(3, config_di_17=level)
    assert read(Safety, values, polarity="active_low").state is SafetyState.NORMAL
    assert read(Status, values, polarity="active_low").e_stopped is False


@pytest.mark.parametrize("layout", LAYOUTS, ids=lambda layout: layout.name)
def test_older_frames_without_the_safety_inputs_still_tell_the_emergency_stop(layout: Layout) -> None:
    def told(values: dict[str, object], polarity: str | None = "active_low") -> tuple[object, object]:
        return (
            read(Status, values, polarity=polarity, layout=layout).e_stopped,
            read(Safety, values, polarity=polarity, layout=layout).state,
        )

    assert told(RELEASED) == (False, SafetyState.NORMAL)
    assert told({}) == (True, SafetyState.EMERGENCY_STOP)
    assert told(RELEASED | {"op_stat_sos_flag": 1}) == (False, SafetyState.FAULT)
    assert told(RELEASED | {"op_stat_collision_occur": 1}) == (False, SafetyState.PROTECTIVE_STOP)
    assert told(RELEASED | {"op_stat_ems_flag": 1}) == (False, None)
    assert told(RELEASED, None) == (None, None)


def test_an_emergency_stop_outranks_faults_and_collisions() -> None:
    hurt: dict[str, object] = {"op_stat_sos_flag": 5, "op_stat_collision_occur": 1}
    assert read(Safety, hurt, polarity="active_low").state is SafetyState.EMERGENCY_STOP
    assert read(Safety, hurt | RELEASED, polarity="active_low").state is SafetyState.FAULT
    assert read(Safety, hurt).state is SafetyState.FAULT
    assert read(Safety, {"op_stat_collision_occur": 1}).state is SafetyState.PROTECTIVE_STOP


def test_the_healthy_level_of_the_safety_inputs_is_no_alarm() -> None:
    found = functions(chunk(2, config_di_16=1) | chunk(3, config_di_17=1))
    assert (found["config_di_16"].raw, found["config_di_16"].active) == (1, None)
    assert (found["config_di_17"].raw, found["config_di_17"].active) == (1, None)


def test_a_bit_that_only_the_newer_manual_names_is_not_believed_when_it_is_zero() -> None:
    assert functions({})["safety_ems2_pressed"].active is None
    assert functions(chunk(3, safety_ems2_pressed=1))["safety_ems2_pressed"].active is True
    assert functions({})["safety_ems2_pressed"].kind is FunctionKind.ESTOP
    assert read(Controller, {}).fieldbuses == {"profinet": None, "ethernet_ip": None}
    assert read(Controller, chunk(1, profinet_active=1)).fieldbuses == {"profinet": True, "ethernet_ip": None}


def test_safety_inputs_that_an_old_frame_lacks_are_null_and_not_zero() -> None:
    found = read(Safety, {}, layout=STATE_464).functions
    assert found is not None
    assert [function.raw for function in found] == [0, 0, None, None, None, None, None, None]


def test_cabinet_temperatures_are_stored_halved_and_unknown_when_zero() -> None:
    controller = read(Controller, chunk(1, cpu_temp_half=25))
    assert controller.cpu_temperature == pytest.approx(50 + 273.15)
    assert controller.board_temperature is None


@pytest.mark.parametrize("key", ["cpu_temperature", "board_temperature"])
def test_each_cabinet_temperature_is_uncertain_by_itself(key: str) -> None:
    rows = [row for row in SIGNALS if row.key == f"controller.{key}"]
    _, quality = Normaliser(rows, {}).readers(STATE_580)["controller"].read(Frame(bytes(580), STATE_580))
    assert quality is Quality.UNCERTAIN


def test_every_vector_states_the_quality_of_every_group() -> None:
    groups = set(Normaliser(SIGNALS, {"estop_polarity": None, "external_joints": 0}).groups) - {"vendor"}
    vectors = [vector for vector in load(Path(rainbow.__file__).with_name("vectors.toml")) if vector.layout]
    assert vectors
    for vector in vectors:
        assert {group for group, expected in vector.canonical.items() if "q" in expected} == groups, vector.name
        assert vector.canonical["controller"]["q"] == "UNCERTAIN", vector.name


def test_six_zeros_of_force_are_a_robot_without_a_sensor() -> None:
    assert read(Wrench, {}) == Wrench()
    wrench = read(Wrench, {"eft_mz": -0.5})
    assert (wrench.force, wrench.torque) == ([0.0, 0.0, 0.0], [0.0, 0.0, -0.5])
    assert read(Wrench, {"eft_fx": 1.0}, layout=STATE_488) == Wrench()


def test_external_joints_are_told_as_many_as_are_configured() -> None:
    values: dict[str, object] = {"aa_joint_ref": [180.0, -90.0, 45.0, 0.0, 0.0, 0.0]}
    assert read(Joints, values).external_target_position is None
    found = read(Joints, values, external_joints=2).external_target_position
    assert found == pytest.approx([math.pi, -math.pi / 2])


@pytest.mark.parametrize(
    ("robot_state", "freedrive", "pause", "motion", "in_motion"),
    [
        (1, 0, 0, Motion.STANDSTILL, False),
        (3, 0, 0, Motion.MOVING, True),
        (3, 0, 1, Motion.HOLD, False),
        (5, 0, 0, Motion.MOVING, None),
        (60, 0, 0, Motion.MOVING, True),
        (563, 0, 0, Motion.MOVING, True),
        (3, 2, 0, Motion.HAND_GUIDING, None),
        (2, 0, 0, Motion.UNKNOWN, None),
        (-1, 0, 0, Motion.UNKNOWN, None),
    ],
)
def test_the_motion_follows_from_state_freedrive_and_pause(
    robot_state: int, freedrive: int, pause: int, motion: Motion, *, in_motion: bool | None
) -> None:
    values = {"robot_state": robot_state, "is_freedrive_mode": freedrive, "op_stat_soft_estop_occur": pause}
    status = read(Status, dict(values))
    assert (status.motion, status.in_motion) == (motion, in_motion)


@pytest.mark.parametrize(
    ("task_state", "state"),
    [(1, ProgramState.STOPPED), (2, ProgramState.PAUSED), (3, ProgramState.RUNNING), (0, ProgramState.UNKNOWN)],
)
def test_the_program_is_paused_at_two_and_runs_at_three(task_state: int, state: ProgramState) -> None:
    program = read(Status, {"task_state": task_state}).program
    assert program is not None
    assert (program.state, program.name, program.line) == (state, None, None)


def test_the_run_time_of_an_old_frame_is_not_read() -> None:
    program = read(Status, {}, layout=STATE_488).program
    assert program is not None
    assert program.run_time is None


@pytest.mark.parametrize(
    ("stage", "arm_power", "power"),
    [(6, 1, Power.ENABLED), (0, 1, Power.POWERED), (3, 1, Power.BOOTING), (7, 1, Power.UNKNOWN), (6, 0, Power.OFF)],
)
def test_the_power_follows_from_stage_and_arm_power(stage: int, arm_power: int, power: Power) -> None:
    assert read(Status, {"init_state_info": stage} | chunk(1, arm_power=arm_power)).power is power


@pytest.mark.parametrize(("value", "simulation"), [(0, False), (1, True), (2, None)])
def test_simulation_is_only_what_the_manual_documents(value: int, *, simulation: bool | None) -> None:
    assert read(Status, {"real_vs_simulation_mode": value}).simulation is simulation


def test_faults_carry_the_field_its_number_the_manuals_words_and_the_joint() -> None:
    joints = [{}, {}, {"err_jam": 1}, {}, {}, {"err_tmp": 1, "enc_calibrating": 1}]
    status = read(Status, {"op_stat_sos_flag": 11, "init_error": 0xABC, "jnt_info": joints})
    assert status.in_error is True
    assert status.faults is not None
    assert [(fault.code, fault.main, fault.text, fault.joint) for fault in status.faults] == [
        ("op_stat_sos_flag", 11, "Temperature err", None),
        ("init_error", 0xABC, None, None),
        ("err_jam", None, "Error state (JAM err)", 2),
        ("err_tmp", None, "Error state (TMP err)", 5),
    ]


# The lists of both manuals as they are printed, v4.3.1 (English) under op_stat_sos_flag and op_stat_ems_flag.
SOS_CODES = """
1=Encoder err (PVL) / 2=CPU err / 3=Big err / 4=Input err / 5=JAM err / 6 = Over current err / 7 = Position bound err /
8 = Mode err / 9 = Match err / 10 = Over current/Low voltage err / 11 = Temperature err / 12 = Speed over err
"""
EMS_CODES = "1 = Arm Stretch / 2= Cartesian Limit / 3=Joint Limit / 4=Un-solvable"


def printed(field: str, text: str) -> list[tuple[str, int, str]]:
    """Field, number and words of each entry of a list that the manual prints."""
    entries = (entry.split("=") for entry in text.split(" /"))
    return [(field, int(number), words.strip()) for number, words in entries]


@pytest.mark.parametrize(
    ("field", "code", "text"), printed("op_stat_sos_flag", SOS_CODES) + printed("op_stat_ems_flag", EMS_CODES)
)
def test_every_code_has_the_words_that_the_manual_prints(field: str, code: int, text: str) -> None:
    assert read(Status, {field: code}).faults == [Fault(field, main=code, text=text)]


def test_the_manual_prints_twelve_device_errors_and_four_kinematic_stops() -> None:
    assert [code for _, code, _ in printed("", SOS_CODES)] == list(range(1, 13))
    assert [code for _, code, _ in printed("", EMS_CODES)] == [1, 2, 3, 4]


@pytest.mark.parametrize(
    ("bit", "code", "text"),
    [
        (4, "enc_nonius_err", "encoder state (Nonius err)"),
        (5, "enc_low_battery", "encoder state (LowBatt err)"),
        (7, "enc_multiturn_err", "encoder state (Multi-turn err)"),
        (8, "err_jam", "Error state (JAM err)"),
        (9, "err_cur", "Error state (CUR err)"),
        (10, "err_big", "Error state (BIG err)"),
        (11, "err_inp", "Error state (INP err)"),
        (12, "err_flt", "Error state (FLT err)"),
        (13, "err_tmp", "Error state (TMP err)"),
        (14, "err_ps1", "Error state (PS1 err)"),
        (15, "err_ps2", "Error state (PS2 err)"),
    ],
)
def test_every_error_bit_of_a_joint_has_the_words_that_the_manual_prints(bit: int, code: str, text: str) -> None:
    for joint in range(6):
        status = read(Status, {"jnt_info": [1 << bit if at == joint else 0xFFFF_004F for at in range(6)]})
        assert (status.faults, status.in_error) == ([Fault(code, text=text, joint=joint)], True)


def test_no_fault_has_a_severity_because_the_manual_gives_none() -> None:
    words: dict[str, object] = {"op_stat_sos_flag": 1, "op_stat_ems_flag": 1, "init_error": 1, "jnt_info": [0xFFFF] * 6}
    for values in (words, chunk(1, sos_active=1)):
        found = read(Status, values).faults
        assert found
        assert {fault.severity for fault in found} == {None}


@pytest.mark.parametrize("field", ["op_stat_sos_flag", "op_stat_ems_flag"])
def test_an_unknown_code_is_told_without_invented_words(field: str) -> None:
    assert read(Status, {field: 13}).faults == [Fault(field, main=13)]


def test_a_device_error_state_without_a_code_is_a_fault_without_words() -> None:
    values = chunk(1, estop_1=1, estop_2=1, sos_active=1)
    status = read(Status, values, polarity="active_low")
    assert (status.in_error, status.faults) == (True, [Fault("sos_active")])
    assert read(Safety, values, polarity="active_low").state is SafetyState.FAULT
    assert read(Safety, values).state is SafetyState.FAULT


def test_a_device_error_with_its_code_is_one_fault_and_not_two() -> None:
    status = read(Status, {"op_stat_sos_flag": 5} | chunk(1, sos_active=1))
    assert status.faults == [Fault("op_stat_sos_flag", main=5, text="JAM err")]


def test_reserved_bits_of_the_joints_are_no_fault() -> None:
    status = read(Status, {"jnt_info": [{"fet": 1, "reserved_16_31": 0xFFFF}] * 6})
    assert (status.faults, status.in_error, status.drives_powered) == ([], False, True)


def test_the_clock_word_goes_nowhere_but_into_the_vendor_group() -> None:
    assert "time" not in {source for row in SIGNALS for source in row.sources}
    assert not any(source.startswith("reserved") for row in SIGNALS for source in row.sources)
