"""The only place that calls the vendor's SDK: what may be called is a written list, and nothing on it moves a robot."""

from __future__ import annotations

import importlib
from typing import Any, NamedTuple, Tuple

SDK_MODULE = "xCoreSDK_python"
READING = frozenset(
    (
        "baseFrame",
        "cartPosture",
        "getAI",
        "getDI",
        "getDO",
        "getKeypadState",
        "getSoftLimit",
        "jointPos",
        "jointTorque",
        "jointVel",
        "operateMode",
        "operationState",
        "posture",
        "powerState",
        "projectsInfo",
        "queryControllerLog",
        "readRegister",
        "robotInfo",
        "toolset",
        "toolsInfo",
        "wobjsInfo",
    )
)
"""Calls that read, and do nothing else. All take a dict for the error as their last argument."""
WATCHING = frozenset(("setEventWatcher", "setNoneEventWatcher"))
"""Calls that say who hears of events; the owner's alone. They take the same dict."""
WITHOUT_ERROR = frozenset(("connectToRobot", "sdkVersion", "setConnectionHandler"))
"""Calls without that dict; connectToRobot is the owner's alone, once, and resets the controller's motion buffer."""
LETTING_GO = frozenset(("disconnectFromRobot",))
"""Stops the robot: only with --disconnect-on-exit."""
ALLOWED = READING | WATCHING | WITHOUT_ERROR | LETTING_GO

ROBOT_CLASSES = {
    "xMateRobot": "cobot, 6 axes",
    "xMateErProRobot": "cobot, 7 axes",
    "xMateCr5Robot": "cobot, 5 axes",
    "StandardRobot": "industrial, 6 axes",
    "PCB4Robot": "industrial, 4 axes",
    "PCB3Robot": "industrial, 3 axes",
}
FAILED = -1
"""`ec` of a call that raised instead of filling the dict."""


class NotAllowedError(Exception):
    """A call that is not on the list. A mistake of ours, never of the user's."""


class SdkMissingError(Exception):
    """The SDK is not installed for this Python."""


class Answer(NamedTuple):
    """What one call gave: its value, and the SDK's error number (0 = good) and text."""

    value: Any
    ec: int = 0
    message: str = ""

    @property
    def ok(self) -> bool:
        """Whether the SDK says that it worked."""
        return self.ec == 0


def load() -> Any:
    """Import the SDK.

    Raises:
        SdkMissingError: There is none; the text says what to do.
        Exception: Whatever a broken one raises.
    """
    try:
        return importlib.import_module(SDK_MODULE)
    except ModuleNotFoundError as error:
        if error.name != SDK_MODULE:
            raise
        raise SdkMissingError(
            f"{SDK_MODULE} is not installed for this Python. It is ROKAE's, not ours: get the release for your "
            "controller and Python (3.8 to 3.12) from github.com/RokaeRobot/xCoreSDK-Python, and put the folder that "
            f"holds {SDK_MODULE} on PYTHONPATH"
        ) from None


def call(robot: object, name: str, *args: object, after: Tuple[object, ...] = ()) -> Answer:
    """Call one method of the list with a fresh dict for its error; nothing that the SDK raises gets through.

    Args:
        robot: The SDK's robot.
        name: The method.
        args: What comes before the dict.
        after: What comes after it.

    Raises:
        NotAllowedError: It is not on the list.
    """
    if name not in ALLOWED:
        raise NotAllowedError(name)
    error: dict[str, object] = {}
    try:
        method = getattr(robot, name)
        value = method(*args) if name in WITHOUT_ERROR else method(*args, error, *after)
        ec, message = error.get("ec", 0), error.get("message", "")
        return Answer(value, int(ec) if isinstance(ec, (int, float)) else FAILED, str(message))
    except Exception as raised:  # noqa: BLE001 - the SDK's own, and pybind's TypeErrors
        return Answer(None, FAILED, f"{type(raised).__name__}: {raised}")


def member(sdk: object, enum: str, name: str) -> Any:
    """Find an enumeration's member by name.

    Raises:
        AttributeError: This version of the SDK has none of that name.
    """
    return getattr(getattr(sdk, enum), name)


def code_of(value: object) -> int | None:
    """Read a log number as logReporter gives it: a number, or its text."""
    if isinstance(value, bool):
        return None
    if isinstance(value, int):
        return value
    text = str(value).strip()
    return int(text) if text.lstrip("-").isdigit() and text.isascii() else None
