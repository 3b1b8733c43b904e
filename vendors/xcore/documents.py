"""Files of motion commands, checked before anything is moved: `robot-gateway validate xcore FILE`.

A file is a JSON array of commands that each have a `class`, the arguments of a moveAppend ({"class", "commands"}), an
array of such, or one of these in each line. What a command may hold stands in `commands`; here is what a file may.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from itertools import islice
from typing import Annotated, Literal, TypeGuard, cast

import msgspec
from msgspec import Meta

from gateway.api.documents import Checked, DocumentType, Problem, Row
from vendors.xcore.checking import CLASS, ObjectError, command_named, element_problems
from vendors.xcore.commands import COMMAND_CLASSES, MOST_COMMANDS, MoveAbsJCommand, MoveWaitCommand
from vendors.xcore.encoding import DIALECT, Json, definitions
from vendors.xcore.enums import WorkType
from vendors.xcore.files import LIST_MEMBER, CommandFile, Part, repeated
from vendors.xcore.reading import MOST_PROBLEMS, joined, shortened, shown
from vendors.xcore.rules import AXES, DEFAULT

COLUMNS = ("no.", "type", "target", "speed", "zone")
_NONE = "-"
_DEFAULT = "default"
_MOST = 16  # numbers of a target that are shown
_LARGEST = 1e15  # one that is shown
_SUFFIX = "Command"


class CommandOptions(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What is known of the robot that the commands are for."""

    axes: Annotated[
        Annotated[int, Meta(ge=AXES[0], le=AXES[1])] | None,
        Meta(description="Number of axes of the robot, 3 to 7; without it all commands must agree."),
    ] = None
    work_type: Annotated[
        Literal["collaborative", "industrial"], Meta(description="Kind of robot: it sets the highest speed.")
    ] = "collaborative"


def check_commands(data: bytes, options: msgspec.Struct) -> Checked:
    """Check a file of motion commands.

    Args:
        data: The file.
        options: A `CommandOptions`.
    """
    if not isinstance(options, CommandOptions):
        raise TypeError(f"{type(options).__name__} is no CommandOptions")
    file = CommandFile(data)
    return Checked(tuple(_rows(file.parts, options)), tuple(file.problems))


def schema() -> Json:
    """The JSON Schema (2020-12) of a file; of one in lines, that of each line."""
    found = definitions()
    names = list(COMMAND_CLASSES)
    lists: list[Json] = []
    for name in names:
        words = [name, name.removesuffix(_SUFFIX)]
        plain = cast("Json", found[name])
        members = {CLASS: {"enum": words}, **cast("Json", plain["properties"])}
        required = [CLASS, *cast("list[str]", plain.get("required", []))]
        found[f"{name}WithClass"] = {**plain, "properties": members, "required": required}
        once = {**members, CLASS: {"enum": words, "description": "Need not be repeated here."}}
        element = {**plain, "properties": once}
        most = 1 if COMMAND_CLASSES[name] is MoveWaitCommand else MOST_COMMANDS
        commands = {"type": "array", "items": element, "minItems": 1, "maxItems": most}
        lists.append(_object({CLASS: {"enum": words}, LIST_MEMBER: commands}))
    found["Command"] = {"anyOf": [{"$ref": f"#/$defs/{name}WithClass"} for name in names]}
    found["MoveAppend"] = {"anyOf": lists}
    one: Json = {"anyOf": [{"$ref": "#/$defs/Command"}, {"$ref": "#/$defs/MoveAppend"}]}
    return {
        "$schema": DIALECT,
        "title": "Motion commands",
        "anyOf": [one, {"type": "array", "items": one, "minItems": 1}],
        "$defs": found,
    }


def _object(members: Json) -> Json:
    return {"type": "object", "properties": members, "required": list(members), "additionalProperties": False}


def _rows(parts: Sequence[Part], options: CommandOptions) -> Iterator[Row]:
    """Check each command, and that all are for one number of axes."""
    work_type = WorkType(options.work_type)
    first: tuple[str, int] | None = None  # the command that sets the number of axes
    for part in parts:
        name, problems = _checked(part, options.axes, work_type)
        joints = _joints(name, part.value)
        if options.axes is None and joints is not None:
            first = first or (part.number, joints)
            if joints != first[1]:
                says = f"has {joints} elements; command {first[0]} has {first[1]}, and all are for one robot"
                problems = (*problems, Problem("target.joints", says, f"{joints} elements", f"{first[1]} elements"))
        yield Row(_cells(part, name), problems)


def _checked(part: Part, axes: int | None, work_type: WorkType) -> tuple[str, tuple[Problem, ...]]:
    """Check one command: the name of its class, as far as that is known, and all that is wrong."""
    twice = tuple(islice(_twice(part.value), MOST_PROBLEMS))
    name = part.class_name
    if name is None:
        if not isinstance(part.value, Mapping):
            found = shown(part.value)
            return _NONE, (Problem("", f"{found} is not a command object", found, "an object"), *twice)
        allowed = "the name of a command class"
        if CLASS not in part.value:
            return _NONE, (Problem(CLASS, f"is missing; it is {allowed}", "", allowed), *twice)
        own = part.value[CLASS]
        if not isinstance(own, str):
            return _NONE, (Problem(CLASS, f"{shown(own)} is not {allowed}", shown(own), allowed), *twice)
        name = own
    try:
        plain = command_named(name).__name__
    except ObjectError as error:
        # That of a list is told once, for the list.
        return shortened(name), (*(() if part.class_name else error.problems), *twice)
    return plain, (*element_problems(name, part.value, axes=axes, work_type=work_type), *twice)


def _twice(value: object) -> Iterator[Problem]:
    """The members that stand twice in a command, at whatever depth."""
    waiting: list[tuple[str, object]] = [("", value)]
    while waiting:
        path, found = waiting.pop()
        if isinstance(found, dict):
            for name in repeated(found):
                yield Problem(joined(path, name), "is there twice")
            waiting += [(joined(path, name), one) for name, one in found.items() if isinstance(one, dict | list)]
        elif isinstance(found, list):
            waiting += [(f"{path}[{index}]", one) for index, one in enumerate(found) if isinstance(one, dict | list)]


def _joints(name: str, value: object) -> int | None:
    """How many joints a command names, where a robot may have so many."""
    if name != MoveAbsJCommand.__name__:
        return None
    joints = _at(value, "target", "joints")
    return len(joints) if isinstance(joints, list) and AXES[0] <= len(joints) <= AXES[1] else None


def _cells(part: Part, name: str) -> tuple[str, ...]:
    """What a command is recognised by, also where it is wrong."""
    kind = name.removesuffix(_SUFFIX)
    if name == MoveWaitCommand.__name__:
        duration = _at(part.value, "duration_")
        return part.number, kind, f"{_number(duration)} s" if _is_number(duration) else _NONE, _NONE, _NONE
    return part.number, kind, _target(part.value), _setting(part.value, "speed"), _setting(part.value, "zone")


def _target(value: object) -> str:
    joints, trans, rpy = (_at(value, "target", name) for name in ("joints", "trans", "rpy"))
    if _are_numbers(joints):
        degrees = " ".join(f"{math.degrees(one):.0f}" for one in joints)
        return f"{' '.join(map(_number, joints))} rad ({degrees} deg)"
    both = ((trans, "m"), (rpy, "rad"))
    parts = [f"{' '.join(map(_number, found))} {unit}" for found, unit in both if _are_numbers(found)]
    return ", ".join(parts) or _NONE


def _setting(value: object, name: str) -> str:
    found = _at(value, name)
    if not isinstance(value, Mapping):
        return _NONE
    if name not in value or (_is_number(found) and found == DEFAULT):
        return _DEFAULT
    return _number(found) if _is_number(found) else shown(found)


def _at(value: object, *path: str) -> object:
    for name in path:
        value = value.get(name) if isinstance(value, Mapping) else None
    return value


def _number(value: float) -> str:
    return f"{value:.5g}" if isinstance(value, float) else str(value)


def _is_number(value: object) -> TypeGuard[float]:
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < _LARGEST


def _are_numbers(value: object) -> TypeGuard[list[float]]:
    return isinstance(value, list) and 0 < len(value) <= _MOST and all(map(_is_number, value))


COMMANDS = DocumentType(
    name="commands",
    title="Motion commands, or moveAppend arguments, as JSON or JSON lines",
    noun="command object",
    columns=COLUMNS,
    check=check_commands,
    options=CommandOptions,
    schema=schema,
)
