"""From the fields of the FAIRINO frames to the canonical model, traps included; the same rows for `legacy` and CNDE.

What a frame does not carry stays null. `robot_mode` 0 is automatic, poses turn about fixed axes, and the polarity of
the emergency stop is documented, so that `e_stopped` needs no option. Not told, because nothing establishes it: the
number of program lines (one byte), positions of external axes (no unit), a stop by a singularity, welding set points.
"""

from __future__ import annotations

from gateway.api.model import (
    Channels,
    FunctionKind,
    Motion,
    OperatingMode,
    Power,
    ProgramState,
    SafetyFunction,
    SafetyState,
)
from gateway.api.signals import Signal
from gateway.api.units import ZERO_CELSIUS_K
from vendors.fairino.faults import FAULT_FIELDS, faults, in_error

Six = list[float]

_FULL_NAME = 20  # bytes of the program's name on port 8083
_DRAGGING = 4  # program_state of the CNDE table
_ENABLED = 1  # rbtEnableState

_BITS_OF_BYTE = tuple([bool(byte >> bit & 1) for bit in range(8)] for byte in range(256))

_ONE = {0: False, 1: True}
_MODES = {0: OperatingMode.AUTOMATIC, 1: OperatingMode.MANUAL}
_IN_MOTION = {1: False, 2: True, 3: False}  # robot_state
_MOTIONS = {1: Motion.STANDSTILL, 2: Motion.MOVING, 3: Motion.HOLD, 4: Motion.HAND_GUIDING}
_PROGRAM_STATES = {1: ProgramState.STOPPED, 2: ProgramState.RUNNING, 3: ProgramState.PAUSED}
_SAFETY_FUNCTIONS = (
    ("EmergencyStop", FunctionKind.ESTOP),
    ("btnBoxStopSignal", FunctionKind.ESTOP),
    ("safety_stop0_state", FunctionKind.SAFEGUARD),
    ("safety_stop1_state", FunctionKind.SAFEGUARD),
    ("safetyDoorAlarm", FunctionKind.SAFEGUARD),
    ("safetyPlaneAlarm", FunctionKind.LIMIT),
    ("interfaceAlarm", FunctionKind.LIMIT),
    ("collisionState", FunctionKind.COLLISION),
)


def is_one(value: int) -> bool | None:
    """A word of which only 0 and 1 are documented."""
    return _ONE.get(value)


def operating_mode(robot_mode: int) -> OperatingMode:
    """The mode: 0 is automatic, 1 is manual."""
    return _MODES.get(robot_mode, OperatingMode.UNKNOWN)


def power(enable_state: int) -> Power | None:
    """Enabled, or not known: a robot that is not enabled may have power or not."""
    return Power.ENABLED if enable_state == _ENABLED else None


def drives_powered(enable_state: int) -> bool | None:
    """An enabled robot has power at its drives; of one that is not enabled nothing is known."""
    return True if enable_state == _ENABLED else None


def motion(robot_state: int) -> Motion:
    """What the arm is doing."""
    return _MOTIONS.get(robot_state, Motion.UNKNOWN)


def in_motion(robot_state: int) -> bool | None:
    """Whether the arm moves under command; a hand-guided arm may or may not."""
    return _IN_MOTION.get(robot_state)


def program_state(state: int) -> ProgramState | None:
    """What the program is doing; a controller that says "dragging" here says nothing of the program."""
    return None if state == _DRAGGING else _PROGRAM_STATES.get(state, ProgramState.UNKNOWN)


def program_name(name: str) -> str | None:
    """The name of the program, where there is one."""
    return name or None


def whole_name(name: str) -> str | None:
    """The name of the program; one that fills its field may be cut."""
    return name if 0 < len(name.encode()) < _FULL_NAME else None


def speed_override(robot_mode: int, manual: float, automatic: float) -> float | None:
    """The speed of the mode that is selected, % to 0..1."""
    percent = automatic if robot_mode == 0 else manual if robot_mode == 1 else None
    return percent / 100 if percent is not None and 0 <= percent <= 100 else None  # noqa: PLR2004 - per cent


def pressed(emergency_stop: int | None, button_box: int | None, estop_polarity: str | None) -> bool | None:
    """Whether an emergency stop is pressed, at the control box or the button box.

    The page documents 1 as pressed for both; a configured polarity wins over the page.
    """
    level = 0 if estop_polarity == "active_low" else 1
    if level in (emergency_stop, button_box):
        return True
    released = 1 - level
    return False if emergency_stop == released and button_box in (released, None) else None


def safety_state(
    emergency_stop: int | None,
    button_box: int | None,
    collision: int | None,
    stop_0: int | None,
    stop_1: int | None,
    safety_data: int | None,
    estop_polarity: str | None,
) -> SafetyState | None:
    """The overall state. NORMAL needs every source that all firmware sends; `safety_data` came with 3.9.5."""
    e_stopped = pressed(emergency_stop, button_box, estop_polarity)
    if e_stopped:
        return SafetyState.EMERGENCY_STOP
    if safety_data == 1:
        return SafetyState.FAULT
    if collision == 1:
        return SafetyState.PROTECTIVE_STOP
    if 1 in {stop_0, stop_1}:
        return SafetyState.SAFEGUARD_STOP
    if None in {emergency_stop, collision, stop_0, stop_1}:
        return None
    calm = e_stopped is False and not (collision or stop_0 or stop_1 or safety_data)
    return SafetyState.NORMAL if calm else SafetyState.UNKNOWN


def safety_functions(*words: int | None, estop_polarity: str | None) -> list[SafetyFunction] | None:
    """The safety inputs and monitors that the frame carries."""
    found = []
    for (name, kind), word in zip(_SAFETY_FUNCTIONS, words, strict=True):
        if word is not None:
            active = pressed(word, None, estop_polarity) if kind is FunctionKind.ESTOP else is_one(word)
            found.append(SafetyFunction(name, kind, active=active, raw=word))
    return found or None


def soft_limit(joint: int, external_axis: int) -> bool:
    """Whether a joint or an external axis is beyond its soft limit: both are numbers of an axis, 0 none."""
    return bool(joint or external_axis)


def linear_speed(values: list[float]) -> float:
    """The first of a linear and an angular speed, mm/s to m/s."""
    return values[0] * 1e-3


def force(values: Six) -> Six | None:
    """The force of six values; six exact zeros are a sensor that measures nothing."""
    return values[:3] if any(values) else None


def torque(values: Six) -> Six | None:
    """The torque of six values; six exact zeros are a sensor that measures nothing."""
    return values[3:] if any(values) else None


def bits(words: list[int]) -> list[bool | None]:
    """All bits of some words of 16 bits, the lowest first."""
    found: list[bool | None] = []
    for word in words:
        found += _BITS_OF_BYTE[word & 0xFF]
        found += _BITS_OF_BYTE[word >> 8]
    return found


def counts(channels: list[float | None]) -> Channels:
    """Analog channels in counts of the converter, for which the vendor gives no scale."""
    return Channels(raw=channels)


def one_count(channel: float) -> Channels:
    """The same for a single channel."""
    return Channels(raw=[channel])


def two_counts(first: float | None, second: float | None) -> Channels | None:
    """The same for two channels that CNDE names apart: either may be missing."""
    return None if first is None and second is None else Channels(raw=[first, second])


def cabinet_temperature(celsius: float) -> float | None:
    """The wide-voltage box, in K; another box leaves the field 0."""
    return celsius + ZERO_CELSIUS_K if celsius else None


def fan_current(milliamperes: float, celsius: float) -> float | None:
    """The fan of the wide-voltage box, in A; another box leaves both fields 0."""
    return milliamperes * 1e-3 if milliamperes or celsius else None


def is_active(grippers: int) -> bool:
    """Whether any gripper is activated: one bit each."""
    return grippers != 0


def gripper_position(grippers: int, percent: int) -> float | None:
    """The gripper's opening, 0 to 1; without an active gripper the field is 0."""
    return percent / 100 if grippers and 0 <= percent <= 100 else None  # noqa: PLR2004 - per cent


def gripper_moving(grippers: int, done: int) -> bool | None:
    """Whether the gripper moves; without an active gripper "not done" means nothing."""
    return {0: True, 1: False}.get(done) if grippers else None


def _flags(field: str, name: str, count: int) -> tuple[str, ...]:
    return tuple(f"{field}.{name}{bit}" for bit in range(count))


_ESTOPS = ("EmergencyStop", "btnBoxStopSignal")
_SAFETY = (*_ESTOPS, "collisionState", "safety_stop0_state", "safety_stop1_state", "safetyDataState")

# What both tables tell under the same names.
_SHARED = (
    Signal("joints.position", "jt_cur_pos"),
    Signal("joints.effort", "jt_cur_tor"),
    Signal("tcp.pose", "tl_cur_pos", rotation="rpy_fixed_xyz"),
    Signal("wrench.force", "ft_sensor_data", force),
    Signal("wrench.torque", "ft_sensor_data", torque),
    Signal("status.program.state", "program_state", program_state),
)

STATUS_SIGNALS = (*_SHARED, Signal("status.program.name", "program_name", whole_name))

SIGNALS = (
    *_SHARED,
    Signal("joints.velocity", "actual_qd"),
    Signal("joints.acceleration", "actual_qdd"),
    Signal("joints.current", "actualJointCurrent"),
    Signal("joints.temperature", "jointDriverTemperature"),
    Signal("joints.target_position", "targetJointPos"),
    Signal("joints.target_velocity", "targetJointVel"),
    Signal("joints.target_acceleration", "targetJointAcc"),
    Signal("joints.target_effort", "jt_tgt_tor"),
    Signal("joints.target_current", "targetJointCurrent"),
    Signal("tcp.target_pose", "targetTCPPos", rotation="rpy_fixed_xyz"),
    Signal("tcp.flange_pose", "flange_cur_pos", rotation="rpy_fixed_xyz"),
    Signal("tcp.twist", "actual_TCP_Speed"),
    Signal("tcp.target_twist", "target_TCP_Speed"),
    Signal("tcp.speed", "actual_TCP_CmpSpeed", linear_speed),
    Signal("wrench.raw_force", "ft_sensor_raw_data", force),
    Signal("wrench.raw_torque", "ft_sensor_raw_data", torque),
    Signal("wrench.active", "ft_sensor_active", is_one),
    Signal("io.digital_in.box", _flags("cl_dgt_input_l", "DI", 8) + _flags("cl_dgt_input_h", "CI", 8)),
    Signal("io.digital_in.tool", _flags("tl_dgt_input_l", "DI", 2)),
    Signal("io.digital_in.ext1", "extDIState", bits),
    Signal("io.digital_out.box", _flags("cl_dgt_output_l", "DO", 8) + _flags("cl_dgt_output_h", "CO", 8)),
    Signal("io.digital_out.tool", _flags("tl_dgt_output_l", "DO", 2)),
    Signal("io.digital_out.ext1", "extDOState", bits),
    Signal("analog.analog_in.box", ("cl_analog_input_0", "cl_analog_input_1"), two_counts, partial=True),
    Signal("analog.analog_in.tool", "tl_anglog_input", one_count),
    Signal("analog.analog_in.ext1", "extAIState", counts),
    Signal("analog.analog_out.box", ("cl_analog_output_0", "cl_analog_output_1"), two_counts, partial=True),
    Signal("analog.analog_out.tool", "tl_analog_output", one_count),
    Signal("analog.analog_out.ext1", "extAOState", counts),
    Signal("status.operating_mode", "robot_mode", operating_mode),
    Signal("status.power", "rbtEnableState", power),
    Signal("status.motion", "robot_state", motion),
    Signal("status.program.name", "currentLuaFileName", program_name),
    Signal("status.program.line", "luaLineNum"),
    Signal("status.speed_override", ("robot_mode", "speedScaleManual", "speedScaleAuto"), speed_override),
    Signal("status.drives_powered", "rbtEnableState", drives_powered),
    Signal("status.in_motion", "robot_state", in_motion),
    Signal("status.in_error", FAULT_FIELDS, in_error, partial=True, calm=bool),
    Signal("status.e_stopped", _ESTOPS, pressed, partial=True, options=("estop_polarity",)),
    Signal("status.tool_id", "tool"),
    Signal("status.workobject_id", "user"),
    Signal("status.payload.mass", "load"),
    Signal("status.payload.cog", "loadCog"),
    Signal("status.faults", FAULT_FIELDS, faults, partial=True, calm=list),
    Signal("safety.state", _SAFETY, safety_state, partial=True, options=("estop_polarity",)),
    Signal(
        "safety.functions",
        tuple(name for name, _ in _SAFETY_FUNCTIONS),
        safety_functions,
        partial=True,
        options=("estop_polarity",),
    ),
    Signal("safety.collision", "collisionState", is_one),
    Signal("safety.soft_limit", ("outSoftLimitError", "exaxisOutLimitError"), soft_limit),
    Signal("controller.cabinet_temperature", "wideVoltageCtrlBoxTemp", cabinet_temperature),
    Signal("controller.fan_current", ("wideVoltageCtrlBoxFanVel", "wideVoltageCtrlBoxTemp"), fan_current),
    *(
        Signal(f"controller.fieldbuses.modbus_master_{number}", f"modbusMasterConnect.master_{number}")
        for number in range(8)
    ),
    Signal("controller.fieldbuses.modbus_slave", "modbusSlaveConnect", is_one),
    Signal("controller.gripper.position", ("gripper_active", "gripper_position"), gripper_position),
    Signal("controller.gripper.active", "gripper_active", is_active),
    Signal("controller.gripper.moving", ("gripper_active", "gripper_motiondone"), gripper_moving),
)
