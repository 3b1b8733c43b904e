"""Times functions in turns in one run, so that a noisy machine disturbs all of them alike."""

from __future__ import annotations

import gc
import time
from collections.abc import Callable, Mapping

from tests.bench.plan import Plan

_LEAST_ROUNDS = 15  # they are short: more of them cost little
_MOST_CALLS = 1 << 20


def times_us(calls: Mapping[str, Callable[[], object]], plan: Plan) -> dict[str, list[float]]:
    """Time each function in every round.

    Args:
        calls: By name.
        plan: How many rounds, and how long.

    Returns:
        By name, the time of one call in each round, µs.
    """
    counts = {name: _calls_in(call, plan.call_s) for name, call in calls.items()}
    times: dict[str, list[float]] = {name: [] for name in calls}
    rounds = plan.rounds if plan.rounds == 1 else max(plan.rounds, _LEAST_ROUNDS)
    gc.disable()
    try:
        for _ in range(rounds):
            for name, call in calls.items():
                times[name].append(_time(call, counts[name]) * 1e6)
    finally:
        gc.enable()
    return times


def _calls_in(call: Callable[[], object], seconds: float) -> int:
    count = 1
    while (taken := _time(call, count) * count) < seconds / 4 and count < _MOST_CALLS:
        count *= 2
    return max(1, int(count * seconds / max(taken, 1e-9)))


def _time(call: Callable[[], object], count: int) -> float:
    """Seconds of CPU of one call, averaged over some: what else the machine does is not counted."""
    start = time.thread_time()
    for _ in range(count):
        call()
    return (time.thread_time() - start) / count
