"""Eight virtual controllers at 8 ms: nothing is lost; `make soak` runs it for longer."""

from __future__ import annotations

import os
from contextlib import AsyncExitStack

import anyio
import pytest

from gateway.api.model import LinkState, LinkStats
from gateway.sim.server import serve
from tests.vendors.fairino.test_cnde_simulator import Reading, eventually, reading, robot, simulator
from vendors.fairino.simulator.cnde import CndeBehaviour

ROBOTS = 8
RUN_S = float(os.environ.get("SOAK_SECONDS", "0")) or 1.5


async def nothing_is_lost(seconds: float) -> None:
    """Read eight controllers for a while, over TCP and UDP in turn."""
    async with AsyncExitStack() as stack:
        found: list[Reading] = []
        controllers = await stack.enter_async_context(
            serve(simulator(CndeBehaviour(counts=True)), host="127.0.0.1", port=0)
        )
        first = controllers[0]
        for number in range(ROBOTS):
            transport = "udp" if number % 2 else "tcp"
            settings = robot(first.number_of("cnde", transport), transport)  # type: ignore[arg-type] # a literal
            found.append(await stack.enter_async_context(reading(settings)))
        await eventually(lambda: all(one.state.state is LinkState.ONLINE for one in found))
        await anyio.sleep(seconds)
        sent = first.robot.frames
        await anyio.sleep(1.2)
        stats = [one.data("link_stats") for one in found]
        told = [one for one in stats if isinstance(one, LinkStats)]
        assert len(told) == ROBOTS
        assert sum(one.frames for one in told) >= sent
        assert [one.gaps for one in told] == [0] * ROBOTS
        assert [one.rejects for one in told] == [{}] * ROBOTS
        assert sent > ROBOTS * 100 * seconds


@pytest.mark.soak
@pytest.mark.limit(RUN_S + 60)
async def test_eight_robots_at_8_ms_lose_nothing() -> None:
    await nothing_is_lost(RUN_S)
