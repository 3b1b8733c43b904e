"""The ring of a robot: what is kept of its sessions, how long, and what a reader needs to begin anywhere in it."""

from __future__ import annotations

import itertools
import random
from collections.abc import Sequence

import pytest

from gateway.api.model import Fault, Quality
from gateway.record.chunks import Block, Chunk
from gateway.record.ring import BLOCK_BYTES, OPENING_BYTES, Ring

FAULT = Fault(code="7", text="jammed", since=5)


class Told:
    """What a publisher has told so far."""

    def __init__(self) -> None:
        self.epoch = "b00t.1"
        self.seqs = 0
        self.faults: Sequence[Fault] = ()


class Shown:
    """Keeps the blocks that it is shown."""

    def __init__(self) -> None:
        self.blocks: list[tuple[str, Block]] = []

    def on_block(self, robot: str, block: Block) -> None:
        self.blocks.append((robot, block))


def stamp(at_s: float) -> int:
    """A wall clock that runs with the monotonic one."""
    return int(at_s * 1e6) + 1_000_000_000


def chunks(blocks: Sequence[Block]) -> list[Chunk]:
    return list(itertools.chain.from_iterable(block.chunks() for block in blocks))


def begun(ring: Ring, told: Told | None = None, at_s: float = 0.0) -> Told:
    told = told or Told()
    ring.begin(at_s, stamp, told)
    return told


def test_what_a_session_received_and_sent_is_kept_in_order_with_its_times_and_numbers() -> None:
    ring = Ring("r1", 60, 1 << 20)
    told = begun(ring)
    ring.sent(b"ask", 0.1)
    ring.received(b"answer", 0.2)
    told.seqs = 1
    ring.received(b"more", 0.3)
    ring.silent(Quality.STALE, 7, 0.4)
    ring.end(0.5)
    assert [
        (chunk.kind, chunk.data, chunk.t, chunk.seqs) for chunk in chunks(ring.blocks(0.0)) if chunk.kind != "silent"
    ] == [
        ("begin", b"", stamp(0.0), 0),
        ("sent", b"ask", stamp(0.1), 0),
        ("received", b"answer", stamp(0.2), 0),
        ("received", b"more", stamp(0.3), 1),
        ("end", b"", stamp(0.5), 1),
    ]


def test_a_block_is_closed_after_a_second_or_when_it_is_full() -> None:
    ring = Ring("r1", 60, 64 << 20)
    shown = Shown()
    ring.readers.append(shown)
    begun(ring)
    for at in range(30):
        ring.received(b"x" * 10, at / 10)
    assert [robot for robot, _ in shown.blocks] == ["r1", "r1"]
    ring.received(bytes(BLOCK_BYTES), 3.0)
    assert len(shown.blocks) == 3
    assert len(chunks([block for _, block in shown.blocks])) == 32


def test_blocks_that_are_too_old_are_dropped() -> None:
    ring = Ring("r1", 5, 1 << 20)
    begun(ring)
    for second in range(100):
        ring.received(b"%d" % second, float(second))
    kept = [int(chunk.data) for chunk in chunks(ring.blocks(0.0))]
    assert kept == list(range(kept[0], 100))
    assert 5 <= 99 - kept[0] <= 8
    assert ring.dropped == 0


def test_what_does_not_fit_is_dropped_from_the_oldest_on_and_counted() -> None:
    chance = random.Random(1)  # noqa: S311 - bytes that do not shrink
    ring = Ring("r1", 3600, 100_000)
    begun(ring)
    for second in range(50):
        ring.received(chance.randbytes(20_000), second * 2.0)
    assert ring.n_bytes <= 100_000
    assert ring.dropped > 0
    assert chunks(ring.blocks(0.0))[-1].t == stamp(98.0)


def test_a_block_in_the_middle_of_a_session_knows_what_opened_it() -> None:
    ring = Ring("r1", 5, 1 << 20)
    begun(ring)
    ring.sent(b"hello", 0.1)
    ring.received(b"welcome", 0.2)
    ring.received(b"first frame", 0.3)
    ring.online()
    for second in range(1, 60):
        ring.received(b"frame", float(second))
    first = ring.blocks(0.0)[0]
    assert [(chunk.kind, chunk.data) for chunk in first.opening] == [
        ("begin", b""),
        ("sent", b"hello"),
        ("received", b"welcome"),
        ("received", b"first frame"),
    ]


def test_an_opening_that_never_ends_is_bounded() -> None:
    ring = Ring("r1", 5, 64 << 20)
    begun(ring)
    for second in range(40):
        ring.received(bytes(OPENING_BYTES // 8), float(second))
    opening = ring.blocks(0.0)[-1].opening
    assert sum(len(chunk.data) for chunk in opening) <= OPENING_BYTES


def test_a_new_session_forgets_the_opening_of_the_last_one() -> None:
    ring = Ring("r1", 60, 1 << 20)
    begun(ring)
    ring.received(b"old", 0.1)
    ring.end(0.2)
    begun(ring, at_s=5.0)
    ring.received(b"new", 5.1)
    ring.online()
    ring.received(b"later", 7.0)
    ring.received(b"last", 9.0)
    assert [chunk.data for chunk in ring.blocks(0.0)[-1].opening] == [b"", b"new"]


def test_a_block_knows_the_faults_that_stood_before_it() -> None:
    ring = Ring("r1", 60, 1 << 20)
    told = begun(ring)
    ring.received(b"a", 0.5)
    ring.received(b"b", 1.5)
    told.faults = (FAULT,)
    ring.received(b"c", 2.0)
    assert [block.faults for block in ring.blocks(0.0)] == [(), (FAULT,)]


@pytest.mark.parametrize("jump_s", [-3600.0, 3600.0])
def test_a_wall_clock_that_jumps_neither_keeps_blocks_for_ever_nor_drops_them(jump_s: float) -> None:
    ring = Ring("r1", 10, 1 << 20)
    told = Told()
    offset = [0.0]
    ring.begin(0.0, lambda at_s: stamp(at_s + offset[0]), told)
    for second in range(30):
        if second == 25:
            offset[0] = jump_s
        ring.received(b"%d" % second, float(second))
    kept = [int(chunk.data) for chunk in chunks(ring.blocks(0.0))]
    assert 10 <= len(kept) <= 13
    assert kept[-1] == 29


def test_before_the_first_session_nothing_is_kept() -> None:
    ring = Ring("r1", 10, 1 << 20)
    ring.received(b"x", 0.0)
    ring.end(1.0)
    assert ring.blocks(0.0) == []
