"""What one frame costs: found, decoded and normalised, beside `struct.unpack` and beside what a vendor's SDK does."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

import msgspec

from gateway.api.decoder import Frame
from gateway.api.layout import Layout
from gateway.api.model import GROUPS
from gateway.api.vendor import Protocol
from gateway.api.words import Words
from gateway.core.registry import Registry
from gateway.testing.playing import opened, tell
from gateway.testing.speed_checks import least_of
from gateway.testing.subject import Subject
from gateway.testing.vector_checks import the_frame
from gateway.testing.vectors import Vector
from tests.bench import by_ctypes, cells
from tests.bench.measure import times_us
from tests.bench.plan import Plan
from tests.bench.table import Goal, Row, row_of

_OPTIONS = {"estop_polarity": "active_low"}
USUAL = ("joints", "tcp", "status")
_CONVERTED = "ctypes: from_buffer_copy, the same fields and conversions"
_READ = "ctypes: from_buffer_copy and field reads, nothing converted"
_GOALS = {_CONVERTED: Goal(0.7), _READ: Goal(1.3), "struct.unpack": Goal(6)}
_GOAL_PROTOCOLS = {"fairino:legacy", "fairino:cnde", "rainbow:reqdata"}
_READ_ALL = "joints + tcp + status"
_ALL = f"found, {_READ_ALL}"
# The baselines are given the frame: like is compared with like where it is not to be found here either.
_JUDGED = (_ALL, _READ_ALL)
_USUAL = "found, joints + tcp, status has not changed"


@dataclass(frozen=True, slots=True)
class Case:
    """A protocol with the longest frame that its vectors have.

    Args:
        title: Vendor and protocol.
        frame: The frame, with its bytes.
        calls: What is timed, by name.
        baselines: What it is compared with, by name.
    """

    title: str
    frame: Frame
    calls: dict[str, Callable[[], object]]
    baselines: dict[str, Callable[[], object]]


def rows(plan: Plan) -> Iterator[Row]:
    """Every protocol that the registry finds."""
    registry = Registry()
    for name in registry.names():
        for protocol in registry.vendor(name).protocols:
            yield from _rows(plan, case_of(registry, name, protocol))


def _rows(plan: Plan, case: Case) -> Iterator[Row]:
    """The whole beside every baseline, its parts beside the first."""
    times = times_us({**case.baselines, **case.calls}, plan)
    first, *others = case.baselines
    for base in (first, *others):
        named = [name for name in case.calls if base == first or name in {*_JUDGED, _USUAL}]
        for name in named:
            goals = _GOALS if name in _JUDGED and case.title in _GOAL_PROTOCOLS else {}
            goal = goals.get("struct.unpack" if base.startswith("struct.unpack") else base)
            yield row_of(f"{case.title}  {name}", "µs", times[name], f"{case.title}  {base}", times[base], goal=goal)


def case_of(registry: Registry, vendor: str, protocol: Protocol) -> Case:
    """What is timed of a protocol."""
    subject = Subject(registry.vendor(vendor), protocol, registry.folder(vendor))
    vector = max(subject.states, key=lambda one: (not _has_faults(subject, one), len(one.raw)))
    frame = the_frame(subject, vector)
    assert frame is not None
    decoder = cells.live_decoder() if protocol.name == "cnde" else opened(subject, vector)
    given = {**_OPTIONS, **vector.options}
    normaliser = subject.normaliser(given)
    readers = normaliser.readers(frame.layout)
    usual_readers = {group: readers[group] for group in USUAL if group in readers}
    usual = [one.read for one in usual_readers.values()]
    states = [reader for group, reader in readers.items() if GROUPS[group].delivery == "state"]

    def find() -> None:
        tell(decoder, vector.asked)
        decoder.feed(vector.raw)

    def read_usual() -> None:
        for read in usual:
            read(frame)

    def both() -> None:
        find()
        read_usual()

    looks = [one.read if GROUPS[group].delivery == "sample" else one.key for group, one in usual_readers.items()]

    def no_news() -> None:
        find()
        for look in looks:
            look(frame)

    def all_day() -> None:
        find()
        for reader in states:
            reader.key(frame)
        for read in usual[:2]:
            read(frame)

    calls: dict[str, Callable[[], object]] = {
        _ALL: both,
        _READ_ALL: read_usual,
        _USUAL: no_news,
        "found": find,
        **{group: lambda group=group: readers[group].read(frame) for group in USUAL if group in readers},  # type: ignore[misc]
        "the usual frame: found, joints, tcp, no state has changed": all_day,
        "every canonical group": lambda: [one.read(frame) for group, one in readers.items() if group != "vendor"],
        "the vendor group": lambda: readers["vendor"].read(frame),
    }
    return Case(f"{vendor}:{protocol.name}", frame, calls, _baselines(subject, vector, frame, given))


def _has_faults(subject: Subject, vector: Vector) -> bool:
    """Whether a fault stands in the frame: the usual one has none."""
    frame = the_frame(subject, vector)
    if frame is None:
        return True
    reader = subject.normaliser({**_OPTIONS, **vector.options}).readers(frame.layout).get("status")
    return reader is not None and bool(getattr(reader.read(frame)[0], "faults", None))


def _baselines(
    subject: Subject, vector: Vector, frame: Frame, given: Mapping[str, object]
) -> dict[str, Callable[[], object]]:
    """What anybody else would do with the frame."""
    layout = frame.layout
    if not isinstance(layout, Layout):
        name, least = least_of(vector, subject)
        return {f"{name} of {len(vector.raw)} bytes": least}
    rows = [row for row in subject.protocol.signals if row.group in USUAL]
    words = Words(layout, [source for row in rows for source in row.sources])
    unpack, raw, start = words.struct.unpack_from, frame.raw, frame.start
    made = by_ctypes.Made(layout, rows, {**given, **msgspec.structs.asdict(subject.options(given))})
    return {
        f"struct.unpack of the {words.count} words that they follow from": lambda: unpack(raw, start),
        _CONVERTED: lambda: made.converted(raw, start),
        _READ: lambda: made.read(raw, start),
    }
