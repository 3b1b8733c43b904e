"""The event ring: every edge of one boot under its name `boot:seq`, bounded, and readable from any point."""

from __future__ import annotations

import secrets
from collections import deque
from collections.abc import Callable
from itertools import islice

from gateway.api.model import Event, EventKind

DEFAULT_RING = 10_000
DEFAULT_COMMAND_RING = 20_000


class EventRing:
    """The newest events, in order.

    Args:
        capacity: How many are kept; older ones are gone, and readers are told.
        boot: The part of the names that is new for each ring and each start of the gateway; random when None.
    """

    def __init__(self, capacity: int = DEFAULT_RING, boot: str | None = None) -> None:
        self.boot = boot or secrets.token_hex(4)
        self._ring: deque[Event] = deque(maxlen=capacity)
        self.last_seq = 0

    @property
    def last_name(self) -> str:
        """The name of the newest event; `boot:0` before the first."""
        return f"{self.boot}:{self.last_seq}"

    @property
    def capacity(self) -> int | None:
        """How many are kept."""
        return self._ring.maxlen

    def resize(self, capacity: int) -> None:
        """Keep more or fewer events from now on; the newest ones stay."""
        if capacity != self._ring.maxlen:
            self._ring = deque(self._ring, maxlen=capacity)

    def append(
        self,
        robot: str,
        t: int,
        kind: EventKind,
        before: object,
        after: object,
        raw: dict[str, object],
    ) -> Event:
        """Name an edge and keep it."""
        self.last_seq += 1
        event = Event(
            name=self.last_name,
            seq=self.last_seq,
            robot=robot,
            t=t,
            kind=kind,
            before=before,
            after=after,
            raw=raw,
        )
        self._ring.append(event)
        return event

    def since(
        self,
        name: str | None,
        limit: int,
        wanted: Callable[[Event], bool] = lambda _: True,
    ) -> tuple[list[Event], int | None]:
        """Read back the events after a named one.

        Args:
            name: The last event that the reader has, `boot:seq`; None reads from the oldest.
            limit: At most so many, the oldest first.
            wanted: Which events the reader asked for.

        Returns:
            The events, and how many between `name` and the oldest in the ring are gone for ever: 0 for none, None where
            the number is not known because the name is from another boot.

        Raises:
            ValueError: The name is not of the form `boot:seq`.
        """
        boot, seq = parse_name(name) if name is not None else (self.boot, 0)
        oldest = self._ring[0].seq if self._ring else self.last_seq + 1
        missed: int | None
        if boot != self.boot:
            seq, missed = 0, None
        else:
            missed = max(0, oldest - seq - 1) if name is not None else 0
        skip = max(0, seq - oldest + 1)
        found = (event for event in islice(self._ring, skip, None) if wanted(event))
        return list(islice(found, limit)), missed


def parse_name(name: str) -> tuple[str, int]:
    """Take the name of an event apart.

    Raises:
        ValueError: It is not of the form `boot:seq`.
    """
    boot, colon, seq = name.rpartition(":")
    if not colon or not boot or not seq.isascii() or not seq.isdigit():
        raise ValueError(f"{name!r} is no event name: it must be boot:seq, such as 9f2c41d0:17")
    return boot, int(seq)
