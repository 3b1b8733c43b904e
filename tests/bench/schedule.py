"""When the robots of a load send: all at once, or one after the other; the same for every server that is compared."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Literal

Phases = Literal["aligned", "spread"]
_STEP_S = 0.0005  # no finer: sleeping and waking is work too
_LATE_S = 0.1


def groups(count: int, rate_hz: float, phases: Phases) -> list[range]:
    """Which robots send together, in the order of a period."""
    steps = 1 if phases == "aligned" else max(1, min(count, round(1 / rate_hz / _STEP_S)))
    return [range(step, count, steps) for step in range(steps)]


def turns(count: int, rate_hz: float, phases: Phases) -> Iterator[range]:
    """Say whose turn it is, when it is; a turn that comes late is made up for, a long standstill is not."""
    each = groups(count, rate_hz, phases)
    step_s = 1 / rate_hz / len(each)
    due_s = time.monotonic()
    while True:
        for group in each:
            due_s = waited(due_s, step_s)
            yield group


def waited(due_s: float, step_s: float) -> float:
    """Sleep until a monotonic time; returns when the step after it is due."""
    late_s = time.monotonic() - due_s
    if late_s < 0:
        time.sleep(-late_s)
    elif late_s > _LATE_S:
        due_s += late_s
    return due_s + step_s
