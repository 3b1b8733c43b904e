"""The controller's own wall clock, read from its frames: for `t_src`, and to estimate how far it is from ours."""

from __future__ import annotations

from datetime import UTC, datetime, tzinfo

from gateway.api.decoder import Frame, Table
from gateway.api.reader import ReadWords
from gateway.api.readers import words_reader
from gateway.api.vendor import WallClock


class ControllerClock:
    """Reads one controller's clock.

    Args:
        wall_clock: Where its frames carry it.
        zone: Its time zone by the robot's configuration; None: not known, unless the protocol states it.
    """

    def __init__(self, wall_clock: WallClock, zone: tzinfo | None) -> None:
        self._fields = wall_clock.fields
        self._read_parts = wall_clock.read
        known = wall_clock.zone or zone
        self._zone = known or UTC
        self.zone_is_known = known is not None
        self._layout: Table | None = None
        self._read: ReadWords | None = None

    def utc_us(self, frame: Frame) -> int | None:
        """The controller's time in µs since 1970, as if it were UTC where its zone is not known; None: it says none."""
        if frame.layout is not self._layout:
            self._layout = frame.layout
            self._read = words_reader(frame.layout, self._fields)
        if self._read is None:
            return None
        try:
            parts = self._read_parts(*self._read(frame))
            told = datetime(*parts, tzinfo=self._zone)
            return int(told.replace(microsecond=0).timestamp()) * 1_000_000 + told.microsecond
        except (ValueError, TypeError, OverflowError):  # no date: a clock that was never set
            return None
