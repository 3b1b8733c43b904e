"""Checks of values: every vector decodes to what it must, one frame at a time and in bulk, and encodes back."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from gateway.api.decoder import Event, Frame, Occurrence, Skipped, Table
from gateway.api.layout import Field
from gateway.api.record import Record
from gateway.testing.playing import opened, shown
from gateway.testing.readings import Reading, differences, plain, read_group, read_groups, tells
from gateway.testing.subject import CheckFailed, Subject, layout_of
from gateway.testing.vectors import Vector

_ORIGIN_LEAST = 20  # characters that an origin with something to say has
_SHOWN = 6  # lines of a message


def vectors_cover_everything(subject: Subject) -> None:
    """Vectors say where they come from, and reach every kind, table, field, flag or value, and canonical group."""
    missing = [f"{vector} has no origin" for vector in subject.vectors if len(vector.origin) < _ORIGIN_LEAST]
    told = {vector.layout for vector in subject.states}
    missing += [
        f"no vector of {_kind(table)} {table.name}" for table in subject.protocol.tables if table.name not in told
    ]
    missing += _missing_bytes(subject) if subject.protocol.framing is not None else _missing_text(subject)
    groups = {group for vector in subject.states for group in vector.canonical}
    missing += [
        f"no vector expects {group}" for group in subject.normaliser().groups if group not in {*groups, "vendor"}
    ]
    if missing:
        fail(list(dict.fromkeys(missing)), "add vectors from the manual or a capture")


def vectors_decode(subject: Subject) -> None:
    """Every vector decodes to its table, its quality, its vendor values, its canonical groups or its occurrences."""
    for vector in subject.vectors:
        event = the_event(subject, vector)
        if isinstance(event, Occurrence):
            lines = _entry_differences(vector, event)
        elif isinstance(event, Frame):
            lines = _frame_differences(subject, vector, event)
        else:
            continue
        if lines:
            fail([f"{vector}: {line}" for line in lines], "correct offset, type, unit, mask or row, or the vector")


def vendor_group_is_whole(subject: Subject) -> None:
    """The vendor group holds every field of the table, and every flag or value, under the manual's name."""
    for vector in subject.states:
        frame = _state(subject, vector)
        data = read_group(subject.normaliser(vector.options), "vendor", frame).data
        if isinstance(frame.layout, Record):
            wanted = {name: plain(frame.values.get(name)) for name in frame.layout.by_name}
            lines = differences(wanted, data, "vendor", whole=True)
            lines += [f"vendor.{name} is missing" for name in wanted.keys() - data.keys()]
            if lines:
                fail([f"{vector}: {line}" for line in lines], "show every value of the record as it was told")
            continue
        for field in frame.layout.fields:
            _check_field(field, data, str(vector))


def encoding_agrees(subject: Subject) -> None:
    """What a vector decodes to encodes to bytes that decode to the same."""
    for vector in subject.states:
        frame = _state(subject, vector)
        normaliser = subject.normaliser(vector.options)
        first = read_group(normaliser, "vendor", frame)
        layout = layout_of(frame)
        payload = layout.encode(first.data)
        again = read_group(normaliser, "vendor", Frame(payload, layout))
        # None is written as 0: what was not finite comes back as 0.
        lines = [
            line for line in differences(first.data, again.data, "vendor", whole=True) if "should be None" not in line
        ]
        if lines:
            fail([f"{vector}, encoded and decoded again: {line}" for line in lines], "correct the table")
        wrong = [field.name for field in layout.fields if not first.bad and not _same_bytes(field, frame, payload)]
        if wrong:
            fail([f"{vector}: {name} is encoded to other bytes" for name in wrong], "correct the table")


def bulk_reading_agrees(subject: Subject) -> None:
    """Recordings, read through numpy, hold the same values as frames read one by one."""
    for vector in subject.states:
        frame = _state(subject, vector)
        data = read_group(subject.normaliser(vector.options), "vendor", frame).data
        layout = layout_of(frame)
        record = layout.read_many(frame.raw[frame.start : frame.start + layout.size])[0]
        for field in layout.fields:
            if not field.present:
                continue
            shown, bulk = data[field.name], record[field.name].tolist()
            one_by_one = shown[: field.present] if isinstance(shown, list) else [shown]
            in_bulk = bulk if field.count is not None else [bulk]
            for a, b in zip(one_by_one, in_bulk, strict=True):
                value = a["raw"] if isinstance(a, dict) else a
                if value is not None and value != field.shown(b):
                    raise CheckFailed(
                        f"{vector}: {field.name} is {value!r} one by one, {b!r} in bulk: correct its type"
                    )


def the_event(subject: Subject, vector: Vector) -> Frame | Occurrence | Skipped:
    """The one event that a vector is, as it should be.

    Raises:
        CheckFailed: It is something else.
    """
    decoder = opened(subject, vector)
    events: list[Event] = [*decoder.feed(vector.raw), *decoder.end()]
    event = events[0] if len(events) == 1 else None
    if isinstance(event, Frame) and vector.layout is not None:
        return event
    if isinstance(event, Skipped) and vector.skipped == event.reason:
        return event
    if isinstance(event, Occurrence) and vector.occurrences:
        return event
    wanted = f"one frame of layout {vector.layout}" if vector.layout else f"one skipped frame, {vector.skipped}"
    if vector.occurrences:
        wanted = f"{len(vector.occurrences)} occurrences in one event"
    raise CheckFailed(
        f"{vector} should give {wanted}, not {shown(events)}: correct the framing, or the vector",
    )


def the_frame(subject: Subject, vector: Vector) -> Frame | None:
    """The frame that a vector is; None for one that carries no state, as it should be.

    Raises:
        CheckFailed: It is something else.
    """
    event = the_event(subject, vector)
    return event if isinstance(event, Frame) else None


def _kind(table: Table) -> str:
    return "record" if isinstance(table, Record) else "layout"


def _missing_bytes(subject: Subject) -> Iterator[str]:
    """What of a binary protocol no vector reaches."""
    counted = {vector.skipped for vector in subject.skipped}
    for kind in subject.framing.kinds:
        if not kind.carries_state and kind.name not in counted:
            yield f"no vector of the skipped kind {kind.name}"
    expected = {name for vector in subject.states for name in _telling(vector.vendor)}
    for layout in subject.protocol.layouts:
        names = [field.name for field in layout.fields if not field.flags and field.present] + list(layout.flag_owner)
        yield from (f"no vector expects a value of {name} that is not 0" for name in names if name not in expected)


def _missing_text(subject: Subject) -> Iterator[str]:
    """What of a text protocol no vector reaches."""
    for record in subject.records:
        states = [vector for vector in subject.states if vector.layout == record.name]
        expected = {name for vector in states for name, value in vector.vendor.items() if tells(value)}
        yield from (f"no vector expects a value of {name}" for name in record.by_name if name not in expected)
    if subject.protocol.commands and not subject.told:
        yield "Protocol.commands is set, but no vector has occurrences"
    if subject.told and not subject.protocol.commands:
        yield f"{subject.told[0]} has occurrences, which nobody would see: Protocol.commands is not set"


def _frame_differences(subject: Subject, vector: Vector, frame: Frame) -> list[str]:
    if (frame.layout.name, frame.quality) != (vector.layout, vector.quality):
        raise CheckFailed(
            f"{vector} is read as layout {frame.layout.name}, {frame.quality}; it says {vector.layout}, "
            f"{vector.quality}: correct the framing's kinds or the record, or the vector",
        )
    readings = read_groups(subject.normaliser(vector.options), frame)
    lines = differences(vector.vendor, readings["vendor"].data, "vendor", whole=False)
    for group, expected in vector.canonical.items():
        lines += _group_differences(group, expected, readings)
    return lines


def _entry_differences(vector: Vector, event: Occurrence) -> list[str]:
    wanted, found = vector.occurrences, event.entries
    if len(wanted) != len(found):
        return [f"{len(found)} things have happened, expected are {len(wanted)}"]
    lines: list[str] = []
    for number, (expected, entry) in enumerate(zip(wanted, found, strict=True)):
        path = f"occurrences[{number}]"
        if entry.kind != expected.kind:
            lines.append(f"{path}.kind should be {expected.kind}, not {entry.kind}")
        lines += differences(expected.data, plain(entry.data), f"{path}.data", whole=True)
        lines += differences(expected.raw, plain(entry.raw), f"{path}.raw", whole=False)
    return lines


def _check_field(field: Field, data: Mapping[str, object], where: str) -> None:
    """Check that the vendor group shows a field of a layout as it should."""
    shown_as = data.get(field.name)
    words = shown_as if field.count is not None else [shown_as]
    if not isinstance(words, list) or len(words) != field.elements:
        raise CheckFailed(f"{where}: vendor.{field.name} has not {field.elements} elements but {shown_as!r}")
    names = {"raw", *(flag.name for flag in field.flags)}
    for word in words[: field.present] if field.flags else ():
        if not isinstance(word, dict) or set(word) != names:
            raise CheckFailed(f"{where}: vendor.{field.name} should hold {', '.join(sorted(names))}, not {word!r}")


def _state(subject: Subject, vector: Vector) -> Frame:
    frame = the_frame(subject, vector)
    if frame is None:
        raise CheckFailed(f"{vector} carries state, but is skipped: give its kind the layouts")
    return frame


def _group_differences(group: str, expected: Mapping[str, object], readings: Mapping[str, Reading]) -> list[str]:
    if group not in readings:
        return [f"canonical.{group} is expected, but no signal row fills it"]
    reading = readings[group]
    wanted = {**_telling_nothing(reading), **{name: value for name, value in expected.items() if name != "q"}}
    lines = differences(wanted, reading.data, f"canonical.{group}", whole=True)
    if "q" in expected and expected["q"] != reading.quality:
        lines.append(f"canonical.{group}.q should be {expected['q']}, not {reading.quality}")
    return lines


def _telling_nothing(reading: Reading) -> dict[str, object]:
    """Lists that are empty where nothing is said, such as `tcp.substituted`."""
    empty = plain(type(reading.struct)())
    return {name: value for name, value in empty.items() if tells(value)}


def _telling(tree: Mapping[str, object]) -> Iterator[str]:
    """The names of fields, and of flags by `field.flag`, for which a value other than null and 0 is expected."""
    for name, value in tree.items():
        items = value if isinstance(value, list) else [value]
        if any(item for item in items if not isinstance(item, Mapping)):
            yield name
        for item in items:
            if isinstance(item, Mapping):
                yield from (f"{name}.{flag}" for flag, bits in item.items() if bits)


def _same_bytes(field: Field, frame: Frame, payload: bytes) -> bool:
    end = field.offset + field.present * field.item_size
    return frame.raw[frame.start + field.offset : frame.start + end] == payload[field.offset : end]


def fail(lines: list[str], remedy: str) -> None:
    """Fail with some lines and one remedy."""
    more = f"; and {len(lines) - _SHOWN} more" if len(lines) > _SHOWN else ""
    raise CheckFailed(f"{'; '.join(lines[:_SHOWN])}{more}: {remedy}")
