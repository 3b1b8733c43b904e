"""Readers for the hot path: one frame to one canonical group, compiled once per (layout, group).

The rows of a table are turned into the source of one Python function that unpacks just the words it needs with a single
`struct.Struct` and builds the group's struct. Measured, this costs a fraction of reading field by field, and the rows
stay data (ADR 0003). A frame that holds NaN or infinity takes a second function, which makes those leaves null.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import lru_cache, partial
from itertools import groupby
from types import CodeType
from typing import cast

import msgspec

from gateway.api import model
from gateway.api.decoder import Frame
from gateway.api.expressions import calm_expression, row_expression, word_expression
from gateway.api.layout import STRINGS, Layout
from gateway.api.reader import Read, Reader, ReadKey, ReadWords
from gateway.api.signals import Signal, find_source, struct_inside
from gateway.api.words import Words, finite, flag_value, struct_of

_WHOLE = 0xFF  # every bit of a byte


def compile_group(
    group: str,
    layout: Layout,
    signals: Iterable[Signal],
    options: Mapping[str, object],
) -> Reader | None:
    """Compile the reader of one canonical group.

    Args:
        group: A key of `FRAME_GROUPS`.
        layout: The table of the frames.
        signals: Rows of any group; those of this group are used.
        options: Values of the options that rows name.

    Returns:
        The reader, or None where the vendor tells nothing of this group.

    Raises:
        ValueError: A row names a key, field, flag or option that does not exist, or units that do not convert.
    """
    rows = [signal for signal in signals if signal.group == group]
    struct_type = model.GROUPS[group].struct
    if not rows or struct_type is None:
        return None
    if any(row.doubt for row in rows):
        raise ValueError(f"{group}: only a record's values are doubted one by one; state `quality` instead")
    read = _read_rows(rows, layout, struct_type, options, calm=())
    calm = [row for row in rows if row.calm is not None and _is_whole(row, layout)]
    if calm:
        look = _compile_key(layout, [source for row in calm for source in row.sources])
        nothing = look(Frame(bytes(layout.size), layout))
        read = _unless(look, nothing, read, _read_rows(rows, layout, struct_type, options, calm=calm))
    return Reader(
        read=read,
        key=_compile_key(layout, [source for row in rows if not row.volatile for source in row.sources]),
        empty=struct_type(),
        volatile=tuple(row.path for row in rows if row.volatile),
    )


def _read_rows(
    rows: Sequence[Signal],
    layout: Layout,
    struct_type: type[msgspec.Struct],
    options: Mapping[str, object],
    *,
    calm: Sequence[Signal],
) -> Read:
    """Compile what builds a group of its rows; of those that are calm nothing is read."""
    present = [row for row in rows if any(find_source(layout, source)[0].present for source in row.sources)]
    quality = model.worst(model.Quality.GOOD, *(row.quality for row in present))
    words = Words(layout, [source for row in rows if row not in calm for source in row.sources])
    names: dict[str, object] = {}

    def expression(row: Signal, *, nulls: bool) -> str:
        if row in calm:
            return calm_expression(row, layout, options)
        return row_expression(row, words, names, options, nulls=nulls)

    fast, slow = (_tree(rows, partial(expression, nulls=nulls)) for nulls in (False, True))
    substituted = [".".join(row.path) for row in rows if row.quality is model.Quality.SUBSTITUTED]
    if substituted:
        fast["substituted"] = slow["substituted"] = repr(substituted)
    return _compile_read(words, _build(struct_type, fast, names), _build(struct_type, slow, names), names, quality)


def _is_whole(row: Signal, layout: Layout) -> bool:
    """Whether the frame carries every element that a row follows from."""
    fields = [find_source(layout, source)[0] for source in row.sources]
    return all(field.present == field.elements for field in fields)


def _unless(look: ReadKey, nothing: object, stirred: Read, calm: Read) -> Read:
    """Read what is nearly always 0 only where it is not (ADR 0021)."""

    def read(frame: Frame) -> tuple[object, model.Quality]:
        return calm(frame) if look(frame) == nothing else stirred(frame)

    return read


def compile_vendor(layout: Layout) -> Reader:
    """Compile the reader of the `vendor` group: every field under its manual name and in the manual's unit.

    A field with flags is an object of `raw` and the flags; an array of such words is a list of objects.
    """
    words = Words(layout, [field.name for field in layout.fields])

    def text(*, nulls: bool) -> str:
        items = []
        for field in layout.fields:
            refs = [ref if ref is not None else "None" for ref in words.whole(field)]
            shown = [word_expression(field, ref, nulls=nulls) for ref in refs]
            items.append(f"{field.name!r}: {shown[0] if field.count is None else '[' + ', '.join(shown) + ']'}")
        return "{" + ", ".join(items) + "}"

    empty = {field.name: None for field in layout.fields}
    return Reader(
        read=_compile_read(words, text(nulls=False), text(nulls=True), {}, model.Quality.GOOD),
        key=_compile_key(layout, [field.name for field in layout.fields]),
        empty=empty,
    )


def raw_words(layout: Layout, frame: Frame, sources: Sequence[str]) -> dict[str, object]:
    """Read the raw values of some sources, for events: rare, so nothing is compiled."""
    found: dict[str, object] = {}
    for source in sources:
        field, flag = find_source(layout, source)
        if not field.present:
            found[source] = None
            continue
        values = [field.shown(word) for word in struct_of(layout, [field]).unpack_from(frame.raw, frame.start)]
        shown = [finite(value if flag is None else flag_value(cast("int", value), flag)) for value in values]
        found[source] = shown[0] if field.count is None else shown
    return found


def compile_words(layout: Layout, sources: Sequence[str]) -> ReadWords | None:
    """Compile the reader of all elements of some fields, in the order they are named; None where one is cut off."""
    fields = [find_source(layout, source)[0] for source in sources]
    if any(field.present < field.elements for field in fields):
        return None
    here = sorted(fields, key=lambda field: field.offset)
    words = struct_of(layout, here)
    slots: dict[str, range] = {}
    at = 0
    for field in here:
        slots[field.name] = range(at, at + field.elements)
        at += field.elements
    order = [slot for field in fields for slot in slots[field.name]]

    def read(frame: Frame) -> tuple[object, ...]:
        found = words.unpack_from(frame.raw, frame.start)
        return tuple(found[slot] for slot in order)

    return read


_Tree = dict[str, object]  # path component -> expression, or the tree below it


def _tree(rows: Iterable[Signal], expression: Callable[[Signal], str]) -> _Tree:
    """Hang each row's expression at its path."""
    tree: _Tree = {}
    for row in rows:
        at = tree
        for name in row.path[:-1]:
            at = cast("_Tree", at.setdefault(name, {}))
        if row.path[-1] in at:
            raise ValueError(f"{row.key} stands twice")
        at[row.path[-1]] = expression(row)
    return tree


def _build(struct_type: type[msgspec.Struct], tree: _Tree, names: dict[str, object]) -> str:
    """The expression that builds a struct, with the structs and mappings inside it."""
    names[struct_type.__name__] = struct_type
    below = {field.name: field.type for field in msgspec.structs.fields(struct_type)}
    parts = []
    for name, value in tree.items():
        if isinstance(value, str):
            parts.append(f"{name}={value}")
            continue
        inner = struct_inside(below[name])
        if inner is not None:
            parts.append(f"{name}={_build(inner, cast('_Tree', value), names)}")
        else:
            parts.append(f"{name}={{{', '.join(f'{key!r}: {text}' for key, text in cast('_Tree', value).items())}}}")
    return f"{struct_type.__name__}({', '.join(parts)})"


def _compile_read(words: Words, fast: str, slow: str, names: Mapping[str, object], quality: model.Quality) -> Read:
    """Compile the pair of a fast function and one that meets non-finite words."""
    unpack_names = "".join(f"v{number}, " for number in range(words.count))
    assign = f"    ({unpack_names}) = words" if words.count else "    pass"
    strings = "".join(f"    {ref} = {kind}_of({ref})\n" for ref, kind in words.opaque)
    numbers = f"({', '.join(words.floats)},)" if words.opaque else "words"  # a sum over all is fastest
    check = f"    if not isfinite(sum({numbers})):\n        return read_nulls(words)\n" if words.floats else ""
    source = (
        "def read_nulls(words):\n"
        "    clean = tuple(map(finite, words))\n"
        "    bad = None in clean\n"
        "    words = clean\n"
        f"{assign}\n"
        f"{strings}"
        f"    return {slow}, quality_bad if bad else quality\n"
        "def read(frame):\n"
        "    words = unpack(frame.raw, frame.start)\n"
        f"{assign}\n"
        f"{check}"
        f"{strings}"
        f"    return {fast}, quality\n"
    )
    shown = {f"{kind}_of": to_string for kind, to_string in STRINGS.items()}
    qualities = {"quality": quality, "quality_bad": model.Quality.BAD}
    tools = {"unpack": words.struct.unpack_from, "isfinite": math.isfinite, "finite": finite}
    scope = {**names, **shown, **qualities, **tools}
    exec(_code(source, f"<reader of {words.layout.name}>"), scope)  # noqa: S102 - made of tables, see the top
    return cast("Read", scope["read"])


def compile_state_key(layout: Layout, signals: Iterable[Signal]) -> ReadKey:
    """Compile what reads the bits that any state group follows from: while they stay equal, no group has news."""
    rows = [row for row in signals if model.GROUPS[row.group].delivery == "state" and not row.volatile]
    return _compile_key(layout, [source for row in rows for source in row.sources])


def _compile_key(layout: Layout, sources: Iterable[str]) -> ReadKey:
    """Compile the function that reads just the bits that some sources follow from.

    Whole bytes side by side are one value, compared as they are: a fifth of the time that word by word takes.
    """
    masks = bytearray(layout.size)
    for source in sources:
        field, flag = find_source(layout, source)
        whole = (1 << 8 * field.item_size) - 1 if flag is None else flag.mask << flag.bit
        mask = whole.to_bytes(field.item_size, "little" if layout.byteorder == "<" else "big") * field.present
        for at, bits in enumerate(mask, field.offset):
            masks[at] |= bits
    codes, refs, parts = [layout.byteorder], "", ""
    for bits, run in groupby(bytes(masks).rstrip(b"\0")):
        size = len(list(run))
        codes.append(f"{size}{'x' if bits == 0 else 's' if bits == _WHOLE else 'B'}")
        for _ in range(0 if bits == 0 else 1 if bits == _WHOLE else size):
            ref = f"v{len(refs)}, "
            refs += ref
            parts += ref if bits == _WHOLE else f"{ref[:-2]} & {bits}, "
    if refs == parts:
        body = "    return unpack(frame.raw, frame.start)\n"
    else:
        body = f"    ({refs}) = unpack(frame.raw, frame.start)\n    return ({parts})\n"
    scope: dict[str, object] = {"unpack": struct.Struct("".join(codes)).unpack_from}
    exec(_code(f"def key(frame):\n{body}", f"<key of {layout.name}>"), scope)  # noqa: S102 - made of tables
    return cast("ReadKey", scope["key"])


@lru_cache(maxsize=256)
def _code(source: str, name: str) -> CodeType:
    """The code of a function: robots with the same frames share it, which is most of what a reader weighs."""
    return compile(source, name, "exec")
