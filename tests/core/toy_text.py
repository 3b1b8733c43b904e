"""A text protocol small enough to see through: a line `name` asks, `name=<json>` answers: each answer is one part."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import msgspec

from gateway.api.asking import Rota
from gateway.api.decoder import Entry, Event, Frame, Occurrence, Refused, Reject
from gateway.api.lines import Lines
from gateway.api.model import Command, EventKind, Motion, OperatingMode, Power, ProgramState, SafetyState
from gateway.api.numbers import Numbers
from gateway.api.record import Record, Value
from gateway.api.signals import Signal
from gateway.api.vendor import Protocol, Vendor, WallClock
from gateway.core.settings import RobotSettings

RECORD = Record(
    name="toy_text",
    source="invented",
    fields=(
        Value(name="pos", type=list[float], unit="deg", meaning="Joints"),
        Value(name="vel", type=list[float], unit="deg/s", meaning="Joint velocities"),
        Value(name="mode", type=str, meaning="Mode"),
        Value(name="power", type=str, meaning="Power"),
        Value(name="motion", type=str, meaning="Motion"),
        Value(name="program", type=str, meaning="Program"),
        Value(name="stop", type=bool, meaning="Emergency stop"),
        Value(name="hit", type=bool, meaning="Collision"),
        Value(name="sec", type=int, meaning="Seconds of the controller's clock"),
    ),
)


def _safety(stop: bool | None, hit: bool | None) -> SafetyState | None:  # noqa: FBT001 - values of the record
    if stop:
        return SafetyState.EMERGENCY_STOP
    return SafetyState.PROTECTIVE_STOP if hit else None


SIGNALS = (
    Signal("joints.position", "pos"),
    Signal("joints.velocity", "vel"),
    Signal("status.operating_mode", "mode", OperatingMode),
    Signal("status.power", "power", Power),
    Signal("status.motion", "motion", Motion),
    Signal("status.program.state", "program", ProgramState),
    Signal("status.e_stopped", "stop"),
    Signal("safety.state", ("stop", "hit"), _safety, partial=True),
    Signal("safety.collision", "hit"),
)


def _time(sec: int) -> tuple[int, int, int, int, int, int, int]:
    return (2023, 11, 14, 22, 13, sec, 0)


CLOCK = WallClock(fields=("sec",), read=_time)


class Answers:
    """Reads the answers; `#<text>` is a command object that somebody gave."""

    ready = True
    notes: Sequence[str] = ()

    def __init__(self) -> None:
        self._lines = Lines()
        self._numbers = Numbers()

    @property
    def gaps(self) -> int | None:
        return self._numbers.gaps

    def feed(self, data: bytes) -> list[Event]:
        return [self._event(line) if isinstance(line, bytes) else line for line in self._lines.feed(data)]

    def end(self) -> list[Reject]:
        return self._lines.end()

    def outgoing(self) -> bytes:
        return b""

    def tick(self) -> bytes | Refused:
        return b""

    def goodbye(self) -> bytes:
        return b"bye\n"

    def _event(self, line: bytes) -> Event:
        if line.startswith(b"#"):
            made = Command(id="c", type="Move", index=0, total=1, object={"to": line[1:-1].decode()})
            return Occurrence(line, (Entry(EventKind.COMMAND_ISSUED, made),))
        name, _, told = line.decode().strip().partition("=")
        if name == "n":
            self._numbers.take(int(told))
            return Reject(line, "number")
        if name not in RECORD.by_name:
            return Reject(line, "unknown", f"{name!r}")
        return Frame(line, RECORD, values={name: RECORD.convert(name, msgspec.json.decode(told))})


class Asking(Answers):
    """Asks in turn."""

    def __init__(self, wishes: Mapping[str, float], budget_hz: float) -> None:
        super().__init__()
        self._rota = Rota(wishes, budget_hz)

    def tick(self) -> bytes | Refused:
        name = self._rota.next()
        return b"" if name is None else f"{name}\n".encode()


WISHES = {"pos": 5.0, "vel": 2.0, "mode": 1.0, "stop": 1.0}
PROTOCOL = Protocol(
    name="text",
    title="asked for each part",
    port=1,
    records=(RECORD,),
    signals=SIGNALS,
    make_reader=Answers,
    make_decoders=lambda _, rate_hz: lambda: Asking(WISHES, rate_hz),
    rate_hz=10.0,
    outgoing=(rb"[a-z]+\n",),
    commands=True,
    slowest_s=lambda _, __: 1.0,
)
VENDOR = Vendor(name="toy", title="Toy", protocols=(PROTOCOL,))


def settings(*, stale_s: float = 2.0) -> RobotSettings:
    """A robot that speaks it."""
    return RobotSettings(
        name="r1", host="127.0.0.2", port=1, vendor=VENDOR, protocol=PROTOCOL, rate_hz=10.0, stale_s=stale_s
    )


def answering(values: Mapping[str, object]) -> Callable[[bytes], list[bytes]]:
    """A controller that answers what it knows."""

    def answer(asked: bytes) -> list[bytes]:
        name = asked.decode().strip()
        return [f"{name}={msgspec.json.encode(values[name]).decode()}\n".encode()] if name in values else []

    return answer


def frame(**values: object) -> Frame:
    """One frame that tells some values."""
    return Frame(b"", RECORD, values=values)
