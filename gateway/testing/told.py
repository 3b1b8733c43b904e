"""What a message of a text protocol tells: whether it may be told at all, and what differs from another message."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator, Sequence

import msgspec

from gateway.api.decoder import Event, Frame, Occurrence, Reject, Skipped
from gateway.testing.canonical_checks import group_fits
from gateway.testing.playing import is_json
from gateway.testing.readings import leaves, plain
from gateway.testing.subject import CheckFailed, Subject, record_of
from gateway.testing.vectors import Vector

Told = tuple[object, ...]
_TOKEN = re.compile(rb'"(?:\\.|[^"\\])*"|[{}\[\],:]|[^\s{}\[\],:"]+')


def told(event: Event) -> Told:
    """What an event tells, without its bytes: comparable."""
    if isinstance(event, Frame):
        return ("frame", event.layout.name, event.quality, plain(dict(event.values)))
    if isinstance(event, Occurrence):
        return ("occurrence", plain(event.entries))
    return (type(event).__name__, event.reason)


def check_told(subject: Subject, vector: Vector, event: Event, where: str) -> None:
    """Check that what an event tells may be told: known names, their types, finite, and good for every encoding.

    Raises:
        CheckFailed: It may not.
    """
    if isinstance(event, Occurrence):
        for entry in event.entries:
            _check_encodes(entry.data, f"{where}: the data of {entry.kind}")
            _check_encodes(entry.raw, f"{where}: the raw values of {entry.kind}")
    if not isinstance(event, Frame):
        return
    record = record_of(event)
    if not any(record is known for known in subject.records):
        raise CheckFailed(f"{where}: record {record.name} is none of Protocol.records: name it there")
    for name, value in event.values.items():
        if name not in record.by_name:
            raise CheckFailed(f"{where}: a value {name!r} comes, which record {record.name} does not have")
        try:
            record.convert(name, value)
        except ValueError as error:
            raise CheckFailed(f"{where}: {error}: take values through Record.convert, or reject the message") from error
        _check_encodes(value, f"{where}: {name}")
    normaliser = subject.normaliser(vector.options)
    for group in normaliser.groups:
        if group != "vendor":
            group_fits(normaliser, group, event, where)


def changes(reference: Frame, frame: Frame) -> set[str]:
    """The names of the values that two messages do not tell alike; those that the decoder makes itself are not seen."""
    own = {value.name for value in record_of(reference).fields if value.own}
    was, now = plain(dict(reference.values)), plain(dict(frame.values))
    names = (was.keys() | now.keys()) - own
    return {name for name in names if name not in was or name not in now or was[name] != now[name]}


def touched(vector: Vector, hurt: bytes, at: int, reference: Frame, frame: Frame) -> set[str]:
    """The names whose values damage at one byte may change.

    In JSON those of the members around it, before or after, those that hold such a member, and those that no member has
    the name of; never one that was not there and that the damage does not write. In other text all that were there.
    """
    if not is_json(vector):
        return set(reference.values)
    around = members_at(vector.raw, at) | members_at(hurt, at) | members_at(hurt, at - 1)
    members = {name for _, _, name in _members(vector.raw)}
    made = {name for name in reference.values if members.isdisjoint(name.split("."))}
    holding = {
        name for name, value in (*reference.values.items(), *frame.values.items()) if around & set(_names(plain(value)))
    }
    named = {name for name in {*reference.values, *frame.values} if not around.isdisjoint([name, *name.split(".")])}
    return made | holding | named


def members_at(raw: bytes, at: int) -> set[str]:
    """The names of the JSON members that a byte stands in, the innermost and all around it."""
    return {name for start, end, name in _members(raw) if start <= at < end}


def same_place(events: Sequence[Event], start: int) -> Event | None:
    """The event whose bytes begin at a place of the stream."""
    at = 0
    for event in events:
        if isinstance(event, (Frame, Occurrence, Skipped, Reject)):
            if at == start:
                return event
            at += len(event.raw)
    return None


def _members(raw: bytes) -> Iterator[tuple[int, int, str]]:
    """Each member of each object in a text: where its name begins, where its value ends, and its name."""
    above: list[tuple[bytes, int, str | None]] = []  # of each open object or array: its bracket, and the open member
    for token in _TOKEN.finditer(raw):
        word, bracket = token.group(), above[-1][0] if above else b""
        if word in {b"{", b"["}:
            above.append((word, 0, None))
        elif word in {b"}", b"]", b","} and above:
            _, start, name = above.pop()
            if name is not None:
                yield start, token.start(), name
            if word == b",":
                above.append((bracket, 0, None))
        elif word.startswith(b'"') and bracket == b"{" and above[-1][2] is None:
            above[-1] = (bracket, token.start(), _text(word))


def _names(value: object) -> Iterator[str]:
    """The names of all members inside a value."""
    if isinstance(value, dict):
        yield from value
    for below in value.values() if isinstance(value, dict) else value if isinstance(value, list) else ():
        yield from _names(below)


def _text(word: bytes) -> str:
    try:
        return str(json.loads(word))
    except ValueError:
        return word.decode(errors="replace")


def _check_encodes(value: object, where: str) -> None:
    try:
        found = plain(value)
        msgspec.json.encode(found)
        msgspec.msgpack.encode(found)
    except (TypeError, ValueError, OverflowError) as error:
        raise CheckFailed(f"{where} cannot be sent on: {error}: reject what no encoding can hold") from error
    for path, leaf in leaves(found):
        if isinstance(leaf, float) and not math.isfinite(leaf):
            raise CheckFailed(f"{where}{'.' if path else ''}{path} is {leaf}: reject it, or tell null")


def is_kept(was: object, now: object) -> bool:
    """Whether a list of numbers that was cut keeps the elements before the last, as they were."""
    if not isinstance(was, list) or not isinstance(now, list):
        return True
    return now[:-1] == was[: max(0, len(now) - 1)]
