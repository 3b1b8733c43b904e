"""How far a reader has come in several event rings, as one string that it can give back."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from gateway.core.bus import Topic
from gateway.core.events import EventRing, parse_name


class Bookmark:
    """The name of the newest event that a reader has, for each ring that its topics have.

    As a text: the names with commas between, in an order that stays. `since` and `Last-Event-ID` take it.

    Args:
        topics: What is read.
        since: The names that the reader has given; None: it has given none.
        from_oldest: Where a reader without names begins: before the oldest event of each ring, or behind the newest.
    """

    def __init__(self, topics: Iterable[Topic], since: Sequence[str] | None, *, from_oldest: bool = False) -> None:
        self._rings = {topic.ring.boot: topic.ring for topic in topics if topic.ring is not None}
        given = {} if since is None else {parse_name(name)[0]: name for name in since}
        self._names = {boot: given.get(boot) or f"{boot}:0" for boot in self._rings}
        if since is None:
            start = _before_oldest if from_oldest else _newest
            self._names = {boot: start(ring) for boot, ring in self._rings.items()}

    def __str__(self) -> str:
        return ",".join(self._names.values())

    def move(self, name: str) -> None:
        """The reader has an event."""
        self._names[parse_name(name)[0]] = name

    def move_to_end(self) -> None:
        """The reader has everything that there is for it."""
        self._names.update({boot: ring.last_name for boot, ring in self._rings.items()})


def _newest(ring: EventRing) -> str:
    return ring.last_name


def _before_oldest(ring: EventRing) -> str:
    oldest, _ = ring.since(None, 1)
    return f"{ring.boot}:{oldest[0].seq - 1}" if oldest else ring.last_name
