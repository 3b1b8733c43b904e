"""The stand-in for a robot object: it looks like the robot, passes everything on, and says what went by."""

from __future__ import annotations

from typing import Any, Callable, Dict, Optional, Protocol, Tuple, TypeVar

from robot_gateway_xcore_agent.objects import enum_name

RobotT = TypeVar("RobotT")
Method = Callable[..., Any]


class Listener(Protocol):
    """Who is told; nothing that it does may wait or raise."""

    def issued(self, args: Tuple[object, ...], kwargs: Dict[str, object], returned: object) -> None:
        """Hear that commands were appended: the arguments and the value of the call."""

    def happened(self, event: str, args: Tuple[object, ...]) -> None:
        """Hear what a callback is about to be called with."""


def untap(robot: RobotT) -> RobotT:
    """Give the SDK's own object behind a tapped robot, for calls into the SDK that take a robot; others as they are."""
    if not isinstance(robot, Tapped):
        return robot
    found: RobotT = object.__getattribute__(robot, "_xcore_agent_robot")
    return found


def _appending(tapped: Listener, method: Method) -> Method:
    def call(*args: object, **kwargs: object) -> object:
        returned = method(*args, **kwargs)
        tapped.issued(args, kwargs, returned)
        return returned

    return call


def _watching(tapped: Listener, method: Method) -> Method:
    def call(*args: object, **kwargs: object) -> object:
        args, kwargs = _with_callback(tapped, args, kwargs, None)
        return method(*args, **kwargs)

    return call


def _watching_connection(tapped: Listener, method: Method) -> Method:
    def call(*args: object, **kwargs: object) -> object:
        args, kwargs = _with_callback(tapped, args, kwargs, "connection")
        return method(*args, **kwargs)

    return call


def _with_callback(
    tapped: Listener, args: Tuple[object, ...], kwargs: Dict[str, object], event: Optional[str]
) -> Tuple[Tuple[object, ...], Dict[str, object]]:
    """Replace the callback by one that publishes and then calls it; without an event change nothing."""
    try:
        found = event or next(filter(None, map(enum_name, (*args, *kwargs.values()))))

        def wrapped(value: object) -> object:
            return _telling(tapped, found, value) if callable(value) else value

        return tuple(map(wrapped, args)), {key: wrapped(value) for key, value in kwargs.items()}
    except Exception:  # noqa: BLE001 - the application's call goes on as it is
        return args, kwargs


def _telling(tapped: Listener, event: str, callback: Method) -> Method:
    def told(*args: object, **kwargs: object) -> object:
        tapped.happened(event, args)
        return callback(*args, **kwargs)

    return told


_WRAPPED: Dict[str, Callable[[Listener, Method], Method]] = {
    "moveAppend": _appending,
    "executeCommand": _appending,
    "setEventWatcher": _watching,
    "setConnectionHandler": _watching_connection,
}


class Tapped:
    """Passes everything on to the robot."""

    __slots__ = ("__weakref__", "_xcore_agent_robot", "_xcore_agent_tap")

    def __init__(self, robot: object, tapped: Listener) -> None:
        object.__setattr__(self, "_xcore_agent_robot", robot)
        object.__setattr__(self, "_xcore_agent_tap", tapped)

    def __getattribute__(self, name: str) -> Any:
        robot = object.__getattribute__(self, "_xcore_agent_robot")
        found = getattr(robot, name)
        wrap = _WRAPPED.get(name)
        if wrap is None or not callable(found):
            return found
        call = wrap(object.__getattribute__(self, "_xcore_agent_tap"), found)
        call.__name__, call.__doc__ = name, getattr(found, "__doc__", None)
        return call

    def __setattr__(self, name: str, value: object) -> None:
        setattr(object.__getattribute__(self, "_xcore_agent_robot"), name, value)

    def __delattr__(self, name: str) -> None:
        delattr(object.__getattribute__(self, "_xcore_agent_robot"), name)


_SPECIAL = tuple(
    f"__{name}__"
    for name in (
        "repr",
        "str",
        "dir",
        "hash",
        "eq",
        "ne",
        "lt",
        "le",
        "gt",
        "ge",
        "bool",
        "len",
        "iter",
        "contains",
        "getitem",
        "setitem",
        "delitem",
        "call",
        "enter",
        "exit",
        "aenter",
        "aexit",
        "int",
        "float",
        "index",
        "format",
        "reduce",
        "reduce_ex",
    )
)
"""Methods that Python looks up on the class, and not on the object."""


def _passing(name: str) -> Method:
    def special(self: object, *args: object, **kwargs: object) -> object:
        robot = object.__getattribute__(self, "_xcore_agent_robot")
        others = [untap(value) for value in args]
        returned = getattr(type(robot), name)(robot, *others, **kwargs)
        return self if returned is robot else returned

    return special


def proxy_class(robot_class: type) -> Any:
    """Make the stand-in's class: it has the special methods that the robot's class has, and no others."""
    special = {name: _passing(name) for name in _SPECIAL if _has(robot_class, name)}
    return type("Tapped" + robot_class.__name__, (Tapped,), {"__slots__": (), **special})


def _has(robot_class: type, name: str) -> bool:
    return getattr(robot_class, name, None) is not None
