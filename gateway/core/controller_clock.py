"""The controller's own wall clock, read from its frames: for `t_src`, and to estimate how far it is from ours."""

from __future__ import annotations

from collections.abc import Callable
from datetime import UTC, datetime, tzinfo

from gateway.api.compiler import compile_words
from gateway.api.decoder import Frame
from gateway.api.layout import Layout
from gateway.api.vendor import WallClock

_Read = Callable[[bytes, int], tuple[int | float, ...]]


class ControllerClock:
    """Reads one controller's clock.

    Args:
        wall_clock: Where its frames carry it.
        zone: Its time zone; None: not known.
    """

    def __init__(self, wall_clock: WallClock, zone: tzinfo | None) -> None:
        self._fields = wall_clock.fields
        self._read_parts = wall_clock.read
        self._zone = zone or UTC
        self.zone_is_known = zone is not None
        self._layout: Layout | None = None
        self._read: _Read | None = None

    def utc_us(self, frame: Frame) -> int | None:
        """The controller's time in µs since 1970, as if it were UTC where its zone is not known; None: it says none."""
        if frame.layout is not self._layout:
            self._layout = frame.layout
            self._read = compile_words(frame.layout, self._fields)
        if self._read is None:
            return None
        try:
            parts = self._read_parts(*self._read(frame.raw, frame.start))
            told = datetime(*parts, tzinfo=self._zone)
            return int(told.replace(microsecond=0).timestamp()) * 1_000_000 + told.microsecond
        except (ValueError, TypeError, OverflowError):  # no date: a clock that was never set
            return None
