"""Fast encoding of a table's frames: all words of a layout with one `struct.Struct`."""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence

from gateway.api.layout import Layout

Word = int | float | bytes


class Packer:
    """Packs and unpacks the words of one layout, in wire order, whole arrays included.

    Elements that the layout cuts off have no slot.
    """

    def __init__(self, layout: Layout) -> None:
        here = [field for field in layout.fields if field.present]
        text, end, slot = layout.byteorder, 0, 0
        self.layout = layout
        self.slots: dict[str, slice] = {}
        for field in here:
            text += f"{field.offset - end}x{field.code}"
            end = field.offset + field.present * field.item_size
            self.slots[field.name] = slice(slot, slot + field.present)
            slot += field.present
        self.count = slot
        self._struct = struct.Struct(f"{text}{layout.size - end}x")
        self._scalars = {field.name: field for field in here if field.count is None}

    def pack(self, words: Sequence[Word]) -> bytes:
        """Pack one word for each slot; further words are left out."""
        return self._struct.pack(*words[: self.count])

    def words(self, values: Mapping[str, object]) -> list[Word]:
        """Turn named values, as `Layout.encode` takes them, into words."""
        return list(self._struct.unpack(self.layout.encode(values)))

    def named(self, words: Sequence[Word]) -> dict[str, object]:
        """Name the words: a number or a string for a scalar, a list for an array."""
        return {
            name: self._scalars[name].shown(words[slot.start]) if name in self._scalars else list(words[slot])
            for name, slot in self.slots.items()
        }
