from __future__ import annotations

import math
import random

from gateway.core.clock import SystemClock, Timeline, deadline_s


class SetClock:
    """Both clocks by hand."""

    def __init__(self) -> None:
        self.monotonic_s = 100.0
        self.wall_us = 1_700_000_000_000_000

    def monotonic(self) -> float:
        return self.monotonic_s

    def utc_us(self) -> int:
        return self.wall_us

    def pass_s(self, seconds: float) -> None:
        self.monotonic_s += seconds
        self.wall_us += int(seconds * 1e6)


def test_stamps_are_the_wall_time_of_the_monotonic_moment() -> None:
    clock = SetClock()
    line = Timeline(clock)
    assert line.stamp(100.25) == 1_700_000_000_250_000


def test_stamps_never_go_back_when_the_clock_is_set_back_a_little() -> None:
    clock = SetClock()
    line = Timeline(clock)
    first = line.now()
    clock.wall_us -= 200_000
    assert line.follow() == 0
    assert line.now() == first
    clock.pass_s(1.0)
    assert line.now() == first + 800_000


def test_a_clock_set_forward_by_hours_is_followed() -> None:
    clock = SetClock()
    line = Timeline(clock)
    clock.wall_us += 7_200_000_000
    assert line.follow() == 7_200_000_000
    assert line.now() == clock.wall_us


def test_a_clock_set_back_by_hours_asks_for_a_new_epoch_and_is_followed() -> None:
    clock = SetClock()
    line = Timeline(clock)
    line.now()
    clock.wall_us -= 7_200_000_000
    assert line.follow() == -7_200_000_000
    assert line.now() == clock.wall_us


def test_the_system_clock_counts_microseconds_since_1970() -> None:
    assert SystemClock().utc_us() > 1_700_000_000_000_000


def test_a_deadline_is_the_next_whole_millisecond_and_never_before_its_time() -> None:
    numbers = random.Random(1)  # noqa: S311 - test data
    for _ in range(20_000):
        at_s = numbers.uniform(0, 1e6)
        for near_s in (at_s, math.nextafter(round(at_s, 3), math.inf), round(at_s, 3)):
            whole_s = deadline_s(near_s)
            assert near_s <= whole_s <= near_s + 0.0021
            assert abs(whole_s * 1000 - round(whole_s * 1000)) < 1e-5
    assert deadline_s(math.inf) == math.inf
