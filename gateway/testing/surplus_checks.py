"""The check of answers that say nothing of their question: one too many is noticed before it is believed."""

from __future__ import annotations

from gateway.api.decoder import Decoder, Refused
from gateway.testing.playing import shown
from gateway.testing.polling_checks import answer_to, answers_of, expect_request, live_session
from gateway.testing.streams import frames
from gateway.testing.subject import CheckFailed, DoesNotApply, Subject

_SOON = 3  # ticks within which something is asked, where nothing is awaited


def an_answer_too_many_is_noticed(subject: Subject) -> None:
    """An answer that comes twice, late, while the next question is out: never a value of another shape, and refused.

    The answers stay one behind from then on, as with a controller that takes longer than a period.
    """
    words = len(answers_of(subject))
    if words <= 1:
        raise DoesNotApply("one question alone: an answer too many has its shape")
    for before in range(words):
        decoder = live_session(subject)
        request = expect_request(subject, decoder, "first")
        for _ in range(before):
            decoder.feed(answer_to(subject, request))
            request = expect_request(subject, decoder, "next")
        late = request
        decoder.feed(answer_to(subject, request))
        request = expect_request(subject, decoder, "next")
        _expect_notice(subject, decoder, late, request)


def _expect_notice(subject: Subject, decoder: Decoder, late: bytes, request: bytes) -> None:
    """Check that a decoder refuses answers that are one behind before they tell anything that they cannot mean."""
    where = f"the answer to {late!r}, which comes twice while {request!r} is asked,"
    coming = [late]
    for _ in range(2 * len(answers_of(subject))):
        coming.append(request)
        asked: bytes | Refused = b""
        while coming and not asked:
            of = coming.pop(0)
            answer = answer_to(subject, of)
            events = decoder.feed(answer)
            same = _shape(subject, of) == _shape(subject, request)
            if any(not same or frame.raw.strip() != answer.strip() for frame in frames(events)):
                raise CheckFailed(f"{where} is told: {shown(events)}: reject what cannot be the answer to the question")
            if any(isinstance(event, Refused) for event in events):
                return
            asked = _next_request(decoder)
            if isinstance(asked, Refused):
                return
        request = asked if isinstance(asked, bytes) and asked else expect_request(subject, decoder, "next")
    raise CheckFailed(f"{where} is never noticed: refuse the session as out_of_step")


def _next_request(decoder: Decoder) -> bytes | Refused:
    """What is asked soon; b"" where an answer is awaited."""
    for _ in range(_SOON):
        asked = decoder.tick()
        if asked:
            return asked
    return b""


def _shape(subject: Subject, request: bytes) -> list[object]:
    """The types of what answers a question."""
    told = next(vector.vendor for vector in subject.vectors if vector.asked == request and vector.layout)
    values = [value for record in subject.protocol.records for value in record.fields]
    return [value.type for value in values if told.get(value.name) is not None]
