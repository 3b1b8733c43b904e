"""What reads one group from the frames of one table, whatever kind of table it is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from gateway.api.decoder import Frame
from gateway.api.model import Quality

Read = Callable[[Frame], tuple[object, Quality]]
ReadKey = Callable[[Frame], object]
ReadWords = Callable[[Frame], tuple[object, ...]]


@dataclass(frozen=True, slots=True)
class Reader:
    """How one group is read from frames of one table.

    Attributes:
        read: Returns the group and its quality: what its rows state, BAD where it held non-finite values.
        key: What the group's discrete values follow from: while it stays equal, a state topic has no news.
        empty: The group with every leaf null.
        volatile: Paths of the leaves that always change.
    """

    read: Read
    key: ReadKey
    empty: object
    volatile: tuple[tuple[str, ...], ...] = ()
