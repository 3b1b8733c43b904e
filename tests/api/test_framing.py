"""Framing: an invented protocol with a magic of two bytes, a checksum and a tail, and the discipline of polling."""

from __future__ import annotations

import dataclasses
import struct
import zlib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.api.decoder import Event, Frame, Refused, Reject, Skipped
from gateway.api.framing import Checksum, FramedDecoder, Framing, Kind
from gateway.api.layout import Field, Layout
from gateway.api.model import Quality
from gateway.api.polling import Polled

STATE = Layout(name="state", size=4, source="x", byteorder=">", fields=(Field(name="a", offset=0, type="u32"),))
SEALED = Framing(
    magic=b"\xaa\x55",
    header=5,
    length_at=2,
    length_adds=11,
    type_at=4,
    layout_at=5,
    byteorder="big",
    checksum=Checksum(type="u32", of=zlib.crc32),
    tail=b"\r\n",
    kinds=(
        Kind(type=1, name="state", layouts=(STATE,), smallest=15, largest=40),
        Kind(type=2, name="note", smallest=11, largest=40),
    ),
)
# The same without what notices damage, and with one length a session.
BARE_STATES = (
    Layout(name="long", size=8, source="x", fields=(Field(name="a", offset=4, type="u32"),)),
    Layout(name="short", size=6, source="x", fields=(Field(name="a", offset=4, type="u16"),)),
)
BARE = Framing(
    magic=b"$",
    header=2,
    length_at=1,
    length_type="u8",
    kinds=(Kind(type=None, name="state", layouts=BARE_STATES, smallest=6, largest=32, step=2),),
    one_length=True,
)


def sealed(payload: bytes, type_: int = 1) -> bytes:
    covered = b"\xaa\x55" + struct.pack(">HB", len(payload), type_) + payload
    return covered + struct.pack(">I", zlib.crc32(covered)) + b"\r\n"


def bare(size: int, fill: int = 1) -> bytes:
    return b"$" + bytes((size,)) + bytes((fill,)) * (size - 2)


def reasons(events: list[Event]) -> list[str]:
    return [event.layout.name if isinstance(event, Frame) else getattr(event, "reason", "") for event in events]


GOOD = sealed(b"\0\0\0\x07")


def test_a_good_frame_is_found_with_its_layout_and_where_it_starts() -> None:
    assert FramedDecoder(SEALED).feed(GOOD) == [Frame(GOOD, STATE, 5)]


def test_a_longer_frame_keeps_its_layout_and_is_uncertain() -> None:
    (event,) = FramedDecoder(SEALED).feed(sealed(b"\0\0\0\x07more"))
    assert isinstance(event, Frame)
    assert (event.layout, event.quality) == (STATE, Quality.UNCERTAIN)


def test_after_a_good_frame_one_that_is_damaged_anywhere_is_still_none() -> None:
    for at in range(len(GOOD)):
        decoder = FramedDecoder(SEALED)
        assert len(decoder.feed(GOOD)) == 1
        damaged = GOOD[:at] + bytes((GOOD[at] ^ 0x01,)) + GOOD[at + 1 :]
        assert not any(isinstance(event, (Frame, Skipped)) for event in decoder.feed(damaged))


def test_half_a_frame_that_waits_goes_before_a_whole_one() -> None:
    decoder = FramedDecoder(SEALED)
    decoder.feed(GOOD + GOOD[:6])
    assert decoder.feed(GOOD[6:] + GOOD) == [Frame(GOOD, STATE, 5)] * 2


def test_a_frame_without_state_is_skipped_under_its_name() -> None:
    note = sealed(b"hello", 2)
    assert FramedDecoder(SEALED).feed(note + GOOD) == [Skipped(note, "note"), Frame(GOOD, STATE, 5)]


@pytest.mark.parametrize(
    ("bad", "reason"),
    [
        (b"xyz", "junk"),
        (sealed(b"\0\0\0\x07", 3), "type"),
        (sealed(b"\0\0\0"), "size"),
        (sealed(b"\0" * 30), "size"),
        (GOOD[:6] + b"\x01" + GOOD[7:], "checksum"),
        (GOOD[:-1] + b"\0", "tail"),
        (GOOD[:9] + bytes(4) + GOOD[13:], "checksum"),
    ],
)
def test_what_is_no_frame_is_rejected_with_a_reason_and_the_next_is_found(bad: bytes, reason: str) -> None:
    events = FramedDecoder(SEALED).feed(bad + GOOD)
    assert reasons(events) == [reason, "state"]
    assert isinstance(events[0], Reject)
    assert events[0].raw == bad


def test_half_a_magic_waits_for_the_other_half() -> None:
    decoder = FramedDecoder(SEALED)
    assert decoder.feed(GOOD[:1]) == []
    assert decoder.pending == 1
    assert decoder.feed(GOOD[1:]) == [Frame(GOOD, STATE, 5)]


def test_half_a_magic_behind_junk_is_kept_and_the_junk_is_rejected() -> None:
    decoder = FramedDecoder(SEALED)
    assert reasons(decoder.feed(b"xx\xaa")) == ["junk"]
    assert decoder.pending == 1
    assert reasons(decoder.feed(b"\xaa" + GOOD[1:])) == ["junk", "state"]


def test_what_is_left_at_the_end_is_truncated() -> None:
    decoder = FramedDecoder(SEALED)
    decoder.feed(GOOD[:7])
    assert decoder.end() == [Reject(GOOD[:7], "truncated", "the header promises 15 bytes, 7 came")]
    assert decoder.end() == []
    decoder.feed(GOOD[:3])
    assert decoder.end() == [Reject(GOOD[:3], "truncated", "3 bytes came")]


def test_a_session_keeps_the_length_of_its_first_frame() -> None:
    decoder = FramedDecoder(BARE)
    events = decoder.feed(bare(8) + bare(6, 2) + bare(8, 3))
    assert reasons(events) == ["long", "length", "long"]


def test_a_first_frame_that_reaches_over_the_next_header_is_refused() -> None:
    damaged = b"\x24\x0c" + bare(8)[2:]
    events = FramedDecoder(BARE).feed(damaged + bare(8, 2) * 2)
    assert reasons(events) == ["straddle", "long", "long"]


def test_a_size_off_the_step_is_no_size() -> None:
    assert reasons(FramedDecoder(BARE).feed(b"\x24\x09" + bytes(7) + bare(8))) == ["size", "long"]


def test_a_decoder_that_only_reads_sends_nothing() -> None:
    decoder = FramedDecoder(SEALED)
    assert (decoder.ready, decoder.outgoing(), decoder.tick(), decoder.goodbye()) == (True, b"", b"", b"")


def test_the_largest_frame_is_that_of_the_largest_kind() -> None:
    assert SEALED.largest == 40


PIECES = st.lists(
    st.one_of(
        st.binary(max_size=12),
        st.binary(min_size=4, max_size=4).map(sealed),
        st.binary(max_size=20).map(lambda payload: sealed(payload, 2)),
        st.just(b"\xaa\x55"),
        st.binary(min_size=4, max_size=4).map(lambda payload: sealed(payload)[:-3]),
    ),
    max_size=12,
)


@given(PIECES, st.lists(st.integers(1, 30), max_size=60))
def test_cuts_change_no_frame_and_lose_no_byte(pieces: list[bytes], sizes: list[int]) -> None:
    stream = b"".join(pieces)
    whole, cut = FramedDecoder(SEALED), FramedDecoder(SEALED)
    at, events = 0, []
    for size in [*sizes, len(stream)]:
        events += cut.feed(stream[at : at + size])
        at += size
    expected = whole.feed(stream)
    assert [event for event in events if not isinstance(event, Reject)] == [
        event for event in expected if not isinstance(event, Reject)
    ]
    for decoder, found in ((whole, expected), (cut, events)):
        assert decoder.pending <= SEALED.largest
        left = decoder.end()
        assert b"".join(event.raw for event in [*found, *left] if not isinstance(event, Refused)) == stream


@given(st.integers(0, len(GOOD) - 1), st.integers(1, 255))
def test_no_damage_passes_a_checksum(at: int, damage: int) -> None:
    damaged = bytearray(GOOD)
    damaged[at] ^= damage
    events = FramedDecoder(SEALED).feed(GOOD + bytes(damaged) + GOOD * 4)
    assert {event.raw for event in events if isinstance(event, Frame)} == {GOOD}


@given(st.binary(max_size=2000))
def test_rubbish_raises_nothing_and_is_kept_in_bounds(rubbish: bytes) -> None:
    decoder = FramedDecoder(dataclasses.replace(SEALED, magic=b"$"))
    decoder.feed(rubbish)
    assert decoder.pending <= SEALED.largest


@pytest.fixture
def polled() -> Polled:
    return Polled(FramedDecoder(BARE), b"ask")


def test_one_request_is_outstanding_until_its_answer(polled: Polled) -> None:
    assert [polled.tick(), polled.tick(), polled.tick()] == [b"ask", b"", b""]
    assert polled.feed(bare(8)[:3]) == []
    assert polled.tick() == b""
    assert reasons(polled.feed(bare(8)[3:])) == ["long"]
    assert polled.tick() == b"ask"


def test_a_reject_answers_nothing(polled: Polled) -> None:
    polled.tick()
    polled.feed(b"junk")
    assert polled.tick() == b""
    assert reasons(polled.feed(b"x" + bare(8))) == ["junk", "long"]
    assert polled.tick() == b"ask"


def test_a_frame_that_nobody_asked_for_ends_the_session(polled: Polled) -> None:
    reject, refused = polled.feed(bare(8))
    assert isinstance(reject, Reject)
    assert (reject.reason, reject.raw) == ("unrequested", bare(8))
    assert isinstance(refused, Refused)
    assert refused.kind == "out_of_step"


def test_a_second_answer_ends_the_session_but_the_first_is_kept(polled: Polled) -> None:
    polled.tick()
    events = polled.feed(bare(8) + bare(8, 2))
    assert [type(event) for event in events] == [Frame, Reject, Refused]


def test_bytes_that_stay_unexplained_before_a_request_end_the_session(polled: Polled) -> None:
    polled.tick()
    polled.feed(bare(8) + b"$")
    asked = [polled.tick() for _ in range(Polled.GRACE_TICKS)]
    assert asked[:-1] == [b""] * (Polled.GRACE_TICKS - 1)
    assert isinstance(asked[-1], Refused)


def test_bytes_that_are_explained_in_time_do_not_end_the_session(polled: Polled) -> None:
    polled.tick()
    polled.feed(bare(8) + b"$")
    polled.tick()
    assert reasons(polled.feed(b"\x01")) == ["size"]
    assert polled.tick() == b"ask"


def test_a_polled_session_owes_nothing_else(polled: Polled) -> None:
    polled.feed(b"$")
    assert (polled.ready, polled.outgoing(), polled.goodbye()) == (True, b"", b"")
    assert reasons(list(polled.end())) == ["truncated"]


def test_events_say_what_they_are_without_their_bytes() -> None:
    shown = [str(event) for event in (Frame(GOOD, STATE), Skipped(b"12", "note"), Reject(b"1", "junk"))]
    assert shown == ["Frame(state, 15 bytes)", "Skipped(note, 2 bytes)", "Reject(junk, 1 bytes)"]
