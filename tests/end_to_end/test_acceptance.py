"""The acceptance runs: short in `make check`, at full length by `make soak`, with the same code."""

from __future__ import annotations

import asyncio
import os
import resource
from collections.abc import AsyncIterator, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import cast

import anyio
import pytest

from gateway.api.messages import Data, Missed
from gateway.api.model import Link, LinkStats, Quality, Sample
from gateway.client import Client, connect
from gateway.sim.chaos import ChaosPlan, parse_chaos
from gateway.sim.server import VirtualController
from gateway.testing.cell import VirtualCell, virtual_cell
from vendors.rainbow.layouts import STATE_580

SOAK_S = float(os.environ.get("SOAK_SECONDS", "0"))
RUN_S = SOAK_S or 6.0
CHAOS_S = SOAK_S or 9.0
RATE_HZ = 500
ROBOTS = 8
PERIOD_MS = 8
STEADY = "split=0.2,coalesce=0.1,junk=0.05,"
# In the short run everything happens at least twice; in the long one there is time to get into one's stride between.
CHAOS = STEADY + ("header=0.0007,stall=1.5/9,cut=3" if SOAK_S else "header=0.003,stall=1.3/4,cut=1.4")
RECOVERY_S = 1.0
SILENT = {Quality.STALE, Quality.DISCONNECTED}
_WATCH_S = 0.002
_GAP_S = 0.05


async def samples(client: Client) -> AsyncIterator[Sample]:
    """Every sample; nothing may be missed."""
    async for message in client.pushed():
        assert not isinstance(message, Missed)
        if isinstance(message, Data):
            for sample in message.samples:
                yield sample


def latest(cell: VirtualCell, topic_name: str) -> object:
    topic = cell.gateway.bus.topics[topic_name]
    assert topic.latest is not None
    return topic.latest.sample(topic).data


@pytest.mark.soak
@pytest.mark.limit(RUN_S + 30)
async def test_every_frame_of_a_fast_controller_reaches_a_client_that_asks_for_all() -> None:
    async with virtual_cell("rainbow", scenario="steady", settings={"rate_hz": RATE_HZ}) as cell:
        sent = await _run_and_count(cell)
        stats = cast("LinkStats", latest(cell, "r1/link_stats"))
        link = cast("Link", latest(cell, "r1/link"))
    assert stats.rejects == {}
    assert link.requested_hz == RATE_HZ
    assert link.reached_hz is not None
    print(f"\n{RUN_S:g} s at {RATE_HZ} Hz: {sent[0]} frames sent and received, reached {link.reached_hz:g} Hz")
    if SOAK_S:
        assert link.reached_hz >= 0.98 * RATE_HZ


@pytest.mark.soak
@pytest.mark.limit(RUN_S + 30)
async def test_every_frame_of_eight_pushing_controllers_reaches_a_client_that_asks_for_all() -> None:
    settings = {"cnde": {"period_ms": PERIOD_MS}}
    async with virtual_cell("fairino", protocol="cnde", count=ROBOTS, settings=settings) as cell:
        sent = await _run_and_count(cell)
        stats = [cast("LinkStats", latest(cell, f"r{number}/link_stats")) for number in range(1, ROBOTS + 1)]
    assert [one.rejects for one in stats] == [{}] * ROBOTS
    assert [one.sessions for one in stats] == [1] * ROBOTS
    rate_hz = min(sent) / RUN_S
    print(
        f"\n{RUN_S:g} s, {ROBOTS} controllers at {PERIOD_MS} ms: {sum(sent)} frames sent and received, {rate_hz:.1f} Hz"
    )
    if SOAK_S:
        assert rate_hz >= 0.95 * 1000 / PERIOD_MS  # the handshakes included


async def _run_and_count(cell: VirtualCell) -> list[int]:
    """Let a client take all samples of every robot for the run.

    Returns:
        For each controller, the number of frames that it has sent, the gateway has published and the client has got.
    """
    received: dict[str, list[int]] = {f"r{number}": [] for number in range(1, len(cell.controllers) + 1)}
    async with connect(cell.url) as client:
        await client.subscribe(["*/joints"], mode="all")
        async with anyio.create_task_group() as tasks:

            async def read() -> None:
                async for sample in samples(client):
                    if sample.q not in SILENT:
                        received[sample.topic.partition("/")[0]].append(sample.seq)

            tasks.start_soon(read)
            await anyio.sleep(RUN_S)
            pairs = zip(cell.controllers, received, strict=True)
            sent = [await _counted_by_all(cell, controller, name, received[name]) for controller, name in pairs]
            tasks.cancel_scope.cancel()
    for name, last in zip(received, sent, strict=True):
        first = received[name][0]
        assert first <= last / 4, f"{name}: the client came while the link was starting, not at frame {first}"
        assert received[name][: last - first + 1] == list(range(first, last + 1)), f"{name}: samples are missing"
    return sent


async def _counted_by_all(cell: VirtualCell, controller: VirtualController, name: str, received: list[int]) -> int:
    """Wait for a moment in which nothing is under way; the number of frames that everybody has counted then."""
    topic = cell.gateway.bus.topics[f"{name}/joints"]
    for _ in range(2000):
        assert topic.latest is not None
        published = topic.latest.sample(topic).seq
        if controller.robot.frames == published:
            while received[-1] < published:  # noqa: ASYNC110 - the client's list is no event
                await anyio.sleep(0.001)
            return published
        await anyio.sleep(0.0003)
    pytest.fail(f"{name}: {controller.robot.frames} frames were sent, {published} published")


@dataclass
class Course:
    """What happened in a run of chaos, in the loop's time.

    Attributes:
        hits: Each cut and each damaged header: when, and what.
        resumed: Each first live sample of a session or after a gap: when, and of which session.
        gaps_s: How long each gap was.
    """

    hits: list[tuple[float, str]] = field(default_factory=list)
    resumed: list[tuple[float, str]] = field(default_factory=list)
    gaps_s: list[float] = field(default_factory=list)
    last_s: float | None = None

    def arrived(self, now_s: float, epoch: str) -> None:
        """Take note of a live sample."""
        gap_s = 0.0 if self.last_s is None else now_s - self.last_s
        if gap_s >= _GAP_S or not self.resumed or self.resumed[-1][1] != epoch:
            self.resumed.append((now_s, epoch))
            self.gaps_s.append(gap_s)
        self.last_s = now_s

    async def watch(self, controller: VirtualController) -> None:
        """Take note of what hits the controller, until cancelled."""
        faults, seen = controller.robot.faults, {"cut": 0, "header": 0}
        while True:
            now_s = asyncio.get_running_loop().time()
            for name, count in seen.items():
                if faults[name] != count:
                    seen[name] = faults[name]
                    self.hits.append((now_s, name))
            await anyio.sleep(_WATCH_S)

    def recoveries(self, plan: ChaosPlan, start_s: float, end_s: float) -> Iterator[tuple[str, float]]:
        """Tell how long after each return of the controller the first live sample came.

        A controller returns at once when a connection is cut, and at the end of a stall. Where it is hit again before
        the sample came, and before it was due, it is the later return that counts: a damaged header, too, costs a
        polled session its answer.
        """
        stalls = [start_s + number * plan.stall_every_s for number in range(1, 1 + int(end_s / plan.stall_every_s))]
        returns = [(at_s, "cut") for at_s, name in self.hits if name == "cut" and not plan.silent(at_s - start_s)]
        returns += [(at_s, "stall") for at_s in stalls if at_s < end_s]
        hits = [at_s for at_s, _ in self.hits] + [at_s - plan.stall_s for at_s in stalls]
        for at_s, name in sorted(returns):
            before = [epoch for resumed_s, epoch in self.resumed if resumed_s <= at_s]
            back_s = next(
                (
                    resumed_s
                    for resumed_s, epoch in self.resumed
                    if resumed_s > at_s and (name == "stall" or [epoch] != before[-1:])
                ),
                end_s,
            )
            if not any(at_s < hit_s <= min(back_s, at_s + RECOVERY_S) for hit_s in [*hits, end_s]):
                yield name, back_s - at_s


@pytest.mark.soak
@pytest.mark.limit(CHAOS_S + 30)
async def test_chaos_never_makes_a_false_sample_and_the_link_comes_back() -> None:
    memory_kib: list[int] = []
    course = Course()
    count = 0
    async with (
        virtual_cell("rainbow", settings={"rate_hz": RATE_HZ}, chaos=CHAOS, keep=200) as cell,
        connect(cell.url) as client,
        anyio.create_task_group() as tasks,
    ):
        (controller,) = cell.controllers
        tasks.start_soon(course.watch, controller)
        await client.subscribe(["r1/vendor"], mode="all")
        meant: dict[bytes, None] = {}
        with anyio.move_on_after(CHAOS_S):
            async for sample in samples(client):
                if sample.q in SILENT:
                    continue
                raw = STATE_580.encode(cast("dict[str, object]", sample.data))
                if raw not in meant:
                    meant = dict.fromkeys(sent.frame for sent in controller.robot.sent)
                assert raw in meant, f"seq {sample.seq} holds values that the controller never sent"
                course.arrived(asyncio.get_running_loop().time(), sample.epoch)
                count += 1
                if count % 500 == 0:
                    memory_kib.append(_memory_kib())
        end_s = asyncio.get_running_loop().time()
        stats = cast("LinkStats", latest(cell, "r1/link_stats"))
        faults = dict(controller.robot.faults)
        tasks.cancel_scope.cancel()
    found = list(course.recoveries(parse_chaos(CHAOS), controller.start_s, end_s))
    print(f"\n{CHAOS_S:g} s of chaos {CHAOS}: {count} samples, all true; rejects {stats.rejects}; faults {faults}")
    print(f"sessions {stats.sessions}; longest gap {max(course.gaps_s):.2f} s; memory {_ends(memory_kib)} KiB")
    for name in ("cut", "stall"):
        taken_s = [one for what, one in found if what == name]
        longest = f", at most {max(taken_s):.2f} s" if taken_s else ""
        print(f"samples again after a {name}: {len(taken_s)} times{longest}")
    assert count > 10
    assert sum(stats.rejects.values()) > 0
    assert {"split", "coalesce", "junk", "header", "stall", "cut"} <= set(faults)
    assert found, "not one return of the controller could be timed"
    if SOAK_S:
        assert {name for name, _ in found} == {"cut", "stall"}
        assert max(taken_s for _, taken_s in found) <= RECOVERY_S
        assert memory_kib[-1] <= 1.05 * memory_kib[len(memory_kib) // 3]


def test_a_recovery_is_timed_from_the_controllers_own_return() -> None:
    plan = parse_chaos("stall=2/10,cut=3")
    course = Course(
        hits=[(3.0, "cut"), (9.0, "cut"), (12.0, "cut"), (12.1, "header")],
        resumed=[(0.5, "a"), (3.25, "b"), (10.5, "c"), (13.5, "d")],
    )
    assert list(course.recoveries(plan, start_s=0.0, end_s=15.0)) == [("cut", 0.25), ("stall", 0.5)]
    lost = Course(hits=[(3.0, "cut")], resumed=[(0.5, "a")])
    assert list(lost.recoveries(plan, start_s=0.0, end_s=3.5)) == []  # it was not due yet
    assert list(lost.recoveries(plan, start_s=0.0, end_s=9.5)) == [("cut", 6.5)]


def _ends(values: Sequence[int]) -> str:
    return f"{values[0]} to {values[-1]}" if values else "not measured"


def _memory_kib() -> int:
    """Resident memory; ru_maxrss would only ever grow."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * resource.getpagesize() // 1024
