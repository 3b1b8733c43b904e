"""How long a sample is under way from the controller's send to the subscriber's read, beside a bare relay."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import AbstractContextManager

import msgspec

from gateway.config.keys import Server
from tests.bench import cells
from tests.bench.listeners import QUANTILES, Seen
from tests.bench.plan import Plan
from tests.bench.processes import Process, module, running
from tests.bench.table import Goal, Row, row_of

CLIENTS = 10
_DEFAULT_MS = Server().flush_ms
_NAMES = ("p50", "p99", "p99.9")
_P99 = 1


def rows(plan: Plan) -> Iterator[Row]:
    """The gateway without a flush time and with the default one, in turns with the relay."""
    relayed: list[list[float]] = []
    at_once: list[list[float]] = []
    flushed: list[list[float]] = []
    for _ in range(plan.rounds):
        with cells.controllers(plan.robots, plan.rate_hz) as (_, ports):
            relayed.append(_taken(plan, cells.relay(ports), "relay"))
            at_once.append(_taken(plan, cells.gateway(ports, 0.0), "json"))
            flushed.append(_taken(plan, cells.gateway(ports), "json"))
    load = f"a bare relay, {plan.robots} × {plan.rate_hz:g} Hz, {CLIENTS} clients"
    for title, found in (("flush_ms 0", at_once), (f"flush_ms {_DEFAULT_MS:g}, the default", flushed)):
        for index, name in enumerate(_NAMES):
            ours, floor = [one[index] * 1e3 for one in found], [one[index] * 1e3 for one in relayed]
            goal = None
            if index == _P99:
                late_ms = sorted(floor)[len(floor) // 2] + 2 * _DEFAULT_MS
                words = f"≤ relay + {2 * _DEFAULT_MS:g} ms"
                goal = Goal(1.5) if found is at_once else Goal(late_ms, "value", words)
            note = f"the relay: {sorted(floor)[len(floor) // 2]:.3f} ms"
            yield row_of(f"{title}: {name}", "ms", ours, load, floor, goal=goal, note=note)


def _taken(plan: Plan, server: AbstractContextManager[tuple[Process, int]], dialect: str) -> list[float]:
    """The quantiles, in s."""
    with server as (_, port), running(module("listeners", port, dialect, CLIENTS, "latency")) as clients:
        assert clients.line() == b"ready"
        time.sleep(plan.warm_s)
        clients.ask("new")
        time.sleep(plan.window_s)
        seen = msgspec.json.decode(clients.ask("?"), type=Seen)
    assert len(seen.taken_s) == len(QUANTILES), "no sample came"
    return seen.taken_s
