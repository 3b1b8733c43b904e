"""Readers for the hot path: one frame to one canonical group, compiled once per (layout, group).

The rows of a table are turned into the source of one Python function that unpacks just the words it needs with a single
`struct.Struct` and builds the group's struct. Measured, this costs a fraction of reading field by field, and the rows
stay data (ADR 0003). A frame that holds NaN or infinity takes a second function, which makes those leaves null.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import cast

import msgspec

from gateway.api import model, units
from gateway.api.layout import STRINGS, Field, Flag, Layout
from gateway.api.rotations import POSE_FROM, pose_without_rotation
from gateway.api.signals import Signal, find_source, leaf

Read = Callable[[bytes, int], tuple[object, bool]]
ReadKey = Callable[[bytes, int], object]
# An unsigned integer of the same size: for keys that compare floats bit by bit, where NaN equals NaN.
_AS_BITS = {"f32": "I", "f64": "Q"}


@dataclass(frozen=True, slots=True)
class Reader:
    """How one group is read from frames of one layout.

    Attributes:
        read: Takes `raw` and where the layout starts in it; returns the group and whether it held non-finite values.
        key: The bits that the group's discrete values follow from: while they stay equal, a state topic has no news.
        quality: The worst quality that the rows themselves state.
        empty: The group with every leaf null.
        volatile: Paths of the leaves that always change.
    """

    read: Read
    key: ReadKey
    quality: model.Quality
    empty: object
    volatile: tuple[tuple[str, ...], ...] = ()


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
    words = _Words(layout, [source for row in rows for source in row.sources])
    names: dict[str, object] = {}
    fast = _tree(rows, lambda row: _expression(row, words, names, options, nulls=False))
    slow = _tree(rows, lambda row: _expression(row, words, names, options, nulls=True))
    substituted = [".".join(row.path) for row in rows if row.quality is model.Quality.SUBSTITUTED]
    if substituted:
        fast["substituted"] = slow["substituted"] = repr(substituted)
    present = [row for row in rows if any(words.refs(source) for source in row.sources)]
    return Reader(
        read=_compile_read(words, _build(struct_type, fast, names), _build(struct_type, slow, names), names),
        key=_compile_key(layout, [source for row in rows if not row.volatile for source in row.sources]),
        quality=model.worst(model.Quality.GOOD, *(row.quality for row in present)),
        empty=struct_type(),
        volatile=tuple(row.path for row in rows if row.volatile),
    )


def compile_vendor(layout: Layout) -> Reader:
    """Compile the reader of the `vendor` group: every field under its manual name and in the manual's unit.

    A field with flags is an object of `raw` and the flags; an array of such words is a list of objects.
    """
    words = _Words(layout, [field.name for field in layout.fields])

    def text(*, nulls: bool) -> str:
        items = []
        for field in layout.fields:
            refs = [ref if ref is not None else "None" for ref in words.whole(field)]
            shown = [_word_expression(field, ref, nulls=nulls) for ref in refs]
            items.append(f"{field.name!r}: {shown[0] if field.count is None else '[' + ', '.join(shown) + ']'}")
        return "{" + ", ".join(items) + "}"

    empty = {field.name: None for field in layout.fields}
    return Reader(
        read=_compile_read(words, text(nulls=False), text(nulls=True), {}),
        key=_compile_key(layout, [field.name for field in layout.fields]),
        quality=model.Quality.GOOD,
        empty=empty,
    )


def raw_values(layout: Layout, raw: bytes, start: int, sources: Sequence[str]) -> dict[str, object]:
    """Read the raw values of some sources, for events: rare, so nothing is compiled."""
    found: dict[str, object] = {}
    for source in sources:
        field, flag = find_source(layout, source)
        if not field.present:
            found[source] = None
            continue
        values = [field.shown(word) for word in _struct(layout, [field]).unpack_from(raw, start)]
        shown = [_finite(value if flag is None else _flag_value(cast("int", value), flag)) for value in values]
        found[source] = shown[0] if field.count is None else shown
    return found


def compile_words(layout: Layout, sources: Sequence[str]) -> Callable[[bytes, int], tuple[int | float, ...]] | None:
    """Compile the reader of all elements of some fields, in the order they are named; None where one is cut off."""
    fields = [find_source(layout, source)[0] for source in sources]
    if any(field.present < field.elements for field in fields):
        return None
    here = sorted(fields, key=lambda field: field.offset)
    words = _struct(layout, here)
    slots: dict[str, range] = {}
    at = 0
    for field in here:
        slots[field.name] = range(at, at + field.elements)
        at += field.elements
    order = [slot for field in fields for slot in slots[field.name]]

    def read(raw: bytes, start: int) -> tuple[int | float, ...]:
        found = words.unpack_from(raw, start)
        return tuple(found[slot] for slot in order)

    return read


class _Words:
    """The words that some sources need, each unpacked once into a local variable."""

    def __init__(self, layout: Layout, sources: Iterable[str]) -> None:
        self.layout = layout
        used = {find_source(layout, source)[0].name for source in sources}
        self.fields = _wire_order(field for field in layout.fields if field.name in used and field.present)
        self.struct = _struct(layout, self.fields)
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
        return [None if ref is None else ref if flag is None else _flag(ref, flag) for ref in self.whole(field)]


def _wire_order(fields: Iterable[Field]) -> list[Field]:
    """The order in which one struct unpacks them, whatever the order of the table."""
    return sorted(fields, key=lambda field: field.offset)


def _struct(layout: Layout, fields: Sequence[Field]) -> struct.Struct:
    """One struct that unpacks the present elements of some fields, in the order of the table."""
    return _packing(layout, fields, {})


def _packing(layout: Layout, fields: Sequence[Field], codes: Mapping[str, str]) -> struct.Struct:
    parts, at = [layout.byteorder], 0
    for field in _wire_order(fields):
        gap = field.offset - at
        parts.append(f"{gap}x" if gap else "")
        parts.append(f"{field.present}{codes[field.type]}" if field.type in codes else field.code)
        at = field.offset + field.present * field.item_size
    return struct.Struct("".join(parts))


def _flag(ref: str, flag: Flag) -> str:
    return f"({ref} >> {flag.bit} & {flag.mask})" if flag.bit else f"({ref} & {flag.mask})"


def _flag_value(word: int, flag: Flag) -> int:
    return word >> flag.bit & flag.mask


def _finite(value: object) -> object:
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _word_expression(field: Field, ref: str, *, nulls: bool) -> str:
    """The vendor group's expression for one element: the value, or an object of the raw word and its flags."""
    if not field.flags or ref == "None":
        return ref
    flags = ", ".join(f"{flag.name!r}: {_flag(ref, flag)}" for flag in field.flags)
    shown = f"{{'raw': {ref}, {flags}}}"
    return f"(None if {ref} is None else {shown})" if nulls else shown


def _expression(
    row: Signal,
    words: _Words,
    names: dict[str, object],
    options: Mapping[str, object],
    *,
    nulls: bool,
) -> str:
    """The expression that a row's key follows from."""
    goal = leaf(row.key)
    if row.via is not None:
        return _via_expression(row, words, names, options, nulls=nulls)
    values = [value for source in row.sources for value in words.values(source)]
    if all(value is None for value in values):
        return "None"
    found = {find_source(words.layout, source)[0].unit for source in row.sources}
    if len(found) > 1:
        raise ValueError(f"{row.key}: its sources have different units: {found}")
    unit = found.pop()
    if goal.shape == "pose":
        return _pose_expression(row, values, unit, names, nulls=nulls)
    if goal.shape == "channels":
        si, items = _channel_items(row, values, unit, nulls=nulls)
        names["Channels"] = model.Channels
        return f"Channels([{items}], {si!r})"
    items_list = [_item(row, value, unit, goal.unit, goal.shape, nulls=nulls) for value in values]
    if goal.shape in {"array", "bits"}:
        return f"[{', '.join(items_list)}]"
    if goal.shape in {"float", "int", "bool"} and len(items_list) == 1:
        return items_list[0]
    raise ValueError(f"{row.key}: {len(items_list)} values need a function (via) to become {goal.shape}")


def _via_expression(
    row: Signal,
    words: _Words,
    names: dict[str, object],
    options: Mapping[str, object],
    *,
    nulls: bool,
) -> str:
    arguments, checked = [], []
    for source in row.sources:
        field, _ = find_source(words.layout, source)
        values = words.values(source)
        if not row.partial and any(value is None for value in values):
            return "None"
        absent = all(value is None for value in values)
        shown = ["None" if value is None else value for value in values]
        arguments.append("None" if absent else shown[0] if field.count is None else f"[{', '.join(shown)}]")
        checked += [ref for ref in words.refs(source) if field.is_float]
    for option in row.options:
        if option not in options:
            raise ValueError(f"{row.key}: the robot has no option {option!r}")
        names[f"option_{option}"] = options[option]
        arguments.append(f"{option}=option_{option}")
    function = f"via_{'_'.join((row.group, *row.path))}"
    names[function] = row.via
    call = f"{function}({', '.join(arguments)})"
    if nulls and checked and not row.partial:
        return f"(None if {' or '.join(f'{ref} is None' for ref in checked)} else {call})"
    return call


def _pose_expression(
    row: Signal,
    values: Sequence[str | None],
    unit: str | None,
    names: dict[str, object],
    *,
    nulls: bool,
) -> str:
    if unit is None or "|" not in unit or any(value is None for value in values):
        if unit is not None and "|" in unit:
            return "None"
        raise ValueError(f"{row.key}: a pose needs a source in `mm|deg` or the like, not {unit!r}")
    length, angle = unit.split("|")
    present = [value for value in values if value is not None]
    scaled = [_scaled(value, length, "m") for value in present[:3]] + [
        _scaled(value, angle, "rad") for value in present[3:]
    ]
    function = f"pose_{row.rotation}"
    names[function] = POSE_FROM[row.rotation] if row.rotation else pose_without_rotation
    call = f"{function}({', '.join(scaled)})"
    return f"(None if {' or '.join(f'{value} is None' for value in present)} else {call})" if nulls else call


def _channel_items(row: Signal, values: Sequence[str | None], unit: str | None, *, nulls: bool) -> tuple[str, str]:
    if unit is None:
        raise ValueError(f"{row.key}: channels without a unit need a function (via) that fills `raw`")
    si = next(si for si in ("V", "A") if _converts(unit, si))
    return si, ", ".join(_item(row, value, unit, si, "float", nulls=nulls) for value in values)


def _converts(unit: str, si: str) -> bool:
    try:
        units.conversion(unit, si)
    except ValueError:
        return False
    return True


def _item(row: Signal, value: str | None, unit: str | None, si: str | None, shape: str, *, nulls: bool) -> str:
    """The expression for one element of a row without a function."""
    if value is None:
        return "None"
    if shape in {"bits", "bool"}:
        return f"(None if {value} is None else {value} != 0)" if nulls else f"{value} != 0"
    if shape == "int" or si is None:
        return value
    if unit is None and si != "1":
        raise ValueError(f"{row.key} is in {si}, but its source has no unit")
    scaled = _scaled(value, unit or "1", si)
    return f"(None if {value} is None else {scaled})" if nulls and scaled != value else scaled


def _scaled(value: str, unit: str, si: str) -> str:
    found = units.conversion(unit, si)
    text = value if found.scale == 1.0 else f"{value} * {found.scale!r}"
    return text if found.offset == 0.0 else f"{text} + {found.offset!r}"


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
        inner = _struct_inside(below[name])
        if inner is not None:
            parts.append(f"{name}={_build(inner, cast('_Tree', value), names)}")
        else:
            parts.append(f"{name}={{{', '.join(f'{key!r}: {text}' for key, text in cast('_Tree', value).items())}}}")
    return f"{struct_type.__name__}({', '.join(parts)})"


def _struct_inside(annotation: object) -> type[msgspec.Struct] | None:
    """The struct in `Annotated[Struct | None, …]`, or None where it is a mapping."""
    candidates = [annotation]
    while candidates:
        one = candidates.pop()
        if isinstance(one, type) and issubclass(one, msgspec.Struct):
            return one
        if getattr(one, "__origin__", None) is dict:
            return None
        candidates += getattr(one, "__args__", ()) or ()
    return None


def _compile_read(words: _Words, fast: str, slow: str, names: Mapping[str, object]) -> Read:
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
        f"    return {slow}, bad\n"
        "def read(raw, start):\n"
        "    words = unpack(raw, start)\n"
        f"{assign}\n"
        f"{check}"
        f"{strings}"
        f"    return {fast}, False\n"
    )
    shown = {f"{kind}_of": to_string for kind, to_string in STRINGS.items()}
    scope = {**names, **shown, "unpack": words.struct.unpack_from, "isfinite": math.isfinite, "finite": _finite}
    exec(compile(source, f"<reader of {words.layout.name}>", "exec"), scope)  # noqa: S102 - made of tables, see the top
    return cast("Read", scope["read"])


def _compile_key(layout: Layout, sources: Iterable[str]) -> ReadKey:
    """Compile the function that reads just the bits that some sources follow from."""
    masks: dict[str, int] = {}
    for source in sources:
        field, flag = find_source(layout, source)
        whole = (1 << 8 * field.item_size) - 1
        masks[field.name] = masks.get(field.name, 0) | (whole if flag is None else flag.mask << flag.bit)
    fields = _wire_order(field for field in layout.fields if field.name in masks and field.present)
    refs: list[str] = []
    parts: list[str] = []
    for field in fields:
        whole = (1 << 8 * field.item_size) - 1
        for _ in range(field.present):
            ref = f"v{len(refs)}"
            refs.append(f"{ref}, ")
            parts.append(f"{ref}, " if masks[field.name] == whole else f"{ref} & {masks[field.name]}, ")
    if refs == parts:
        body = "    return unpack(raw, start)\n"
    else:
        body = f"    ({''.join(refs)}) = unpack(raw, start)\n    return ({''.join(parts)})\n"
    scope: dict[str, object] = {"unpack": _packing(layout, fields, _AS_BITS).unpack_from}
    exec(compile(f"def key(raw, start):\n{body}", f"<key of {layout.name}>", "exec"), scope)  # noqa: S102 - made of tables
    return cast("ReadKey", scope["key"])
