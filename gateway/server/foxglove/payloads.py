"""What the channels carry: the sample as every door sends it, and what of it has a Foxglove schema of its own.

Each is encoded once, whatever the number of clients: samples are kept at their reading, events by identity.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache
from typing import Generic, TypeVar

import msgspec

from gateway.api.model import Array, Event, EventKind, Fault, Pose, Sample, Severity, Tcp

T = TypeVar("T")
_ENCODER = msgspec.json.Encoder()
_KEPT_EVENTS = 4096
_POSITION, _ORIENTATION = 3, 4
NOTHING = b""  # the payload of what cannot be told: nothing is sent

_INFO, _WARNING, _ERROR, _FATAL = 2, 3, 4, 5  # foxglove.LogLevel
_LEVELS = {
    EventKind.LINK_LOST: _WARNING,
    EventKind.LINK_INCOMPATIBLE: _ERROR,
    EventKind.SAFETY_CHANGED: _WARNING,
    EventKind.ESTOP_PRESSED: _ERROR,
    EventKind.COLLISION_DETECTED: _ERROR,
    EventKind.FAULT_RAISED: _WARNING,
    EventKind.COMMAND_MISSED: _WARNING,
}
_SEVERITIES = {Severity.INFO: _INFO, Severity.WARNING: _WARNING, Severity.ERROR: _ERROR, Severity.FATAL: _FATAL}


class Same(Generic[T]):
    """A value as a key: it equals itself only, and what it holds is not looked at."""

    __slots__ = ("value",)

    def __init__(self, value: T) -> None:
        self.value = value

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Same) and other.value is self.value

    def __hash__(self) -> int:
        return id(self.value)


class Time(msgspec.Struct, frozen=True):
    """A time of Foxglove, UTC since 1970."""

    sec: int
    nsec: int


class Vector3(msgspec.Struct, frozen=True):
    """A position in m."""

    x: float
    y: float
    z: float


class Quaternion(msgspec.Struct, frozen=True):
    """A unit quaternion."""

    x: float
    y: float
    z: float
    w: float


class FoxglovePose(msgspec.Struct, frozen=True):
    """foxglove.Pose: whole, or not at all."""

    position: Vector3
    orientation: Quaternion


class PoseInFrame(msgspec.Struct, frozen=True):
    """foxglove.PoseInFrame."""

    timestamp: Time
    frame_id: str
    pose: FoxglovePose


class FrameTransform(msgspec.Struct, frozen=True):
    """foxglove.FrameTransform."""

    timestamp: Time
    parent_frame_id: str
    child_frame_id: str
    translation: Vector3
    rotation: Quaternion


class FrameTransforms(msgspec.Struct, frozen=True):
    """foxglove.FrameTransforms."""

    transforms: list[FrameTransform]


class Log(msgspec.Struct, frozen=True, kw_only=True):
    """foxglove.Log, and beside it the event as the other doors send it."""

    timestamp: Time
    level: int
    message: str
    name: str
    file: str
    line: int
    event: Event


def pose_in_frame(sample: Sample) -> bytes:
    """The pose of the tool centre point, or `NOTHING` where any part of it is not known."""
    pose = _pose(sample.data.pose) if isinstance(sample.data, Tcp) else None
    if pose is None:
        return NOTHING
    return _ENCODER.encode(PoseInFrame(_time(sample.t), f"{_robot(sample)}/base", pose))


def frame_transforms(sample: Sample) -> bytes:
    """Tool centre point and flange under the base, or `NOTHING` where neither is known."""
    data = sample.data
    if not isinstance(data, Tcp):
        return NOTHING
    robot, at = _robot(sample), _time(sample.t)
    poses = {"tcp": _pose(data.pose), "flange": _pose(data.flange_pose)}
    known = [
        FrameTransform(at, f"{robot}/base", f"{robot}/{child}", pose.position, pose.orientation)
        for child, pose in poses.items()
        if pose is not None
    ]
    return _ENCODER.encode(FrameTransforms(known)) if known else NOTHING


def log(event: Event) -> bytes:
    """An event as a line of a log."""
    return _encoded(_log, Same(event))


def as_it_is(event: Event) -> bytes:
    """An event as every door sends it."""
    return _encoded(_as_it_is, Same(event))


def log_level(event: Event) -> int:
    """The foxglove.LogLevel of an event: a fault's own severity, or by its kind."""
    if event.kind is EventKind.FAULT_RAISED and isinstance(event.after, Fault) and event.after.severity is not None:
        return _SEVERITIES[event.after.severity]
    return _LEVELS.get(event.kind, _INFO)


def log_text(event: Event) -> str:
    """An event in one line."""
    parts = [_words(value) for value in (event.before, event.after) if value is not None]
    return f"{event.kind}: {' → '.join(parts)}" if parts else event.kind.value


def _encoded(make: Callable[[Same[Event]], bytes], event: Same[Event]) -> bytes:
    try:
        return make(event)
    except Exception:  # noqa: BLE001 - a plugin's wrong type costs the event's values, not the clients
        return make(Same(msgspec.structs.replace(event.value, before=None, after=None, raw={})))


@lru_cache(_KEPT_EVENTS)
def _log(event: Same[Event]) -> bytes:
    told = event.value
    return _ENCODER.encode(
        Log(
            timestamp=_time(told.t),
            level=log_level(told),
            message=log_text(told),
            name=told.robot,
            file=told.boot,
            line=told.seq,
            event=told,
        )
    )


@lru_cache(_KEPT_EVENTS)
def _as_it_is(event: Same[Event]) -> bytes:
    return _ENCODER.encode(event.value)


def _words(value: object) -> str:
    if isinstance(value, Fault):
        codes = "/".join(str(code) for code in (value.main, value.sub) if code is not None)
        return " ".join(part for part in (value.code, codes, value.text) if part)
    return value if isinstance(value, str) else _ENCODER.encode(value).decode()


def _time(t: int) -> Time:
    """A time in µs."""
    return Time(t // 1_000_000, t % 1_000_000 * 1000)


def _robot(sample: Sample) -> str:
    return sample.topic.partition("/")[0]


def _pose(pose: Pose | None) -> FoxglovePose | None:
    """A pose that is known whole."""
    if pose is None:
        return None
    position, orientation = _known(pose.position, _POSITION), _known(pose.orientation, _ORIENTATION)
    if position is None or orientation is None:
        return None
    return FoxglovePose(Vector3(*position), Quaternion(*orientation))


def _known(values: Array | None, size: int) -> list[float] | None:
    """Numbers, if there are so many and all are told."""
    if not isinstance(values, list) or len(values) != size:
        return None
    known = [value for value in values if value is not None and type(value) in {int, float} and math.isfinite(value)]
    return known if len(known) == size else None
