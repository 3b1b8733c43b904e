"""Resident memory: idle, under load, and while clients come and go."""

from __future__ import annotations

import statistics
import time
from collections.abc import Iterator
from typing import NamedTuple

from tests.bench import cells
from tests.bench.dialects import RATED_HZ
from tests.bench.plan import Plan
from tests.bench.processes import Process, module, running
from tests.bench.table import Goal, Row, row_of

_BARE = (
    "import sys, aiohttp, msgspec, numpy, prometheus_client, structlog, uvloop; print(0, flush=True); sys.stdin.read()"
)
_CLIENTS = 50
_LOOKS = 5
_ENOUGH = 0.98


def rows(plan: Plan) -> Iterator[Row]:
    """Each beside a Python that has only imported the same packages; at the end, the gateway beside itself."""
    idle, bare = [], []
    loads: dict[bool, list[_Load]] = {False: [], True: []}
    for _ in range(plan.rounds):
        with running(["-c", _BARE]) as process:
            process.line()
            bare.append(process.memory_mb())
        with cells.controllers(1, 1.0) as (_, ports), cells.gateway(ports) as (server, _):
            time.sleep(plan.warm_s)
            idle.append(server.memory_mb())
        for recorder, found in loads.items():
            found.append(_loaded(plan, recorder=recorder))
    base = "a Python that has imported the same packages"
    yield row_of("idle: one robot at 1 Hz, no client", "MB", idle, base, bare)
    goal = Goal(100, "value", "≤ 100 MB")
    for recorder, found in loads.items():
        rings = "the recorder's rings full" if recorder else "without the recorder"
        title = f"{plan.many} robots × {plan.rate_hz:g} Hz, {_readers(plan)} clients"
        rated = [one.rated_mb for one in found]
        yield row_of(f"{title} at {RATED_HZ:g} Hz, {rings}", "MB", rated, base, bare, goal=goal)
        share = min(one.share for one in found)
        slow = f"the clients took {share:.0%} of the samples: what they have still to get is kept for them"
        every = [one.every_mb for one in found]
        note = slow if share < _ENOUGH else ""
        yield row_of(f"{title} with every sample, {rings}", "MB", every, base, bare, goal=goal, note=note)
    yield from _churn(plan)


class _Load(NamedTuple):
    """The largest load of one round: memory with clients at a rate and with every sample, and what those got of it."""

    rated_mb: float
    every_mb: float
    share: float


def _loaded(plan: Plan, *, recorder: bool) -> _Load:
    taken = []
    with (
        cells.controllers(plan.many, plan.rate_hz) as (_, ports),
        cells.gateway(ports, recorder=recorder) as (server, port),
    ):
        time.sleep(plan.fill_s if recorder else plan.warm_s)
        for dialect in ("json-rated", "json"):
            with cells.clients(port, dialect, _readers(plan), ["*/joints"]) as process:
                before = cells.counted(process)
                time.sleep(plan.window_s)
                taken.append(server.memory_mb())
                after = cells.counted(process)
    due = plan.many * plan.rate_hz * _readers(plan) * (after.at_s - before.at_s)
    return _Load(taken[0], taken[1], (after.delivered - before.delivered) / due)


def _readers(plan: Plan) -> int:
    return min(_CLIENTS, plan.visitors)


def _churn(plan: Plan) -> Iterator[Row]:
    """Once: its length is what it is about."""
    with (
        cells.controllers(plan.robots, plan.rate_hz) as (_, ports),
        cells.gateway(ports) as (server, port),
        running(module("visitors", port, plan.visitors)) as visitors,
    ):
        assert visitors.line() == b"ready"
        time.sleep(plan.churn_s / 10)
        first = _memory(server)
        time.sleep(plan.churn_s * 9 / 10)
        last, n_came = _memory(server), int(visitors.ask("?"))
    name = f"{plan.visitors} clients coming and going for {plan.churn_s:g} s"
    base = f"the same after {plan.churn_s / 10:g} s"
    yield row_of(name, "MB", [last], base, [first], goal=Goal(1.05), note=f"{n_came} clients came")


def _memory(server: Process) -> float:
    """The median of a second: it goes up and down with what is being sent."""
    found = []
    for _ in range(_LOOKS):
        found.append(server.memory_mb())
        time.sleep(1 / _LOOKS)
    return statistics.median(found)
