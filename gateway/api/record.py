"""Tables of named values: what the messages of a text protocol carry, as `Layout` is for binary frames.

A `Record` says the name, type, unit and meaning of each value; the decoder has parsed them, so a frame of a record
holds them as `Frame.values`. A frame may carry some of them only: the others keep what they last were, with its age.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import msgspec

from gateway.api import units
from gateway.api.layout import Flag


@dataclass(frozen=True, slots=True, kw_only=True)
class Value:
    """A named value of a record.

    Args:
        name: The manual's own name.
        type: What it is, as a type that msgspec converts to: `float`, `list[float]`, `str`, a struct …
        unit: A unit of `gateway.api.units`, or None. `mm|deg` is a pose: three lengths, three angles, and what follows
            them is not looked at.
        meaning: What it says.
        own: The decoder has made it of several messages: no member of any message has the name.
    """

    name: str
    type: object
    unit: str | None = None
    meaning: str = ""
    own: bool = False

    flags: ClassVar[tuple[Flag, ...]] = ()


@dataclass(frozen=True, kw_only=True)
class Record:
    """The table of a text protocol's values.

    Args:
        name: Unique inside the protocol; shown as `link.layout`.
        fields: The rows.
        source: Manual, version and section that the table was taken from.
    """

    name: str
    fields: tuple[Value, ...]
    source: str

    @cached_property
    def by_name(self) -> dict[str, Value]:
        """The values by name."""
        return {value.name: value for value in self.fields}

    def convert(self, name: str, told: object) -> object:
        """Check one value as it was parsed, and bring it into its type; None stays None.

        Raises:
            ValueError: It is no such value; the text says what was found and what is expected.
        """
        if told is None:
            return None
        try:
            return msgspec.convert(told, self.by_name[name].type)
        except msgspec.ValidationError as error:
            raise ValueError(f"{name}: {error}") from None

    def problems(self) -> list[str]:
        """Lint the table: one line for each thing that is wrong with it."""
        found = [] if self.source else ["no source: name manual, version and section"]
        names = [value.name for value in self.fields]
        found += [
            f"{name}: the name stands twice" for name in sorted({name for name in names if names.count(name) > 1})
        ]
        for value in self.fields:
            if value.unit is not None and not units.is_known(value.unit):
                found.append(f"{value.name}: unit {value.unit!r} is unknown")
            if not value.meaning:
                found.append(f"{value.name}: no meaning")
        return found
