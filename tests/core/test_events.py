from __future__ import annotations

import pytest

from gateway.api.model import Event, EventKind
from gateway.core.events import EventRing, parse_name


def filled(count: int, capacity: int = 10) -> EventRing:
    ring = EventRing(capacity, boot="b")
    for number in range(count):
        ring.append(f"r{number % 2}", number, EventKind.MODE_CHANGED, None, number, {})
    return ring


def seqs(events: list[Event]) -> list[int]:
    return [event.seq for event in events]


def test_events_are_named_by_boot_and_count_from_one() -> None:
    assert filled(2).last_name == "b:2"
    assert EventRing(boot="b").last_name == "b:0"


def test_reading_on_gives_what_came_after() -> None:
    events, missed = filled(5).since("b:3", 100)
    assert (seqs(events), missed) == ([4, 5], 0)


def test_reading_without_a_name_starts_at_the_oldest() -> None:
    events, missed = filled(12).since(None, 100)
    assert (seqs(events), missed) == (list(range(3, 13)), 0)


def test_a_hole_in_the_ring_is_counted() -> None:
    events, missed = filled(15).since("b:2", 100)
    assert (seqs(events), missed) == (list(range(6, 16)), 3)


def test_the_name_of_another_boot_gives_everything_and_an_unknown_loss() -> None:
    events, missed = filled(3).since("a:2", 100)
    assert (seqs(events), missed) == ([1, 2, 3], None)


def test_the_limit_takes_the_oldest_first_and_filters_before_it_counts() -> None:
    events, _ = filled(8).since(None, 2, lambda event: event.robot == "r1")
    assert seqs(events) == [2, 4]


def test_a_name_that_lies_ahead_gives_nothing() -> None:
    assert filled(3).since("b:99", 100) == ([], 0)


@pytest.mark.parametrize("name", ["", "7", ":7", "b:", "b:x", "b:-1", "b:٣"])
def test_what_is_no_name_is_refused(name: str) -> None:
    with pytest.raises(ValueError, match="boot:seq"):
        parse_name(name)


@pytest.mark.parametrize("seq", [4, 2**63, 10**40])
def test_a_name_that_no_event_has_yet_reads_nothing(seq: int) -> None:
    ring = filled(3)
    assert ring.since(f"{ring.boot}:{seq}", 10) == ([], 0)
