"""The lists of command objects that the virtual application appends: encoded once, numbered when they are sent.

Each list is of one class, in turn; its targets go on along the closed path of the motion.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import msgspec

from gateway.sim import motion
from vendors.xcore.commands import (
    Command,
    MoveAbsJCommand,
    MoveCCommand,
    MoveCFCommand,
    MoveJCommand,
    MoveLCommand,
    MoveSPCommand,
    MoveWaitCommand,
)
from vendors.xcore.encoding import to_builtins
from vendors.xcore.enums import CartesianPositionOffsetType, MoveCFCommandRotType
from vendors.xcore.objects import CartesianPosition, CartesianPositionOffset, Frame, JointPosition

POINTS = 60
_MARK = "<number>"
_LIFT = CartesianPositionOffset(type=CartesianPositionOffsetType.offs, frame=Frame(trans=(0.0, 0.0, 0.05)))
_RETRACT = CartesianPositionOffset(type=CartesianPositionOffsetType.relTool, frame=Frame(trans=(0.0, 0.0, -0.02)))


def info(number: int) -> str:
    """What the customInfo of the command of a running number says."""
    return f"n-{number}"


@dataclass(frozen=True, slots=True)
class Kind:
    """A class of commands, encoded for each point of the path.

    Args:
        name: Of the class.
        parts: What stands before and behind the number in the customInfo, by point; no number for a MoveWait.
        moves: Whether it moves the robot, so that feedback comes; it may stand in a list with others then.
    """

    name: str
    parts: tuple[tuple[bytes, bytes], ...]
    moves: bool

    def body(self, list_number: int, first: int, size: int) -> bytes:
        """Return the members of an `issued`: cmdID, class and commands, as JSON without braces.

        Args:
            list_number: The running number of the list.
            first: The running number of its first command.
            size: How many commands.
        """
        chosen = ((number, *self.parts[number % POINTS]) for number in range(first, first + size))
        if self.moves:
            commands = b",".join(b"%b%d%b" % (before, number, behind) for number, before, behind in chosen)
        else:
            commands = b",".join(before for _, before, _ in chosen)
        return b'"cmdID":"cmd-%d","class":"%b","commands":[%b]' % (list_number, self.name.encode(), commands)


@cache
def kinds(axes: int) -> tuple[Kind, ...]:
    """Every class in its turn, for a robot of so many axes."""
    return tuple(_kind(make, axes) for make in _MAKERS)


def _kind(make: Callable[[int, int], Command], axes: int) -> Kind:
    commands = [make(point, axes) for point in range(POINTS)]
    parts = []
    for command in commands:
        encoded = msgspec.json.encode(to_builtins(command, omit_defaults=True))
        before, _, behind = encoded.partition(_MARK.encode())
        parts.append((before, behind))
    return Kind(type(commands[0]).__name__, tuple(parts), not isinstance(commands[0], MoveWaitCommand))


def _joints(point: int, axes: int) -> JointPosition:
    angles, _ = motion.target(point % POINTS * motion.CYCLE_S / POINTS, 1.0)
    return JointPosition(joints=(*angles, *(0.0,) * (axes - len(angles))))


def _pose(point: int, axes: int) -> CartesianPosition:
    angles, speeds = motion.target(point % POINTS * motion.CYCLE_S / POINTS, 1.0)
    there = motion.forward(angles, speeds)
    return CartesianPosition(trans=there.position, rpy=there.rpy, hasElbow=axes > len(angles))


def _custom() -> str:
    return info(0).replace("0", _MARK)


def _move_abs_j(point: int, axes: int) -> MoveAbsJCommand:
    return MoveAbsJCommand(target=_joints(point, axes), jointSpeed=0.3, zone=10.0, customInfo=_custom())


def _move_j(point: int, axes: int) -> MoveJCommand:
    offset = _LIFT if point % 2 else CartesianPositionOffset()
    return MoveJCommand(target=_pose(point, axes), offset=offset, speed=500.0, zone=20.0, customInfo=_custom())


def _move_l(point: int, axes: int) -> MoveLCommand:
    offset = _RETRACT if point % 2 else CartesianPositionOffset()
    return MoveLCommand(
        target=_pose(point, axes), offset=offset, speed=200.0 + point, zone=5.0, rotSpeed=1.5, customInfo=_custom()
    )


def _move_c(point: int, axes: int) -> MoveCCommand:
    return MoveCCommand(
        target=_pose(point + 2, axes), aux=_pose(point + 1, axes), auxOffset=_LIFT, speed=150.0, customInfo=_custom()
    )


def _move_cf(point: int, axes: int) -> MoveCFCommand:
    return MoveCFCommand(
        target=_pose(point + 2, axes),
        aux=_pose(point + 1, axes),
        angle=math.tau,
        rotType=tuple(MoveCFCommandRotType)[point % len(MoveCFCommandRotType)],
        speed=100.0,
        customInfo=_custom(),
    )


def _move_sp(point: int, axes: int) -> MoveSPCommand:
    return MoveSPCommand(
        target=_pose(point, axes),
        radius=0.01,
        radius_step=0.002,
        angle=2 * math.tau,
        direction=bool(point % 2),
        speed=80.0,
        customInfo=_custom(),
    )


def _move_wait(point: int, _axes: int) -> MoveWaitCommand:
    return MoveWaitCommand(duration_=0.1 + 0.01 * point)


_MAKERS: tuple[Callable[[int, int], Command], ...] = (
    _move_abs_j,
    _move_j,
    _move_l,
    _move_c,
    _move_cf,
    _move_sp,
    _move_wait,
)
