"""What was told lately: kept for its time and in its room, and the states that stood before."""

from __future__ import annotations

from gateway.record.spool import Said
from gateway.record.told import ToldLog


def said(topic: str, seq: int, data: bytes = b"{}") -> Said:
    return Said(topic=topic, t=seq, seq=seq, data=data)


def test_what_is_older_than_asked_for_is_left_out_but_for_the_states_that_stood() -> None:
    log = ToldLog(60)
    for second in range(10):
        log.add(float(second), said("r1/link", second))
        log.add(float(second), said("r1/events", second))
    assert [(one.topic, one.seq) for one in log.since(8.0)] == [
        ("r1/link", 7),
        ("r1/link", 8),
        ("r1/events", 8),
        ("r1/link", 9),
        ("r1/events", 9),
    ]


def test_what_is_too_old_is_dropped_and_its_state_still_stands() -> None:
    log = ToldLog(5)
    log.add(0.0, said("r1/link", 1))
    log.add(0.0, said("r1/events", 1))
    log.add(100.0, said("r2/link", 1))
    assert [one.topic for one in log.since(0.0)] == ["r1/link", "r2/link"]
    log.forget("r1/link")
    assert [one.topic for one in log.since(0.0)] == ["r2/link"]


def test_a_storm_takes_no_more_memory_than_it_may() -> None:
    log = ToldLog(3600, most_bytes=10_000)
    for number in range(1000):
        log.add(0.0, said("r1/events", number, bytes(100)))
    assert log.n_bytes <= 10_000
    assert log.since(0.0)[-1].seq == 999
