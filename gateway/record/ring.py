"""The ring of one robot: the bytes of its last seconds, compressed, bounded in time and in memory."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from typing import Protocol

import msgspec

from gateway.api.model import Fault, Quality
from gateway.core.tap import Told
from gateway.record.chunks import Block, Chunk, Kind, Silence
from gateway.record.packing import Closed, Packer

# A block is closed when it spans so long or holds so much.
BLOCK_S = 1.0
BLOCK_BYTES = 128 * 1024
# What a session may exchange before its first good frame; of one that never comes so far the oldest is forgotten.
OPENING_BYTES = 256 * 1024
# What a chunk takes in memory besides its bytes, roughly.
_CHUNK_BYTES = 128


class Reader(Protocol):
    """Who reads on while the ring is written."""

    def on_block(self, robot: str, block: Block) -> None:
        """A block of a robot was closed, and has been compressed."""
        ...


class Ring:
    """Keeps what a robot's sessions received and sent: a `gateway.core.tap.Tap`.

    Args:
        robot: Its name.
        seconds: How long it is kept, in s.
        n_bytes: How much memory the compressed blocks may take.
        packer: Compresses full blocks while the session goes on; None: they are compressed as they are closed.

    Attributes:
        readers: Who is shown each block when it has been compressed.
        dropped: How many blocks were dropped before their time, for want of room.
    """

    def __init__(self, robot: str, seconds: float, n_bytes: int, packer: Packer | None = None) -> None:
        self.robot = robot
        self._keep_s = seconds
        self._most_bytes = n_bytes
        self._packer = packer
        self._waiting: deque[Closed] = deque()  # behind the blocks
        self._blocks: deque[tuple[float, Block]] = deque()  # with the monotonic time of their last chunk, s
        self._n_bytes = 0
        self._open: list[Chunk] = []
        self._first_s = self._last_s = 0.0
        self._open_bytes = 0
        self._open_faults: Sequence[Fault] = ()
        self._open_opening: Sequence[Chunk] = ()
        self._stamp: Callable[[float], int] | None = None
        self._told: Told | None = None
        self._opening: list[Chunk] = []
        self._opening_bytes = 0
        self._is_opening = False
        self.readers: list[Reader] = []
        self.dropped = 0

    @property
    def n_bytes(self) -> int:
        """What is kept, compressed."""
        return self._n_bytes

    @property
    def span_s(self) -> float:
        """How long ago the oldest block ended when the newest did, in s."""
        return self._blocks[-1][0] - self._blocks[0][0] if self._blocks else 0.0

    def resize(self, seconds: float, n_bytes: int) -> None:
        """Keep more or less from now on."""
        self._keep_s, self._most_bytes = seconds, n_bytes

    def shorten(self) -> bool:
        """Drop the oldest block before its time, unless it is the only one; whether it was dropped."""
        if len(self._blocks) <= 1:
            return False
        self._n_bytes -= self._blocks.popleft()[1].n_bytes
        self.dropped += 1
        return True

    def begin(self, at_s: float, stamp: Callable[[float], int], told: Told) -> None:
        """A session has begun."""
        self._stamp, self._told = stamp, told
        self._opening, self._opening_bytes, self._is_opening = [], 0, True
        self._add("begin", b"", at_s)

    def received(self, data: bytes, at_s: float) -> None:
        """Bytes were received."""
        self._add("received", data, at_s)

    def sent(self, data: bytes, at_s: float) -> None:
        """Bytes were sent."""
        self._add("sent", data, at_s)

    def online(self) -> None:
        """The first good frame has come."""
        self._is_opening = False

    def silent(self, quality: Quality, t_last: int | None, at_s: float) -> None:
        """It is said that no more values come."""
        self._add("silent", msgspec.json.encode(Silence(quality, t_last)), at_s)

    def expired(self, at_s: float) -> None:
        """It was said that some values are too old."""
        self._add("expired", b"", at_s)

    def end(self, at_s: float) -> None:
        """The session is over."""
        self._add("end", b"", at_s)
        self._opening, self._is_opening = [], False

    def blocks(self, since_s: float) -> list[Block]:
        """Every block that holds something from a monotonic time on, s; the one that is being written is closed."""
        self.close_block()
        return [block for last_s, block in self._blocks if last_s >= since_s]

    def close_old_block(self, now_s: float) -> None:
        """Close the block that is being written if it began long ago, monotonic: nothing may come for hours."""
        if self._open and now_s - self._first_s >= BLOCK_S:
            self._close()

    def close_block(self) -> None:
        """Close the block that is being written, if there is one; the readers have everything then."""
        if self._open:
            self._set_aside()
        self._pack_waiting()

    def _close(self) -> None:
        """Close the block that is being written, in no time: the frame that has filled it has not been read yet."""
        closed = self._set_aside()
        if self._packer is None or not self._packer.take(closed, self._keep_packed):
            self._pack_waiting()

    def _set_aside(self) -> Closed:
        n_bytes = self._open_bytes + _CHUNK_BYTES * len(self._open)
        closed = Closed(self._open, self._open_faults, self._open_opening, self._last_s, n_bytes)
        self._open, self._open_bytes = [], 0
        self._waiting.append(closed)
        return closed

    def _pack_waiting(self) -> None:
        """Compress what waits here and now; what the packer still has of it, it finds done."""
        for closed in self._waiting:
            closed.pack()
        self._keep_packed()

    def _keep_packed(self) -> None:
        """Keep what has been compressed, in order."""
        while self._waiting and (block := self._waiting[0].block) is not None:
            self._keep(self._waiting.popleft().last_s, block)

    def _keep(self, last_s: float, block: Block) -> None:
        self._blocks.append((last_s, block))
        self._n_bytes += block.n_bytes
        while last_s - self._blocks[0][0] > self._keep_s:
            self._n_bytes -= self._blocks.popleft()[1].n_bytes
        while self._n_bytes > self._most_bytes and self.shorten():
            pass
        for reader in self.readers:
            reader.on_block(self.robot, block)

    def _add(self, kind: Kind, data: bytes, at_s: float) -> None:
        if self._told is None or self._stamp is None:
            return
        t = self._stamp(at_s)
        chunk = Chunk(t, kind, data, self._told.epoch, self._told.seqs)  # type: ignore[arg-type] # a dict of its own
        if not self._open:
            self._first_s = at_s
            self._open_faults = self._told.faults
            self._open_opening = () if kind == "begin" else tuple(self._opening)
        self._open.append(chunk)
        self._last_s = at_s
        self._open_bytes += len(data)
        if self._is_opening:
            self._keep_opening(chunk)
        if self._open_bytes >= BLOCK_BYTES or at_s - self._first_s >= BLOCK_S:
            self._close()

    def _keep_opening(self, chunk: Chunk) -> None:
        self._opening.append(chunk)
        self._opening_bytes += len(chunk.data)
        while self._opening_bytes > OPENING_BYTES:
            self._opening_bytes -= len(self._opening.pop(0).data)
