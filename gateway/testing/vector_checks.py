"""Checks of values: every vector decodes to what it must, one frame at a time and in bulk, and encodes back."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from gateway.api.decoder import Event, Frame, Skipped
from gateway.api.layout import Field
from gateway.testing.readings import Reading, differences, plain, read_group, read_groups, tells
from gateway.testing.subject import CheckFailed, Subject
from gateway.testing.vectors import Vector

_ORIGIN_LEAST = 20  # characters that an origin with something to say has
_SHOWN = 6  # lines of a message


def vectors_cover_everything(subject: Subject) -> None:
    """Vectors say where they come from, and reach every kind, layout, field, flag and canonical group."""
    missing = [f"{vector} has no origin" for vector in subject.vectors if len(vector.origin) < _ORIGIN_LEAST]
    told = {vector.layout for vector in subject.states}
    missing += [f"no vector of layout {layout.name}" for layout in subject.protocol.layouts if layout.name not in told]
    counted = {vector.skipped for vector in subject.skipped}
    for kind in subject.protocol.framing.kinds:
        if not kind.carries_state and kind.name not in counted:
            missing.append(f"no vector of the skipped kind {kind.name}")
    expected = {name for vector in subject.states for name in _telling(vector.vendor)}
    for layout in subject.protocol.layouts:
        names = [field.name for field in layout.fields if not field.flags and field.present] + list(layout.flag_owner)
        missing += [f"no vector expects a value of {name} that is not 0" for name in names if name not in expected]
    groups = {group for vector in subject.states for group in vector.canonical}
    missing += [
        f"no vector expects {group}" for group in subject.normaliser().groups if group not in {*groups, "vendor"}
    ]
    if missing:
        _fail(list(dict.fromkeys(missing)), "add vectors from the manual or a capture")


def vectors_decode(subject: Subject) -> None:
    """Every vector decodes to its layout, its quality, its vendor values and its canonical groups."""
    for vector in subject.vectors:
        frame = the_frame(subject, vector)
        if frame is None:
            continue
        if (frame.layout.name, frame.quality) != (vector.layout, vector.quality):
            raise CheckFailed(
                f"{vector} is read as layout {frame.layout.name}, {frame.quality}; it says {vector.layout}, "
                f"{vector.quality}: correct the framing's kinds, or the vector",
            )
        readings = read_groups(subject.normaliser(vector.options), frame)
        lines = differences(vector.vendor, readings["vendor"].data, "vendor", whole=False)
        for group, expected in vector.canonical.items():
            lines += _group_differences(group, expected, readings)
        if lines:
            _fail([f"{vector}: {line}" for line in lines], "correct offset, type, unit, mask or row, or the vector")


def vendor_group_is_whole(subject: Subject) -> None:
    """The vendor group holds every field of the table, and every flag, under the manual's name."""
    for vector in subject.states:
        frame = _state(subject, vector)
        data = read_group(subject.normaliser(vector.options), "vendor", frame).data
        for field in frame.layout.fields:
            shown = data.get(field.name)
            words = shown if field.count is not None else [shown]
            if not isinstance(words, list) or len(words) != field.elements:
                raise CheckFailed(f"{vector}: vendor.{field.name} has not {field.elements} elements but {shown!r}")
            names = {"raw", *(flag.name for flag in field.flags)}
            for word in words[: field.present] if field.flags else ():
                if not isinstance(word, dict) or set(word) != names:
                    raise CheckFailed(
                        f"{vector}: vendor.{field.name} should hold {', '.join(sorted(names))}, not {word!r}"
                    )


def encoding_agrees(subject: Subject) -> None:
    """What a vector decodes to encodes to bytes that decode to the same."""
    for vector in subject.states:
        frame = _state(subject, vector)
        normaliser = subject.normaliser(vector.options)
        first = read_group(normaliser, "vendor", frame)
        payload = frame.layout.encode(first.data)
        again = read_group(normaliser, "vendor", Frame(payload, frame.layout))
        # None is written as 0: what was not finite comes back as 0.
        lines = [
            line for line in differences(first.data, again.data, "vendor", whole=True) if "should be None" not in line
        ]
        if lines:
            _fail([f"{vector}, encoded and decoded again: {line}" for line in lines], "correct the table")
        wrong = [
            field.name for field in frame.layout.fields if not first.bad and not _same_bytes(field, frame, payload)
        ]
        if wrong:
            _fail([f"{vector}: {name} is encoded to other bytes" for name in wrong], "correct the table")


def bulk_reading_agrees(subject: Subject) -> None:
    """Recordings, read through numpy, hold the same values as frames read one by one."""
    for vector in subject.states:
        frame = _state(subject, vector)
        data = read_group(subject.normaliser(vector.options), "vendor", frame).data
        record = frame.layout.read_many(frame.raw[frame.start : frame.start + frame.layout.size])[0]
        for field in frame.layout.fields:
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


def the_frame(subject: Subject, vector: Vector) -> Frame | None:
    """The frame that a vector is; None for one that is skipped, as it should be.

    Raises:
        CheckFailed: It is something else.
    """
    decoder = subject.protocol.reader()
    events: list[Event] = [*decoder.feed(vector.raw), *decoder.end()]
    if len(events) == 1 and isinstance(events[0], Frame) and vector.layout is not None:
        return events[0]
    if len(events) == 1 and isinstance(events[0], Skipped) and vector.skipped == events[0].reason:
        return None
    wanted = f"one frame of layout {vector.layout}" if vector.layout else f"one skipped frame, {vector.skipped}"
    raise CheckFailed(
        f"{vector} should give {wanted}, not {', '.join(map(str, events)) or 'nothing'}: "
        "correct the framing, or the vector",
    )


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


def _fail(lines: list[str], remedy: str) -> None:
    more = f"; and {len(lines) - _SHOWN} more" if len(lines) > _SHOWN else ""
    raise CheckFailed(f"{'; '.join(lines[:_SHOWN])}{more}: {remedy}")
