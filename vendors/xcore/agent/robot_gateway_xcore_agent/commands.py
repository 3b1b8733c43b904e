"""The commands of the gateway: what may be read, with which arguments, and what is refused.

The names of the arguments are those of the SDK's own parameters.
"""

from __future__ import annotations

from typing import Any, Callable, Dict, NamedTuple, Tuple

from robot_gateway_xcore_agent import sdk
from robot_gateway_xcore_agent.lines import Members, number, numbers
from robot_gateway_xcore_agent.objects import encode
from robot_gateway_xcore_agent.reader import LEVELS, LOGS_ASKED, POSES, Reader, split, switch
from robot_gateway_xcore_agent.sdk import Answer

RESERVED = frozenset(
    (
        "clearServoAlarm",
        "moveAppend",
        "moveReset",
        "moveStart",
        "setDefaultSpeed",
        "setDefaultZone",
        "setMotionControlMode",
        "setOperateMode",
        "setPowerState",
        "stop",
    )
)
"""Names of the schema that this version refuses."""
MEMBERS = frozenset(("type", "id", "name", "args"))
LONGEST_ID = 256
LONGEST_NAME = 256
"""Characters of an id, and of a register's name."""
MAX_INDEX = 65_535
"""No limit of boards, ports and register indices is documented; this one keeps them inside the SDK's integers."""


class RefusedError(Exception):
    """A command that the agent does not carry out."""

    def __init__(self, error: str, message: str) -> None:
        super().__init__(message)
        self.error = error


Check = Callable[[object], object]


def _whole(low: int, high: int) -> Check:
    def check(value: object) -> object:
        if isinstance(value, bool) or not isinstance(value, int):
            raise RefusedError("bad_request", "must be a whole number")
        if not low <= value <= high:
            raise RefusedError("range", f"must be {low} to {high}")
        return value

    return check


def _name(value: object) -> object:
    if not isinstance(value, str) or not 0 < len(value) <= LONGEST_NAME:
        raise RefusedError("bad_request", f"must be a text of 1 to {LONGEST_NAME} characters")
    return value


def _switch(value: object) -> object:
    if not isinstance(value, bool):
        raise RefusedError("bad_request", "must be true or false")
    return value


def _one_of(*choices: str) -> Check:
    def check(value: object) -> object:
        if not isinstance(value, str) or value not in choices:
            raise RefusedError("bad_request", "must be one of {}".format(", ".join(choices)))
        return value

    return check


def _some_of(*choices: str) -> Check:
    one = _one_of(*choices)

    def check(value: object) -> object:
        if not isinstance(value, list):
            raise RefusedError("bad_request", "must be a list")
        return tuple(dict.fromkeys(str(one(element)) for element in value))

    return check


_REQUIRED = object()


class Argument(NamedTuple):
    """One argument: what it must be, and what it is if it is not given."""

    check: Check
    default: object = _REQUIRED


Args = Dict[str, Any]
Carry = Callable[[Reader, Args], Tuple[Answer, Callable[[Any], object]]]


class Command(NamedTuple):
    """What is called, and how its value is encoded."""

    carry: Carry
    arguments: Dict[str, Argument] = {}  # noqa: RUF012 - a constant


def _reads(encoded: Callable[[Any], object], name: str) -> Command:
    return Command(lambda reader, _args: (reader.call(name), encoded))


def _port(name: str, encoded: Callable[[Any], object]) -> Command:
    index = Argument(_whole(0, MAX_INDEX))
    return Command(
        lambda reader, args: (reader.call(name, args["board"], args["port"]), encoded), {"board": index, "port": index}
    )


def _pose(name: str, encoded: Callable[[Any], object]) -> Command:
    return Command(
        lambda reader, args: (reader.call(name, reader.coordinates(args["ct"])), encoded),
        {"ct": Argument(_one_of(*POSES))},
    )


def _joint_pos(reader: Reader, _args: Args) -> Tuple[Answer, Callable[[Any], object]]:
    if reader.identity.joint_num is None:
        found = reader.identify()
        if not found.ok:
            return found, encode
    joint_num = reader.identity.joint_num or 0
    answer = reader.call("jointPos")
    return answer, lambda values: dict(zip(("joints", "external"), split(values, joint_num)))


def _soft_limit(reader: Reader, _args: Args) -> Tuple[Answer, Callable[[Any], object]]:
    box = reader.module.PyTypeVectorArrayDouble2()
    answer = reader.call("getSoftLimit", box)
    return answer, lambda enabled: {"enabled": switch(enabled), "limits": [numbers(pair) for pair in box.content()]}


_BOXES = {
    ("bool", False): "PyTypeBool",
    ("int", False): "PyTypeInt",
    ("float", False): "PyTypeFloat",
    ("bool", True): "PyTypeVectorBool",
    ("int", True): "PyTypeVectorInt",
    ("float", True): "PyTypeVectorFloat",
}


def _register(reader: Reader, args: Args) -> Tuple[Answer, Callable[[Any], object]]:
    box = getattr(reader.module, _BOXES[args["type"], args["array"]])()
    answer = reader.call("readRegister", args["name"], args["index"], box)
    encoded: Callable[[Any], object] = switch if args["type"] == "bool" else number

    def content(_nothing: object) -> object:
        found = box.content()
        return [encoded(element) for element in found] if args["array"] else encoded(found)

    return answer, content


def _logs(reader: Reader, args: Args) -> Tuple[Answer, Callable[[Any], object]]:
    levels = {sdk.member(reader.module, "LogInfoLevel", level) for level in args["level"]}
    after = (args["offset"],) if args["offset"] else ()
    return reader.call("queryControllerLog", args["count"], levels, after=after), encode


COMMANDS: Dict[str, Command] = {
    "robotInfo": _reads(encode, "robotInfo"),
    "jointPos": Command(_joint_pos),
    "posture": _pose("posture", numbers),
    "cartPosture": _pose("cartPosture", encode),
    "baseFrame": _reads(numbers, "baseFrame"),
    "toolset": _reads(encode, "toolset"),
    "toolsInfo": _reads(encode, "toolsInfo"),
    "wobjsInfo": _reads(encode, "wobjsInfo"),
    "projectsInfo": _reads(encode, "projectsInfo"),
    "getDI": _port("getDI", switch),
    "getDO": _port("getDO", switch),
    "getAI": _port("getAI", number),
    "readRegister": Command(
        _register,
        {
            "name": Argument(_name),
            "index": Argument(_whole(0, MAX_INDEX), 0),
            "type": Argument(_one_of("bool", "int", "float")),
            "array": Argument(_switch, default=False),
        },
    ),
    "getSoftLimit": Command(_soft_limit),
    "getKeypadState": _reads(encode, "getKeypadState"),
    "queryControllerLog": Command(
        _logs,
        {
            "count": Argument(_whole(1, LOGS_ASKED), LOGS_ASKED),
            "level": Argument(_some_of(*LEVELS), ()),
            "offset": Argument(_whole(0, MAX_INDEX), 0),
        },
    ),
}


def checked(message: Members) -> Tuple[str, Command, Args]:
    """Check a command before anything is done.

    Raises:
        RefusedError: It is not what may be asked.
    """
    unknown = sorted(set(message) - MEMBERS)
    if unknown:
        raise RefusedError("bad_request", "unknown members: {}".format(", ".join(unknown)[:200]))
    name, given = message.get("name"), message.get("args", {})
    if not isinstance(name, str):
        raise RefusedError("bad_request", "name must be a text")
    if name in RESERVED:
        raise RefusedError("read_only", "agent is read-only")
    command = COMMANDS.get(name)
    if command is None:
        raise RefusedError("unsupported", "no command of this name")
    if not isinstance(given, dict):
        raise RefusedError("bad_request", "args must be an object")
    unknown = sorted(set(given) - set(command.arguments))
    if unknown:
        raise RefusedError("bad_request", "unknown args: {}".format(", ".join(unknown)[:200]))
    args: Args = {}
    for key, argument in command.arguments.items():
        value = given.get(key, argument.default)
        if value is _REQUIRED:
            raise RefusedError("bad_request", f"args.{key} is missing")
        try:
            args[key] = argument.check(value) if key in given else value
        except RefusedError as error:
            raise RefusedError(error.error, f"args.{key} {error}") from None
    return name, command, args
