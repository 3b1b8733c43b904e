"""The canonical model: what every robot is told in, whatever its vendor.

SI units (m, rad, s, kg, N, N·m, A, V, K); poses are a position and a unit quaternion (x, y, z, w); arrays are ordered
from base to flange. Every leaf may be null, and null means "this source cannot tell": it is never 0, and 0 is never
null. For information only; not for functional safety (IEC 61508).
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Annotated, Literal

import msgspec
from msgspec import Meta

SAFETY_NOTICE = "For information only; not for functional safety (IEC 61508)."

Array = list[float | None]
Bits = list[bool | None]


def _in(unit: str, text: str) -> Meta:
    """Describe a leaf that has a unit."""
    return Meta(description=text, extra_json_schema={"unit": unit})


def _is(text: str) -> Meta:
    """Describe a leaf without a unit."""
    return Meta(description=text)


class Quality(StrEnum):
    """How far a sample may be trusted; the worst reason wins, in the order of `QUALITY_RANK`."""

    GOOD = "GOOD"
    SUBSTITUTED = "SUBSTITUTED"
    UNCERTAIN = "UNCERTAIN"
    BAD = "BAD"
    STALE = "STALE"
    DISCONNECTED = "DISCONNECTED"


QUALITY_RANK = {quality: rank for rank, quality in enumerate(Quality)}


def worst(*qualities: Quality) -> Quality:
    """The worst of some qualities."""
    return max(qualities, key=QUALITY_RANK.__getitem__)


class OperatingMode(StrEnum):
    """Operating mode in the words of OPC 40010 and ISO 10218."""

    UNKNOWN = "UNKNOWN"
    MANUAL = "MANUAL"
    MANUAL_REDUCED_SPEED = "MANUAL_REDUCED_SPEED"
    MANUAL_HIGH_SPEED = "MANUAL_HIGH_SPEED"
    AUTOMATIC = "AUTOMATIC"
    AUTOMATIC_EXTERNAL = "AUTOMATIC_EXTERNAL"
    OTHER = "OTHER"


class Power(StrEnum):
    """How far the arm is powered up."""

    UNKNOWN = "UNKNOWN"
    OFF = "OFF"
    BOOTING = "BOOTING"
    POWERED = "POWERED"
    ENABLED = "ENABLED"
    FAULT = "FAULT"


class Motion(StrEnum):
    """What the arm is doing."""

    UNKNOWN = "UNKNOWN"
    STANDSTILL = "STANDSTILL"
    MOVING = "MOVING"
    HOLD = "HOLD"
    HAND_GUIDING = "HAND_GUIDING"
    EXTERNAL_CONTROL = "EXTERNAL_CONTROL"
    JOGGING = "JOGGING"


class ProgramState(StrEnum):
    """What the robot program is doing."""

    UNKNOWN = "UNKNOWN"
    NONE = "NONE"
    LOADED = "LOADED"
    RUNNING = "RUNNING"
    PAUSED = "PAUSED"
    STOPPED = "STOPPED"
    ERROR = "ERROR"


class SafetyState(StrEnum):
    """What the controller says of its safety system, for information only."""

    UNKNOWN = "UNKNOWN"
    NORMAL = "NORMAL"
    REDUCED = "REDUCED"
    PROTECTIVE_STOP = "PROTECTIVE_STOP"
    SAFEGUARD_STOP = "SAFEGUARD_STOP"
    EMERGENCY_STOP = "EMERGENCY_STOP"
    RECOVERY = "RECOVERY"
    VIOLATION = "VIOLATION"
    FAULT = "FAULT"


class FunctionKind(StrEnum):
    """Kind of a safety function or input."""

    ESTOP = "estop"
    PROTECTIVE = "protective"
    SAFEGUARD = "safeguard"
    ENABLING = "enabling"
    COLLISION = "collision"
    LIMIT = "limit"


class LinkState(StrEnum):
    """State of the lasting association with a robot."""

    DISCONNECTED = "DISCONNECTED"
    CONNECTING = "CONNECTING"
    HANDSHAKING = "HANDSHAKING"
    ONLINE = "ONLINE"
    STALE = "STALE"
    INCOMPATIBLE = "INCOMPATIBLE"
    REFUSED = "REFUSED"
    FAULTED = "FAULTED"


class Severity(StrEnum):
    """Severity of a fault, where the vendor gives one."""

    INFO = "INFO"
    WARNING = "WARNING"
    ERROR = "ERROR"
    FATAL = "FATAL"


class Pose(msgspec.Struct, frozen=True):
    """A pose of one reference in another."""

    position: Annotated[Array | None, _in("m", "x, y, z; shape (3,).")] = None
    orientation: Annotated[
        Array | None,
        _in("1", "Unit quaternion (x, y, z, w), w >= 0; shape (4,). Null where the rotation is not known."),
    ] = None


class Joints(msgspec.Struct, frozen=True):
    """Joint values, base to flange; an array is null where the source has no such value."""

    position: Annotated[Array | None, _in("rad", "Measured position.")] = None
    velocity: Annotated[Array | None, _in("rad/s", "Measured velocity.")] = None
    acceleration: Annotated[Array | None, _in("rad/s²", "Measured acceleration.")] = None
    effort: Annotated[Array | None, _in("N·m", "Measured torque.")] = None
    current: Annotated[Array | None, _in("A", "Measured motor current.")] = None
    temperature: Annotated[Array | None, _in("K", "Measured temperature.")] = None
    target_position: Annotated[Array | None, _in("rad", "Commanded position.")] = None
    target_velocity: Annotated[Array | None, _in("rad/s", "Commanded velocity.")] = None
    target_acceleration: Annotated[Array | None, _in("rad/s²", "Commanded acceleration.")] = None
    target_effort: Annotated[Array | None, _in("N·m", "Commanded torque.")] = None
    target_current: Annotated[Array | None, _in("A", "Commanded motor current.")] = None
    external_position: Annotated[Array | None, _in("rad", "Measured position of the external axes.")] = None
    external_target_position: Annotated[Array | None, _in("rad", "Commanded position of the external axes.")] = None


class Tcp(msgspec.Struct, frozen=True):
    """Tool centre point, in the base reference."""

    pose: Annotated[Pose | None, _is("Pose of the tool centre point.")] = None
    target_pose: Annotated[Pose | None, _is("Commanded pose.")] = None
    flange_pose: Annotated[Pose | None, _is("Pose of the flange.")] = None
    twist: Annotated[Array | None, _in("m/s, rad/s", "Linear then angular velocity; shape (6,).")] = None
    target_twist: Annotated[Array | None, _in("m/s, rad/s", "Commanded linear then angular velocity; shape (6,).")] = (
        None
    )
    speed: Annotated[float | None, _in("m/s", "Magnitude of the linear velocity.")] = None
    elbow: Annotated[float | None, _in("rad", "Elbow angle of a seven-axis arm.")] = None
    substituted: Annotated[list[str], _is("Keys whose value is a commanded one, shown as measured.")] = []


class Wrench(msgspec.Struct, frozen=True):
    """Force and torque at the tool."""

    force: Annotated[Array | None, _in("N", "x, y, z; shape (3,).")] = None
    torque: Annotated[Array | None, _in("N·m", "About x, y, z; shape (3,).")] = None
    raw_force: Annotated[Array | None, _in("N", "Without compensation; shape (3,).")] = None
    raw_torque: Annotated[Array | None, _in("N·m", "Without compensation; shape (3,).")] = None
    active: Annotated[bool | None, _is("Whether force sensing is switched on.")] = None


class Io(msgspec.Struct, frozen=True):
    """Digital inputs and outputs by bank."""

    digital_in: Annotated[dict[str, Bits | None] | None, _is("Inputs by bank: box, tool, ext1 …")] = None
    digital_out: Annotated[dict[str, Bits | None] | None, _is("Outputs by bank: box, tool, ext1 …")] = None


class Channels(msgspec.Struct, frozen=True):
    """Analog channels of one bank: either in a unit, or raw where the manual gives no scale."""

    values: Annotated[Array | None, _is("Values in `unit`.")] = None
    unit: Annotated[str | None, _is("Unit of `values`.")] = None
    raw: Annotated[Array | None, _is("Values as the controller sends them, without a known scale.")] = None


class Analog(msgspec.Struct, frozen=True):
    """Analog inputs and outputs by bank."""

    analog_in: Annotated[dict[str, Channels | None] | None, _is("Inputs by bank: box, tool, ext1 …")] = None
    analog_out: Annotated[dict[str, Channels | None] | None, _is("Outputs by bank: box, tool, ext1 …")] = None


class Fault(msgspec.Struct, frozen=True):
    """A fault that the controller reports. Code and text are the vendor's: the gateway invents none."""

    code: Annotated[str, _is("The vendor's name of the fault or of the field that carries it.")]
    main: Annotated[int | None, _is("The vendor's main code.")] = None
    sub: Annotated[int | None, _is("The vendor's sub-code.")] = None
    severity: Annotated[Severity | None, _is("Severity, where the vendor gives one.")] = None
    text: Annotated[str | None, _is("The vendor's words.")] = None
    joint: Annotated[int | None, _is("Index of the joint, base = 0.")] = None
    since: Annotated[int | None, _in("µs", "When the gateway first saw it, UTC since 1970.")] = None
    remedy: Annotated[str | None, _is("The vendor's remedy.")] = None

    @property
    def key(self) -> tuple[str, int | None, int | None, int | None]:
        """What makes it the same fault as before."""
        return (self.code, self.main, self.sub, self.joint)


class Program(msgspec.Struct, frozen=True):
    """The robot program."""

    state: Annotated[ProgramState | None, _is("What it is doing.")] = None
    name: Annotated[str | None, _is("Its name.")] = None
    line: Annotated[int | None, _is("The line being executed.")] = None
    total_lines: Annotated[int | None, _is("How many lines it has.")] = None
    run_time: Annotated[float | None, _in("s", "Time since it started; never by itself a change of state.")] = None


class Payload(msgspec.Struct, frozen=True):
    """The load that the controller assumes."""

    mass: Annotated[float | None, _in("kg", "Mass.")] = None
    cog: Annotated[Array | None, _in("m", "Centre of gravity in the flange reference; shape (3,).")] = None


class Status(msgspec.Struct, frozen=True):
    """What the robot is doing."""

    operating_mode: Annotated[OperatingMode | None, _is("Operating mode.")] = None
    power: Annotated[Power | None, _is("How far the arm is powered up.")] = None
    motion: Annotated[Motion | None, _is("What the arm is doing.")] = None
    program: Annotated[Program | None, _is("The robot program.")] = None
    speed_override: Annotated[float | None, _in("1", "Speed override, 0 to 1.")] = None
    simulation: Annotated[bool | None, _is("The controller simulates its arm.")] = None
    drives_powered: Annotated[bool | None, _is("The motors have power.")] = None
    motion_possible: Annotated[bool | None, _is("A move would be carried out now.")] = None
    in_motion: Annotated[bool | None, _is("The arm moves under command.")] = None
    in_error: Annotated[bool | None, _is("The controller reports an error.")] = None
    e_stopped: Annotated[
        bool | None,
        _is(
            "An emergency stop is pressed; null where its polarity is neither documented nor set by estop_polarity. "
            f"{SAFETY_NOTICE}"
        ),
    ] = None
    tool_id: Annotated[int | None, _is("Number of the selected tool.")] = None
    workobject_id: Annotated[int | None, _is("Number of the selected work object.")] = None
    payload: Annotated[Payload | None, _is("The load that the controller assumes.")] = None
    faults: Annotated[list[Fault] | None, _is("Present faults; empty: none; null: the source cannot tell.")] = None


class SafetyFunction(msgspec.Struct, frozen=True):
    """One safety function or input."""

    name: Annotated[str, _is("The vendor's name.")]
    kind: Annotated[FunctionKind | None, _is("Its kind; null where the vendor does not say.")] = None
    enabled: Annotated[bool | None, _is("It is switched on.")] = None
    active: Annotated[bool | None, _is("It has triggered; null where polarity or meaning is not established.")] = None
    stop_category: Annotated[int | None, _is("Stop category of IEC 60204-1: 0, 1 or 2.")] = None
    raw: Annotated[int | None, _is("The raw bits as the controller sends them.")] = None


class Safety(msgspec.Struct, frozen=True):
    """What the controller says of its safety system. For information only; not for functional safety (IEC 61508)."""

    state: Annotated[SafetyState | None, _is("Overall state; null where the source cannot tell.")] = None
    functions: Annotated[list[SafetyFunction] | None, _is("Safety functions and inputs.")] = None
    collision: Annotated[bool | None, _is("A collision with something else is detected.")] = None
    self_collision: Annotated[bool | None, _is("A collision with itself is detected.")] = None
    collision_detection: Annotated[bool | None, _is("Collision detection is switched on.")] = None
    singularity: Annotated[bool | None, _is("Stopped by a singularity.")] = None
    soft_limit: Annotated[bool | None, _is("Stopped by a software limit.")] = None


class Welder(msgspec.Struct, frozen=True):
    """A welding power source."""

    target_voltage: Annotated[float | None, _in("V", "Commanded voltage.")] = None
    target_current: Annotated[float | None, _in("A", "Commanded current.")] = None
    arc: Annotated[bool | None, _is("The arc is on.")] = None
    inhibited: Annotated[bool | None, _is("Welding without an arc is selected.")] = None


class Gripper(msgspec.Struct, frozen=True):
    """A gripper."""

    position: Annotated[float | None, _in("1", "Opening, 0 to 1.")] = None
    active: Annotated[bool | None, _is("It is activated.")] = None
    moving: Annotated[bool | None, _is("It is moving.")] = None


class Controller(msgspec.Struct, frozen=True):
    """The cabinet: what is neither joint nor safety."""

    cabinet_temperature: Annotated[float | None, _in("K", "Air in the cabinet.")] = None
    board_temperature: Annotated[float | None, _in("K", "Main board.")] = None
    cpu_temperature: Annotated[float | None, _in("K", "Processor.")] = None
    fan_current: Annotated[float | None, _in("A", "Fans.")] = None
    supplies: Annotated[dict[str, bool | None] | None, _is("Supply voltages that are present, by name.")] = None
    tool_voltage: Annotated[float | None, _in("V", "Supply voltage at the tool flange.")] = None
    fieldbuses: Annotated[dict[str, bool | None] | None, _is("Fieldbuses that are communicating, by name.")] = None
    gripper: Annotated[Gripper | None, _is("The gripper.")] = None
    welder: Annotated[Welder | None, _is("The welding power source.")] = None


class Link(msgspec.Struct, frozen=True, kw_only=True):
    """The lasting association with a robot; survives reconnects."""

    state: Annotated[LinkState, _is("State of the link.")]
    reason: Annotated[str | None, _is("Why it is in this state, for the operator.")] = None
    since: Annotated[int, _in("µs", "Since when it is online, or is not: retries do not restart it. UTC since 1970.")]
    attempts: Annotated[int, _is("Attempts to connect since the last good frame.")] = 0
    protocol: Annotated[str, _is("The vendor's protocol that is spoken.")]
    peer: Annotated[str, _is("Address of the controller.")]
    layout: Annotated[str | None, _is("The layout of the frames of this session.")] = None
    requested_hz: Annotated[float | None, _in("Hz", "Rate asked for; null where the controller sets it.")] = None
    reached_hz: Annotated[float | None, _in("Hz", "Rate reached by the last frames, rounded.")] = None
    parts_hz: Annotated[
        dict[str, float],
        _in("Hz", "Rate reached by each part of the state, rounded, where the controller tells it in parts."),
    ] = {}
    last_error: Annotated[str | None, _is("The last reason why the link was lost.")] = None
    next_attempt: Annotated[int | None, _in("µs", "When the next attempt is due, UTC since 1970.")] = None
    notes: Annotated[list[str], _is("What the operator should know of this link, one sentence each.")] = []


class LinkStats(msgspec.Struct, frozen=True):
    """Counters of a link since the gateway started, once a second."""

    frames: Annotated[int, _is("Good frames.")] = 0
    skipped: Annotated[int, _is("Known frames that carry no state.")] = 0
    rejects: Annotated[dict[str, int], _is("Rejects by reason.")] = {}
    bad_values: Annotated[
        int, _is("Groups that held NaN or infinite values, of those that were read; state always is.")
    ] = 0
    gaps: Annotated[int | None, _is("Frames that the controller numbered and we did not see; null: no number.")] = None
    sessions: Annotated[int, _is("Sessions that were opened.")] = 0
    n_bytes: Annotated[int, _in("byte", "Bytes received.")] = 0
    age: Annotated[float | None, _in("s", "Age of the last good frame.")] = None
    interval_p50: Annotated[float | None, _in("s", "Median interval of the frames of the last second.")] = None
    interval_p99: Annotated[float | None, _in("s", "99th percentile of the same.")] = None
    decode_time: Annotated[float | None, _in("s", "Mean time to decode one read of the last second.")] = None
    clock_offset: Annotated[float | None, _in("s", "Controller's clock minus ours; null: it has none.")] = None


class EventKind(StrEnum):
    """What an event says has happened."""

    LINK_ONLINE = "link.online"
    LINK_LOST = "link.lost"
    LINK_INCOMPATIBLE = "link.incompatible"
    MODE_CHANGED = "mode.changed"
    POWER_CHANGED = "power.changed"
    MOTION_STARTED = "motion.started"
    MOTION_STOPPED = "motion.stopped"
    PROGRAM_STARTED = "program.started"
    PROGRAM_PAUSED = "program.paused"
    PROGRAM_STOPPED = "program.stopped"
    SAFETY_CHANGED = "safety.changed"
    ESTOP_PRESSED = "estop.pressed"
    ESTOP_RELEASED = "estop.released"
    COLLISION_DETECTED = "collision.detected"
    COLLISION_CLEARED = "collision.cleared"
    FAULT_RAISED = "fault.raised"
    FAULT_CLEARED = "fault.cleared"
    IO_CHANGED = "io.changed"
    ROBOT_ADDED = "robot.added"
    ROBOT_CHANGED = "robot.changed"
    ROBOT_REMOVED = "robot.removed"
    COMMAND_ISSUED = "command.issued"
    COMMAND_EXECUTED = "command.executed"
    COMMAND_MISSED = "command.missed"


class Event(msgspec.Struct, frozen=True, kw_only=True):
    """Something changed or happened, and when. Lossless inside a bounded ring."""

    name: Annotated[str, _is("`boot:seq`: boot is new for each ring and at each start of the gateway.")]
    seq: Annotated[int, _is("Counts the events of one ring.")]
    robot: Annotated[str, _is("Name of the robot.")]
    t: Annotated[int, _in("µs", "Receive time of the frame that showed it, UTC since 1970.")]
    kind: Annotated[EventKind, _is("What happened.")]
    before: Annotated[object, _is("Canonical value before; null: unknown.")] = msgspec.field(name="from", default=None)
    after: Annotated[object, _is("Canonical value after.")] = msgspec.field(name="to", default=None)
    raw: Annotated[
        dict[str, Annotated[object, _is("A raw value.")]], _is("The vendor's raw values that it follows from.")
    ] = {}

    @property
    def boot(self) -> str:
        """The part of its name that all events of its ring share."""
        return self.name.rpartition(":")[0]


class Command(msgspec.Struct, frozen=True, kw_only=True):
    """One command object that the cell's own application has given to the controller: `to` of `command.issued`."""

    id: Annotated[str, _is("The vendor's name of the list that it was given in; its feedback carries the same.")]
    type: Annotated[str, _is("The vendor's class of the object.")]
    index: Annotated[int, _is("Its place in the list, from 0.")]
    total: Annotated[int, _is("How many objects the list has.")]
    object: Annotated[dict[str, object], _is("The object under the vendor's names and in the vendor's units.")]


class CommandFeedback(msgspec.Struct, frozen=True, kw_only=True):
    """How far a list of command objects was carried out: `to` of `command.executed`."""

    id: Annotated[str, _is("The vendor's name of the list.")]
    index: Annotated[int | None, _is("The object that this is about: its place in the list, from 0.")] = None
    reached: Annotated[bool | None, _is("Its target was reached.")] = None
    error: Annotated[Annotated[object, _is("A value.")], _is("The vendor's error, where there is one.")] = None
    text: Annotated[str | None, _is("The vendor's words.")] = None
    custom: Annotated[str | None, _is("What the application has put into the object to find it again.")] = None


class CommandsMissed(msgspec.Struct, frozen=True, kw_only=True):
    """What the stream itself has lost, as its sender says: `to` of `command.missed`."""

    count: Annotated[
        int | None,
        _is("How many messages, or command objects of a list that could not be read; null: nobody can know."),
    ] = None


Delivery = Literal["sample", "state", "event"]


@dataclass(frozen=True, slots=True)
class Group:
    """A row of the model: one group of keys that makes a topic `<robot>/<name>`."""

    name: str
    delivery: Delivery
    struct: type[msgspec.Struct] | None
    text: str


GROUPS: dict[str, Group] = {
    group.name: group
    for group in (
        Group("joints", "sample", Joints, "Joint values."),
        Group("tcp", "sample", Tcp, "Tool centre point."),
        Group("wrench", "sample", Wrench, "Force and torque."),
        Group("io", "state", Io, "Digital inputs and outputs."),
        Group("analog", "sample", Analog, "Analog inputs and outputs."),
        Group("status", "state", Status, "What the robot is doing."),
        Group("safety", "state", Safety, "Safety system, for information only."),
        Group("controller", "sample", Controller, "The cabinet."),
        Group("link", "state", Link, "The association with the robot."),
        Group("link_stats", "sample", LinkStats, "Counters of the link, once a second."),
        Group("events", "event", Event, "Edges."),
        Group("commands", "event", Event, "Command objects seen on the stream, and how they were carried out."),
        Group("vendor", "sample", None, "Every field of the vendor's frame, under its manual name and unit."),
    )
}

# Groups that are normalised from the vendor's frames; the others are the gateway's own words.
FRAME_GROUPS = tuple(
    name for name, group in GROUPS.items() if group.struct not in {Link, LinkStats, Event} and name != "vendor"
)


class Sample(msgspec.Struct, frozen=True, kw_only=True):
    """Stamped canonical values of one topic: the envelope that every door sends."""

    topic: Annotated[str, _is("`<robot>/<group>`.")]
    seq: Annotated[int, _is("Counts the frames that carried the group inside an epoch, read by anyone or not.")]
    epoch: Annotated[str, _is("New on every session of the link.")]
    t: Annotated[int, _in("µs", "Receive time, UTC since 1970; never backwards inside an epoch.")]
    t_src: Annotated[int | None, _in("µs", "The controller's own wall clock, where it has one.")] = None
    t_last: Annotated[int | None, _in("µs", "Time of the last frame, in the one sample after a link is lost.")] = None
    q: Annotated[Quality, _is("The worst of DISCONNECTED > STALE > BAD > UNCERTAIN > SUBSTITUTED > GOOD.")]
    origin: Annotated[Literal["live", "sim", "replay"], _is("Where it comes from.")] = "live"
    data: Annotated[object, _is("The group.")]
