"""What the virtual xCore controller says of its robot, for both protocols: rad, m, N·m and the vendor's words.

The tool is the flange and the reference is the base, so every pose is the same.
"""

from __future__ import annotations

from math import cos, pi, sin

from gateway.api.model import Power, ProgramState
from gateway.sim.scenario import RobotState
from vendors.xcore.enums import OperateMode, OperationState, PowerState
from vendors.xcore.simulator.options import XcoreOptions

DEG = 180 / pi
PROJECTS = {"virtual_cell": ("task_main",), "virtual_test": ("task_main", "task_background")}
PROJECT = next(iter(PROJECTS))
TASK = PROJECTS[PROJECT][0]
# Plausible for a small arm, axis by axis; the seventh stands still and weighs nothing.
_TORQUE_PER_AMPERE = (11.5, 11.5, 9.0, 4.5, 4.5, 3.0, 3.0)  # N·m/A
RATED_TORQUE = (91.0, 91.0, 78.0, 22.0, 20.0, 16.0, 16.0)  # N·m
_EXTRA_RAD = 0.25

Quaternion = tuple[float, float, float, float]


def joints(state: RobotState, options: XcoreOptions) -> list[float]:
    """Angles of the axes, rad."""
    return _widened(state.position, options)


def extras(options: XcoreOptions) -> list[float]:
    """Values of the external joints, which never move, rad."""
    return [_EXTRA_RAD * (number + 1) for number in range(options.extra_joints)]


def velocities(state: RobotState, options: XcoreOptions) -> list[float]:
    """Velocities of the axes, rad/s."""
    return _widened(state.velocity, options)


def torques(state: RobotState, options: XcoreOptions) -> list[float]:
    """Torques of the axes, N·m."""
    currents = _widened(state.current, options)
    return [ampere * each for ampere, each in zip(currents, _TORQUE_PER_AMPERE, strict=False)]


def pose(state: RobotState) -> list[float]:
    """x, y, z in m and rx, ry, rz in rad."""
    return [*state.tcp.position, *state.tcp.rpy]


def quaternion(rpy: tuple[float, float, float]) -> Quaternion:
    """Convert rx, ry, rz in rad to w, x, y, z."""
    x, y, z = (angle / 2 for angle in rpy)
    cx, sx, cy, sy, cz, sz = cos(x), sin(x), cos(y), sin(y), cos(z), sin(z)
    return (
        cx * cy * cz + sx * sy * sz,
        sx * cy * cz - cx * sy * sz,
        cx * sy * cz + sx * cy * sz,
        cx * cy * sz - sx * sy * cz,
    )


def powered(state: RobotState) -> bool:
    """Whether the motors are on."""
    return state.phase.power is Power.ENABLED


def running(state: RobotState) -> bool:
    """Whether the program runs."""
    return state.phase.program is ProgramState.RUNNING


def automatic(state: RobotState) -> bool:
    """Whether the mode is automatic: a robot is guided by hand in the other."""
    return not state.phase.freedrive


def at_home(state: RobotState) -> bool:
    """Whether the home output is active: where the arm waits for a program."""
    phase = state.phase
    waits = powered(state) and phase.program is ProgramState.STOPPED and not state.moving
    return waits and phase.fault is None and not phase.freedrive


def project(state: RobotState) -> str | None:
    """The project that is open while its program runs or pauses."""
    return None if state.phase.program is ProgramState.STOPPED else PROJECT


def power_state(state: RobotState) -> PowerState:
    """The SDK's word."""
    if state.phase.estop:
        return PowerState.estop
    return PowerState.on if powered(state) else PowerState.off


def operate_mode(state: RobotState) -> OperateMode:
    """The SDK's word."""
    return OperateMode.automatic if automatic(state) else OperateMode.manual


def operation_state(state: RobotState) -> OperationState:
    """The SDK's word."""
    if state.phase.freedrive:
        return OperationState.drag
    return OperationState.rlProgram if running(state) else OperationState.idle


def _widened(values: tuple[float, ...], options: XcoreOptions) -> list[float]:
    return [*values, *(0.0,) * (options.axes - len(values))]
