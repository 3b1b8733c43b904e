"""Checks of what a plugin sends: nothing outside its allow-list, and never a second request before the answer."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import cast

import msgspec
from msgspec import inspect

from gateway.api.decoder import Decoder, Event, Frame, Occurrence, Refused, Reject, Skipped
from gateway.api.model import Quality
from gateway.testing.playing import shown
from gateway.testing.streams import frames
from gateway.testing.subject import PUSHED, CheckFailed, DoesNotApply, Subject
from gateway.testing.vectors import Vector

_PATIENCE = 200  # ticks: more than any grace that a decoder may grant
_WALK = 3_000  # random steps of a session


def only_allowed_bytes_are_sent(subject: Subject) -> None:
    """Whatever is sent, at any time and with any option, is matched whole by a pattern of Protocol.outgoing."""
    for options in option_variants(subject.protocol.options):
        decoder = subject.protocol.decoder(options)
        _check_sent(subject, decoder.outgoing(), "first bytes")
        asked: bytes | Refused = b""
        for number in range(_PATIENCE):
            vector = subject.vectors[number % len(subject.vectors)]
            known = answers_of(subject).get(asked) if isinstance(asked, bytes) and number % 3 else None
            decoder.feed(known or (vector.raw[: len(vector.raw) // 2] if number % 7 == 0 else vector.raw))
            _check_sent(subject, decoder.outgoing(), "bytes owed")
            asked = decoder.tick()
            if not isinstance(asked, Refused):
                _check_sent(subject, asked, "request")
            elif subject.protocol.records:
                decoder = subject.protocol.decoder(options)
        _check_sent(subject, decoder.goodbye(), "bytes before the close")


def one_request_is_outstanding(subject: Subject) -> None:
    """A polled decoder sends the next request only after the answer to the last; a pushed one never asks."""
    decoder = live_session(subject)
    if not subject.polls:
        if subject.protocol.outgoing:
            raise DoesNotApply(f"{PUSHED}, and what it sends is a handshake: only_allowed_bytes_are_sent looks at it")
        if any(decoder.tick() for _ in range(_PATIENCE)):
            raise CheckFailed("a protocol that pushes asks for frames: state its request, or send nothing")
        return
    request = expect_request(subject, decoder, "first")
    for _ in range(max(1, len(answers_of(subject)))):
        answer = answer_to(subject, request)
        events: list[Event] = []
        # Each tick is time that passes: a text protocol may give up an answer that takes too long.
        looks = {0, len(answer) // 2, len(answer) - 1} if subject.protocol.records else range(len(answer))
        for number in range(len(answer)):
            if number in looks:
                _expect_silence(decoder, f"{number} bytes of the answer have come")
            events = decoder.feed(answer[number : number + 1])
        if not _answered(subject, events):
            raise CheckFailed(
                f"the whole answer to {request!r}, byte by byte, gives no frame: wait for its end, or for the length "
                "that the header promises"
            )
        request = expect_request(subject, decoder, "next")
    answer = answer_to(subject, request)
    damaged = decoder.feed(b"\0" * len(answer))
    if frames(damaged):
        raise CheckFailed("zeros are taken for the answer: check the header")
    _expect_silence(decoder, "the answer was damaged")


def skipped_frames_answer_nothing(subject: Subject) -> None:
    """A known frame without state answers no request and changes no frame."""
    skipped = _unasked(subject)
    if not skipped:
        raise DoesNotApply("every frame of the protocol carries state")
    for vector in skipped:
        decoder = live_session(subject)
        answer = answer_to(subject, expect_request(subject, decoder, "first"))
        if frames(decoder.feed(vector.raw)):
            raise CheckFailed(f"{vector} gives a frame: it carries no state")
        _expect_silence(decoder, f"{vector} has come, which carries no state")
        if [frame.raw for frame in frames(decoder.feed(answer))] != [answer]:
            raise CheckFailed(f"after {vector} the answer is lost: a skipped frame must change nothing")


def unrequested_frames_end_the_session(subject: Subject) -> None:
    """A frame that nobody asked for, a second answer, or bytes that stay unexplained mean: out of step."""
    for session in subject.sessions:
        answer = session[0].raw
        _expect_refusal(live_session(subject).feed(answer), 0, "a frame that nobody asked for")
        decoder = live_session(subject)
        expect_request(subject, decoder, "first")
        _expect_refusal(decoder.feed(answer + answer), 1, "a second answer behind the first")
        for size in (1, len(answer) // 2, len(answer) - 1):
            decoder = live_session(subject)
            decoder.feed(answer[:size])
            asked = [decoder.tick() for _ in range(_PATIENCE)]
            sent = [one for one in asked if not isinstance(one, Refused) and one]
            if sent:
                raise CheckFailed(f"{size} bytes of a frame that nobody asked for came, and a request is sent into it")
            if not any(isinstance(one, Refused) and one.kind == "out_of_step" for one in asked):
                raise CheckFailed(f"{size} bytes that nobody asked for stay unexplained for ever: refuse, out_of_step")


def late_answers_answer_nothing(subject: Subject) -> None:
    """An answer that nobody asked for, or that comes twice, ends the session or is left out: it answers no question."""
    for late in subject.vectors:
        for size in {1, len(late.raw) // 2, len(late.raw) - 1, len(late.raw)} - {0}:
            stray = late.raw[:size]
            where = f"{size} bytes of {late}, which nobody asked for,"
            decoder = live_session(subject)
            _follow(subject, decoder, decoder.feed(stray), b"", where)
            decoder = live_session(subject)
            answer = answer_to(subject, expect_request(subject, decoder, "first"))
            _follow(subject, decoder, decoder.feed(answer + stray), answer, f"{where} behind an answer")


def requests_never_outrun_answers(subject: Subject) -> None:
    """In a long random session, cut anyhow and with junk, requests never outnumber answers by more than one."""
    chance = subject.random()
    waiting = last = b""
    skipped = _unasked(subject)
    decoder, asked, answered = live_session(subject), 0, 0
    for step in range(_WALK):
        what = chance.randrange(8)
        if what <= 1 and asked == answered + 1 and not waiting:
            waiting = answer_to(subject, last) if subject.protocol.records else chance.choice(subject.sessions[0]).raw
        elif what == 2 and skipped and not waiting:  # noqa: PLR2004 - one of eight things that happen
            waiting = chance.choice(skipped).raw
        elif what <= 4:  # noqa: PLR2004 - the same
            size = chance.randint(1, 400)
            events = decoder.feed(waiting[:size])
            answered += _answered(subject, events)
            waiting = waiting[size:]
            if any(isinstance(event, Refused) for event in events):
                raise CheckFailed(
                    f"at step {step} good answers give {shown(events)}: refuse only what nobody asked for"
                )
        else:
            request = decoder.tick()
            if isinstance(request, Refused):
                decoder, asked, answered, waiting = live_session(subject), 0, 0, b""
            elif request:
                asked, last = asked + 1, request
        if asked > answered + 1:
            raise CheckFailed(f"at step {step} {asked} requests are sent for {answered} answers: wait for each answer")


def option_variants(options: type[msgspec.Struct]) -> Iterator[msgspec.Struct]:
    """A protocol's default options, and each option in turn at every value, or at both ends, that it may have."""
    yield options()
    info = inspect.type_info(options)
    for field in cast("inspect.StructType", info).fields:
        for value in _values(field.type):
            yield msgspec.convert({field.encode_name: value}, options)


def _values(type_: inspect.Type) -> list[object]:
    if isinstance(type_, inspect.Metadata):
        return _values(type_.type)
    if isinstance(type_, inspect.UnionType):
        return [value for one in type_.types for value in _values(one)]
    if isinstance(type_, inspect.LiteralType):
        return list(type_.values)
    if isinstance(type_, inspect.EnumType):
        return [one.value for one in type_.cls]
    if isinstance(type_, (inspect.IntType, inspect.FloatType)):
        return [end for end in (type_.ge, type_.le) if end is not None]
    return [False, True] if isinstance(type_, inspect.BoolType) else []


def answers_of(subject: Subject) -> dict[bytes, bytes]:
    """Good answers by what was asked, where vectors say it: those that tell something first."""
    ranked = sorted(subject.vectors, key=lambda vector: vector.layout is None)
    return {vector.asked: vector.raw for vector in reversed(ranked) if vector.asked is not None}


def answer_to(subject: Subject, request: bytes) -> bytes:
    """A good answer to a request."""
    if subject.protocol.framing is not None:
        return subject.sessions[0][0].raw
    answers = answers_of(subject)
    if answers and request not in answers:
        raise CheckFailed(f"no vector says what {request!r} is answered with: add one with `asked` and a value")
    return answers[request] if answers else subject.states[0].raw


def _answered(subject: Subject, events: list[Event]) -> int:
    """How many answers have come; of text, those that tell nothing too."""
    if subject.protocol.framing is not None:
        return len(frames(events))
    return sum(isinstance(event, (Frame, Occurrence, Skipped)) for event in events)


def _unasked(subject: Subject) -> list[Vector]:
    """The skipped vectors that answer nothing and may come at any time."""
    return [vector for vector in subject.skipped if vector.asked is None and not vector.before]


def live_session(subject: Subject) -> Decoder:
    """A decoder of a live session whose handshake, where there is one, is not looked at."""
    decoder = subject.protocol.decoder(subject.options())
    decoder.outgoing()
    return decoder


def _follow(subject: Subject, decoder: Decoder, events: list[Event], wanted: bytes, where: str) -> None:
    """Check that no question after stray bytes is answered by them: neither now, nor by what comes next."""
    told = [event.raw for event in events if isinstance(event, (Frame, Occurrence))]
    if told not in ([wanted] if wanted else [], []):
        raise CheckFailed(f"{where} are told: {shown(events)}: reject what no question asked for")
    if any(isinstance(event, Refused) for event in events):
        return
    for _ in range(_PATIENCE):
        request = decoder.tick()
        if isinstance(request, Refused):
            return
        if request:
            answer = answer_to(subject, request)
            found = decoder.feed(answer)
            mixed = [
                event
                for event in found
                if isinstance(event, (Frame, Occurrence)) and event.raw.strip() != answer.strip()
            ]
            if mixed:
                raise CheckFailed(
                    f"{where} are told as a part of the next answer: {shown(found)} of {answer!r}: "
                    "reject them, or refuse the session as out_of_step",
                )
            return
    if events or wanted:
        return
    raise CheckFailed(f"{where} stay unexplained for ever: reject them, or refuse the session as out_of_step")


def _check_sent(subject: Subject, sent: bytes, what: str) -> None:
    if sent and not any(re.fullmatch(pattern, sent, re.DOTALL) for pattern in subject.protocol.outgoing):
        raise CheckFailed(
            f"{what} {sent!r} are not in Protocol.outgoing: the gateway only reads; add a pattern if reading needs it",
        )


def expect_request(subject: Subject, decoder: Decoder, which: str) -> bytes:
    """What is asked now, or soon; it must be something."""
    request = decoder.tick()
    for _ in range(_PATIENCE if subject.protocol.records else 0):
        request = request or decoder.tick()  # nothing may be due yet
    if not isinstance(request, bytes) or not request:
        raise CheckFailed(f"the {which} tick asks for nothing ({request!r}): return the request")
    return request


def _expect_silence(decoder: Decoder, when: str) -> None:
    for _ in range(3):
        asked = decoder.tick()
        if asked != b"":
            raise CheckFailed(f"a second request leaves while {when}: a late answer would be taken for the next one")


def _expect_refusal(events: list[Event], good: int, what: str) -> None:
    refused = [event for event in events if isinstance(event, Refused) and event.kind == "out_of_step"]
    rejected = [event for event in events if isinstance(event, Reject)]
    found = [event for event in events if isinstance(event, Frame) and event.quality is not Quality.BAD]
    if len(found) != good or not refused or not rejected:
        raise CheckFailed(
            f"{what} gives {', '.join(map(str, events)) or 'nothing'}: reject it and refuse the session as out_of_step",
        )
