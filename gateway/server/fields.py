"""The dotted paths that a subscription may name in `fields`: what a group has, and what was probably meant."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import cache

import msgspec
from msgspec import inspect

from gateway.api.decoder import Table
from gateway.api.layout import Field
from gateway.api.record import Record

Shape = Mapping[str, "Shape"]  # name -> what may be named below it
ANY = "*"  # in a shape: whatever the name
LEAF: Shape = {}


@cache
def shape_of(struct: type[msgspec.Struct]) -> Shape:
    """The paths of a group of the model; what is in an array has none."""
    return _shape(inspect.type_info(struct))


def vendor_shape(tables: Iterable[Table]) -> Shape:
    """The paths of a vendor group: the fields, and the flags of those that are no arrays."""
    found: dict[str, dict[str, Shape]] = {}
    for table in tables:
        if isinstance(table, Record):
            found.update({value.name: dict(_shape(inspect.type_info(value.type))) for value in table.fields})
            continue
        for field in table.fields:
            found.setdefault(field.name, {}).update(_flags(field))
    return found


def has(shape: Shape, path: Sequence[str]) -> bool:
    """Whether a shape has a path."""
    for name in path:
        below = shape.get(name, shape.get(ANY) if name else None)
        if below is None:
            return False
        shape = below
    return True


def nearest(word: str, shapes: Iterable[Shape]) -> str | None:
    """The path that was probably meant."""
    known = dict.fromkeys(path for shape in shapes for path in _paths(shape))
    return next(iter(difflib.get_close_matches(word, known, n=1)), None)


def _shape(kind: inspect.Type) -> Shape:
    if isinstance(kind, inspect.Metadata):
        return _shape(kind.type)
    if isinstance(kind, inspect.UnionType):
        return {name: below for one in kind.types for name, below in _shape(one).items()}
    if isinstance(kind, inspect.StructType):
        return {field.encode_name: _shape(field.type) for field in kind.fields}
    return {ANY: _shape(kind.value_type)} if isinstance(kind, inspect.DictType) else LEAF


def _flags(field: Field) -> dict[str, Shape]:
    return {name: LEAF for name in ("raw", *(flag.name for flag in field.flags)) if field.flags and field.count is None}


def _paths(shape: Shape, before: str = "") -> Iterator[str]:
    for name, below in shape.items():
        if name != ANY:
            yield before + name
            yield from _paths(below, f"{before}{name}.")
