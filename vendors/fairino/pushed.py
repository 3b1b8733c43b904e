"""The two protocols that a FAIRINO controller pushes as soon as somebody connects: `legacy` and `status`.

Same framing, other payload. Nothing is ever sent, and a session is never closed for its silence: from firmware 3.9.4
on an integrator may have the robot stop when the connection to one of these ports is lost.
"""

from __future__ import annotations

import struct
from functools import lru_cache
from zlib import adler32

from gateway.api.framing import Checksum, Framing, Kind
from gateway.api.layout import Layout
from gateway.api.vendor import Protocol
from vendors.fairino.layouts import LEGACY_LAYOUTS, STATUS_357, STATUS_433
from vendors.fairino.signals import SIGNALS, STATUS_SIGNALS
from vendors.fairino.wall_clock import WALL_CLOCK

MAGIC = b"\x5a\x5a"
HEADER = 5
LENGTH_ADDS = 7  # header and checksum, which data_len does not count
_LONGEST_PAYLOAD = 4096
_HAZARD = (
    "the integrator may have set SetRobotStopOnComDisc for this port (firmware 3.9.4 and later): "
    "the robot then stops when the connection is closed"
)


def sum16(data: bytes) -> int:
    """The vendor's sum check: all bytes before it, modulo 65536.

    Adler-32 has the sum of the bytes, and one, in its lower 16 bits: exact for 256 of them, and the bits above do not
    matter here. A frame of 2 kB takes 1.1 µs so, and 6.3 µs with `sum` over its bytes (ADR 0021).
    """
    pieces = _pieces(len(data)).unpack(data)
    return (sum(map(adler32, pieces)) - len(pieces)) & 0xFFFF


@lru_cache(maxsize=64)
def _pieces(size: int) -> struct.Struct:
    """What cuts so many bytes into pieces of 256, and a shorter one."""
    return struct.Struct("256s" * (size // 256) + f"{size % 256}s")


def _framing(smallest_payload: int, *layouts: Layout) -> Framing:
    state = Kind(
        type=None,
        name="state",
        layouts=layouts,
        smallest=smallest_payload + LENGTH_ADDS,
        largest=_LONGEST_PAYLOAD + LENGTH_ADDS,
    )
    return Framing(
        magic=MAGIC,
        header=HEADER,
        length_at=3,
        length_adds=LENGTH_ADDS,
        kinds=(state,),
        checksum=Checksum(type="u16", of=sum16),
        counter_at=2,
        any_size=True,
    )


LEGACY = Protocol(
    name="legacy",
    title="State frames of firmware up to 3.9.4, pushed on port 20004",
    port=20004,
    framing=_framing(577, *LEGACY_LAYOUTS),
    signals=SIGNALS,
    on_stale="keep",
    cost=25.0,
    wall_clock=WALL_CLOCK,
    hazard=_HAZARD,
)

STATUS = Protocol(
    name="status",
    title="Short state frames at 10 Hz, pushed on port 8083 to one client",
    port=8083,
    framing=_framing(64, STATUS_357, STATUS_433),
    signals=STATUS_SIGNALS,
    on_stale="keep",
    cost=25.0,
    hazard=_HAZARD,
)
