"""The traps between FAIRINO's words and the canonical model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from math import pi

import pytest

from gateway.api.decoder import Frame
from gateway.api.model import (
    Analog,
    Controller,
    FunctionKind,
    Io,
    Joints,
    Motion,
    OperatingMode,
    Power,
    ProgramState,
    Quality,
    Safety,
    SafetyState,
    Severity,
    Status,
    Tcp,
    Wrench,
)
from gateway.api.normaliser import Normaliser
from gateway.api.vendor import Protocol
from vendors.fairino import VENDOR
from vendors.fairino.faults import FAULT_FIELDS
from vendors.fairino.layouts import LEGACY_LAYOUTS, LONGEST, STATUS_433
from vendors.fairino.signals import SIGNALS, STATUS_SIGNALS

BY_NAME = {layout.name: layout for layout in LEGACY_LAYOUTS}


@dataclass
class Read:
    """The groups of one frame."""

    joints: Joints
    tcp: Tcp
    wrench: Wrench
    io: Io
    analog: Analog
    status: Status
    safety: Safety
    controller: Controller


@cache
def normaliser(estop_polarity: str | None) -> Normaliser:
    """The rows, compiled once."""
    return Normaliser(SIGNALS, {"estop_polarity": estop_polarity})


def read_frame(values: Mapping[str, object], total: str = "2075", estop_polarity: str | None = None) -> Read:
    """Every group of a frame with some values; what is not named is 0."""
    layout = BY_NAME[total]
    payload = layout.encode(values)
    readers = normaliser(estop_polarity).readers(layout)
    found = {group: reader.read(Frame(payload, layout))[0] for group, reader in readers.items() if group != "vendor"}
    return Read(**found)  # type: ignore[arg-type] # the reader of a group returns its struct


def groups(**values: object) -> Read:
    """Every group of the longest frame."""
    return read_frame(values)


def test_robot_mode_0_is_automatic() -> None:
    assert groups(robot_mode=0).status.operating_mode is OperatingMode.AUTOMATIC
    assert groups(robot_mode=1).status.operating_mode is OperatingMode.MANUAL
    assert groups(robot_mode=2).status.operating_mode is OperatingMode.UNKNOWN


def test_angles_turn_about_fixed_axes_and_lengths_are_metres() -> None:
    pose = groups(tl_cur_pos=[1000.0, -500.0, 250.0, 90.0, 0.0, 90.0]).tcp.pose
    assert pose is not None
    assert pose.position == pytest.approx([1.0, -0.5, 0.25])
    # R = Rz(90)·Rx(90): the tool's z axis points along the base's x, its x axis along the base's y
    assert pose.orientation == pytest.approx([0.5, 0.5, 0.5, 0.5])


def test_joints_and_speeds_are_si() -> None:
    read = groups(
        jt_cur_pos=[180.0] * 6,
        actual_qd=[90.0] * 6,
        actual_qdd=[-180.0] * 6,
        jt_cur_tor=[1.5] * 6,
        jointDriverTemperature=[26.85] * 6,
        actual_TCP_Speed=[1000.0, 0.0, -500.0, 180.0, 0.0, -90.0],
        actual_TCP_CmpSpeed=[1250.0, 45.0],
    )
    assert read.joints.position == pytest.approx([pi] * 6)
    assert read.joints.velocity == pytest.approx([pi / 2] * 6)
    assert read.joints.acceleration == pytest.approx([-pi] * 6)
    assert read.joints.effort == pytest.approx([1.5] * 6)
    assert read.joints.temperature == pytest.approx([300.0] * 6)
    assert read.tcp.twist == pytest.approx([1.0, 0.0, -0.5, pi, 0.0, -pi / 2])
    assert read.tcp.speed == pytest.approx(1.25)
    assert read.tcp.substituted == []


def test_torques_of_port_8083_are_thousandths() -> None:
    payload = STATUS_433.encode({"jt_cur_tor": [1500.0, -250.0, 0.0, 0.0, 0.0, 1.0]})
    joints = Normaliser(STATUS_SIGNALS, {}).readers(STATUS_433)["joints"].read(Frame(payload, STATUS_433))[0]
    assert isinstance(joints, Joints)
    assert joints.effort == pytest.approx([1.5, -0.25, 0.0, 0.0, 0.0, 0.001])


@pytest.mark.parametrize(("name", "told"), [("cell.lua", "cell.lua"), ("x" * 20, None), ("", None)])
def test_a_name_that_fills_its_field_on_port_8083_may_be_cut_and_is_null(name: str, told: str | None) -> None:
    payload = STATUS_433.encode({"program_name": name})
    status = Normaliser(STATUS_SIGNALS, {}).readers(STATUS_433)["status"].read(Frame(payload, STATUS_433))[0]
    assert isinstance(status, Status)
    assert status.program is not None
    assert status.program.name == told


def test_port_8083_tells_neither_mode_nor_emergency_stop() -> None:
    readers = Normaliser(STATUS_SIGNALS, {}).readers(STATUS_433)
    assert set(readers) == {"joints", "tcp", "wrench", "status", "vendor"}
    status = readers["status"].read(Frame(b"\xff" * 431, STATUS_433))[0]
    assert isinstance(status, Status)
    assert status.operating_mode is None
    assert status.e_stopped is status.in_error is None


@pytest.mark.parametrize(
    ("state", "motion", "moves"),
    [
        (1, Motion.STANDSTILL, False),
        (2, Motion.MOVING, True),
        (3, Motion.HOLD, False),
        (4, Motion.HAND_GUIDING, None),
        (0, Motion.UNKNOWN, None),
        (5, Motion.UNKNOWN, None),
    ],
)
def test_robot_state_is_motion(state: int, motion: Motion, moves: bool | None) -> None:  # noqa: FBT001 - a value
    status = groups(robot_state=state).status
    assert (status.motion, status.in_motion) == (motion, moves)


@pytest.mark.parametrize(
    ("state", "told"),
    [
        (1, ProgramState.STOPPED),
        (2, ProgramState.RUNNING),
        (3, ProgramState.PAUSED),
        (4, None),
        (0, ProgramState.UNKNOWN),
    ],
)
def test_a_program_state_of_dragging_says_nothing_of_the_program(state: int, told: ProgramState | None) -> None:
    program = groups(program_state=state).status.program
    assert program is not None
    assert program.state is told


def test_the_number_of_lines_is_one_byte_and_not_told() -> None:
    program = groups(programTotalLine=200, luaLineNum=4711, currentLuaFileName="a.lua").status.program
    assert program is not None
    assert (program.total_lines, program.line, program.name) == (None, 4711, "a.lua")


def test_a_robot_that_is_not_enabled_may_have_power_or_not() -> None:
    assert groups(rbtEnableState=1).status.power is Power.ENABLED
    assert groups(rbtEnableState=1).status.drives_powered is True
    for state in (0, 2, -1):
        status = groups(rbtEnableState=state).status
        assert status.power is None
        assert status.drives_powered is None


def test_the_speed_is_that_of_the_selected_mode() -> None:
    speeds = {"speedScaleManual": 25.0, "speedScaleAuto": 80.0}
    assert groups(robot_mode=0, **speeds).status.speed_override == pytest.approx(0.8)
    assert groups(robot_mode=1, **speeds).status.speed_override == pytest.approx(0.25)
    assert groups(robot_mode=2, **speeds).status.speed_override is None
    assert groups(robot_mode=0, speedScaleAuto=101.0).status.speed_override is None


@pytest.mark.parametrize(
    ("main", "button_box", "polarity", "told"),
    [
        (0, 0, None, False),
        (1, 0, None, True),
        (0, 1, None, True),
        (2, 0, None, None),
        (0, 2, None, None),
        (0, 0, "active_high", False),
        (1, 1, "active_low", False),
        (0, 1, "active_low", True),
    ],
)
def test_the_documented_polarity_holds_until_another_is_configured(
    main: int,
    button_box: int,
    polarity: str | None,
    told: bool | None,  # noqa: FBT001 - a value
) -> None:
    read = read_frame({"EmergencyStop": main, "btnBoxStopSignal": button_box}, estop_polarity=polarity)
    assert read.status.e_stopped is told
    assert (read.safety.state is SafetyState.EMERGENCY_STOP) == (told is True)


def test_an_older_firmware_without_a_button_box_signal_tells_its_emergency_stop() -> None:
    read = read_frame({"EmergencyStop": 0}, "584")
    assert read.status.e_stopped is False
    assert read.safety.state is SafetyState.NORMAL
    assert read_frame({"EmergencyStop": 1}, "584").status.e_stopped is True


@pytest.mark.parametrize(
    ("values", "state"),
    [
        ({}, SafetyState.NORMAL),
        ({"collisionState": 1}, SafetyState.PROTECTIVE_STOP),
        ({"safety_stop0_state": 1}, SafetyState.SAFEGUARD_STOP),
        ({"safety_stop1_state": 1}, SafetyState.SAFEGUARD_STOP),
        ({"safetyDataState": 1}, SafetyState.FAULT),
        ({"safetyDataState": 1, "EmergencyStop": 1}, SafetyState.EMERGENCY_STOP),
        ({"collisionState": 2}, SafetyState.UNKNOWN),
        ({"safety_stop0_state": 7}, SafetyState.UNKNOWN),
        ({"EmergencyStop": 7}, SafetyState.UNKNOWN),
        ({"safetyDoorAlarm": 1}, SafetyState.NORMAL),
    ],
)
def test_the_safety_state_is_the_worst_that_is_documented(values: dict[str, object], state: SafetyState) -> None:
    assert groups(**values).safety.state is state


def test_functions_keep_the_raw_word_where_its_meaning_is_not_documented() -> None:
    functions = {one.name: one for one in groups(safetyDoorAlarm=1, safety_stop0_state=9).safety.functions or []}
    assert functions["safetyDoorAlarm"].active is True
    assert (functions["safety_stop0_state"].active, functions["safety_stop0_state"].raw) == (None, 9)
    assert functions["EmergencyStop"].kind is FunctionKind.ESTOP
    older = read_frame({}, "1236").safety.functions or []
    assert [one.name for one in older] == [
        "EmergencyStop",
        "safety_stop0_state",
        "safety_stop1_state",
        "collisionState",
    ]


def test_a_singular_posture_is_no_stop_by_a_singularity() -> None:
    read = groups(strangePosFlag=1)
    assert read.safety.singularity is None
    assert read.status.faults == []


def test_faults_keep_the_vendors_codes() -> None:
    status = groups(main_code=14, sub_code=-2).status
    assert status.in_error is True
    (fault,) = status.faults or []
    assert (fault.code, fault.main, fault.sub, fault.severity) == ("main_code", 14, -2, Severity.ERROR)


def test_axes_count_from_1_in_the_frame_and_from_0_in_the_model() -> None:
    status = groups(driverError=3, outSoftLimitError=6, driverComError=[0, 1, 0, 0, 0, 0]).status
    assert [(fault.code, fault.joint) for fault in status.faults or []] == [
        ("driverComError", 1),
        ("driverError", 2),
        ("outSoftLimitError", 5),
    ]
    (fault,) = groups(driverError=9).status.faults or []
    assert (fault.joint, fault.main) == (None, 9)


def test_a_warning_is_no_error() -> None:
    status = groups(motonAlarm=16, alarm=2, safetyDoorAlarm=1).status
    assert status.in_error is False
    assert {fault.severity for fault in status.faults or []} == {Severity.WARNING}


@pytest.mark.parametrize("source", FAULT_FIELDS)
def test_every_fault_field_reports_and_0_does_not(source: str) -> None:
    field = LONGEST.by_name[source]
    value: object = 1 if field.count is None else [0] * (field.elements - 1) + [1]
    (fault,) = groups(**{source: value}).status.faults or []
    assert fault.code.startswith(source) or source == "sub_code"
    assert groups().status.faults == []


def test_older_firmware_tells_the_faults_that_it_has() -> None:
    status = read_frame({"main_code": 1}, "584").status
    assert [fault.code for fault in status.faults or []] == ["main_code"]
    assert read_frame({}, "584").status.in_error is False


def test_six_exact_zeros_are_a_sensor_that_measures_nothing() -> None:
    wrench = groups(ft_sensor_active=0).wrench
    assert wrench.force is wrench.torque is wrench.raw_force is None
    assert wrench.active is False
    wrench = groups(ft_sensor_data=[0.0, 0.0, -1.0, 0.0, 0.0, 0.5], ft_sensor_active=2).wrench
    assert (wrench.force, wrench.torque, wrench.active) == ([0.0, 0.0, -1.0], [0.0, 0.0, 0.5], None)


def test_standard_channels_come_before_configurable_ones() -> None:
    box = (groups(cl_dgt_input_l={"DI0": 1}, cl_dgt_input_h={"CI1": 1}).io.digital_in or {})["box"]
    assert box == [True, *[False] * 8, True, *[False] * 6]
    tool = (groups(tl_dgt_output_l=0b111).io.digital_out or {})["tool"]
    assert tool == [True, True]  # bits 0 and 1 only


def test_extension_words_come_lowest_bit_first() -> None:
    bits = (groups(extDIState=[1, 0x8000, 0, 0, 0, 0, 0, 0]).io.digital_in or {})["ext1"]
    assert bits is not None
    assert [at for at, bit in enumerate(bits) if bit] == [0, 31]
    assert len(bits) == 128


def test_analog_counts_have_no_unit() -> None:
    analog_in = groups(cl_analog_input_0=4095, cl_analog_input_1=1).analog.analog_in or {}
    box = analog_in["box"]
    assert box is not None
    assert (box.raw, box.values, box.unit) == ([4095, 1], None, None)


def test_a_box_without_wide_voltage_leaves_its_fields_0_and_they_are_null() -> None:
    controller = groups().controller
    assert controller.cabinet_temperature is controller.fan_current is None
    controller = groups(wideVoltageCtrlBoxTemp=20.0, wideVoltageCtrlBoxFanVel=0).controller
    assert controller.cabinet_temperature == pytest.approx(293.15)
    assert controller.fan_current == 0


def test_without_an_active_gripper_its_fields_say_nothing() -> None:
    gripper = groups(gripper_position=0, gripper_motiondone=0).controller.gripper
    assert gripper is not None
    assert (gripper.active, gripper.position, gripper.moving) == (False, None, None)
    gripper = groups(gripper_active=2, gripper_position=60, gripper_motiondone=2).controller.gripper
    assert gripper is not None
    assert (gripper.active, gripper.moving) == (True, None)
    assert gripper.position == pytest.approx(0.6)


def test_what_the_frame_does_not_carry_is_null_never_0() -> None:
    read = read_frame({}, "584")
    assert read.joints.temperature is read.joints.target_position is read.joints.current is None
    assert read.tcp.target_pose is None
    assert read.status.speed_override is None
    assert read.status.power is None
    assert read.status.payload is not None
    assert read.status.payload.mass is None
    assert read.status.payload.cog is None
    assert read.safety.soft_limit is None
    assert (read.io.digital_in or {})["ext1"] is None
    assert (read.analog.analog_out or {})["box"] is None


def test_the_payload_is_in_metres() -> None:
    payload = groups(load=1.25, loadCog=[0.0, 5.0, -42.5]).status.payload
    assert payload is not None
    assert payload.mass == 1.25
    assert payload.cog == pytest.approx([0.0, 0.005, -0.0425])


@pytest.mark.parametrize("protocol", VENDOR.protocols, ids=lambda protocol: str(protocol.name))
def test_rows_compile_for_every_layout(protocol: Protocol) -> None:
    for layout in protocol.layouts:
        readers = Normaliser(protocol.signals, {"estop_polarity": None}).readers(layout)
        data, quality = readers["vendor"].read(Frame(bytes(layout.size), layout))
        assert quality is Quality.GOOD
        assert isinstance(data, dict)
        assert list(data) == [field.name for field in layout.fields]
