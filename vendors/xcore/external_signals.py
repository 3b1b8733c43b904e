"""Rows of External Communication: which word becomes which canonical key.

`false` also means that the query has failed. So it never becomes a value by itself: it is null, but where a second
answer says the same. The raw answers stand in the vendor group.
"""

from __future__ import annotations

from collections.abc import Sequence

from gateway.api.model import (
    Fault,
    FunctionKind,
    Motion,
    OperatingMode,
    Power,
    ProgramState,
    SafetyFunction,
    SafetyState,
    Severity,
)
from gateway.api.signals import Signal

_MOTION = {
    "ready": Motion.STANDSTILL,
    "jog": Motion.JOGGING,
    "drag": Motion.HAND_GUIDING,
    "rci": Motion.EXTERNAL_CONTROL,
    "load_identify": Motion.MOVING,
    "dynamic_identify": Motion.MOVING,
}
_NO_PROGRAM = _MOTION.keys()  # tasks besides which no program runs
_KNOWN_TASKS = {*_MOTION, "program", "demo", "debug"}


def _arm(told: Sequence[float], *, axes: int) -> Sequence[float]:
    return told[:axes]


def _external(told: Sequence[float], *, axes: int) -> Sequence[float] | None:
    return told[axes:] or None


def _effort(told: Sequence[float], *, axes: int, torque_unit: str | None) -> Sequence[float] | None:
    return told[:axes] if torque_unit == "Nm" else None


def _only_true(told: bool) -> bool | None:  # noqa: FBT001 - a word's answer
    return True if told else None


def _mode(automatic: bool) -> OperatingMode | None:  # noqa: FBT001
    return OperatingMode.AUTOMATIC if automatic else None


def _power(motors_on: bool) -> Power | None:  # noqa: FBT001
    return Power.ENABLED if motors_on else None


def _motion(task: str) -> Motion | None:
    return _MOTION.get(task, None if task in _KNOWN_TASKS else Motion.UNKNOWN)


def _program(running: bool | None, task: str | None) -> ProgramState | None:  # noqa: FBT001
    """Running by its own word; stopped where that word says no and the task is another."""
    if running:
        return ProgramState.RUNNING
    return ProgramState.STOPPED if running is False and task in _NO_PROGRAM else None


def _e_stopped(told: bool, *, estop_polarity: str | None) -> bool | None:  # noqa: FBT001
    """A clear `true` is believed either way; a `false` only where it may mean danger."""
    if estop_polarity == "active_low":
        return not told
    return True if told and estop_polarity == "active_high" else None


def _e_stop_is_doubtful(told: bool, *, estop_polarity: str | None) -> bool:  # noqa: FBT001
    return estop_polarity == "active_low" and not told


def _state(estop: bool | None, collision: bool | None, *, estop_polarity: str | None) -> SafetyState | None:  # noqa: FBT001
    if estop is not None and _e_stopped(estop, estop_polarity=estop_polarity):
        return SafetyState.EMERGENCY_STOP
    return SafetyState.PROTECTIVE_STOP if collision else None


def _state_is_doubtful(estop: bool | None, _collision: bool | None, *, estop_polarity: str | None) -> bool:  # noqa: FBT001
    return estop is not None and _e_stop_is_doubtful(estop, estop_polarity=estop_polarity)


def _functions(
    estop: bool | None,  # noqa: FBT001
    collision: bool | None,  # noqa: FBT001
    *,
    estop_polarity: str | None,
) -> list[SafetyFunction] | None:
    if estop is None and collision is None:
        return None
    pressed = None if estop is None else _e_stopped(estop, estop_polarity=estop_polarity)
    return [
        SafetyFunction("estop_state", FunctionKind.ESTOP, active=pressed, raw=_raw(estop)),
        SafetyFunction(
            "collision_state", FunctionKind.COLLISION, active=True if collision else None, raw=_raw(collision)
        ),
    ]


def _raw(told: bool | None) -> int | None:  # noqa: FBT001
    return None if told is None else int(told)


def _faults(told: bool) -> list[Fault] | None:  # noqa: FBT001
    return [Fault(code="fault_state", severity=Severity.ERROR)] if told else None


_STOPS = ("estop_state", "collision_state")
_POLARITY = ("estop_polarity",)

SIGNALS = (
    Signal("joints.position", "jnt_pos", _arm, options=("axes",)),
    Signal("joints.velocity", "jnt_vel", _arm, options=("axes",)),
    Signal("joints.effort", "jnt_trq", _effort, options=("axes", "torque_unit")),
    Signal("joints.external_position", "jnt_pos", _external, options=("axes",)),
    Signal("tcp.pose", "cart_pos", rotation="rpy_fixed_xyz"),
    Signal("status.operating_mode", "operating_mode", _mode),
    Signal("status.power", "motor_on_state", _power),
    Signal("status.drives_powered", "motor_on_state", _only_true),
    Signal("status.motion", "task_state", _motion),
    Signal("status.program.state", ("robot_running_state", "task_state"), _program, partial=True),
    Signal("status.program.name", "current_prog"),
    Signal("status.in_error", "fault_state", _only_true),
    Signal("status.e_stopped", "estop_state", _e_stopped, options=_POLARITY, doubt=_e_stop_is_doubtful),
    Signal("status.faults", "fault_state", _faults),
    Signal("safety.state", _STOPS, _state, partial=True, options=_POLARITY, doubt=_state_is_doubtful),
    Signal("safety.functions", _STOPS, _functions, partial=True, options=_POLARITY),
    Signal("safety.collision", "collision_state", _only_true),
)
