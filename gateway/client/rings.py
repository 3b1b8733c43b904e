"""How far a client has read each ring of events, so that a cut loses no event and doubles none."""

from __future__ import annotations

from collections.abc import Collection, Iterable

from gateway.api.model import Event


class _Ring:
    """One ring.

    Attributes:
        read: Every event up to this seq has come, as far as it was asked for.
        until: The newest event when the ring was last read on: up to it, events may come in any order and twice.
        early: Those between the two that have come.
    """

    __slots__ = ("early", "read", "until")

    def __init__(self, read: int, until: int) -> None:
        self.read = read
        self.until = until
        self.early: set[int] = set()


class Rings:
    """Where to read on, by ring; pure bookkeeping.

    Several subscriptions that read on in the same ring are each told their events of before: these come mixed and
    twice. What comes after the newest of them is in order and comes once.
    """

    def __init__(self) -> None:
        self._rings: dict[str, _Ring] = {}

    @property
    def names(self) -> list[str]:
        """The name to read on after, of each ring."""
        return [f"{boot}:{ring.read}" for boot, ring in self._rings.items()]

    def subscribed(self, last_events: Iterable[str], since: Collection[str] | None) -> None:
        """Take the answer to a subscription.

        Args:
            last_events: The newest event of each of its rings.
            since: What it was to read on after; None: it begins with what comes now.
        """
        asked = dict(map(_parts, since or ()))
        for boot, newest in map(_parts, last_events):
            ring = self._rings.get(boot)
            if since is None:
                if ring is None:
                    self._rings[boot] = _Ring(newest, newest)
                continue
            first = asked.get(boot, 0)  # one that is not named is read from its beginning
            if ring is None:
                self._rings[boot] = _Ring(first, newest)
                continue
            ring.read = min(ring.read, first)
            ring.until = max(ring.until, newest)

    def keep(self, boots: Collection[str]) -> None:
        """Forget the rings of a gateway that is no more: to name them again would make every loss unknown."""
        self._rings = {boot: ring for boot, ring in self._rings.items() if boot in boots}

    def take(self, event: Event) -> bool:
        """Take an event; whether it comes for the first time."""
        ring = self._rings.setdefault(event.boot, _Ring(event.seq - 1, event.seq - 1))
        if event.seq <= ring.read or event.seq in ring.early:
            return False
        if event.seq > ring.until:
            ring.read = ring.until = event.seq
            ring.early.clear()
        else:
            ring.early.add(event.seq)
        return True


def boots_of(names: Iterable[str]) -> set[str]:
    """The rings of some names."""
    return {boot for boot, _ in map(_parts, names)}


def _parts(name: str) -> tuple[str, int]:
    """Ring and seq of a name that the gateway has told or accepted."""
    boot, _, seq = name.rpartition(":")
    return boot, int(seq)
