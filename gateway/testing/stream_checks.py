"""Checks of streams: how they are cut changes nothing, and what is no frame gives none."""

from __future__ import annotations

import random
from collections.abc import Iterator, Sequence

from gateway.api.decoder import Decoder, Event, Frame, Refused, Reject, Skipped
from gateway.api.record import Record
from gateway.testing.playing import Turn, sessions, tell, turns_of
from gateway.testing.streams import check_conserved, cuts, feed_all, frames, pending, placed
from gateway.testing.subject import CheckFailed, Subject
from gateway.testing.told import told
from gateway.testing.vectors import Vector

_GARBAGE = 65_536  # bytes of garbage; chance makes a frame of it once in very many seeds
_JUNK = 37  # bytes of junk between two frames


def cuts_change_nothing(subject: Subject) -> None:
    """The same frames come whole, byte by byte, in random cuts and joined, and no byte is lost."""
    for turns, expected in _clean_streams(subject):
        stream = b"".join(turn.raw for turn in turns)
        for how, played in _cut(turns, subject.random()):
            decoder = subject.protocol.reader()
            events: list[Event] = []
            for asked, chunks in played:
                tell(decoder, asked)
                events += feed_all(decoder, chunks)
            check_conserved(stream, events, decoder.end(), how, blank=bool(subject.protocol.records))
            found = [_told(event) for event in events]
            if found != expected:
                at = next(
                    (i for i, pair in enumerate(zip(found, expected, strict=False)) if pair[0] != pair[1]), len(found)
                )
                raise CheckFailed(
                    f"a stream of {len(expected)} good frames, fed {how}, gives {len(found)} events, and event {at} is "
                    f"{events[at] if at < len(events) else 'missing'}: a decoder must not depend on how bytes arrive",
                )


def junk_is_rejected(subject: Subject) -> None:
    """Junk between frames becomes counted rejects, costs no frame that does not begin in it, however it is cut."""
    chance = subject.random()
    magic = subject.framing.magic
    harmless = bytes(byte for byte in chance.randbytes(_JUNK * 4) if byte not in magic)[:_JUNK]
    for session in subject.sessions:
        stream = harmless + b"".join(vector.raw + harmless for vector in session)
        wanted = [vector.raw for vector in session]
        for how, events in _fed(subject, stream):
            if [frame.raw for frame in frames(events)] != wanted:
                raise CheckFailed(
                    f"with junk between them, and fed {how}, {len(frames(events))} of {len(wanted)} frames come"
                )
            rejects = [event for event in events if isinstance(event, Reject)]
            if sum(len(reject.raw) for reject in rejects) != len(stream) - sum(map(len, wanted)):
                raise CheckFailed(f"junk between frames, fed {how}, is not all rejected: return it as Reject")
            if not all(reject.reason for reject in rejects):
                raise CheckFailed("a Reject has no reason: name one short, stable word that a counter can be kept by")
        _check_tempting_junk(subject, session)


def garbage_gives_nothing(subject: Subject) -> None:
    """Random bytes, with and without magics among them, give no frame, no exception and a bounded buffer."""
    framing = subject.framing
    noise = bytearray(subject.random().randbytes(_GARBAGE))
    for name, garbage in (
        ("random", bytes(noise)),
        ("random with magics", _with_magics(noise, framing.magic, subject)),
    ):
        decoder = subject.protocol.reader()
        for at in range(0, len(garbage), 509):
            events = decoder.feed(garbage[at : at + 509])
            if frames(events):
                raise CheckFailed(f"{name} bytes give {frames(events)[0]}: check magic, length, type and tail")
            _check_bounded(decoder, framing.largest)


def cut_frames_are_truncated(subject: Subject) -> None:
    """A frame that a closed connection cuts at any byte gives no frame, and its bytes are rejected at the end."""
    for vector in subject.vectors:
        for size in range(1, len(vector.raw)):
            decoder = subject.protocol.reader()
            events = decoder.feed(vector.raw[:size])
            left = decoder.end()
            check_conserved(vector.raw[:size], events, left, f"as a stream that ends after {size} bytes")
            if any(isinstance(event, (Frame, Skipped)) for event in events):
                raise CheckFailed(f"the first {size} bytes of {vector} are taken for {events[0]}: wait for its length")
        decoder = subject.protocol.reader()
        decoder.feed(vector.raw[:-1])
        decoder.end()
        if decoder.feed(vector.raw)[-1:] == [] or pending(decoder):
            raise CheckFailed(f"after end(), {vector} is not found any more: end() must empty the buffer")


def _cut(turns: Sequence[Turn], chance: random.Random) -> Iterator[tuple[str, list[tuple[bytes | None, list[bytes]]]]]:
    """Ways to cut a stream, turn by turn."""
    ways = zip(*(cuts(turn.raw, chance) for turn in turns), strict=True)
    for way in ways:
        yield way[0][0], [(turn.asked, chunks) for turn, (_, chunks) in zip(turns, way, strict=True)]


def _clean_streams(subject: Subject) -> list[tuple[list[Turn], list[object]]]:
    """Streams of good frames, skipped ones among them, and what must come out."""
    return _clean_text(subject) if subject.protocol.records else _clean_frames(subject)


def _clean_text(subject: Subject) -> list[tuple[list[Turn], list[object]]]:
    """Sessions of messages, and what comes out where each message is fed whole, one after the other."""
    streams = []
    for session in sessions(subject):
        decoder = subject.protocol.reader()
        expected: list[object] = []
        for vector in session:
            tell(decoder, vector.asked)
            events = decoder.feed(vector.raw)
            if any(isinstance(event, Refused) for event in events):
                break
            expected += map(_told, events)
        else:
            streams.append((turns_of(session), expected))
    return streams


def _clean_frames(subject: Subject) -> list[tuple[list[Turn], list[object]]]:
    """Streams of binary frames, and what must come out."""
    streams = []
    for session in subject.sessions:
        vectors: list[Vector] = []
        for number, vector in enumerate(session):
            vectors += [vector, *subject.skipped[number : number + 1], vector]
        vectors += [*subject.skipped, session[0]]
        expected: list[object] = [
            (vector.layout, vector.quality, vector.raw) if vector.layout else (vector.skipped, vector.raw)
            for vector in vectors
        ]
        streams.append((turns_of(vectors), expected))
    return streams


def _told(event: Event) -> object:
    if isinstance(event, Frame):
        key = (event.layout.name, event.quality, event.raw)
        return (*key, told(event)) if isinstance(event.layout, Record) else key
    return (event.reason, event.raw) if isinstance(event, Skipped) else event


def _fed(subject: Subject, stream: bytes) -> list[tuple[str, list[Event]]]:
    found = []
    for how, chunks in cuts(stream, subject.random()):
        decoder = subject.protocol.reader()
        events = feed_all(decoder, chunks)
        left = decoder.end()
        check_conserved(stream, events, left, how)
        found.append((how, [*events, *left]))
    return found


def _check_tempting_junk(subject: Subject, session: Sequence[Vector]) -> None:
    """Junk full of magics may cost the frames that it seems to reach into, but cuts change nothing."""
    framing = subject.framing
    junk = _with_magics(bytearray(subject.random().randbytes(_JUNK)), framing.magic, subject)
    good = session[0].raw * (framing.largest // len(session[0].raw) + 2)
    stream = good + b"".join(junk + vector.raw for vector in session) + junk + good
    runs = _fed(subject, stream)
    first = [(place.start, place.event.raw) for place in placed(runs[0][1]) if isinstance(place.event, Frame)]
    for how, events in runs[1:]:
        found = [(place.start, place.event.raw) for place in placed(events) if isinstance(place.event, Frame)]
        if found != first:
            raise CheckFailed(
                f"with junk between them, other frames come {how} than whole: decide on bytes, not on chunks"
            )
    last = len(stream) - len(session[0].raw)
    if not first or first[-1][0] != last:
        raise CheckFailed(f"after junk, the next good frame is not found within {framing.largest} bytes: search on")


def _with_magics(noise: bytearray, magic: bytes, subject: Subject) -> bytes:
    """Put a magic every few bytes, so that headers begin everywhere."""
    chance = subject.random()
    found = bytearray()
    at = 0
    while at < len(noise):
        step = chance.randint(1, 24)
        found += magic + noise[at : at + step]
        at += step
    return bytes(found)


def _check_bounded(decoder: Decoder, largest: int) -> None:
    if pending(decoder) > largest:
        raise CheckFailed(f"{pending(decoder)} bytes wait in the buffer; no frame has more than {largest}: reject them")
