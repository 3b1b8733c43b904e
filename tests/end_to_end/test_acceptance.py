"""The acceptance runs: short in `make check`, at full length by `make soak`, with the same code."""

from __future__ import annotations

import os
import resource
from collections.abc import AsyncIterator
from pathlib import Path
from typing import cast

import anyio
import pytest

from gateway.api.messages import Data, Missed
from gateway.api.model import Link, LinkStats, Quality, Sample
from gateway.client import Client, connect
from gateway.sim.server import VirtualController
from gateway.testing.cell import VirtualCell, virtual_cell
from vendors.rainbow.layouts import STATE_580

SOAK_S = float(os.environ.get("SOAK_SECONDS", "0"))
SHORT_S = 8.0
RUN_S = SOAK_S or SHORT_S
RATE_HZ = 500
STALL_S = 1.5
CHAOS = f"split=0.2,coalesce=0.1,junk=0.05,header=0.0007,stall={STALL_S}/9,cut=3"
LIVE = {Quality.GOOD, Quality.SUBSTITUTED}


async def samples(client: Client) -> AsyncIterator[Sample]:
    """Every sample; nothing may be missed."""
    async for message in client.pushed():
        assert not isinstance(message, Missed)
        if isinstance(message, Data):
            for sample in message.samples:
                yield sample


def latest(cell: VirtualCell, group: str) -> object:
    topic = cell.gateway.bus.topics[f"r1/{group}"]
    assert topic.latest is not None
    return topic.latest.sample(topic).data


@pytest.mark.soak
@pytest.mark.limit(RUN_S + 30)
async def test_every_frame_of_a_fast_controller_reaches_a_client_that_asks_for_all() -> None:
    received: list[int] = []
    async with (
        virtual_cell("rainbow", scenario="steady", settings={"rate_hz": RATE_HZ}) as cell,
        connect(cell.url) as client,
    ):
        await client.subscribe(["r1/joints"], mode="all")
        (controller,) = cell.controllers
        async with anyio.create_task_group() as tasks:

            async def read() -> None:
                async for sample in samples(client):
                    received.extend([sample.seq] if sample.q in LIVE else [])

            tasks.start_soon(read)
            await anyio.sleep(RUN_S)
            link = cast("Link", latest(cell, "link"))
            sent = await _counted_by_all(cell, controller, received)
            tasks.cancel_scope.cancel()
        stats = cast("LinkStats", latest(cell, "link_stats"))
    assert received == list(range(received[0], sent + 1))
    assert received[0] <= RATE_HZ  # the client came while the link was starting
    assert stats.rejects == {}
    assert link.requested_hz == RATE_HZ
    assert link.reached_hz is not None
    print(f"\n{RUN_S:g} s at {RATE_HZ} Hz: {sent} frames sent and received, reached {link.reached_hz:g} Hz")
    if SOAK_S:
        assert link.reached_hz >= 0.98 * RATE_HZ


async def _counted_by_all(cell: VirtualCell, controller: VirtualController, received: list[int]) -> int:
    """Wait for a moment in which nothing is under way; the number of frames that everybody has counted then."""
    robot = controller.robot
    for _ in range(2000):
        reading = cell.gateway.bus.topics["r1/joints"].latest
        topic = cell.gateway.bus.topics["r1/joints"]
        assert reading is not None
        published = reading.sample(topic).seq
        if robot.requests == robot.frames == published:
            while received[-1] < published:  # noqa: ASYNC110 - the client's list is no event
                await anyio.sleep(0.001)
            del received[received.index(published) + 1 :]
            return published
        await anyio.sleep(0.0003)
    pytest.fail(f"{robot.frames} frames were sent, {published} published")


@pytest.mark.soak
@pytest.mark.limit(RUN_S + 30)
async def test_chaos_never_makes_a_false_sample_and_the_link_comes_back() -> None:
    memory_kib: list[int] = []
    gaps_s: list[float] = []
    count = 0
    async with (
        virtual_cell("rainbow", settings={"rate_hz": RATE_HZ}, chaos=CHAOS, keep=200) as cell,
        connect(cell.url) as client,
    ):
        (controller,) = cell.controllers
        await client.subscribe(["r1/vendor"], mode="all")
        last_t: int | None = None
        meant: dict[bytes, None] = {}
        with anyio.move_on_after(RUN_S):
            async for sample in samples(client):
                if sample.q not in LIVE:
                    continue
                raw = STATE_580.encode(cast("dict[str, object]", sample.data))
                if raw not in meant:
                    meant = dict.fromkeys(sent.frame for sent in controller.robot.sent)
                assert raw in meant, f"seq {sample.seq} holds values that the controller never sent"
                if last_t is not None:
                    gaps_s.append((sample.t - last_t) / 1e6)
                last_t = sample.t
                count += 1
                if count % 500 == 0:
                    memory_kib.append(_memory_kib())
        stats = cast("LinkStats", latest(cell, "link_stats"))
        faults = dict(controller.robot.faults)
    assert count > 10
    assert sum(stats.rejects.values()) > 0
    assert {"split", "junk", "header", "cut"} <= set(faults)
    print(f"\n{RUN_S:g} s of chaos {CHAOS}: {count} samples, all true; rejects {stats.rejects}; faults {faults}")
    print(f"longest gap {max(gaps_s):.2f} s; sessions {stats.sessions}; memory {memory_kib[0]} to {memory_kib[-1]} KiB")
    if SOAK_S:
        assert max(gaps_s) <= STALL_S + 1.0
        assert memory_kib[-1] <= 1.05 * memory_kib[len(memory_kib) // 3]


def _memory_kib() -> int:
    """Resident memory; ru_maxrss would only ever grow."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * resource.getpagesize() // 1024
