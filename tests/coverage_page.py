"""The page `docs/coverage.md`: what each protocol tells of the model, and from what; made of the tables of signals."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Iterator, Sequence

from gateway.api.decoder import Table
from gateway.api.describe import never_told
from gateway.api.model import FRAME_GROUPS, GROUPS, Quality
from gateway.api.readers import unit_of
from gateway.api.signals import Leaf, Signal, keys_of, leaf
from gateway.api.units import conversion
from gateway.api.vendor import Protocol, Vendor
from gateway.core.registry import Registry

_MANY = 4
_YES, _NO = "●", "–"  # noqa: RUF001 - a dash, as in print
_HEAD = """# What each robot tells

Which keys of [the model](model.md) each protocol fills, and from which of the vendor's fields. This page is made of the
vendors' tables by `make generated`. A key that is not told is always null; a key that is told is null all the same
where the controller's firmware does not send the field, or an option that it needs is not set.

Units are the manual's, then the model's. The raw fields, all of them, are in the topic `<robot>/vendor`.
"""


def coverage_page(registry: Registry) -> str:
    """The page."""
    spoken = [(vendor, protocol) for vendor in map(registry.vendor, registry.names()) for protocol in vendor.protocols]
    parts = [_HEAD, "## At a glance\n", f"{_YES} told, {_NO} this protocol cannot tell.\n", *_glance(spoken)]
    for vendor, protocol in spoken:
        parts += ["", f"## {vendor.name} {protocol.name}\n", f"{protocol.title.rstrip('.')}.\n", *_protocol(protocol)]
    return "\n".join(parts) + "\n"


def _glance(spoken: Sequence[tuple[Vendor, Protocol]]) -> Iterator[str]:
    yield "| key | " + " | ".join(f"{vendor.name} {protocol.name}" for vendor, protocol in spoken) + " |"
    yield "|---|" + ":-:|" * len(spoken)
    for group in FRAME_GROUPS:
        never = [never_told(group, [row for row in one.signals if row.group == group]) for _, one in spoken]
        for key in _leaves(group):
            told = (_NO if key in missing else _YES for missing in never)
            yield f"| `{group}.{key}` | " + " | ".join(told) + " |"


def _leaves(group: str) -> list[str]:
    """The keys of a group that have nothing below them, but for the gateway's own."""
    struct = GROUPS[group].struct
    keys = keys_of(struct) if struct else []
    return [key for key in keys if key != "substituted" and not any(one.startswith(f"{key}.") for one in keys)]


def _protocol(protocol: Protocol) -> Iterator[str]:
    table = protocol.longest
    yield "| key | from | unit | how | quality |"
    yield "|---|---|---|---|---|"
    for group in FRAME_GROUPS:
        for row in (row for row in protocol.signals if row.group == group):
            found = leaf(row.key)
            cells = (f"`{row.key}`", _sources(row), _units(row, table, found), _how(row, table, found), _quality(row))
            yield f"| {' | '.join(cells)} |"
    never = {
        group: never_told(group, [row for row in protocol.signals if row.group == group]) for group in FRAME_GROUPS
    }
    yield "\nIt cannot tell:\n"
    for group, keys in never.items():
        missing = [key for key in _leaves(group) if key in keys]
        if missing:
            whole = len(missing) == len(_leaves(group))
            yield f"- {group}: " + ("nothing at all" if whole else ", ".join(f"`{key}`" for key in missing))


def _sources(row: Signal) -> str:
    names = [f"`{source}`" for source in row.sources]
    return ", ".join(names) if len(names) <= _MANY else f"{names[0]}, {names[1]} … {names[-1]} ({len(names)})"


def _units(row: Signal, table: Table, found: Leaf) -> str:
    theirs = list(dict.fromkeys(unit_of(table, source) or "" for source in row.sources))
    shown = ", ".join(filter(None, theirs)).replace("|", ", ")
    ours = found.unit if found.unit != "1" else ""
    if found.shape == "pose":
        ours = "m, quaternion"
    elif found.shape == "channels":
        ours = shown or "raw"
    return f"{shown or _NO} → {ours or _NO}" if shown or ours else ""


def _how(row: Signal, table: Table, found: Leaf) -> str:
    parts = [_named(row)] if row.via is not None else list(_converted(row, table, found))
    if row.options:
        parts.append("by the options " + ", ".join(f"`{option}`" for option in row.options))
    if row.volatile:
        parts.append("no change of state by itself")
    return "; ".join(filter(None, parts)).replace("|", "\\|")


def _named(row: Signal) -> str:
    """What the function of a row does, in its own words."""
    via = row.via
    while isinstance(via, functools.partial):
        via = via.func
    text = (inspect.getdoc(via) or "").partition("\n")[0] if inspect.isfunction(via) else ""
    name = getattr(via, "__name__", "").strip("_<>").replace("_", " ")
    return text.rstrip(".") or ("computed" if name == "lambda" else f"computed: {name}")


def _converted(row: Signal, table: Table, found: Leaf) -> Iterator[str]:
    """What follows from the units alone."""
    unit = unit_of(table, row.sources[0])
    if len(row.sources) > 1:
        yield "put end to end"
    if found.shape == "pose":
        yield from (_factor(part, ours) for part, ours in zip((unit or "").split("|"), ("m", "rad"), strict=False))
        yield f"angles: {row.rotation}" if row.rotation else "the rotation is not known: orientation null"
    elif unit is not None and found.unit is not None:
        yield from (_factor(part, ours) for part, ours in zip(unit.split("|"), found.unit.split(", "), strict=False))
    elif found.shape in {"bits", "bool"}:
        yield "bit by bit" if found.shape == "bits" else "0 is false"
    elif len(row.sources) == 1:
        yield "as it is"


def _factor(unit: str, canonical: str) -> str:
    found = conversion(unit, canonical)
    if (found.scale, found.offset) == (1.0, 0.0):
        return f"{unit} as it is"
    scale = "" if found.scale == 1.0 else f" × {found.scale:.6g}"
    return f"{unit}{scale}" + (f" + {found.offset:g}" if found.offset else "")


def _quality(row: Signal) -> str:
    doubt = "UNCERTAIN by value" if row.doubt is not None else ""
    return ", ".join(filter(None, ["" if row.quality is Quality.GOOD else row.quality.value, doubt]))
