"""An invented vendor: pushed frames with a magic of two bytes, a counter, a checksum and a tail, all big-endian.

0       2        4      5         6                 26         28     30
+-------+--------+------+---------+-----------------+----------+------+
| 5A A5 | length | type | counter | payload         | checksum | 0D 0A|
+-------+--------+------+---------+-----------------+----------+------+
"""

from __future__ import annotations

from gateway.api.framing import Checksum, Framing, Kind
from gateway.api.layout import Field, Flag, Layout
from gateway.api.signals import Signal
from gateway.api.vendor import Protocol, Vendor

STATE = Layout(
    name="state",
    size=20,
    byteorder=">",
    source="An invented manual, version 1, section 1",
    fields=(
        Field(name="angles", offset=0, type="f32", count=3, unit="deg", meaning="Angle of each joint"),
        Field(name="volts", offset=12, type="u16", unit="V", meaning="Supply voltage of the tool"),
        Field(
            name="word",
            offset=14,
            type="u16",
            meaning="Bits",
            flags=(
                Flag(name="collision", bit=0, meaning="Collision detected"),
                Flag(name="tool", bit=8, width=4, meaning="Number of the tool"),
            ),
        ),
        Field(name="counts", offset=16, type="i16", count=2, meaning="Counters"),
    ),
)
SHORT = STATE.prefix(18, name="short")


def checksum(covered: bytes) -> int:
    """The sum of all covered bytes, each times its place: an exchange is noticed too."""
    return sum(byte * (place % 251 + 1) for place, byte in enumerate(covered)) & 0xFFFF


FRAMING = Framing(
    magic=b"\x5a\xa5",
    header=6,
    length_at=2,
    length_adds=10,
    type_at=4,
    layout_at=6,
    byteorder="big",
    checksum=Checksum(type="u16", of=checksum),
    tail=b"\r\n",
    kinds=(
        Kind(type=1, name="state", layouts=(STATE, SHORT), smallest=28, largest=64),
        Kind(type=2, name="greeting", smallest=10, largest=64),
    ),
)

VENDOR = Vendor(
    name="kilo",
    title="Kilo Robots",
    protocols=(
        Protocol(
            name="stream",
            title="State data, pushed",
            port=4711,
            framing=FRAMING,
            signals=(
                Signal("joints.position", "angles"),
                Signal("controller.tool_voltage", "volts"),
                Signal("safety.collision", "word.collision"),
                Signal("status.tool_id", "word.tool"),
            ),
            cost=60.0,  # a checksum in Python over every byte of a small frame
        ),
    ),
    exempt={
        "simulator_answers": "an invented robot has no virtual controller",
        "data_arrives_and_returns": "an invented robot has no virtual controller",
    },
)
