"""What one frame costs: found, decoded and normalised, beside `struct.unpack` of the same bytes as words."""

from __future__ import annotations

import ctypes
import struct
from collections.abc import Callable, Iterator
from typing import Any

from gateway.api.decoder import Frame
from gateway.api.layout import TYPES, Layout
from gateway.api.model import GROUPS, Quality
from gateway.api.normaliser import Normaliser
from gateway.api.vendor import Protocol
from gateway.core.registry import Registry
from gateway.testing import vectors
from gateway.testing.playing import opened, tell
from gateway.testing.speed_checks import least_of
from gateway.testing.subject import Subject
from gateway.testing.vector_checks import the_frame
from tests.bench.measure import Row, compare

OPTIONS = {"estop_polarity": "active_low"}
_CTYPES = {
    **{f"u{bits}": f"c_uint{bits}" for bits in (8, 16, 32, 64)},
    **{f"i{bits}": f"c_int{bits}" for bits in (8, 16, 32, 64)},
    "f32": "c_float",
    "f64": "c_double",
}


def rows() -> Iterator[Row]:
    """Every protocol that the registry finds."""
    registry = Registry()
    for name in registry.names():
        for protocol in registry.vendor(name).protocols:
            make = _text_rows if protocol.framing is None else _binary_rows
            yield from make(registry, name, protocol)


def _binary_rows(registry: Registry, vendor: str, protocol: Protocol) -> list[Row]:
    frame, layout = _longest(registry, vendor, protocol)
    raw = frame.raw
    unpack = struct.Struct(f"<{len(raw) // 4}I").unpack_from
    decoder = protocol.reader()
    normaliser = Normaliser(protocol.signals, {**OPTIONS, **_defaults(protocol)})
    readers = normaliser.readers(frame.layout)
    canonical = [reader for group, reader in readers.items() if group != "vendor"]
    states = [reader for group, reader in readers.items() if GROUPS[group].delivery == "state"]

    def everything() -> None:
        for reader in canonical:
            reader.read(frame)

    def usual() -> None:
        decoder.feed(raw)
        for reader in states:
            reader.key(frame)
        readers["joints"].read(frame)
        readers["tcp"].read(frame)

    candidates: list[tuple[str, Callable[[], object]]] = [
        ("find the frame", lambda: decoder.feed(raw)),
        ("joints", lambda: readers["joints"].read(frame)),
        ("tcp", lambda: readers["tcp"].read(frame)),
        ("status, when it has changed", lambda: readers["status"].read(frame)),
        ("has status, safety or io changed?", lambda: [reader.key(frame) for reader in states]),
        ("usual frame: found, joints, tcp, no change", usual),
        ("every canonical group", everything),
        ("every field of the vendor group", lambda: readers["vendor"].read(frame)),
        ("the same fields by ctypes, as others read them", _by_ctypes(frame, layout)),
    ]
    title = f"{vendor}:{protocol.name}"
    baseline = (f"{title}  struct.unpack of {len(raw) // 4} words", lambda: unpack(raw))
    return compare(baseline, [(f"{title}  {name}", call) for name, call in candidates])


def _text_rows(registry: Registry, vendor: str, protocol: Protocol) -> list[Row]:
    """The longest message that carries state, beside the least that anybody must do with it."""
    subject = Subject(registry.vendor(vendor), protocol, registry.folder(vendor))
    vector = max(subject.states, key=lambda one: len(one.raw))
    frame = the_frame(subject, vector)
    assert frame is not None
    decoder = opened(subject, vector)
    readers = subject.normaliser({**OPTIONS, **vector.options}).readers(frame.layout)
    canonical = [reader for group, reader in readers.items() if group != "vendor"]
    states = [reader for group, reader in readers.items() if GROUPS[group].delivery == "state"]

    def find() -> None:
        tell(decoder, vector.asked)
        decoder.feed(vector.raw)

    def usual() -> None:
        find()
        for reader in states:
            reader.key(frame)
        readers["joints"].read(frame)
        readers["tcp"].read(frame)

    candidates: list[tuple[str, Callable[[], object]]] = [
        ("find and check the message", find),
        ("usual message: found, joints, tcp, no change", usual),
        ("every canonical group", lambda: [reader.read(frame) for reader in canonical]),
        ("every value of the vendor group", lambda: readers["vendor"].read(frame)),
    ]
    title, (name, least) = f"{vendor}:{protocol.name}", least_of(vector, subject)
    baseline = (f"{title}  {name} of {len(vector.raw)} bytes", least)
    return compare(baseline, [(f"{title}  {name}", call) for name, call in candidates])


def _longest(registry: Registry, vendor: str, protocol: Protocol) -> tuple[Frame, Layout]:
    """The longest frame among the vectors that a table explains to its end, and that table."""
    known = vectors.load(registry.folder(vendor) / "vectors.toml")
    events = [event for one in known if one.protocol == protocol.name for event in protocol.reader().feed(one.raw)]
    exact = [event for event in events if isinstance(event, Frame) and event.layout in protocol.layouts]
    found = max(exact, key=lambda frame: (frame.quality is Quality.GOOD, len(frame.raw)))
    assert isinstance(found.layout, Layout)
    return found, found.layout


def _by_ctypes(frame: Frame, layout: Layout) -> Callable[[], object]:
    """Read every field with ctypes, the way of the vendors' own clients: a packed struct, copied, then its fields."""
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
    made: Any = type("Made", (base,), {"_pack_": 1, "_fields_": fields})
    reads = [(name, issubclass(type_, ctypes.Array) and type_._type_ is not ctypes.c_char) for name, type_ in fields]
    assert ctypes.sizeof(made) <= layout.size

    def read() -> dict[str, object]:
        got = made.from_buffer_copy(frame.raw, frame.start)
        return {name: list(getattr(got, name)) if is_array else getattr(got, name) for name, is_array in reads}

    return read


def _defaults(protocol: Protocol) -> dict[str, object]:
    options = protocol.options()
    return {name: getattr(options, name) for name in options.__struct_fields__}
