"""A vendor small enough to see through: two words of joints, one of state, polled or pushed."""

from __future__ import annotations

import dataclasses
import struct

import msgspec

from gateway.api.framing import Framing, Kind
from gateway.api.layout import Field, Flag, Layout
from gateway.api.model import Motion
from gateway.api.signals import Signal
from gateway.api.vendor import OnStale, Protocol, Vendor
from gateway.core.settings import RobotSettings

LAYOUT = Layout(
    name="toy",
    size=20,
    source="invented",
    fields=(
        Field(name="header", offset=0, type="u8", count=4),
        Field(name="angle", offset=4, type="f32", count=2, unit="deg"),
        Field(
            name="word",
            offset=12,
            type="u32",
            flags=(
                Flag(name="moving", bit=0),
                Flag(name="noise", bit=8, width=24),
                Flag(name="waypoint", bit=1, width=3),
            ),
        ),
        Field(name="run_time", offset=16, type="f32", unit="s"),
    ),
)


def motion(moving: int, waypoint: int) -> Motion:
    """Waypoints change the sources, not the motion."""
    return Motion.MOVING if moving or waypoint else Motion.STANDSTILL


SIGNALS = (
    Signal("joints.position", "angle"),
    Signal("status.motion", ("word.moving", "word.waypoint"), motion),
    Signal("status.program.run_time", "run_time", volatile=True),
)

FRAMING = Framing(
    magic=b"$",
    header=4,
    length_at=1,
    length_adds=4,
    type_at=3,
    kinds=(
        Kind(type=3, name="state", layouts=(LAYOUT,), smallest=20, largest=64, step=4),
        Kind(type=4, name="other", smallest=8, largest=64),
    ),
)


def ask(_: msgspec.Struct) -> bytes:
    """The request."""
    return b"ask"


POLLED = Protocol(
    name="polled",
    title="asked for each frame",
    port=1,
    framing=FRAMING,
    signals=SIGNALS,
    request=ask,
    rate_hz=10.0,
    max_rate_hz=100.0,
    outgoing=(b"ask",),
)
PUSHED = dataclasses.replace(POLLED, name="pushed", request=None, rate_hz=None, outgoing=())
VENDOR = Vendor(name="toy", title="Toy", protocols=(POLLED, PUSHED))


def frame(*, angle: float = 1.0, word: int = 0, run_time: float = 0.0, extra: int = 0) -> bytes:
    """One state frame, packed by hand."""
    body = struct.pack("<ffIf", angle, 2 * angle, word, run_time) + bytes(extra)
    return struct.pack("<BHB", 0x24, len(body), 3) + body


OTHER = struct.pack("<BHB", 0x24, 4, 4) + b"note"


def settings(*, pushed: bool = False, on_stale: OnStale = "close", stale_s: float = 1.0) -> RobotSettings:
    """A robot that speaks toy."""
    protocol = dataclasses.replace(PUSHED if pushed else POLLED, on_stale=on_stale)
    return RobotSettings(
        name="r1",
        host="192.0.2.1",
        port=1,
        vendor=VENDOR,
        protocol=protocol,
        rate_hz=protocol.rate_hz,
        stale_s=stale_s,
    )
