"""From the fields of the real-time frame to the canonical model.

Everything in the frame is a double, enumerations and bits too: a value that is none of those that are documented gives
null. What the interface does not send stays null: the operating mode, the program's name, the speed slider, whether the
arm is guided by hand (but in backdrive), the flange's pose, analog inputs and outputs.
"""

from __future__ import annotations

from math import hypot, isinf

from gateway.api.model import Fault, Motion, Power, ProgramState, SafetyState
from gateway.api.signals import Signal

Numbers = list[float]
Bits = list[bool | None]

_POWER_OFF, _IDLE, _BACKDRIVE, _RUNNING = 3, 5, 6, 7  # robot_mode; a whole double finds its number in a dict
_DRIVES: dict[float, bool] = {_POWER_OFF: False, _RUNNING: True}
_POWERS: dict[float, Power] = {
    2: Power.BOOTING,
    _POWER_OFF: Power.OFF,
    4: Power.POWERED,
    _IDLE: Power.POWERED,
    _BACKDRIVE: Power.POWERED,
    _RUNNING: Power.ENABLED,
}
# A program that is stopping or pausing still runs, one that is resuming still pauses.
_PROGRAM_STATES: dict[float, ProgramState] = {
    0: ProgramState.RUNNING,
    1: ProgramState.STOPPED,
    2: ProgramState.RUNNING,
    3: ProgramState.RUNNING,
    4: ProgramState.PAUSED,
    5: ProgramState.PAUSED,
}
_VIOLATION, _FAULT = 8, 9  # safety_mode and safety_status
# 1 to 13 are the manual's; the others are those of the maker's own ROS package ur_dashboard_msgs, SafetyStatus.
_SAFETY_STATES: dict[float, SafetyState] = {
    1: SafetyState.NORMAL,
    2: SafetyState.REDUCED,
    3: SafetyState.PROTECTIVE_STOP,
    4: SafetyState.RECOVERY,
    5: SafetyState.SAFEGUARD_STOP,
    6: SafetyState.EMERGENCY_STOP,
    7: SafetyState.EMERGENCY_STOP,
    _VIOLATION: SafetyState.VIOLATION,
    _FAULT: SafetyState.FAULT,
    12: SafetyState.SAFEGUARD_STOP,
    15: SafetyState.EMERGENCY_STOP,
    16: SafetyState.SAFEGUARD_STOP,
    18: SafetyState.SAFEGUARD_STOP,
    19: SafetyState.SAFEGUARD_STOP,
    20: SafetyState.EMERGENCY_STOP,
    22: SafetyState.SAFEGUARD_STOP,
}
# A fault or a violation hides what else holds: then nothing is said of the emergency stops.
_STOPS_SHOWN: dict[SafetyState, bool] = dict.fromkeys(
    set(SafetyState) - {SafetyState.FAULT, SafetyState.VIOLATION}, False
)
_STOPS_SHOWN[SafetyState.EMERGENCY_STOP] = True
_SAFETY_TEXTS: dict[float, str] = {_VIOLATION: "VIOLATION", _FAULT: "FAULT"}
_JOINT_TEXTS: dict[float, str] = {251: "VIOLATION", 252: "FAULT"}
_MOST_BITS = 1 << 32


def power(robot_mode: float) -> Power:
    """How far the arm is powered up; in backdrive its brakes may be forced, but no joint is controlled."""
    return _POWERS.get(robot_mode, Power.UNKNOWN)


def drives_powered(robot_mode: float) -> bool | None:
    """Whether the motors have power: established for power off and running only."""
    return _DRIVES.get(robot_mode)


def motion(robot_mode: float, target_velocity: Numbers) -> Motion:
    """What the arm is doing: by its target velocities, and guided by hand in backdrive."""
    if robot_mode == _BACKDRIVE:
        return Motion.HAND_GUIDING
    return Motion.MOVING if any(target_velocity) else Motion.STANDSTILL


def in_motion(robot_mode: float, target_velocity: Numbers) -> bool | None:
    """Whether the arm moves under command: not where no joint has a target velocity; else a hand may guide it."""
    return None if robot_mode == _BACKDRIVE or any(target_velocity) else False


def program_state(state: float) -> ProgramState:
    """What the program is doing."""
    return _PROGRAM_STATES.get(state, ProgramState.UNKNOWN)


def safety_state(mode: float | None, status: float | None) -> SafetyState | None:
    """The overall state, from safety_status where the frame has it: it tells more stops than safety_mode."""
    shown = mode if status is None else status
    return None if shown is None else _SAFETY_STATES.get(shown)


def e_stopped(mode: float | None, status: float | None) -> bool | None:
    """Whether an emergency stop is pressed; unknown in a fault, a violation and every state that is not documented."""
    state = safety_state(mode, status)
    return None if state is None else _STOPS_SHOWN.get(state)


def faults(joint_modes: Numbers | None, mode: float | None, status: float | None) -> list[Fault] | None:
    """Joints and the safety system in fault, under the name of their field; the interface tells no other error."""
    if joint_modes is None:
        return None
    name, shown = ("safety_mode", mode) if status is None else ("safety_status", status)
    found = [
        Fault("joint_modes", main=int(value), text=_JOINT_TEXTS[value], joint=joint)
        for joint, value in enumerate(joint_modes)
        if value in _JOINT_TEXTS
    ]
    if shown is not None and shown in _SAFETY_TEXTS:
        found.insert(0, Fault(name, main=int(shown), text=_SAFETY_TEXTS[shown]))
    return found


def in_error(joint_modes: Numbers | None, mode: float | None, status: float | None) -> bool | None:
    """Whether a joint or the safety system is in fault."""
    found = faults(joint_modes, mode, status)
    return None if found is None else bool(found)


def box_bits(value: float) -> Bits | None:
    """The bits 0 to 15 of a whole number: 8 standard, then 8 configurable inputs or outputs."""
    return _bits(value, 0, 16)


def tool_bits(value: float) -> Bits | None:
    """The bits 16 and 17 of a whole number: those of the tool."""
    return _bits(value, 16, 2)


def first_three(values: Numbers) -> Numbers:
    """The first three of six numbers: linear, in SI units."""
    return values[:3]


def last_three(values: Numbers) -> Numbers:
    """The last three of six numbers: angular, in SI units."""
    return values[3:]


def magnitude(values: Numbers) -> float | None:
    """The length of the first three of six numbers; none where it is too large for a number."""
    length = hypot(*values[:3])
    return None if isinf(length) else length


def _bits(value: float, first: int, count: int) -> Bits | None:
    if not 0 <= value < _MOST_BITS or not value.is_integer():
        return None
    word = int(value)
    return [bool(word >> bit & 1) for bit in range(first, first + count)]


_SAFETY = ("safety_mode", "safety_status")

SIGNALS = (
    Signal("joints.position", "q_actual"),
    Signal("joints.velocity", "qd_actual"),
    Signal("joints.current", "I_actual"),
    Signal("joints.temperature", "motor_temperatures"),
    Signal("joints.target_position", "q_target"),
    Signal("joints.target_velocity", "qd_target"),
    Signal("joints.target_acceleration", "qdd_target"),
    Signal("joints.target_effort", "M_target"),
    Signal("joints.target_current", "I_target"),
    Signal("tcp.pose", "tool_vector_actual", rotation="rotation_vector"),
    Signal("tcp.target_pose", "tool_vector_target", rotation="rotation_vector"),
    Signal("tcp.twist", "TCP_speed_actual"),
    Signal("tcp.target_twist", "TCP_speed_target"),
    Signal("tcp.speed", "TCP_speed_actual", magnitude),
    Signal("wrench.force", "TCP_force", first_three),
    Signal("wrench.torque", "TCP_force", last_three),
    Signal("io.digital_in.box", "digital_input_bits", box_bits),
    Signal("io.digital_in.tool", "digital_input_bits", tool_bits),
    Signal("io.digital_out.box", "digital_outputs", box_bits),
    Signal("io.digital_out.tool", "digital_outputs", tool_bits),
    Signal("status.power", "robot_mode", power),
    Signal("status.motion", ("robot_mode", "qd_target"), motion),
    Signal("status.in_motion", ("robot_mode", "qd_target"), in_motion),
    Signal("status.drives_powered", "robot_mode", drives_powered),
    Signal("status.program.state", "program_state", program_state),
    Signal("status.in_error", ("joint_modes", *_SAFETY), in_error, partial=True),
    Signal("status.e_stopped", _SAFETY, e_stopped, partial=True),
    Signal("status.payload.mass", "payload_mass"),
    Signal("status.payload.cog", "payload_CoG"),
    Signal("status.faults", ("joint_modes", *_SAFETY), faults, partial=True),
    Signal("safety.state", _SAFETY, safety_state, partial=True),
)
