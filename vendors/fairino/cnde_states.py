"""What CNDE is asked for by name, and the layout that follows from the types that the controller returns.

The returned types are the truth; the vendor's table only says which fields hold a state, and is compared.
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import lru_cache

from gateway.api.layout import TYPES, Field, Layout
from vendors.fairino.layouts import CNDE_FIELDS, CNDE_STATES, LONGEST, STATES, State

HEADER = 6  # 5A 5A, count, type, length (u16)
TAIL = b"\xa5\xa5"
MOST_DATA = 4096
# One datagram of this size is not cut into fragments on any usual network.
MOST_UDP = 1400

ALL_STATES = {state.name: state for state in (*STATES, *CNDE_STATES)}
_TABLE = {field.name: field for field in (*LONGEST.fields, *CNDE_FIELDS)}
_SOURCE = "fr_documentation, CNDE introduction; the types are those that the controller returned"

_WIRE_TYPES = {"UINT8": "u8", "INT32": "i32", "UINT32": "u32", "UINT64": "u64", "DOUBLE": "f64"}
_WIRE_TYPE = re.compile(r"(UINT8|INT32|UINT64|DOUBLE)(?:_([1-9][0-9]{0,3}))?|(UINT32)", re.ASCII)

# The legacy table has the length one byte earlier.
_HEADER_FIELDS = (
    _TABLE["frame_head"],
    _TABLE["frame_cnt"],
    dataclasses.replace(_TABLE["data_len"], offset=4, meaning="Data length: total frame length minus 8"),
)


@dataclass(frozen=True, slots=True)
class Wire:
    """A type as the controller writes it.

    Args:
        type: A key of `gateway.api.layout.TYPES`.
        count: Elements; None for a scalar.
    """

    type: str
    count: int | None

    @property
    def elements(self) -> int:
        """How many elements it has."""
        return 1 if self.count is None else self.count

    @property
    def size(self) -> int:
        """Bytes on the wire."""
        return self.elements * TYPES[self.type][2]


def parse_type(text: str) -> Wire | None:
    """Read a wire type such as `DOUBLE_6`; None where it is none that is known."""
    found = _WIRE_TYPE.fullmatch(text)
    if found is None:
        return None
    return Wire(_WIRE_TYPES[found[1] or found[3]], int(found[2]) if found[2] else None)


def payload_size(states: Iterable[State]) -> int:
    """Bytes of the values of some states, by the vendor's types."""
    return sum(wire.size for wire in (parse_type(state.type) for state in states) if wire)


def fitting(*preferred: Iterable[str], most: int = MOST_UDP) -> tuple[str, ...]:
    """Choose states whose configuration and data frame have at most so many bytes each.

    Args:
        preferred: Names of fields that are wanted before all others, the most wanted first.
        most: Bytes of a frame, header and tail included.
    """
    ranks = {name: rank for rank, names in reversed(list(enumerate(preferred))) for name in names}
    ranked = sorted(
        ALL_STATES.values(), key=lambda state: min(ranks.get(name, len(preferred)) for name in state.fields)
    )
    chosen: set[str] = set()
    names = values = 0
    around = HEADER + len(TAIL)
    for state in ranked:
        more_names, more_values = names + len(state.name) + bool(chosen), values + payload_size([state])
        if around + 2 + more_names <= most and around + more_values <= most:
            chosen.add(state.name)
            names, values = more_names, more_values
    return tuple(name for name in ALL_STATES if name in chosen)


@dataclass(frozen=True, slots=True)
class Granted:
    """A configuration that the controller has accepted.

    Attributes:
        layout: Explains the data frames, from their first byte on.
        notes: What differs from the vendor's table, for the operator.
    """

    layout: Layout
    notes: tuple[str, ...]

    @property
    def frame_size(self) -> int:
        """Bytes of a whole data frame."""
        return self.layout.size + len(TAIL)


@lru_cache(maxsize=16)
def granted(names: tuple[str, ...], types: tuple[str, ...]) -> Granted:
    """Make the layout of a configuration; robots with the same share it.

    Fields of states that are not configured stay in the table and read as null.

    Args:
        names: The states, in configured order.
        types: The types that the controller returned for them; all are known.

    Raises:
        ValueError: A type is not known, or the data frame would be larger than the protocol allows.
    """
    fields = list(_HEADER_FIELDS)
    differing, left_out = [], []
    at = HEADER
    for name, text in zip(names, types, strict=True):
        wire = parse_type(text)
        if wire is None:
            raise ValueError(f"{name}: type {text!r} is unknown")
        state = ALL_STATES.get(name)
        found = _unlisted(name, wire, at) if state is None else _placed(state, wire, at)
        if found is None:
            left_out.append(f"{name} ({text})")
        elif state is not None and state.type != text:
            differing.append(f"{name} ({text}, not {state.type})")
        fields += found or []
        at += wire.size
    if at - HEADER > MOST_DATA:
        raise ValueError(f"data frames would carry {at - HEADER} bytes: more than {MOST_DATA}")
    name = f"{len(names)} states, {at + len(TAIL)} bytes"
    layout = Layout(name=name, size=at, fields=(*fields, *_absent(fields, at)), source=_SOURCE)
    notes = []
    if differing:
        notes.append(f"types that differ from the vendor's table: {', '.join(differing)}")
    if left_out:
        notes.append(f"left out, their types do not fit their fields: {', '.join(left_out)}")
    return Granted(layout, tuple(notes))


def _absent(fields: Iterable[Field], at: int) -> Iterator[Field]:
    """The fields that the frame does not carry, behind those that it does."""
    here = {field.name for field in fields}
    for row in _TABLE.values():
        if row.name not in here:
            yield dataclasses.replace(row, offset=at, present=0)
            at += row.elements * row.item_size


def _placed(state: State, wire: Wire, at: int) -> list[Field] | None:
    """The fields that hold a state, where they stand in the frame; None where the type does not fit them."""
    rows = [_TABLE[name] for name in state.fields]
    if state.packed:
        first = rows[0].offset
        if wire.type != "u8" or wire.size != rows[-1].end - first:
            return None
        return [dataclasses.replace(row, offset=at + row.offset - first) for row in rows]
    unlike = wire.type == "f64" and not state.type.startswith("DOUBLE")  # what reads its bits cannot take a float
    if unlike or wire.elements != sum(row.elements for row in rows):
        return None
    found = []
    for row in rows:
        found.append(dataclasses.replace(row, type=wire.type, offset=at))
        at = found[-1].end
    return found


def _unlisted(name: str, wire: Wire, at: int) -> list[Field]:
    """The field of a state that the tables do not list, such as an output register: under the name it was asked by."""
    meaning = "A state that the configuration asks for; the vendor's table does not list it"
    return [Field(name=name, offset=at, type=wire.type, count=wire.count, meaning=meaning)]


def name_fault(name: str) -> str | None:
    """Say why a name cannot be asked for; None if it can."""
    if re.fullmatch(r"[A-Za-z][A-Za-z0-9_]{0,63}", name, re.ASCII) is None:
        return f"{name!r} is no name of a state"
    if name in _TABLE and name not in ALL_STATES:
        owner = next((state.name for state in ALL_STATES.values() if name in state.fields), None)
        return f"{name!r} is a field of the state {owner!r}" if owner else f"{name!r} is no state"
    return None
