"""What one frame costs: found, decoded and normalised, beside `struct.unpack` of the same bytes as words."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator

from gateway.api.model import GROUPS
from gateway.api.normaliser import Normaliser
from gateway.api.vendor import Protocol
from gateway.core.registry import Registry
from gateway.testing import vectors
from tests.bench.measure import Row, compare

OPTIONS = {"estop_polarity": "active_low"}


def rows() -> Iterator[Row]:
    """Every protocol that the registry finds."""
    registry = Registry()
    for name in registry.names():
        for protocol in registry.vendor(name).protocols:
            yield from _protocol_rows(registry, name, protocol)


def _protocol_rows(registry: Registry, vendor: str, protocol: Protocol) -> list[Row]:
    raw = _longest(registry, vendor, protocol)
    unpack = struct.Struct(f"<{len(raw) // 4}I").unpack_from
    decoder = protocol.reader()
    decoder.feed(raw)
    normaliser = Normaliser(protocol.signals, {**OPTIONS, **_defaults(protocol)})
    layout = max(protocol.layouts, key=lambda layout: layout.size)
    readers = normaliser.readers(layout)
    canonical = [reader for group, reader in readers.items() if group != "vendor"]
    states = [reader for group, reader in readers.items() if GROUPS[group].delivery == "state"]

    def everything() -> None:
        for reader in canonical:
            reader.read(raw, 0)

    def usual() -> None:
        decoder.feed(raw)
        for reader in states:
            reader.key(raw, 0)
        readers["joints"].read(raw, 0)
        readers["tcp"].read(raw, 0)

    candidates: list[tuple[str, Callable[[], object]]] = [
        ("find the frame", lambda: decoder.feed(raw)),
        ("joints", lambda: readers["joints"].read(raw, 0)),
        ("tcp", lambda: readers["tcp"].read(raw, 0)),
        ("status, when it has changed", lambda: readers["status"].read(raw, 0)),
        ("has status, safety or io changed?", lambda: [reader.key(raw, 0) for reader in states]),
        ("usual frame: found, joints, tcp, no change", usual),
        ("every canonical group", everything),
        ("every field of the vendor group", lambda: readers["vendor"].read(raw, 0)),
    ]
    title = f"{vendor}:{protocol.name}"
    baseline = (f"{title}  struct.unpack of {len(raw) // 4} words", lambda: unpack(raw))
    return compare(baseline, [(f"{title}  {name}", call) for name, call in candidates])


def _longest(registry: Registry, vendor: str, protocol: Protocol) -> bytes:
    known = vectors.load(registry.folder(vendor) / "vectors.toml")
    fitting = [vector.raw for vector in known if vector.protocol == protocol.name and _is_exact(protocol, vector.raw)]
    return max(fitting, key=len)


def _is_exact(protocol: Protocol, raw: bytes) -> bool:
    return len(raw) in {layout.size for layout in protocol.layouts}


def _defaults(protocol: Protocol) -> dict[str, object]:
    options = protocol.options()
    return {name: getattr(options, name) for name in options.__struct_fields__}
