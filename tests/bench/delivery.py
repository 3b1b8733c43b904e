"""What a delivered sample costs: CPU of the server's process only, samples counted by the clients in another."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field, replace
from functools import partial

from tests.bench import cells
from tests.bench.plan import Plan
from tests.bench.processes import Process, part
from tests.bench.schedule import Phases
from tests.bench.table import Goal, Row, row_of

TOPICS = "*/joints"
_GOAL = Goal(0.4)
_GOAL_CLIENTS = 50
_ALONE = {"gateway", "foxglove"}
_ENOUGH = 0.98
_PHASES: tuple[Phases, ...] = ("aligned", "spread")
# A server, its port, and what else runs for it.
_Running = tuple[Process, int, tuple[Process, ...]]
Server = Callable[[Plan, Phases, str], AbstractContextManager[_Running]]


@dataclass(frozen=True, slots=True)
class Load:
    """What one figure is of."""

    server: str
    phases: Phases
    encoding: str
    clients: int
    is_alone: bool = False  # the server has one core, and the rest of the load the others


@dataclass(slots=True)
class Taken:
    """The figures of a load, one a round.

    Attributes:
        cost_us: CPU time for each delivered sample, µs.
        share: Samples that came of those that were due.
    """

    cost_us: list[float] = field(default_factory=list)
    share: list[float] = field(default_factory=list)


@contextmanager
def _ours(plan: Plan, phases: Phases, _encoding: str) -> Iterator[_Running]:
    with (
        cells.controllers(plan.robots, plan.rate_hz, phases) as (robots, ports),
        cells.gateway(ports) as (server, port),
    ):
        yield server, port, (robots,)


@contextmanager
def _publisher(name: str, plan: Plan, phases: Phases, encoding: str) -> Iterator[_Running]:
    with cells.publisher(name, plan, phases, encoding) as (server, port):
        yield server, port, ()


SERVERS: dict[str, Server] = {
    "gateway": _ours,
    "foxglove": partial(_publisher, "sdk"),
    "websockets": partial(_publisher, "broadcast"),
}


def rows(plan: Plan) -> Iterator[Row]:
    """Ours beside foxglove-sdk's server, for each encoding, phase and number of clients; then beside websockets."""
    taken: dict[Load, Taken] = {}
    for _ in range(plan.rounds):
        for phases in _PHASES:
            for encoding in plan.encodings:
                for name in SERVERS:
                    _take_all(taken, plan, name, phases, encoding)
    for other in ("foxglove", "websockets"):
        for load in taken:
            if load.server == "gateway" and replace(load, server=other) in taken:
                yield _row(load, other, taken, plan)


def _take_all(taken: dict[Load, Taken], plan: Plan, name: str, phases: Phases, encoding: str) -> None:
    """Start one server, and measure it with each number of clients."""
    with SERVERS[name](plan, phases, encoding) as (server, port, others):
        loads = [Load(name, phases, encoding, count) for count in plan.clients]
        if _GOAL_CLIENTS in plan.clients and name in _ALONE:
            loads.append(Load(name, phases, encoding, _GOAL_CLIENTS, is_alone=True))
        for load in loads:
            found = taken.setdefault(load, Taken())
            dialect = encoding if name == "gateway" else f"{name}-{encoding}"
            cost_us, share = measured(plan, server, port, dialect, load.clients, others if load.is_alone else None)
            found.cost_us.append(cost_us)
            found.share.append(share)


def measured(
    plan: Plan,
    server: Process,
    port: int,
    dialect: str,
    count: int,
    others: tuple[Process, ...] | None = None,
) -> tuple[float, float]:
    """Measure a server with some clients.

    Args:
        plan: How long.
        server: It is measured.
        port: Its port.
        dialect: What its clients speak.
        count: How many they are.
        others: The server has a core of its own, and these run beside the clients; None: each where the kernel puts it.

    Returns:
        CPU time for each delivered sample, in µs, and the share of the samples that came.
    """
    topics = [TOPICS] if dialect in {"json", "msgpack"} else [f"r{number}" for number in range(plan.robots)]
    with cells.clients(port, dialect, count, topics) as process:
        if others is not None:
            part(server, process, *others)
        time.sleep(plan.warm_s)
        before, cpu_s = cells.counted(process), server.cpu_s()
        time.sleep(plan.window_s)
        after, used_s = cells.counted(process), server.cpu_s() - cpu_s
    n_delivered = after.delivered - before.delivered
    due = plan.robots * plan.rate_hz * count * (after.at_s - before.at_s)
    return used_s / max(1, n_delivered) * 1e6, n_delivered / due


def _row(load: Load, other: str, taken: dict[Load, Taken], plan: Plan) -> Row:
    ours, theirs = taken[load], taken[replace(load, server=other)]
    encoding = {"json": "JSON", "msgpack": "MessagePack"}[load.encoding]
    short = [
        f"{name} delivered {min(found.share):.0%} of its samples"
        for name, found in (("the gateway", ours), (other, theirs))
        if min(found.share) < _ENOUGH
    ]
    return row_of(
        f"{encoding}, {load.clients} clients, phases {load.phases}{', each server on one core' * load.is_alone}",
        "µs",
        ours.cost_us,
        f"{_TITLES[other]}: CPU per delivered sample at {plan.robots} × {plan.rate_hz:g} Hz",
        theirs.cost_us,
        goal=_GOAL if other == "foxglove" and load.clients == _GOAL_CLIENTS else None,
        note="; ".join(short),
    )


_TITLES = {
    "foxglove": "foxglove-sdk's server, the same bytes",
    "websockets": "websockets.broadcast, the same bytes",
}
