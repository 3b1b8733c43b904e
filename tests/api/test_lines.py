"""Lines of text, cut anywhere, ended in several ways, and too long."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.api.decoder import Reject, Skipped
from gateway.api.lines import LONGEST, Lines

Found = bytes | Reject | Skipped
ENDS = [b"\n", b"\r", b"\r\n", b"\n\n", b"aab", b"END"]


def read(pieces: Sequence[bytes], end: bytes = b"\n", longest: int = LONGEST) -> list[Found]:
    lines = Lines(end, longest)
    return [one for piece in pieces for one in lines.feed(piece)] + list(lines.end())


def good(found: Sequence[Found]) -> list[bytes]:
    return [one for one in found if isinstance(one, bytes)]


def raw(found: Sequence[Found]) -> bytes:
    return b"".join(one if isinstance(one, bytes) else one.raw for one in found)


def rejects(found: Sequence[Found]) -> list[str]:
    return [one.reason for one in found if isinstance(one, Reject)]


def cut(stream: bytes, places: Sequence[int]) -> list[bytes]:
    at = sorted({0, len(stream), *(place % (len(stream) + 1) for place in places)})
    return [stream[before:after] for before, after in itertools.pairwise(at)]


def bytewise(stream: bytes) -> list[bytes]:
    return [stream[at : at + 1] for at in range(len(stream))]


@pytest.mark.parametrize("end", ENDS)
def test_every_cut_in_two_gives_the_same_lines(end: bytes) -> None:
    stream = b"one" + end + end + b"two words" + end + "drei ä".encode() + end + b"rest"
    whole = read([stream], end)
    assert len(good(whole)) >= 4
    assert raw(whole) == stream
    for place in range(len(stream) + 1):
        assert read([stream[:place], stream[place:]], end) == whole
    assert read(bytewise(stream), end) == whole


def test_lines_come_with_their_end_and_a_carriage_return_is_theirs() -> None:
    assert read([b"a\r\n\nb\n"]) == [b"a\r\n", b"\n", b"b\n"]
    assert read([b"a\nb\r\n"], b"\r\n") == [b"a\nb\r\n"]


def test_an_end_that_came_in_parts_is_seen_when_it_is_whole() -> None:
    lines = Lines(b"\r\n")
    assert lines.feed(b"a\r") == []
    assert lines.pending == 2
    assert lines.feed(b"\rb\r") == []
    assert lines.feed(b"\nc") == [b"a\r\rb\r\n"]
    assert lines.pending == 1


def test_nothing_gives_nothing() -> None:
    assert read([b"", b""]) == []
    assert Lines().feed(b"") == []


def test_a_line_may_be_as_long_as_allowed_and_no_longer() -> None:
    fits, over = b"x" * 9 + b"\n", b"y" * 10 + b"\n"
    assert read([fits], longest=10) == [fits]
    assert read(bytewise(fits), longest=10) == [fits]
    for pieces in ([over + fits], bytewise(over + fits), [over[:10], over[10:] + fits]):
        found = read(pieces, longest=10)
        assert good(found) == [fits]
        assert rejects(found) == ["too_long"]
        assert raw(found) == over + fits


@pytest.mark.parametrize("end", ENDS)
@pytest.mark.parametrize("size", [1, 7, 64, 1000])
def test_an_endless_line_fills_no_memory_is_counted_once_and_the_next_line_is_found(end: bytes, size: int) -> None:
    lines = Lines(end, 100)
    found: list[Found] = []
    stream = b"x" * 5000 + end + b"good" + end
    for at in range(0, len(stream), size):
        found += lines.feed(stream[at : at + size])
        assert lines.pending < 100 + len(end)
    assert good(found) == [b"good" + end]
    assert rejects(found) == ["too_long"]
    assert raw(found) == stream
    assert lines.end() == []


def test_a_line_too_long_is_counted_once_also_where_the_stream_ends_in_it() -> None:
    for size in (1, 3, 200):
        found = read([b"x" * size] * (600 // size), longest=100)
        assert rejects(found) == ["too_long"]
        assert raw(found) == b"x" * 600


def test_the_end_of_the_stream_gives_the_line_that_never_became_whole() -> None:
    lines = Lines()
    lines.feed(b"good\nhal")
    (left,) = lines.end()
    assert (left.raw, left.reason) == (b"hal", "truncated")
    assert "3 bytes came" in left.detail
    assert lines.end() == []
    assert lines.feed(b"next\n") == [b"next\n"]


def test_after_the_end_of_a_stream_the_next_line_is_no_rest_of_a_long_one() -> None:
    lines = Lines(b"\r\n", 10)
    found = lines.feed(b"x" * 20 + b"\r")
    (left,) = lines.end()
    assert raw([*found, left]) == b"x" * 20 + b"\r"
    assert (left.reason, left.detail) == ("truncated", "the rest of a line that is too long")
    assert lines.feed(b"\nok\r\n") == [b"\nok\r\n"]


@pytest.mark.parametrize(("end", "longest"), [(b"", 10), (b"\n", 1), (b"\r\n", 2), (b"\r\n", 0)])
def test_a_line_must_have_room_for_its_end_and_an_end(end: bytes, longest: int) -> None:
    with pytest.raises(ValueError, match="must end with something"):
        Lines(end, longest)


words = st.lists(st.sampled_from([b"x", b"\r", b"\n", b"\r\n", b"a", b"aa", b"b", b"yyyyyyyyyyyyyy"]), max_size=30)


@given(words, st.lists(st.integers(0, 10_000), max_size=12), st.sampled_from(ENDS), st.integers(4, 20))
def test_whatever_comes_no_byte_is_lost_and_the_lines_do_not_follow_from_the_cuts(
    parts: list[bytes], places: list[int], end: bytes, longest: int
) -> None:
    stream = b"".join(parts)
    whole = read([stream], end, longest)
    lines = Lines(end, longest)
    found: list[Found] = []
    n_fed = 0
    for piece in cut(stream, places):
        found += lines.feed(piece)
        assert stream.startswith(raw(found))
        n_fed += len(piece)
        assert len(raw(found)) + lines.pending == n_fed
    found += lines.end()
    assert raw(found) == raw(whole) == stream
    assert good(found) == good(whole) == [line for line in _split(stream, end) if len(line) <= longest]
    assert rejects(found).count("too_long") == rejects(whole).count("too_long")


def _split(stream: bytes, end: bytes) -> list[bytes]:
    return [line + end for line in stream.split(end)[:-1]]
