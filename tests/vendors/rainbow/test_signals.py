"""From the Rainbow state frame to the model: every trap that a careless reading falls into."""

from __future__ import annotations

import math
from typing import TypeVar

import msgspec
import pytest

from gateway.api.layout import Layout
from gateway.api.model import (
    Controller,
    FunctionKind,
    Joints,
    Motion,
    Power,
    ProgramState,
    Quality,
    Safety,
    SafetyFunction,
    SafetyState,
    Severity,
    Status,
    Tcp,
    Wrench,
)
from gateway.api.normaliser import Normaliser
from vendors.rainbow.layouts import STATE_464, STATE_488, STATE_580
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


def read(
    kind: type[T],
    values: dict[str, object],
    *,
    polarity: str | None = None,
    external_joints: int = 0,
    layout: Layout = STATE_580,
) -> T:
    """Read one group of a frame that holds some values and is 0 elsewhere."""
    normaliser = Normaliser(SIGNALS, {"estop_polarity": polarity, "external_joints": external_joints})
    found, _ = normaliser.readers(layout)[GROUPS[kind]].read(layout.encode(values), 0)
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
    assert normaliser.readers(STATE_580)["tcp"].quality is Quality.SUBSTITUTED
    assert read(Tcp, {}).substituted == ["pose"]


def test_the_soft_estop_word_means_paused_and_is_no_emergency_stop() -> None:
    status = read(
        Status, {"op_stat_soft_estop_occur": 1, "task_state": 3, "robot_state": 3} | RELEASED, polarity="active_low"
    )
    assert status.program is not None
    assert status.program.state is ProgramState.PAUSED
    assert (status.motion, status.in_motion, status.e_stopped) == (Motion.HOLD, False, False)
    assert read(Safety, {"op_stat_soft_estop_occur": 1} | RELEASED, polarity="active_low").state is SafetyState.NORMAL


@pytest.mark.parametrize(
    ("code", "text"), [(1, "arm stretch"), (2, "Cartesian limit"), (3, "joint limit"), (4, "unsolvable")]
)
def test_the_ems_word_is_a_kinematic_stop_and_no_emergency_stop(code: int, text: str) -> None:
    values = {"op_stat_ems_flag": code} | RELEASED
    safety, status = read(Safety, values, polarity="active_low"), read(Status, values, polarity="active_low")
    assert (safety.state, safety.soft_limit, status.e_stopped) == (SafetyState.NORMAL, code in {2, 3}, False)
    assert status.faults is not None
    assert [(fault.code, fault.main, fault.text) for fault in status.faults] == [("kinematic_stop", code, text)]


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
    before = key(STATE_580.encode({}), 0)
    assert key(STATE_580.encode({"op_stat_self_collision": {"time_zone_raw": 0xFFFFFFF}}), 0) == before
    assert key(STATE_580.encode(chunk(3, tcp_speed_x10=999)), 0) == before
    assert key(STATE_580.encode({"op_stat_self_collision": 1}), 0) != before


def test_run_time_and_temperatures_never_make_status_change() -> None:
    key = Normaliser(SIGNALS, {"estop_polarity": None, "external_joints": 0}).readers(STATE_580)["status"].key
    before = key(STATE_580.encode({}), 0)
    assert key(STATE_580.encode({"task_run_time": 99} | chunk(1, cpu_temp_half=30)), 0) == before


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


def test_faults_carry_the_vendors_code_text_and_joint() -> None:
    joints = [{}, {}, {"err_jam": 1}, {}, {}, {"err_tmp": 1, "enc_calibrating": 1}]
    status = read(Status, {"op_stat_sos_flag": 11, "init_error": 0xABC, "jnt_info": joints})
    assert status.in_error is True
    assert status.faults is not None
    assert [(fault.code, fault.main, fault.text, fault.joint) for fault in status.faults] == [
        ("sos", 11, "temperature", None),
        ("init_error", 0xABC, None, None),
        ("err_jam", None, "JAM error", 2),
        ("err_tmp", None, "TMP error (temperature)", 5),
    ]
    assert {fault.severity for fault in status.faults} == {Severity.ERROR}


def test_an_unknown_device_error_is_told_without_invented_words() -> None:
    status = read(Status, {"op_stat_sos_flag": 13})
    assert status.faults is not None
    assert [(fault.main, fault.text) for fault in status.faults] == [(13, None)]


def test_reserved_bits_of_the_joints_are_no_fault() -> None:
    status = read(Status, {"jnt_info": [{"fet": 1, "reserved_16_31": 0xFFFF}] * 6})
    assert (status.faults, status.in_error, status.drives_powered) == ([], False, True)


def test_the_clock_word_goes_nowhere_but_into_the_vendor_group() -> None:
    assert "time" not in {source for row in SIGNALS for source in row.sources}
    assert not any(source.startswith("reserved") for row in SIGNALS for source in row.sources)
