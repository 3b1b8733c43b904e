"""Signal rows: which field or flag of a vendor's frame becomes which key of the canonical model.

A row names its sources; the conversion follows from the units of the table and of the model. Where a key follows from
several fields, or from an option of the robot, the row names a small pure function of them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import lru_cache

import msgspec
from msgspec import inspect

from gateway.api.layout import Field, Flag, Layout
from gateway.api.model import GROUPS, Quality
from gateway.api.rotations import Rotation


@dataclass(frozen=True, slots=True)
class Signal:
    """One row: a canonical key and what it follows from.

    Args:
        key: `<group>.<path>`, such as `joints.position` or `io.digital_in.box`.
        field: The source, or several: `field` or `field.flag`. Without `via` several are put end to end.
        via: A pure function of the sources' raw values, in the manual's units: a number for a scalar, a list for an
            array. Not called where a source is not in the frame or not finite: the key is null then.
        partial: Whether `via` is called all the same, with None for such a source.
        options: Options of the robot that `via` takes as keyword arguments.
        rotation: How the last three numbers of a `mm|deg` source turn; None leaves the orientation null.
        quality: SUBSTITUTED for a commanded value that is shown as measured, UNCERTAIN for a reading not established.
        volatile: Whether the value always changes: it never makes a state topic publish by itself.
        calm: Of a layout: makes what `via` gives while every source is 0 (`list`: [], `bool`: False); it is not called
            then. For faults: the many words of which are nearly always 0.
        doubt: Of a record: says, of what `via` takes, whether this value is UNCERTAIN; None: it never is.
    """

    key: str
    field: str | tuple[str, ...]
    via: Callable[..., object] | None = None
    partial: bool = False
    options: tuple[str, ...] = ()
    rotation: Rotation | None = None
    quality: Quality = Quality.GOOD
    volatile: bool = False
    calm: Callable[[], object] | None = None
    doubt: Callable[..., bool] | None = None

    @property
    def group(self) -> str:
        """The group that the key belongs to."""
        return self.key.partition(".")[0]

    @property
    def path(self) -> tuple[str, ...]:
        """The key inside its group."""
        return tuple(self.key.split(".")[1:])

    @property
    def sources(self) -> tuple[str, ...]:
        """The sources, also where there is only one."""
        return (self.field,) if isinstance(self.field, str) else self.field


@dataclass(frozen=True, slots=True)
class Leaf:
    """What the model says of one key.

    Args:
        shape: `array`, `bits`, `channels`, `pose`, `float`, `int`, `bool` or `other`.
        unit: Canonical unit, or None.
    """

    shape: str
    unit: str | None


@lru_cache(maxsize=1024)
def leaf(key: str) -> Leaf:
    """Find what the model says of a key.

    Raises:
        ValueError: The model has no such key.
    """
    group, *path = key.split(".")
    if group not in GROUPS or GROUPS[group].struct is None or not path:
        raise ValueError(f"the model has no key {key!r}; its groups are {', '.join(GROUPS)}")
    found: inspect.Type = inspect.type_info(GROUPS[group].struct)
    unit: str | None = None
    for name in path:
        inner, _ = _plain(found)
        if isinstance(inner, inspect.StructType):
            rows = {field.name: field.type for field in inner.fields}
            if name not in rows:
                raise ValueError(f"the model has no key {key!r}; here it has {', '.join(rows)}")
            found = rows[name]
        elif isinstance(inner, inspect.DictType):
            found = inner.value_type
        else:
            raise ValueError(f"the model has no key {key!r}: it ends before {name!r}")  # noqa: TRY004 - a wrong value
        unit = _plain(found)[1]
    return Leaf(_shape(_plain(found)[0]), unit)


def keys_of(struct: type[msgspec.Struct]) -> list[str]:
    """The dotted paths of all leaves and subtrees of a group's struct."""
    return list(_paths(inspect.type_info(struct)))


def find_source(layout: Layout, source: str) -> tuple[Field, Flag | None]:
    """Find the field, and the flag where one is named, of a source.

    Raises:
        ValueError: The layout has no such field or flag.
    """
    if source in layout.by_name:
        return layout.by_name[source], None
    if source in layout.flag_owner:
        return layout.flag_owner[source]
    raise ValueError(f"layout {layout.name} has no field or flag {source!r}")


def struct_inside(annotation: object) -> type[msgspec.Struct] | None:
    """The struct in `Annotated[Struct | None, …]`, or None where it is a mapping."""
    candidates = [annotation]
    while candidates:
        one = candidates.pop()
        if isinstance(one, type) and issubclass(one, msgspec.Struct):
            return one
        if getattr(one, "__origin__", None) is dict:
            return None
        candidates += getattr(one, "__args__", ()) or ()
    return None


def _paths(type_: inspect.Type) -> Iterable[str]:
    inner, _ = _plain(type_)
    if isinstance(inner, inspect.StructType):
        for field in inner.fields:
            yield field.encode_name
            for below in _paths(field.type):
                yield f"{field.encode_name}.{below}"


def _plain(type_: inspect.Type) -> tuple[inspect.Type, str | None]:
    """Take off metadata and `| None`; return the type and its unit."""
    unit = None
    while True:
        if isinstance(type_, inspect.Metadata):
            unit = (type_.extra_json_schema or {}).get("unit", unit)
            type_ = type_.type
        elif isinstance(type_, inspect.UnionType):
            rest = [one for one in type_.types if not isinstance(one, inspect.NoneType)]
            if len(rest) != 1:
                return type_, unit
            type_ = rest[0]
        else:
            return type_, unit


def _shape(type_: inspect.Type) -> str:
    if isinstance(type_, inspect.ListType):
        item = _plain(type_.item_type)[0]
        return {inspect.FloatType: "array", inspect.BoolType: "bits"}.get(type(item), "other")
    if isinstance(type_, inspect.StructType):
        return {"Pose": "pose", "Channels": "channels"}.get(type_.cls.__name__, "other")
    return {inspect.FloatType: "float", inspect.IntType: "int", inspect.BoolType: "bool"}.get(type(type_), "other")
