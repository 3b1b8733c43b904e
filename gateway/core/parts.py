"""The state of a robot that is told in parts: a frame brings some values, the others stay, and none stays for ever."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from collections.abc import Set as AbstractSet
from dataclasses import dataclass, replace

from gateway.api.decoder import Frame


@dataclass(frozen=True, slots=True)
class Part:
    """One value of the state.

    Attributes:
        value: As it was told last; None: the controller could not tell.
        frame: The frame that told it.
        t: When it was received, µs UTC.
        at_s: The same, monotonic.
    """

    value: object
    frame: Frame
    t: int
    at_s: float


@dataclass(frozen=True, slots=True)
class View:
    """What some values say together.

    Attributes:
        frame: Holds the values; one that is too old, or was never told, is None.
        oldest: The oldest part that says something; None: there is none.
    """

    frame: Frame
    oldest: Part | None


class Parts:
    """The newest part of each value of one session.

    Args:
        stale_s: Age at which a value is no longer told.
    """

    def __init__(self, stale_s: float) -> None:
        self._stale_s = stale_s
        self._parts: dict[str, Part] = {}
        self._told: set[str] = set()

    @property
    def told(self) -> AbstractSet[str]:
        """The values that were told in this session, be it that the controller could not tell."""
        return self._told

    def clear(self) -> None:
        """A new session has begun: nothing is known."""
        self._parts.clear()
        self._told.clear()

    def restamp(self, stamp: Callable[[float], int]) -> None:
        """The wall clock was set: what is known has other times, the oldest first."""
        in_order = sorted(self._parts.items(), key=lambda item: item[1].at_s)
        self._parts = {name: replace(part, t=stamp(part.at_s)) for name, part in in_order}

    def take(self, frame: Frame, t: int, at_s: float) -> None:
        """Take what a frame tells."""
        for name, value in frame.values.items():
            self._parts[name] = Part(value, frame, t, at_s)
        self._told.update(frame.values)

    def drop_stale(self, now_s: float) -> set[str]:
        """Forget the values that are too old; the names of those that told something."""
        old = [name for name, part in self._parts.items() if now_s - part.at_s > self._stale_s]
        return {name for name in old if self._parts.pop(name).value is not None}

    def view(self, frame: Frame, names: Iterable[str] | None) -> View:
        """What some values say now, as one frame.

        Args:
            frame: The frame that came last: gives raw bytes, table and quality.
            names: The values that are wanted; None: all.
        """
        parts: Mapping[str, Part] = self._parts
        if names is not None:
            parts = {name: self._parts[name] for name in names if name in self._parts}
        telling = [part for part in parts.values() if part.value is not None]
        oldest = min(telling, key=lambda part: part.at_s, default=None)
        values = {name: part.value for name, part in parts.items()}
        return View(Frame(frame.raw, frame.layout, frame.start, frame.quality, values), oldest)
