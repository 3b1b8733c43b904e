"""Whether the gateway lives, is ready, and how late its loop is."""

from __future__ import annotations

import time

import aiohttp
import anyio
import anyio.lowlevel
import pytest

from gateway import __version__
from gateway.api.model import Link, LinkState
from gateway.core.bus import Bus
from gateway.server.health import BEAT_S, HUNG_S, LAG_BOUNDS_S, PULSE, Pulse, healthz
from tests.server.kit import Now, T, cell, publish, running_door


def link(state: LinkState, *, attempts: int = 0, last_error: str | None = None) -> Link:
    return Link(state=state, since=T, protocol="polled", peer="x", attempts=attempts, last_error=last_error)


def beaten(now: Now, *lags_s: float) -> Pulse:
    """A pulse whose beats came so late."""
    pulse = Pulse(now)
    for lag_s in lags_s:
        now.at_s += BEAT_S + lag_s
        pulse.beat()
    return pulse


def test_every_beat_is_counted_under_the_bound_that_its_lag_keeps() -> None:
    pulse = beaten(Now(), -0.001, 0.0, 0.004, 0.03, 1.0, 60.0)
    at = dict(zip([*LAG_BOUNDS_S, None], pulse.counts, strict=True))
    assert (at[0.005], at[0.05], at[None]) == (3, 1, 1)
    assert sum(pulse.counts) == 6
    assert pulse.lag_sum == pytest.approx(61.034)


def test_a_beat_that_came_late_does_not_make_the_next_one_late() -> None:
    now = Now()
    pulse = beaten(now, 3.0, 0.0)
    assert pulse.counts[0] == 1
    assert pulse.overdue_s == pytest.approx(-BEAT_S)


async def test_a_loop_that_was_held_up_shows_in_its_lag() -> None:
    pulse = Pulse()
    with pulse.beating():
        await anyio.lowlevel.checkpoint()
        time.sleep(BEAT_S + 0.06)  # noqa: ASYNC251 - the loop is held up on purpose
        await anyio.sleep(0.01)
        assert sum(pulse.counts[LAG_BOUNDS_S.index(0.05) + 1 :]) == 1
    counted = sum(pulse.counts)
    await anyio.sleep(2 * BEAT_S)
    assert sum(pulse.counts) == counted, "the pulse beats on after its end"


async def test_health_tells_the_version_while_the_loop_turns() -> None:
    async with running_door(*cell()) as url, aiohttp.ClientSession() as session:
        answer = await session.get(at(url, "/healthz"))
        assert (answer.status, await answer.json()) == (200, {"status": "ok", "gateway": __version__})


class _Request:
    """As much of a request as health looks at."""

    def __init__(self, pulse: Pulse) -> None:
        self.app = {PULSE: pulse}
        self.query: dict[str, str] = {}


@pytest.mark.parametrize(("late_s", "status"), [(0.0, 200), (HUNG_S - 0.1, 200), (HUNG_S + 0.1, 503)])
async def test_a_loop_that_stood_fails_its_health(late_s: float, status: int) -> None:
    now = Now()
    pulse = Pulse(now)
    now.at_s += BEAT_S + late_s
    answer = await healthz(_Request(pulse))  # type: ignore[arg-type]
    assert answer.status == status
    if status == 503:
        assert "has not turned for 5.2 s" in str(answer.text)
        pulse.beat()
        assert (await healthz(_Request(pulse))).status == 200  # type: ignore[arg-type]


def at(url: str, path: str) -> str:
    return url.replace("ws://", "http://").replace("/ws", path)


async def ready(bus: Bus, robots: list[object]) -> tuple[int, dict[str, object]]:
    async with running_door(bus, robots) as url, aiohttp.ClientSession() as session:  # type: ignore[arg-type]
        answer = await session.get(at(url, "/readyz"))
        return answer.status, await answer.json()


@pytest.mark.parametrize(
    ("told", "is_ready"),
    [
        (link(LinkState.DISCONNECTED), False),
        (link(LinkState.CONNECTING, attempts=1), False),
        (link(LinkState.HANDSHAKING, attempts=1), True),
        (link(LinkState.ONLINE), True),
        (link(LinkState.DISCONNECTED, attempts=1, last_error="refused"), True),
        (link(LinkState.CONNECTING, attempts=2, last_error="refused"), True),
        (link(LinkState.FAULTED, last_error="no such plugin"), True),
    ],
    ids=lambda value: f"{value.state}-{value.attempts}" if isinstance(value, Link) else str(value),
)
async def test_a_link_counts_as_tried_when_its_first_attempt_has_come_to_something(told: Link, is_ready: bool) -> None:  # noqa: FBT001
    bus, robots = cell("r1", "r2")
    publish(bus, "r2/link", 2, told)
    status, body = await ready(bus, [*robots])
    if is_ready:
        assert (status, body) == (200, {"status": "ready", "robots": 2})
    else:
        words = "not tried yet: r2"
        assert (status, body) == (503, {"code": "NOT_READY", "message": words, "waiting": ["r2"]})


async def test_a_gateway_without_robots_is_ready() -> None:
    assert (await ready(Bus(cell()[0].events), []))[0] == 200
