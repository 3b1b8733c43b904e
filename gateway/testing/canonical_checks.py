"""Checks of the canonical groups: right shapes, finite or null, and null for what the frame cannot tell."""

from __future__ import annotations

import math
import re
import struct
from collections.abc import Iterator, Mapping, Sequence

import msgspec

from gateway.api.decoder import Frame
from gateway.api.layout import TYPES, Layout
from gateway.api.model import FRAME_GROUPS, GROUPS
from gateway.api.normaliser import Normaliser
from gateway.api.signals import Signal, find_source
from gateway.testing.readings import Plain, Reading, leaves, plain, read_group, tells, value_at
from gateway.testing.streams import BITS, damaged
from gateway.testing.subject import CheckFailed, DoesNotApply, Subject, layout_of
from gateway.testing.vector_checks import the_frame
from gateway.testing.vectors import Vector

# Elements of the model's arrays that have a fixed number of them, by the last part of their key.
_SHAPES = {
    "position": 3,
    "orientation": 4,
    "twist": 6,
    "target_twist": 6,
    "force": 3,
    "torque": 3,
    "raw_force": 3,
    "raw_torque": 3,
    "cog": 3,
}
_INDEX = re.compile(r"\[\d+\]$")


def canonical_groups_fit_the_model(subject: Subject) -> None:
    """Every group of every vector has the model's keys, types, shapes and enumerations, and survives both encodings."""
    for vector, frame, normaliser in _frames(subject):
        canonical_fits(normaliser, frame, str(vector))


def nothing_is_told_that_is_not_finite(subject: Subject) -> None:
    """NaN and infinity in any word of any vector make null of what follows from it, and nothing else, and q BAD.

    NaN in every word, both infinities in the first of each field.
    """
    if not any(field.is_float for layout in subject.protocol.layouts for field in layout.fields):
        raise DoesNotApply("no table has a floating-point field")
    for vector, frame, normaliser in _frames(subject):
        clean = {group: read_group(normaliser, group, frame).data for group in (*_canonical(normaliser), "vendor")}
        layout = layout_of(frame)
        for field in layout.fields:
            rows = [row for row in normaliser.signals if _uses(row, layout, field.name)]
            for index in range(field.present if field.is_float else 0):
                at = frame.start + field.offset + index * field.item_size
                for value in (math.nan, math.inf, -math.inf) if index == 0 else (math.nan,):
                    code = layout.byteorder + TYPES[field.type][0]
                    raw = bytearray(frame.raw)
                    struct.pack_into(code, raw, at, value)
                    hurt = Frame(bytes(raw), frame.layout, frame.start, frame.quality)
                    where = f"{vector} with {value} in {field.name}[{index}]"
                    _check_nulls(normaliser, hurt, rows, clean, where)


def cut_off_is_null(subject: Subject) -> None:
    """What a shorter frame does not carry is null, also inside an array, and never 0."""
    if all(field.present == field.elements for layout in subject.protocol.layouts for field in layout.fields):
        raise DoesNotApply("every table is whole: there are no shorter frames")
    for vector, frame, normaliser in _frames(subject):
        layout, vendor = layout_of(frame), read_group(normaliser, "vendor", frame).data
        for field in layout.fields:
            shown = vendor[field.name]
            words = shown if isinstance(shown, list) else [shown]
            if any(word is not None for word in words[field.present :]):
                raise CheckFailed(f"{vector}: vendor.{field.name} holds {shown!r}; only {field.present} elements came")
        for group in _canonical(normaliser):
            data = read_group(normaliser, group, frame).data
            for row in subject.protocol.signals:
                if row.group == group:
                    _check_cut(row, layout, value_at(data, row.path), f"{vector}: {row.key}")


def keys_follow_values(subject: Subject) -> None:
    """A state group's key changes with every bit that the group follows from, and with no other.

    Each byte once, all its bits; each bit by itself where a group follows from some bits of the byte.
    """
    if all(GROUPS[group].delivery != "state" for group in _canonical(subject.normaliser())):
        raise DoesNotApply("no row fills a state group")
    for vector, frame, normaliser in _frames(subject):
        for group in _canonical(normaliser):
            if GROUPS[group].delivery != "state":
                continue
            reader = normaliser.readers(frame.layout)[group]
            before, data = reader.key(frame), _steady(normaliser, group, frame)
            watched = _watched(subject, group, layout_of(frame))
            for at in range(layout_of(frame).size):
                for damage in (0xFF,) if watched[at] in {0, 0xFF} else BITS:
                    hurt = Frame(damaged(frame.raw, frame.start + at, damage), frame.layout, frame.start, frame.quality)
                    follows = bool(damage & watched[at])
                    same = reader.key(hurt) == before
                    if same == follows:
                        verb = "does not change" if same else "changes"
                        raise CheckFailed(
                            f"{vector}: the key of {group} {verb} with byte {at}: correct the row's sources"
                        )
                    if same and _steady(normaliser, group, hurt) != data:
                        raise CheckFailed(
                            f"{vector}: {group} changes with byte {at}, its key does not: name every source"
                        )


def canonical_fits(normaliser: Normaliser, frame: Frame, where: str) -> None:
    """Check the canonical groups of one frame against the model.

    Raises:
        CheckFailed: A key, type, shape or enumeration is not the model's.
    """
    for group in _canonical(normaliser):
        _check_shapes(group, group_fits(normaliser, group, frame, where).data, f"{where}: {group}")


def group_fits(normaliser: Normaliser, group: str, frame: Frame, where: str) -> Reading:
    """Check the keys, types and enumerations of one canonical group of one frame against the model.

    Raises:
        CheckFailed: One is not the model's.
    """
    reading = read_group(normaliser, group, frame)
    _check_fits(group, reading.struct, f"{where}: {group}")
    return reading


def _frames(subject: Subject) -> Iterator[tuple[Vector, Frame, Normaliser]]:
    """Each state vector with its frame and the normaliser of its options; equal ones once."""
    seen = set()
    for vector in subject.states:
        frame = the_frame(subject, vector)
        named = (vector.raw, msgspec.json.encode(vector.options, order="sorted"))
        if frame is not None and named not in seen:
            seen.add(named)
            yield vector, frame, subject.normaliser(vector.options)


def _canonical(normaliser: Normaliser) -> list[str]:
    return [group for group in normaliser.groups if group in FRAME_GROUPS]


def _check_fits(group: str, found: object, where: str) -> None:
    """Check a group against the model by encoding it and reading it back as the model's struct."""
    model = GROUPS[group].struct
    if model is None or not isinstance(found, model):
        raise CheckFailed(f"{where} is a {type(found).__name__}: return the model's struct")
    for name, value in leaves(plain(found)):
        if isinstance(value, float) and not math.isfinite(value):
            raise CheckFailed(f"{where}.{name} is {value}: make it null")
    try:
        in_json: object = msgspec.json.decode(msgspec.json.encode(found), type=model)
        in_msgpack: object = msgspec.msgpack.decode(msgspec.msgpack.encode(found), type=model)
    except (msgspec.ValidationError, TypeError) as error:
        raise CheckFailed(f"{where} does not fit the model: {error}: return the type that the key has") from error
    if plain(in_json) != plain(found) or plain(in_msgpack) != plain(found):
        raise CheckFailed(f"{where} is not the same after encoding: return the type that the key has")


def _check_shapes(group: str, data: Plain, where: str) -> None:
    arrays: dict[str, list[object]] = {}
    for name, value in leaves(data):
        if _INDEX.search(name):
            arrays.setdefault(_INDEX.sub("", name), []).append(value)
    for name, items in arrays.items():
        wanted = _SHAPES.get(name.rpartition(".")[2]) if group != "joints" else None
        if wanted is not None and len(items) != wanted:
            raise CheckFailed(f"{where}.{name} has {len(items)} elements, the model {wanted}: correct the row")
        if name.endswith("orientation"):
            numbers = [float(item) for item in items if isinstance(item, (int, float))]
            if len(numbers) != len(items) or not math.isclose(math.hypot(*numbers), 1, abs_tol=1e-6) or numbers[3] < 0:
                raise CheckFailed(f"{where}.{name} is {items}: give a unit quaternion (x, y, z, w) with w >= 0")
    if group == "joints":
        lengths = {name: len(items) for name, items in arrays.items() if not name.startswith("external_")}
        if len(set(lengths.values())) > 1:
            raise CheckFailed(f"{where}: arrays of different length, {lengths}: every array has the robot's axes")
    override = data.get("speed_override")
    if isinstance(override, float) and not 0 <= override <= 1:
        raise CheckFailed(f"{where}.speed_override is {override}: give 0 to 1")


def _check_nulls(
    normaliser: Normaliser, hurt: Frame, naming: Sequence[Signal], clean: Mapping[str, Plain], where: str
) -> None:
    """Check every group of a frame that holds a value that is not finite.

    Args:
        normaliser: Reads it.
        hurt: The frame.
        naming: The rows that name the field of that value.
        clean: The groups of the frame as it was.
        where: What was done to the frame.
    """
    for group, before in clean.items():
        rows = [row for row in naming if row.group == group]
        reading = read_group(normaliser, group, hurt)
        if (rows or group == "vendor") and not reading.bad:
            raise CheckFailed(f"{where}: {group} is not flagged BAD: return True with a group that held it")
        differing = [name for name, value in reading.data.items() if value != before.get(name)]
        now = dict(leaves({name: reading.data[name] for name in differing}))
        was = dict(leaves({name: before.get(name) for name in differing}))
        wrong = [name for name, value in now.items() if isinstance(value, float) and not math.isfinite(value)]
        if not any(row.partial for row in rows):
            wrong += [name for name in was.keys() & now.keys() if was[name] != now[name] and now[name] is not None]
        if wrong:
            raise CheckFailed(f"{where}: {group}.{wrong[0]} is {now[wrong[0]]!r}: make it null")
        if not rows and group != "vendor" and differing:
            raise CheckFailed(f"{where}: {group} changes, though no row of it names the field")


def _check_cut(row: Signal, layout: Layout, value: object, where: str) -> None:
    fields = [find_source(layout, source)[0] for source in row.sources]
    missing = [field.present < field.elements for field in fields]
    if row.partial or not any(missing):
        return
    if row.via is not None or not any(field.present for field in fields):
        if tells(value):
            raise CheckFailed(f"{where} is {value!r}, but {', '.join(row.sources)} is cut off: give null, never 0")
        return
    items = value.get("values") if isinstance(value, dict) and "values" in value else value
    if isinstance(items, list):
        here = [index < field.present for field in fields for index in range(field.elements)]
        if len(items) != len(here) or any(
            item is not None for item, there in zip(items, here, strict=True) if not there
        ):
            raise CheckFailed(
                f"{where} is {items!r}, but {', '.join(row.sources)} is cut off in part: null what is missing"
            )
    elif tells(value):
        raise CheckFailed(f"{where} is {value!r}, but {', '.join(row.sources)} is cut off in part: give null")


def _uses(row: Signal, layout: Layout, field: str) -> bool:
    return any(find_source(layout, source)[0].name == field for source in row.sources)


def _steady(normaliser: Normaliser, group: str, frame: Frame) -> Plain:
    """A group without what always changes."""
    data = read_group(normaliser, group, frame).data
    for *above, name in normaliser.readers(frame.layout)[group].volatile:
        holder = value_at(data, above)
        if isinstance(holder, dict):
            holder.pop(name, None)
    return data


def _watched(subject: Subject, group: str, layout: Layout) -> bytearray:
    """For each byte of a layout, the bits that a group follows from."""
    found = bytearray(layout.size)
    for row in subject.protocol.signals:
        if row.group != group or row.volatile:
            continue
        for source in row.sources:
            field, flag = find_source(layout, source)
            mask = (1 << 8 * field.item_size) - 1 if flag is None else flag.mask << flag.bit
            order = "little" if layout.byteorder == "<" else "big"
            for index in range(field.present):
                first = field.offset + index * field.item_size
                for place, bits in enumerate(mask.to_bytes(field.item_size, order)):  # type: ignore[arg-type] # a literal
                    found[first + place] |= bits
    return found
