"""Edges: events found once, in one place, in the canonical state of a robot.

Only live frames are compared. What changed while the link was lost is an edge as soon as it is seen again. The first
value ever seen is none, for nothing is known to have changed, but for what nobody may miss: a pressed emergency stop, a
detected collision, a fault. Where frames bring the state in parts, a null whose parts have not come yet says nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import dataclass
from fnmatch import fnmatchcase

import msgspec

from gateway.api.model import EventKind, Fault, Io, Motion, Program, ProgramState, Safety, Status

_MOVES = {Motion.MOVING, Motion.HAND_GUIDING, Motion.EXTERNAL_CONTROL, Motion.JOGGING}
_RESTS = {Motion.STANDSTILL, Motion.HOLD}
_ACTIVE = {ProgramState.RUNNING, ProgramState.PAUSED}
_ENDED = {ProgramState.NONE, ProgramState.LOADED, ProgramState.STOPPED, ProgramState.ERROR}


@dataclass(frozen=True, slots=True)
class Edge:
    """One change, before the ring has named it.

    Args:
        kind: What happened.
        key: The canonical key that changed.
        before: Its value before; None: unknown.
        after: Its value after.
    """

    kind: EventKind
    key: str
    before: object
    after: object


Rule = Callable[[object, object], EventKind | None]


def _changed(kind: EventKind) -> Rule:
    return lambda _before, _after: kind


def _switched(on: EventKind, off: EventKind) -> Rule:
    return lambda before, after: on if after else off if before else None


def _motion(before: object, after: object) -> EventKind | None:
    if after in _MOVES and before not in _MOVES:
        return EventKind.MOTION_STARTED
    return EventKind.MOTION_STOPPED if after in _RESTS and before in _MOVES else None


def _program(before: object, after: object) -> EventKind | None:
    if after == ProgramState.RUNNING:
        return EventKind.PROGRAM_STARTED
    if after == ProgramState.PAUSED:
        return EventKind.PROGRAM_PAUSED
    return EventKind.PROGRAM_STOPPED if after in _ENDED and before in _ACTIVE else None


# canonical key -> which event its change is, if any
_RULES: dict[str, Rule] = {
    "status.operating_mode": _changed(EventKind.MODE_CHANGED),
    "status.power": _changed(EventKind.POWER_CHANGED),
    "status.motion": _motion,
    "status.program.state": _program,
    "status.e_stopped": _switched(EventKind.ESTOP_PRESSED, EventKind.ESTOP_RELEASED),
    "safety.state": _changed(EventKind.SAFETY_CHANGED),
    "safety.collision": _switched(EventKind.COLLISION_DETECTED, EventKind.COLLISION_CLEARED),
    "safety.self_collision": _switched(EventKind.COLLISION_DETECTED, EventKind.COLLISION_CLEARED),
}

# The keys that are compared.
EDGE_KEYS = (*_RULES, "status.faults")

# Keys whose null is told as a change; of the others it says that nobody knows, and the last known value stays.
_NULL_IS_NEWS = {"status.operating_mode", "status.power", "safety.state"}
_AT_FIRST_SIGHT = {EventKind.ESTOP_PRESSED, EventKind.COLLISION_DETECTED}


class EdgeFinder:
    """Finds the edges of one robot and remembers since when its faults stand.

    Args:
        io_events: Globs of the inputs and outputs whose changes are edges: `digital_in.box.3`, `digital_out.*`. Each
            part between dots is matched by itself; what is left out at the end is everything below.
    """

    def __init__(self, io_events: Sequence[str] = ()) -> None:
        self._io_globs = [glob.split(".") for glob in io_events]
        self._io_wanted: dict[str, bool] = {}  # by name
        self._io_known: dict[str, bool] = {}
        self._known: dict[str, object] = {}
        self._faults_unsure = False
        self._unsure: set[str] = set()  # keys that were null since their known value
        self._faults: dict[tuple[object, ...], Fault] = {}

    @property
    def faults(self) -> Sequence[Fault]:
        """The faults that stand, with the time since when."""
        return tuple(self._faults.values())

    def know(self, faults: Sequence[Fault]) -> None:
        """These faults stood before the first status that is observed."""
        self._faults = {fault.key: fault for fault in faults}

    def observe_safety(self, safety: Safety, untold: AbstractSet[str] = frozenset()) -> list[Edge]:
        """Compare the safety group with what was known.

        Args:
            safety: As normalised.
            untold: Keys whose null says nothing: what they follow from has not all come in this session.
        """
        return self._compare(
            {
                "safety.state": safety.state,
                "safety.collision": safety.collision,
                "safety.self_collision": safety.self_collision,
            },
            untold,
        )

    def observe_io(self, io: Io) -> list[Edge]:
        """Compare the configured inputs and outputs with what was known; null: the last known level stays."""
        edges = []
        for key, name, level in _levels(io) if self._io_globs else ():
            if level is None or not self._wants(name):
                continue
            before = self._io_known.get(name)
            self._io_known[name] = level
            if before is not None and before is not level:
                edges.append(Edge(EventKind.IO_CHANGED, key, {name: before}, {name: level}))
        return edges

    def stamped(self, status: Status) -> Status:
        """The status whose known faults say since when they stand."""
        if not status.faults:
            return status
        return msgspec.structs.replace(status, faults=[self._faults.get(fault.key, fault) for fault in status.faults])

    def observe_status(
        self, status: Status, t: int, untold: AbstractSet[str] = frozenset()
    ) -> tuple[Status, list[Edge]]:
        """Compare the status group with what was known, and stamp its faults.

        Args:
            status: As normalised.
            t: Receive time, µs UTC.
            untold: Keys whose null says nothing: what they follow from has not all come in this session.

        Returns:
            The status whose faults say `since` when they stand, and the edges.
        """
        program = status.program or Program()
        edges = self._compare(
            {
                "status.operating_mode": status.operating_mode,
                "status.power": status.power,
                "status.motion": status.motion,
                "status.program.state": program.state,
                "status.e_stopped": status.e_stopped,
            },
            untold,
        )
        if status.faults is None:
            # What stands then may be another fault of the same name.
            self._faults_unsure = self._faults_unsure or "status.faults" not in untold
            return status, edges
        unsure, self._faults_unsure = self._faults_unsure, False
        present: dict[tuple[object, ...], Fault] = {}
        for fault in status.faults:
            known = None if unsure else self._faults.get(fault.key)
            stamped = msgspec.structs.replace(fault, since=known.since if known else t)
            present[fault.key] = stamped
            if known is None:
                edges.append(Edge(EventKind.FAULT_RAISED, "status.faults", None, stamped))
        edges += [
            Edge(EventKind.FAULT_CLEARED, "status.faults", fault, None)
            for key, fault in self._faults.items()
            if key not in present
        ]
        self._faults = present
        return msgspec.structs.replace(status, faults=list(present.values())), edges

    def _wants(self, name: str) -> bool:
        found = self._io_wanted.get(name)
        if found is None:
            parts = name.split(".")
            found = self._io_wanted[name] = any(
                all(fnmatchcase(part, one) for part, one in zip(parts, glob, strict=False)) for glob in self._io_globs
            )
        return found

    def _compare(self, values: dict[str, object], untold: AbstractSet[str]) -> list[Edge]:
        edges = []
        for key, after in values.items():
            if after is None and key in untold:
                continue
            if after is None and not (key in _NULL_IS_NEWS and key in self._known):
                self._unsure.add(key)
                continue
            first = key not in self._known
            unsure = key in self._unsure
            before = self._known.get(key)
            self._known[key] = after
            self._unsure.discard(key)
            if after == before and unsure:  # between the two nobody knows what it was
                kind = _RULES[key](None, after)
                edges += [Edge(kind, key, None, after)] if kind in _AT_FIRST_SIGHT else []
            elif after != before:
                kind = _RULES[key](before, after)
                if kind is not None and (not first or kind in _AT_FIRST_SIGHT):
                    edges.append(Edge(kind, key, before, after))
        return edges


def _levels(io: Io) -> Iterator[tuple[str, str, bool | None]]:
    """Every input and output: the key of its bank, its name such as `digital_in.box.3`, and its level."""
    for side in ("digital_in", "digital_out"):
        banks: dict[str, list[bool | None] | None] = getattr(io, side) or {}
        for bank, levels in banks.items():
            for number, level in enumerate(levels or ()):
                yield f"io.{side}.{bank}", f"{side}.{bank}.{number}", level
