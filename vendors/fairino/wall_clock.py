"""The controller's own clock, `robotTime`: date and time of day to the millisecond, in a zone that it does not tell."""

from __future__ import annotations

from gateway.api.vendor import WallClock

_PARTS = ("year", "mouth", "day", "hour", "minute", "second", "millisecond")  # the vendor's spelling of month


def _read(*parts: int) -> tuple[int, int, int, int, int, int, int]:
    year, month, day, hour, minute, second, millisecond = (int(part) for part in parts)
    return year, month, day, hour, minute, second, millisecond * 1000


WALL_CLOCK = WallClock(fields=tuple(f"robotTime_{part}" for part in _PARTS), read=_read)
