"""Compression out of the way: full blocks wait for a thread, and nobody loses one, gets one twice or out of order."""

from __future__ import annotations

import random
import threading
from collections.abc import AsyncIterator, Iterator, Sequence
from contextlib import asynccontextmanager
from pathlib import Path
from typing import overload

import anyio
import anyio.from_thread
import anyio.lowlevel
import pytest

from gateway.api.model import Fault
from gateway.record.chunks import Block
from gateway.record.packing import MOST_BYTES, Packer
from gateway.record.ring import BLOCK_BYTES, Ring
from gateway.record.spool import Raw
from tests.record.recorder_kit import running_recorder
from tests.record.test_ring import FAULT, Shown, Told, begun, chunks


class Gate(Sequence[Fault]):
    """Faults that hold up whoever compresses a block with them in a thread, until the gate is opened.

    Attributes:
        reached: Set when a thread stands there.
    """

    def __init__(self) -> None:
        self.reached = anyio.Event()
        self._open = threading.Event()

    def open(self) -> None:
        self._open.set()

    def __iter__(self) -> Iterator[Fault]:
        if threading.current_thread() is not threading.main_thread():
            anyio.from_thread.run_sync(self.reached.set)
            assert self._open.wait(10)
        return iter([FAULT])

    def __len__(self) -> int:
        return 1

    @overload
    def __getitem__(self, at: int) -> Fault: ...
    @overload
    def __getitem__(self, at: slice) -> Sequence[Fault]: ...
    def __getitem__(self, at: int | slice) -> Fault | Sequence[Fault]:
        return [FAULT][at]


class Following(Shown):
    """Keeps the blocks that it is shown, and tells when there are so many."""

    def __init__(self) -> None:
        super().__init__()
        self._more = anyio.Event()

    def on_block(self, robot: str, block: Block) -> None:
        super().on_block(robot, block)
        self._more.set()

    async def until(self, count: int) -> None:
        with anyio.fail_after(10):
            while len(self.blocks) < count:
                self._more = anyio.Event()
                await self._more.wait()

    def numbers(self, robot: str = "r1") -> list[int]:
        """What the robot has said, see `fill`."""
        blocks = [block for name, block in self.blocks if name == robot]
        return numbers(blocks)


def numbers(blocks: Sequence[Block]) -> list[int]:
    return [int.from_bytes(chunk.data[:4], "big") for chunk in chunks(blocks) if chunk.kind == "received"]


def fill(ring: Ring, number: int, at_s: float | None = None) -> None:
    """A robot says as much as a block holds, and its number."""
    ring.received(number.to_bytes(4, "big") + bytes(BLOCK_BYTES - 4), number / 1000 if at_s is None else at_s)


@asynccontextmanager
async def packed(packer: Packer | None = None, faults: Sequence[Fault] = ()) -> AsyncIterator[tuple[Ring, Following]]:
    """A ring with a session, whose blocks are compressed in a thread, and a reader; the first block has the faults."""
    packer, told = packer or Packer(gather_s=0.0), Told()
    told.faults = faults
    ring, shown = Ring("r1", 60, 64 << 20, packer), Following()
    ring.readers.append(shown)
    async with anyio.create_task_group() as tasks:
        tasks.start_soon(packer.run)
        await anyio.lowlevel.checkpoint()
        begun(ring, told)
        told.faults = ()
        yield ring, shown
        tasks.cancel_scope.cancel()


async def test_a_full_block_is_not_compressed_by_the_one_who_fills_it_and_shown_when_it_is() -> None:
    async with packed() as (ring, shown):
        for number in range(5):
            fill(ring, number)
        assert (shown.blocks, ring.n_bytes) == ([], 0)
        await shown.until(5)
        assert shown.numbers() == list(range(5))
        assert ring.n_bytes == sum(block.n_bytes for _, block in shown.blocks) > 0
        assert ring.blocks(0.0) == [block for _, block in shown.blocks]


async def test_blocks_in_which_nothing_more_comes_are_compressed_in_the_thread_too() -> None:
    async with packed() as (ring, shown):
        ring.received((7).to_bytes(4, "big"), 0.5)
        ring.close_old_block(0.9)
        ring.close_old_block(1.5)
        assert shown.blocks == []
        await shown.until(1)
        assert shown.numbers() == [7]


async def test_who_asks_gets_what_still_waits_and_nobody_gets_it_twice() -> None:
    async with packed() as (ring, shown):
        fill(ring, 0)
        fill(ring, 1)
        assert numbers(ring.blocks(0.0)) == [0, 1]
        assert shown.numbers() == [0, 1]
        fill(ring, 2)
        await shown.until(3)
        assert shown.numbers() == numbers(ring.blocks(0.0)) == [0, 1, 2]


async def test_who_asks_gets_a_block_that_the_thread_is_at_and_nobody_gets_it_twice() -> None:
    gate = Gate()
    async with packed(faults=gate) as (ring, shown):
        fill(ring, 0)
        await gate.reached.wait()
        fill(ring, 1)
        ring.received((2).to_bytes(4, "big"), 0.002)
        assert numbers(ring.blocks(0.0)) == shown.numbers() == [0, 1, 2]
        assert [block.faults for _, block in shown.blocks] == [(FAULT,), (), ()]
        n_bytes = ring.n_bytes
        gate.open()
        fill(ring, 3)
        await shown.until(4)
        assert shown.numbers() == numbers(ring.blocks(0.0)) == [0, 1, 2, 3]
        assert ring.n_bytes == n_bytes + shown.blocks[-1][1].n_bytes


async def test_many_blocks_do_not_wait_for_more() -> None:
    async with packed(Packer(gather_s=3600)) as (ring, shown):
        for number in range(8):
            fill(ring, number)
        await shown.until(8)
        fill(ring, 8)
        assert shown.numbers() == list(range(8))


async def test_where_no_thread_can_be_started_blocks_are_compressed_all_the_same(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    async def cannot(*_: object, **__: object) -> None:
        raise RuntimeError("can't start new thread")

    monkeypatch.setattr("gateway.record.packing.anyio.to_thread.run_sync", cannot)
    async with packed() as (ring, shown):
        fill(ring, 0)
        await shown.until(1)
        fill(ring, 1)
        await shown.until(2)
        assert shown.numbers() == numbers(ring.blocks(0.0)) == [0, 1]


async def test_what_waits_is_bounded_and_beyond_it_blocks_are_compressed_as_they_are_closed() -> None:
    packer, gate = Packer(gather_s=0.0), Gate()
    async with packed(packer, gate) as (ring, shown):
        fill(ring, 0)
        await gate.reached.wait()
        count = 0
        while not shown.blocks:
            count += 1
            fill(ring, count)
            assert packer._n_bytes <= MOST_BYTES
        assert MOST_BYTES // BLOCK_BYTES - 1 <= count <= MOST_BYTES // BLOCK_BYTES + 1
        fill(ring, count + 1)
        assert shown.numbers() == list(range(count + 2))
        gate.open()
        while packer._n_bytes:
            await anyio.lowlevel.checkpoint()
        fill(ring, count + 2)
        assert len(shown.blocks) == count + 2
        await shown.until(count + 3)
        assert shown.numbers() == list(range(count + 3))


async def test_many_small_chunks_count_with_what_they_take_in_memory() -> None:
    packer = Packer(gather_s=0.0)
    async with packed(packer) as (ring, shown):
        for at in range(1000):
            ring.received(b"x", at / 1000)
        ring.received(b"x", 1.0)
        assert packer._n_bytes > 100_000
        await shown.until(1)
        assert packer._n_bytes == 0


async def test_what_waits_when_the_gateway_ends_is_not_lost() -> None:
    async with packed() as (ring, shown):
        fill(ring, 0)
        fill(ring, 1)
    assert shown.blocks == []
    fill(ring, 2)
    assert shown.numbers() == [0, 1, 2]
    assert numbers(ring.blocks(0.0)) == [0, 1, 2]


async def test_a_block_that_the_thread_is_at_when_the_gateway_ends_is_there_once() -> None:
    packer = Packer(gather_s=0.0)
    ring, shown, told = Ring("r1", 60, 64 << 20, packer), Following(), Told()
    ring.readers.append(shown)
    async with anyio.create_task_group() as tasks:
        tasks.start_soon(packer.run)
        await anyio.lowlevel.checkpoint()
        told.faults = gate = Gate()
        begun(ring, told)
        fill(ring, 0)
        await gate.reached.wait()
        fill(ring, 1)
        tasks.cancel_scope.cancel()
        gate.open()
    assert numbers(ring.blocks(0.0)) == shown.numbers() == [0, 1]


def test_with_a_packer_that_does_not_run_blocks_are_compressed_as_they_are_closed() -> None:
    ring, shown = Ring("r1", 60, 64 << 20, Packer()), Shown()
    ring.readers.append(shown)
    begun(ring)
    fill(ring, 0)
    assert len(shown.blocks) == 1


@pytest.mark.parametrize("seed", range(5))
async def test_whatever_happens_while_the_thread_works_each_block_is_shown_once_and_in_order(seed: int) -> None:
    chance = random.Random(seed)  # noqa: S311 - what happens when
    packer, shown = Packer(gather_s=0.0), Following()
    rings = [Ring(name, 3600, 64 << 20, packer) for name in ("r1", "r2", "r3")]
    said: dict[str, list[int]] = {ring.robot: [] for ring in rings}
    async with anyio.create_task_group() as tasks:
        tasks.start_soon(packer.run)
        await anyio.lowlevel.checkpoint()
        for ring in rings:
            ring.readers.append(shown)
            begun(ring)
        for number in range(200):
            ring = chance.choice(rings)
            said[ring.robot].append(number)
            ring.received(number.to_bytes(4, "big") + chance.randbytes(BLOCK_BYTES // 3), number / 1000)
            if chance.random() < 0.1:
                assert numbers(ring.blocks(0.0)) == said[ring.robot] == shown.numbers(ring.robot)
            for _ in range(chance.choice([0, 0, 1, 5])):
                await anyio.lowlevel.checkpoint()
        tasks.cancel_scope.cancel()
    for ring in rings:
        assert numbers(ring.blocks(0.0)) == said[ring.robot] == shown.numbers(ring.robot)


async def test_a_stream_that_begins_while_blocks_wait_gets_each_of_them_once(tmp_path: Path) -> None:
    async with running_recorder(tmp_path, ring_bytes=64 << 20) as kit:
        kit.robot("r1")
        ring, shown = kit.recorder.rings["r1"], Following()
        ring.readers.append(shown)
        await kit.until(lambda: kit.recorder._packer._is_running)
        fill(ring, 0, kit.clock.monotonic())
        assert shown.blocks == []
        with kit.recorder.streaming(lambda _: True) as one:
            fill(ring, 1, kit.clock.monotonic())
            with kit.recorder.streaming(lambda _: True) as other:
                fill(ring, 2, kit.clock.monotonic())
                await shown.until(3)
                assert len(one._waiting) == len(other._waiting) == 4  # the beginning, and three blocks


async def test_a_capture_has_what_waits(tmp_path: Path) -> None:
    async with running_recorder(tmp_path, ring_bytes=64 << 20) as kit:
        kit.robot("r1")
        await kit.until(lambda: kit.recorder._packer._is_running)
        ring = kit.recorder.rings["r1"]
        ring.received(bytes(BLOCK_BYTES), kit.clock.monotonic())
        assert kit.recorder.info.ring_bytes == 0
        blocks = [message.block for message in kit.recorder.capture("r1", 10) if isinstance(message, Raw)]
        assert [len(chunk.data) for chunk in chunks(blocks)] == [0, BLOCK_BYTES]
        assert kit.recorder.info.ring_bytes == sum(block.n_bytes for block in blocks) > 0


async def test_a_robot_that_is_forgotten_while_its_blocks_wait_is_shown_whole_and_never_again(tmp_path: Path) -> None:
    async with running_recorder(tmp_path, ring_bytes=64 << 20) as kit:
        kit.robot("r1")
        kit.robot("r2")
        await kit.until(lambda: kit.recorder._packer._is_running)
        gone, other, shown = kit.recorder.rings["r1"], kit.recorder.rings["r2"], Following()
        gone.readers.append(shown)
        other.readers.append(shown)
        fill(gone, 0, kit.clock.monotonic())
        kit.recorder.forget("r1")
        assert shown.numbers("r1") == [0]
        fill(gone, 1, kit.clock.monotonic())  # its session has not ended yet
        fill(other, 2, kit.clock.monotonic())
        await shown.until(2)
        assert (shown.numbers("r1"), shown.numbers("r2")) == ([0], [2])


async def test_a_recording_that_the_end_of_the_gateway_finishes_has_what_waits(tmp_path: Path) -> None:
    async with running_recorder(tmp_path, after_s=60.0, ring_bytes=64 << 20) as kit:
        kit.robot("r1")
        kit.recorder.snapshot()
        await kit.until(lambda: bool(kit.writers.made) and bool(kit.writers.made[0].got))
        kit.say("r1", bytes(BLOCK_BYTES))
        kit.say("r1", b"last words")
    (written,) = kit.writers.made
    assert [len(data) for data in written.data] == [BLOCK_BYTES, len(b"last words")]
