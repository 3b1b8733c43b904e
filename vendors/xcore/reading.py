"""Reads JSON data as xCore objects, member by member, and notes each thing that is wrong in words."""

from __future__ import annotations

import difflib
import json
import math
import sys
from collections.abc import Mapping, Sequence
from enum import Enum
from functools import cache

import msgspec
from msgspec import inspect

from gateway.api.documents import Problem
from vendors.xcore.enums import ALIASES
from vendors.xcore.rules import DEFAULT, Limits, carried, fields_of, plain

MOST_PROBLEMS = 100  # of one object; more are only counted
_SHOWN = 60  # characters of a wrong value
_WIDEST = 128  # bits of a number that is shown
_LIKE = 0.6  # how alike a word must be to be meant


class Reader:
    """Reads one object.

    Args:
        axes: How many joints the robot has; None: any number.
        top_speed: Highest speed in mm/s; None: what the command says.
        lenient: Unknown members are passed over.
    """

    def __init__(self, *, axes: int | None = None, top_speed: float | None = None, lenient: bool = False) -> None:
        self._axes = axes
        self._top_speed = top_speed
        self._lenient = lenient
        self._problems: list[Problem] = []
        self._more = 0

    @property
    def problems(self) -> tuple[Problem, ...]:
        """All that was wrong, in the order of the data."""
        more = (Problem("", f"{self._more} more problems"),) if self._more else ()
        return (*self._problems, *more)

    def read_object(self, value: object, wanted: type[msgspec.Struct], path: str) -> object:
        """Read the members of an object.

        Args:
            value: What is to be the object, as JSON data.
            wanted: Its class.
            path: Where it stands.

        Returns:
            The same, in the one spelling that msgspec takes; of use only where there are no problems.
        """
        if not isinstance(value, Mapping):
            return self._not(path, value, "an object")
        members = _members(wanted)
        read: dict[str, object] = {}
        meant: set[str | None] = set()
        for name, item in value.items():
            if name in members:
                read[name] = self._read(item, members[name].type, joined(path, name))
            elif not self._lenient:
                meant.add(self._unknown(path, name, list(members)))
        for name, member in members.items():
            if member.required and name not in value and name not in meant:
                self._add(Problem(joined(path, name), "is missing", "", _described(*plain(member.type))))
        return read

    def _read(self, value: object, wanted: inspect.Type, path: str) -> object:
        kind, limits = plain(wanted)
        if limits.speed and self._top_speed is not None:
            limits = limits._replace(high=self._top_speed)
        match kind:
            case inspect.StructType(cls=cls):
                return self.read_object(value, cls, path)
            case inspect.FloatType() | inspect.IntType():
                return self._number(value, kind, limits, path)
            case inspect.VarTupleType():
                return self._array(value, kind, limits, path)
            case inspect.TupleType(item_types=parts):
                return self._pair(value, parts, path)
            case inspect.EnumType(cls=cls):
                return self._word(value, cls, path)
            case inspect.StrType():
                return value if isinstance(value, str) and carried(value) else self._not(path, value, "text")
            case _:
                return value if isinstance(value, bool) else self._not(path, value, _described(kind, limits))

    def _number(self, value: object, kind: inspect.FloatType | inspect.IntType, limits: Limits, path: str) -> object:
        allowed = _described(kind, limits)
        if isinstance(value, bool) or not isinstance(value, int | float):
            return self._not(path, value, allowed, "; it stands without quotes" if _numeric(value) else "")
        if not math.isfinite(value) if isinstance(value, float) else abs(value) > sys.float_info.max:
            return self._not(path, value, allowed, "; it must be finite")
        if isinstance(kind, inspect.IntType):
            if isinstance(value, float) and not value.is_integer():
                return self._not(path, value, allowed)
            value = int(value)
        low = limits.low if limits.or_default else kind.ge
        high = limits.high if limits.or_default else kind.le
        inside = (low is None or value >= low) and (high is None or value <= high)
        if not inside and not (limits.or_default and value == DEFAULT):
            return self._not(path, value, allowed)
        return value

    def _array(self, value: object, kind: inspect.VarTupleType, limits: Limits, path: str) -> object:
        allowed = _described(kind, limits)
        if not isinstance(value, Sequence) or isinstance(value, str | bytes):
            return self._not(path, value, allowed)
        if limits.axes and self._axes is not None:
            if len(value) != self._axes:
                allowed = f"{self._axes} elements"
                says = f"has {_count(value)}; the robot has {self._axes} axes"
                self._add(Problem(path, says, _count(value), allowed))
        elif not _long_enough(len(value), kind, limits):
            says = f"has {_count(value)} instead of {_lengths(kind, limits).removesuffix(' elements')}"
            self._add(Problem(path, says, _count(value), allowed))
        return [self._read(item, kind.item_type, f"{path}[{index}]") for index, item in enumerate(value)]

    def _pair(self, value: object, parts: tuple[inspect.Type, ...], path: str) -> object:
        allowed = "an array of name and value"
        if not isinstance(value, Sequence) or isinstance(value, str | bytes) or len(value) != len(parts):
            return self._not(path, value, allowed)
        both = zip(value, parts, strict=True)
        return [self._read(item, part, f"{path}[{index}]") for index, (item, part) in enumerate(both)]

    def _word(self, value: object, wanted: type[Enum], path: str) -> object:
        names = [str(member.value) for member in wanted]
        if isinstance(value, str) and (value in names or value in ALIASES.get(wanted.__name__, {})):
            return value
        meant = nearest(value, names) if isinstance(value, str) else None
        return self._not(path, value, f"one of {', '.join(names)}", f'; did you mean "{meant}"?' if meant else "")

    def _not(self, path: str, value: object, allowed: str, more: str = "") -> object:
        found = shown(value)
        self._add(Problem(path, f"{found} is not {allowed}{more}", found, allowed))
        return value

    def _unknown(self, path: str, name: object, names: list[str]) -> str | None:
        if len(self._problems) >= MOST_PROBLEMS:
            self._more += 1
            return None
        word = name if isinstance(name, str) else str(name)
        says = f"is no known member; {hint(word, names, 'the members are')}"
        self._add(Problem(joined(path, word), says, shown(name), f"one of {', '.join(names)}"))
        return nearest(word, names)

    def _add(self, problem: Problem) -> None:
        if len(self._problems) < MOST_PROBLEMS:
            self._problems.append(problem)
        else:
            self._more += 1


def shown(value: object) -> str:
    """A wrong value in a few words: as JSON has it, shortened."""
    match value:
        case int() if value.bit_length() > _WIDEST:
            return "a number of many digits"
        case bool() | int() | float() | None:
            return json.dumps(value)
        case str():
            return json.dumps(shortened(value), ensure_ascii=not carried(value))
        case Mapping():
            return "an object"
        case Sequence():
            return f"an array of {_count(value)}" if value else "an empty array"
        case _:
            return f"a {type(value).__name__}"


def shortened(text: str) -> str:
    """A text of the file, so short that a message can hold it."""
    return text if len(text) <= _SHOWN else f"{text[:_SHOWN]}…"


def joined(path: str, name: str) -> str:
    """The path of a member."""
    return f"{path}.{shortened(name)}" if path else shortened(name)


def nearest(word: str, words: Sequence[str]) -> str | None:
    """The word that was probably meant."""
    known = {one.lower(): one for one in words}
    found = difflib.get_close_matches(word[:_SHOWN].lower(), known, n=1, cutoff=_LIKE)
    return known[found[0]] if found else None


def hint(word: str, words: Sequence[str], otherwise: str) -> str:
    """The end of a sentence about an unknown word: the one that was probably meant, or all that there are."""
    meant = nearest(word, words)
    return f'did you mean "{meant}"?' if meant else f"{otherwise} {', '.join(words)}"


@cache
def _members(wanted: type[msgspec.Struct]) -> dict[str, inspect.Field]:
    return {field.encode_name: field for field in fields_of(wanted)}


def _numeric(value: object) -> bool:
    """Tell whether it is a number in quotes."""
    if not isinstance(value, str) or len(value) > _SHOWN:
        return False
    try:
        float(value)
    except ValueError:
        return False
    return True


def _described(kind: inspect.Type, limits: Limits) -> str:
    """What a type allows, in words."""
    match kind:
        case inspect.FloatType() | inspect.IntType():
            word = "a whole number" if isinstance(kind, inspect.IntType) else "a number"
            if limits.or_default:
                return f"-1 or {word}{_range(limits.low, limits.high)}"
            return word + _range(kind.ge, kind.le)
        case inspect.VarTupleType():
            return f"an array of {_lengths(kind, limits)}"
        case inspect.StructType():
            return "an object"
        case inspect.EnumType(cls=cls):
            return f"one of {', '.join(str(member.value) for member in cls)}"
        case inspect.StrType():
            return "text"
        case _:
            return "true or false"


def _range(low: float | None, high: float | None) -> str:
    if low is None:
        return ""
    return f" of at least {_digits(low)}" if high is None else f" from {_digits(low)} to {_digits(high)}"


def _digits(limit: float) -> str:
    return str(limit) if isinstance(limit, int) else f"{limit:g}"


def _long_enough(count: int, kind: inspect.VarTupleType, limits: Limits) -> bool:
    if limits.lengths:
        return count in limits.lengths
    return (kind.min_length or 0) <= count and (kind.max_length is None or count <= kind.max_length)


def _lengths(kind: inspect.VarTupleType, limits: Limits) -> str:
    if limits.lengths:
        return f"{' or '.join(map(str, limits.lengths))} elements"
    if kind.max_length is None:
        return "any number of elements"
    if kind.min_length == kind.max_length:
        return f"{kind.max_length} elements"
    return f"{kind.min_length} to {kind.max_length} elements"


def _count(value: Sequence[object]) -> str:
    return f"{len(value)} {_elements(len(value))}"


def _elements(count: int) -> str:
    return "element" if count == 1 else "elements"
