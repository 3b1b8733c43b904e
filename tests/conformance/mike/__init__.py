"""An invented vendor: a word is asked, a text answers it, and nothing in the text says what was asked.

gateway    -> controller   word CR
controller -> gateway      true | false        to `moving`, without any end
                           text CR             to every other word
                           # text CR           a comment, at any time before an answer
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Annotated

import msgspec
from msgspec import Meta

from gateway.api.asking import Rota
from gateway.api.decoder import Event, Frame, Refused, Reject, Skipped
from gateway.api.model import OperatingMode
from gateway.api.record import Record, Value
from gateway.api.signals import Signal
from gateway.api.vendor import DecoderFactory, Protocol, Vendor

END = b"\r"
LONGEST = 400
_FLAGS = {b"true": True, b"false": False}
_PATIENCE = 20
Finite = Annotated[float, Meta(ge=-1e6, le=1e6)]
ANSWERS = Record(
    name="answers",
    source="An invented manual, version 1, section 1",
    fields=(
        Value(
            name="pos",
            type=Annotated[list[Finite], Meta(min_length=3, max_length=3)],
            unit="deg",
            meaning="Angle of each joint",
        ),
        Value(name="volts", type=Finite, unit="V", meaning="Supply voltage of the tool"),
        Value(name="mode", type=str, meaning="auto or manual"),
        Value(name="moving", type=bool, meaning="The arm moves"),
    ),
)
MODES = ("auto", "manual")
WORDS = tuple(ANSWERS.by_name)
READERS: dict[str, Callable[[str], object]] = {
    "pos": lambda text: [float(word) for word in text.split(",")],
    "volts": float,
    "mode": str,
}


class Answers:
    """Reads answers to what it is told was asked."""

    ready = True
    notes: Sequence[str] = ()
    gaps: int | None = None

    def __init__(self) -> None:
        self._buffer = b""
        self._left: list[Event] = []
        self._word: str | None = None

    @property
    def pending(self) -> int:
        """How many bytes wait."""
        return len(self._buffer)

    def asked(self, data: bytes) -> None:
        """Take the question; what still waits belongs to the one before."""
        self._left += self.end()
        self._word = data.removesuffix(END).decode()

    def feed(self, data: bytes) -> list[Event]:
        """Take received bytes."""
        events, self._left = self._left, []
        self._buffer += data
        while self._buffer and (length := self.length()):
            raw, self._buffer = self._buffer[:length], self._buffer[length:]
            events.append(self.answer(raw))
        if len(self._buffer) > LONGEST:
            events += [*self.end(), Refused("an answer without end", "out_of_step")]
        return events

    def end(self) -> list[Reject]:
        """Return what is left."""
        left, self._buffer = self._buffer, b""
        return [Reject(left, "truncated")] if left else []

    def outgoing(self) -> bytes:
        """Nothing is owed."""
        return b""

    def tick(self) -> bytes | Refused:
        """Nothing is asked."""
        return b""

    def goodbye(self) -> bytes:
        """Nothing is owed."""
        return b""

    def length(self) -> int:
        """Bytes of the first answer; 0 while it is not whole."""
        flags = _FLAGS if self._word == "moving" else {}
        for flag in flags:
            if self._buffer.startswith(flag):
                return len(flag)
        return self._buffer.find(END) + 1

    def answer(self, raw: bytes) -> Event:
        """Read one answer."""
        if raw.startswith(b"#"):
            return Skipped(raw, "comment")
        word, self._word = self._word, None
        if word is None:
            return Reject(raw, "unrequested")
        try:
            return Frame(raw, ANSWERS, values={word: ANSWERS.convert(word, self.read(word, raw))})
        except (KeyError, ValueError) as error:
            return Reject(raw, "answer", str(error))

    def read(self, word: str, raw: bytes) -> object:
        """The value of an answer."""
        return _FLAGS[raw] if word == "moving" else READERS[word](raw.removesuffix(END).decode())


class Asking(Answers):
    """One session: asks the words in turn; what cannot be the answer to a word ends it."""

    def __init__(self) -> None:
        super().__init__()
        self._rota = Rota(dict.fromkeys(WORDS, 10.0), 30.0)
        self._waited = 0

    def feed(self, data: bytes) -> list[Event]:
        """Take received bytes; what nobody asked for ends the session."""
        events = super().feed(data)
        return self.refusing(events) if any(isinstance(event, Reject) for event in events) else events

    def read(self, word: str, raw: bytes) -> object:
        """The value of an answer; no other word's answer is a mode."""
        value = super().read(word, raw)
        if word == "mode" and value not in MODES:
            raise ValueError(f"{value!r} is no mode")
        return value

    def refusing(self, events: list[Event]) -> list[Event]:
        """What is told where something was rejected."""
        return [*events, Refused("nobody asked for that", "out_of_step")]

    def tick(self) -> bytes | Refused:
        """The next word."""
        if self._word is not None or self._buffer:
            self._waited += 1
            return Refused("no answer", "out_of_step") if self._waited > _PATIENCE else b""
        self._waited = 0
        self._word = self._rota.next()
        return self._word.encode() + END if self._word else b""


def make_decoders(_options: msgspec.Struct, _rate_hz: float) -> DecoderFactory:
    """Make what makes the sessions."""
    return Asking


def mode(told: str) -> OperatingMode:
    """The operating mode of its word."""
    return OperatingMode.AUTOMATIC if told == "auto" else OperatingMode.OTHER


VENDOR = Vendor(
    name="mike",
    title="Mike Robots",
    protocols=(
        Protocol(
            name="words",
            title="One word, one answer",
            port=None,
            records=(ANSWERS,),
            signals=(
                Signal("joints.position", "pos"),
                Signal("controller.tool_voltage", "volts"),
                Signal("status.operating_mode", "mode", via=mode),
                Signal("status.in_motion", "moving"),
            ),
            make_reader=Answers,
            make_decoders=make_decoders,
            rate_hz=50.0,
            max_rate_hz=100.0,
            outgoing=(rb"(pos|volts|mode|moving)\r",),
            cost=60.0,
        ),
    ),
)
