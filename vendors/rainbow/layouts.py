"""The state frame of the Rainbow Robotics RB series, as sent on port 5001 in answer to `reqdata`.

    0      1            3      4                                        580
    +------+------------+------+------------------------------------------+
    | 0x24 | size (u16) | 0x03 | 144 words: f32, i32 or u32, little-endian |
    +------+------------+------+------------------------------------------+
             size = bytes behind the header: 576

Source: Rainbow Robotics, Data Structure [reqdata], V 4.3.1 (2022-03-01), and its v6.10 revision; the masks are those of
v6.10. Words with bit fields are declared `int` by the vendor and read here as unsigned. Flags marked since="6.10" are
described by v6.10 only. The older, shorter frames are prefixes of the same table.
"""

from __future__ import annotations

from gateway.api.layout import Field, Flag, Layout

SOURCE = "Rainbow Robotics, Data Structure [reqdata], V 4.3.1 and v6.10"

# Bit 31 is output 15: both manuals print input 15, which is already bit 15.
_EXTENSION_IO = tuple(
    Flag(name=f"ext_{way}_{number}", bit=first + number, meaning=f"Extension I/O digital {word} {number}")
    for way, word, first in (("di", "input", 0), ("do", "output", 16))
    for number in range(16)
)

_FIELDS = (
    Field(
        name="header",
        offset=0,
        type="u8",
        count=4,
        meaning="Frame header: start byte 0x24, size low byte, size high byte, frame type (3 for this structure)",
    ),
    Field(
        name="time",
        offset=4,
        type="f32",
        unit="s",
        meaning="Documented as the base timer; real boxes do not fill it with a usable time, so ignore it",
    ),
    Field(
        name="jnt_ref",
        offset=8,
        type="f32",
        count=6,
        unit="deg",
        meaning="Commanded angle of each joint (0 base, 1 shoulder, 2 elbow, 3 wrist1, 4 wrist2, 5 wrist3)",
    ),
    Field(
        name="jnt_ang", offset=32, type="f32", count=6, unit="deg", meaning="Encoder angle of each joint, same order"
    ),
    Field(
        name="jnt_cur", offset=56, type="f32", count=6, unit="A", meaning="Measured current of each joint, same order"
    ),
    Field(
        name="tcp_ref",
        offset=80,
        type="f32",
        count=6,
        unit="mm|deg",
        meaning="TCP pose computed from the commanded angles: x y z in mm, rx ry rz in deg",
    ),
    Field(
        name="tcp_pos",
        offset=104,
        type="f32",
        count=6,
        unit="mm|deg",
        meaning="Meant to be the TCP pose from the encoder angles, but sent as a copy of tcp_ref",
    ),
    Field(name="analog_in", offset=128, type="f32", count=4, unit="V", meaning="Control-box analog inputs 0-3"),
    Field(name="analog_out", offset=144, type="f32", count=4, unit="V", meaning="Control-box analog outputs 0-3"),
    Field(
        name="digital_in",
        offset=160,
        type="i32",
        count=16,
        meaning="Control-box digital inputs 0-15, one word each, 0 or 1",
    ),
    Field(
        name="digital_out",
        offset=224,
        type="i32",
        count=16,
        meaning="Control-box digital outputs 0-15, one word each, 0 or 1",
    ),
    Field(
        name="jnt_temperature",
        offset=288,
        type="f32",
        count=6,
        unit="degC",
        meaning="Measured temperature of each joint (base to wrist3)",
    ),
    Field(name="task_pc", offset=312, type="i32", meaning="Target program counter during STEP (vendor: not for users)"),
    Field(
        name="task_repeat",
        offset=316,
        type="i32",
        meaning="Requested number of program runs on the PLAY page (vendor: not for users)",
    ),
    Field(name="task_run_id", offset=320, type="i32", meaning="Program counter now executing (vendor: not for users)"),
    Field(
        name="task_run_num",
        offset=324,
        type="i32",
        meaning="Number of the current program run on the PLAY page (vendor: not for users)",
    ),
    Field(
        name="task_run_time",
        offset=328,
        type="i32",
        unit="s",
        meaning="Time since the program started (vendor: not for users); float in the oldest layouts",
    ),
    Field(name="task_state", offset=332, type="i32", meaning="Program state: 1 idle, 2 running but paused, 3 running"),
    Field(
        name="default_speed", offset=336, type="f32", meaning="Global speed multiplier, the speed bar of the UI, 0 to 1"
    ),
    Field(
        name="robot_state",
        offset=340,
        type="i32",
        meaning="Motion state: 1 idle, 3 moving, 5 conveyor or force control without a move, 60+n waypoint n of MovePB/ITPL/Pro, 560+n waypoint n of MoveXB (6.10)",
    ),
    Field(
        name="information_chunk_1",
        offset=344,
        type="u32",
        meaning="Power, safety chain, buttons, temperatures, field buses",
        flags=(
            Flag(name="box_48v_in", bit=0, meaning="48 V present at the control-box input"),
            Flag(name="box_48v_out", bit=1, meaning="48 V present at the control-box output"),
            Flag(name="box_24v_in", bit=2, meaning="24 V present at the control-box input"),
            Flag(
                name="estop_1",
                bit=3,
                meaning="Emergency-stop channel 1 of the control box",
                note="1 = released/OK (inferred from a healthy robot); rbpodo comments call this bit 48 V switching",
            ),
            Flag(name="user_switch", bit=4, meaning="User power switch of the control box"),
            Flag(
                name="estop_2",
                bit=5,
                meaning="Emergency-stop channel 2 of the control box",
                note="1 = released/OK (inferred from a healthy robot)",
            ),
            Flag(name="arm_power", bit=6, meaning="Power applied to the arm", note="6.10 says DC power: the same bit"),
            Flag(name="teach_button", bit=7, meaning="Direct-teaching button on the tool-flange board pressed"),
            Flag(
                name="hand_button_a",
                bit=8,
                meaning="Hand controller button A",
                note="polarity not established; may read 1 at rest",
                since="6.10",
            ),
            Flag(
                name="hand_button_b",
                bit=9,
                meaning="Hand controller button B",
                note="polarity not established; may read 1 at rest",
                since="6.10",
            ),
            Flag(
                name="hand_button_c",
                bit=10,
                meaning="Hand controller button C",
                note="polarity not established; may read 1 at rest",
                since="6.10",
            ),
            Flag(
                name="hand_button_d",
                bit=11,
                meaning="Hand controller button D",
                note="polarity not established; may read 1 at rest",
                since="6.10",
            ),
            Flag(name="sos_active", bit=12, meaning="SOS (device error) state", since="6.10"),
            Flag(name="lan2can_connected", bit=13, meaning="LAN-to-CAN converter connected", since="6.10"),
            Flag(name="gp_a", bit=14, meaning="General-purpose port A", since="6.10"),
            Flag(name="gp_b", bit=15, meaning="General-purpose port B", since="6.10"),
            Flag(
                name="cpu_temp_half",
                bit=16,
                width=6,
                meaning="Control-box CPU temperature, stored halved",
                note="degC = raw * 2 (inference), range 0-126",
                since="6.10",
            ),
            Flag(
                name="board_temp_half",
                bit=22,
                width=6,
                meaning="Control-box mainboard temperature, stored halved",
                note="degC = raw * 2 (inference), range 0-126",
                since="6.10",
            ),
            Flag(name="profinet_active", bit=28, meaning="PROFINET communication active", since="6.10"),
            Flag(name="ethernet_ip_active", bit=29, meaning="EtherNet/IP communication active", since="6.10"),
            Flag(
                name="program_load_toggle",
                bit=30,
                meaning="Inverts each time a program is loaded successfully",
                note="an edge, not a level",
            ),
            Flag(
                name="program_transmit",
                bit=31,
                meaning="Program transfer from the tablet UI over TCP/IP",
                note="vendor: not for users",
            ),
        ),
    ),
    Field(
        name="reserved_1",
        offset=348,
        type="f32",
        count=6,
        meaning="Not for use; not always zero (older layouts kept a TCP target here)",
    ),
    Field(
        name="jnt_info",
        offset=372,
        type="u32",
        count=6,
        meaning="Status and error bits of each joint",
        flags=(
            Flag(name="fet", bit=0, meaning="FET (power stage) on"),
            Flag(name="run", bit=1, meaning="RUN state; 1 in position control, 0 in direct teaching"),
            Flag(name="init", bit=2, meaning="INIT state"),
            Flag(name="mode", bit=3, meaning="MODE state; 0 in position control, 1 in direct teaching"),
            Flag(name="enc_nonius_err", bit=4, meaning="Encoder: Nonius error"),
            Flag(name="enc_low_battery", bit=5, meaning="Encoder: low battery"),
            Flag(name="enc_calibrating", bit=6, meaning="Encoder: calibration mode"),
            Flag(name="enc_multiturn_err", bit=7, meaning="Encoder: multi-turn error"),
            Flag(name="err_jam", bit=8, meaning="Joint error JAM"),
            Flag(name="err_cur", bit=9, meaning="Joint error CUR (over-current)"),
            Flag(name="err_big", bit=10, meaning="Joint error BIG", note="vendor gives only the abbreviation"),
            Flag(name="err_inp", bit=11, meaning="Joint error INP (input)"),
            Flag(name="err_flt", bit=12, meaning="Joint error FLT", note="vendor gives only the abbreviation"),
            Flag(name="err_tmp", bit=13, meaning="Joint error TMP (temperature)"),
            Flag(name="err_ps1", bit=14, meaning="Joint error PS1", note="vendor gives only the abbreviation"),
            Flag(name="err_ps2", bit=15, meaning="Joint error PS2", note="vendor gives only the abbreviation"),
            Flag(
                name="reserved_16_31",
                bit=16,
                width=16,
                meaning="Reserved",
                note="not zero on a real box: never compare the whole word",
            ),
        ),
    ),
    Field(name="collision_detect_onoff", offset=396, type="i32", meaning="Out-collision detection: 1 on, 0 off"),
    Field(
        name="is_freedrive_mode",
        offset=400,
        type="i32",
        meaning="Free-drive (direct teaching): non-zero on, 0 off",
        flags=(Flag(name="freedrive", bit=0, width=2, meaning="Free-drive on when non-zero", since="6.10"),),
    ),
    Field(
        name="real_vs_simulation_mode",
        offset=404,
        type="i32",
        meaning="Operating mode: 0 real robot, 1 simulation",
        flags=(Flag(name="simulation", bit=0, width=4, meaning="1 simulation, 0 real robot", since="6.10"),),
    ),
    Field(
        name="init_state_info",
        offset=408,
        type="i32",
        meaning="Arm activation stage: 0 default, 1 power check, 2 device check, 3 servo check, 4 parameter check, 5 payload check, 6 active",
        flags=(Flag(name="init_stage", bit=0, width=6, meaning="Activation stage 0-6", since="6.10"),),
    ),
    Field(
        name="init_error",
        offset=412,
        type="i32",
        meaning="Error code of the activation (vendor: not for users)",
        flags=(Flag(name="init_error_code", bit=0, width=12, meaning="Activation error code", since="6.10"),),
    ),
    Field(name="tfb_analog_in", offset=416, type="f32", count=2, unit="V", meaning="Tool-flange analog inputs 0-1"),
    Field(
        name="tfb_digital_in",
        offset=424,
        type="i32",
        count=2,
        meaning="Tool-flange digital inputs 0-1, 0 or 1",
        flags=(Flag(name="tfb_di", bit=0, width=2, meaning="Tool-flange digital input of this element", since="6.10"),),
    ),
    Field(
        name="tfb_digital_out",
        offset=432,
        type="i32",
        count=2,
        meaning="Tool-flange digital outputs 0-1, 0 or 1",
        flags=(
            Flag(name="tfb_do", bit=0, width=2, meaning="Tool-flange digital output of this element", since="6.10"),
        ),
    ),
    Field(name="tfb_voltage_out", offset=440, type="f32", unit="V", meaning="Tool-flange supply voltage"),
    Field(
        name="op_stat_collision_occur",
        offset=444,
        type="i32",
        meaning="Out-collision detected: non-zero yes",
        flags=(
            Flag(name="out_collision", bit=0, width=2, meaning="Out-collision detected when non-zero", since="6.10"),
        ),
    ),
    Field(
        name="op_stat_sos_flag",
        offset=448,
        type="i32",
        meaning="Arm device error code 0-12",
        flags=(Flag(name="sos_code", bit=0, width=6, meaning="Arm device error code 0-12", since="6.10"),),
    ),
    Field(
        name="op_stat_self_collision",
        offset=452,
        type="u32",
        meaning="Self-collision detected: non-zero yes; other bits carry other data",
        flags=(
            Flag(
                name="self_collision",
                bit=0,
                width=2,
                meaning="Self-collision detected when non-zero",
                note="4.3.1 describes the whole word as 0 or 1",
                since="6.10",
            ),
            Flag(
                name="last_out_collision_cause",
                bit=2,
                width=2,
                meaning="Cause of the last out-collision: 1 motor torque, 2 accelerometer, 3 gyro",
                note="0 = none",
                since="6.10",
            ),
            Flag(
                name="time_zone_raw",
                bit=4,
                width=28,
                meaning="Control-box time zone",
                note="encoding undocumented: do not decode",
                since="6.10",
            ),
        ),
    ),
    Field(name="op_stat_soft_estop_occur", offset=456, type="i32", meaning="Pause flag, 0 or 1"),
    Field(
        name="op_stat_ems_flag",
        offset=460,
        type="i32",
        meaning="Kinematic stop: 0 none, 1 arm stretch, 2 Cartesian limit, 3 joint limit, 4 unsolvable",
        flags=(Flag(name="ems_code", bit=0, width=6, meaning="Kinematic stop code 0-4", since="6.10"),),
    ),
    Field(
        name="information_chunk_2",
        offset=464,
        type="u32",
        meaning="Config DI 16, welding voltage, activation, component links",
        flags=(
            Flag(
                name="config_di_16",
                bit=0,
                width=2,
                meaning="Configurable digital input 16 (safety input)",
                note="vendor: not for users; 1 is the healthy state, do not alarm on it",
            ),
            Flag(
                name="target_weld_voltage_x100",
                bit=2,
                width=16,
                meaning="Target welding voltage times 100",
                note="V = raw / 100",
            ),
            Flag(name="arm_activating", bit=18, width=2, meaning="Arm activation in progress", since="6.10"),
            Flag(
                name="pfl_mode",
                bit=20,
                width=2,
                meaning="PFL (power and force limiting) mode",
                note="values undocumented",
                since="6.10",
            ),
            Flag(
                name="component_connection",
                bit=22,
                width=8,
                meaning="Connection state of robot components",
                note="bit assignment undocumented",
                since="6.10",
            ),
            Flag(
                name="reserved_30_31",
                bit=30,
                width=2,
                meaning="Not described",
                note="neither document describes these bits",
            ),
        ),
    ),
    Field(
        name="information_chunk_3",
        offset=468,
        type="u32",
        meaning="Config DI 17, TCP speed, safety inputs",
        flags=(
            Flag(
                name="config_di_17",
                bit=0,
                width=2,
                meaning="Configurable digital input 17 (safety input)",
                note="vendor: not for users; 1 is the healthy state, do not alarm on it",
            ),
            Flag(
                name="tcp_speed_x10",
                bit=2,
                width=16,
                meaning="TCP speed times 10",
                note="unit not stated; mm/s assumed",
                since="6.10",
            ),
            Flag(
                name="task_load_flag",
                bit=18,
                width=2,
                meaning="Task load flag",
                note="values undocumented",
                since="6.10",
            ),
            Flag(
                name="lan_cable",
                bit=20,
                width=2,
                meaning="LAN cable connection",
                note="values undocumented",
                since="6.10",
            ),
            Flag(name="safety_ems2_pressed", bit=22, meaning="Safety input EMS2 pressed", since="6.10"),
            Flag(name="safety_prs_pressed", bit=23, meaning="Safety input PRS pressed", since="6.10"),
            Flag(name="safety_hss_pressed", bit=24, meaning="Safety input HSS pressed", since="6.10"),
            Flag(name="safety_sss_pressed", bit=25, meaning="Safety input SSS pressed", since="6.10"),
            Flag(
                name="reserved_26_31",
                bit=26,
                width=6,
                meaning="Not described",
                note="neither document describes these bits",
            ),
        ),
    ),
    Field(
        name="inbox_trap_flag",
        offset=472,
        type="i32",
        count=2,
        meaning="In-box 0 and 1: check has triggered",
        flags=(
            Flag(
                name="inbox_trapped", bit=0, width=4, meaning="In-box check of this element has triggered", since="6.10"
            ),
        ),
    ),
    Field(
        name="inbox_check_mode",
        offset=480,
        type="i32",
        count=2,
        meaning="In-box 0 and 1 check mode: 0 none, 1 flange centre, 2 TCP, 3 tool box, 4 all",
        flags=(Flag(name="inbox_mode", bit=0, width=4, meaning="In-box check mode 0-4 of this element", since="6.10"),),
    ),
    Field(name="eft_fx", offset=488, type="f32", unit="N", meaning="External force/torque sensor, force x"),
    Field(name="eft_fy", offset=492, type="f32", unit="N", meaning="External force/torque sensor, force y"),
    Field(name="eft_fz", offset=496, type="f32", unit="N", meaning="External force/torque sensor, force z"),
    Field(name="eft_mx", offset=500, type="f32", unit="Nm", meaning="External force/torque sensor, moment x"),
    Field(name="eft_my", offset=504, type="f32", unit="Nm", meaning="External force/torque sensor, moment y"),
    Field(name="eft_mz", offset=508, type="f32", unit="Nm", meaning="External force/torque sensor, moment z"),
    Field(
        name="information_chunk_4",
        offset=512,
        type="u32",
        meaning="Welding, tool list, extra tool-flange inputs, program stop, home",
        flags=(
            Flag(name="no_arc", bit=0, width=2, meaning="No-arc function on"),
            Flag(name="tool_list_index", bit=2, width=6, meaning="Selected tool list number"),
            Flag(name="ext_joint_jog", bit=8, width=2, meaning="Jog of external joints on"),
            Flag(name="tfb_di_2", bit=10, meaning="Tool-flange digital input 2"),
            Flag(name="tfb_di_3", bit=11, meaning="Tool-flange digital input 3"),
            Flag(name="tfb_di_4", bit=12, meaning="Tool-flange digital input 4"),
            Flag(name="tfb_di_5", bit=13, meaning="Tool-flange digital input 5"),
            Flag(name="arc_light", bit=14, meaning="Arc light on", note="vendor: not for users"),
            Flag(
                name="target_weld_current_x10",
                bit=15,
                width=13,
                meaning="Target welding current times 10",
                note="A = raw / 10, max 819.1; 4.3.1 prints 16 bits, which would overlap bits 28-30",
            ),
            Flag(name="target_weld_voltage_option", bit=28, width=2, meaning="Target welding voltage option, 0 or 1"),
            Flag(name="program_intended_stop", bit=30, meaning="Program ended on purpose", since="6.10"),
            Flag(name="home_posture", bit=31, meaning="Arm is in the home posture", since="6.10"),
        ),
    ),
    Field(
        name="extend_io1_analog_in",
        offset=516,
        type="f32",
        count=4,
        unit="V",
        meaning="Extension I/O board analog inputs 0-3",
    ),
    Field(
        name="extend_io1_analog_out",
        offset=532,
        type="f32",
        count=4,
        unit="V",
        meaning="Extension I/O board analog outputs 0-3",
    ),
    Field(
        name="extend_io1_digital_info",
        offset=548,
        type="u32",
        meaning="Extension I/O board digital inputs (bits 0-15) and outputs (bits 16-31)",
        flags=_EXTENSION_IO,
    ),
    Field(
        name="aa_joint_ref",
        offset=552,
        type="f32",
        count=6,
        unit="deg",
        meaning="Commanded angle of external (auxiliary) joints 0-5",
    ),
    Field(
        name="safety_board_stat_info",
        offset=576,
        type="u32",
        meaning="Safety-board data, layout undocumented (vendor: not for users)",
    ),
)

STATE_580 = Layout(name="580", size=580, fields=_FIELDS, source=SOURCE)

# In frames older than 580 bytes task_run_time is a float of another meaning: it is not read there.
_CHANGED = ("task_run_time",)
STATE_512 = STATE_580.prefix(512, name="512", absent=_CHANGED)
STATE_488 = STATE_580.prefix(488, name="488", absent=_CHANGED)
STATE_484 = STATE_580.prefix(484, name="484", absent=_CHANGED)
STATE_464 = STATE_580.prefix(464, name="464", absent=_CHANGED)
LAYOUTS = (STATE_580, STATE_512, STATE_488, STATE_484, STATE_464)
