"""Decoders: no exception, no byte lost, the same frames however the stream is cut, nothing sent that is not allowed.

byte 0    bit 0: a live session rather than a reader; bit 1: the controller's ticks go on meanwhile
byte 1    how the stream is cut
byte 2    which options of the vectors, and which of their questions
byte 3 …  the stream
"""

from __future__ import annotations

import random
import re
from collections.abc import Mapping
from functools import partial

import msgspec

from gateway.api.decoder import AskedDecoder, Decoder, Event, Frame, Occurrence, Refused, Skipped
from gateway.api.model import GROUPS
from gateway.testing.canonical_checks import group_fits
from gateway.testing.readings import read_group
from gateway.testing.streams import check_conserved
from gateway.testing.subject import CheckFailed, Subject
from gateway.testing.vectors import Vector
from tests.fuzz.target import Target

_HEAD = 3
_LIVE, _TICKING = 1, 2
_READ = 3  # so many frames of a stream are normalised
_SESSIONS = 2
_LONGEST_SEED = 4096


def target(subject: Subject) -> Target:
    """The decoders of one protocol: the one that only reads, and those of its sessions."""
    singles = [vector.raw for vector in subject.vectors]
    several = [b"".join(vector.raw for vector in session)[:_LONGEST_SEED] for session in _sessions(subject)]
    heads = (bytes(_HEAD), bytes((_LIVE | _TICKING, 7, 1)))
    seeds = tuple(head + raw for raw in dict.fromkeys([*singles, *several]) for head in heads)
    return Target(f"{subject.vendor.name}-{subject.protocol.name}", partial(_run, subject), seeds)


def _sessions(subject: Subject) -> list[tuple[Vector, ...]]:
    return list(subject.sessions) if subject.protocol.framing else [subject.vectors]


def _run(subject: Subject, data: bytes) -> None:
    mode, seed, choice = data[:_HEAD].ljust(_HEAD, b"\0")
    stream = data[_HEAD:]
    pieces = _pieces(stream, random.Random(seed))  # noqa: S311 - test data, no secrets
    given = [vector.options for vector in subject.vectors]
    options = given[choice % len(given)]
    if mode & _LIVE:
        factory = subject.protocol.decoders(subject.options(options))
        for _ in range(_SESSIONS):  # what the first has learned, the second knows
            _play_live(subject, factory(), pieces, ticking=bool(mode & _TICKING))
        return
    whole = _play(subject, _asked(subject, choice), [stream])
    cut = _play(subject, _asked(subject, choice), pieces)
    if _told(whole) != _told(cut):
        raise CheckFailed(f"whole: {_shown(whole)}; cut by seed {seed}: {_shown(cut)}")
    _normalise(subject, options, whole)


def _pieces(stream: bytes, chance: random.Random) -> list[bytes]:
    found, at = [], 0
    largest = chance.choice((1, 7, 100, 3000)) if len(stream) < _LONGEST_SEED else 3000
    while at < len(stream):
        size = chance.randint(1, largest)
        found.append(stream[at : at + size])
        at += size
    return found


def _asked(subject: Subject, choice: int) -> Decoder:
    decoder = subject.protocol.reader()
    questions = list(dict.fromkeys(vector.asked for vector in subject.vectors if vector.asked is not None))
    if questions and isinstance(decoder, AskedDecoder):
        decoder.asked(questions[choice % len(questions)])
    return decoder


def _play(subject: Subject, decoder: Decoder, pieces: list[bytes]) -> list[Event]:
    """What a decoder that only reads makes of a stream, up to where it refuses to go on."""
    events: list[Event] = []
    fed = b""
    for piece in pieces:
        events += decoder.feed(piece)
        fed += piece
        if any(isinstance(event, Refused) for event in events):
            break
    left = decoder.end()
    check_conserved(fed, events, left, "so", blank=bool(subject.protocol.records))
    refused = next((at for at, event in enumerate(events) if isinstance(event, Refused)), len(events))
    return events[:refused]


def _play_live(subject: Subject, decoder: Decoder, pieces: list[bytes], *, ticking: bool) -> None:
    """The same for a session: whatever comes, it sends what is allowed and nothing else."""
    events: list[Event] = []
    fed = b""
    _check_sent(subject, decoder.outgoing())
    for piece in pieces:
        if ticking:
            sent = decoder.tick()
            if isinstance(sent, Refused):
                break
            _check_sent(subject, sent)
        events += decoder.feed(piece)
        fed += piece
        _check_sent(subject, decoder.outgoing())
        if any(isinstance(event, Refused) for event in events):
            break
    _ = decoder.ready, decoder.gaps, list(decoder.notes)
    check_conserved(fed, events, decoder.end(), "live", blank=bool(subject.protocol.records))
    _check_sent(subject, decoder.goodbye())


def _check_sent(subject: Subject, sent: bytes) -> None:
    if sent and not any(re.fullmatch(pattern, sent, re.DOTALL) for pattern in subject.protocol.outgoing):
        raise CheckFailed(f"{sent!r} would be sent, which the protocol's row does not allow")


def _normalise(subject: Subject, options: Mapping[str, object], events: list[Event]) -> None:
    """Read the first frames as the gateway would: every group has the model's types, and every encoding takes it."""
    frames = [event for event in events if isinstance(event, Frame)]
    normaliser = subject.normaliser(options)
    for frame in frames[:_READ]:
        for group in normaliser.readers(frame.layout):
            fits = group in GROUPS and group != "vendor"
            reading = group_fits(normaliser, group, frame, "fuzz") if fits else read_group(normaliser, group, frame)
            msgspec.json.encode(reading.struct)
            msgspec.msgpack.encode(reading.struct)
    for event in events:
        if isinstance(event, Occurrence):
            msgspec.json.encode(event.entries)
            msgspec.msgpack.encode(event.entries)


def _told(events: list[Event]) -> list[tuple[str, bytes]]:
    """What must be the same however the stream is cut."""
    told = (Frame, Occurrence, Skipped)
    return [(type(event).__name__, event.raw) for event in events if isinstance(event, told) and event.raw]


def _shown(events: list[Event]) -> str:
    return ", ".join(map(str, events))
