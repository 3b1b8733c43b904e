from __future__ import annotations

from itertools import islice

from gateway.core.backoff import FIRST_S, JITTER, LONGEST_S, backoff, no_waiting


def test_delays_grow_from_a_fifth_of_a_second_to_five_seconds() -> None:
    delays = list(islice(backoff(), 20))
    assert FIRST_S * (1 - JITTER) <= delays[0] <= FIRST_S * (1 + JITTER)
    assert all(LONGEST_S * (1 - JITTER) <= delay <= LONGEST_S * (1 + JITTER) for delay in delays[-10:])


def test_two_series_differ_so_that_robots_do_not_come_back_in_step() -> None:
    assert list(islice(backoff(), 5)) != list(islice(backoff(), 5))


def test_tests_may_take_the_waiting_out() -> None:
    assert list(islice(no_waiting(), 3)) == [0.0, 0.0, 0.0]
