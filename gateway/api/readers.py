"""Readers for every kind of table: compiled for the bytes of a `Layout`, bound for the values of a `Record`."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from gateway.api.compiler import compile_group, compile_vendor, compile_words, raw_words
from gateway.api.decoder import Frame, Table
from gateway.api.reader import Reader, ReadWords
from gateway.api.record import Record
from gateway.api.record_readers import record_group, record_vendor, record_words
from gateway.api.signals import Signal


def group_reader(group: str, table: Table, signals: Iterable[Signal], options: Mapping[str, object]) -> Reader | None:
    """Make the reader of one canonical group; None where the vendor tells nothing of it.

    Raises:
        ValueError: A row names a key, source or option that does not exist, or units that do not convert.
    """
    make = record_group if isinstance(table, Record) else compile_group
    return make(group, table, signals, options)  # type: ignore[arg-type] # each with its own kind of table


def vendor_reader(table: Table) -> Reader:
    """Make the reader of the `vendor` group."""
    return record_vendor(table) if isinstance(table, Record) else compile_vendor(table)


def words_reader(table: Table, sources: Sequence[str]) -> ReadWords | None:
    """Make what reads all elements of some sources, in the order they are named; None where one is not there."""
    return record_words(table, sources) if isinstance(table, Record) else compile_words(table, sources)


def raw_values(frame: Frame, sources: Sequence[str]) -> dict[str, object]:
    """Read the raw values of some sources, for events: rare, so nothing is compiled."""
    table = frame.layout
    if isinstance(table, Record):
        return {source: frame.values.get(source) for source in sources}
    return raw_words(table, frame, sources)


def unit_of(table: Table, source: str) -> str | None:
    """The unit of a source, in the manual.

    Raises:
        ValueError: The table has no such source.
    """
    if isinstance(table, Record):
        if source not in table.by_name:
            raise ValueError(f"record {table.name} has no value {source!r}")
        return table.by_name[source].unit
    if source in table.by_name:
        return table.by_name[source].unit
    if source in table.flag_owner:
        return table.flag_owner[source][0].unit
    raise ValueError(f"layout {table.name} has no field or flag {source!r}")
