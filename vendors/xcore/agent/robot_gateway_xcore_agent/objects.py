"""The SDK's objects as tables, and how they become JSON: attribute names stay, enumerations become their names.

An object is read in two steps, because the tap reads on the application's thread and writes on its own: `snapshot`
copies the attributes of one object, and only that; `Snapshot.encoded` makes JSON of the copies, later and elsewhere.
"""

from __future__ import annotations

import datetime as dt
import operator
from typing import Any, Callable, Dict, Iterator, List, NamedTuple, Optional, Tuple

from robot_gateway_xcore_agent.lines import Members, number, numbers

REQUIRED = object()
"""The default of a field that has none: it is always written."""


class Field(NamedTuple):
    """One attribute: its name, a kind of `KINDS` or the class of the object that it holds, and its default.

    An object whose default is not `REQUIRED` may be left out when all its members have theirs.
    """

    name: str
    kind: str
    default: object = REQUIRED


_FRAME = (Field("trans", "numbers", [0, 0, 0]), Field("rpy", "numbers", [0, 0, 0]), Field("pos", "numbers", [0] * 16))
_NRT = (Field("speed", "number", -1), Field("zone", "number", -1), Field("customInfo", "str", ""))
_ROT = Field("rotSpeed", "number", -1)
_JOINT_SPEED = Field("jointSpeed", "number", -1)
_TARGET = Field("target", "CartesianPosition")
_OFFSET = Field("offset", "CartesianPositionOffset", None)
_TARGET_OFFSET = Field("targetOffset", "CartesianPositionOffset", None)
_AUX_OFFSET = Field("auxOffset", "CartesianPositionOffset", None)
_ARC = (_TARGET, Field("aux", "CartesianPosition"), _TARGET_OFFSET, _AUX_OFFSET, _ROT)
_WORK = (Field("name", "str"), Field("alias", "str", ""), Field("robotHeld", "bool"))

OBJECTS: Dict[str, Tuple[Field, ...]] = {
    "Info": (
        Field("id", "str"),
        Field("mac", "str"),
        Field("version", "str"),
        Field("type", "str"),
        Field("joint_num", "int"),
    ),
    "Frame": _FRAME,
    "CartesianPosition": (
        *_FRAME,
        Field("elbow", "number", 0),
        Field("hasElbow", "bool", False),  # noqa: FBT003 - a table
        Field("confData", "ints", []),
        Field("external", "numbers", []),
    ),
    "CartesianPositionOffset": (Field("type", "enum", "none"), Field("frame", "Frame")),
    "JointPosition": (Field("joints", "numbers"), Field("external", "numbers", [])),
    "Torque": (Field("tau", "numbers"),),
    "Load": (
        Field("mass", "number", 0),
        Field("cog", "numbers", [0, 0, 0]),
        Field("inertia", "numbers", [0, 0, 0]),
    ),
    "Toolset": (Field("load", "Load"), Field("end", "Frame"), Field("ref", "Frame")),
    "RLProjectInfo": (Field("name", "str"), Field("taskList", "strs")),
    "WorkToolInfo": (*_WORK, Field("pos", "Frame"), Field("load", "Load")),
    "MoveAbsJCommand": (Field("target", "JointPosition"), *_NRT, _JOINT_SPEED),
    "MoveJCommand": (_TARGET, *_NRT, _OFFSET, _JOINT_SPEED),
    "MoveLCommand": (_TARGET, *_NRT, _OFFSET, _ROT),
    "MoveCCommand": (*_ARC, *_NRT),
    "MoveCFCommand": (*_ARC, *_NRT, Field("angle", "number", 0), Field("rotType", "enum", "constPose")),
    "MoveSPCommand": (
        _TARGET,
        *_NRT,
        _TARGET_OFFSET,
        Field("radius", "number", 0),
        Field("radius_step", "number", 0),
        Field("angle", "number", 0),
        Field("direction", "bool"),
        _ROT,
    ),
    "MoveWaitCommand": (Field("duration_", "seconds"),),
    "LogInfo": (Field("id", "int"), Field("timestamp", "str"), Field("content", "str"), Field("repair", "str")),
    "KeyPadState": tuple(Field(f"key{key}_state", "bool") for key in range(1, 8)),
}
"""Source: ROKAE's data-structure page, with the corrections of the SDK's own names; lengths m, angles rad."""
COMMANDS = frozenset(name for name in OBJECTS if name.startswith("Move"))
"""The classes that moveAppend and executeCommand take."""
MISSPELT = {"WorkToollnfo": "WorkToolInfo", "Loglnfo": "LogInfo"}
"""Names that the page prints with the letter l for I."""
WRITTEN_WHEN_SET = "pos"
"""A frame's matrix is zero unless a real-time mode fills it: zeros are no matrix."""


class UnknownClassError(TypeError):
    """An object is of no class that the tables know."""


def enum_name(value: object) -> Optional[str]:
    """Give an enumeration's name; null if it has none."""
    if isinstance(value, str):
        return value
    name = getattr(value, "name", None)
    return name if isinstance(name, str) else None


def seconds(value: object) -> Optional[float]:
    """Give a duration in s; null if it is none."""
    return value.total_seconds() if isinstance(value, dt.timedelta) else number(value)


def whole(value: object) -> Optional[int]:
    """Give a whole number, also one that came as a float; null if it is none."""
    found = number(value)
    return int(found) if found is not None and found == int(found) else None


def _wholes(value: object) -> Optional[List[Optional[int]]]:
    found = numbers(value)
    return None if found is None else [whole(element) for element in found]


def _text(value: object) -> Optional[str]:
    return value if isinstance(value, str) else None


def _texts(value: object) -> Optional[List[Optional[str]]]:
    return [_text(element) for element in value] if isinstance(value, (list, tuple)) else None


def _flag(value: object) -> Optional[bool]:
    return value if isinstance(value, bool) else None


KINDS: Dict[str, Callable[[object], object]] = {
    "number": number,
    "numbers": numbers,
    "int": whole,
    "ints": _wholes,
    "str": _text,
    "strs": _texts,
    "bool": _flag,
    "enum": enum_name,
    "seconds": seconds,
}

_IMMUTABLE = frozenset((int, float, str, bool, type(None), dt.timedelta, tuple))


def _copied(value: object) -> object:
    """Copy what the application could change later: lists of any kind. Everything else in a field is immutable."""
    if type(value) in _IMMUTABLE:
        return value
    if type(value) is list:
        return value[:]
    try:
        return list(value)  # type: ignore[call-overload]  # arrays, bound vectors
    except TypeError:
        return value  # an enumeration


class Leaf(NamedTuple):
    """One attribute that holds no further object: where it stands, and whether its place is written even if empty."""

    path: Tuple[str, ...]
    field: Field
    place_required: bool


class Snapshot(NamedTuple):
    """One object's attributes as they were."""

    name: str
    leaves: Tuple[Leaf, ...]
    values: List[object]

    def encoded(self, *, omit_defaults: bool = False) -> Members:
        """Make the JSON object; with `omit_defaults` members that say nothing new are left out."""
        members: Members = {}
        for leaf, value in zip(self.leaves, self.values):
            field = leaf.field
            encoded = KINDS[field.kind](value)
            omitted = (omit_defaults or field.name == WRITTEN_WHEN_SET) and encoded == field.default
            if omitted and not leaf.place_required:
                continue
            place = members
            for step in leaf.path:
                place = place.setdefault(step, {})
            if not omitted:
                place[field.name] = encoded
        return members


class _Plan(NamedTuple):
    name: str
    leaves: Tuple[Leaf, ...]
    read: Callable[[object], Tuple[object, ...]]


_plans: Dict[type, _Plan] = {}


def class_name(value: object) -> str:
    """Find the SDK's name for an object's class; an application's subclass counts as its base.

    Raises:
        UnknownClassError: The tables have none of its classes.
    """
    for cls in type(value).__mro__:
        name = MISSPELT.get(cls.__name__, cls.__name__)
        if name in OBJECTS:
            return name
    raise UnknownClassError(type(value).__name__)


def _leaves(name: str, path: Tuple[str, ...] = (), *, required: bool = True) -> Iterator[Leaf]:
    for field in OBJECTS[name]:
        if field.kind in KINDS:
            yield Leaf(path, field, required)
        else:
            yield from _leaves(field.kind, (*path, field.name), required=required and field.default is REQUIRED)


def _planned(value: object) -> _Plan:
    """List the attributes that this object has: SDK versions differ, and not every documented one is readable."""
    name = class_name(value)
    leaves = []
    paths = []
    for leaf in _leaves(name):
        dotted = ".".join((*leaf.path, leaf.field.name))
        try:
            operator.attrgetter(dotted)(value)
        except AttributeError:
            continue
        leaves.append(leaf)
        paths.append(dotted)
    if not paths:
        raise UnknownClassError(type(value).__name__)
    getter = operator.attrgetter(*paths)
    if len(paths) > 1:
        return _Plan(name, tuple(leaves), getter)
    return _Plan(name, tuple(leaves), lambda value: (getter(value),))


def snapshot(value: object) -> Snapshot:
    """Copy an object's attributes; cheap, nothing is converted.

    Raises:
        UnknownClassError: The tables do not know its class.
        Exception: Whatever reading an attribute raises.
    """
    plan = _plans.get(type(value))
    if plan is None:
        plan = _plans[type(value)] = _planned(value)
    try:
        values = plan.read(value)
    except AttributeError:
        plan = _planned(value)  # this one lacks what the first of its class had
        values = plan.read(value)
    return Snapshot(plan.name, plan.leaves, [_copied(found) for found in values])


def encode(value: object) -> Any:
    """Encode one object, or a list of objects, with all members."""
    if value is None:
        return None
    if isinstance(value, (list, tuple)):
        return [encode(element) for element in value]
    return snapshot(value).encoded()
