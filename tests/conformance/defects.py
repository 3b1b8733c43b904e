"""Decoders with a defect, for the tests of the suite: each function stands in for a method of an invented vendor's.

It gets the decoder, the method that it stands in for, and that method's arguments.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import cast

import msgspec

from gateway.api.decoder import Event, Frame, Occurrence, Reject, Skipped
from gateway.api.lines import Lines
from gateway.api.model import Controller, Quality
from gateway.api.reader import Reader

Plain = Callable[..., object]


def repairs(self: object, plain: Plain, raw: bytes) -> object:
    """Make something of every line."""
    try:
        return plain(self, raw)
    except msgspec.DecodeError:
        return {"type": "state", "seq": 1, "volts": 0.0}


def closes(self: object, plain: Plain, raw: bytes) -> object:
    """Close what was left open."""
    try:
        return plain(self, raw)
    except msgspec.DecodeError:
        return plain(self, raw.strip() + b"}")


def takes_neighbour(self: object, plain: Plain, told: dict[str, object]) -> dict[str, object]:
    """Tell as volts how long another member is."""
    return {**cast("dict[str, object]", plain(self, told)), "volts": float(len(str(told.get("mode"))))}


def gives_up(self: object, plain: Plain, raw: bytes) -> object:
    """Reject everything behind a wrong line."""
    event = Reject(raw, "broken") if getattr(self, "broken", False) else plain(self, raw)
    self.__dict__["broken"] = isinstance(event, Reject)
    return event


def unlimited(self: object, plain: Plain, data: bytes) -> object:
    """Keep a line however long it gets."""
    if "grown" not in self.__dict__:
        self.__dict__["_lines"] = Lines(b"\n", 1 << 30)
        self.__dict__["grown"] = True
    return plain(self, data)


def eager(self: object, plain: Plain, data: bytes) -> object:
    """Take an object for whole before its line has ended."""
    events = cast("list[Event]", plain(self, data))
    lines = cast("Lines", self.__dict__["_lines"])
    if lines._buffer.endswith(b"}"):
        event = cast("Event", self.line(lines._buffer))  # type: ignore[attr-defined] # the plugin's
        lines._buffer, lines._searched = b"", 0
        return [*events, event]
    return events


def one_read(self: object, plain: Plain, data: bytes) -> object:
    """Take one read for whole lines."""
    return [*cast("list[Event]", plain(self, data)), *self.end()]  # type: ignore[attr-defined] # the plugin's


def unchecked(_self: object, _plain: Plain, told: dict[str, object]) -> dict[str, object]:
    """Tell every member as it came."""
    return {name: told[name] for name in ("angles", "volts", "mode", "collision") if name in told}


def unnamed(self: object, plain: Plain, told: dict[str, object]) -> dict[str, object]:
    """Tell a value that no table has."""
    return {**cast("dict[str, object]", plain(self, told)), "extra": 1}


def first_object(_self: object, plain: Plain, raw: bytes) -> object:
    """Take the first object of a list."""
    told = msgspec.json.decode(raw)
    return told[0] if isinstance(told, list) and told and isinstance(told[0], dict) else plain(None, raw)


def keeps_pending(self: object, _plain: Plain, data: bytes) -> None:
    """Leave what waits for the answer to the next question."""
    self.__dict__["_word"] = data[:-1].decode()


def tells_strays(self: object, plain: Plain, raw: bytes) -> object:
    """Take what nobody asked for as the answer to the last question."""
    if self.__dict__["_word"] is None:
        self.__dict__["_word"] = "mode"
    return plain(self, raw)


def keeps_strays(self: object, plain: Plain, data: bytes) -> object:
    """Keep what nobody asked for until somebody asks."""
    if self.__dict__["_word"] is None:
        self.__dict__["_buffer"] += data
        return []
    return plain(self, data)


def tolerant(_self: object, _plain: Plain, events: list[Event]) -> list[Event]:
    """Go on behind an answer that cannot be one."""
    return events


def reads_anything(self: object, plain: Plain, word: str, raw: bytes) -> object:
    """Take any text for a mode."""
    return raw.decode().strip() if word == "mode" else plain(self, word, raw)


def impatient(self: object, _plain: Plain) -> bytes:
    """Ask in every period."""
    self.__dict__["_word"] = self.__dict__["_rota"].next() or "mode"
    return bytes(self.__dict__["_word"], "ascii") + b"\r"


def stubborn(self: object, plain: Plain) -> object:
    """Ask into what waits."""
    self.__dict__["_buffer"], kept = b"", self.__dict__["_buffer"]
    asked = plain(self)
    self.__dict__["_buffer"] = kept
    return asked


def told_twice(self: object, plain: Plain, raw: bytes) -> object:
    """Tell one number under two names."""
    event = plain(self, raw)
    if isinstance(event, Frame) and "pos" in event.values:
        numbers = cast("list[float]", event.values["pos"])
        return msgspec.structs.replace(event, values={"pos": numbers, "volts": numbers[0]})
    return event


def answered_by_comments(self: object, plain: Plain, raw: bytes) -> object:
    """Take a comment for the answer."""
    event = plain(self, raw)
    if isinstance(event, Skipped):
        self.__dict__["_word"] = None
    return event


def slowly(self: object, plain: Plain, data: bytes) -> object:
    """Take a long time."""
    sum(range(20_000))
    return plain(self, data)


def raises_bytes(self: object, plain: Plain, raw: bytes) -> object:
    """Decode without care."""
    raw.decode()
    return plain(self, raw)


def invents(self: object, plain: Plain, raw: bytes) -> object:
    """Say that something has happened where nothing has."""
    event = plain(self, raw)
    return Occurrence(raw, ()) if isinstance(event, Reject) else event


def unconverted(self: object, plain: Plain, raw: bytes) -> object:
    """Tell numbers as they are parsed."""
    word, event = self.__dict__["_word"], plain(self, raw)
    if word != "volts":
        return event
    table = type(self).__mro__[1].answer.__globals__["ANSWERS"]  # type: ignore[attr-defined] # the plugin's
    return Frame(raw, table, values={"volts": float(raw)})


def careless(self: object, _plain: Plain, raw: bytes) -> object:
    """Parse with the standard library, to any depth."""
    try:
        told = json.loads(raw)
        if not isinstance(told, dict):
            raise ValueError("no object")  # noqa: TRY004, TRY301 - like the plain one
        return self.message(raw, told)  # type: ignore[attr-defined] # the plugin's
    except ValueError:
        return Reject(raw, "line")


def zeros(group: str, reader: Reader) -> Reader:
    """Read 0 where nothing is known."""
    if group != "controller":
        return reader

    def read(frame: Frame) -> tuple[object, Quality]:
        return Controller(tool_voltage=cast("float", frame.values.get("volts") or 0.0)), Quality.GOOD

    return Reader(read, reader.key, reader.empty)
