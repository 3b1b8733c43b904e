"""The virtual agent's results: a reading command is answered, any other refused; each exactly once.

Names of arguments are those of the SDK's own parameters.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple

from gateway.sim.scenario import RobotState
from vendors.xcore.encoding import Json, to_builtins
from vendors.xcore.enums import CoordinateType, LogInfoLevel
from vendors.xcore.objects import Frame, Info, Load, RLProjectInfo, Toolset, WorkToolInfo
from vendors.xcore.simulator import telling
from vendors.xcore.simulator.application import Application
from vendors.xcore.simulator.options import XcoreOptions
from vendors.xcore.simulator.state import cart_posture, inputs, keypad, outputs, pressure

RESERVED = frozenset(
    {
        "setOperateMode", "setPowerState", "setMotionControlMode", "setDefaultSpeed", "setDefaultZone",
        "moveReset", "moveAppend", "moveStart", "stop", "clearServoAlarm",
    }
)  # fmt: skip
NO_SUCH = -2  # the virtual SDK's number for what the controller does not have
_MEMBERS = frozenset({"type", "id", "name", "args"})
_LONGEST_ID = 256
_MOST_LOGS = 10
_HIGHEST = 65_535
_BASE = [0.0] * 6
_LIMIT = 3.0
_LEVELS = tuple(level.value for level in LogInfoLevel)
_TOOLS = (
    WorkToolInfo(name="tool0", robotHeld=True),
    WorkToolInfo(name="g_tool_0", robotHeld=True, load=Load(mass=1.2)),
)
_WOBJS = (WorkToolInfo(name="wobj0"), WorkToolInfo(name="g_wobj_0", pos=Frame(trans=(0.4, -0.2, 0.1))))
_REGISTERS: Mapping[str, list[bool] | list[int] | list[float]] = {
    "virtual_ready": [True, False, True, False],
    "virtual_count": [3, 1, 4, 1],
    "virtual_level": [2.5, 0.75, 0.5, 0.25],
}
_REGISTER_TYPES: Mapping[str, type] = {"bool": bool, "int": int, "float": float}


class Refusal(Exception):  # noqa: N818 - what happened to a command is its name
    """A command is not carried out.

    Args:
        error: The agent's word; empty where the virtual SDK failed.
        message: What is wrong.
    """

    def __init__(self, error: str, message: str) -> None:
        super().__init__(message)
        self.error = error


class Asked(NamedTuple):
    """What a command is answered from: its arguments are checked."""

    args: Mapping[str, object]
    state: RobotState
    options: XcoreOptions
    info: Info
    application: Application


Check = Callable[[object], object]


class Results:
    """Makes the results of commands.

    Args:
        info: What the controller says of itself.
        options: Of the simulator.
        application: Knows the controller's log.
    """

    def __init__(self, info: Info, options: XcoreOptions, application: Application) -> None:
        self._info = info
        self._options = options
        self._application = application

    def answer(self, message: Mapping[str, object], state: RobotState) -> Json:
        """The members of the result of a message of type `command`."""
        name = message.get("id")
        if not isinstance(name, str) or len(name) > _LONGEST_ID:
            return _refused("", Refusal("bad_request", f"id must be a text of at most {_LONGEST_ID} characters"))
        try:
            command, args = _checked(message)
            value = command.read(Asked(args, state, self._options, self._info, self._application))
        except Refusal as refusal:
            return _refused(name, refusal)
        return {"id": name, "ok": True, "ec": 0, "message": "", "value": value}


def _refused(name: str, refusal: Refusal) -> Json:
    if not refusal.error:
        return {"id": name, "ok": False, "ec": NO_SUCH, "message": str(refusal)}
    return {"id": name, "ok": False, "ec": 0, "message": str(refusal), "error": refusal.error}


def _checked(message: Mapping[str, object]) -> tuple[_Command, Mapping[str, object]]:
    unknown = sorted(set(message) - _MEMBERS)
    if unknown:
        raise Refusal("bad_request", f"unknown members: {', '.join(unknown)[:200]}")
    name, given = message.get("name"), message.get("args", {})
    if not isinstance(name, str):
        raise Refusal("bad_request", "name must be a text")
    if name in RESERVED:
        raise Refusal("read_only", "agent is read-only")
    command = _COMMANDS.get(name)
    if command is None:
        raise Refusal("unsupported", "no command of this name")
    if not isinstance(given, dict):
        raise Refusal("bad_request", "args must be an object")
    unknown = sorted(set(given) - set(command.arguments))
    if unknown:
        raise Refusal("bad_request", f"unknown args: {', '.join(unknown)[:200]}")
    return command, {key: _argument(key, argument, given) for key, argument in command.arguments.items()}


def _argument(key: str, argument: _Argument, given: Mapping[str, object]) -> object:
    if key not in given:
        if argument.default is None:
            raise Refusal("bad_request", f"args.{key} is missing")
        return argument.default
    try:
        return argument.check(given[key])
    except Refusal as refusal:
        raise Refusal(refusal.error, f"args.{key} {refusal}") from None


class _Argument(NamedTuple):
    """What an argument must be, and what it is where it is not given; None: it must be given."""

    check: Check
    default: object = None


class _Command(NamedTuple):
    """How a value is read, and what may be asked."""

    read: Callable[[Asked], object]
    arguments: Mapping[str, _Argument] = {}


def _whole(low: int, high: int) -> Check:
    def check(value: object) -> object:
        if isinstance(value, bool) or not isinstance(value, int):
            raise Refusal("bad_request", "must be a whole number")
        if not low <= value <= high:
            raise Refusal("range", f"must be {low} to {high}")
        return value

    return check


def _one_of(*words: str) -> Check:
    def check(value: object) -> object:
        if not isinstance(value, str) or value not in words:
            raise Refusal("bad_request", f"must be one of {', '.join(words)}")
        return value

    return check


def _levels(value: object) -> object:
    if not isinstance(value, list):
        raise Refusal("bad_request", "must be a list")
    return frozenset(map(_one_of(*_LEVELS), value)) or frozenset(_LEVELS)


def _text(value: object) -> object:
    if not isinstance(value, str) or not 0 < len(value) <= _LONGEST_ID:
        raise Refusal("bad_request", f"must be a text of 1 to {_LONGEST_ID} characters")
    return value


def _switch(value: object) -> object:
    if not isinstance(value, bool):
        raise Refusal("bad_request", "must be true or false")
    return value


def _number(args: Mapping[str, object], key: str) -> int:
    value = args[key]
    return value if isinstance(value, int) else 0


def _port_of(read: Callable[[RobotState], tuple[bool | float, ...]]) -> Callable[[Asked], object]:
    def found(asked: Asked) -> object:
        board, port = _number(asked.args, "board"), _number(asked.args, "port")
        values = read(asked.state)
        if board or port >= len(values):
            raise Refusal("", f"the virtual controller has no port {port} on board {board}")
        return values[port]

    return found


def _register(asked: Asked) -> object:
    name, wanted = str(asked.args["name"]), str(asked.args["type"])
    index = _number(asked.args, "index")
    values = _REGISTERS.get(name)
    if values is None or type(values[0]) is not _REGISTER_TYPES[wanted] or index >= len(values):
        raise Refusal("", f"the virtual controller has no register {name}[{index}] of type {wanted}")
    return values if asked.args["array"] else values[index]


def _logs(asked: Asked) -> object:
    levels = asked.args["level"]
    chosen = levels if isinstance(levels, frozenset) else frozenset(_LEVELS)
    return asked.application.logs(chosen, _number(asked.args, "count"), _number(asked.args, "offset"))


_POSE = {"ct": _Argument(_one_of(*(one.value for one in CoordinateType)))}
_PORT = {"board": _Argument(_whole(0, _HIGHEST)), "port": _Argument(_whole(0, _HIGHEST))}
_COMMANDS: Mapping[str, _Command] = {
    "robotInfo": _Command(lambda asked: to_builtins(asked.info)),
    "jointPos": _Command(
        lambda asked: {
            "joints": telling.joints(asked.state, asked.options),
            "external": telling.extras(asked.options),
        }
    ),
    "posture": _Command(lambda asked: telling.pose(asked.state), _POSE),
    "cartPosture": _Command(lambda asked: to_builtins(cart_posture(asked.state, asked.options)), _POSE),
    "baseFrame": _Command(lambda _asked: _BASE),
    "toolset": _Command(lambda _asked: to_builtins(Toolset())),
    "toolsInfo": _Command(lambda _asked: [to_builtins(tool) for tool in _TOOLS]),
    "wobjsInfo": _Command(lambda _asked: [to_builtins(wobj) for wobj in _WOBJS]),
    "projectsInfo": _Command(
        lambda _asked: [
            to_builtins(RLProjectInfo(name=name, taskList=tasks)) for name, tasks in telling.PROJECTS.items()
        ]
    ),
    "getDI": _Command(_port_of(inputs), _PORT),
    "getDO": _Command(_port_of(outputs), _PORT),
    "getAI": _Command(_port_of(lambda state: (pressure(state),)), _PORT),
    "readRegister": _Command(
        _register,
        {
            "name": _Argument(_text),
            "index": _Argument(_whole(0, _HIGHEST), 0),
            "type": _Argument(_one_of(*_REGISTER_TYPES)),
            "array": _Argument(_switch, default=False),
        },
    ),
    "getSoftLimit": _Command(lambda asked: {"enabled": True, "limits": [[-_LIMIT, _LIMIT]] * asked.options.axes}),
    "getKeypadState": _Command(lambda asked: to_builtins(keypad(asked.state))),
    "queryControllerLog": _Command(
        _logs,
        {
            "count": _Argument(_whole(1, _MOST_LOGS), _MOST_LOGS),
            "level": _Argument(_levels, frozenset(_LEVELS)),
            "offset": _Argument(_whole(0, _HIGHEST), 0),
        },
    ),
}
