"""Bad input on ports 20004 and 8083: each costs what it must, is counted by a reason, and the stream goes on."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from gateway.api.decoder import Event, Frame, Reject
from gateway.api.framing import FramedDecoder
from gateway.api.layout import Layout
from gateway.api.model import Quality
from gateway.api.vendor import Protocol
from gateway.sim.scenario import find_scenario
from gateway.sim.simulator import VirtualRobot
from vendors.fairino.layouts import LEGACY_LAYOUTS, LONGEST
from vendors.fairino.pushed import LEGACY, STATUS, sum16
from vendors.fairino.simulator import FairinoOptions, LegacySession, StatusSession


def sealed(data: bytes) -> bytes:
    """Put the right checksum behind a frame."""
    return data + sum16(data).to_bytes(2, "little")


def legacy(total: int = 1236, *, count: int = 0, **values: object) -> bytes:
    """A frame of port 20004."""
    header = {"frame_head": 0x5A5A, "frame_cnt": count, "data_len": total - 7}
    payload = LONGEST.encode({**values, **header}).ljust(total - 2, b"\x33")
    return sealed(payload[: total - 2])


def reasons(events: list[Event]) -> list[str]:
    return [event.reason for event in events if isinstance(event, Reject)]


def frames(events: list[Event]) -> list[bytes]:
    return [event.raw for event in events if isinstance(event, Frame)]


@pytest.fixture(params=["legacy", "status"])
def stream(request: pytest.FixtureRequest) -> Iterator[tuple[Protocol, list[bytes]]]:
    """A protocol, and four frames that follow each other."""
    robot = VirtualRobot(find_scenario("steady"))
    options = FairinoOptions()
    if request.param == "legacy":
        pushing = LegacySession(robot, options)
        yield LEGACY, [pushing.frame(0.008 * number) for number in range(4)]
    else:
        status = StatusSession(robot, options)
        yield STATUS, [status.frame(0.1 * number) for number in range(4)]


Stream = tuple[Protocol, list[bytes]]


def test_a_wrong_checksum_costs_one_frame(stream: Stream) -> None:
    protocol, (a, b, c, d) = stream
    for at in (len(b) - 1, len(b) - 2, 40):
        hurt = b[:at] + bytes([b[at] ^ 0x41]) + b[at + 1 :]
        events = protocol.reader().feed(a + hurt + c + d)
        assert frames(events) == [a, c, d]
        assert reasons(events) == ["checksum"]


@pytest.mark.parametrize("length", [0, 1, 63, 4097, 65535])
def test_a_length_that_lies_is_rejected_at_once(stream: Stream, length: int) -> None:
    protocol, (a, b, c, _) = stream
    hurt = b[:3] + length.to_bytes(2, "little") + b[5:]
    events = protocol.reader().feed(a + hurt + c)
    assert frames(events) == [a, c]
    assert reasons(events) == ["size"]


@pytest.mark.parametrize("length", [64, 576])
def test_port_20004_has_no_frame_below_584_bytes(length: int) -> None:
    a, c = legacy(count=1), legacy(count=3)
    hurt = legacy(count=2)
    hurt = hurt[:3] + length.to_bytes(2, "little") + hurt[5:]
    assert frames(LEGACY.reader().feed(a + hurt + c)) == [a, c]


def test_a_length_that_swallows_the_next_frame_costs_both_at_most() -> None:
    good = [legacy(count=number) for number in range(6)]
    hurt = good[1][:3] + (4096).to_bytes(2, "little") + good[1][5:]
    events = LEGACY.reader().feed(good[0] + hurt + b"".join(good[2:]))
    assert frames(events) == [good[0], *good[2:]]
    assert reasons(events) == ["checksum"]


def test_start_bytes_inside_the_payload_are_no_frame() -> None:
    inside = legacy(main_code=0x5A5A5A5A, gripper_fault=0x5A5A, jt_cur_pos=[105.41] * 6, count=0x5A)
    decoder = LEGACY.reader()
    chunks = [inside[at : at + 1] for at in range(len(inside))]
    assert frames([event for chunk in chunks for event in decoder.feed(chunk)]) == [inside]
    # begun in the middle, the search ends at the next whole frame
    events = LEGACY.reader().feed(inside[8:] + inside + inside)
    assert frames(events) == [inside, inside]


def test_a_byte_sum_above_65535_is_reduced_to_16_bits() -> None:
    raw = legacy(jt_cur_pos=[-12.345678901] * 6, extDIState=[0xFFFF] * 8, lastServoTarget=[-77.77777777] * 6,
                 toolCoord=[-0.1] * 6, wobjCoord=[-0.1] * 6, extoolCoord=[-0.1] * 6, exAxisCoord=[-0.1] * 6,
                 actual_qd=[-0.1] * 6, actual_qdd=[-0.1] * 6, jt_cur_tor=[-0.1] * 6, jt_tgt_tor=[-0.1] * 6)  # fmt: skip
    assert sum(raw[:-2]) > 0xFFFF
    assert frames(LEGACY.reader().feed(raw)) == [raw]


def test_half_a_frame_and_then_silence_gives_nothing(stream: Stream) -> None:
    protocol, (a, b, _, _) = stream
    decoder = protocol.reader()
    assert isinstance(decoder, FramedDecoder)
    assert frames(decoder.feed(a + b[: len(b) // 2])) == [a]
    assert decoder.pending == len(b) // 2
    (left,) = decoder.end()
    assert (left.raw, left.reason) == (b[: len(b) // 2], "truncated")


def test_a_frame_whose_tail_is_missing_costs_itself(stream: Stream) -> None:
    protocol, (a, b, c, d) = stream
    for missing in (1, 2, 7):
        events = protocol.reader().feed(a + b[:-missing] + c + d)
        assert frames(events) == [a, c, d]
        assert reasons(events) == ["checksum"]


def test_nothing_is_ever_sent(stream: Stream) -> None:
    protocol, (a, *_) = stream
    decoder = protocol.decoder(protocol.options())
    assert protocol.outgoing == ()
    for _ in range(3):
        assert (decoder.outgoing(), decoder.tick(), decoder.goodbye()) == (b"", b"", b"")
        decoder.feed(a)


def test_silence_never_closes_a_session(stream: Stream) -> None:
    protocol, _ = stream
    assert protocol.on_stale == "keep"
    assert "SetRobotStopOnComDisc" in protocol.hazard


@pytest.mark.parametrize("total", [585, 700, 1235, 1237, 2000, 2076, 4103])
def test_an_unknown_size_is_decoded_as_far_as_known_and_uncertain(total: int) -> None:
    (event,) = LEGACY.reader().feed(legacy(total, robot_mode=1))
    assert isinstance(event, Frame)
    assert event.quality is Quality.UNCERTAIN
    assert str(total) in event.layout.name or total > 2075
    assert isinstance(event.layout, Layout)
    assert event.layout.size <= total - 2


@pytest.mark.parametrize("layout", LEGACY_LAYOUTS, ids=lambda layout: str(layout.name))
def test_every_known_size_has_its_own_layout(layout: Layout) -> None:
    (event,) = LEGACY.reader().feed(legacy(int(layout.name)))
    assert isinstance(event, Frame)
    assert event.layout is layout
    assert event.quality is Quality.GOOD


def test_the_counter_stands_behind_the_start_bytes(stream: Stream) -> None:
    protocol, found = stream
    assert protocol.framing is not None
    at = protocol.framing.counter_at
    assert at is not None
    assert [raw[at] for raw in found] == [0, 1, 2, 3]


@given(st.binary(max_size=600))
@example(b"\xff" * 4096)
@example(b"\xff" * 256)
def test_the_sum_is_that_of_the_bytes(data: bytes) -> None:
    assert sum16(data) == sum(data) & 0xFFFF
