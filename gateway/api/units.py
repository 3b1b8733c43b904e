"""Units of the vendors' tables and their conversion to the canonical SI units of the model."""

from __future__ import annotations

import math
from dataclasses import dataclass

ZERO_CELSIUS_K = 273.15


@dataclass(frozen=True, slots=True)
class Conversion:
    """`canonical = raw * scale + offset`."""

    scale: float = 1.0
    offset: float = 0.0

    def __call__(self, raw: float) -> float:
        """Convert one value."""
        return raw * self.scale + self.offset


# vendor unit -> (canonical unit, conversion)
_TO_SI: dict[str, tuple[str, Conversion]] = {
    "m": ("m", Conversion()),
    "mm": ("m", Conversion(1e-3)),
    "rad": ("rad", Conversion()),
    "deg": ("rad", Conversion(math.pi / 180)),
    "s": ("s", Conversion()),
    "ms": ("s", Conversion(1e-3)),
    "us": ("s", Conversion(1e-6)),
    "kg": ("kg", Conversion()),
    "N": ("N", Conversion()),
    "Nm": ("N·m", Conversion()),
    "mNm": ("N·m", Conversion(1e-3)),
    "N·m": ("N·m", Conversion()),
    "A": ("A", Conversion()),
    "mA": ("A", Conversion(1e-3)),
    "V": ("V", Conversion()),
    "K": ("K", Conversion()),
    "degC": ("K", Conversion(1.0, ZERO_CELSIUS_K)),
    "m/s": ("m/s", Conversion()),
    "mm/s": ("m/s", Conversion(1e-3)),
    "rad/s": ("rad/s", Conversion()),
    "deg/s": ("rad/s", Conversion(math.pi / 180)),
    "rad/s^2": ("rad/s²", Conversion()),
    "deg/s^2": ("rad/s²", Conversion(math.pi / 180)),
    "%": ("1", Conversion(1e-2)),
    "1": ("1", Conversion()),
    "Hz": ("Hz", Conversion()),
}


def is_known(unit: str) -> bool:
    """Whether every part of a unit (`mm`, or `mm|deg` for a pose) can be converted."""
    return all(part in _TO_SI for part in unit.split("|"))


def shares(unit: str, canonical: str, count: int) -> list[tuple[str, str]]:
    """Find the unit of each value of an array, beside the one that it becomes.

    Args:
        unit: Of a vendor's table; of several (`mm/s|deg/s`) each measures an equal share of the values, in order.
        canonical: Of the model; of several, in the same order (`m/s, rad/s`).
        count: How many values there are.

    Raises:
        ValueError: There are not as many units as in the model, or the values have no equal shares.
    """
    pairs = list(zip(unit.split("|"), canonical.split(", "), strict=False))
    if len(pairs) != 1 + max(unit.count("|"), canonical.count(", ")) or count % len(pairs):
        raise ValueError(f"{count} values in {unit!r} do not become an array in {canonical!r}")
    return [pair for pair in pairs for _ in range(count // len(pairs))]


def conversion(unit: str, canonical: str) -> Conversion:
    """Find the conversion from a vendor's unit to a canonical one.

    Args:
        unit: A unit of a vendor's table, such as `deg`.
        canonical: The unit of the model, such as `rad`.

    Raises:
        ValueError: The unit is unknown, or measures something else.
    """
    if unit not in _TO_SI:
        raise ValueError(f"unit {unit!r} is unknown; known are {', '.join(sorted(_TO_SI))}")
    si, found = _TO_SI[unit]
    if si != canonical:
        raise ValueError(f"unit {unit!r} converts to {si!r}, not to {canonical!r}")
    return found
