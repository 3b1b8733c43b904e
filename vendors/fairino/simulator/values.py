"""What the virtual FAIRINO controller says of its robot: the scenario in the vendor's fields, units and codes.

One set of values for every protocol, by the names of the legacy table: a writer takes what its layout has.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from datetime import UTC, datetime, timedelta
from math import pi

from gateway.api.layout import Layout
from gateway.api.model import Power, ProgramState
from gateway.api.units import ZERO_CELSIUS_K
from gateway.sim.packing import Packer, Word
from gateway.sim.scenario import FaultKind, Phase, RobotState

Values = Mapping[str, object]

PROGRAM = "cell.lua"
MAGIC_WORD = 0x5A5A
_DEG = 180 / pi
_BEGIN = datetime(2026, 1, 1, tzinfo=UTC)  # the controller's clock when its scenario begins
_PROGRAM_STATES = {ProgramState.STOPPED: 1, ProgramState.RUNNING: 2, ProgramState.PAUSED: 3}
_STOPPED, _RUNNING, _PAUSED, _DRAGGING = 1, 2, 3, 4  # robot_state
_AUTOMATIC, _MANUAL = 0, 1  # robot_mode
# Made up: the vendor's list of codes is not public.
_MAIN_CODES = {
    FaultKind.ENCODER: 2,
    FaultKind.FOLLOWING_ERROR: 3,
    FaultKind.OVER_CURRENT: 4,
    FaultKind.OVER_TEMPERATURE: 5,
}
_TORQUE_PER_AMPERE = (11.5, 11.5, 9.0, 4.5, 4.5, 3.0)  # Nm/A at the joint, plausible for a small arm
_LINES = 9

# What stays the same as long as the controller runs.
SETTLED: Values = {
    "frame_head": MAGIC_WORD,
    "tool": 1,
    "cl_dgt_input_h": {"CI0": 1, "CI7": 1},
    "cl_analog_input_0": 2048,
    "cl_analog_input_1": 512,
    "tl_anglog_input": 777,
    "ft_sensor_raw_data": [1.5, -0.9, -11.25, 0.06, -0.03, 0.015],
    "ft_sensor_active": 1,
    "gripper_motiondone": 1,
    "gripper_active": 1,
    "gripper_speed": 50,
    "gripper_current": 40,
    "gripper_temp": 31,
    "gripper_voltage": 24,
    "auxState_servoId": 1,
    "auxState_servoState": 1,
    "auxState_servoPos": 12.5,
    **{f"extAxisStatus_{axis}_ready": 1 for axis in range(2)},
    **{f"extAxisStatus_{axis}_inPos": 1 for axis in range(2)},
    "extDIState": [0x8001, 0, 0, 0, 0, 0, 0, 1],
    "extDOState": [2, 0, 0, 0, 0, 0, 0, 0],
    "extAIState": [100, 200, 300, 400],
    "extAOState": [1000, 0, 0, 0],
    "cl_analog_output_0": 1024,
    "tl_analog_output": 99,
    "toolCoord": [0.0, 0.0, 120.0, 0.0, 0.0, 0.0],
    "load": 1.25,
    "loadCog": [0.0, 5.0, 42.5],
    "wideVoltageCtrlBoxFanVel": 210,
    "collisionLevel": [5, 5, 5, 6, 6, 6],
    "speedScaleManual": 30.0,
    "programTotalLine": _LINES,
    "safetyBoxSingal": [1, 1, 1, 1, 1, 1],
    "modbusMasterConnect": {"master_0": 1},
    "modbusSlaveConnect": 1,
    "weldReadyState": 1,
    "axleGenComData": "0003a1b2c3",
    "programRunState": 1,
    "timestamp_us": 0,
}


def phase_values(phase: Phase) -> dict[str, object]:
    """What only a phase changes."""
    working = phase.program is not ProgramState.STOPPED
    running = int(phase.program is ProgramState.RUNNING)
    fault = phase.fault
    return {
        "program_state": _PROGRAM_STATES[phase.program],
        "robot_mode": _AUTOMATIC if working else _MANUAL,
        "main_code": _MAIN_CODES[fault.kind] if fault else 0,
        "sub_code": fault.joint + 1 if fault else 0,
        "cl_dgt_output_l": {"DO1": running, "DO2": int(fault is not None)},
        "cl_dgt_input_l": {"DI1": 1, "DI3": running},
        "EmergencyStop": int(phase.estop),
        "collisionState": int(phase.collision),
        "rbtEnableState": int(phase.power is Power.ENABLED),
        "mc_queue_len": 2 * running,
        "speedScaleAuto": 100 * phase.speed_override,
        "currentLuaFileName": PROGRAM if working else "",
        "program_name": PROGRAM if working else "",
        "driverError": fault.joint + 1 if fault else 0,
        "motonAlarm": 3 if phase.collision else 0,
    }


def moving_values(state: RobotState) -> dict[str, object]:
    """What every frame may change."""
    position = [angle * _DEG for angle in state.position]
    target = [angle * _DEG for angle in state.target_position]
    velocity = [rate * _DEG for rate in state.velocity]
    torque = [amperes * factor for amperes, factor in zip(state.current, _TORQUE_PER_AMPERE, strict=True)]
    pose = [*(1000 * metres for metres in state.tcp.position), *(angle * _DEG for angle in state.tcp.rpy)]
    speed = 1000 * state.tcp.speed
    twist = [speed, 0.0, 0.0, 0.0, 0.0, 0.0]
    closed = int(state.gripper_closed)
    return {
        "robot_state": _robot_state(state),
        "jt_cur_pos": position,
        "tl_cur_pos": pose,
        "flange_cur_pos": [*pose[:2], pose[2] + 120.0, *pose[3:]],
        "actual_qd": velocity,
        "target_TCP_CmpSpeed": [speed, 0.0],
        "target_TCP_Speed": twist,
        "actual_TCP_CmpSpeed": [speed, 0.0],
        "actual_TCP_Speed": twist,
        "jt_cur_tor": torque,
        "tl_dgt_output_l": closed,
        "tl_dgt_input_l": closed,
        "ft_sensor_data": [1.2, -0.8, -9.3 - 14.7 * closed, 0.05, -0.02, 0.01],
        "motion_done": int(not state.moving),
        "trajectory_pnum": state.cycles,
        "gripper_position": 100 * closed,
        "jointDriverTorque": torque,
        "jointDriverTemperature": [kelvin - ZERO_CELSIUS_K for kelvin in state.temperature],
        "jt_tgt_tor": torque,
        "wideVoltageCtrlBoxTemp": 38.5 + 0.5 * closed,
        "targetJointPos": target,
        "targetJointVel": velocity,
        "actualJointCurrent": list(state.current),
        "targetJointCurrent": list(state.current),
        "targetTCPPos": pose,
        "luaLineNum": 1 + int(state.program_s) % _LINES if state.program_s else 0,
        "run_up_time": state.time_s,
        "timestamp_us": int(state.time_s * 1e6),
        **_clock(state.time_s),
    }


def frame_values(state: RobotState) -> dict[str, object]:
    """All values of one moment, by the names of the tables; what is not named is 0."""
    return {**SETTLED, **phase_values(state.phase), **moving_values(state)}


def as_status(values: Values) -> dict[str, object]:
    """The same values as port 8083 gives them: joint torques in thousandths of a Nm."""
    found = dict(values)
    torque = found.get("jt_cur_tor")
    if isinstance(torque, list):
        found["jt_cur_tor"] = [1000 * value for value in torque]
    return found


class Writer:
    """Writes the words of one layout: what only a phase changes once a phase, the rest once a frame.

    Args:
        layout: Fields of any protocol, under the names of the tables; others stay 0.
        adapt: Changes values where a protocol gives them otherwise.
    """

    def __init__(self, layout: Layout, adapt: Callable[[Values], Values] = lambda values: values) -> None:
        self.packer = Packer(layout)
        self._adapt = adapt
        self._template: list[Word] = []
        self._phase: Phase | None = None

    def words(self, state: RobotState) -> list[Word]:
        """All words of a moment, in wire order."""
        slots = self.packer.slots
        if state.phase is not self._phase:
            known = self.packer.layout.by_name
            values = self._adapt({**SETTLED, **phase_values(state.phase)})
            self._template = self.packer.words({name: value for name, value in values.items() if name in known})
            self._phase = state.phase
        words = self._template.copy()
        for name, value in self._adapt(moving_values(state)).items():
            slot = slots.get(name)
            if slot is None:
                continue
            words[slot] = value[: slot.stop - slot.start] if isinstance(value, list) else [value]  # type: ignore[list-item] # words
        return words


def _robot_state(state: RobotState) -> int:
    phase = state.phase
    if phase.freedrive:
        return _DRAGGING
    if phase.program is ProgramState.PAUSED:
        return _PAUSED
    return _RUNNING if state.moving else _STOPPED


def _clock(time_s: float) -> dict[str, object]:
    now = _BEGIN + timedelta(seconds=time_s)
    parts = {
        "year": now.year,
        "mouth": now.month,
        "day": now.day,
        "hour": now.hour,
        "minute": now.minute,
        "second": now.second,
        "millisecond": now.microsecond // 1000,
    }
    return {f"robotTime_{name}": part for name, part in parts.items()}
