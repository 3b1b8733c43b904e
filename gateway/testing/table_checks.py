"""Checks of what a plugin states: its record, its folder, its tables, its framing and its signal rows."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable

import msgspec

from gateway.api.framing import Framing, Kind
from gateway.api.layout import TYPES
from gateway.api.model import FRAME_GROUPS
from gateway.api.record import Record
from gateway.api.signals import leaf
from gateway.api.vendor import Protocol, Vendor
from gateway.testing.subject import CheckFailed, Subject

_NAME = re.compile(r"[a-z][a-z0-9_]{0,31}")
_README_LEAST = 500  # characters that a README with something to say has
_TO_FILL = re.compile(r"\bFILL: (?P<what>.*?)[\s|.\"]*$")
_FILLED = {".py", ".toml", ".md"}
_WALK = (
    "layouts.py",
    "__init__.py",
    "signals.py",
    "vectors.toml",
    "simulator.py",
)  # what is filled first; the rest last


def nothing_is_left_to_fill(subject: Subject) -> None:
    """No line of the folder says FILL any more, as the lines of a new plugin do: each says what belongs there."""
    order = {name: number for number, name in enumerate(_WALK)}
    files = sorted(
        (file for file in subject.folder.rglob("*") if file.suffix in _FILLED),
        key=lambda file: (order.get(file.name, len(order)), file),
    )
    found = [
        f"{file.relative_to(subject.folder)} line {number}: {line['what']}"
        for file in files
        for number, text in enumerate(file.read_text("utf-8", "replace").splitlines(), start=1)
        if (line := _TO_FILL.search(text))
    ]
    if found:
        raise CheckFailed("\n".join(found))


def record_is_valid(subject: Subject) -> None:
    """The folder exports a VENDOR of its own name, whose protocols state what the core needs."""
    vendor: object = subject.vendor
    if not isinstance(vendor, Vendor):
        raise CheckFailed(f"VENDOR is a {type(vendor).__name__}: make it a gateway.api.vendor.Vendor")
    if vendor.name != subject.folder.name:
        raise CheckFailed(f"VENDOR.name is {vendor.name!r} in the folder {subject.folder.name!r}: give both one name")
    names = [protocol.name for protocol in vendor.protocols]
    _none("protocol names", (name for name in names if names.count(name) > 1), "give each protocol its own name")
    _none("names", (name for name in (vendor.name, *names) if not _NAME.fullmatch(name)), f"use {_NAME.pattern}")
    _none("problems", _protocol_problems(subject.protocol), "correct the Protocol record")
    empty = [check for check, reason in vendor.exempt.items() if not reason.strip()]
    _none("exemptions without a reason", empty, "write down why the check cannot hold")


def folder_is_documented(subject: Subject) -> None:
    """README.md says what the manual does not, and what damage cannot be noticed; vectors.toml is there."""
    readme = subject.folder / "README.md"
    text = readme.read_text() if readme.is_file() else ""
    if len(text) < _README_LEAST:
        raise CheckFailed(
            f"{readme.name} has {len(text)} characters: name manual, firmware, quirks and what is not established",
        )
    if subject.protocol.name not in text:
        raise CheckFailed(f"{readme.name} does not mention the protocol {subject.protocol.name}: describe it")
    if (subject.protocol.framing is None or subject.framing.checksum is None) and "checksum" not in text:
        raise CheckFailed(f"{readme.name}: frames have no checksum; say so, and what damage cannot be noticed")
    subject.vectors  # noqa: B018 - fails where there is none


def tables_hold(subject: Subject) -> None:
    """Tables have unique names, no overlap, known units, a source, and flags that fit their field."""
    layouts = subject.protocol.layouts
    names = [layout.name for layout in layouts]
    _none("layout names", (name for name in names if names.count(name) > 1), "give each layout its own name")
    for layout in layouts:
        _none(f"problems of layout {layout.name}", layout.problems(), "correct the table")
        silent = [field.name for field in layout.fields if not field.meaning]
        silent += [name for name, (_, flag) in layout.flag_owner.items() if not flag.meaning]
        _none(f"rows of layout {layout.name} without a meaning", silent, "say what the manual says of them")
        if layout.dtype.itemsize != layout.size:
            raise CheckFailed(f"layout {layout.name}: its dtype has {layout.dtype.itemsize} bytes, not {layout.size}")


def records_hold(subject: Subject) -> None:
    """Records have unique names, and each of their values a type, a known unit, a meaning and a source."""
    records = subject.records
    names = [record.name for record in records]
    _none("record names", (name for name in names if names.count(name) > 1), "give each record its own name")
    for record in records:
        _none(f"problems of record {record.name}", record.problems(), "correct the table")
        _none(f"types of record {record.name}", _type_problems(record), "name a type that msgspec converts to")
        if not record.fields:
            raise CheckFailed(f"record {record.name} has no values: name those that its messages carry")


def framing_holds(subject: Subject) -> None:
    """The framing's parts stand inside the header, and every table fits the sizes that its kind allows."""
    framing = subject.framing
    if not framing.magic:
        raise CheckFailed("the framing has no magic: name the first bytes of every frame, or junk is taken for frames")
    last = framing.length_at + TYPES[framing.length_type][2]
    if last > framing.header or len(framing.magic) > framing.header or (framing.type_at or 0) >= framing.header:
        raise CheckFailed(f"magic, length or type stand outside the header of {framing.header} bytes: correct `header`")
    types = [kind.type for kind in framing.kinds]
    _none("types", (str(type_) for type_ in types if types.count(type_) > 1), "give each type one kind")
    _none("kinds", (problem for kind in framing.kinds for problem in _kind_problems(framing, kind)), "correct the kind")
    if not subject.state_kinds:
        raise CheckFailed("no kind of frame carries state: give one its layouts")


def signals_compile(subject: Subject) -> None:
    """Every row names keys of the model and sources of the table, and its units convert."""
    signals = subject.protocol.signals
    if not signals:
        raise CheckFailed(
            "the protocol has no signal row, so nothing of it is told: add a row for each key it can tell"
        )
    for signal in signals:
        try:
            leaf(signal.key)
        except ValueError as error:
            raise CheckFailed(f"signal {signal.key}: {error}: use a key of gateway/api/model.py") from error
        if signal.group not in FRAME_GROUPS:
            raise CheckFailed(
                f"signal {signal.key}: group {signal.group} is the gateway's own word: leave it to the core"
            )
    doubled = [key for key, count in Counter(signal.key for signal in signals).items() if count > 1]
    _none("keys that stand twice", doubled, "keep one row a key")
    for table in subject.protocol.tables:
        try:
            subject.normaliser().readers(table)
        except (ValueError, KeyError, TypeError) as error:
            kind = "record" if isinstance(table, Record) else "layout"
            raise CheckFailed(f"{kind} {table.name}: {error}: correct the row, or the unit of its field") from error


def _protocol_problems(protocol: Protocol) -> Iterable[str]:
    if protocol.port is not None and not 0 < protocol.port < 1 << 16:
        yield f"port {protocol.port} is none"
    if protocol.stale_s <= 0 or protocol.cost <= 0:
        yield "stale_s and cost must be above 0"
    if protocol.framing is not None and (protocol.request is None) != (protocol.rate_hz is None):
        yield "request and rate_hz belong together: both for a polled protocol, neither for a pushed one"
    if protocol.rate_hz is not None and (protocol.max_rate_hz is None or protocol.max_rate_hz < protocol.rate_hz):
        yield f"max_rate_hz {protocol.max_rate_hz} must be there and not below rate_hz {protocol.rate_hz}"
    if protocol.framing is None and protocol.rate_hz is not None and protocol.make_decoders is None:
        yield "rate_hz is there, but no make_decoders: a text protocol that asks makes its own sessions"
    for pattern in protocol.outgoing:
        try:
            re.compile(pattern)
        except re.error as error:
            yield f"outgoing {pattern!r} is no pattern: {error}"
    try:
        protocol.options()
    except TypeError as error:
        yield f"{protocol.options.__name__}: {error}: every option needs a default"


def _type_problems(record: Record) -> Iterable[str]:
    for value in record.fields:
        try:
            msgspec.json.Decoder(value.type)
        except (TypeError, ValueError) as error:
            yield f"{value.name}: {error}"


def _kind_problems(framing: Framing, kind: Kind) -> Iterable[str]:
    behind = len(framing.tail) + (TYPES[framing.checksum.type][2] if framing.checksum else 0)
    if not framing.header <= kind.smallest <= kind.largest:
        yield f"{kind.name}: {kind.smallest} to {kind.largest} bytes do not hold a header of {framing.header}"
    for layout in kind.layouts:
        total = framing.layout_at + layout.size + behind
        if not kind.smallest <= total <= kind.largest or total % kind.step:
            yield f"{kind.name}: a frame of layout {layout.name} has {total} bytes, which its sizes do not allow"


def _none(what: str, found: Iterable[str], remedy: str) -> None:
    """Check that there is nothing of a kind."""
    shown = list(dict.fromkeys(found))
    if shown:
        raise CheckFailed(f"{what}: {'; '.join(shown[:8])}{'; …' if len(shown) > 8 else ''}: {remedy}")  # noqa: PLR2004
