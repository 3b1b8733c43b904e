"""Compression out of the way: the sessions only close their blocks, and a thread compresses them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import anyio
import anyio.to_thread
import zstandard

from gateway.api.model import Fault
from gateway.record.chunks import Block, Chunk, compressor, pack

# What may wait for the thread; more than that is compressed on the loop. About 1 s of 16 robots.
MOST_BYTES = 4_000_000
# What is closed within this time is compressed in one go: calling the thread costs a third of compressing a block.
GATHER_S = 0.1
# So many blocks in one go at most: all of them are handed on at once, and meanwhile no frame is read.
_BATCH = 8


@dataclass(slots=True, eq=False)
class Closed:
    """A closed block that waits to be compressed.

    Attributes:
        chunks: In order; nobody changes them any more.
        faults: What stood before the first.
        opening: The opening of their session, where it is over.
        last_s: Monotonic time of the last chunk, s.
        n_bytes: What they take in memory, roughly.
        block: The chunks, compressed; None: not yet.
    """

    chunks: Sequence[Chunk]
    faults: Sequence[Fault]
    opening: Sequence[Chunk]
    last_s: float
    n_bytes: int
    block: Block | None = None

    def pack(self, own: zstandard.ZstdCompressor | None = None) -> None:
        """Compress it, unless somebody has: loop and thread may both do so at a time, and come to the same.

        Args:
            own: The compressor of the thread that calls; None: it is the main thread.
        """
        if self.block is None:
            self.block = pack(self.chunks, self.faults, self.opening, own)


class Packer:
    """Compresses the closed blocks of all rings in a thread, one after the other.

    Args:
        gather_s: How long it waits for further blocks when one has come, in s; not where a batch is complete.
    """

    def __init__(self, gather_s: float = GATHER_S) -> None:
        self._gather_s = gather_s
        self._waiting: list[tuple[Closed, Callable[[], None]]] = []
        self._n_bytes = 0
        self._more, self._many = anyio.Event(), anyio.Event()
        self._is_running = False

    def take(self, closed: Closed, done: Callable[[], None]) -> bool:
        """Take a block; not if nobody would compress it, or if too much waits.

        Args:
            closed: The block. Whoever needs it before it is done packs it and need not say so.
            done: Called on the loop some time after it has been compressed.
        """
        if not self._is_running or self._n_bytes + closed.n_bytes > MOST_BYTES:
            return False
        self._waiting.append((closed, done))
        self._n_bytes += closed.n_bytes
        self._more.set()
        if len(self._waiting) >= _BATCH:
            self._many.set()
        return True

    async def run(self) -> None:
        """Compress what comes until cancelled; what is left then is for the rings to pack, which still have it."""
        limiter, own = anyio.CapacityLimiter(1), compressor()
        self._is_running = True
        try:
            while True:
                await self._more.wait()
                with anyio.move_on_after(self._gather_s):
                    await self._many.wait()
                self._more, self._many = anyio.Event(), anyio.Event()
                while self._waiting:
                    await self._pack_some(limiter, own)
        finally:
            self._is_running = False
            self._waiting, self._n_bytes = [], 0

    async def _pack_some(self, limiter: anyio.CapacityLimiter, own: zstandard.ZstdCompressor) -> None:
        batch = self._waiting[:_BATCH]
        del self._waiting[:_BATCH]
        work = partial(_pack, [closed for closed, _ in batch], own)
        try:
            await anyio.to_thread.run_sync(work, limiter=limiter)
        except RuntimeError:  # the system starts no thread (pids limit): better late than not at all
            work()
        for closed, done in batch:
            self._n_bytes -= closed.n_bytes
            done()


def _pack(blocks: list[Closed], own: zstandard.ZstdCompressor) -> None:
    for closed in blocks:
        closed.pack(own)
