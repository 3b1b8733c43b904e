"""An invented vendor: one JSON object a line, pushed, with a hello first and lines that tell what has happened."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, cast

import msgspec
from msgspec import Meta

from gateway.api.decoder import Entry, Event, Frame, Occurrence, Refused, Reject, Skipped
from gateway.api.lines import Lines
from gateway.api.model import Command, EventKind, OperatingMode
from gateway.api.numbers import Numbers
from gateway.api.record import Record, Value
from gateway.api.signals import Signal
from gateway.api.vendor import Protocol, Vendor

Finite = Annotated[float, Meta(ge=-1e6, le=1e6)]
STATE = Record(
    name="state",
    source="An invented manual, version 1, section 1",
    fields=(
        Value(
            name="angles",
            type=Annotated[list[Finite], Meta(min_length=3, max_length=3)],
            unit="deg",
            meaning="Angle of each joint",
        ),
        Value(name="volts", type=Finite, unit="V", meaning="Supply voltage of the tool"),
        Value(name="mode", type=str, meaning="auto or manual"),
        Value(name="collision", type=bool, meaning="Collision detected"),
        Value(name="alarm", type=str, meaning="The newest alarm, of lines of their own", own=True),
    ),
)
_MODES = {"auto": OperatingMode.AUTOMATIC, "manual": OperatingMode.MANUAL}


class LinesDecoder:
    """One session."""

    notes: Sequence[str] = ()

    def __init__(self) -> None:
        self._lines = Lines(b"\n")
        self._numbers = Numbers()
        self.ready = False

    @property
    def gaps(self) -> int | None:
        """How many numbered lines did not come."""
        return self._numbers.gaps

    @property
    def pending(self) -> int:
        """How many bytes wait for the end of their line."""
        return self._lines.pending

    def feed(self, data: bytes) -> list[Event]:
        """Take received bytes."""
        return [self.line(line) if isinstance(line, bytes) else line for line in self._lines.feed(data)]

    def end(self) -> list[Reject]:
        """Return what is left."""
        return self._lines.end()

    def outgoing(self) -> bytes:
        """Nothing is owed."""
        return b""

    def tick(self) -> bytes | Refused:
        """Nothing is asked."""
        return b""

    def goodbye(self) -> bytes:
        """Nothing is owed."""
        return b""

    def line(self, raw: bytes) -> Event:
        """Read one line."""
        if not raw.strip():
            return Skipped(raw, "empty")
        try:
            told = self.parse(raw)
            return self.message(raw, told)
        except (ValueError, RecursionError) as error:
            return Reject(raw, "line", str(error))

    def parse(self, raw: bytes) -> dict[str, object]:
        """Make an object of a line."""
        told: object = msgspec.json.decode(raw)
        if not isinstance(told, dict):
            raise ValueError("no object")  # noqa: TRY004 - a wrong message
        return told

    def message(self, raw: bytes, told: dict[str, object]) -> Event:
        """Read one object."""
        kind = told.get("type")
        if kind == "hello":
            self.ready = True
            return Skipped(raw, "hello")
        if not self.ready:
            raise ValueError("no hello came")
        if kind not in ("state", "alarm", "issued"):  # it may be of any type
            return Skipped(raw, "unknown")
        self._numbers.take(msgspec.convert(told.get("seq"), Annotated[int, Meta(ge=1, le=1 << 53)]))
        if kind == "issued":
            return Occurrence(raw, tuple(_commands(told)))
        if kind == "alarm":
            return Frame(raw, STATE, values={"alarm": STATE.convert("alarm", told.get("text"))})
        return Frame(raw, STATE, values=self.values(told))

    def values(self, told: dict[str, object]) -> dict[str, object]:
        """The values of the record."""
        return {
            name: STATE.convert(name, told[name])
            for name, value in STATE.by_name.items()
            if name in told and not value.own
        }


def _commands(told: dict[str, object]) -> list[Entry]:
    objects = msgspec.convert(told.get("objects"), list[dict[str, Finite | str]])
    name = msgspec.convert(told.get("id"), str)
    return [
        Entry(
            EventKind.COMMAND_ISSUED,
            Command(id=name, type="Move", index=index, total=len(objects), object=cast("dict[str, object]", one)),
        )
        for index, one in enumerate(objects)
    ]


def mode(told: str) -> OperatingMode:
    """The operating mode of its word."""
    return _MODES.get(told, OperatingMode.OTHER)


VENDOR = Vendor(
    name="lima",
    title="Lima Robots",
    protocols=(
        Protocol(
            name="lines",
            title="State data, one JSON object a line",
            port=4712,
            records=(STATE,),
            signals=(
                Signal("joints.position", "angles"),
                Signal("controller.tool_voltage", "volts"),
                Signal("status.operating_mode", "mode", via=mode),
                Signal("safety.collision", "collision"),
            ),
            make_reader=LinesDecoder,
            commands=True,
            cost=60.0,
        ),
    ),
)
