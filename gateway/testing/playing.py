"""Vectors played to decoders that only read: with what was asked before them, and what the same decoder read first."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from gateway.api.decoder import AskedDecoder, Decoder, Event, Frame, Occurrence, Reject, Skipped
from gateway.api.model import EventKind
from gateway.testing.subject import CheckFailed, Subject
from gateway.testing.vectors import Vector


@dataclass(frozen=True, slots=True)
class Turn:
    """What is received after one question, or without any.

    Attributes:
        asked: The question as it was sent, or None.
        raw: The bytes that are received.
    """

    asked: bytes | None
    raw: bytes


def turns_of(vectors: Iterable[Vector]) -> list[Turn]:
    """The turns of some vectors; what needs no question is joined to what came before it."""
    found: list[Turn] = []
    for vector in vectors:
        if vector.asked is None and found:
            found[-1] = Turn(found[-1].asked, found[-1].raw + vector.raw)
        else:
            found.append(Turn(vector.asked, vector.raw))
    return found


def history(vector: Vector) -> list[Vector]:
    """What the same decoder has read before a vector, oldest first."""
    found: dict[str, Vector] = {}
    for earlier in vector.before:
        found |= {one.name: one for one in (*history(earlier), earlier)}
    return list(found.values())


def tell(decoder: Decoder, asked: bytes | None) -> None:
    """Tell a decoder what was asked.

    Raises:
        CheckFailed: It takes no questions.
    """
    if asked is None:
        return
    if not isinstance(decoder, AskedDecoder):
        raise CheckFailed(
            f"vectors say what was asked, but {type(decoder).__name__} of Protocol.make_reader takes no questions: "
            "give it a method `asked(data)`, see gateway.api.decoder.AskedDecoder",
        )
    decoder.asked(asked)


def opened(subject: Subject, vector: Vector) -> Decoder:
    """A decoder that has read what comes before a vector, and knows what was asked."""
    decoder = subject.protocol.reader()
    for earlier in history(vector):
        tell(decoder, earlier.asked)
        events = decoder.feed(earlier.raw)
        if len(events) != 1 or not isinstance(events[0], (Frame, Occurrence, Skipped)):
            raise CheckFailed(
                f"{vector} comes after {earlier.name}, which gives {shown(events)}: correct `before`, or the decoder"
            )
    tell(decoder, vector.asked)
    return decoder


def said(events: Iterable[Event]) -> list[Event]:
    """Events without the notices that a rejected message may have held commands: they tell nothing of the robot."""
    found: list[Event] = []
    for event in events:
        behind = bool(found) and isinstance(found[-1], Reject)
        if not (behind and isinstance(event, Occurrence) and not event.raw and _missed_alone(event)):
            found.append(event)
    return found


def _missed_alone(event: Occurrence) -> bool:
    return all(entry.kind is EventKind.COMMAND_MISSED for entry in event.entries)


def shown(events: Sequence[Event]) -> str:
    """Some events in words."""
    return ", ".join(map(str, events)) or "nothing"


def ending(subject: Subject, vector: Vector | None = None) -> bytes:
    """What ends a message of a text protocol: the white space behind it; without a vector, of the one that has most."""
    vectors = subject.vectors if vector is None else (vector,)
    return max((one.raw[len(one.raw.rstrip()) :] for one in vectors), key=len)


def is_json(vector: Vector) -> bool:
    """Whether a message is a JSON object."""
    return vector.raw.lstrip().startswith(b"{")


def different(subject: Subject) -> list[Vector]:
    """The vectors that differ in what is received, asked or read before."""
    found = {(vector.raw, vector.asked, tuple(one.name for one in vector.before)): vector for vector in subject.vectors}
    return list(found.values())


def sessions(subject: Subject) -> list[list[Vector]]:
    """The vectors as sessions may carry them: those with one history together, and each that begins a history."""
    opening = {earlier.name for vector in subject.vectors for earlier in vector.before}
    found: dict[tuple[str, ...], list[Vector]] = {}
    alone: list[list[Vector]] = []
    for vector in subject.vectors:
        if vector.name in opening:
            alone.append([*history(vector), vector])
        else:
            found.setdefault(tuple(one.name for one in vector.before), []).append(vector)
    return alone + [[*history(group[0]), *group, group[0]] for group in found.values()]
