"""The normaliser: from frames to canonical groups, with one compiled reader per (layout, group)."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from gateway.api.compiler import Reader, compile_group, compile_vendor
from gateway.api.layout import Layout
from gateway.api.model import FRAME_GROUPS
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
        self._readers: dict[int, tuple[Layout, dict[str, Reader]]] = {}
        told = {signal.group for signal in self.signals}
        self.groups = (*(group for group in FRAME_GROUPS if group in told), "vendor")

    def readers(self, layout: Layout) -> dict[str, Reader]:
        """The readers of every group for frames of one layout; compiled when first asked for."""
        found = self._readers.get(id(layout))
        if found is None:
            readers = {"vendor": compile_vendor(layout)}
            for group in self.groups:
                reader = compile_group(group, layout, self.signals, self._options) if group != "vendor" else None
                if reader is not None:
                    readers[group] = reader
            found = self._readers[id(layout)] = (layout, readers)
        return found[1]

    def sources(self, key: str) -> tuple[str, ...]:
        """The sources that a key, or a whole subtree of keys, follows from."""
        rows = (signal for signal in self.signals if signal.key == key or signal.key.startswith(f"{key}."))
        return tuple(dict.fromkeys(source for row in rows for source in row.sources))
