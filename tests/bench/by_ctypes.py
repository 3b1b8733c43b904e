"""How the vendors' own clients read a frame: a packed ctypes struct, copied from the bytes, then its fields.

The conversions are the gateway's own expressions, so that only the reading differs.
"""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, cast

from gateway.api import model
from gateway.api.compiler import _build, _tree
from gateway.api.expressions import calm_expression, row_expression
from gateway.api.layout import STRINGS, TYPES, Field, Layout
from gateway.api.signals import Signal, find_source
from gateway.api.words import Words, wire_order

_CTYPES = {
    **{f"u{bits}": f"c_uint{bits}" for bits in (8, 16, 32, 64)},
    **{f"i{bits}": f"c_int{bits}" for bits in (8, 16, 32, 64)},
    "f32": "c_float",
    "f64": "c_double",
}
_Read = Callable[[bytes, int], object]


class Made:
    """Readers of some signals' fields that are made of ctypes.

    Args:
        layout: The table of the frame.
        rows: Whose fields are read.
        options: Values of the options that rows name.

    Attributes:
        read: Copies the struct and reads the fields.
        converted: The same, and builds the groups.
    """

    def __init__(self, layout: Layout, rows: Sequence[Signal], options: Mapping[str, object]) -> None:
        words = Words(layout, [source for row in rows for source in row.sources])
        sources = dict.fromkeys(source for row in rows for source in row.sources)
        names = dict.fromkeys(find_source(layout, source)[0].name for source in sources)
        fields = wire_order(field for field in layout.fields if field.name in names and field.present)
        scope: dict[str, object] = {"copied": struct_of(layout).from_buffer_copy}
        scope |= {f"{kind}_of": to_string for kind, to_string in STRINGS.items()}
        reads = [f"{', '.join(map(str, words.whole(field)[: field.present]))}{_reading(field)}" for field in fields]
        strings = [f"{ref} = {kind}_of({ref})" for ref, kind in words.opaque]
        calm = [row for row in rows if row.calm is not None]
        stirred = [ref for row in calm for source in row.sources for ref in words.refs(source)]

        def expression(row: Signal) -> str:
            made = row_expression(row, words, scope, options, nulls=False)
            return f"({made} if stirred else {calm_expression(row, layout, options)})" if row in calm else made

        groups = []
        for group in dict.fromkeys(row.group for row in rows):
            tree = _tree([row for row in rows if row.group == group], expression)
            groups.append(_build(cast("type[Any]", model.GROUPS[group].struct), tree, scope))
        scope |= {"isfinite": math.isfinite}
        check = f"if not isfinite(sum(({', '.join(words.floats)},))): return None"
        looks = [f"stirred = {' or '.join(dict.fromkeys(stirred))}"] if stirred else []
        self.read = _compiled(scope, reads, "None")
        self.converted = _compiled(scope, [*reads, check, *strings, *looks], ", ".join(groups))


def _reading(field: Field) -> str:
    if field.is_opaque or field.count is None:
        return f" = struct.{field.name}"
    return f", = struct.{field.name}[:]" if field.present == 1 else f" = struct.{field.name}[:]"


def _compiled(scope: Mapping[str, object], lines: Sequence[str], answer: str) -> _Read:
    body = "".join(f"    {line}\n" for line in lines)
    source = f"def read(raw, start):\n    struct = copied(raw, start)\n{body}    return {answer}\n"
    made = dict(scope)
    exec(compile(source, "<by ctypes>", "exec"), made)  # noqa: S102 - made of tables
    return cast("_Read", made["read"])


def struct_of(layout: Layout) -> Any:  # noqa: ANN401 - a type that exists only now
    """The packed ctypes struct of a table."""
    fields: list[tuple[str, Any]] = []
    end = 0
    for field in sorted(layout.fields, key=lambda field: field.offset):
        if not field.present:
            continue
        if field.offset > end:
            fields.append((f"gap_{end}", ctypes.c_uint8 * (field.offset - end)))
        if field.type in TYPES:
            one = getattr(ctypes, _CTYPES[field.type])
            fields.append((field.name, one if field.count is None else one * field.present))
        else:
            fields.append((field.name, ctypes.c_char * field.item_size))
        end = field.offset + field.present * field.item_size
    base = ctypes.LittleEndianStructure if layout.byteorder == "<" else ctypes.BigEndianStructure
    made = type("Made", (base,), {"_pack_": 1, "_fields_": fields})
    assert ctypes.sizeof(cast("Any", made)) <= layout.size
    return made
