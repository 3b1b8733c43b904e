"""What a target is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Target:
    """One thing that takes bytes from strangers.

    Attributes:
        name: Short, lower case; names the corpus and the crash files.
        run: Takes any bytes; whatever it raises is a bug.
        seeds: Bytes to start from.
    """

    name: str
    run: Callable[[bytes], None]
    seeds: tuple[bytes, ...]
