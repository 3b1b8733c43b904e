"""The objects of the xCore data-structure page that are no commands, with the SDK's names, defaults and ranges.

Source: the vendor's page "Data Structures" (its item numbers are given), lengths and defaults of SDK 0.7.1. Lengths in
m, angles in rad, torque in N·m, mass in kg. JSON: members by these names, enumerations by theirs; a member that has its
default may be left out.
"""
# ruff: noqa: N815 - the SDK's names

from __future__ import annotations

from typing import Annotated

from msgspec import Meta

from vendors.xcore.enums import CartesianPositionOffsetType, OperateMode
from vendors.xcore.rules import AXES, INT, XcoreObject, each_axis, exactly, none_or, one, some, told

Numbers = tuple[float, ...]
Int = Annotated[int, Meta(ge=INT[0], le=INT[1])]
ZERO = (0.0, 0.0, 0.0)


class Info(XcoreObject, frozen=True, kw_only=True):
    """1. What the controller says of itself."""

    id: Annotated[str, told("Uid of the controller.")]
    mac: Annotated[str, told("MAC address; from SDK 0.7.0.")] = ""
    version: Annotated[str, told("Version of the controller.")]
    type: Annotated[str, told("Name of the robot model.")]
    joint_num: Annotated[int, Meta(ge=AXES[0], le=AXES[1], description="Number of axes.")]


class Frame(XcoreObject, frozen=True, kw_only=True):
    """3. A pose."""

    trans: Annotated[Numbers, exactly("m", "Translation x, y, z.", 3)] = ZERO
    rpy: Annotated[Numbers, exactly("rad", "XYZ Euler angles a, b, c.", 3)] = ZERO
    pos: Annotated[Numbers, none_or("1", "Matrix 4x4 by rows; for real-time Cartesian modes only.", 16)] = ()


class CartesianPosition(Frame, frozen=True, kw_only=True):
    """4. A pose that a robot can be in."""

    elbow: Annotated[float, one("rad", "Elbow angle of a seven-axis robot.")] = 0.0
    hasElbow: Annotated[bool, told("The elbow angle counts.")] = False
    confData: Annotated[tuple[Int, ...], none_or("1", "Configuration of the axes: cf1 to cf7, cfx.", 8)] = ()
    external: Annotated[Numbers, some("rad; rail: m", "External joints.")] = ()


class CartesianPositionOffset(XcoreObject, frozen=True, kw_only=True):
    """5. An offset to a target."""

    type: Annotated[CartesianPositionOffsetType, told("What it is relative to.")] = CartesianPositionOffsetType.none
    frame: Annotated[Frame, told("The offset.")] = Frame()


class JointPosition(XcoreObject, frozen=True, kw_only=True):
    """6. The joints of a robot."""

    joints: Annotated[Numbers, each_axis("rad", "Joint angles, base to flange.")]
    external: Annotated[Numbers, some("rad; rail: m", "External joints.")] = ()


class Torque(XcoreObject, frozen=True, kw_only=True):
    """7. Joint torques, without gravity and friction."""

    tau: Annotated[Numbers, each_axis("N·m", "Torques, base to flange.")]


class StateList(XcoreObject, frozen=True, kw_only=True):
    """2, missing on the page: the state in one piece."""

    joint_pos: Annotated[Numbers, each_axis("rad", "Joint angles, base to flange.")]
    cart_pos: Annotated[CartesianPosition, told("Pose of the robot.")] = CartesianPosition()
    digital_signals: Annotated[tuple[tuple[str, bool], ...], told("Name and value of each digital signal.")] = ()
    analog_signals: Annotated[tuple[tuple[str, float], ...], told("Name and value of each analog signal.")] = ()
    operation_mode: Annotated[OperateMode, told("Operating mode.")]
    speed_override: Annotated[float, told("Speed override, as the SDK counts it.")]


class Load(XcoreObject, frozen=True, kw_only=True):
    """8. A load."""

    mass: Annotated[float, one("kg", "Mass.", 0.0)] = 0.0
    cog: Annotated[Numbers, exactly("m", "Centre of gravity x, y, z.", 3)] = ZERO
    inertia: Annotated[Numbers, exactly("kg·m²", "Inertia ix, iy, iz.", 3)] = ZERO


class Toolset(XcoreObject, frozen=True, kw_only=True):
    """9. What a tool, a workpiece, the load and who holds it come to."""

    load: Annotated[Load, told("Load held at the robot's end.")] = Load()
    end: Annotated[Frame, told("Robot's end relative to the flange.")] = Frame()
    ref: Annotated[Frame, told("Robot's reference relative to the world.")] = Frame()


class FrameCalibrationResult(XcoreObject, frozen=True, kw_only=True):
    """10. What a calibration found."""

    frame: Annotated[Frame, told("The calibrated frame.")] = Frame()
    errors: Annotated[Numbers, exactly("m", "Deviation of the sample points: least, mean, greatest.", 3)] = ZERO


class RLProjectInfo(XcoreObject, frozen=True, kw_only=True):
    """11. A project on the controller."""

    name: Annotated[str, told("Name of the project.")]
    taskList: Annotated[tuple[str, ...], told("Names of its tasks.")] = ()


class WorkToolInfo(XcoreObject, frozen=True, kw_only=True):
    """12. A tool or workpiece; the page spells it with a small l: WorkToollnfo."""

    name: Annotated[str, told("Name: g_tool_0 to 15 and g_wobj_0 to 15 are the global ones.")] = ""
    alias: Annotated[str, told("Description; not used yet, says the page.")] = ""
    robotHeld: Annotated[bool, told("The robot holds it.")] = False
    pos: Annotated[Frame, told("Its pose; that of a workpiece is relative to its user frame.")] = Frame()
    load: Annotated[Load, told("Its load.")] = Load()


class LogInfo(XcoreObject, frozen=True, kw_only=True):
    """20. An entry of the controller's log; the page spells it with a small l: Loglnfo."""

    id: Annotated[Int, told("Number of the entry.")]
    timestamp: Annotated[str, told("Date and time, in the controller's words.")] = ""
    content: Annotated[str, told("What happened.")] = ""
    repair: Annotated[str, told("What to do.")] = ""


class KeyPadState(XcoreObject, frozen=True, kw_only=True):
    """21. The keys at the robot's end; CR1 to CR7 are their labels."""

    key1_state: Annotated[bool, told("CR1 is pressed.")] = False
    key2_state: Annotated[bool, told("CR2 is pressed.")] = False
    key3_state: Annotated[bool, told("CR3 is pressed.")] = False
    key4_state: Annotated[bool, told("CR4 is pressed.")] = False
    key5_state: Annotated[bool, told("CR5 is pressed.")] = False
    key6_state: Annotated[bool, told("CR6 is pressed.")] = False
    key7_state: Annotated[bool, told("CR7 is pressed.")] = False


OBJECT_CLASSES: dict[str, type[XcoreObject]] = {
    found.__name__: found
    for found in (
        Info, StateList, Frame, CartesianPosition, CartesianPositionOffset, JointPosition, Torque, Load, Toolset,
        FrameCalibrationResult, RLProjectInfo, WorkToolInfo, LogInfo, KeyPadState,
    )
}  # fmt: skip
