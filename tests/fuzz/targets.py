"""Every target. A new reader of foreign bytes is one more line here."""

from __future__ import annotations

from gateway.core.registry import Registry
from gateway.testing.conformance import subjects
from tests.fuzz import decoders, doors, files
from tests.fuzz.target import Target


def all_targets() -> dict[str, Target]:
    """The targets by name: those of every protocol and document that the registry finds, of the doors, and of files."""
    registry = Registry()
    found: list[Target] = []
    for name in registry.names():
        found += [decoders.target(subject) for subject in subjects(registry, name)]
        found += [files.document(name, kind) for kind in registry.vendor(name).documents]
    found += [doors.native_json(), doors.native_msgpack(), doors.foxglove(), doors.control()]
    found += [files.config(registry), files.tokens()]
    return {target.name: target for target in found}
