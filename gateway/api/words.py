"""The words of a frame that some sources need: unpacked at once, each into a local variable of a compiled reader."""

from __future__ import annotations

import math
import struct
from collections.abc import Iterable, Sequence

from gateway.api.layout import Field, Flag, Layout
from gateway.api.signals import find_source


class Words:
    """The words that some sources need, each unpacked once into a local variable."""

    def __init__(self, layout: Layout, sources: Iterable[str]) -> None:
        self.layout = layout
        used = {find_source(layout, source)[0].name for source in sources}
        self.fields = wire_order(field for field in layout.fields if field.name in used and field.present)
        self.struct = struct_of(layout, self.fields)
        names = iter(f"v{number}" for number in range(sum(field.present for field in self.fields)))
        self._refs = {field.name: [next(names) for _ in range(field.present)] for field in self.fields}
        self.count = sum(field.present for field in self.fields)
        self.floats = [ref for field in self.fields if field.is_float for ref in self._refs[field.name]]
        self.opaque = [(self._refs[field.name][0], field.type) for field in self.fields if field.is_opaque]

    def whole(self, field: Field) -> list[str | None]:
        """The variable of each element; None for one that the frame does not carry."""
        here: list[str | None] = list(self._refs.get(field.name, []))
        return here + [None] * (field.elements - len(here))

    def refs(self, source: str) -> list[str]:
        """The variables of the elements that the frame carries."""
        return self._refs.get(find_source(self.layout, source)[0].name, [])

    def values(self, source: str) -> list[str | None]:
        """An expression for the raw value of each element; None for one that the frame does not carry."""
        field, flag = find_source(self.layout, source)
        if flag is None:
            return self.whole(field)
        return [None if ref is None else flag_expression(ref, flag) for ref in self.whole(field)]


def wire_order(fields: Iterable[Field]) -> list[Field]:
    """The order in which one struct unpacks them, whatever the order of the table."""
    return sorted(fields, key=lambda field: field.offset)


def struct_of(layout: Layout, fields: Sequence[Field]) -> struct.Struct:
    """One struct that unpacks the present elements of some fields, in wire order."""
    parts, at = [layout.byteorder], 0
    for field in wire_order(fields):
        gap = field.offset - at
        parts.append(f"{gap}x" if gap else "")
        parts.append(field.code)
        at = field.offset + field.present * field.item_size
    return struct.Struct("".join(parts))


def flag_expression(ref: str, flag: Flag) -> str:
    """The expression for a flag of a word."""
    return f"({ref} >> {flag.bit} & {flag.mask})" if flag.bit else f"({ref} & {flag.mask})"


def flag_value(word: int, flag: Flag) -> int:
    """A flag of a word."""
    return word >> flag.bit & flag.mask


def finite(value: object) -> object:
    """A raw value, or None for NaN and infinity."""
    return None if isinstance(value, float) and not math.isfinite(value) else value
