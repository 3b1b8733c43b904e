"""The largest loads: one robot at 1 kHz, and many robots with clients that check every number; and nobody listening."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import ExitStack
from typing import NamedTuple

import msgspec

from tests.bench import cells
from tests.bench.controllers import Told
from tests.bench.listeners import Seen
from tests.bench.plan import Plan
from tests.bench.processes import Process, module, part, running
from tests.bench.table import Goal, Row, row_of

_FAST_HZ = 1000.0
_CARRIED = 85.0


class Taken(NamedTuple):
    """The figures of one round."""

    cpu: float  # % of a core
    lost: float  # frames that left and were not read, or numbers that a client missed
    lag_ms: float  # mean of the loop's lag
    late: int  # beats of the loop that came more than 25 ms late
    n_samples: int
    clients_cpu: float  # % of a core; near 100 the machine cannot carry the clients, and what is missed says nothing
    unread: int = 0  # of `lost`, the frames that the server did not read; the rest are samples that clients missed


def rows(plan: Plan) -> Iterator[Row]:
    """Each load beside the relay under the same load."""
    quiet = f"{plan.robots} robots × {plan.rate_hz:g} Hz, nobody listens"
    yield from _rows(plan, quiet, plan.robots, plan.rate_hz, 0, Goal(25, "value", "≤ 25 % of a core"))
    yield from _rows(plan, f"1 robot × {_FAST_HZ:g} Hz, {plan.readers} clients", 1, _FAST_HZ, plan.readers, None)
    many = f"{plan.many} robots × {plan.rate_hz:g} Hz, {plan.readers} clients"
    yield from _rows(plan, many, plan.many, plan.rate_hz, plan.readers, None)


def _rows(plan: Plan, title: str, robots: int, rate_hz: float, readers: int, goal: Goal | None) -> Iterator[Row]:
    ours, floor = [], []
    for _ in range(plan.rounds):
        with cells.controllers(robots, rate_hz) as (source, ports):
            ours.append(_taken(plan, source, ports, readers, ours=True))
            floor.append(_taken(plan, source, ports, readers, ours=False))
    base = "a bare relay under the same load"
    yield row_of(f"{title}: CPU", "%", [one.cpu for one in ours], base, [one.cpu for one in floor], goal=goal)
    lost = "frames and samples missed" if readers else "frames missed"
    nothing = Goal(0, "value", "nothing missed") if readers else None
    busy = max(one.clients_cpu for one in ours)
    delivered = f"{sum(one.n_samples for one in ours):,} samples checked" if readers else ""
    if busy > _CARRIED:
        delivered += f"; the machine does not carry the clients: their process took {busy:.0f} % of a core"
    unread = sum(one.unread for one in ours)
    if unread:
        delivered += f"; {unread} of what was missed are frames that the server did not read"
    yield row_of(f"{title}: {lost}", "", [one.lost for one in ours], goal=nothing, note=delivered)
    late = sum(one.late for one in ours)
    note = f"{late} beats came more than 25 ms late" if late else ""
    yield row_of(f"{title}: mean lag of the loop", "ms", [one.lag_ms for one in ours], note=note)


def _taken(plan: Plan, source: Process, ports: list[int], readers: int, *, ours: bool) -> Taken:
    with ExitStack() as stack:
        server, port = stack.enter_context(cells.gateway(ports) if ours else cells.relay(ports))
        clients = None
        if readers:
            arguments = module("listeners", port, "json" if ours else "relay", readers, "check")
            clients = stack.enter_context(running(arguments))
            assert clients.line() == b"ready"
        part(server, source, *(() if clients is None else (clients,)))
        time.sleep(plan.warm_s)
        seen_before = None if clients is None else msgspec.json.decode(clients.ask("?"), type=Seen)
        before = cells.metrics(port) if ours else None
        busy_s = 0.0 if clients is None else clients.cpu_s()
        sent, cpu_s, at_s = _sent(source), server.cpu_s(), time.monotonic()
        time.sleep(plan.window_s)
        took_s = time.monotonic() - at_s
        share = (server.cpu_s() - cpu_s) / took_s * 100
        busy = 0.0 if clients is None else (clients.cpu_s() - busy_s) / took_s * 100
        seen = Seen() if clients is None else msgspec.json.decode(clients.ask("?"), type=Seen)
        if before is None:
            return Taken(share, 0, 0, 0, seen.samples, busy)
        after, told = cells.metrics(port), _sent(source)
        beats = max(1, after.beats - before.beats)
        unread = after.gaps - before.gaps + told.blocked - sent.blocked
        lost = unread + seen.holes + seen.missed + seen.lost
        lost += 0 if seen_before is None else seen_before.holes
        lag_ms = (after.lag_sum_s - before.lag_sum_s) / beats * 1e3
        return Taken(share, lost, lag_ms, after.late - before.late, seen.samples, busy, unread)


def _sent(source: Process) -> Told:
    return msgspec.json.decode(source.ask("?"), type=Told)
