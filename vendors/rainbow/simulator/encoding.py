"""The state frames of the virtual Rainbow controller, made of the same table that decodes them.

What clients must mask or ignore is filled with values other than zero. Sessions stand in `sessions.py`.
"""

from __future__ import annotations

import dataclasses
from functools import partial
from math import pi, sin
from random import Random
from typing import Annotated, Literal

import msgspec
from msgspec import Meta

from gateway.api.layout import Layout
from gateway.api.model import Power, ProgramState
from gateway.api.units import ZERO_CELSIUS_K
from gateway.sim.packing import Packer, Word
from gateway.sim.scenario import FaultKind, RobotState
from gateway.sim.simulator import VirtualRobot
from vendors.rainbow.layouts import LAYOUTS, STATE_580

HEADER = 4
STATE, CONFIGURATION, POP_UP = 3, 4, 10  # frame types
_LONGEST = 4100
_SIZES = tuple(sorted(layout.size for layout in LAYOUTS))


class RainbowOptions(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Options of the virtual Rainbow controller."""

    layout: Annotated[
        int,
        Meta(
            ge=_SIZES[0],
            le=_LONGEST,
            description=f"Bytes of a state frame: {', '.join(map(str, _SIZES))}, or more in steps of 4.",
        ),
    ] = 580
    size_counts: Annotated[
        Literal["payload", "frame"],
        Meta(description="What the size field counts: the payload, or wrongly the whole frame."),
    ] = "payload"
    time: Annotated[
        Literal["finite", "nan"],
        Meta(description="What stands in the word `time`, which no box fills: some finite number, or NaN."),
    ] = "finite"

    def __post_init__(self) -> None:
        if self.layout not in _SIZES and (self.layout < _SIZES[-1] or self.layout % 4):
            known = ", ".join(str(size) for size in _SIZES)
            raise ValueError(f"layout is {self.layout}: it is one of {known}, or more in steps of 4")


def frame(type_: int, payload: bytes, size: int | None = None) -> bytes:
    """Frame a payload; `size` overrides what the size field says."""
    size = len(payload) if size is None else size
    return b"$" + size.to_bytes(2, "little") + bytes([type_]) + payload


# Frames that carry no state: configurations of old and older boxes, and a pop-up (kind, text, padding, length).
FILLERS = (
    frame(CONFIGURATION, bytes(range(92))),
    frame(CONFIGURATION, bytes(range(208)) * 3),
    frame(POP_UP, b"\x01" + b"Check the tool.".ljust(1000, b"\0") + bytes(3) + (15).to_bytes(4, "little")),
)

# In frames older than 580 bytes task_run_time is a float.
_OLD_TABLE = dataclasses.replace(
    STATE_580,
    fields=tuple(
        dataclasses.replace(field, type="f32") if field.name == "task_run_time" else field for field in STATE_580.fields
    ),
)


def table(size: int) -> Layout:
    """Return the table that a frame of `size` bytes is written by."""
    return STATE_580 if size >= STATE_580.size else _OLD_TABLE.prefix(size, name=str(size))


_FAULTS = {  # -> op_stat_sos_flag, flag of jnt_info
    FaultKind.ENCODER: (1, "enc_nonius_err"),
    FaultKind.FOLLOWING_ERROR: (5, "err_jam"),
    FaultKind.OVER_CURRENT: (6, "err_cur"),
    FaultKind.OVER_TEMPERATURE: (11, "err_tmp"),
}
_TASK_STATES = {ProgramState.STOPPED: 1, ProgramState.PAUSED: 2, ProgramState.RUNNING: 3}
_STILL, _MOVING = 1, 3  # robot_state
_MOTOR_TORQUE = 1  # last_out_collision_cause
_TIME_ZONE = 0x2A40D50  # undocumented; on real boxes a large number
_DEG = 180 / pi


class Encoder:
    """Writes state frames: what only a phase changes is written once a phase, the rest once a frame."""

    def __init__(self, robot: VirtualRobot, options: RainbowOptions) -> None:
        self._robot = robot
        self._options = options
        layout = table(options.layout)
        self.packer = Packer(layout)
        size = options.layout if options.size_counts == "frame" else options.layout - HEADER
        self._header = frame(STATE, b"", size)
        self._tail = bytes((7 * at) & 0xFF | 1 for at in range(options.layout - layout.size))
        self._full = Packer(_OLD_TABLE if layout.size < STATE_580.size else STATE_580)
        self._template: list[Word] = []
        self._template_of: tuple[object, int] = (None, 0)
        self._time: tuple[int, float] = (-1, 0.0)

    def words(self, state: RobotState) -> list[Word]:
        """Return all words of the whole table, in wire order."""
        stage = _activation(state)
        if self._template_of[0] is not state.phase or self._template_of[1] != stage:
            self._template = self._full.words(self._values(state, stage))
            self._template_of = state.phase, stage
        words = self._template.copy()
        tcp = state.tcp
        pose = [*(1000 * metres for metres in tcp.position), *(angle * _DEG for angle in tcp.rpy)]
        words[_TIME] = self._uninitialised(int(state.time_s))
        words[_JOINTS] = [
            *(angle * _DEG for angle in state.target_position),
            *(angle * _DEG for angle in state.position),
            *state.current,
            *pose,
            *pose,  # tcp_pos is a copy of tcp_ref
        ]
        words[_TEMPERATURES] = [kelvin - ZERO_CELSIUS_K for kelvin in state.temperature]
        closed = int(state.gripper_closed)
        words[_GRIPPER_IN] = [closed, 1 - closed]
        words[_GRIPPER_OUT] = closed
        words[_RUN_ID] = 1 + int(state.program_s) % 8 if state.program_s else 0
        words[_RUN_NUM] = state.cycles
        words[_RUN_TIME] = int(state.program_s)
        words[_ROBOT_STATE] = self._robot_state(state)
        words[_CHUNK_1] = int(words[_CHUNK_1]) | _cabinet_temperatures(state.time_s)
        words[_SELF_COLLISION] = int(words[_SELF_COLLISION]) ^ (int(state.time_s) & 0xF) << _ZONE_BIT
        words[_CHUNK_3] = int(words[_CHUNK_3]) | min(int(tcp.speed * 10_000), 0xFFFF) << _SPEED_BIT
        words[_FORCE_Z] = -9.3 - 14.7 * closed
        return words

    def frame(self, now_s: float) -> bytes:
        """Return one frame, and count it."""
        words = self.words(self._robot.state(now_s))
        data = self.packer.pack(words) + self._tail
        self._robot.count(data, now_s, partial(self.packer.named, words))
        return data

    def _robot_state(self, state: RobotState) -> int:
        phase = state.phase
        interrupted = phase.program is ProgramState.PAUSED and not phase.collision
        return _MOVING if interrupted or (state.moving and not phase.freedrive) else _STILL

    def _uninitialised(self, second: int) -> float:
        """The word that no box fills: it looks like whatever stood in the memory before."""
        if self._time[0] != second:
            random = Random(f"{self._robot.seed}/{self._robot.number}/{second}")  # noqa: S311 - no secret
            value = float("nan") if self._options.time == "nan" else 10 ** random.uniform(-30, 30)
            self._time = second, value
        return self._time[1]

    def _values(self, state: RobotState, stage: int) -> dict[str, object]:
        """What only a phase changes, by the manual's names."""
        phase = state.phase
        sos, joint_flag = _FAULTS[phase.fault.kind] if phase.fault else (0, "")
        faulted = phase.fault.joint if phase.fault else None
        paused = phase.program is ProgramState.PAUSED
        return {
            **_SETTLED,
            "header": list(self._header),
            "analog_in": [2.5, 0.75, 0.02, 0.01],
            "analog_out": [1.0 if phase.program is ProgramState.RUNNING else 0.0, 0.0, 0.0, 0.0],
            "digital_in": [0, 1, 1, int(phase.program is ProgramState.RUNNING), *[0] * 12],
            "digital_out": [0, int(phase.program is ProgramState.RUNNING), int(phase.fault is not None), *[0] * 13],
            "task_state": _TASK_STATES[phase.program],
            "default_speed": phase.speed_override,
            "information_chunk_1": {**_HEALTHY, **_power_bits(state), "sos_active": int(sos > 0)},
            "jnt_info": [
                _joint_bits(state, joint_flag if joint == faulted else "") for joint in range(len(state.position))
            ],
            "is_freedrive_mode": int(phase.freedrive),
            "init_state_info": stage,
            "op_stat_collision_occur": int(phase.collision),
            "op_stat_sos_flag": sos,
            "op_stat_self_collision": {
                "last_out_collision_cause": _MOTOR_TORQUE if phase.collision else 0,
                "time_zone_raw": _TIME_ZONE,
            },
            "op_stat_soft_estop_occur": int(paused),
            "information_chunk_2": {
                "config_di_16": 1,
                "arm_activating": int(phase.power is Power.BOOTING),
                "pfl_mode": 1,
                "component_connection": 0x3F,
            },
        }


# What stays the same as long as the controller runs.
_SETTLED: dict[str, object] = {
    "task_repeat": 100,
    "reserved_1": [1.5e-39, -3.2e8, 7.25, 4.6e-41, -0.125, 1.1e20],
    "collision_detect_onoff": 1,
    "tfb_analog_in": [0.42, 0.17],
    "tfb_digital_in": [1, 0],
    "tfb_digital_out": [0, 1],
    "tfb_voltage_out": 24.0,
    "information_chunk_3": {"config_di_17": 1, "lan_cable": 1},
    "inbox_check_mode": [2, 0],
    "eft_fx": 1.2,
    "eft_fy": -0.8,
    "eft_mx": 0.05,
    "eft_my": -0.02,
    "eft_mz": 0.01,
    "information_chunk_4": {"tool_list_index": 2, "tfb_di_3": 1},
    "extend_io1_analog_in": [0.1, 0.2, 0.3, 0.4],
    "extend_io1_analog_out": [5.0, 0.0, 0.0, 0.0],
    "extend_io1_digital_info": {"ext_di_0": 1, "ext_di_15": 1, "ext_do_1": 1, "ext_do_15": 1},
    "aa_joint_ref": [12.5, -45.0, 0.0, 0.0, 0.0, 0.0],
    "safety_board_stat_info": 0x80000101,
}
_HEALTHY = {
    "box_48v_in": 1,
    "box_24v_in": 1,
    "user_switch": 1,
    "hand_button_a": 1,  # may read 1 at rest
    "hand_button_b": 1,
    "lan2can_connected": 1,
    "program_load_toggle": 1,
}


def _power_bits(state: RobotState) -> dict[str, int]:
    powered = int(state.phase.power is not Power.OFF)
    released = int(not state.phase.estop)
    return {
        "box_48v_out": powered,
        "arm_power": powered,
        "estop_1": released,  # 1 is the healthy state
        "estop_2": released,
        "teach_button": int(state.phase.freedrive),
    }


def _joint_bits(state: RobotState, faulted: str) -> dict[str, int]:
    enabled = int(state.phase.power is Power.ENABLED)
    guided = int(state.phase.freedrive)
    bits = {
        "fet": enabled,
        "run": int(enabled and not guided),
        "init": enabled,
        "mode": guided,
        "reserved_16_31": 0x0100,
    }
    return {**bits, faulted: 1} if faulted else bits


def _activation(state: RobotState) -> int:
    """The activation stage: 0 at rest, 1 to 5 while the checks run, 6 when the arm is active."""
    power = state.phase.power
    if power is Power.ENABLED:
        return 6
    return 1 + min(4, int(5 * state.progress)) if power is Power.BOOTING else 0


def _cabinet_temperatures(time_s: float) -> int:
    """CPU near 52 degC and main board near 40 degC, each stored halved."""
    drift = 2.5 * sin(time_s / 120)
    return int((52 + drift) / 2) << _CPU_BIT | int((40 + drift) / 2) << _BOARD_BIT


def _slots(first: str, last: str) -> slice:
    slots = Packer(STATE_580).slots
    return slice(slots[first].start, slots[last].stop)


def _slot(name: str) -> int:
    return int(Packer(STATE_580).slots[name].start)


def _bit(name: str) -> int:
    return STATE_580.flag_owner[name][1].bit


_TIME = _slot("time")
_JOINTS = _slots("jnt_ref", "tcp_pos")
_TEMPERATURES = _slots("jnt_temperature", "jnt_temperature")
_GRIPPER_IN = slice(_slot("digital_in"), _slot("digital_in") + 2)
_GRIPPER_OUT = _slot("digital_out")
_RUN_ID, _RUN_NUM, _RUN_TIME = _slot("task_run_id"), _slot("task_run_num"), _slot("task_run_time")
_ROBOT_STATE = _slot("robot_state")
_CHUNK_1, _CHUNK_3 = _slot("information_chunk_1"), _slot("information_chunk_3")
_SELF_COLLISION, _FORCE_Z = _slot("op_stat_self_collision"), _slot("eft_fz")
_CPU_BIT, _BOARD_BIT = _bit("information_chunk_1.cpu_temp_half"), _bit("information_chunk_1.board_temp_half")
_SPEED_BIT, _ZONE_BIT = _bit("information_chunk_3.tcp_speed_x10"), _bit("op_stat_self_collision.time_zone_raw")
