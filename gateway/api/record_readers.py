"""Readers of records: rows bound to named values, as `compiler` binds them to the words of a frame.

Text protocols are slow, and their values are parsed already, so nothing is compiled: each row becomes one function.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from typing import cast

import msgspec

from gateway.api import model, units
from gateway.api.decoder import Frame
from gateway.api.model import Quality
from gateway.api.reader import Reader, ReadWords
from gateway.api.record import Record
from gateway.api.rotations import QUATERNION_FROM
from gateway.api.signals import Signal, leaf, struct_inside

_Values = Mapping[str, object]
_Make = Callable[[_Values], object]
_POSE = 6


def record_group(
    group: str,
    record: Record,
    signals: Iterable[Signal],
    options: Mapping[str, object],
) -> Reader | None:
    """Make the reader of one canonical group.

    The quality of a row counts only where its value tells something. NaN and infinity are null, and make it BAD.

    Args:
        group: A key of `FRAME_GROUPS`.
        record: The table of the frames.
        signals: Rows of any group; those of this group are used.
        options: Values of the options that rows name.

    Returns:
        The reader, or None where the vendor tells nothing of this group.

    Raises:
        ValueError: A row names a key, value or option that does not exist, or units that do not convert.
    """
    rows = [signal for signal in signals if signal.group == group]
    struct_type = model.GROUPS[group].struct
    if not rows or struct_type is None:
        return None
    made = [(row, _maker(row, record, options)) for row in rows]
    inside = _builder(struct_type, [(row.path, make) for row, make in made])

    def build(values: _Values, substituted: list[str]) -> object:
        return struct_type(**inside(values), **({"substituted": substituted} if substituted else {}))

    graded = [(row, make) for row, make in made if row.quality is not Quality.GOOD]
    doubts = [(make, _doubt(row, options)) for row, make in made if row.doubt is not None]
    watched = tuple(dict.fromkeys(source for row in rows if not row.volatile for source in row.sources))
    sources = tuple(dict.fromkeys(source for row in rows for source in row.sources))

    def read(frame: Frame) -> tuple[object, Quality]:
        values, quality = _finite_values(frame.values, sources)
        substituted = []
        for row, make in graded:
            if make(values) is not None:
                quality = model.worst(quality, row.quality)
                if row.quality is Quality.SUBSTITUTED:
                    substituted.append(".".join(row.path))
        if any(make(values) is not None and doubt(values) for make, doubt in doubts):
            quality = model.worst(quality, Quality.UNCERTAIN)
        return build(values, substituted), quality

    return Reader(
        read=read,
        key=lambda frame: tuple(map(frame.values.get, watched)),
        empty=struct_type(),
        volatile=tuple(row.path for row in rows if row.volatile),
    )


def record_vendor(record: Record) -> Reader:
    """Make the reader of the `vendor` group: every value under its manual name and in the manual's unit."""
    names = tuple(record.by_name)
    return Reader(
        read=lambda frame: _finite_values(frame.values, names),
        key=lambda frame: tuple(map(frame.values.get, names)),
        empty=dict.fromkeys(names),
    )


def record_words(record: Record, sources: Sequence[str]) -> ReadWords | None:
    """Make what reads some values of a frame, in the order they are named; None where one is not in the table."""
    if any(source not in record.by_name for source in sources):
        return None
    return lambda frame: tuple(map(frame.values.get, sources))


def _finite_values(values: _Values, names: Sequence[str]) -> tuple[_Values, Quality]:
    """Some values, with null for what is not finite, and BAD where there was such; structs are not looked into."""
    told = {name: values.get(name) for name in names}
    found = {name: _finite(value) for name, value in told.items()}
    bad = any(found[name] is not value for name, value in told.items())
    return found, Quality.BAD if bad else Quality.GOOD


def _finite(value: object) -> object:
    """The value itself where all of it is finite; else a copy with null in the place of what is not."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, list | tuple):
        items = [_finite(one) for one in value]
        return value if all(one is before for one, before in zip(items, value, strict=True)) else items
    if isinstance(value, dict):
        below = {key: _finite(one) for key, one in value.items()}
        return value if all(one is value[key] for key, one in below.items()) else below
    return value


def _maker(row: Signal, record: Record, options: Mapping[str, object]) -> _Make:
    """What makes a row's value of the values of a frame."""
    unknown = [source for source in row.sources if source not in record.by_name]
    if unknown:
        raise ValueError(f"record {record.name} has no value {unknown[0]!r}")
    if row.via is not None:
        return _via_maker(row, options)
    if len(row.sources) > 1:
        raise ValueError(f"{row.key}: several values need a function (via)")
    goal = leaf(row.key)
    source, unit = row.sources[0], record.by_name[row.sources[0]].unit
    if goal.shape == "pose":
        return _pose_maker(row, source, unit)
    if goal.shape not in {"array", "bits", "float", "int", "bool", "other"}:
        raise ValueError(f"{row.key} needs a function (via)")
    if goal.unit is None or goal.shape in {"bits", "bool", "int", "other"}:
        return lambda values: values.get(source)
    if unit is None and goal.unit != "1":
        raise ValueError(f"{row.key} is in {goal.unit}, but its source has no unit")
    return partial(_converted, source, units.conversion(unit or "1", goal.unit))


def _converted(source: str, conversion: units.Conversion, values: _Values) -> object:
    told = values.get(source)
    if told is None:
        return None
    if isinstance(told, Sequence):
        return [None if one is None else conversion(one) for one in told]
    return conversion(cast("float", told))


def _via_maker(row: Signal, options: Mapping[str, object]) -> _Make:
    via, sources, partly = cast("Callable[..., object]", row.via), row.sources, row.partial
    missing = [option for option in row.options if option not in options]
    if missing:
        raise ValueError(f"{row.key}: the robot has no option {missing[0]!r}")
    chosen = {option: options[option] for option in row.options}

    def make(values: _Values) -> object:
        told = [values.get(source) for source in sources]
        if not partly and None in told:
            return None
        return via(*told, **chosen)

    return make


def _doubt(row: Signal, options: Mapping[str, object]) -> _Make:
    return _via_maker(dataclasses.replace(row, via=row.doubt), options)


def _pose_maker(row: Signal, source: str, unit: str | None) -> _Make:
    if unit is None or "|" not in unit:
        raise ValueError(f"{row.key}: a pose needs a source in `mm|deg` or the like, not {unit!r}")
    length, angle = (units.conversion(part, si) for part, si in zip(unit.split("|"), ("m", "rad"), strict=True))
    turn = QUATERNION_FROM[row.rotation] if row.rotation else None

    def make(values: _Values) -> object:
        told = values.get(source)
        if not isinstance(told, Sequence) or len(told) < _POSE or None in told[:_POSE]:
            return None
        x, y, z, a, b, c = told[:_POSE]
        position: list[float | None] = [length(x), length(y), length(z)]
        return model.Pose(position, None if turn is None else turn(angle(a), angle(b), angle(c)))

    return make


def _builder(
    struct_type: type[msgspec.Struct], rows: Sequence[tuple[tuple[str, ...], _Make]]
) -> Callable[[_Values], dict[str, object]]:
    """What makes the values of a struct's fields of its rows, with the structs and mappings inside it."""
    below: dict[str, list[tuple[tuple[str, ...], _Make]]] = {}
    makers: dict[str, _Make] = {}
    for path, make in rows:
        if len(path) > 1:
            below.setdefault(path[0], []).append((path[1:], make))
        elif path[0] in makers:
            raise ValueError(f"{'.'.join(path)} stands twice")
        else:
            makers[path[0]] = make
    annotations = {field.name: field.type for field in msgspec.structs.fields(struct_type)}
    for name, inner_rows in below.items():
        if name in makers:
            raise ValueError(f"{name} stands twice: whole, and in parts")
        inner = struct_inside(annotations[name])
        makers[name] = _mapping(inner_rows) if inner is None else _inner(inner, inner_rows)
    return lambda values: {name: make(values) for name, make in makers.items()}


def _inner(struct_type: type[msgspec.Struct], rows: Sequence[tuple[tuple[str, ...], _Make]]) -> _Make:
    inside = _builder(struct_type, rows)
    return lambda values: struct_type(**inside(values))


def _mapping(rows: Sequence[tuple[tuple[str, ...], _Make]]) -> _Make:
    makers = {path[0]: make for path, make in rows}
    deeper = [path for path, _ in rows if len(path) > 1]
    if deeper:
        raise ValueError(f"{'.'.join(deeper[0])}: {deeper[0][0]} needs a function (via) that makes the whole of it")
    if len(makers) < len(rows):
        names = [path[0] for path, _ in rows]
        raise ValueError(f"{next(name for name in names if names.count(name) > 1)} stands twice")
    return lambda values: {name: make(values) for name, make in makers.items()}
