"""What a frame says, group by group, as plain values; and how it is compared with what it should say."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import cast

import msgspec

from gateway.api.decoder import Frame
from gateway.api.model import Quality, worst
from gateway.api.normaliser import Normaliser

# Expected values are written by people, from a manual: a 32-bit float has seven digits.
RELATIVE, ABSOLUTE = 1e-6, 1e-9

Plain = dict[str, object]


@dataclass(frozen=True, slots=True)
class Reading:
    """One group of one frame.

    Attributes:
        data: Plain values: dict, list, str, int, float, bool, None.
        quality: The quality that its sample would have.
        bad: Whether it held non-finite values.
        struct: What the compiled reader returned.
    """

    data: Plain
    quality: Quality
    bad: bool
    struct: object


def read_group(normaliser: Normaliser, group: str, frame: Frame) -> Reading:
    """Read one group of a frame."""
    reader = normaliser.readers(frame.layout)[group]
    struct, quality = reader.read(frame)
    return Reading(plain(struct), worst(frame.quality, quality), quality is Quality.BAD, struct)


def read_groups(normaliser: Normaliser, frame: Frame) -> dict[str, Reading]:
    """Read every group of a frame, `vendor` included."""
    return {group: read_group(normaliser, group, frame) for group in normaliser.readers(frame.layout)}


def plain(struct: object) -> Plain:
    """A group, or a value in it, as plain values. Floats stay as they are, also where they are not finite."""
    return cast("Plain", msgspec.to_builtins(struct))


def leaves(value: object, path: str = "") -> Iterator[tuple[str, object]]:
    """Every leaf with its dotted path; elements of arrays by `[index]`."""
    if isinstance(value, dict):
        for name, below in value.items():
            yield from leaves(below, f"{path}.{name}" if path else name)
    elif isinstance(value, list):
        for index, below in enumerate(value):
            yield from leaves(below, f"{path}[{index}]")
    else:
        yield path, value


def value_at(data: object, path: Sequence[str]) -> object:
    """The value at a path; None where the path ends in a null."""
    for name in path:
        if not isinstance(data, Mapping):
            return None
        data = data.get(name)
    return data


def differences(expected: object, found: object, path: str, *, whole: bool) -> list[str]:
    """What is not as it should be, one line each.

    Args:
        expected: Values as a vector states them.
        found: Values as they were read.
        path: Where we are.
        whole: Whether what is not expected must be null; else it is not looked at.
    """
    if isinstance(expected, Mapping) and isinstance(found, Mapping):
        lines = []
        for name, value in expected.items():
            if name not in found and value is not None:
                lines.append(f"{path}.{name} should be {value!r}; there is no such key")
            else:
                lines += differences(value, found.get(name), f"{path}.{name}", whole=whole)
        if whole:
            unnamed = {name: value for name, value in found.items() if name not in expected}
            lines += [f"{path}.{name} should be null, not {value!r}" for name, value in unnamed.items() if tells(value)]
        return lines
    if isinstance(expected, list) and isinstance(found, list) and len(expected) == len(found):
        pairs = zip(expected, found, strict=True)
        return [line for i, (a, b) in enumerate(pairs) for line in differences(a, b, f"{path}[{i}]", whole=whole)]
    if expected is None and not tells(found):
        return []
    return [] if _same(expected, found) else [f"{path} should be {expected!r}, not {found!r}"]


def tells(value: object) -> bool:
    """Whether a value tells anything: null, or an object of nulls, does not."""
    if isinstance(value, Mapping):
        return any(tells(below) for below in value.values())
    return value is not None


def _same(expected: object, found: object) -> bool:
    number = (int, float)
    if isinstance(expected, bool) or isinstance(found, bool):
        return expected is found
    if isinstance(expected, number) and isinstance(found, number):
        return math.isclose(expected, found, rel_tol=RELATIVE, abs_tol=ABSOLUTE)
    return expected == found
