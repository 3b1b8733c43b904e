"""A session of CNDE that was held before is read by what was sent and answered in it."""

from __future__ import annotations

import pytest

from gateway.api.decoder import AskedDecoder, Event, Frame, Reject, Skipped
from gateway.core.registry import Registry
from gateway.testing.conformance import subjects
from vendors.fairino.cnde import WRONG_IN_A_ROW, CndeOptions
from vendors.fairino.cnde_observing import CndeObserver
from vendors.fairino.cnde_protocol import CNDE
from vendors.fairino.cnde_wire import DATA, MESSAGE, START, STOP, configuration, frame

NAMES = ("robot_mode", "actual_joint_pos")
TYPES = b"\x00UINT8,DOUBLE_6"
SHORT = frame(DATA, bytes(49))


def whole() -> bytes:
    """A data frame of the default configuration."""
    found = next(one for one in subjects(Registry(), "fairino") if one.protocol.name == "cnde")
    return next(vector.raw for vector in found.vectors if vector.name == "cnde_working")


def configured() -> CndeObserver:
    """One that has seen a configuration being granted and started."""
    observer = CndeObserver(CndeOptions())
    observer.asked(frame(STOP))
    observer.asked(configuration(NAMES, 8))
    observer.feed(frame(MESSAGE, TYPES))
    observer.asked(frame(START))
    return observer


def kinds(events: list[Event]) -> list[type[Event]]:
    return [type(event) for event in events]


def test_it_is_told_what_was_asked() -> None:
    assert isinstance(CNDE.observer(CndeOptions()), AskedDecoder)


def test_without_a_handshake_frames_are_those_of_the_options() -> None:
    assert kinds(CndeObserver(CndeOptions()).feed(whole())) == [Frame]
    events = CndeObserver(CndeOptions(states=NAMES)).feed(SHORT + whole())
    assert kinds(events) == [Frame, Reject]


def test_a_configuration_that_was_seen_says_what_frames_hold() -> None:
    observer = configured()
    events = observer.feed(SHORT)

    assert kinds(events) == [Frame]
    assert isinstance(events[0], Frame)
    assert events[0].layout.name == "2 states, 57 bytes"
    assert observer.ready


def test_frames_before_the_start_carry_no_state() -> None:
    observer = CndeObserver(CndeOptions())
    observer.asked(frame(STOP) + configuration(NAMES, 8))

    assert observer.feed(SHORT) == [Skipped(SHORT, "data before start")]


def test_an_answer_that_does_not_fit_is_none() -> None:
    observer = CndeObserver(CndeOptions())
    observer.asked(configuration(NAMES, 8))

    for said in (b"\x00UINT8", b"\x03UINT8,DOUBLE_6", b"\x00UINT8,COFFEE", b""):
        assert kinds(observer.feed(frame(MESSAGE, said))) == [Skipped]
        assert not observer.ready
    assert kinds(observer.feed(SHORT)) == [Skipped]


def test_a_configuration_larger_than_a_frame_is_no_layout() -> None:
    observer = CndeObserver(CndeOptions())
    observer.asked(configuration(NAMES, 8))
    observer.feed(frame(MESSAGE, b"\x00DOUBLE_400,DOUBLE_400"))

    assert kinds(observer.feed(SHORT)) == [Skipped]


def test_frames_of_another_length_are_rejects_until_it_is_configured_anew() -> None:
    observer = configured()

    assert kinds(observer.feed(whole() * WRONG_IN_A_ROW)) == [Reject] * WRONG_IN_A_ROW
    assert kinds(observer.feed(SHORT)) == [Skipped]


def test_gaps_are_counted_by_the_controllers_numbers() -> None:
    observer = configured()
    for count in (1, 2, 5):
        observer.feed(frame(DATA, bytes(49), count))

    assert observer.gaps == 2


def test_it_sends_nothing() -> None:
    observer = configured()

    assert (observer.outgoing(), observer.tick(), observer.goodbye()) == (b"", b"", b"")


@pytest.mark.parametrize("names", [("no_such_state",), NAMES])
def test_states_that_nobody_knows_wait_for_the_controllers_types(names: tuple[str, ...]) -> None:
    observer = CndeObserver(CndeOptions(states=names))
    observer.asked(configuration(names, 8))
    observer.feed(frame(MESSAGE, b"\x00" + b",".join([b"UINT8"] * len(names))))
    observer.asked(frame(START))

    assert kinds(observer.feed(frame(DATA, bytes(len(names))))) == [Frame]
