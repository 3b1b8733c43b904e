"""What `robot-gateway decode` prints: rows, values, CSV or JSON, and what there was in all."""

from __future__ import annotations

import csv
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import msgspec

from gateway.api.decoder import Decoder
from gateway.api.describe import describe
from gateway.api.vendor import Protocol
from gateway.cli.common import FAILURE, USAGE, fail, tell
from gateway.cli.recorded import put
from gateway.cli.view import UNKNOWN, clock_time, flat, units_of, value_lines
from gateway.record.decoding import Decoding, Row, Values
from gateway.record.pieces import Conversation

_EXPLAINED = {"reject", "refused", "sent", "failed"}


@dataclass(frozen=True, slots=True)
class Spoken:
    """A conversation, and how it is read."""

    conversation: Conversation
    protocol: Protocol
    make: Callable[[], Decoder]
    signal_options: Mapping[str, object]
    title: str


@dataclass(frozen=True, slots=True)
class Asked:
    """What the command line asks for."""

    values: bool
    groups: list[str]
    rejects: bool
    json: bool
    csv: list[str] | None

    def reads(self) -> bool:
        """Whether values are read at all."""
        return self.values or bool(self.groups) or self.csv is not None


def print_all(path: Path, spoken: list[Spoken], asked: Asked) -> None:
    """Decode all conversations of a file and print what is asked for; end with 1 where there is no frame."""
    rows = csv.writer(sys.stdout, lineterminator="\n")
    table = _Table(rows, asked.csv or [])
    n_frames = 0
    for one in spoken:
        decoding = Decoding(one.conversation, one.make)
        values = Values(one.protocol, one.signal_options, asked.groups or _groups(asked.csv)) if asked.reads() else None
        if one.title and not asked.json and asked.csv is None:
            put(one.title)
        printed = _Printed(one, values, asked, table)
        for row in decoding.rows():
            printed.take(row)
        n_frames += decoding.found.counts["frame"] + decoding.found.counts["occurrence"]
        printed.finish(decoding)
    if asked.csv and not table.columns and n_frames:
        fail(f"no frame has {', '.join(asked.csv)}; the first has, for example, {', '.join(table.examples)}", USAGE)
    if not n_frames:
        fail(f"{path}: no frame is in it: is it really what {spoken[0].protocol.title} sends?", FAILURE)


def _groups(fields: list[str] | None) -> list[str]:
    return sorted({field.partition(".")[0] for field in fields or ()})


class _Table:
    """The rows of CSV; its columns are those of the first frame that has any of the fields."""

    def __init__(self, writer: object, fields: list[str]) -> None:
        self._write = writer.writerow  # type: ignore[attr-defined] # the type of a csv.writer has no name
        self._fields = fields
        self.columns: list[str] = []
        self.examples: list[str] = []

    def take(self, name: str, row: Row, values: Mapping[str, object]) -> None:
        """Write a row for a frame that has any of the fields."""
        told = flat(values)
        self.examples = self.examples or list(told)[:6]
        if not self.columns:
            self.columns = [
                key for field in self._fields for key in told if key == field or key.startswith(f"{field}.")
            ]
            if not self.columns:
                return
            self._write(["conversation", "offset", "t", *self.columns])
        if any(key in told for key in self.columns):
            self._write([name, row.offset, row.t, *map(told.get, self.columns)])


class _Printed:
    """Prints what was found in one conversation."""

    def __init__(self, spoken: Spoken, values: Values | None, asked: Asked, table: _Table) -> None:
        self._spoken = spoken
        self._name = spoken.conversation.name
        self._values = values
        self._asked = asked
        self._table = table
        self._units: dict[tuple[str, str], dict[str, str]] = {}

    def take(self, row: Row) -> None:
        """Print a row."""
        if self._asked.rejects and row.kind not in _EXPLAINED:
            return
        told = {} if row.frame is None or self._values is None else self._values.read(row.frame)
        if self._asked.csv is not None:
            if row.frame is not None:
                self._table.take(self._name, row, told)
        elif self._asked.json:
            plain = {"conversation": self._name, "offset": row.offset, "t": row.t, "kind": row.kind, "size": row.size}
            more = {"name": row.name, "detail": row.detail or None}
            put(msgspec.json.encode({**plain, **more, **({"values": told} if told else {})}).decode())
        else:
            time = UNKNOWN if row.t is None else clock_time(row.t)
            detail = f": {row.detail}" if row.detail else ""
            put(f"{row.offset:>10}  {time:<12}  {row.kind:<10}  {row.size:>6}  {row.name}{detail}")
            for group, data in told.items():
                for line in value_lines(group, data, self._units_of(group, row)):
                    put(f"    {line}")

    def finish(self, decoding: Decoding) -> None:
        """Print what there was in all, and what should be known of it."""
        found = decoding.found
        for note in self._spoken.conversation.notes:
            tell("noted:", "yellow", f"{self._name}: {note}")
        if self._asked.json:
            counts: dict[str, object] = {"conversation": self._name, "summary": dict(found.counts)}
            counts |= {"rejects": dict(found.rejects), "received": found.n_received, "explained": found.n_explained}
            put(msgspec.json.encode(counts).decode())
            return
        rejects = ", ".join(f"{count} {reason}" for reason, count in found.rejects.items())
        parts = [f"{count} {kind}" for kind, count in found.counts.items() if kind != "reject"]
        parts += [f"rejected: {rejects}"] if rejects else ["0 rejected"]
        left = found.n_received - found.n_explained
        parts += [f"{found.n_received} bytes, {'all explained' if not left else f'{left} of them not explained'}"]
        text = ", ".join(parts)
        if self._asked.csv is None:
            put(text)
        else:
            tell("read:", "green", f"{self._name}  {text}".strip())

    def _units_of(self, group: str, row: Row) -> dict[str, str]:
        if row.frame is None:
            return {}
        layout = row.frame.layout
        found = self._units.get((group, layout.name))
        if found is None:
            schema = describe(f"r/{group}", group, layout, self._spoken.protocol.signals).schema
            found = self._units[group, layout.name] = units_of(schema)
        return found
