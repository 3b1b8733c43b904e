"""The normaliser: from frames to canonical groups, with one reader per (table, group)."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from gateway.api.compiler import compile_state_key
from gateway.api.decoder import Table
from gateway.api.layout import Layout
from gateway.api.model import FRAME_GROUPS
from gateway.api.reader import Reader, ReadKey
from gateway.api.readers import group_reader, vendor_reader
from gateway.api.signals import Signal


class Normaliser:
    """The readers of one robot: its protocol's rows, bound to its options.

    Args:
        signals: The protocol's rows.
        options: Values of the options that rows name.

    Attributes:
        groups: The groups that the vendor can tell something of, `vendor` included.
    """

    def __init__(self, signals: Iterable[Signal], options: Mapping[str, object]) -> None:
        self.signals = tuple(signals)
        self._options = options
        self._readers: dict[int, tuple[Table, dict[str, Reader]]] = {}
        self._state_keys: dict[int, tuple[Layout, ReadKey]] = {}
        told = {signal.group for signal in self.signals}
        self.groups = (*(group for group in FRAME_GROUPS if group in told), "vendor")

    def readers(self, layout: Table) -> dict[str, Reader]:
        """The readers of every group for frames of one table; made when first asked for."""
        found = self._readers.get(id(layout))
        if found is None:
            readers = {"vendor": vendor_reader(layout)}
            for group in self.groups:
                reader = group_reader(group, layout, self.signals, self._options) if group != "vendor" else None
                if reader is not None:
                    readers[group] = reader
            found = self._readers[id(layout)] = (layout, readers)
        return found[1]

    def state_key(self, layout: Layout) -> ReadKey:
        """Reads what all state groups together follow from: of nearly every frame it is the same as of the last."""
        found = self._state_keys.get(id(layout))
        if found is None:
            found = self._state_keys[id(layout)] = (layout, compile_state_key(layout, self.signals))
        return found[1]

    def group_sources(self, group: str) -> tuple[str, ...]:
        """The sources that a group follows from."""
        rows = (signal for signal in self.signals if signal.group == group)
        return tuple(dict.fromkeys(source for row in rows for source in row.sources))

    def sources(self, key: str) -> tuple[str, ...]:
        """The sources that a key, or a whole subtree of keys, follows from."""
        rows = (signal for signal in self.signals if signal.key == key or signal.key.startswith(f"{key}."))
        return tuple(dict.fromkeys(source for row in rows for source in row.sources))

    def sources_of(self, key: str) -> tuple[str, ...]:
        """The sources that a key follows from, also where one row fills the subtree that it is in."""
        while not (found := self.sources(key)) and "." in key:
            key = key.rpartition(".")[0]
        return found
