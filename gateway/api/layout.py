"""Payload tables: one table describes a frame, and decodes it, encodes it, and prints its schema and docs.

A `Layout` holds `Field` rows with explicit offsets, and their `Flag` rows name the bits. Reading many frames goes
through the numpy `dtype` and `read_many`; reading one frame on the hot path is compiled (see `compiler.py`).
"""

from __future__ import annotations

import dataclasses
import math
import struct
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

from gateway.api import units

if TYPE_CHECKING:
    import numpy as np

# table type -> (struct code, numpy code, bytes of one element)
TYPES: dict[str, tuple[str, str, int]] = {
    "u8": ("B", "u1", 1),
    "i8": ("b", "i1", 1),
    "u16": ("H", "u2", 2),
    "i16": ("h", "i2", 2),
    "u32": ("I", "u4", 4),
    "i32": ("i", "i4", 4),
    "u64": ("Q", "u8", 8),
    "i64": ("q", "i8", 8),
    "f32": ("f", "f4", 4),
    "f64": ("d", "f8", 8),
}

# Types whose value is one run of bytes: shown as text (NUL-padded UTF-8, bad bytes replaced) or as hexadecimal digits.
OPAQUE = ("text", "bytes")

Value = int | float | None
Values = Mapping[str, object]


@dataclass(frozen=True, slots=True, kw_only=True)
class Flag:
    """A named bit, or a named run of bits, of a field.

    Args:
        name: The manual's name, unique inside the layout.
        bit: The lowest bit.
        width: How many bits.
        meaning: What it says, with the meaning of its values.
        note: What is doubtful about it.
        since: The version of the manual that first names it, or "" where all do.
    """

    name: str
    bit: int
    width: int = 1
    meaning: str = ""
    note: str = ""
    since: str = ""

    @property
    def mask(self) -> int:
        """The mask after shifting down: `value = (word >> bit) & mask`."""
        return (1 << self.width) - 1


@dataclass(frozen=True, slots=True, kw_only=True)
class Field:
    """A named value of a frame: a scalar, or an array of equal elements.

    Args:
        name: The manual's own name.
        offset: Bytes from the start of the layout.
        type: A key of `TYPES`, or one of `OPAQUE`.
        count: Elements of an array; None for a scalar.
        size: Bytes of a `text` or `bytes` value, which is always a scalar.
        unit: A unit of `gateway.api.units`, or None. `mm|deg` is a pose: three lengths and three angles.
        meaning: What it says.
        flags: Named bits of (each element of) the word.
        present: How many elements the frame carries: fewer than there are where a layout is a prefix.
    """

    name: str
    offset: int
    type: str
    count: int | None = None
    unit: str | None = None
    meaning: str = ""
    flags: tuple[Flag, ...] = ()
    present: int = -1
    size: int | None = None

    def __post_init__(self) -> None:
        if self.type not in TYPES and self.type not in OPAQUE:
            known = ", ".join((*TYPES, *OPAQUE))
            raise ValueError(f"field {self.name}: type {self.type!r} is unknown; known are {known}")
        if (self.size is not None) != self.is_opaque or (self.is_opaque and self.count is not None):
            raise ValueError(f"field {self.name}: `size` belongs to text and bytes, which have no `count`")
        if self.present == -1:
            object.__setattr__(self, "present", self.elements)

    @property
    def elements(self) -> int:
        """How many elements the field has when it is whole."""
        return 1 if self.count is None else self.count

    @property
    def item_size(self) -> int:
        """Bytes of one element."""
        return TYPES[self.type][2] if self.size is None else self.size

    @property
    def end(self) -> int:
        """Offset of the first byte behind the whole field."""
        return self.offset + self.elements * self.item_size

    @property
    def is_float(self) -> bool:
        """Whether the elements are floating-point numbers."""
        return self.type in {"f32", "f64"}

    @property
    def is_opaque(self) -> bool:
        """Whether the value is one run of bytes, shown as a string."""
        return self.type in OPAQUE

    @property
    def code(self) -> str:
        """The struct code of the elements that the frame carries; there must be one at least."""
        return f"{self.present}{TYPES[self.type][0]}" if self.size is None else f"{self.size}s"

    def shown(self, word: object) -> object:
        """A word as it was unpacked, as a value of the vendor group: text and bytes become strings."""
        return STRINGS[self.type](word) if isinstance(word, bytes) else word


@dataclass(frozen=True, kw_only=True)
class Layout:
    """One payload table.

    Args:
        name: Unique inside the protocol; shown as `link.layout`.
        size: Bytes of the payload.
        fields: The rows, in wire order.
        source: Manual, version and section that the table was taken from.
        byteorder: `<` or `>`.
        firmware: Versions of the controller that are known to send it, for people; empty: not known.
    """

    name: str
    size: int
    fields: tuple[Field, ...]
    source: str
    byteorder: str = "<"
    firmware: str = ""

    @property
    def title(self) -> str:
        """The name, with the firmware that sends it where that is known."""
        return f"{self.name} (firmware {self.firmware})" if self.firmware else self.name

    @cached_property
    def by_name(self) -> dict[str, Field]:
        """The fields by name."""
        return {field.name: field for field in self.fields}

    @cached_property
    def flag_owner(self) -> dict[str, tuple[Field, Flag]]:
        """Each flag with the field that carries it, by `field.flag`."""
        return {f"{field.name}.{flag.name}": (field, flag) for field in self.fields for flag in field.flags}

    @cached_property
    def dtype(self) -> np.dtype[np.void]:
        """The numpy dtype, with explicit offsets; cut-off elements are left out."""
        import numpy as np  # noqa: PLC0415 - 16 MB that a gateway, which reads one frame at a time, does not need

        here = [field for field in self.fields if field.present]
        return np.dtype(
            {
                "names": [field.name for field in here],
                "formats": [_numpy_format(field, self.byteorder) for field in here],
                "offsets": [field.offset for field in here],
                "itemsize": self.size,
            },
        )

    def prefix(self, size: int, *, name: str, absent: Sequence[str] = (), firmware: str = "") -> Layout:
        """Derive the layout of a shorter frame: what is cut off stays in the table and reads as null.

        Args:
            size: Bytes of the shorter payload.
            name: Name of the derived layout.
            absent: Fields that the shorter frame carries with another meaning, so they read as null too.
            firmware: What sends the shorter frame, where that is known.

        Raises:
            ValueError: The size is not shorter, or an absent field does not exist.
        """
        if not 0 < size < self.size:
            raise ValueError(f"layout {self.name}: a prefix has 1 to {self.size - 1} bytes, not {size}")
        unknown = set(absent) - set(self.by_name)
        if unknown:
            raise ValueError(f"layout {self.name}: no field {', '.join(sorted(unknown))}")

        def cut(field: Field) -> Field:
            whole = max(0, (size - field.offset) // field.item_size)
            return dataclasses.replace(field, present=0 if field.name in absent else min(field.elements, whole))

        fields = tuple(cut(field) for field in self.fields)
        return dataclasses.replace(self, name=name, size=size, fields=fields, firmware=firmware)

    def encode(self, values: Values) -> bytes:
        """Encode named values; what is not named is zero.

        Args:
            values: A number or a sequence for each field; a field with flags also takes a mapping of `raw` and flag
                names (or a sequence of such mappings), of which the flags win; text and bytes take a string. None is
                written as zero.

        Returns:
            `size` bytes.

        Raises:
            ValueError: A name is unknown, an array has the wrong length, or a value does not fit its type.
        """
        unknown = set(values) - set(self.by_name)
        if unknown:
            raise ValueError(f"layout {self.name}: no field {', '.join(sorted(unknown))}")
        payload = bytearray(self.size)
        for name, value in values.items():
            field = self.by_name[name]
            items = [value] if field.count is None else value
            if not isinstance(items, Sequence) or len(items) != field.elements:
                raise ValueError(f"layout {self.name}: {name} takes {field.elements} values, not {value!r}")
            words = [_word(field, item) for item in items[: field.present]]
            if not words:
                continue  # cut off: it may stand behind the payload
            try:
                struct.pack_into(self._code(field), payload, field.offset, *words)
            except (struct.error, TypeError) as error:
                raise ValueError(f"layout {self.name}: {name} = {value!r}: {error}") from None
        return bytes(payload)

    def read_many(self, payloads: bytes) -> np.ndarray[tuple[int], np.dtype[np.void]]:
        """Read whole payloads laid end to end, for recordings and plots.

        Returns:
            Shape (n,), one record a payload, with the raw values of the table.

        Raises:
            ValueError: The length is no multiple of `size`.
        """
        import numpy as np  # noqa: PLC0415 - as above

        return np.frombuffer(payloads, dtype=self.dtype)

    def problems(self) -> list[str]:
        """Lint the table: one line for each thing that is wrong with it."""
        found = [] if self.source else ["no source: name manual, version and section"]
        names = [field.name for field in self.fields]
        found += [
            f"{name}: the name stands twice" for name in sorted({name for name in names if names.count(name) > 1})
        ]
        for before, after in zip(self.fields, self.fields[1:], strict=False):
            if after.offset < before.end:
                found.append(f"{after.name}: at {after.offset} it overlaps {before.name}, which ends at {before.end}")
        for field in self.fields:
            found += self._field_problems(field)
        return found

    def _field_problems(self, field: Field) -> list[str]:
        found = []
        if field.present and field.offset + field.present * field.item_size > self.size:
            found.append(f"{field.name}: it ends behind the {self.size} bytes of the layout")
        if field.unit is not None and not units.is_known(field.unit):
            found.append(f"{field.name}: unit {field.unit!r} is unknown")
        # x y z and three angles, or the magnitudes of both
        if field.unit is not None and "|" in field.unit and field.count not in {6, 2}:
            found.append(f"{field.name}: a pose has six elements")
        taken = 0
        for flag in field.flags:
            bits = flag.mask << flag.bit
            if flag.bit + flag.width > 8 * field.item_size:
                found.append(f"{field.name}.{flag.name}: it does not fit {field.type}")
            if bits & taken:
                found.append(f"{field.name}.{flag.name}: it overlaps another flag")
            taken |= bits
        flag_names = [flag.name for flag in field.flags]
        if len(set(flag_names)) != len(flag_names) or "raw" in flag_names:
            found.append(f"{field.name}: flag names must be unique, and none may be `raw`")
        if field.flags and (field.is_float or field.is_opaque):
            found.append(f"{field.name}: a {'float' if field.is_float else field.type} has no flags")
        return found

    def _code(self, field: Field) -> str:
        return f"{self.byteorder}{field.code}"


def text_of(word: bytes) -> str:
    """The text of a NUL-padded word; what is no UTF-8 is replaced."""
    return word.partition(b"\0")[0].decode("utf-8", "replace")


# How a word of an opaque type is shown.
STRINGS: dict[str, Callable[[bytes], str]] = {"text": text_of, "bytes": bytes.hex}


def is_finite(value: Value) -> bool:
    """Whether a raw value may be used: integers always, floats unless they are NaN or infinite."""
    return value is not None and math.isfinite(value)


def _numpy_format(field: Field, byteorder: str) -> object:
    code = byteorder + TYPES[field.type][1] if field.size is None else f"V{field.size}"
    return code if field.count is None else (code, (field.present,))


def _word(field: Field, item: object) -> int | float | bytes:
    """The raw word of one element; a mapping of flags is put together."""
    if field.is_opaque:
        return _opaque_word(field, item)
    if item is None:
        return 0
    if isinstance(item, Mapping):
        flags = {flag.name: flag for flag in field.flags}
        word = item.get("raw") or 0
        for name, value in item.items():
            if name == "raw":
                continue
            if name not in flags:
                raise ValueError(f"field {field.name} has no flag {name!r}")
            flag = flags[name]
            if not 0 <= int(value) <= flag.mask:
                raise ValueError(f"field {field.name}: flag {name} takes 0 to {flag.mask}, not {value!r}")
            word = word & ~(flag.mask << flag.bit) | int(value) << flag.bit
        return int(word)
    if isinstance(item, (int, float)):
        return item
    raise ValueError(f"field {field.name}: {item!r} is no number")


def _opaque_word(field: Field, item: object) -> bytes:
    """The bytes of a text or of hexadecimal digits, which the struct pads with NUL."""
    if item is None:
        return b""
    if not isinstance(item, str):
        raise ValueError(f"field {field.name}: {item!r} is no string")  # noqa: TRY004 - as every wrong value
    word = item.encode() if field.type == "text" else bytes.fromhex(item)
    if len(word) > field.item_size:
        raise ValueError(f"field {field.name} holds {field.item_size} bytes, not {len(word)}")
    return word
