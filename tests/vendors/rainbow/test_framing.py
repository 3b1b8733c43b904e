from __future__ import annotations

import struct

import pytest

from gateway.api.decoder import Event, Frame, Reject
from vendors.rainbow import VENDOR


def decoded(stream: bytes) -> list[Event]:
    decoder = VENDOR.protocol().reader()
    return [*decoder.feed(stream), *decoder.end()]


def frame(total: int, size: int | None = None) -> bytes:
    head = struct.pack("<BHB", 0x24, total - 4 if size is None else size, 3)
    return head + bytes(total - 4)


def test_a_box_that_counts_the_header_in_its_size_is_never_decoded() -> None:
    events = decoded(frame(580, size=580) * 5)
    assert not any(isinstance(event, Frame) for event in events)


def test_the_size_does_not_count_the_header() -> None:
    events = decoded(frame(580) * 3)
    assert [len(event.raw) for event in events if isinstance(event, Frame)] == [580, 580, 580]


def test_a_session_takes_only_the_length_of_its_first_good_frame() -> None:
    events = decoded(frame(512) + frame(580) + frame(512))
    assert [len(event.raw) for event in events if isinstance(event, Frame)] == [512, 512]


def test_a_size_that_nobody_knows_is_named_in_the_reject() -> None:
    (event,) = decoded(frame(500))
    assert "state of 500 bytes (header 24 f0 01 03), known are 464, 484, 488, 512, 580 or more" in str(event.detail)  # type: ignore[union-attr]


@pytest.mark.parametrize("more", [1, 2, 3])
def test_a_size_that_is_no_whole_number_of_words_is_rejected_and_the_next_frame_is_found(more: int) -> None:
    events = decoded(frame(580 + more) + frame(580))
    first, last = events[0], events[-1]
    assert isinstance(first, Reject)
    assert first.reason == "size"
    assert f"state of {580 + more} bytes" in str(first.detail)
    assert isinstance(last, Frame)
    assert len(last.raw) == 580
    assert sum(isinstance(event, Frame) for event in events) == 1
