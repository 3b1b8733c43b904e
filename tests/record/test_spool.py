"""The spool: messages of a stream that may be cut anywhere, and what is no stream of ours."""

from __future__ import annotations

import random
import struct

import pytest

from gateway.record.chunks import Chunk, before, pack
from gateway.record.spool import Begin, End, Lost, Message, Raw, Said, SpoolError, SpoolReader, encode

BLOCK = pack([Chunk(1, "received", b"abc", "e.1", 1), Chunk(5, "received", b"def", "e.1", 2)], (), ())
MESSAGES: list[Message] = [
    Begin(robots="", vendor_dirs=["/a"], from_t=1, reason={"trigger": "x"}, gateway="1"),
    Raw(robot="r1", block=BLOCK),
    Said(topic="r1/link", t=2, seq=3, data=b"{}"),
    Lost(n_messages=2, n_bytes=10),
    End(to_t=9, more={"again": "y"}),
]
STREAM = b"".join(map(encode, MESSAGES))


def test_a_stream_is_read_whole_byte_by_byte_and_in_any_cuts() -> None:
    assert list(SpoolReader().feed(STREAM)) == MESSAGES
    chance = random.Random(1)  # noqa: S311 - cuts
    for sizes in ([1] * len(STREAM), [chance.randint(1, 40) for _ in range(len(STREAM))]):
        reader, found, at = SpoolReader(), list[Message](), 0
        for size in sizes:
            found += reader.feed(STREAM[at : at + size])
            at += size
        assert found == MESSAGES


def test_half_a_message_is_none() -> None:
    assert list(SpoolReader().feed(STREAM[:-1])) == MESSAGES[:-1]


@pytest.mark.parametrize(
    "data",
    [b"GET / HTTP/1.1\r\n\r\n", struct.pack(">I", 4) + b"\xff\xff\xff\xff", encode(MESSAGES[0])[:4] + bytes(500)],
)
def test_what_is_no_stream_of_ours_is_refused(data: bytes) -> None:
    with pytest.raises(SpoolError):
        list(SpoolReader().feed(data))


def test_a_block_is_cut_at_a_moment() -> None:
    assert before(BLOCK, 6) is BLOCK
    assert before(BLOCK, 1) is None
    early = before(BLOCK, 5)
    assert early is not None
    assert [chunk.data for chunk in early.chunks()] == [b"abc"]


def test_a_block_in_which_the_clock_was_set_back_is_cut_by_the_times() -> None:
    block = pack([Chunk(9, "received", b"a", "e.1", 1), Chunk(2, "received", b"b", "e.1", 2)], (), ())
    early = before(block, 5)
    assert early is not None
    assert [chunk.data for chunk in early.chunks()] == [b"b"]
