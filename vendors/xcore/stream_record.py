"""What the messages of our stream `xcore-objects/1` carry: the table of its state, and the envelopes.

Source: docs/xcore-objects.md. The stream is ours, not ROKAE's; its members have the names of the vendor's SDK.
"""
# ruff: noqa: N815 - the SDK's names

from __future__ import annotations

from typing import Annotated

import msgspec
from msgspec import Meta

from gateway.api.model import Fault
from gateway.api.record import Record, Value
from vendors.xcore.objects import CartesianPosition, KeyPadState, LogInfo, Toolset

SCHEMA = "xcore-objects/1"
LONGEST = 65_536
# The units of version 1; a hello that says others is another language.
UNITS = {
    "length": "m",
    "angle": "rad",
    "speed": "mm/s",
    "zone": "mm",
    "rotSpeed": "rad/s",
    "torque": "Nm",
    "mass": "kg",
    "time": "s",
}
Whole = Annotated[int, Meta(ge=-(2**53), le=2**53)]
Finite = Annotated[float, Meta(ge=-1e9, le=1e9)]
Joints = Annotated[list[Finite], Meta(min_length=3, max_length=7)]
SixValues = Annotated[list[Finite], Meta(min_length=6, max_length=6)]


class Posture(msgspec.Struct, frozen=True):
    """Six values x y z rx ry rz each, in m and rad."""

    flangeInBase: SixValues | None = None
    endInRef: SixValues | None = None


class Execution(msgspec.Struct, frozen=True):
    """What an RL program is doing: the event rlExecution."""

    taskName: str | None = None
    lookaheadLine: Whole | None = None
    lookaheadFile: str | None = None
    executeLine: Whole | None = None
    executeFile: str | None = None


class Entry(msgspec.Struct, frozen=True):
    """An entry of the controller's log with its level."""

    level: str | None
    log: LogInfo


class ReadError(msgspec.Struct, frozen=True):
    """Why a member could not be read."""

    ec: Whole = 0
    message: str = ""


RECORD = Record(
    name=SCHEMA,
    source="docs/xcore-objects.md, version 1; names and units of the vendor's SDK 0.7.1",
    fields=(
        Value(name="ts", type=int, unit="us", meaning="Clock of the agent's machine, since 1970 UTC"),
        Value(name="jointPos", type=Joints, unit="rad", meaning="Joint positions"),
        Value(name="jointVel", type=Joints, unit="rad/s", meaning="Joint velocities"),
        Value(name="jointTorque", type=Joints, unit="Nm", meaning="Joint torques"),
        Value(name="external", type=list[Finite], unit="rad", meaning="External joints; a rail in m"),
        Value(name="posture", type=Posture, meaning="Flange in base, and robot end in the selected reference"),
        Value(name="cartPosture", type=CartesianPosition, meaning="The robot's end in the selected reference"),
        Value(name="powerState", type=str, meaning="on, off, estop, gstop or unknown"),
        Value(name="operateMode", type=str, meaning="manual, automatic or unknown"),
        Value(name="operationState", type=str, meaning="What the robot is busy with: idle, jog, drag, moving …"),
        Value(name="keypad", type=KeyPadState, meaning="Keys at the robot's end"),
        Value(name="di", type=dict[str, bool | None], meaning="Digital inputs by name"),
        Value(name="do", type=dict[str, bool | None], meaning="Digital outputs by name"),
        Value(name="ai", type=dict[str, Finite | None], meaning="Analog inputs by name"),
        Value(name="errors", type=dict[str, ReadError], meaning="Why members could not be read, by member"),
        Value(name="collided", type=bool, meaning="A collision was detected: the event safety"),
        Value(name="rlExecution", type=Execution, meaning="What an RL program is doing: the event rlExecution"),
        Value(name="connected", type=bool, meaning="The SDK is connected to the controller: the event connection"),
        Value(name="log", type=Entry, meaning="The newest entry of the controller's log"),
        Value(name="faults", type=list[Fault], meaning="Entries that stand as faults: see the README", own=True),
        Value(name="toolset", type=Toolset, meaning="Tool, workpiece and load: the result of toolset"),
    ),
)
