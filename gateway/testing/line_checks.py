"""Checks of the messages of text protocols: damaged, cut, too long, or none at all.

Text has no checksum: damage in a digit gives another number, and nobody can notice. What is checked is that damage
stays where it is: the next whole good message is found, no value of an untouched name changes, no name comes that was
not there, and whatever is told has the type that its record says.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import cast

from gateway.api.decoder import Decoder, Event, Frame, Occurrence, Refused, Reject, Skipped
from gateway.api.lines import LONGEST
from gateway.testing.playing import different, ending, is_json, opened, said, shown, tell
from gateway.testing.streams import check_conserved, damaged, frames, pending
from gateway.testing.subject import CheckFailed, DoesNotApply, Subject
from gateway.testing.told import changes, check_told, is_kept, members_at, same_place, told, touched
from gateway.testing.vector_checks import the_event
from gateway.testing.vectors import Vector

_GOODS = 2  # good messages that follow a damaged one
_JUNK = 65_536
_PIECE = 997  # bytes that are fed at once
_LINES = 200  # lines of junk
_READABLE = bytes(range(0x20, 0x7F))
_WORD = frozenset(b"0123456789abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ_")


def damaged_lines_stay_alone(subject: Subject) -> None:
    """Damage in a message changes what it touches and nothing else, and the next whole good message is found.

    Each byte in five ways: all its bits, its lowest, another one, taken out, doubled.
    """
    for vector in different(subject):
        reference = the_event(subject, vector)
        clean = _play(subject, vector, vector.raw)
        repeats = [same_place(clean, number * len(vector.raw)) for number in range(_GOODS + 1)]
        again = [event is not None and told(event) == told(reference) for event in repeats]
        for at, how, hurt in _hurts(vector.raw):
            where = f"{vector} with byte {at} {how}"
            events = _play(subject, vector, hurt, where)
            first = events[0] if events else None
            _check_begun(subject, vector, reference, events, (at, hurt), where)
            at_end = at >= len(vector.raw.rstrip())
            if all(again) and not isinstance(first, Refused):
                _check_found(vector, reference, events, len(hurt), _GOODS - 1 if at_end else _GOODS, where)


def cut_lines_tell_nothing(subject: Subject) -> None:
    """A message that the stream's end cuts at any byte tells nothing; where its own end follows, nothing false."""
    end = ending(subject)
    for vector in different(subject):
        reference = the_event(subject, vector)
        for size in range(1, len(vector.raw)):
            where = f"the first {size} bytes of {vector}"
            decoder = opened(subject, vector)
            events = said(decoder.feed(vector.raw[:size]))
            check_conserved(vector.raw[:size], events, decoder.end(), f"up to byte {size} of {vector}", blank=True)
            if any(isinstance(event, (Frame, Occurrence, Skipped)) for event in events):
                raise CheckFailed(f"{where} are taken for {shown(events)}: wait for the end of the message")
            if end and size < len(vector.raw.rstrip()):
                _check_cut(subject, vector, reference, vector.raw[:size] + end, where)


def long_lines_cost_themselves(subject: Subject) -> None:
    """A message without end is rejected piece by piece, fills no memory, and the next good one is found."""
    end = ending(subject)
    if not end:
        raise DoesNotApply("no message ends with white space: where a line would end is not known")
    for vector in different(subject):
        payload = vector.raw.rstrip()
        padding = b"7" * 4 * LONGEST
        inside = payload.replace(b"{", b'{"padding":"' + padding + b'",', 1) if is_json(vector) else padding + payload
        decoder = opened(subject, vector)
        events: list[Event] = []
        n_fed = 0
        for piece in _pieces(inside + end):
            events = said([*events, *decoder.feed(piece)])
            n_fed += len(piece)
            _check_held(decoder, events, n_fed, f"{vector}, made too long")
            if any(isinstance(event, Refused) for event in events):
                break
        if any(isinstance(event, (Frame, Occurrence)) for event in events):
            raise CheckFailed(f"{vector} with {len(padding)} bytes of padding is read: reject what is too long")
        if not any(isinstance(event, (Reject, Refused)) for event in events):
            raise CheckFailed(f"{vector} with {len(padding)} bytes of padding is not rejected: count what is too long")
        if isinstance(events[-1], Refused):
            continue
        tell(decoder, vector.asked)
        after = decoder.feed(vector.raw)
        ended = any(isinstance(event, Refused) for event in after)
        if not ended and told(the_event(subject, vector)) not in [told(event) for event in after]:
            raise CheckFailed(f"after a line that is too long, {vector} gives {shown(after)}: go on at the line's end")


def junk_lines_tell_nothing(subject: Subject) -> None:
    """Random bytes, random lines and pieces of messages raise nothing, fill no memory and give nothing untrue."""
    chance, end = subject.random(), ending(subject) or b"\n"
    junk = [chance.randbytes(chance.randint(0, 60)).replace(end, b"") + end for _ in range(_LINES)]
    words = [bytes(chance.choices(_READABLE, k=chance.randint(0, 60))) + end for _ in range(_LINES)]
    for name, stream in (
        ("random bytes", chance.randbytes(_JUNK)),
        ("random lines", b"".join(junk)),
        ("random readable lines", b"".join(words)),
    ):
        decoder, events = subject.protocol.reader(), cast("list[Event]", [])
        for number, piece in enumerate(_pieces(stream), start=1):
            events += decoder.feed(piece)
            if frames(events) or any(isinstance(event, Occurrence) for event in events):
                raise CheckFailed(f"{name} tell {shown(events[-1:])}: reject what is no message")
            _check_held(decoder, events, min(number * _PIECE, len(stream)), name)
            if any(isinstance(event, Refused) for event in events):
                break
    for vector in different(subject):
        for other in different(subject):
            size = chance.randrange(len(vector.raw))
            spliced = vector.raw[:size] + other.raw[chance.randrange(len(other.raw)) :]
            where = f"{size} bytes of {vector} with the end of {other}"
            for event in opened(subject, vector).feed(spliced):
                check_told(subject, vector, event, where)


def _hurts(raw: bytes) -> Iterator[tuple[int, str, bytes]]:
    """Each byte of a message damaged in every way."""
    for at in range(len(raw)):
        for how, bits in (("inverted", 0xFF), ("with its lowest bit changed", 1), ("with a bit changed", 1 << at % 8)):
            yield at, how, damaged(raw, at, bits)
        yield at, "taken out", raw[:at] + raw[at + 1 :]
        yield at, "doubled", raw[: at + 1] + raw[at:]


def _play(subject: Subject, vector: Vector, hurt: bytes, where: str = "") -> list[Event]:
    """What a damaged message gives, and the good ones behind it, until the session is refused."""
    decoder = opened(subject, vector)
    events = said(decoder.feed(hurt))
    stream = hurt
    for _ in range(_GOODS):
        if any(isinstance(event, Refused) for event in events):
            return events
        tell(decoder, vector.asked)
        events = said([*events, *decoder.feed(vector.raw)])
        stream += vector.raw
    if not any(isinstance(event, Refused) for event in events):
        check_conserved(stream, events, decoder.end(), f"message by message ({where or vector})", blank=True)
    return events


def _check_begun(
    subject: Subject,
    vector: Vector,
    reference: Event,
    events: Sequence[Event],
    damage: tuple[int, bytes],
    where: str,
) -> None:
    """Check what comes out of a damaged message itself: what begins in it."""
    hurt, begin = damage[1], 0
    for event in events:
        if isinstance(event, Refused) or begin >= len(hurt):
            return
        if isinstance(event, (Frame, Occurrence)):
            if begin + len(event.raw) > len(hurt):
                raise CheckFailed(f"{where}: {event} mixes two messages: reject what no end separates")
            check_told(subject, vector, event, where)
            _check_same(vector, reference, event, damage, where)
        begin += len(event.raw)


def _check_same(vector: Vector, reference: Event, event: Event, damage: tuple[int, bytes], where: str) -> None:
    if isinstance(event, Occurrence):
        if not isinstance(reference, Occurrence) or len(event.entries) > len(reference.entries):
            raise CheckFailed(f"{where} says that something has happened, which did not: {event}")
        return
    if not isinstance(event, Frame) or not isinstance(reference, Frame):
        if isinstance(event, Frame):
            raise CheckFailed(f"{where} is read as {event}, but carries no state: reject or skip it")
        return
    if event.layout is not reference.layout:
        raise CheckFailed(f"{where} is read as {event} instead of {reference}")
    at, hurt = damage
    differing = changes(reference, event)
    stray = differing - touched(vector, hurt, at, reference, event)
    word = hurt[at : at + 1] if len(hurt) == len(vector.raw) else b""
    if not is_json(vector) and word and {vector.raw[at], word[0]} <= _WORD and len(differing) > 1:
        stray |= differing
    if stray:
        name = min(stray)
        inside = " and ".join(sorted(members_at(vector.raw, at))) or "no member" if is_json(vector) else "one word"
        raise CheckFailed(
            f"{where}, in {inside}: {name} is {event.values.get(name)!r} instead of {reference.values.get(name)!r}: "
            "take each value from its own place alone",
        )


def _check_found(vector: Vector, reference: Event, events: Sequence[Event], start: int, count: int, where: str) -> None:
    """Check that the last good messages behind a damaged one are found."""
    if any(isinstance(event, Refused) for event in events):
        return
    for number in range(_GOODS - count, _GOODS):
        found = same_place(events, start + number * len(vector.raw))
        if found is None or type(found) is not type(reference):
            raise CheckFailed(
                f"{where} costs good message {number + 1} of {_GOODS} behind it, of {shown(events)}: go on at the end "
                "of a message that is wrong",
            )
        same = not changes(reference, found) if isinstance(found, Frame) and isinstance(reference, Frame) else True
        if not same:
            raise CheckFailed(f"{where} changes what the good message behind it tells: keep nothing of a wrong one")


def _check_cut(subject: Subject, vector: Vector, reference: Event, cut: bytes, where: str) -> None:
    decoder = opened(subject, vector)
    events = said(decoder.feed(cut))
    for event in events:
        if isinstance(event, (Frame, Occurrence)) and is_json(vector):
            raise CheckFailed(f"{where}, then the end of a line, tell {event}: reject what is not whole")
        check_told(subject, vector, event, where)
        if isinstance(event, Frame) and isinstance(reference, Frame):
            new = event.values.keys() - reference.values.keys()
            torn = [name for name, now in event.values.items() if not is_kept(reference.values.get(name), now)]
            if new or torn:
                raise CheckFailed(f"{where} tell {min([*new, *torn])} otherwise than the whole message does")
    if not any(isinstance(event, Refused) for event in events):
        tell(decoder, vector.asked)
        events += decoder.feed(vector.raw)
        check_conserved(cut + vector.raw, events, decoder.end(), f"cut ({where})", blank=True)
        found = same_place(events, len(cut))
        if not any(isinstance(event, Refused) for event in events) and type(found) is not type(reference):
            raise CheckFailed(f"{where}, then the end of a line: the good message is not found, but {shown(events)}")


def _check_held(decoder: Decoder, events: Sequence[Event], n_fed: int, where: str) -> None:
    """Check how many bytes a decoder keeps: those that no event holds yet."""
    given = sum(0 if isinstance(event, Refused) else len(event.raw) for event in events)
    ended = any(isinstance(event, Refused) for event in events)
    held = max(0 if ended else n_fed - given, pending(decoder))
    if held > LONGEST:
        raise CheckFailed(f"{where}: {held} bytes wait for the end of their line, allowed are {LONGEST}: reject them")


def _pieces(data: bytes) -> Iterator[bytes]:
    return (data[at : at + _PIECE] for at in range(0, len(data), _PIECE))
