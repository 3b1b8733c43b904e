"""What looks over a session's shoulder: every byte that it receives and sends, with its time."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Protocol

from gateway.api.model import Fault, Quality

Seqs = int | Mapping[str, int]


class Told(Protocol):
    """What has been published so far, so that a replay goes on from there."""

    @property
    def epoch(self) -> str:
        """The running epoch."""
        ...

    @property
    def seqs(self) -> Seqs:
        """The number of the last sample; by group, where frames bring the state in parts."""
        ...

    @property
    def faults(self) -> Sequence[Fault]:
        """The faults that stand, with the time since when."""
        ...


class Tap(Protocol):
    """Takes the bytes of one robot's sessions. It must return at once, and never raises."""

    def begin(self, at_s: float, stamp: Callable[[float], int], told: Told) -> None:
        """A session has begun.

        Args:
            at_s: When, monotonic, in s.
            stamp: Maps a monotonic time in s to µs UTC, as the samples have it.
            told: What is published of it.
        """
        ...

    def received(self, data: bytes, at_s: float) -> None:
        """Bytes were received, at a monotonic time in s; they have not been decoded yet."""
        ...

    def sent(self, data: bytes, at_s: float) -> None:
        """Bytes were sent, at a monotonic time in s."""
        ...

    def online(self) -> None:
        """The first good frame has come: what was exchanged before it is needed to read what follows."""
        ...

    def silent(self, quality: Quality, t_last: int | None, at_s: float) -> None:
        """It is said on every topic, at a monotonic time in s, that none come any more since `t_last`, µs UTC."""
        ...

    def expired(self, at_s: float) -> None:
        """It was said that some values have become too old, at a monotonic time in s."""
        ...

    def end(self, at_s: float) -> None:
        """The session is over, at a monotonic time in s."""
        ...
