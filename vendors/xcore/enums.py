"""The enumerations of the xCore SDK: their JSON form is the SDK's name, the SDK's number is `number`.

Source: xCore SDK 0.7.1. Numbers do not follow the names' sense (PowerState.on is 0): compare members, never numbers.
"""
# ruff: noqa: N815 - the SDK's names

from __future__ import annotations

from enum import Enum
from typing import Self


class SdkEnum(Enum):
    """An enumeration of the SDK; the value of a member is its name.

    Attributes:
        number: What the SDK counts it as.
    """

    number: int

    def __new__(cls, name: str, number: int = 0) -> Self:
        """Make a member of its name and the SDK's number."""
        member = object.__new__(cls)
        member._value_ = name
        member.number = number
        return member

    @classmethod
    def _missing_(cls, value: object) -> Self | None:
        name = ALIASES.get(cls.__name__, {}).get(value) if isinstance(value, str) else None
        return None if name is None else cls[name]

    @classmethod
    def of_number(cls, number: int) -> Self:
        """Find a member by the SDK's number.

        Raises:
            ValueError: There is none.
        """
        for member in cls:
            if member.number == number:
                return member
        raise ValueError(f"{cls.__name__} has no number {number}")


# Spellings of the vendor's page, by enumeration.
ALIASES: dict[str, dict[str, str]] = {"CartesianPositionOffsetType": {"Offs": "offs", "RelTool": "relTool"}}


class PowerState(SdkEnum):
    """Power of the motors."""

    on = ("on", 0)
    off = ("off", 1)
    estop = ("estop", 2)
    gstop = ("gstop", 3)
    unknown = ("unknown", -1)


class OperateMode(SdkEnum):
    """Operating mode."""

    manual = ("manual", 0)
    automatic = ("automatic", 1)
    unknown = ("unknown", -1)


class OperationState(SdkEnum):
    """What the robot is busy with."""

    idle = ("idle", 0)
    jog = ("jog", 1)
    rtControlling = ("rtControlling", 2)
    drag = ("drag", 3)
    rlProgram = ("rlProgram", 4)
    demo = ("demo", 5)
    dynamicIdentify = ("dynamicIdentify", 6)
    frictionIdentify = ("frictionIdentify", 7)
    loadIdentify = ("loadIdentify", 8)
    moving = ("moving", 9)
    jogging = ("jogging", 10)
    unknown = ("unknown", -1)


class MotionControlMode(SdkEnum):
    """Who commands motion."""

    Idle = ("Idle", 0)
    NrtCommandMode = ("NrtCommandMode", 1)
    NrtRLTask = ("NrtRLTask", 2)
    RtCommandMode = ("RtCommandMode", 3)


class CartesianPositionOffsetType(SdkEnum):
    """What an offset is relative to: nothing, the workpiece, the tool."""

    none = ("none", 0)
    offs = ("offs", 1)
    relTool = ("relTool", 2)


class MoveCFCommandRotType(SdkEnum):
    """How the orientation follows a full circle."""

    constPose = ("constPose", 0)
    rotAxis = ("rotAxis", 1)
    fixedAxis = ("fixedAxis", 2)


class CoordinateType(SdkEnum):
    """Which reference a pose is told in."""

    flangeInBase = ("flangeInBase", 0)
    endInRef = ("endInRef", 1)


class Event(SdkEnum):
    """What may be watched."""

    moveExecution = ("moveExecution", 0)
    safety = ("safety", 1)
    rlExecution = ("rlExecution", 2)
    logReporter = ("logReporter", 3)


class LogInfoLevel(SdkEnum):
    """Level of a log entry; the entry itself does not carry it."""

    info = ("info", 0)
    warning = ("warning", 1)
    error = ("error", 2)


class StopLevel(SdkEnum):
    """How the robot stops."""

    stop0 = ("stop0", 0)
    stop1 = ("stop1", 1)
    stop2 = ("stop2", 2)
    suppleStop = ("suppleStop", 3)


class FrameType(SdkEnum):
    """Which reference."""

    world = ("world", 0)
    base = ("base", 1)
    flange = ("flange", 2)
    tool = ("tool", 3)
    wobj = ("wobj", 4)
    path = ("path", 5)
    rail = ("rail", 6)


class JogOptSpace(SdkEnum):
    """What jogging moves in."""

    world = ("world", 0)
    flange = ("flange", 1)
    baseFrame = ("baseFrame", 2)
    toolFrame = ("toolFrame", 3)
    wobjFrame = ("wobjFrame", 4)
    jointSpace = ("jointSpace", 5)
    singularityAvoidMode = ("singularityAvoidMode", 6)
    baseParallelMode = ("baseParallelMode", 7)


class WorkType(SdkEnum):
    """Kind of robot; it sets the highest speed."""

    industrial = ("industrial", 0)
    collaborative = ("collaborative", 1)


class RtControllerMode(SdkEnum):
    """What a real-time loop controls."""

    jointPosition = ("jointPosition", 0)
    cartesianPosition = ("cartesianPosition", 1)
    jointImpedance = ("jointImpedance", 2)
    cartesianImpedance = ("cartesianImpedance", 3)
    torque = ("torque", 4)


class AvoidSingularityMethod(SdkEnum):
    """How a singularity is passed."""

    lockAxis4 = ("lockAxis4", 0)
    wrist = ("wrist", 1)
    jointWay = ("jointWay", 2)


class DragParameterSpace(SdkEnum):
    """What hand guiding moves in."""

    jointSpace = ("jointSpace", 0)
    cartesianSpace = ("cartesianSpace", 1)


class DragParameterType(SdkEnum):
    """What hand guiding may move."""

    translationOnly = ("translationOnly", 0)
    rotationOnly = ("rotationOnly", 1)
    freely = ("freely", 2)


class xPanelOptVout(SdkEnum):  # noqa: N801 - the SDK's name
    """Voltage at the tool flange."""

    off = ("off", 0)
    reserve = ("reserve", 1)
    supply12v = ("supply12v", 2)
    supply24v = ("supply24v", 3)


ENUMS: dict[str, type[SdkEnum]] = {found.__name__: found for found in SdkEnum.__subclasses__()}
