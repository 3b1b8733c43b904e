"""Rows of `xcore-objects/1`: which member becomes which canonical key."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import UTC, datetime, timedelta

from gateway.api.model import (
    Channels,
    FunctionKind,
    Motion,
    OperatingMode,
    Payload,
    Pose,
    Power,
    ProgramState,
    SafetyFunction,
    SafetyState,
)
from gateway.api.rotations import pose_from_rpy
from gateway.api.signals import Signal
from gateway.api.vendor import WallClock
from vendors.xcore.objects import CartesianPosition, KeyPadState, Toolset
from vendors.xcore.stream_record import Execution, Posture

# "unknown" is a word of the controller, by which it says that it cannot tell: null.
_UNKNOWN = "unknown"
_MODES = {"manual": OperatingMode.MANUAL, "automatic": OperatingMode.AUTOMATIC}
_POWER = {"on": Power.ENABLED, "off": Power.OFF, "estop": Power.OFF, "gstop": Power.OFF}
_MOTION = {
    "idle": Motion.STANDSTILL,
    "jog": Motion.JOGGING,
    "jogging": Motion.JOGGING,
    "rtControlling": Motion.EXTERNAL_CONTROL,
    "drag": Motion.HAND_GUIDING,
    "demo": Motion.MOVING,
    "dynamicIdentify": Motion.MOVING,
    "frictionIdentify": Motion.MOVING,
    "loadIdentify": Motion.MOVING,
    "moving": Motion.MOVING,
}
_PROGRAMS = {
    "rlProgram": ProgramState.RUNNING,
    "idle": ProgramState.STOPPED,
    "jog": ProgramState.STOPPED,
    "jogging": ProgramState.STOPPED,
    "drag": ProgramState.STOPPED,
}
_NOT_TOLD = {"rlProgram", _UNKNOWN}


def _mode(told: str) -> OperatingMode | None:
    return None if told == _UNKNOWN else _MODES.get(told, OperatingMode.UNKNOWN)


def _power(told: str) -> Power | None:
    return None if told == _UNKNOWN else _POWER.get(told, Power.UNKNOWN)


def _drives_powered(told: str) -> bool | None:
    return told == "on" if told in _POWER else None


def _motion(told: str) -> Motion | None:
    """What the arm does; while an RL program runs, nobody says whether it moves."""
    return _MOTION.get(told, None if told in _NOT_TOLD else Motion.UNKNOWN)


def _program(told: str) -> ProgramState | None:
    return _PROGRAMS.get(told)


def _e_stopped(power: str) -> bool | None:
    return power == "estop" if power in _POWER else None


def _safety(power: str | None, collided: bool | None) -> SafetyState | None:  # noqa: FBT001 - values of the record
    if power == "estop":
        return SafetyState.EMERGENCY_STOP
    if power == "gstop":
        return SafetyState.SAFEGUARD_STOP
    if collided:
        return SafetyState.PROTECTIVE_STOP
    return SafetyState.NORMAL if power == "on" else None


def _functions(power: str | None, collided: bool | None) -> list[SafetyFunction] | None:  # noqa: FBT001
    if power is None and collided is None:
        return None
    known = power if power in _POWER else None
    return [
        SafetyFunction("estop", FunctionKind.ESTOP, active=None if known is None else known == "estop"),
        SafetyFunction("gstop", FunctionKind.SAFEGUARD, active=None if known is None else known == "gstop"),
        SafetyFunction("collided", FunctionKind.COLLISION, active=collided),
    ]


def _pose(posture: Posture | None, position: CartesianPosition | None) -> Pose | None:
    """The robot's end in the selected reference, from whichever of the two was read."""
    if posture is not None and posture.endInRef is not None:
        return _six(posture.endInRef)
    return None if position is None else _six((*position.trans, *position.rpy))


def _flange(posture: Posture) -> Pose | None:
    return None if posture.flangeInBase is None else _six(posture.flangeInBase)


def _six(values: Sequence[float]) -> Pose:
    x, y, z, rx, ry, rz = values
    return pose_from_rpy(x, y, z, rx, ry, rz)


def _elbow(position: CartesianPosition) -> float | None:
    return position.elbow if position.hasElbow else None


def _external(told: Sequence[float]) -> Sequence[float] | None:
    return told or None


def _task(told: Execution) -> str | None:
    return told.taskName or None


def _line(told: Execution) -> int | None:
    return told.executeLine


def _payload(told: Toolset) -> Payload:
    return Payload(mass=told.load.mass, cog=list(told.load.cog))


def _inputs(
    di: Mapping[str, bool | None] | None, keys: KeyPadState | None
) -> dict[str, list[bool | None] | None] | None:
    """Each named input is a bank of its own; so are the keys at the robot's end."""
    banks: dict[str, list[bool | None] | None] = _banks(di or {})
    if keys is not None:
        banks["keypad"] = [getattr(keys, f"key{number}_state") for number in range(1, 8)]
    return banks or None


def _banks(told: Mapping[str, bool | None]) -> dict[str, list[bool | None] | None]:
    return {name: [value] for name, value in told.items()}


def _channels(told: Mapping[str, float | None]) -> dict[str, Channels | None]:
    return {name: Channels(raw=[value]) for name, value in told.items()}


_STOPS = ("powerState", "collided")

SIGNALS = (
    Signal("joints.position", "jointPos"),
    Signal("joints.velocity", "jointVel"),
    Signal("joints.effort", "jointTorque"),
    Signal("joints.external_position", "external", _external),
    Signal("tcp.pose", ("posture", "cartPosture"), _pose, partial=True),
    Signal("tcp.flange_pose", "posture", _flange),
    Signal("tcp.elbow", "cartPosture", _elbow),
    Signal("io.digital_in", ("di", "keypad"), _inputs, partial=True),
    Signal("io.digital_out", "do", _banks),
    Signal("analog.analog_in", "ai", _channels),
    Signal("status.operating_mode", "operateMode", _mode),
    Signal("status.power", "powerState", _power),
    Signal("status.drives_powered", "powerState", _drives_powered),
    Signal("status.motion", "operationState", _motion),
    Signal("status.program.state", "operationState", _program),
    Signal("status.program.name", "rlExecution", _task),
    Signal("status.program.line", "rlExecution", _line),
    Signal("status.e_stopped", "powerState", _e_stopped),
    Signal("status.payload", "toolset", _payload),
    Signal("status.faults", "faults"),
    Signal("safety.state", _STOPS, _safety, partial=True),
    Signal("safety.functions", _STOPS, _functions, partial=True),
    Signal("safety.collision", "collided"),
)


def _utc(ts: int) -> tuple[int, int, int, int, int, int, int]:
    told = datetime(1970, 1, 1, tzinfo=UTC) + timedelta(microseconds=ts)
    return told.year, told.month, told.day, told.hour, told.minute, told.second, told.microsecond


WALL_CLOCK = WallClock(fields=("ts",), read=_utc, zone=UTC)
