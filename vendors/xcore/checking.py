"""Makes xCore objects of plain JSON data, and says all that is wrong with data that is none.

msgspec makes what is right. What it refuses is read again here, member by member, for the whole list of problems.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import cast

import msgspec

from gateway.api.documents import Problem
from vendors.xcore.commands import COMMAND_CLASSES, FASTEST, MOST_COMMANDS, Command, MoveAbsJCommand, MoveWaitCommand
from vendors.xcore.enums import WorkType
from vendors.xcore.objects import OBJECT_CLASSES, JointPosition, StateList, Torque
from vendors.xcore.reading import Reader, nearest, shown
from vendors.xcore.rules import XcoreObject

CLASSES: dict[str, type[XcoreObject]] = {**OBJECT_CLASSES, **COMMAND_CLASSES}
CLASS = "class"  # the member that names the class of an object where its place does not
_SUFFIX = "Command"
_MISSPELT = {"WorkToollnfo": "WorkToolInfo", "Loglnfo": "LogInfo"}  # as the page has them
_COMMAND_NAMES = {**COMMAND_CLASSES, **{name.removesuffix(_SUFFIX): found for name, found in COMMAND_CLASSES.items()}}
_NAMES: dict[str, type[XcoreObject]] = {
    **CLASSES,
    **_COMMAND_NAMES,
    **{wrong: CLASSES[right] for wrong, right in _MISSPELT.items()},
}


class ObjectError(ValueError):
    """Data is no such object.

    Attributes:
        class_name: What it was to be.
        problems: All that is wrong with it, at least one.
    """

    def __init__(self, class_name: str, problems: Sequence[Problem]) -> None:
        more = f" (and {len(problems) - 1} more)" if len(problems) > 1 else ""
        super().__init__(f"{class_name}: {problems[0]}{more}")
        self.class_name = class_name
        self.problems = tuple(problems)

    @property
    def path(self) -> str:
        """The first member that is wrong: `target.joints[3]`."""
        return self.problems[0].path

    @property
    def found(self) -> str:
        """What stands there, shortened; empty where nothing does."""
        return self.problems[0].found

    @property
    def allowed(self) -> str:
        """What may stand there."""
        return self.problems[0].allowed


def class_named(name: str) -> type[XcoreObject]:
    """Find a class by the SDK's name, with or without "Command", or as the page misspells it.

    Raises:
        ObjectError: There is none of that name; it names the nearest one.
    """
    if name in _NAMES:
        return _NAMES[name]
    raise ObjectError(shown(name), [_unknown(name, CLASSES, _NAMES)])


def command_named(name: str) -> type[Command]:
    """Find a command class by its name, with or without "Command".

    Raises:
        ObjectError: There is none of that name; it names the nearest one.
    """
    if name in _COMMAND_NAMES:
        return _COMMAND_NAMES[name]
    raise ObjectError(shown(name), [_unknown(name, COMMAND_CLASSES, _COMMAND_NAMES)])


def command_of(
    class_name: str,
    value: Mapping[str, object],
    *,
    axes: int | None = None,
    work_type: WorkType | None = None,
) -> Command:
    """Make a command of its members.

    Args:
        class_name: "MoveLCommand", or "MoveL".
        value: Its members as JSON data; unknown ones are refused.
        axes: How many joints the robot has; None: any number that a robot may have.
        work_type: Kind of robot, which sets the highest speed; None: the higher one.

    Raises:
        ObjectError: It is no such command.
    """
    made = _made(command_named(class_name), value, axes=axes, work_type=work_type, lenient=False)
    return cast("Command", made)


def object_of(
    class_name: str,
    value: Mapping[str, object],
    *,
    axes: int | None = None,
    lenient: bool = False,
) -> XcoreObject:
    """Make an object of its members.

    Args:
        class_name: The SDK's name.
        value: Its members as JSON data.
        axes: How many joints the robot has; None: any number that a robot may have.
        lenient: Unknown members are passed over, as in messages of a later agent.

    Raises:
        ObjectError: It is no such object.
    """
    return _made(class_named(class_name), value, axes=axes, work_type=None, lenient=lenient)


def commands_of(
    class_name: str,
    values: Sequence[Mapping[str, object]],
    *,
    axes: int | None = None,
    work_type: WorkType | None = None,
) -> tuple[Command, ...]:
    """Make the commands of one moveAppend.

    Args:
        class_name: The class of all of them.
        values: The members of each; a member `class` may repeat the class.
        axes: How many joints the robot has; None: any number that a robot may have.
        work_type: Kind of robot, which sets the highest speed; None: the higher one.

    Raises:
        ObjectError: They are no such list: its size, or one of them; paths begin with `commands`.
    """
    problems = list_problems_of(class_name, values, axes=axes, work_type=work_type)
    if problems:
        raise ObjectError(class_name, problems)
    plain = [{name: item for name, item in value.items() if name != CLASS} for value in values]
    return tuple(command_of(class_name, value, axes=axes, work_type=work_type) for value in plain)


def problems_of(
    class_name: str,
    value: object,
    *,
    axes: int | None = None,
    work_type: WorkType | None = None,
) -> tuple[Problem, ...]:
    """All that is wrong with an object, commands included; nothing: it can be made.

    Args:
        class_name: The SDK's name.
        value: What is to be its members, as JSON data.
        axes: How many joints the robot has; None: any number that a robot may have.
        work_type: Kind of robot, which sets the highest speed; None: the higher one.
    """
    try:
        wanted = class_named(class_name)
    except ObjectError as error:
        return error.problems
    if isinstance(value, Mapping) and _fast(wanted, value, axes, work_type) is not None:
        return ()
    reader = _reader(axes, work_type, lenient=False)
    reader.read_object(value, wanted, "")
    return reader.problems


def list_problems_of(
    class_name: object,
    values: object,
    *,
    axes: int | None = None,
    work_type: WorkType | None = None,
) -> tuple[Problem, ...]:
    """All that is wrong with the arguments of one moveAppend.

    Args:
        class_name: What is to be the class of all commands.
        values: What is to be the list of them.
        axes: How many joints the robot has; None: any number that a robot may have.
        work_type: Kind of robot, which sets the highest speed; None: the higher one.
    """
    problems = list(list_size_problems(class_name, values))
    if isinstance(class_name, str) and class_name in _COMMAND_NAMES and isinstance(values, Sequence):
        for index, value in enumerate(values[:MOST_COMMANDS]):
            path = f"commands[{index}]"
            for found in element_problems(class_name, value, axes=axes, work_type=work_type):
                place = f"{path}.{found.path}" if found.path else path
                problems.append(Problem(place, found.message, found.found, found.allowed))
    return tuple(problems)


def list_size_problems(class_name: object, values: object) -> tuple[Problem, ...]:
    """What is wrong with the class and the size of a list for moveAppend, whatever its commands are."""
    problems = []
    if not isinstance(class_name, str):
        allowed = "the name of a command class"
        problems.append(Problem(CLASS, f"{shown(class_name)} is not {allowed}", shown(class_name), allowed))
    elif class_name not in _COMMAND_NAMES:
        problems.append(_unknown(class_name, COMMAND_CLASSES, _COMMAND_NAMES))
    if not isinstance(values, Sequence) or isinstance(values, str | bytes):
        allowed = "an array of commands"
        problems.append(Problem("commands", f"{shown(values)} is not {allowed}", shown(values), allowed))
        return tuple(problems)
    alone = isinstance(class_name, str) and _COMMAND_NAMES.get(class_name) is MoveWaitCommand
    allowed = "1 command, because MoveWait stands alone" if alone else f"1 to {MOST_COMMANDS} commands"
    if not values:
        problems.append(Problem("commands", f"is empty; allowed: {allowed}", "an empty array", allowed))
    elif len(values) > (1 if alone else MOST_COMMANDS):
        problems.append(
            Problem("commands", f"has {len(values)} commands; allowed: {allowed}", f"{len(values)}", allowed)
        )
    return tuple(problems)


def element_problems(
    class_name: str,
    value: object,
    *,
    axes: int | None = None,
    work_type: WorkType | None = None,
) -> tuple[Problem, ...]:
    """All that is wrong with one command of a list whose class is known; its member `class` may repeat that class."""
    if not isinstance(value, Mapping) or CLASS not in value:
        return problems_of(class_name, value, axes=axes, work_type=work_type)
    own = value[CLASS]
    rest = {name: item for name, item in value.items() if name != CLASS}
    problems = problems_of(class_name, rest, axes=axes, work_type=work_type)
    if isinstance(own, str) and _COMMAND_NAMES.get(own) is _COMMAND_NAMES[class_name]:
        return problems
    allowed = f'"{class_name}", the one class of this list'
    return (Problem(CLASS, f"{shown(own)} is not {allowed}", shown(own), allowed), *problems)


def _made(
    wanted: type[XcoreObject],
    value: Mapping[str, object],
    *,
    axes: int | None,
    work_type: WorkType | None,
    lenient: bool,
) -> XcoreObject:
    made = _fast(wanted, value, axes, work_type)
    if made is not None:
        return made
    reader = _reader(axes, work_type, lenient=lenient)
    # What is only spelt in another way is right now: 1.0 for a whole number, members that a lenient reader leaves out.
    again = reader.read_object(value, wanted, "")
    if reader.problems:
        raise ObjectError(wanted.__name__, reader.problems)
    return msgspec.convert(again, wanted)


def _fast(
    wanted: type[XcoreObject],
    value: Mapping[str, object],
    axes: int | None,
    work_type: WorkType | None,
) -> XcoreObject | None:
    """Make what is right at once; None where that has to be looked at."""
    try:
        made = msgspec.convert(value, wanted)
    except (msgspec.ValidationError, UnicodeEncodeError):
        return None
    if axes is not None and _n_joints(made) not in {None, axes}:
        return None
    if work_type is not None and getattr(made, "speed", 0.0) > FASTEST[work_type]:
        return None
    return made


def _n_joints(made: XcoreObject) -> int | None:
    match made:
        case MoveAbsJCommand(target=JointPosition(joints=joints)) | JointPosition(joints=joints):
            return len(joints)
        case Torque(tau=joints) | StateList(joint_pos=joints):
            return len(joints)
        case _:
            return None


def _reader(axes: int | None, work_type: WorkType | None, *, lenient: bool) -> Reader:
    return Reader(axes=axes, top_speed=None if work_type is None else FASTEST[work_type], lenient=lenient)


def _unknown(name: str, known: Mapping[str, object], accepted: Mapping[str, object]) -> Problem:
    meant = nearest(name, [word for word in accepted if word not in _MISSPELT])
    says = f'did you mean "{meant}"?' if meant else f"known are {', '.join(known)}"
    return Problem(CLASS, f"{shown(name)} is no known class; {says}", shown(name), f"one of {', '.join(known)}")
