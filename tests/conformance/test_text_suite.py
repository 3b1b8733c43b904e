"""The suite on text protocols: each planted defect of two invented vendors is found by the right check."""

from __future__ import annotations

import dataclasses
import shutil
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import cast

import msgspec
import pytest

from gateway.api.decoder import Decoder, Event, Frame, Table
from gateway.api.model import Quality
from gateway.api.normaliser import Normaliser
from gateway.api.reader import Reader
from gateway.api.record import Record, Value
from gateway.api.signals import Signal
from gateway.api.vendor import DecoderFactory
from gateway.core.registry import Registry
from gateway.sim.simulator import Simulator, VirtualRobot
from gateway.testing.conformance import CHECKS, Result, perform, subjects
from gateway.testing.subject import Subject
from gateway.testing.told import members_at
from tests.conformance import defects

HERE = Path(__file__).parent
Plant = Callable[[Subject], Subject]
BY_NAME = {check.name: check for check in CHECKS}
FOR_POLLED = tuple(check.name for check in CHECKS if "polled" in check.of)
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


def with_signal(subject: Subject, at: str, /, **changes: object) -> Subject:
    """A copy in which one signal row differs."""

    def differing(row: Signal) -> Signal:
        return dataclasses.replace(row, **changes) if row.key == at else row  # type: ignore[arg-type] # the same

    return with_protocol(subject, signals=tuple(map(differing, subject.protocol.signals)))


def changed(plain: DecoderFactory, methods: Mapping[str, Callable[..., object] | None]) -> DecoderFactory:
    """A decoder of the plugin in which other methods stand in for some; None: it has no such method."""
    assert isinstance(plain, type)

    def standing_in(name: str, new: Callable[..., object]) -> Callable[..., object]:
        return lambda self, *args: new(self, getattr(plain, name), *args)

    return type("Changed", (plain,), {name: new and standing_in(name, new) for name, new in methods.items()})


def reading(**methods: Callable[..., object] | None) -> Plant:
    """Plant a reading decoder with other methods."""

    def plant(subject: Subject) -> Subject:
        assert subject.protocol.make_reader is not None
        return with_protocol(subject, make_reader=changed(subject.protocol.make_reader, methods))

    return plant


def asking(**methods: Callable[..., object] | None) -> Plant:
    """Plant a session with other methods."""

    def plant(subject: Subject) -> Subject:
        decoder = changed(subject.protocol.decoders(subject.options()), methods)
        return with_protocol(subject, make_decoders=lambda _options, _rate_hz: decoder)

    return plant


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


# defect -> the vendor, how it is planted, the check that must find it, and words that its message must have
DEFECTS: Mapping[str, tuple[str, Plant, str, str]] = {
    "a unit that does not exist": (
        "lima",
        lambda s: with_value(s, "volts", unit="furlong"),
        "records_hold",
        "unit 'furlong' is unknown",
    ),
    "a value that means nothing": ("lima", lambda s: with_value(s, "volts", meaning=""), "records_hold", "no meaning"),
    "a type that is none": (
        "mike",
        lambda s: with_value(s, "volts", type=3),
        "records_hold",
        "types of record answers",
    ),
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
        reading(asked=None),
        "vectors_decode",
        "takes no questions: give it a method `asked(data)`",
    ),
    "one read taken for whole lines": (
        "lima",
        reading(feed=defects.one_read),
        "cuts_change_nothing",
        "how bytes arrive",
    ),
    "a line that is repaired": (
        "lima",
        reading(parse=defects.repairs),
        "damaged_lines_stay_alone",
        "from its own place alone",
    ),
    "a value from another's place": (
        "lima",
        reading(values=defects.takes_neighbour),
        "damaged_lines_stay_alone",
        "volts is 3.0 instead of 4.0",
    ),
    "a decoder that gives up": (
        "lima",
        reading(line=defects.gives_up),
        "damaged_lines_stay_alone",
        "costs good message",
    ),
    "something that has not happened": (
        "lima",
        reading(line=defects.invents),
        "damaged_lines_stay_alone",
        "which did not",
    ),
    "two values of one number": ("mike", reading(answer=defects.told_twice), "damaged_lines_stay_alone", "one word"),
    "an answer that mixes two": (
        "mike",
        reading(asked=defects.keeps_pending),
        "damaged_lines_stay_alone",
        "mixes two messages",
    ),
    "a line that is not waited for": (
        "lima",
        reading(feed=defects.eager),
        "cut_lines_tell_nothing",
        "wait for the end",
    ),
    "a cut line that is closed": (
        "lima",
        reading(parse=defects.closes),
        "cut_lines_tell_nothing",
        "reject what is not whole",
    ),
    "lines without bounds": (
        "lima",
        reading(feed=defects.unlimited),
        "long_lines_cost_themselves",
        "wait for the end of their",
    ),
    "bytes that are no UTF-8": (
        "lima",
        reading(line=defects.raises_bytes),
        "junk_lines_tell_nothing",
        "UnicodeDecodeError",
    ),
    "junk that has happened": (
        "lima",
        reading(line=defects.invents),
        "junk_lines_tell_nothing",
        "reject what is no message",
    ),
    "values as they came": (
        "lima",
        reading(values=defects.unchecked),
        "json_is_taken_with_care",
        "through Record.convert",
    ),
    "a value that no table has": (
        "lima",
        reading(values=defects.unnamed),
        "values_have_their_types",
        "'extra' comes, which",
    ),
    "a value of another type": (
        "lima",
        lambda s: with_value(s, "volts", type=str),
        "values_have_their_types",
        "volts: Expected `str`, got `float`",
    ),
    "NaN that is told": (
        "mike",
        lambda s: with_value(reading(answer=defects.unconverted)(s), "volts", type=float),
        "numbers_stay_finite",
        "volts is nan: reject it",
    ),
    "an object inside a list": (
        "lima",
        reading(parse=defects.first_object),
        "json_is_taken_with_care",
        "take one object a line",
    ),
    "recursion without end": (
        "lima",
        reading(line=defects.careless),
        "json_is_taken_with_care",
        "RecursionError",
    ),
    "zero where nothing is known": ("lima", twisted(defects.zeros), "what_is_not_told_is_null", "is 0.0"),
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
        asking(tick=defects.impatient),
        "one_request_is_outstanding",
        "a second request leaves",
    ),
    "questions that run ahead": (
        "mike",
        asking(tick=defects.impatient),
        "requests_never_outrun_answers",
        "wait for each",
    ),
    "a comment taken for the answer": (
        "mike",
        asking(answer=defects.answered_by_comments),
        "skipped_frames_answer_nothing",
        "which carries no state",
    ),
    "an answer that nobody asked for": (
        "mike",
        asking(answer=defects.tells_strays),
        "late_answers_answer_nothing",
        "reject what no question asked for",
    ),
    "a late answer kept for the next question": (
        "mike",
        asking(feed=defects.keeps_strays, tick=defects.stubborn),
        "late_answers_answer_nothing",
        "as a part of the next answer",
    ),
    "an answer too many that is taken for another one": (
        "mike",
        asking(read=defects.reads_anything),
        "an_answer_too_many_is_noticed",
        "reject what cannot be the answer to the question",
    ),
    "an answer too many that is lived with": (
        "mike",
        asking(refusing=defects.tolerant),
        "an_answer_too_many_is_noticed",
        "is never noticed: refuse the session",
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
    "a skipped line of another name": (
        "mike",
        edited('skipped = "comment"', 'skipped = "remark"'),
        "vectors_decode",
        "one skipped frame, remark",
    ),
    "a skipped line that no vector knows": (
        "lima",
        edited('skipped = "empty"', 'skipped = "blank"'),
        "simulator_answers",
        "skipped as 'empty': add a vector of it",
    ),
    "a vendor group that is not whole": (
        "lima",
        twisted(lambda _, reader: dataclasses.replace(reader, read=lambda _frame: ({}, Quality.GOOD))),
        "vendor_group_is_whole",
        "vendor.angles",
    ),
    "an enumeration with a word of its own": (
        "mike",
        lambda s: with_signal(s, "status.operating_mode", via=lambda _: "DANCING"),
        "canonical_groups_fit_the_model",
        "Invalid enum value 'DANCING'",
    ),
    "a slow decoder": ("lima", reading(feed=defects.slowly), "decoding_is_fast", "times json.loads of the same bytes"),
    "a slow decoder of words": (
        "mike",
        reading(feed=defects.slowly),
        "decoding_is_fast",
        "times finding the numbers of",
    ),
}


@pytest.fixture
def vendors(tmp_path: Path) -> Callable[[str], Subject]:
    return lambda name: loaded(tmp_path, name)


@pytest.mark.limit(60)
@pytest.mark.parametrize("defect", DEFECTS)
async def test_a_planted_defect_is_found(vendors: Callable[[str], Subject], defect: str) -> None:
    name, plant, check, words = DEFECTS[defect]
    outcome = await perform(BY_NAME[check], plant(vendors(name)))
    assert outcome.result == "failed"
    assert words in outcome.message
    assert len(outcome.message) < 1500


@pytest.mark.parametrize("check", BY_NAME)
async def test_an_invented_vendor_that_pushes_lines_passes(lima: Subject, check: str) -> None:
    outcome = await perform(BY_NAME[check], lima)
    wanted: Result = "does not apply" if check in {*FOR_BYTES, *FOR_POLLED} else "passed"
    assert outcome.result == wanted, outcome.message


@pytest.mark.parametrize("check", BY_NAME)
async def test_an_invented_vendor_that_answers_words_passes(mike: Subject, check: str) -> None:
    outcome = await perform(BY_NAME[check], mike)
    wanted: Result = "does not apply" if check in {*FOR_BYTES, "json_is_taken_with_care"} else "passed"
    assert outcome.result == wanted, outcome.message


def test_every_check_of_text_has_a_defect_that_it_finds() -> None:
    found = {check for _, _, check, _ in DEFECTS.values()}
    assert {check.name for check in CHECKS if "text" in check.of} <= found


@pytest.mark.parametrize(
    ("before", "after", "words"),
    [
        ('asked = "pos\\r"', 'asked = ""', "`asked` is empty: leave it out where nothing was asked"),
        ('asked = "pos\\r"', 'before = ["nobody"]', "it names 'nobody' in `before`, which does not stand before it"),
        ('text = "24.0\\r"', 'text = "24.0\\r"\nhex = "00"', "it needs one of `hex`, `text` and `base`"),
        ('text = "24.0\\r"', "", "it needs one of `hex`, `text` and `base`"),
        ('skipped = "comment"', "", "it needs one of `layout`, `skipped` and `occurrences`"),
    ],
)
async def test_a_vector_that_cannot_be_is_named_with_what_is_wrong(
    mike: Subject, before: str, after: str, words: str
) -> None:
    outcome = await perform(BY_NAME["vectors_decode"], edited(before, after)(mike))
    assert outcome.result == "failed"
    assert words in outcome.message


async def test_a_base_hands_on_what_was_asked(mike: Subject) -> None:
    (still,) = (vector for vector in mike.vectors if vector.name == "still")
    assert (still.asked, still.raw) == (b"moving\r", b"false")


@pytest.mark.parametrize(
    ("raw", "at", "names"),
    [
        (b'{"a":{"b":[1,{"c":"d"}]},"e":2}', 0, set()),
        (b'{"a":{"b":[1,{"c":"d"}]},"e":2}', 2, {"a"}),
        (b'{"a":{"b":[1,{"c":"d"}]},"e":2}', 18, {"a", "b", "c"}),
        (b'{"a":{"b":[1,{"c":"d"}]},"e":2}', 11, {"a", "b"}),
        (b'{"a":{"b":[1,{"c":"d"}]},"e":2}', 29, {"e"}),
        (b'}]"{{"a":"\xff', 9, set()),
    ],
)
def test_the_members_around_a_byte_are_found(raw: bytes, at: int, names: set[str]) -> None:
    assert members_at(raw, at) == names
