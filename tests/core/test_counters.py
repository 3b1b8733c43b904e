"""What a link counts."""

from __future__ import annotations

import pytest

from gateway.api.decoder import Entry, Event, Occurrence, Reject, Skipped
from gateway.api.model import EventKind
from gateway.core.counters import LinkCounters
from tests.core.toy_text import frame


def take(counters: LinkCounters, at_s: float, *events: Event) -> None:
    counters.take(1, events, at_s, 0.0)


def test_each_part_has_a_rate_of_its_own() -> None:
    counters = LinkCounters(parts=True)
    counters.begin()
    for turn in range(100):
        take(counters, turn / 10, frame(often=1))
        if turn % 20 == 0:
            take(counters, turn / 10, frame(rare=1, both=None))
    counters.second(10.0, 0)
    assert counters.parts_hz == {"often": 10.0, "rare": 0.5, "both": 0.5}


def test_a_part_that_came_once_has_no_rate_yet() -> None:
    counters = LinkCounters(parts=True)
    take(counters, 1.0, frame(a=1))
    take(counters, 1.0, frame(b=1), frame(b=2))  # in one read
    counters.second(2.0, 0)
    assert counters.parts_hz == {}


def test_a_rate_is_said_anew_only_where_it_has_really_changed() -> None:
    counters = LinkCounters(parts=True)
    for turn in range(8):
        take(counters, turn * 1.0, frame(a=1))
    counters.second(8.0, 0)
    said = counters.parts_hz
    for turn in range(8):
        take(counters, 8 + turn * 1.1, frame(a=1))
    counters.second(17.0, 0)
    assert counters.parts_hz is said
    for turn in range(8):
        take(counters, 17 + turn * 0.5, frame(a=1))
    counters.second(21.0, 0)
    assert counters.parts_hz == {"a": 2.0}


def test_a_new_session_forgets_when_parts_came() -> None:
    counters = LinkCounters(parts=True)
    for turn in range(8):
        take(counters, turn * 1.0, frame(a=1))
    counters.begin()
    take(counters, 1000.0, frame(a=1))
    counters.second(1001.0, 0)
    assert counters.parts_hz == {}


def test_where_every_answer_tells_everything_no_parts_are_counted() -> None:
    counters = LinkCounters()
    for turn in range(8):
        take(counters, turn * 1.0, frame(a=1))
    counters.second(8.0, 0)
    assert counters.parts_hz == {}


def test_an_occurrence_is_no_frame_and_makes_nothing_fresh() -> None:
    counters = LinkCounters()
    take(counters, 1.0, Occurrence(b"#", (Entry(EventKind.COMMAND_ISSUED, None),)), Skipped(b"", "x"), Reject(b"", "r"))
    stats = counters.second(2.0, 0)
    assert (stats.frames, stats.skipped, stats.rejects, stats.age) == (0, 2, {"r": 1}, None)


@pytest.mark.parametrize(
    ("ended", "running", "total"),
    [
        ([], None, None),
        ([None], None, None),
        ([None], 0, 0),
        ([2], None, 2),
        ([2, None, 3], 1, 6),
        ([0], None, 0),
    ],
)
def test_gaps_are_summed_over_the_sessions(ended: list[int | None], running: int | None, total: int | None) -> None:
    counters = LinkCounters()
    for gaps in ended:
        counters.begin()
        counters.end(gaps)
    counters.begin()
    assert counters.second(0.0, 0, gaps=running).gaps == total
    assert counters.second(1.0, 0, gaps=running).gaps == total


def test_what_the_transport_refuses_stands_beside_the_rejects() -> None:
    counters = LinkCounters()
    take(counters, 1.0, Reject(b"x", "junk"))
    assert counters.second(2.0, 0, refused={"foreign_peer": 3}).rejects == {"junk": 1, "foreign_peer": 3}
    assert counters.second(3.0, 0, refused={"foreign_peer": 4}).rejects == {"junk": 1, "foreign_peer": 4}
