"""How long to wait before the next attempt: growing delays with jitter."""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator

FIRST_S = 0.2
LONGEST_S = 5.0
GROWTH = 1.7
JITTER = 0.2
# Between attempts at a controller that refuses us, or that no layout explains: somebody has to change something first.
REFUSED_S = 10.0

Backoff = Callable[[], Iterator[float]]


def backoff() -> Iterator[float]:
    """Yield delays in s for ever: 0.2 s growing to 5 s, each up to 20 % shorter or longer."""
    delay_s = FIRST_S
    while True:
        yield delay_s * random.uniform(1 - JITTER, 1 + JITTER)  # noqa: S311 - spreads attempts, hides nothing
        delay_s = min(delay_s * GROWTH, LONGEST_S)


def no_waiting() -> Iterator[float]:
    """Yield no delay at all: for tests."""
    while True:
        yield 0.0
