"""Chunks: what one read received or one write sent, with all that a replay needs to tell the same samples again."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Literal

import msgspec
import zstandard

from gateway.api.model import Fault, Quality

Kind = Literal["begin", "received", "sent", "silent", "expired", "end"]
# Fast: the rings are compressed all the time, and frames of robots that stand still shrink at any level.
_LEVEL = 1
_PARAMETERS = zstandard.ZstdCompressionParameters.from_level(_LEVEL, write_checksum=True, write_content_size=True)


class Chunk(msgspec.Struct, frozen=True, array_like=True, gc=False):
    """One read, one write, or another moment of a session.

    Attributes:
        t: µs UTC, as the samples that follow from it have it.
        kind: What it is: bytes received or sent, a session that begins or ends, or that the gateway said that no more
            values come, or that some have become too old.
        data: The bytes, of a datagram exactly one; of `silent` a `Silence`; else empty.
        epoch: The epoch that ran before it.
        seqs: The number of the last sample before it; by group, where frames bring the state in parts. None: not told,
            the numbers go on.
    """

    t: int
    kind: Kind
    data: bytes
    epoch: str
    seqs: int | dict[str, int] | None


class Silence(msgspec.Struct, frozen=True, array_like=True):
    """What was said when no more values came.

    Attributes:
        quality: STALE or DISCONNECTED.
        t_last: Time of the last frame, µs UTC; None: there was none.
    """

    quality: Quality
    t_last: int | None


class Block(msgspec.Struct, frozen=True, kw_only=True):
    """Some chunks in a row, compressed.

    Attributes:
        first_t: Of the first chunk, µs UTC.
        last_t: Of the last chunk, µs UTC.
        faults: The faults that stood before the first chunk, with the time since when.
        opening: What was exchanged in the session that the first chunk belongs to, until its first good frame: a reader
            that begins here has to know it. Empty where the block holds it itself.
        packed: The chunks, msgpack in zstandard.
    """

    first_t: int
    last_t: int
    faults: tuple[Fault, ...]
    opening: tuple[Chunk, ...]
    packed: bytes

    @property
    def n_bytes(self) -> int:
        """What it takes in memory, roughly."""
        return len(self.packed)

    def chunks(self) -> list[Chunk]:
        """The chunks again."""
        return _DECODER.decode(zstandard.ZstdDecompressor().decompress(self.packed))


def compressor() -> zstandard.ZstdCompressor:
    """A compressor: two threads must not use one at the same time."""
    return zstandard.ZstdCompressor(compression_params=_PARAMETERS)


_COMPRESSOR = compressor()
_ENCODER = msgspec.msgpack.Encoder()
_DECODER = msgspec.msgpack.Decoder(list[Chunk])


def pack(
    chunks: Sequence[Chunk],
    faults: Iterable[Fault],
    opening: Sequence[Chunk],
    own: zstandard.ZstdCompressor | None = None,
) -> Block:
    """Compress some chunks.

    Args:
        chunks: In order; at least one.
        faults: What stood before the first.
        opening: The opening of their session, where it is over.
        own: The compressor of the thread that calls; None: it is the main thread.
    """
    # A copy: the compressor shrinks a buffer of the largest size, and the rest of it could be used for nothing.
    packed = bytes(memoryview((own or _COMPRESSOR).compress(_ENCODER.encode(chunks))))
    return Block(first_t=chunks[0].t, last_t=chunks[-1].t, faults=tuple(faults), opening=tuple(opening), packed=packed)


def before(block: Block, t: int) -> Block | None:
    """What a block holds before a time, µs UTC; None: nothing."""
    if block.first_t < t and block.last_t < t:
        return block
    early = [chunk for chunk in block.chunks() if chunk.t < t] if min(block.first_t, block.last_t) < t else []
    return pack(early, block.faults, block.opening) if early else None
