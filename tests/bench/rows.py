"""The table of benchmarks: a name, what it measures, and the function that makes its rows."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

from tests.bench import decode, delivery, latency, memory, rates, startup, sweeps
from tests.bench.plan import Plan
from tests.bench.table import Row


@dataclass(frozen=True, slots=True)
class Benchmark:
    """One benchmark.

    Args:
        title: What it measures.
        rows: Makes its rows.
    """

    title: str
    rows: Callable[[Plan], Iterator[Row]]


BENCHMARKS = {
    "decode": Benchmark("one frame found, decoded and normalised", decode.rows),
    "latency": Benchmark("from the controller's send to the subscriber's read", latency.rows),
    "delivery": Benchmark(
        "CPU for each delivered sample, reading and normalising of live frames included", delivery.rows
    ),
    "rates": Benchmark("the largest loads: what is missed, CPU, lag of the loop", rates.rows),
    "memory": Benchmark("resident memory", memory.rows),
    "startup": Benchmark("start to first sample, and the command status", startup.rows),
    "sweeps": Benchmark("how cost grows with robots, clients, rate and groups", sweeps.rows),
}
