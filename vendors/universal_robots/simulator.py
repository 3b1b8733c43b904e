"""The virtual Universal Robots controller: it pushes real-time frames on port 30013, made of the table that reads them.

It has no port 30003: nothing of this project ever speaks to that one.
"""

from __future__ import annotations

from functools import partial
from math import acos, hypot, sin
from typing import Annotated, Literal, cast

import msgspec
from msgspec import Meta

from gateway.api.model import Power, ProgramState
from gateway.api.rotations import quaternion_from_rpy
from gateway.api.units import ZERO_CELSIUS_K
from gateway.sim.motion import ArmPose, Six
from gateway.sim.packing import Packer
from gateway.sim.scenario import Phase, RobotState
from gateway.sim.simulator import Demo, Port, Simulator, VirtualRobot
from vendors.universal_robots.layouts import LAYOUTS

_BY_SIZE = {layout.size: layout for layout in LAYOUTS}
_HEADER = 4
_UP_S = 100.0  # how long the controller has been up when the scenario begins
_MOMENT_NM = 8.0  # N·m for each A, about


class UniversalRobotsOptions(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Options of the virtual Universal Robots controller."""

    size: Annotated[
        Literal[1220, 1140, 1116, 1108, 1060, 1044],
        Meta(description="Bytes of a frame, which tell the software: 1220 is 5.10 and later, 1108 is 3.5 or 5.0."),
    ] = 1220
    rate_hz: Annotated[
        int,
        Meta(ge=1, le=500, description="Frames a second: 500 as the e-Series, 125 as CB3."),
    ] = 125


class RealtimeSession:
    """One client of port 30013: a frame every period, and whatever it sends is ignored."""

    def __init__(self, robot: VirtualRobot, options: msgspec.Struct) -> None:
        own = cast("UniversalRobotsOptions", options)
        self._robot = robot
        self._packer = Packer(_BY_SIZE[own.size])
        self._settled: tuple[Phase | None, dict[str, object]] = (None, {})
        self.period_s: float | None = 1 / own.rate_hz

    def received(self, _data: bytes, _now_s: float) -> list[bytes]:
        """Ignore what comes: the port is read-only."""
        return []

    def due(self, now_s: float) -> list[bytes]:
        """Push a frame."""
        state = self._robot.state(now_s)
        if self._settled[0] is not state.phase:
            self._settled = state.phase, phase_values(state.phase)
        values = {"message_size": self._packer.layout.size, **self._settled[1], **_moving_values(state)}
        words = self._packer.words(values)
        frame = self._packer.pack(words)
        self._robot.count(frame, now_s, partial(self._packer.named, words))
        return [frame]


def phase_values(phase: Phase) -> dict[str, object]:
    """What only a phase changes, by the manual's names."""
    powered = phase.power is not Power.OFF
    joint = {Power.ENABLED: 253.0, Power.OFF: 239.0}.get(phase.power, 246.0)
    joints = [joint] * 6
    if phase.fault:
        joints[phase.fault.joint] = 252.0
    safety = 7.0 if phase.estop else 9.0 if phase.fault else 3.0 if phase.collision else 1.0
    runs = phase.program is ProgramState.RUNNING
    return {
        "joint_modes": joints,
        "safety_mode": safety,
        "safety_status": safety,
        "program_state": {ProgramState.RUNNING: 2.0, ProgramState.PAUSED: 4.0}.get(phase.program, 1.0),
        "speed_scaling": 1.0 if runs else 0.0,
        "digital_outputs": 0b01 | runs << 1 | (phase.fault is not None) << 8,
        "controller_timer": 0.0005,
        "tool_accelerometer_values": [0.12, -0.31, 9.78],
        "V_main": 48.1,
        "V_robot": 48.0 if powered else 0.0,
        "I_robot": 1.1 if powered else 0.0,
        "V_actual": [47.9 if powered else 0.0] * 6,
        "payload_mass": 1.5,
        "payload_CoG": [0.0, 0.01, 0.06],
        "payload_inertia": [0.002, 0.002, 0.001, 0.0, 0.0, 0.0],
    }


def _moving_values(state: RobotState) -> dict[str, object]:
    """What each frame changes."""
    pose = [*state.tcp.position, *_rotation_vector(state.tcp)]
    twist = [*_linear(state.tcp), 0.0, 0.0, state.velocity[0]]
    closed = int(state.gripper_closed)
    return {
        "time": _UP_S + state.time_s,
        "q_target": state.target_position,
        "qd_target": state.velocity,
        "I_target": state.current,
        "M_target": [_MOMENT_NM * current for current in state.current],
        "q_actual": state.position,
        "qd_actual": state.velocity,
        "I_actual": state.current,
        "I_control": state.current,
        "tool_vector_actual": pose,
        "TCP_speed_actual": twist,
        "TCP_force": [1.2, -0.8, -9.3 - 14.7 * closed, 0.05, -0.02, 0.01],
        "tool_vector_target": pose,
        "TCP_speed_target": twist,
        "digital_input_bits": 0b110 | closed << 16 | (1 - closed) << 17,
        "motor_temperatures": [kelvin - ZERO_CELSIUS_K for kelvin in state.temperature],
        "robot_mode": _robot_mode(state),
        "linear_momentum_norm": 12.0 * state.tcp.speed,
        "elbow_position": _elbow(state.position),
    }


def _robot_mode(state: RobotState) -> float:
    """Power on, then idle, then running; a freedrive is no mode of its own."""
    if state.phase.power is Power.BOOTING:
        return 4.0 if state.progress < 0.5 else 5.0  # noqa: PLR2004 - half of the phase
    return 7.0 if state.phase.power is Power.ENABLED else 3.0


def _rotation_vector(tcp: ArmPose) -> list[float]:
    """Axis times angle, in rad, of the orientation."""
    x, y, z, w = (part or 0.0 for part in quaternion_from_rpy(*tcp.rpy))
    angle = 2 * acos(min(1.0, w))
    scale = angle / sin(angle / 2) if angle else 2.0
    return [x * scale, y * scale, z * scale]


def _linear(tcp: ArmPose) -> list[float]:
    """The speed of the TCP, in m/s, as if it went round the base."""
    x, y, _ = tcp.position
    radius = hypot(x, y) or 1.0
    return [-tcp.speed * y / radius, tcp.speed * x / radius, 0.0]


def _elbow(position: Six) -> list[float]:
    """Where the elbow of a small cobot is, in m: its upper arm is 0.425 m long and begins 0.089 m above the base."""
    shoulder = position[1]
    return [0.425 * sin(shoulder), 0.0, 0.089 - 0.425 * sin(shoulder)]


SIMULATOR = Simulator(
    ports=(Port(protocol="realtime", port=30013, session=RealtimeSession, header=_HEADER),),
    options=UniversalRobotsOptions,
    demos=(Demo(protocol="realtime"),),
)
