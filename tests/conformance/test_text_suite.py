"""The suite on text protocols: each planted defect of two invented vendors is found by the right check."""

from __future__ import annotations

import dataclasses
import json
import shutil
from collections.abc import Callable, Mapping
from pathlib import Path
from types import ModuleType
from typing import cast

import msgspec
import pytest

from gateway.api.decoder import Decoder, Event, Frame, Occurrence, Refused, Reject, Skipped, Table
from gateway.api.lines import Lines
from gateway.api.normaliser import Normaliser
from gateway.api.reader import Reader
from gateway.api.record import Record, Value
from gateway.api.vendor import Protocol
from gateway.core.registry import Registry
from gateway.sim.simulator import Simulator, VirtualRobot
from gateway.testing.conformance import CHECKS, Result, perform, subjects
from gateway.testing.subject import Subject

HERE = Path(__file__).parent
BY_NAME = {check.name: check for check in CHECKS}
NOT_POLLED = tuple(check.name for check in CHECKS if "polled" in check.of)
FOR_BYTES = tuple(check.name for check in CHECKS if "bytes" in check.of)


def loaded(tmp_path: Path, name: str) -> Subject:
    """The protocol of an invented vendor, from a folder that the test may change."""
    shutil.copytree(HERE / name, tmp_path / name, ignore=shutil.ignore_patterns("__pycache__"))
    for path in (tmp_path, *tmp_path.rglob("*")):
        path.chmod(0o700)
    return subjects(Registry((tmp_path,)), name)[0]


@pytest.fixture
def lima(tmp_path: Path) -> Subject:
    return loaded(tmp_path, "lima")


@pytest.fixture
def mike(tmp_path: Path) -> Subject:
    return loaded(tmp_path, "mike")


def with_protocol(subject: Subject, **changes: object) -> Subject:
    """A copy whose protocol differs."""
    protocol = dataclasses.replace(subject.protocol, **changes)  # type: ignore[arg-type] # names of its fields
    return dataclasses.replace(subject, protocol=protocol, _normalisers={})


def with_value(subject: Subject, name: str, **changes: object) -> Subject:
    """A copy in whose record one value differs."""
    (record,) = subject.records

    def differing(value: Value) -> Value:
        return dataclasses.replace(value, **changes) if value.name == name else value  # type: ignore[arg-type] # the same

    fields = tuple(map(differing, record.fields))
    return with_record(subject, dataclasses.replace(record, fields=fields))


def with_record(subject: Subject, record: Record) -> Subject:
    """A copy whose record is another one, for its decoders too."""
    make = cast("Callable[[], Decoder]", subject.protocol.make_reader)

    def retold() -> Decoder:
        decoder = make()
        plain_feed = decoder.feed

        def feed(data: bytes) -> list[Event]:
            return [
                msgspec.structs.replace(event, layout=record) if isinstance(event, Frame) else event
                for event in plain_feed(data)
            ]

        decoder.feed = feed  # type: ignore[method-assign] # planted
        return decoder

    return with_protocol(subject, records=(record,), make_reader=retold)


def changed(subject: Subject, name: str, **methods: Callable[..., object]) -> type[Decoder]:
    """A decoder of the plugin with other methods; each gets the plain one as `plain`."""
    plain: type[Decoder] = getattr(_module(subject), name)

    def bound(method: str, new: Callable[..., object]) -> Callable[..., object]:
        return lambda self, *args: new(self, getattr(plain, method, None), *args)

    return type("Changed", (plain,), {method: bound(method, new) for method, new in methods.items()})


def reading(**methods: Callable[..., object]) -> Plant:
    """Plant a reading decoder with other methods."""

    def plant(subject: Subject) -> Subject:
        name = "LinesDecoder" if subject.vendor.name == "lima" else "Answers"
        return with_protocol(subject, make_reader=changed(subject, name, **methods))

    return plant


def asking(**methods: Callable[..., object]) -> Plant:
    """Plant a session with other methods."""

    def plant(subject: Subject) -> Subject:
        decoder = changed(subject, "Asking", **methods)
        return with_protocol(subject, make_decoders=lambda _options, _rate_hz: decoder)

    return plant


def _module(subject: Subject) -> ModuleType:
    import sys  # noqa: PLC0415 - the plugin's module, whatever folder it was loaded from

    return sys.modules[f"vendors.{subject.vendor.name}"]


class Twisted(Normaliser):
    """Readers that are changed on the way."""

    def __init__(self, plain: Normaliser, twist: Callable[[str, Reader], Reader]) -> None:
        super().__init__(plain.signals, plain._options)
        self._twist = twist

    def readers(self, layout: Table) -> dict[str, Reader]:
        """The changed readers."""
        return {group: self._twist(group, reader) for group, reader in super().readers(layout).items()}


def twisted(twist: Callable[[str, Reader], Reader]) -> Plant:
    """Plant other readers."""

    class Other(Subject):
        def normaliser(self, given: Mapping[str, object] = {}) -> Normaliser:
            """The changed normaliser."""
            return Twisted(super().normaliser(given), twist)

    return lambda subject: Other(subject.vendor, subject.protocol, subject.folder, subject.simulator)


def edited(before: str, after: str) -> Plant:
    """Plant an error in vectors.toml."""

    def plant(subject: Subject) -> Subject:
        path = subject.folder / "vectors.toml"
        text = path.read_text()
        assert before in text
        path.write_text(text.replace(before, after))
        return dataclasses.replace(subject)

    return plant


def simulated(answer: Callable[[list[bytes]], list[bytes]]) -> Plant:
    """Plant a virtual controller that says something else."""

    def plant(subject: Subject) -> Subject:
        assert subject.simulator is not None
        simulator = cast("Simulator", subject.simulator())

        def session(robot: VirtualRobot, options: msgspec.Struct) -> object:
            made = simulator.ports[0].session(robot, options)
            received, due = made.received, made.due
            made.received = lambda data, now_s: answer(received(data, now_s))  # type: ignore[method-assign] # planted
            made.due = lambda now_s: answer(due(now_s))  # type: ignore[method-assign] # planted
            return made

        port = dataclasses.replace(simulator.ports[0], session=session)  # type: ignore[arg-type] # a session
        other = dataclasses.replace(simulator, ports=(port,))
        return dataclasses.replace(subject, simulator=lambda: other)

    return plant


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


def takes_neighbour(_self: object, _plain: Plain, told: dict[str, object]) -> dict[str, object]:
    """Read the volts of a length elsewhere in the message."""
    return {"angles": told.get("angles"), "volts": float(len(str(told.get("mode"))))}


def gives_up(self: object, plain: Plain, raw: bytes) -> object:
    """Reject everything behind a wrong line."""
    event = Reject(raw, "broken") if getattr(self, "broken", False) else plain(self, raw)
    self.__dict__["broken"] = isinstance(event, Reject)
    return event


def remembers(self: object, plain: Plain, told: dict[str, object]) -> dict[str, object]:
    """Tell what was told before in place of what is not there; a number as text."""
    held = self.__dict__.setdefault("held", {})
    held.update(cast("dict[str, object]", plain(self, told)))
    return dict(held)


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


def loose(_self: object, _plain: Plain, raw: bytes) -> object:
    """Parse with the standard library, and take lists too."""
    told = json.loads(raw)
    return told[0] if isinstance(told, list) and told else told


def first_object(_self: object, plain: Plain, raw: bytes) -> object:
    """Take the first object of a list."""
    told = msgspec.json.decode(raw)
    return told[0] if isinstance(told, list) and told and isinstance(told[0], dict) else plain(None, raw)


def keeps_pending(self: object, _plain: Plain, data: bytes) -> None:
    """Leave what waits for the answer to the next question."""
    self.__dict__["_word"] = data[:-1].decode()


def tells_strays(self: object, _plain: Plain, raw: bytes) -> object:
    """Take what nobody asked for as the answer to the last question."""
    if self.__dict__["_word"] is None:
        self.__dict__["_word"] = "mode"
    return _plain(self, raw)


def keeps_strays(self: object, plain: Plain, data: bytes) -> object:
    """Keep what nobody asked for until somebody asks."""
    if self.__dict__["_word"] is None:
        self.__dict__["_buffer"] += data
        return []
    return plain(self, data)


def impatient(self: object, _plain: Plain) -> bytes:
    """Ask in every period."""
    self.__dict__["_word"] = self.__dict__["_rota"].next() or "mode"
    return self.__dict__["_word"].encode() + b"\r"


def stubborn(self: object, plain: Plain) -> object:
    """Ask into what waits."""
    self.__dict__["_buffer"], kept = b"", self.__dict__["_buffer"]
    asked = plain(self)
    self.__dict__["_buffer"] = kept
    return asked


def half_pairs(self: object, plain: Plain, raw: bytes) -> object:
    """Read only as many numbers as come, in their order, the last one doubled."""
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


Plant = Callable[[Subject], Subject]

# defect -> the vendor, how it is planted, the check that must find it, and words that its message must have
DEFECTS: Mapping[str, tuple[str, Plant, str, str]] = {
    "a unit that does not exist": (
        "lima",
        lambda s: with_value(s, "volts", unit="furlong"),
        "records_hold",
        "unit 'furlong' is unknown",
    ),
    "a value that means nothing": ("lima", lambda s: with_value(s, "volts", meaning=""), "records_hold", "no meaning"),
    "a type that is none": ("mike", lambda s: with_value(s, "volts", type=3), "records_hold", "types of record answers"),
    "a record without a source": (
        "mike",
        lambda s: with_record(s, dataclasses.replace(s.records[0], source="")),
        "records_hold",
        "name manual, version and section",
    ),
    "a unit of another quantity": (
        "lima",
        lambda s: with_value(s, "angles", unit="V"),
        "signals_compile",
        "record state: unit 'V' converts to 'V', not to 'rad'",
    ),
    "a value that no vector reaches": (
        "mike",
        edited('vendor = { mode = "auto" }', 'vendor = { mode = "null" }'),
        "vectors_cover_everything",
        "no vector expects a value of mode",
    ),
    "occurrences that no topic shows": (
        "lima",
        lambda s: with_protocol(s, commands=False),
        "vectors_cover_everything",
        "Protocol.commands is not set",
    ),
    "another value": ("lima", edited("volts = 24.0, ", "volts = 25.0, "), "vectors_decode", "vendor.volts should be"),
    "another occurrence": (
        "lima",
        edited("object = { speed = 200.0 }", "object = { speed = 200.0, zone = 1 }"),
        "vectors_decode",
        "occurrences[0].data.object.zone should be 1; there is no such key",
    ),
    "a thing too many that has happened": (
        "lima",
        edited("index = 1, total = 2", "index = 1, total = 3"),
        "vectors_decode",
        "occurrences[1].data.total should be 3",
    ),
    "a hello that is not before": (
        "lima",
        edited('before = ["hello"]', "before = []"),
        "vectors_decode",
        "should give one frame of layout state, not Reject(line",
    ),
    "questions that the reader does not take": (
        "mike",
        lambda s: with_protocol(s, make_reader=_module(subject=s).Asking.__mro__[1].__base__),
        "vectors_decode",
        "",
    ),
    "one read taken for whole lines": ("lima", reading(feed=one_read), "cuts_change_nothing", "how bytes arrive"),
    "values of a line before": ("lima", reading(values=remembers), "canonical_groups_fit_the_model", ""),
    "a line that is repaired": ("lima", reading(parse=repairs), "damaged_lines_stay_alone", "from its own place alone"),
    "a value from another's place": (
        "lima",
        reading(values=takes_neighbour),
        "damaged_lines_stay_alone",
        "volts is 3.0 instead of 4.0",
    ),
    "a decoder that gives up": ("lima", reading(line=gives_up), "damaged_lines_stay_alone", "costs good message"),
    "something that has not happened": (
        "lima",
        reading(line=invents),
        "damaged_lines_stay_alone",
        "which did not",
    ),
    "two values of one number": ("mike", reading(answer=half_pairs), "damaged_lines_stay_alone", "one word"),
    "an answer that mixes two": ("mike", reading(asked=keeps_pending), "damaged_lines_stay_alone", "mixes two messages"),
    "a line that is not waited for": ("lima", reading(feed=eager), "cut_lines_tell_nothing", "wait for the end"),
    "a cut line that is closed": ("lima", reading(parse=closes), "cut_lines_tell_nothing", "reject what is not whole"),
    "lines without bounds": ("lima", reading(feed=unlimited), "long_lines_cost_themselves", "wait for the end of their"),
    "bytes that are no UTF-8": ("lima", reading(line=raises_bytes), "junk_lines_tell_nothing", "UnicodeDecodeError"),
    "junk that has happened": ("lima", reading(line=invents), "junk_lines_tell_nothing", "reject what is no message"),
    "values as they came": ("lima", reading(values=unchecked), "json_is_taken_with_care", "through Record.convert"),
    "a value that no table has": ("lima", reading(values=unnamed), "values_have_their_types", "'extra' comes, which"),
    "a value of another type": (
        "lima",
        lambda s: with_value(s, "volts", type=str),
        "values_have_their_types",
        "volts: Expected `str`, got `float`",
    ),
    "NaN that is told": (
        "mike",
        lambda s: with_value(reading(answer=_unlimited_floats)(s), "volts", type=float),
        "numbers_stay_finite",
        "volts is nan: reject it",
    ),
    "an object inside a list": ("lima", reading(parse=first_object), "json_is_taken_with_care", "take one object a line"),
    "recursion without end": (
        "lima",
        reading(line=_no_care, parse=loose),
        "json_is_taken_with_care",
        "RecursionError",
    ),
    "zero where nothing is known": ("lima", twisted(lambda g, r: _zeros(g, r)), "what_is_not_told_is_null", "is 0.0"),
    "a key that stands still": (
        "lima",
        twisted(lambda _, reader: dataclasses.replace(reader, key=lambda _frame: 0)),
        "named_values_move_keys",
        "does not change with",
    ),
    "a key that follows too much": (
        "lima",
        twisted(lambda _, reader: dataclasses.replace(reader, key=lambda frame: str(frame.values))),
        "named_values_move_keys",
        "changes with",
    ),
    "a second question before the answer": (
        "mike",
        asking(tick=impatient),
        "one_request_is_outstanding",
        "a second request leaves",
    ),
    "questions that run ahead": ("mike", asking(tick=impatient), "requests_never_outrun_answers", "wait for each"),
    "a comment taken for the answer": (
        "mike",
        asking(answer=answered_by_comments),
        "skipped_frames_answer_nothing",
        "which carries no state",
    ),
    "an answer that nobody asked for": (
        "mike",
        asking(answer=tells_strays),
        "late_answers_answer_nothing",
        "reject what no question asked for",
    ),
    "a late answer kept for the next question": (
        "mike",
        asking(feed=keeps_strays, tick=stubborn),
        "late_answers_answer_nothing",
        "",
    ),
    "a question that no vector answers": (
        "mike",
        edited('asked = "volts\\r"', 'asked = "volt\\r"'),
        "one_request_is_outstanding",
        "no vector says what b'volts\\r' is answered with",
    ),
    "a word outside the allow-list": (
        "mike",
        lambda s: with_protocol(s, outgoing=(rb"pos\r",)),
        "only_allowed_bytes_are_sent",
        "are not in Protocol.outgoing",
    ),
    "a virtual controller that does not answer": (
        "mike",
        simulated(lambda segments: [one for one in segments if one != b"auto\r"]),
        "simulator_answers",
        "does not answer b'mode\\r'",
    ),
    "a line that no vector knows": (
        "mike",
        edited('skipped = "comment"', 'skipped = "remark"'),
        "vectors_decode",
        "one skipped frame, remark",
    ),
    "a slow decoder": ("lima", reading(feed=slowly), "decoding_is_fast", "times json.loads of the same bytes"),
    "a slow decoder of words": ("mike", reading(feed=slowly), "decoding_is_fast", "times finding the numbers of"),
}


def _unlimited_floats(self: object, plain: Plain, raw: bytes) -> object:
    event = plain(self, raw)
    return event
