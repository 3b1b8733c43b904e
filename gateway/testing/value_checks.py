"""Checks of the values of text protocols: what a text may say and a value may not, and what follows from each value."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator

import msgspec

from gateway.api.decoder import Frame, Occurrence
from gateway.api.lines import LONGEST
from gateway.api.model import FRAME_GROUPS, GROUPS
from gateway.api.normaliser import Normaliser
from gateway.testing.playing import different, ending, is_json, opened, said
from gateway.testing.readings import read_group, tells, value_at
from gateway.testing.subject import CheckFailed, DoesNotApply, Subject
from gateway.testing.told import check_told
from gateway.testing.vector_checks import the_event, the_frame
from gateway.testing.vectors import Vector

_NUMBER = re.compile(rb"-?\d+(?:\.\d+)?(?:[eE][+-]?\d+)?")
_NO_NUMBERS = (b"nan", b"NaN", b"inf", b"-inf", b"Infinity", b"-Infinity", b"1e999", b"-1e999", b"9" * 400)
_DEEP = LONGEST // 8  # brackets: a line of that depth is not too long
_MARK = "\N{REPLACEMENT CHARACTER}here\N{REPLACEMENT CHARACTER}"
# What stands in place of a value: of another type each, null, and text that no encoding can hold.
_OTHERS = (
    b"null",
    b"true",
    b"[]",
    b"{}",
    b"[[]]",
    b'[{"":[]}]',
    b'""',
    b'"text"',
    b"-1",
    b"0.5",
    b'"\\ud800"',
    b'"\\u0000"',
)
_NO_OBJECTS = (b"[]", b"null", b"true", b"1", b'"text"', b"{}", b"NaN", b"[%s]", b'{"type":%s}', b"%s%s")


def values_have_their_types(subject: Subject) -> None:
    """Every value of every vector is one of its record, has its type, is finite, and survives both encodings."""
    for vector in subject.vectors:
        check_told(subject, vector, the_event(subject, vector), str(vector))


def numbers_stay_finite(subject: Subject) -> None:
    """NaN, infinity and numbers too large in place of any number of any message are never told."""
    for vector in different(subject):
        for found in _NUMBER.finditer(vector.raw):
            for text in _NO_NUMBERS:
                hurt = vector.raw[: found.start()] + text + vector.raw[found.end() :]
                where = f"{vector} with {text[:12].decode()} at byte {found.start()}"
                for event in opened(subject, vector).feed(hurt):
                    check_told(subject, vector, event, where)


def json_is_taken_with_care(subject: Subject) -> None:
    """JSON that is no object, nests without end or holds values of other types raises nothing, tells nothing false."""
    vectors = [vector for vector in different(subject) if is_json(vector)]
    if not vectors:
        raise DoesNotApply("its messages are no JSON objects")
    for vector in vectors:
        payload, end = vector.raw.rstrip(), ending(subject, vector)
        for shape in _NO_OBJECTS:
            hurt = shape.replace(b"%s", payload) + end
            for event in said(opened(subject, vector).feed(hurt)):
                if isinstance(event, (Frame, Occurrence)):
                    raise CheckFailed(f"{vector} inside {shape.decode()} tells {event}: take one object a line")
        for where, hurt in _with_others(payload):
            for event in opened(subject, vector).feed(hurt + end):
                check_told(subject, vector, event, f"{vector} with {where}")


def named_values_move_keys(subject: Subject) -> None:
    """A state group's key changes with every value that the group follows from, and with no other."""
    if all(GROUPS[group].delivery != "state" for group in _canonical(subject.normaliser())):
        raise DoesNotApply("no row fills a state group")
    for vector, frame in _frames(subject):
        normaliser = subject.normaliser(vector.options)
        readers = normaliser.readers(frame.layout)
        for group in _canonical(normaliser):
            if GROUPS[group].delivery != "state":
                continue
            rows = [row for row in normaliser.signals if row.group == group and not row.volatile]
            watched = {source for row in rows for source in row.sources}
            for name, value in frame.values.items():
                for other in (None, (value,)):  # no value, and one that is none of those that it was
                    hurt = msgspec.structs.replace(frame, values={**frame.values, name: other})
                    moved = readers[group].key(hurt) != readers[group].key(frame)
                    follows = name in watched and other != value
                    if moved != follows:
                        verb = "changes" if moved else "does not change"
                        raise CheckFailed(f"{vector}: the key of {group} {verb} with {name}: correct the row's sources")


def what_is_not_told_is_null(subject: Subject) -> None:
    """A value that a message leaves out, or tells as null, makes null of what follows from it, and of nothing else."""
    for vector, frame in _frames(subject):
        normaliser = subject.normaliser(vector.options)
        for name in frame.values:
            rest = {other: value for other, value in frame.values.items() if other != name}
            for values, how in ((rest, "left out"), ({**rest, name: None}, "null")):
                hurt = msgspec.structs.replace(frame, values=values)
                _check_null(normaliser, frame, hurt, name, f"{vector} with {name} {how}")


def _check_null(normaliser: Normaliser, frame: Frame, hurt: Frame, name: str, where: str) -> None:
    vendor = read_group(normaliser, "vendor", hurt).data
    if name not in vendor or tells(vendor[name]):
        raise CheckFailed(f"{where}: vendor.{name} is {vendor.get(name, 'missing')!r}: show null under every name")
    for group in _canonical(normaliser):
        rows = [row for row in normaliser.signals if row.group == group]
        naming = [row for row in rows if name in row.sources]
        before, after = read_group(normaliser, group, frame).data, read_group(normaliser, group, hurt).data
        for row in naming:
            told = value_at(after, row.path)
            if not row.partial and tells(told):
                raise CheckFailed(f"{where}: {row.key} is {told!r}: what nothing is known of is null")
        for row in rows:
            if row not in naming and value_at(before, row.path) != value_at(after, row.path):
                raise CheckFailed(f"{where}: {row.key} changes, which does not name it: name every source")


def _with_others(payload: bytes) -> Iterator[tuple[str, bytes]]:
    """A JSON object with each of its values, the containers too, replaced by each of some others, and by a deep one."""
    deep = b"[" * _DEEP + b"]" * _DEEP, b'{"a":' * _DEEP + b"1" + b"}" * _DEEP
    for path, marked in _marked(json.loads(payload)):
        before, _, after = json.dumps(marked).partition(json.dumps(_MARK))
        for other in (*_OTHERS, *deep):
            yield f"{other[:12].decode()} at {path}", before.encode() + other + after.encode()


def _marked(value: object) -> Iterator[tuple[str, object]]:
    """A copy of a JSON value for each value inside it, with a mark in its place."""
    if isinstance(value, dict):
        for name, below in value.items():
            yield str(name), {**value, name: _MARK}
            yield from ((f"{name}.{path}", {**value, name: marked}) for path, marked in _marked(below))
    elif isinstance(value, list):
        for index, below in enumerate(value):
            places = [("", _MARK), *((f".{path}", marked) for path, marked in _marked(below))]
            yield from ((f"[{index}]{path}", [*value[:index], one, *value[index + 1 :]]) for path, one in places)


def _frames(subject: Subject) -> Iterator[tuple[Vector, Frame]]:
    for vector in subject.states:
        frame = the_frame(subject, vector)
        if frame is not None:
            yield vector, frame


def _canonical(normaliser: Normaliser) -> list[str]:
    return [group for group in normaliser.groups if group in FRAME_GROUPS]
