"""How the gateway's cost grows with robots, clients, rate and fields: one point each, by itself."""

from __future__ import annotations

import time
from collections.abc import Iterator

import msgspec

from tests.bench import cells
from tests.bench.plan import Plan
from tests.bench.processes import Process
from tests.bench.table import Row, row_of

_CLIENTS = 10
_GROUPS = ("joints", "tcp", "vendor")


class Point(msgspec.Struct, frozen=True, kw_only=True):
    """One load.

    Args:
        axis: What is varied.
        at: Where on the axis.
        robots: How many.
        rate_hz: Of each.
        clients: How many, each with every sample.
        groups: What they subscribe to, of every robot.
    """

    axis: str
    at: float
    robots: int
    rate_hz: float
    clients: int
    groups: tuple[str, ...] = ("joints",)

    @property
    def name(self) -> str:
        """As a row is called."""
        return f"by {self.axis}: {self.at:g}"


def points(plan: Plan) -> list[Point]:
    """Every load, around the usual one."""
    base = Point(
        axis="robots", at=0, robots=plan.robots, rate_hz=plan.rate_hz, clients=min(_CLIENTS, max(plan.clients))
    )

    def varied(axis: str, at: float, **changed: object) -> Point:
        return msgspec.structs.replace(base, axis=axis, at=at, **changed)

    robots = sorted({1, plan.robots // 4 or 1, plan.robots // 2, plan.robots, plan.many // 2, plan.many})
    rates = (plan.rate_hz / 8, plan.rate_hz / 2, plan.rate_hz, 500.0)
    axes = (
        [varied("robots", count, robots=count) for count in robots],
        [varied("clients", count, clients=count) for count in (0, *plan.clients)],
        [varied("rate", rate, rate_hz=rate) for rate in rates],
        [varied("groups", count, groups=_GROUPS[:count]) for count in range(1, len(_GROUPS) + 1)],
    )
    return [point for axis in axes for point in axis[: plan.points]]


def rows(plan: Plan) -> Iterator[Row]:
    """The CPU of the gateway at every point, in % of a core."""
    for point in points(plan):
        shares = []
        for _ in range(min(plan.rounds, 3)):
            with cells.controllers(point.robots, point.rate_hz) as (_, ports), cells.gateway(ports) as (server, port):
                shares.append(_share(plan, point, server, port))
        note = ", ".join(
            (f"{point.robots} robots × {point.rate_hz:g} Hz", f"{point.clients} clients", " + ".join(point.groups))
        )
        yield row_of(point.name, "%", shares, note=note)


def _share(plan: Plan, point: Point, server: Process, port: int) -> float:
    def measured() -> float:
        time.sleep(plan.warm_s)
        cpu_s, at_s = server.cpu_s(), time.monotonic()
        time.sleep(plan.window_s)
        return (server.cpu_s() - cpu_s) / (time.monotonic() - at_s) * 100

    if not point.clients:
        return measured()
    with cells.clients(port, "json", point.clients, [f"*/{group}" for group in point.groups]):
        return measured()
