"""CNDE on the wire: frames, messages, and everything that may ever be sent.

    0       2       3      4            6              6 + length
    +-------+-------+------+------------+--------------+-------+
    | 5A 5A | count | type | length u16 | data         | A5 A5 |
    +-------+-------+------+------------+--------------+-------+

There is no checksum. Types 0 and 5 switch outputs and write registers: they are never sent.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from gateway.api.framing import Framing, Kind
from vendors.fairino.cnde_states import HEADER, MOST_DATA, TAIL

MAGIC = b"\x5a\x5a"
AROUND = HEADER + len(TAIL)
COUNTER_AT = 2
CONFIGURE, START, STOP, DATA, MESSAGE, FIRMWARE = 1, 2, 3, 4, 6, 8  # frame types
SUCCESS, WARNING, ERROR = 0, 2, 3  # message codes; 1 is information, 4 a fault
_SHOWN = 160  # characters of a controller's own words

_TYPES = (
    "input configuration",
    "output configuration",
    "start",
    "stop",
    "data",
    "input data",
    "message",
    "protocol version",
    "firmware version",
)

# Every type is delimited alike; what a data frame means, only the handshake tells.
DELIMITED = Framing(
    magic=MAGIC,
    header=HEADER,
    length_at=4,
    length_adds=AROUND,
    type_at=3,
    kinds=tuple(
        Kind(type=number, name=name, smallest=AROUND, largest=AROUND + MOST_DATA) for number, name in enumerate(_TYPES)
    ),
    tail=TAIL,
)

# What may ever be sent: an output configuration, start, stop, and the question for the firmware's version.
_NAME = rb"[A-Za-z][A-Za-z0-9_]*"
OUTGOING = (
    rb"ZZ\x00\x01[\x00-\xff]{2}[\x08-\xc8]\x00" + _NAME + rb"(," + _NAME + rb")*\xa5\xa5",
    rb"ZZ\x00[\x02\x03\x08]\x00\x00\xa5\xa5",
)


@dataclass(frozen=True, slots=True)
class Message:
    """What a controller says in words."""

    code: int
    text: str

    def __str__(self) -> str:
        return f'"{self.text[:_SHOWN]}"' if self.text else "nothing more"


def frame(kind: int, data: bytes = b"", count: int = 0) -> bytes:
    """Make a frame."""
    return MAGIC + bytes((count & 0xFF, kind)) + len(data).to_bytes(2, "little") + data + TAIL


def configuration(names: Sequence[str], period_ms: int) -> bytes:
    """Make the frame that asks for some states."""
    return frame(CONFIGURE, period_ms.to_bytes(2, "little") + ",".join(names).encode("ascii"))


def message(raw: bytes) -> Message:
    """Read a message, or the answer with the firmware's version; an empty one says nothing, not even success."""
    data = raw[HEADER : -len(TAIL)]
    has_code = raw[3] == MESSAGE
    text = data[has_code:].decode("utf-8", "replace").strip("\0 \r\n")
    shown = "".join(letter if letter.isprintable() else "\N{REPLACEMENT CHARACTER}" for letter in text)
    return Message(data[0] if has_code and data else 1, shown)


def asked_states(raw: bytes) -> tuple[str, ...]:
    """The states that such a frame asks for."""
    return tuple(raw[HEADER + 2 : -len(TAIL)].decode("ascii", "replace").split(","))
