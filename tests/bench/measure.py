"""Measures functions beside each other in one run, so that a noisy machine disturbs both alike."""

from __future__ import annotations

import gc
import statistics
import time
from collections.abc import Callable, Sequence

import msgspec

ROUNDS = 9
ROUND_S = 0.02


class Row(msgspec.Struct, frozen=True, kw_only=True):
    """One figure and its ratio to a baseline of the same run.

    Args:
        name: What was measured.
        baseline: What it is compared with.
        value_us: Median time of one call, µs.
        ratio: Median of the rounds' ratios to the baseline.
        least: Smallest ratio of a round.
        most: Largest ratio of a round.
    """

    name: str
    baseline: str
    value_us: float
    ratio: float
    least: float
    most: float


def compare(
    baseline: tuple[str, Callable[[], object]],
    candidates: Sequence[tuple[str, Callable[[], object]]],
) -> list[Row]:
    """Time candidates and a baseline in turns.

    Args:
        baseline: Its name and a call of it.
        candidates: The same of each candidate.

    Returns:
        A row each, the baseline's first.
    """
    named = [baseline, *candidates]
    counts = [_calls_in(call, ROUND_S) for _, call in named]
    times: list[list[float]] = [[] for _ in named]
    gc.disable()
    try:
        for _ in range(ROUNDS):
            for index, (_, call) in enumerate(named):
                times[index].append(_time(call, counts[index]))
    finally:
        gc.enable()
    rows = []
    for index, (name, _) in enumerate(named):
        ratios = [value / base for value, base in zip(times[index], times[0], strict=True)]
        rows.append(
            Row(
                name=name,
                baseline=baseline[0],
                value_us=statistics.median(times[index]) * 1e6,
                ratio=statistics.median(ratios),
                least=min(ratios),
                most=max(ratios),
            ),
        )
    return rows


def _calls_in(call: Callable[[], object], seconds: float) -> int:
    count = 1
    while (taken := _time(call, count) * count) < seconds / 4:
        count *= 2
    return max(1, int(count * seconds / taken))


def _time(call: Callable[[], object], count: int) -> float:
    """Seconds of one call, averaged over some."""
    start = time.perf_counter()
    for _ in range(count):
        call()
    return (time.perf_counter() - start) / count
