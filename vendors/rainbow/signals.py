"""From the fields of the Rainbow state frame to the canonical model, traps included.

What the controller does not send stays null: joint velocity, acceleration and effort, the operating mode, the flange
pose, the program's name and line. Bits that only v6.10 describes may be unfilled on an older box, whose frames look the
same: their 1 is told, their 0 is "cannot tell".
"""

from __future__ import annotations

from gateway.api.model import (
    Fault,
    FunctionKind,
    Motion,
    Power,
    ProgramState,
    Quality,
    SafetyFunction,
    SafetyState,
)
from gateway.api.signals import Signal
from gateway.api.units import ZERO_CELSIUS_K
from vendors.rainbow.layouts import STATE_580

Words = list[int]

IDLE, PAUSED, RUNNING = 1, 2, 3  # task_state
STILL, MOVING, HELD_BY_PROCESS = 1, 3, 5  # robot_state
WAYPOINTS = range(60, 1060)  # robot_state: 60 + n and 560 + n
INIT_DONE = 6  # init_state_info

_ONE = {0: False, 1: True}
_PROGRAM_STATES = {IDLE: ProgramState.STOPPED, PAUSED: ProgramState.PAUSED, RUNNING: ProgramState.RUNNING}
_IN_MOTION = {Motion.STANDSTILL: False, Motion.HOLD: False, Motion.MOVING: True}

# The words are the manual's; v4.3.1 and v6.10 agree on them.
_SOS_TEXTS = {
    1: "Encoder err (PVL)",
    2: "CPU err",
    3: "Big err",
    4: "Input err",
    5: "JAM err",
    6: "Over current err",
    7: "Position bound err",
    8: "Mode err",
    9: "Match err",
    10: "Over current/Low voltage err",
    11: "Temperature err",
    12: "Speed over err",
}
_KINEMATIC_TEXTS = {1: "Arm Stretch", 2: "Cartesian Limit", 3: "Joint Limit", 4: "Un-solvable"}
_SOFT_LIMITS = {2, 3}
_JOINT_TEXTS = {
    "enc_nonius_err": "encoder state (Nonius err)",
    "enc_low_battery": "encoder state (LowBatt err)",
    "enc_multiturn_err": "encoder state (Multi-turn err)",
    "err_jam": "Error state (JAM err)",
    "err_cur": "Error state (CUR err)",
    "err_big": "Error state (BIG err)",
    "err_inp": "Error state (INP err)",
    "err_flt": "Error state (FLT err)",
    "err_tmp": "Error state (TMP err)",
    "err_ps1": "Error state (PS1 err)",
    "err_ps2": "Error state (PS2 err)",
}
_JOINT_BITS = {name: 1 << STATE_580.flag_owner[f"jnt_info.{name}"][1].bit for name in _JOINT_TEXTS}
_ANY_JOINT_BIT = sum(_JOINT_BITS.values())
_ESTOPS = ("information_chunk_1.estop_1", "information_chunk_1.estop_2")
_EMS2 = "information_chunk_3.safety_ems2_pressed"
_UNEXPLAINED_STOPS = tuple(f"information_chunk_3.safety_{name}_pressed" for name in ("prs", "hss", "sss"))
_SOS = "op_stat_sos_flag.sos_code"
_SOS_ACTIVE = "information_chunk_1.sos_active"
_KINEMATIC = "op_stat_ems_flag.ems_code"
# The whole words of the joints: only those with an error are opened. Their reserved bits cost a comparison.
_ERRORS = (_SOS, _SOS_ACTIVE, _KINEMATIC, "init_error.init_error_code", "jnt_info")
_OUT_COLLISION = "op_stat_collision_occur.out_collision"
_SELF_COLLISION = "op_stat_self_collision.self_collision"
_PAUSE = "op_stat_soft_estop_occur"
_SAFETY_INPUTS = (
    "information_chunk_2.config_di_16",
    "information_chunk_3.config_di_17",
    _EMS2,
    *_UNEXPLAINED_STOPS,
)


def is_one(value: int) -> bool | None:
    """A word of which only 0 and 1 are documented."""
    return _ONE.get(value)


def set_or_unknown(bit: int) -> bool | None:
    """A bit that only v6.10 describes: an older box may leave it 0."""
    return True if bit else None


def pressed(estop_1: int, estop_2: int, estop_polarity: str | None) -> bool | None:
    """Whether an emergency stop of the box is pressed, on either channel; unknown until the polarity is configured."""
    if estop_polarity is None:
        return None
    level = 0 if estop_polarity == "active_low" else 1
    return level in {estop_1, estop_2}


def e_stopped(estop_1: int, estop_2: int, ems2: int | None, estop_polarity: str | None) -> bool | None:
    """Whether any emergency stop is pressed. EMS2 is documented as pressed when 1; its 0 or absence proves nothing."""
    return True if ems2 else pressed(estop_1, estop_2, estop_polarity)


def power(init_stage: int, arm_power: int) -> Power:
    """How far the arm is powered up, from its activation stage and the power at the arm."""
    if not arm_power:
        return Power.OFF
    if init_stage == 0:
        return Power.POWERED
    if init_stage == INIT_DONE:
        return Power.ENABLED
    return Power.BOOTING if init_stage < INIT_DONE else Power.UNKNOWN


def motion(robot_state: int, freedrive: int, pause: int) -> Motion:
    """What the arm is doing. `op_stat_soft_estop_occur` means paused: it is no emergency stop."""
    if freedrive:
        return Motion.HAND_GUIDING
    if robot_state == STILL:
        return Motion.STANDSTILL
    if robot_state in {MOVING, HELD_BY_PROCESS} or robot_state in WAYPOINTS:
        return Motion.HOLD if pause else Motion.MOVING
    return Motion.UNKNOWN


def in_motion(robot_state: int, freedrive: int, pause: int) -> bool | None:
    """Whether the arm moves under command; a hand-guided or force-controlled arm may or may not."""
    if freedrive or robot_state == HELD_BY_PROCESS:
        return None
    return _IN_MOTION.get(motion(robot_state, 0, pause))


def program_state(task_state: int, pause: int) -> ProgramState:
    """What the program is doing. An idle controller does not say whether a program is loaded."""
    if task_state == RUNNING and pause:
        return ProgramState.PAUSED
    return _PROGRAM_STATES.get(task_state, ProgramState.UNKNOWN)


def all_set(flags: Words) -> bool:
    """Whether a flag is set at every joint."""
    return all(flags)


def joint_errors(words: Words) -> int:
    """The error bits that are set at any joint."""
    a, b, c, d, e, f = words
    return (a | b | c | d | e | f) & _ANY_JOINT_BIT


def faults(sos: int, sos_active: int, kinematic: int, init_error: int, joints: Words) -> list[Fault]:
    """Every fault that the frame shows, under the name of its field; the manual gives no severity."""
    found = []
    if sos:
        found.append(Fault("op_stat_sos_flag", main=sos, text=_SOS_TEXTS.get(sos)))
    elif sos_active:
        found.append(Fault("sos_active"))
    if kinematic:
        found.append(Fault("op_stat_ems_flag", main=kinematic, text=_KINEMATIC_TEXTS.get(kinematic)))
    if init_error:
        found.append(Fault("init_error", main=init_error))
    if joint_errors(joints):
        found += [
            Fault(code, text=_JOINT_TEXTS[code], joint=joint)
            for code, bit in _JOINT_BITS.items()
            for joint, word in enumerate(joints)
            if word & bit
        ]
    return found


def in_error(sos: int, sos_active: int, kinematic: int, init_error: int, joints: Words) -> bool:
    """Whether the frame shows any fault."""
    return bool(sos or sos_active or kinematic or init_error or joint_errors(joints))


def safety_state(
    estop_1: int,
    estop_2: int,
    ems2: int | None,
    sos: int,
    sos_active: int,
    out_collision: int,
    self_collision: int,
    *other_stops: int | None,
    estop_polarity: str | None,
) -> SafetyState | None:
    """The overall state. NORMAL needs every emergency stop known to be released, and no other stop.

    What stopped the arm kinematically or by the inputs PRS, HSS and SSS is not established: the state is null then.
    """
    stopped = e_stopped(estop_1, estop_2, ems2, estop_polarity)
    if stopped:
        return SafetyState.EMERGENCY_STOP
    if sos or sos_active:
        return SafetyState.FAULT
    if out_collision or self_collision:
        return SafetyState.PROTECTIVE_STOP
    return None if stopped is None or any(other_stops) else SafetyState.NORMAL


def safety_functions(
    estop_1: int,
    estop_2: int,
    *inputs: int | None,
    estop_polarity: str | None,
) -> list[SafetyFunction]:
    """The safety inputs with their raw bits; `active` only where its meaning is established."""
    found = [
        SafetyFunction(name, FunctionKind.ESTOP, active=pressed(bit, bit, estop_polarity), raw=bit)
        for name, bit in (("estop_1", estop_1), ("estop_2", estop_2))
    ]
    for source, bit in zip(_SAFETY_INPUTS, inputs, strict=True):
        name = source.partition(".")[2]
        kind = FunctionKind.ESTOP if name == "safety_ems2_pressed" else None
        active = set_or_unknown(bit) if bit is not None and name.endswith("_pressed") else None
        found.append(SafetyFunction(name, kind, active=active, raw=bit))
    return found


def soft_limit(kinematic: int) -> bool:
    """Whether a Cartesian or joint limit stopped the arm: a kinematic stop, not an emergency stop."""
    return kinematic in _SOFT_LIMITS


def halved_temperature(half: int) -> float | None:
    """The cabinet's temperatures are stored halved, in degC; 0 on a box that does not fill them."""
    return half * 2 + ZERO_CELSIUS_K if half else None


def hundredths(value: int) -> float:
    """A value times 100."""
    return value / 100


def tenths(value: int) -> float:
    """A value times 10."""
    return value / 10


def nonzero_vector(*components: float) -> list[float] | None:
    """Force and torque: six exact zeros are a box without a sensor."""
    return list(components[:3]) if any(components) else None


def external_joints(angles: list[float], external_joints: int) -> list[float] | None:
    """The configured number of external joints, deg to rad; the frame always has room for six."""
    return [angle * 0.017453292519943295 for angle in angles[:external_joints]] or None


_FORCE = ("eft_fx", "eft_fy", "eft_fz")
_TORQUE = ("eft_mx", "eft_my", "eft_mz")

SIGNALS = (
    Signal("joints.position", "jnt_ang"),
    Signal("joints.target_position", "jnt_ref"),
    Signal("joints.current", "jnt_cur"),
    Signal("joints.temperature", "jnt_temperature"),
    Signal("joints.external_target_position", "aa_joint_ref", external_joints, options=("external_joints",)),
    # The controller sends tcp_ref a second time as tcp_pos.
    Signal("tcp.pose", "tcp_pos", rotation="rpy_fixed_xyz", quality=Quality.SUBSTITUTED),
    Signal("tcp.target_pose", "tcp_ref", rotation="rpy_fixed_xyz"),
    Signal("wrench.force", _FORCE + _TORQUE, nonzero_vector),
    Signal("wrench.torque", _TORQUE + _FORCE, nonzero_vector),
    Signal("io.digital_in.box", "digital_in"),
    Signal("io.digital_in.tool", ("tfb_digital_in.tfb_di", *(f"information_chunk_4.tfb_di_{n}" for n in range(2, 6)))),
    Signal("io.digital_in.ext1", tuple(f"extend_io1_digital_info.ext_di_{n}" for n in range(16))),
    Signal("io.digital_out.box", "digital_out"),
    Signal("io.digital_out.tool", "tfb_digital_out.tfb_do"),
    Signal("io.digital_out.ext1", tuple(f"extend_io1_digital_info.ext_do_{n}" for n in range(16))),
    Signal("analog.analog_in.box", "analog_in"),
    Signal("analog.analog_in.tool", "tfb_analog_in"),
    Signal("analog.analog_in.ext1", "extend_io1_analog_in"),
    Signal("analog.analog_out.box", "analog_out"),
    Signal("analog.analog_out.ext1", "extend_io1_analog_out"),
    Signal("status.power", ("init_state_info.init_stage", "information_chunk_1.arm_power"), power),
    Signal("status.motion", ("robot_state", "is_freedrive_mode.freedrive", _PAUSE), motion),
    Signal("status.program.state", ("task_state", _PAUSE), program_state),
    Signal("status.program.run_time", "task_run_time", volatile=True),
    Signal("status.speed_override", "default_speed"),
    Signal("status.simulation", "real_vs_simulation_mode.simulation", is_one),
    Signal("status.drives_powered", "jnt_info.fet", all_set),
    Signal("status.in_motion", ("robot_state", "is_freedrive_mode.freedrive", _PAUSE), in_motion),
    Signal("status.in_error", _ERRORS, in_error),
    Signal("status.e_stopped", (*_ESTOPS, _EMS2), e_stopped, partial=True, options=("estop_polarity",)),
    Signal("status.tool_id", "information_chunk_4.tool_list_index"),
    Signal("status.faults", _ERRORS, faults),
    Signal(
        "safety.state",
        (*_ESTOPS, _EMS2, _SOS, _SOS_ACTIVE, _OUT_COLLISION, _SELF_COLLISION, _KINEMATIC, *_UNEXPLAINED_STOPS),
        safety_state,
        partial=True,
        options=("estop_polarity",),
    ),
    Signal(
        "safety.functions",
        (*_ESTOPS, *_SAFETY_INPUTS),
        safety_functions,
        partial=True,
        options=("estop_polarity",),
    ),
    Signal("safety.collision", _OUT_COLLISION),
    Signal("safety.self_collision", _SELF_COLLISION),
    Signal("safety.collision_detection", "collision_detect_onoff", is_one),
    Signal("safety.soft_limit", _KINEMATIC, soft_limit),
    # That the temperatures are halved rests on the wording of the manual and one capture.
    Signal(
        "controller.cpu_temperature", "information_chunk_1.cpu_temp_half", halved_temperature, quality=Quality.UNCERTAIN
    ),
    Signal(
        "controller.board_temperature",
        "information_chunk_1.board_temp_half",
        halved_temperature,
        quality=Quality.UNCERTAIN,
    ),
    Signal("controller.supplies.48v_in", "information_chunk_1.box_48v_in"),
    Signal("controller.supplies.48v_out", "information_chunk_1.box_48v_out"),
    Signal("controller.supplies.24v_in", "information_chunk_1.box_24v_in"),
    Signal("controller.tool_voltage", "tfb_voltage_out"),
    Signal("controller.fieldbuses.profinet", "information_chunk_1.profinet_active", set_or_unknown),
    Signal("controller.fieldbuses.ethernet_ip", "information_chunk_1.ethernet_ip_active", set_or_unknown),
    Signal("controller.welder.target_voltage", "information_chunk_2.target_weld_voltage_x100", hundredths),
    Signal("controller.welder.target_current", "information_chunk_4.target_weld_current_x10", tenths),
    Signal("controller.welder.arc", "information_chunk_4.arc_light"),
    Signal("controller.welder.inhibited", "information_chunk_4.no_arc"),
)
