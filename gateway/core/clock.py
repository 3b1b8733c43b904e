"""Clocks: the machine's two, behind one small interface, and the time line that stamps the samples of one epoch."""

from __future__ import annotations

import math
import time
from typing import Protocol

# A wall clock that is set by more than this has jumped: backwards it is not waited for, a new epoch begins instead.
STEP_US = 500_000


class Clock(Protocol):
    """What the core knows of time; tests give their own."""

    def monotonic(self) -> float:
        """Seconds, never set, never backwards."""
        ...

    def utc_us(self) -> int:
        """µs since 1970 UTC, as the machine believes now; may be set forward and back."""
        ...


class SystemClock:
    """The machine's clocks."""

    def monotonic(self) -> float:
        """Seconds of the same clock that the event loop uses."""
        return time.monotonic()

    def utc_us(self) -> int:
        """µs since 1970 UTC."""
        return time.time_ns() // 1000


def deadline_s(at_s: float) -> float:
    """The deadline of a scope that ends at a monotonic time: the next whole millisecond.

    uvloop's timers have no finer steps: a deadline between two of them makes anyio set it again and again until it is
    there, which costs up to a millisecond of CPU for each wait.
    """
    if at_s == math.inf:
        return at_s
    whole_s = math.ceil(at_s * 1000) / 1000
    return whole_s if whole_s >= at_s else whole_s + 0.001  # a product rounded down must not end the wait too early


class Stamps(Protocol):
    """What gives samples their times, µs since 1970 UTC."""

    def stamp(self, monotonic_s: float) -> int:
        """The time of a monotonic time in s."""
        ...


class Timeline:
    """Maps monotonic receive times to UTC; never backwards inside an epoch.

    Args:
        clock: Where both times come from.
    """

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._offset_us = self._measured_offset_us()
        self._last_us = 0
        self._now_us = 0

    def stamp(self, monotonic_s: float) -> int:
        """The UTC time, µs since 1970, of a monotonic time in s."""
        self._last_us = max(self._last_us, int(monotonic_s * 1e6) + self._offset_us)
        return self._last_us

    def now(self) -> int:
        """The UTC time, µs since 1970, of now; a frame received before and stamped after keeps its own."""
        self._now_us = max(self._now_us, self._last_us, int(self._clock.monotonic() * 1e6) + self._offset_us)
        return self._now_us

    def follow(self) -> int:
        """Follow the wall clock, which may have been set.

        Returns:
            By how many µs it has jumped, 0 for none: after a jump back (negative) a new epoch must begin.
        """
        measured = self._measured_offset_us()
        jump_us = measured - self._offset_us
        self._offset_us = measured
        if jump_us < -STEP_US:
            self._last_us = self._now_us = 0
        return jump_us if abs(jump_us) > STEP_US else 0

    def _measured_offset_us(self) -> int:
        return self._clock.utc_us() - int(self._clock.monotonic() * 1e6)
