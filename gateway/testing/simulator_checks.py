"""Checks of the virtual controller, sans-I/O: the bytes go from decoder to session and back without a socket."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

from gateway.api.decoder import Decoder, Event, Frame, Refused, Reject, Skipped
from gateway.sim.scenario import SCENARIOS, find_scenario
from gateway.sim.simulator import Port, Simulator, VirtualRobot, VirtualSession
from gateway.testing.canonical_checks import canonical_fits
from gateway.testing.subject import CheckFailed, Subject
from gateway.testing.told import check_told

_POLLS = 40
_PERIOD_S = 0.25


def simulator_answers(subject: Subject) -> None:
    """Every scenario of the virtual controller yields a good frame a poll, or pushes frames, and they fit the model."""
    port, simulator = _port(subject)
    for name in SCENARIOS:
        robot = VirtualRobot(find_scenario(name))
        session = port.session(robot, simulator.options())
        decoder = subject.protocol.decoder(subject.options())
        count = sum(_step(subject, decoder, session, number * _PERIOD_S) for number in range(_POLLS))
        if count < (_POLLS if subject.protocol.request else 1):
            raise CheckFailed(f"scenario {name}: {_POLLS} polls give {count} frames: answer every request with a frame")
        if robot.frames != count:
            raise CheckFailed(
                f"scenario {name}: {count} frames came, the robot counts {robot.frames}: call robot.count()"
            )


def _port(subject: Subject) -> tuple[Port, Simulator]:
    simulator = subject.simulator() if subject.simulator is not None else None
    if not isinstance(simulator, Simulator):
        raise CheckFailed(
            "the module or package `simulator` exports no SIMULATOR: "
            "write the virtual controller that the tests and the demo need"
        )
    ports = [port for port in simulator.ports if port.protocol == subject.protocol.name]
    if not ports:
        raise CheckFailed(f"SIMULATOR has no port of protocol {subject.protocol.name}: give it one")
    return ports[0], simulator


def _step(subject: Subject, decoder: Decoder, session: VirtualSession, now_s: float) -> int:
    """One period: what the decoder asks, the session answers; returns how many frames came."""
    asked = decoder.tick()
    if isinstance(asked, Refused):
        raise CheckFailed(f"the decoder refuses the virtual controller: {asked.reason}")
    segments = deque((*_answers(session, decoder.outgoing(), now_s), *_answers(session, asked, now_s)))
    segments += session.due(now_s)
    frames: list[Event] = []
    while segments:
        frames += decoder.feed(segments.popleft())
        segments += _answers(session, decoder.outgoing(), now_s)
    for event in frames:
        if isinstance(event, (Reject, Refused)):
            raise CheckFailed(f"the decoder does not take what the virtual controller sends: {event}")
        if isinstance(event, Frame):
            canonical_fits(subject.normaliser(), event, f"the virtual controller after {now_s:g} s")
    if subject.protocol.records:
        _check_messages(subject, asked, frames, now_s)
    return sum(isinstance(event, Frame) for event in frames)


def _check_messages(subject: Subject, asked: bytes, events: Sequence[Event], now_s: float) -> None:
    """Check what a virtual controller says in text: every question is answered, and vectors know what is skipped."""
    where = f"the virtual controller after {now_s:g} s"
    named = {vector.skipped for vector in subject.skipped}
    for event in events:
        check_told(subject, subject.states[0], event, where)
        if isinstance(event, Skipped) and event.reason not in named:
            raise CheckFailed(f"{where} says what is skipped as {event.reason!r}: add a vector of it")
    if subject.polls and asked and not events:
        raise CheckFailed(f"{where} does not answer {asked!r}: answer every request")


def _answers(session: VirtualSession, asked: bytes, now_s: float) -> Sequence[bytes]:
    return session.received(asked, now_s) if asked else ()
