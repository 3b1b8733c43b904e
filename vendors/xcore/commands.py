"""The motion commands of the xCore data-structure page, items 13 to 19: only ever read and checked, never sent.

Speed in mm/s, zone in mm, as the SDK has them; everything else in m, rad and s.
"""
# ruff: noqa: N815 - the SDK's names

from __future__ import annotations

from typing import Annotated

from vendors.xcore.enums import MoveCFCommandRotType, WorkType
from vendors.xcore.objects import CartesianPosition, CartesianPositionOffset, JointPosition
from vendors.xcore.rules import DEFAULT, XcoreObject, either, one, told

SLOWEST = 5.0  # mm/s
FASTEST = {WorkType.collaborative: 4000.0, WorkType.industrial: 7000.0}  # mm/s
SHORTEST_WAIT = 0.001  # s
MOST_COMMANDS = 100  # of one moveAppend

_NO_OFFSET = CartesianPositionOffset()
_SPEED = either(
    "mm/s",
    "Speed of the robot's end, at most 4000 for a collaborative robot.",
    SLOWEST,
    FASTEST[WorkType.industrial],
    speed=True,
)
_JOINT_SPEED = either("1", "Joint speed as a part of the highest; it counts where it is not -1.", 0, 1)
_ROT_SPEED = either("rad/s", "Speed of rotation.", 0)
_TARGET = told("Where to.")
_OFFSET = told("Offset to the target.")
_AUX_OFFSET = told("Offset to the auxiliary point.")


class NrtCommand(XcoreObject, frozen=True, kw_only=True):
    """What every move has."""

    speed: Annotated[float, _SPEED] = DEFAULT
    zone: Annotated[float, either("mm", "Zone around the target in which the next move may begin.", 0, 200)] = DEFAULT
    customInfo: Annotated[str, told("Returned in the events of the move.")] = ""


class MoveAbsJCommand(NrtCommand, frozen=True, kw_only=True):
    """13. Move to joint angles."""

    target: Annotated[JointPosition, _TARGET]
    jointSpeed: Annotated[float, _JOINT_SPEED] = DEFAULT


class MoveJCommand(NrtCommand, frozen=True, kw_only=True):
    """14. Move to a pose, joint by joint."""

    target: Annotated[CartesianPosition, _TARGET]
    offset: Annotated[CartesianPositionOffset, _OFFSET] = _NO_OFFSET
    jointSpeed: Annotated[float, _JOINT_SPEED] = DEFAULT


class MoveLCommand(NrtCommand, frozen=True, kw_only=True):
    """15. Move in a straight line."""

    target: Annotated[CartesianPosition, _TARGET]
    offset: Annotated[CartesianPositionOffset, _OFFSET] = _NO_OFFSET
    rotSpeed: Annotated[float, _ROT_SPEED] = DEFAULT


class MoveCCommand(NrtCommand, frozen=True, kw_only=True):
    """16. Move along an arc."""

    target: Annotated[CartesianPosition, _TARGET]
    aux: Annotated[CartesianPosition, told("A point of the arc.")]
    targetOffset: Annotated[CartesianPositionOffset, _OFFSET] = _NO_OFFSET
    auxOffset: Annotated[CartesianPositionOffset, _AUX_OFFSET] = _NO_OFFSET
    rotSpeed: Annotated[float, _ROT_SPEED] = DEFAULT


class MoveCFCommand(NrtCommand, frozen=True, kw_only=True):
    """17. Move along a full circle."""

    target: Annotated[CartesianPosition, told("A point of the circle.")]
    aux: Annotated[CartesianPosition, told("Another point of the circle.")]
    targetOffset: Annotated[CartesianPositionOffset, _OFFSET] = _NO_OFFSET
    auxOffset: Annotated[CartesianPositionOffset, _AUX_OFFSET] = _NO_OFFSET
    rotSpeed: Annotated[float, _ROT_SPEED] = DEFAULT
    angle: Annotated[float, one("rad", "How much of the circle to run.")] = 0.0
    rotType: Annotated[MoveCFCommandRotType, told("How the orientation follows.")] = MoveCFCommandRotType.constPose


class MoveSPCommand(NrtCommand, frozen=True, kw_only=True):
    """18. Move along a spiral."""

    target: Annotated[CartesianPosition, told("Where to; only its rpy is used.")]
    targetOffset: Annotated[CartesianPositionOffset, _OFFSET] = _NO_OFFSET
    radius: Annotated[float, one("m", "Radius at the start.")] = 0.0
    radius_step: Annotated[float, one("m/rad", "What the radius changes by.")] = 0.0
    angle: Annotated[float, one("rad", "How much to turn in all.")] = 0.0
    direction: Annotated[bool, told("Clockwise. Must be given.")]
    rotSpeed: Annotated[float, _ROT_SPEED] = DEFAULT


class MoveWaitCommand(XcoreObject, frozen=True, kw_only=True):
    """19. Wait; it stands alone in its moveAppend."""

    duration_: Annotated[float, one("s", "How long.", SHORTEST_WAIT)]


Command = MoveAbsJCommand | MoveJCommand | MoveLCommand | MoveCCommand | MoveCFCommand | MoveSPCommand | MoveWaitCommand
COMMAND_CLASSES: dict[str, type[Command]] = {
    "MoveAbsJCommand": MoveAbsJCommand,
    "MoveJCommand": MoveJCommand,
    "MoveLCommand": MoveLCommand,
    "MoveCCommand": MoveCCommand,
    "MoveCFCommand": MoveCFCommand,
    "MoveSPCommand": MoveSPCommand,
    "MoveWaitCommand": MoveWaitCommand,
}
