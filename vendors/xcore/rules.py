"""What xCore objects are declared with: units and limits of a member, and the base class that holds them.

A limit that a type can say stands in its `Meta`; the others (finite, "-1 or ...", "0 or 16 elements") stand in `extra`,
beside the JSON Schema that says the same, and are held by `__post_init__`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache
from typing import NamedTuple

import msgspec
from msgspec import Meta, inspect

DEFAULT = -1.0  # "use the controller's default", wherever a command has it
AXES = (3, 7)
INT = (-(2**31), 2**31 - 1)


class Limits(NamedTuple):
    """Limits of a member that its type cannot say.

    Args:
        or_default: -1 is allowed beside the range.
        low: Least value.
        high: Greatest value; None: any.
        lengths: The only numbers of elements.
        axes: One element for each axis.
        speed: The greatest value depends on the kind of robot.
    """

    or_default: bool = False
    low: float = 0.0
    high: float | None = None
    lengths: tuple[int, ...] = ()
    axes: bool = False
    speed: bool = False


class XcoreObject(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Base of the objects."""

    def __post_init__(self) -> None:
        """Hold the limits that types cannot say.

        Raises:
            ValueError: A member is outside of its limits.
        """
        for name, holds in _rules(type(self)):
            if not holds(getattr(self, name)):
                raise ValueError(f"{name} is out of its range")


def one(unit: str, text: str, low: float | None = None) -> Meta:
    """Describe a number.

    Args:
        unit: Its unit.
        text: What it is.
        low: Least value, in that unit.
    """
    return Meta(description=text, extra_json_schema={"unit": unit}, ge=low)


def told(text: str) -> Meta:
    """Describe what has no unit."""
    return Meta(description=text)


def either(unit: str, text: str, low: float, high: float | None = None, *, speed: bool = False) -> Meta:
    """Describe a number that is -1 for the controller's default, or in a range.

    Args:
        unit: Its unit.
        text: What it is.
        low: Least value beside -1, in that unit.
        high: Greatest value; None: any.
        speed: The greatest value depends on the kind of robot.
    """
    range_ = {"minimum": low} if high is None else {"minimum": low, "maximum": high}
    return Meta(
        description=f"{text} -1: the controller's default.",
        extra_json_schema={"unit": unit, "anyOf": [{"const": -1}, range_]},
        extra={"limits": Limits(or_default=True, low=low, high=high, speed=speed)},
    )


def exactly(unit: str, text: str, count: int) -> Meta:
    """Describe an array of so many elements."""
    return Meta(description=text, extra_json_schema={"unit": unit}, min_length=count, max_length=count)


def some(unit: str, text: str) -> Meta:
    """Describe an array of any length."""
    return Meta(description=text, extra_json_schema={"unit": unit})


def none_or(unit: str, text: str, count: int) -> Meta:
    """Describe an array that is empty or has so many elements."""
    return Meta(
        description=text,
        extra_json_schema={"unit": unit, "anyOf": [{"maxItems": 0}, {"minItems": count, "maxItems": count}]},
        extra={"limits": Limits(lengths=(0, count))},
    )


def each_axis(unit: str, text: str) -> Meta:
    """Describe an array with an element for each axis."""
    low, high = AXES
    return Meta(
        description=text,
        extra_json_schema={"unit": unit},
        min_length=low,
        max_length=high,
        extra={"limits": Limits(axes=True)},
    )


def plain(kind: inspect.Type) -> tuple[inspect.Type, Limits]:
    """A type without what is wrapped around it, and the limits that were."""
    limits = Limits()
    while isinstance(kind, inspect.Metadata):
        found = (kind.extra or {}).get("limits")
        limits = found if isinstance(found, Limits) else limits
        kind = kind.type
    return kind, limits


def fields_of(struct: type[msgspec.Struct]) -> tuple[inspect.Field, ...]:
    """The members of an object, with their types."""
    found = inspect.type_info(struct)
    if not isinstance(found, inspect.StructType):
        raise TypeError(f"{struct} is no struct")
    return found.fields


def carried(text: str) -> bool:
    """Tell whether UTF-8 can carry a text: half a surrogate pair, which JSON can name, it cannot."""
    try:
        text.encode()
    except UnicodeEncodeError:
        return False
    return True


@cache
def _rules(struct: type[msgspec.Struct]) -> tuple[tuple[str, Callable[..., bool]], ...]:
    """The members of an object that have limits which types cannot say."""
    found = ((field.name, _rule(*plain(field.type))) for field in fields_of(struct))
    return tuple((name, rule) for name, rule in found if rule is not None)


def _rule(kind: inspect.Type, limits: Limits) -> Callable[..., bool] | None:
    if isinstance(kind, inspect.StrType):
        return carried
    if isinstance(kind, inspect.FloatType):
        return _ranged(limits) if limits.or_default else math.isfinite
    if isinstance(kind, inspect.VarTupleType):
        item = _rule(*plain(kind.item_type))
        return _array(item, limits.lengths) if item or limits.lengths else None
    if isinstance(kind, inspect.TupleType):
        parts = [_rule(*plain(part)) for part in kind.item_types]
        return lambda values: all(rule(value) for rule, value in zip(parts, values, strict=True) if rule)
    return None


def _ranged(limits: Limits) -> Callable[[float], bool]:
    low, high = limits.low, math.inf if limits.high is None else limits.high
    return lambda value: value == DEFAULT or (low <= value <= high and math.isfinite(value))


def _array(item: Callable[..., bool] | None, lengths: tuple[int, ...]) -> Callable[..., bool]:
    def holds(values: tuple[object, ...]) -> bool:
        return (not lengths or len(values) in lengths) and (item is None or all(map(item, values)))

    return holds
