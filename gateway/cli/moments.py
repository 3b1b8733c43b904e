"""Moments of a recording, as people write them: seconds from its beginning or its end, or a time."""

from __future__ import annotations

from datetime import datetime, time, timedelta

_DAY = timedelta(days=1)


def moment(text: str, begins_t: int, ends_t: int) -> int:
    """Read a moment of a recording.

    Args:
        text: Seconds from the beginning (`10`, `2.5`), from the end (`-10`), a time of day (`03:12:07.5`, local), or a
            date and time in ISO form, local where it names no zone.
        begins_t: When the recording begins, µs UTC.
        ends_t: When it ends, µs UTC.

    Returns:
        µs UTC.

    Raises:
        ValueError: It is none of these.
    """
    try:
        seconds = float(text)
    except ValueError:
        return _named(text, begins_t)
    if not abs(seconds) < 1e9:  # noqa: PLR2004 - thirty years; not a number is caught by it too
        raise ValueError(f"{text!r} is no number of seconds")
    return (ends_t if text.lstrip().startswith("-") else begins_t) + round(seconds * 1e6)


def _named(text: str, begins_t: int) -> int:
    """A time of day, the first one after the beginning, or a date and time."""
    begins = datetime.fromtimestamp(begins_t / 1e6).astimezone()
    try:
        if "-" in text or "T" in text:
            found = datetime.fromisoformat(text)
            return round((found if found.tzinfo else found.astimezone()).timestamp() * 1e6)
        found = datetime.combine(begins.date(), time.fromisoformat(text)).astimezone()
    except ValueError:
        raise ValueError(
            f"{text!r} is no moment of a recording: write seconds from its beginning (10) or its end (-10), "
            "a time of day (03:12:07) or a date and time (2026-05-04T03:12:07)"
        ) from None
    if begins - found > _DAY / 2:  # after midnight, of a recording that began before
        found += _DAY
    return round(found.timestamp() * 1e6)
