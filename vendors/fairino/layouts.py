"""The state frames of the FAIRINO FR series: TCP 20004 (`legacy`), TCP 8083 (`status`), and the states of CNDE.

    0       2       3            5                                  5 + data_len
    +-------+-------+------------+----------------------------------+-----------+
    | 5A 5A | count | data_len   | payload, little-endian, packed   | sum (u16) |
    +-------+-------+------------+----------------------------------+-----------+
                      u16: total size minus 7                         of all bytes before it

Offsets count from the first 5A. Firmware only ever added fields at the end, so every shorter frame is a prefix of the
longest; the checksum behind the payload is no field. The names are the page's own, with its spelling; members of a
sub-struct and elements that CNDE names apart are opened into fields of their own.

Sources: FAIRINO, Data Structure Description (C# SDK v1.1.4 / Web 3.8.3; its content is that of SDK 1.2.6 / Web 3.9.5);
EXT_AXIS_STATUS, ROBOT_TIME and the sizes of each firmware from the vendor's SDKs; units that the page does not give,
and the CNDE names and types, from fr_documentation, CNDE introduction.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

from gateway.api.layout import Field, Flag, Layout

SOURCE = "FAIRINO, Data Structure Description 2.10 ROBOT_STATE_PKG, content of C# SDK 1.2.6 / Web 3.9.5"


def _bits(name: str, count: int, meaning: str, *, first: int = 0) -> tuple[Flag, ...]:
    """Equal flags from bit 0 on, numbered from `first`."""
    return tuple(Flag(name=f"{name}{first + bit}", bit=bit, meaning=f"{meaning} {first + bit}") for bit in range(count))


_FIELDS = (
    Field(name="frame_head", offset=0, type="u16", meaning="Frame start, bytes 0x5A 0x5A"),
    Field(name="frame_cnt", offset=2, type="u8", meaning="Frame counter, wraps 0-255"),
    Field(name="data_len", offset=3, type="u16", meaning="Payload length: total frame length minus 7"),
    Field(
        name="program_state",
        offset=5,
        type="u8",
        meaning="Program state: 1 stopped, 2 running, 3 paused; the CNDE table adds 4 dragging",
    ),
    Field(name="robot_state", offset=6, type="u8", meaning="Motion state: 1 stopped, 2 running, 3 paused, 4 dragging"),
    Field(name="main_code", offset=7, type="i32", meaning="Main fault code"),
    Field(name="sub_code", offset=11, type="i32", meaning="Sub fault code"),
    Field(name="robot_mode", offset=15, type="u8", meaning="Mode: 0 automatic, 1 manual"),
    Field(name="jt_cur_pos", offset=16, type="f64", count=6, unit="deg", meaning="Actual joint positions, axes 1-6"),
    Field(
        name="tl_cur_pos",
        offset=64,
        type="f64",
        count=6,
        unit="mm|deg",
        meaning="Actual tool (TCP) pose x y z rx ry rz",
    ),
    Field(
        name="flange_cur_pos",
        offset=112,
        type="f64",
        count=6,
        unit="mm|deg",
        meaning="Actual end-flange pose x y z rx ry rz",
    ),
    Field(name="actual_qd", offset=160, type="f64", count=6, unit="deg/s", meaning="Actual joint velocities"),
    Field(name="actual_qdd", offset=208, type="f64", count=6, unit="deg/s^2", meaning="Actual joint accelerations"),
    Field(
        name="target_TCP_CmpSpeed",
        offset=256,
        type="f64",
        count=2,
        unit="mm/s|deg/s",
        meaning="Commanded composite TCP speed: [0] linear, [1] orientation",
    ),
    Field(
        name="target_TCP_Speed",
        offset=272,
        type="f64",
        count=6,
        unit="mm/s|deg/s",
        meaning="Commanded TCP speed x y z rx ry rz",
    ),
    Field(
        name="actual_TCP_CmpSpeed",
        offset=320,
        type="f64",
        count=2,
        unit="mm/s|deg/s",
        meaning="Actual composite TCP speed: [0] linear, [1] orientation",
    ),
    Field(
        name="actual_TCP_Speed",
        offset=336,
        type="f64",
        count=6,
        unit="mm/s|deg/s",
        meaning="Actual TCP speed x y z rx ry rz",
    ),
    Field(name="jt_cur_tor", offset=384, type="f64", count=6, unit="Nm", meaning="Actual joint torques"),
    Field(name="tool", offset=432, type="i32", meaning="Number of the tool frame in use"),
    Field(name="user", offset=436, type="i32", meaning="Number of the workpiece frame in use"),
    Field(
        name="cl_dgt_output_h",
        offset=440,
        type="u8",
        meaning="Control-box digital outputs 8-15 (the configurable outputs CO0-CO7), one bit each",
        flags=_bits("CO", 8, "Control-box configurable output"),
    ),
    Field(
        name="cl_dgt_output_l",
        offset=441,
        type="u8",
        meaning="Control-box digital outputs 0-7, one bit each",
        flags=_bits("DO", 8, "Control-box digital output"),
    ),
    Field(
        name="tl_dgt_output_l",
        offset=442,
        type="u8",
        meaning="Tool digital outputs, bits 0 and 1 only",
        flags=_bits("DO", 2, "Tool digital output"),
    ),
    Field(
        name="cl_dgt_input_h",
        offset=443,
        type="u8",
        meaning="Control-box digital inputs 8-15 (the configurable inputs CI0-CI7), one bit each",
        flags=_bits("CI", 8, "Control-box configurable input"),
    ),
    Field(
        name="cl_dgt_input_l",
        offset=444,
        type="u8",
        meaning="Control-box digital inputs 0-7, one bit each",
        flags=_bits("DI", 8, "Control-box digital input"),
    ),
    Field(
        name="tl_dgt_input_l",
        offset=445,
        type="u8",
        meaning="Tool digital inputs, bits 0 and 1 only",
        flags=_bits("DI", 2, "Tool digital input"),
    ),
    Field(name="cl_analog_input_0", offset=446, type="u16", meaning="Control-box analog input AI0, raw 0-4095"),
    Field(name="cl_analog_input_1", offset=448, type="u16", meaning="Control-box analog input AI1, raw 0-4095"),
    Field(
        name="tl_anglog_input",
        offset=450,
        type="u16",
        meaning="Tool analog input, raw 0-4095 (vendor's spelling of analog)",
    ),
    Field(
        name="ft_sensor_raw_data",
        offset=452,
        type="f64",
        count=6,
        unit="N|Nm",
        meaning="Force/torque sensor, raw: fx fy fz tx ty tz",
    ),
    Field(
        name="ft_sensor_data",
        offset=500,
        type="f64",
        count=6,
        unit="N|Nm",
        meaning="Force/torque sensor, processed: fx fy fz tx ty tz",
    ),
    Field(name="ft_sensor_active", offset=548, type="u8", meaning="Force/torque sensor: 1 active, 0 reset"),
    Field(name="EmergencyStop", offset=549, type="u8", meaning="Emergency stop: 1 pressed, 0 not pressed"),
    Field(name="motion_done", offset=550, type="i32", meaning="Motion done: 1 done, 0 not done"),
    Field(
        name="gripper_motiondone",
        offset=554,
        type="u8",
        meaning="Gripper motion done: 1 done, 0 not done; value 2 appears from 3.9.7",
    ),
    Field(name="mc_queue_len", offset=555, type="i32", meaning="Number of queued motion commands"),
    Field(name="collisionState", offset=559, type="u8", meaning="Collision detected: 1 yes, 0 no"),
    Field(name="trajectory_pnum", offset=560, type="i32", meaning="Trajectory point number"),
    Field(
        name="safety_stop0_state",
        offset=564,
        type="u8",
        meaning="Safety stop signal SI0: 0 not active, 1 active (SDK manual, GetSafetyStopState)",
    ),
    Field(
        name="safety_stop1_state",
        offset=565,
        type="u8",
        meaning="Safety stop signal SI1: 0 not active, 1 active (SDK manual, GetSafetyStopState)",
    ),
    Field(name="gripper_fault_id", offset=566, type="u8", meaning="Number of the faulty gripper"),
    Field(name="gripper_fault", offset=567, type="u16", meaning="Gripper fault code"),
    Field(
        name="gripper_active",
        offset=569,
        type="u16",
        meaning="Activated grippers, one bit each, bit n is gripper n (SDK manual, GetGripperActivateStatus)",
    ),
    Field(name="gripper_position", offset=571, type="u8", unit="%", meaning="Gripper position"),
    Field(
        name="gripper_speed",
        offset=572,
        type="u8",
        unit="%",
        meaning="Gripper speed; whether it is signed differs between the SDKs, so values above 127 are doubtful",
    ),
    Field(
        name="gripper_current",
        offset=573,
        type="u8",
        unit="%",
        meaning="Gripper current; whether it is signed differs between the SDKs, so values above 127 are doubtful",
    ),
    Field(name="gripper_temp", offset=574, type="i32", unit="degC", meaning="Gripper temperature"),
    Field(name="gripper_voltage", offset=578, type="i32", unit="V", meaning="Gripper voltage"),
    Field(name="auxState_servoId", offset=582, type="u8", meaning="RS-485 auxiliary axis: servo drive ID number"),
    Field(
        name="auxState_servoErrCode", offset=583, type="i32", meaning="RS-485 auxiliary axis: servo drive error code"
    ),
    Field(name="auxState_servoState", offset=587, type="i32", meaning="RS-485 auxiliary axis: servo drive state"),
    Field(
        name="auxState_servoPos",
        offset=591,
        type="f64",
        meaning="RS-485 auxiliary axis: servo position, unit not stated",
    ),
    Field(
        name="auxState_servoVel", offset=599, type="f32", meaning="RS-485 auxiliary axis: servo speed, unit not stated"
    ),
    Field(
        name="auxState_servoTorque",
        offset=603,
        type="f32",
        meaning="RS-485 auxiliary axis: servo torque, unit not stated",
    ),
    Field(name="extAxisStatus_0_pos", offset=607, type="f64", meaning="UDP external axis 1: position, unit not stated"),
    Field(name="extAxisStatus_0_vel", offset=615, type="f64", meaning="UDP external axis 1: speed, unit not stated"),
    Field(name="extAxisStatus_0_errorCode", offset=623, type="i32", meaning="UDP external axis 1: error code"),
    Field(name="extAxisStatus_0_ready", offset=627, type="u8", meaning="UDP external axis 1: servo ready"),
    Field(name="extAxisStatus_0_inPos", offset=628, type="u8", meaning="UDP external axis 1: in position"),
    Field(name="extAxisStatus_0_alarm", offset=629, type="u8", meaning="UDP external axis 1: servo alarm"),
    Field(name="extAxisStatus_0_flerr", offset=630, type="u8", meaning="UDP external axis 1: following error"),
    Field(name="extAxisStatus_0_nlimit", offset=631, type="u8", meaning="UDP external axis 1: negative limit"),
    Field(name="extAxisStatus_0_pLimit", offset=632, type="u8", meaning="UDP external axis 1: positive limit"),
    Field(
        name="extAxisStatus_0_mdbsOffLine",
        offset=633,
        type="u8",
        meaning="UDP external axis 1: drive offline on RS-485",
    ),
    Field(
        name="extAxisStatus_0_mdbsTimeout",
        offset=634,
        type="u8",
        meaning="UDP external axis 1: RS-485 timeout between control card and box",
    ),
    Field(name="extAxisStatus_0_homingStatus", offset=635, type="u8", meaning="UDP external axis 1: homing state"),
    Field(name="extAxisStatus_1_pos", offset=636, type="f64", meaning="UDP external axis 2: position, unit not stated"),
    Field(name="extAxisStatus_1_vel", offset=644, type="f64", meaning="UDP external axis 2: speed, unit not stated"),
    Field(name="extAxisStatus_1_errorCode", offset=652, type="i32", meaning="UDP external axis 2: error code"),
    Field(name="extAxisStatus_1_ready", offset=656, type="u8", meaning="UDP external axis 2: servo ready"),
    Field(name="extAxisStatus_1_inPos", offset=657, type="u8", meaning="UDP external axis 2: in position"),
    Field(name="extAxisStatus_1_alarm", offset=658, type="u8", meaning="UDP external axis 2: servo alarm"),
    Field(name="extAxisStatus_1_flerr", offset=659, type="u8", meaning="UDP external axis 2: following error"),
    Field(name="extAxisStatus_1_nlimit", offset=660, type="u8", meaning="UDP external axis 2: negative limit"),
    Field(name="extAxisStatus_1_pLimit", offset=661, type="u8", meaning="UDP external axis 2: positive limit"),
    Field(
        name="extAxisStatus_1_mdbsOffLine",
        offset=662,
        type="u8",
        meaning="UDP external axis 2: drive offline on RS-485",
    ),
    Field(
        name="extAxisStatus_1_mdbsTimeout",
        offset=663,
        type="u8",
        meaning="UDP external axis 2: RS-485 timeout between control card and box",
    ),
    Field(name="extAxisStatus_1_homingStatus", offset=664, type="u8", meaning="UDP external axis 2: homing state"),
    Field(name="extAxisStatus_2_pos", offset=665, type="f64", meaning="UDP external axis 3: position, unit not stated"),
    Field(name="extAxisStatus_2_vel", offset=673, type="f64", meaning="UDP external axis 3: speed, unit not stated"),
    Field(name="extAxisStatus_2_errorCode", offset=681, type="i32", meaning="UDP external axis 3: error code"),
    Field(name="extAxisStatus_2_ready", offset=685, type="u8", meaning="UDP external axis 3: servo ready"),
    Field(name="extAxisStatus_2_inPos", offset=686, type="u8", meaning="UDP external axis 3: in position"),
    Field(name="extAxisStatus_2_alarm", offset=687, type="u8", meaning="UDP external axis 3: servo alarm"),
    Field(name="extAxisStatus_2_flerr", offset=688, type="u8", meaning="UDP external axis 3: following error"),
    Field(name="extAxisStatus_2_nlimit", offset=689, type="u8", meaning="UDP external axis 3: negative limit"),
    Field(name="extAxisStatus_2_pLimit", offset=690, type="u8", meaning="UDP external axis 3: positive limit"),
    Field(
        name="extAxisStatus_2_mdbsOffLine",
        offset=691,
        type="u8",
        meaning="UDP external axis 3: drive offline on RS-485",
    ),
    Field(
        name="extAxisStatus_2_mdbsTimeout",
        offset=692,
        type="u8",
        meaning="UDP external axis 3: RS-485 timeout between control card and box",
    ),
    Field(name="extAxisStatus_2_homingStatus", offset=693, type="u8", meaning="UDP external axis 3: homing state"),
    Field(name="extAxisStatus_3_pos", offset=694, type="f64", meaning="UDP external axis 4: position, unit not stated"),
    Field(name="extAxisStatus_3_vel", offset=702, type="f64", meaning="UDP external axis 4: speed, unit not stated"),
    Field(name="extAxisStatus_3_errorCode", offset=710, type="i32", meaning="UDP external axis 4: error code"),
    Field(name="extAxisStatus_3_ready", offset=714, type="u8", meaning="UDP external axis 4: servo ready"),
    Field(name="extAxisStatus_3_inPos", offset=715, type="u8", meaning="UDP external axis 4: in position"),
    Field(name="extAxisStatus_3_alarm", offset=716, type="u8", meaning="UDP external axis 4: servo alarm"),
    Field(name="extAxisStatus_3_flerr", offset=717, type="u8", meaning="UDP external axis 4: following error"),
    Field(name="extAxisStatus_3_nlimit", offset=718, type="u8", meaning="UDP external axis 4: negative limit"),
    Field(name="extAxisStatus_3_pLimit", offset=719, type="u8", meaning="UDP external axis 4: positive limit"),
    Field(
        name="extAxisStatus_3_mdbsOffLine",
        offset=720,
        type="u8",
        meaning="UDP external axis 4: drive offline on RS-485",
    ),
    Field(
        name="extAxisStatus_3_mdbsTimeout",
        offset=721,
        type="u8",
        meaning="UDP external axis 4: RS-485 timeout between control card and box",
    ),
    Field(name="extAxisStatus_3_homingStatus", offset=722, type="u8", meaning="UDP external axis 4: homing state"),
    Field(name="extDIState", offset=723, type="u16", count=8, meaning="Extension digital inputs, 8 words of 16 bits"),
    Field(name="extDOState", offset=739, type="u16", count=8, meaning="Extension digital outputs, 8 words of 16 bits"),
    Field(name="extAIState", offset=755, type="u16", count=4, meaning="Extension analog inputs"),
    Field(name="extAOState", offset=763, type="u16", count=4, meaning="Extension analog outputs"),
    Field(
        name="rbtEnableState",
        offset=771,
        type="i32",
        meaning="Robot enable state: 1 enabled; other values are not documented",
    ),
    Field(
        name="jointDriverTorque",
        offset=775,
        type="f64",
        count=6,
        unit="Nm",
        meaning="Joint torque reported by the drives",
    ),
    Field(
        name="jointDriverTemperature", offset=823, type="f64", count=6, unit="degC", meaning="Joint drive temperature"
    ),
    Field(name="robotTime_year", offset=871, type="u16", meaning="Controller clock: year"),
    Field(name="robotTime_mouth", offset=873, type="u8", meaning="Controller clock: month (vendor's spelling)"),
    Field(name="robotTime_day", offset=874, type="u8", meaning="Controller clock: day"),
    Field(name="robotTime_hour", offset=875, type="u8", meaning="Controller clock: hour"),
    Field(name="robotTime_minute", offset=876, type="u8", meaning="Controller clock: minute"),
    Field(name="robotTime_second", offset=877, type="u8", meaning="Controller clock: second"),
    Field(name="robotTime_millisecond", offset=878, type="u16", meaning="Controller clock: millisecond"),
    Field(name="softwareUpgradeState", offset=880, type="i32", meaning="Software upgrade state"),
    Field(
        name="endLuaErrCode",
        offset=884,
        type="u16",
        meaning="State of the Lua program at the tool end; the CNDE table says signal of the end button",
    ),
    Field(name="cl_analog_output_0", offset=886, type="u16", meaning="Control-box analog output AO0, raw 0-4095"),
    Field(name="cl_analog_output_1", offset=888, type="u16", meaning="Control-box analog output AO1, raw 0-4095"),
    Field(name="tl_analog_output", offset=890, type="u16", meaning="Tool analog output, raw 0-4095"),
    Field(name="gripperRotNum", offset=892, type="f32", meaning="Rotating gripper: turns"),
    Field(name="gripperRotSpeed", offset=896, type="u8", unit="%", meaning="Rotating gripper: speed"),
    Field(name="gripperRotTorque", offset=897, type="u8", unit="%", meaning="Rotating gripper: torque"),
    Field(name="weldingBreakOffState_breakOffState", offset=898, type="u8", meaning="Welding: 1 interrupted"),
    Field(name="weldingBreakOffState_weldArcState", offset=899, type="u8", meaning="Welding arc: 1 interrupted"),
    Field(name="jt_tgt_tor", offset=900, type="f64", count=6, unit="Nm", meaning="Commanded joint torques"),
    Field(name="smartToolState", offset=948, type="i32", meaning="Buttons of the SmartTool handle, bit pattern"),
    Field(
        name="wideVoltageCtrlBoxTemp",
        offset=952,
        type="f32",
        unit="degC",
        meaning="Temperature of the wide-voltage control box",
    ),
    Field(
        name="wideVoltageCtrlBoxFanVel",
        offset=956,
        type="u16",
        unit="mA",
        meaning="Fan current of the wide-voltage control box: the name says velocity, the value is a current",
    ),
    Field(
        name="toolCoord",
        offset=958,
        type="f64",
        count=6,
        unit="mm|deg",
        meaning="Active tool frame x y z rx ry rz, relative to the flange",
    ),
    Field(
        name="wobjCoord",
        offset=1006,
        type="f64",
        count=6,
        unit="mm|deg",
        meaning="Active workpiece frame x y z rx ry rz, relative to the base",
    ),
    Field(
        name="extoolCoord",
        offset=1054,
        type="f64",
        count=6,
        unit="mm|deg",
        meaning="Active external tool frame x y z rx ry rz",
    ),
    Field(
        name="exAxisCoord",
        offset=1102,
        type="f64",
        count=6,
        unit="mm|deg",
        meaning="Active extension-axis frame x y z rx ry rz",
    ),
    Field(name="load", offset=1150, type="f64", unit="kg", meaning="Payload mass"),
    Field(name="loadCog", offset=1158, type="f64", count=3, unit="mm", meaning="Payload centre of gravity x y z"),
    Field(
        name="lastServoTarget",
        offset=1182,
        type="f64",
        count=6,
        meaning="Last ServoJ target waiting in the queue; its unit is not established",
    ),
    Field(name="servoJCmdNum", offset=1230, type="i32", meaning="ServoJ command counter"),
    Field(name="targetJointPos", offset=1234, type="f64", count=6, unit="deg", meaning="Commanded joint positions"),
    Field(name="targetJointVel", offset=1282, type="f64", count=6, unit="deg/s", meaning="Commanded joint velocities"),
    Field(
        name="targetJointAcc", offset=1330, type="f64", count=6, unit="deg/s^2", meaning="Commanded joint accelerations"
    ),
    Field(name="targetJointCurrent", offset=1378, type="f64", count=6, unit="A", meaning="Commanded joint currents"),
    Field(name="actualJointCurrent", offset=1426, type="f64", count=6, unit="A", meaning="Actual joint currents"),
    Field(
        name="actualTCPForce",
        offset=1474,
        type="f64",
        count=6,
        unit="N|Nm",
        meaning="Force and moment at the robot end x y z rx ry rz; the vendor's pages disagree on the unit",
    ),
    Field(
        name="targetTCPPos",
        offset=1522,
        type="f64",
        count=6,
        unit="mm|deg",
        meaning="Commanded TCP pose x y z rx ry rz",
    ),
    Field(name="collisionLevel", offset=1570, type="u8", count=6, meaning="Collision level of each joint, 1-10"),
    Field(name="speedScaleManual", offset=1576, type="f64", unit="%", meaning="Global speed in manual mode, 0-100"),
    Field(name="speedScaleAuto", offset=1584, type="f64", unit="%", meaning="Global speed in automatic mode, 0-100"),
    Field(name="luaLineNum", offset=1592, type="i32", meaning="Line number of the running Lua program"),
    Field(
        name="abnomalStop", offset=1596, type="u8", meaning="Abnormal stop: 1 yes, 0 no (vendor's spelling of abnormal)"
    ),
    Field(name="currentLuaFileName", offset=1597, type="text", size=256, meaning="Name of the running Lua program"),
    Field(
        name="programTotalLine",
        offset=1853,
        type="u8",
        meaning="Number of lines of the Lua program: one byte, so it cannot tell more than 255",
    ),
    Field(
        name="safetyBoxSingal",
        offset=1854,
        type="u8",
        count=6,
        meaning="Button box: one byte for each button, 0 pressed, 1 released (vendor's spelling of signal)",
    ),
    Field(name="weldVoltage", offset=1860, type="f64", unit="V", meaning="Welding voltage"),
    Field(name="weldCurrent", offset=1868, type="f64", unit="A", meaning="Welding current"),
    Field(name="weldTrackVel", offset=1876, type="f64", unit="mm/s", meaning="Seam tracking speed"),
    Field(name="tpdException", offset=1884, type="u8", meaning="Too many TPD trajectories loaded: 1 yes, 0 no"),
    Field(
        name="alarmRebootRobot",
        offset=1885,
        type="u8",
        meaning="Power-cycle request: 0 none, 1 release the emergency stop and restart the box, 2 joint communication fault, restart the box",
    ),
    Field(
        name="modbusMasterConnect",
        offset=1886,
        type="u8",
        meaning="Modbus TCP masters 0-7, one bit each, 1 connected",
        flags=_bits("master_", 8, "Connected: Modbus TCP master"),
    ),
    Field(name="modbusSlaveConnect", offset=1887, type="u8", meaning="Modbus TCP slave: 1 connected, 0 not"),
    Field(name="btnBoxStopSignal", offset=1888, type="u8", meaning="Button-box emergency stop: 1 pressed, 0 released"),
    Field(
        name="dragAlarm",
        offset=1889,
        type="u8",
        meaning="Drag warning: 0 none, 1 warning (robot is in automatic mode), 2 position feedback fault, no switch-over",
    ),
    Field(name="safetyDoorAlarm", offset=1890, type="u8", meaning="Safety door: 1 open, 0 closed"),
    Field(name="safetyPlaneAlarm", offset=1891, type="u8", meaning="Safety wall entered: 1 yes, 0 no"),
    Field(
        name="motonAlarm", offset=1892, type="u8", meaning="Motion warning code, 0 none (vendor's spelling of motion)"
    ),
    Field(
        name="interfaceAlarm",
        offset=1893,
        type="u8",
        meaning="Interference zone entered: 1 yes, 0 no (vendor's spelling of interference)",
    ),
    Field(name="udpCmdState", offset=1894, type="i32", meaning="Connection state of the UDP command port 20007"),
    Field(name="weldReadyState", offset=1898, type="u8", meaning="Welder: 1 ready, 0 fault"),
    Field(
        name="alarmCheckEmergStopBtn",
        offset=1899,
        type="u8",
        meaning="Communication fault, check that the emergency stop is released: 1 fault, 0 normal",
    ),
    Field(name="tsTmCmdComError", offset=1900, type="u8", meaning="Torque command communication: 1 failed, 0 normal"),
    Field(name="tsTmStateComError", offset=1901, type="u8", meaning="Torque state communication: 1 failed, 0 normal"),
    Field(name="ctrlBoxError", offset=1902, type="i32", meaning="Control-box error code"),
    Field(name="safetyDataState", offset=1906, type="u8", meaning="Safety data: 1 abnormal, 0 normal"),
    Field(
        name="forceSensorErrState",
        offset=1907,
        type="u8",
        meaning="Force sensor connection timeout: bit 0 sensor 1, bit 1 sensor 2",
        flags=_bits("sensor_", 2, "Connection timeout of force sensor", first=1),
    ),
    Field(
        name="ctrlOpenLuaErrCode",
        offset=1908,
        type="u8",
        count=4,
        meaning="Error codes of the four controller peripheral protocols",
    ),
    Field(name="strangePosFlag", offset=1912, type="u8", meaning="Singular posture: 1 yes, 0 no"),
    Field(name="alarm", offset=1913, type="u8", meaning="Warning code, 0 none"),
    Field(name="driverAlarm", offset=1914, type="u8", meaning="Number of the axis whose drive warns, 0 none"),
    Field(name="aliveSlaveNumError", offset=1915, type="u8", meaning="Wrong number of active bus slaves: 1 yes, 0 no"),
    Field(
        name="slaveComError",
        offset=1916,
        type="u8",
        count=8,
        meaning="Bus slave state: 0 normal, 1 offline, 2 state differs from setting, 3 not configured, 4 configuration error, 5 initialisation error, 6 mailbox initialisation error",
    ),
    Field(name="cmdPointError", offset=1924, type="u8", meaning="Command point error code, 0 none"),
    Field(name="IOError", offset=1925, type="u8", meaning="I/O error code, 0 none"),
    Field(name="gripperError", offset=1926, type="u8", meaning="Gripper error: 1 motion timeout, 0 none"),
    Field(name="fileError", offset=1927, type="u8", meaning="Configuration file error code, 0 none"),
    Field(name="paraError", offset=1928, type="u8", meaning="Parameter error code, 0 none"),
    Field(
        name="exaxisOutLimitError",
        offset=1929,
        type="u8",
        meaning="External axis beyond its soft limit: axis number, 0 none",
    ),
    Field(
        name="driverComError",
        offset=1930,
        type="u8",
        count=6,
        meaning="Drive communication fault of each axis: 1 fault, 0 normal",
    ),
    Field(
        name="driverError",
        offset=1936,
        type="u8",
        meaning="Number of the axis with a drive fault, 0 none; the page says communication fault",
    ),
    Field(name="outSoftLimitError", offset=1937, type="u8", meaning="Joint beyond its soft limit: axis number, 0 none"),
    Field(
        name="axleGenComData",
        offset=1938,
        type="bytes",
        size=130,
        meaning="Data passed through from the tool end: byte 0 error code (0 normal, 1 no link between tool end and controller, 2 RS-485 fault), byte 1 length, then data",
    ),
    Field(
        name="socketConnTimeout",
        offset=2068,
        type="u8",
        meaning="Socket connect timeout; bits 0-3 are sockets 1-4",
        flags=_bits("socket_", 4, "Connect timeout of socket", first=1),
    ),
    Field(
        name="socketReadTimeout",
        offset=2069,
        type="u8",
        meaning="Socket read timeout; bits 0-3 are sockets 1-4",
        flags=_bits("socket_", 4, "Read timeout of socket", first=1),
    ),
    Field(
        name="tsWebStateComErr", offset=2070, type="u8", meaning="Web to torque-unit communication: 1 failed, 0 normal"
    ),
    Field(
        name="exaxisCoordID",
        offset=2071,
        type="u8",
        meaning="Number of the extension-axis frame in use (id 132, from 3.9.6)",
    ),
    Field(
        name="programRunState",
        offset=2072,
        type="u8",
        meaning="Program run state (id 133, from 3.9.8); its values are not documented",
    ),
)

CHECKSUM_SIZE = 2

# Total size of a frame -> the firmware that sends it. From 3.9.5 on the struct is a container that the SDKs fill from
# CNDE: no SDK reads such a frame from port 20004.
FIRMWARE = {
    584: "3.6, 3.7.1",
    609: "3.7.2, 3.7.3",
    773: "ROS 2 package V2.0",
    777: "3.7.4",
    888: "3.7.6",
    900: "3.7.7",
    902: "3.7.8 to 3.8.1",
    954: "3.8.2",
    960: "3.8.3 to 3.8.5",
    1184: "3.8.6",
    1236: "3.8.7 to 3.9.4",
    2073: "3.9.5, container only",
    2074: "3.9.6, container only",
    2075: "3.9.8, container only",
}
_LONGEST_SIZE = max(FIRMWARE)

# The longest frame that any SDK knows: every other legacy layout is a prefix of it.
LONGEST = Layout(
    name=str(_LONGEST_SIZE),
    size=_LONGEST_SIZE - CHECKSUM_SIZE,
    fields=_FIELDS,
    source=SOURCE,
    firmware=FIRMWARE[_LONGEST_SIZE],
)

LEGACY_LAYOUTS = (
    *(
        LONGEST.prefix(total - CHECKSUM_SIZE, name=str(total), firmware=firmware)
        for total, firmware in FIRMWARE.items()
        if total != _LONGEST_SIZE
    ),
    LONGEST,
)

STATUS_SOURCE = (
    "port 8083 of a controller v3.8.5.1, measured by ichbinmeraj/fairino-fws, 433 bytes; "
    "357 bytes: FAIR-INNOVATION/frcobot_ros2 V2.0, data_type_def.h"
)
_UNCONFIRMED = "Bytes whose meaning no measurement has confirmed"

# Port 8083: only what was confirmed on a real controller is a field; the rest is shown as it came.
STATUS_433 = Layout(
    name="433",
    size=431,
    fields=(
        Field(name="frame_head", offset=0, type="u16", meaning="Frame start, bytes 0x5A 0x5A"),
        Field(name="frame_cnt", offset=2, type="u8", meaning="Frame counter, wraps 0-255"),
        Field(name="data_len", offset=3, type="u16", meaning="Payload length: total frame length minus 7"),
        Field(name="program_state", offset=5, type="u8", meaning="Program state: 1 stopped, 2 running, 3 paused"),
        Field(name="unconfirmed_raw_6", offset=6, type="bytes", size=2, meaning=_UNCONFIRMED),
        Field(name="jt_cur_pos", offset=8, type="f64", count=6, unit="deg", meaning="Joint positions, axes 1-6"),
        Field(name="tl_cur_pos", offset=56, type="f64", count=6, unit="mm|deg", meaning="TCP pose x y z rx ry rz"),
        Field(name="unconfirmed_raw_104", offset=104, type="bytes", size=4, meaning=_UNCONFIRMED),
        Field(
            name="jt_cur_tor",
            offset=108,
            type="f64",
            count=6,
            unit="mNm",
            meaning="Joint torques, in thousandths of a Nm",
        ),
        Field(name="program_name", offset=156, type="text", size=20, meaning="Name of the program, cut at 20 bytes"),
        Field(name="unconfirmed_raw_176", offset=176, type="bytes", size=8, meaning=_UNCONFIRMED),
        Field(
            name="ft_sensor_data",
            offset=184,
            type="f64",
            count=6,
            unit="N|Nm",
            meaning="Force/torque fx fy fz tx ty tz",
        ),
        Field(
            name="unconfirmed_raw",
            offset=232,
            type="bytes",
            size=199,
            meaning=f"{_UNCONFIRMED}: all from here to the checksum",
        ),
    ),
    source=STATUS_SOURCE,
)
STATUS_357 = dataclasses.replace(
    STATUS_433,
    name="357",
    size=355,
    fields=(*STATUS_433.fields[:-1], dataclasses.replace(STATUS_433.fields[-1], size=123)),
)


@dataclass(frozen=True, slots=True)
class State:
    """One state that CNDE can be asked for, and the fields that hold it.

    Where the controller returns `type`, a packed state is the bytes of its fields as they stand in the legacy table; any
    other has its elements in its fields one after the other: all in one array, or one in each scalar. Unit, meaning and
    flags are those of the fields.

    Args:
        id: The vendor's enumeration, 3 to 133; None for a state that only the CNDE introduction names.
        name: What is asked for.
        type: The wire type in the vendor's tables; what the controller returns is the truth.
        fields: Names of fields of `LONGEST`; for a state without an id, of `CNDE_FIELDS`.
        packed: Whether `type` is only a number of bytes.
    """

    id: int | None
    name: str
    type: str
    fields: tuple[str, ...]
    packed: bool = False


def _members(struct: str) -> tuple[str, ...]:
    """The fields that a sub-struct is opened into."""
    return tuple(field.name for field in _FIELDS if field.name.startswith(f"{struct}_"))


# ids 26, 59 and 64 are two names each
STATES = (
    State(3, "program_state", "UINT8", ("program_state",)),
    State(4, "robot_state", "UINT8", ("robot_state",)),
    State(5, "main_code", "INT32", ("main_code",)),
    State(6, "sub_code", "INT32", ("sub_code",)),
    State(7, "robot_mode", "UINT8", ("robot_mode",)),
    State(8, "actual_joint_pos", "DOUBLE_6", ("jt_cur_pos",)),
    State(9, "actual_TCP_pos", "DOUBLE_6", ("tl_cur_pos",)),
    State(10, "actual_flange_pos", "DOUBLE_6", ("flange_cur_pos",)),
    State(11, "actual_joint_vel", "DOUBLE_6", ("actual_qd",)),
    State(12, "actual_joint_acc", "DOUBLE_6", ("actual_qdd",)),
    State(13, "target_TCP_cmpvel", "DOUBLE_2", ("target_TCP_CmpSpeed",)),
    State(14, "target_TCP_vel", "DOUBLE_6", ("target_TCP_Speed",)),
    State(15, "actual_TCP_cmpvel", "DOUBLE_2", ("actual_TCP_CmpSpeed",)),
    State(16, "actual_TCP_vel", "DOUBLE_6", ("actual_TCP_Speed",)),
    State(17, "actual_joint_torque", "DOUBLE_6", ("jt_cur_tor",)),
    State(18, "tool_id", "INT32", ("tool",)),
    State(19, "wobj_id", "INT32", ("user",)),
    State(20, "cfg_DO_box", "UINT8", ("cl_dgt_output_h",)),
    State(21, "std_DO_box", "UINT8", ("cl_dgt_output_l",)),
    State(22, "cfg_DO_tool", "UINT8", ("tl_dgt_output_l",)),
    State(23, "cfg_DI_box", "UINT8", ("cl_dgt_input_h",)),
    State(24, "std_DI_box", "UINT8", ("cl_dgt_input_l",)),
    State(25, "cfg_DI_tool", "UINT8", ("tl_dgt_input_l",)),
    State(26, "std_AI0_box", "DOUBLE", ("cl_analog_input_0",)),
    State(26, "std_AI1_box", "DOUBLE", ("cl_analog_input_1",)),
    State(27, "std_AI_tool", "DOUBLE", ("tl_anglog_input",)),
    State(28, "ft_sensor_raw_data", "DOUBLE_6", ("ft_sensor_raw_data",)),
    State(29, "ft_sensor_data", "DOUBLE_6", ("ft_sensor_data",)),
    State(30, "ft_sensor_active", "UINT8", ("ft_sensor_active",)),
    State(31, "emergency_stop", "UINT8", ("EmergencyStop",)),
    State(32, "motion_done", "INT32", ("motion_done",)),
    State(33, "gripper_motion_done", "UINT8", ("gripper_motiondone",)),
    State(34, "motion_queue_len", "INT32", ("mc_queue_len",)),
    State(35, "collision_state", "UINT8", ("collisionState",)),
    State(36, "trajectory_pnum", "INT32", ("trajectory_pnum",)),
    State(37, "safety_stop0_state", "UINT8", ("safety_stop0_state",)),
    State(38, "safety_stop1_state", "UINT8", ("safety_stop1_state",)),
    State(39, "gripper_fault_id", "UINT8", ("gripper_fault_id",)),
    State(40, "gripper_fault", "INT32", ("gripper_fault",)),
    State(41, "gripper_active", "INT32", ("gripper_active",)),
    State(42, "gripper_position", "UINT8", ("gripper_position",)),
    State(43, "gripper_speed", "INT32", ("gripper_speed",)),
    State(44, "gripper_current", "INT32", ("gripper_current",)),
    State(45, "gripper_temp", "INT32", ("gripper_temp",)),
    State(46, "gripper_voltage", "INT32", ("gripper_voltage",)),
    State(47, "aux_axis_state", "UINT8_25", _members("auxState"), packed=True),
    State(48, "exaxis_status", "UINT8_116", _members("extAxisStatus"), packed=True),
    State(49, "ext_DI_state", "UINT8_16", ("extDIState",), packed=True),
    State(50, "ext_DO_state", "UINT8_16", ("extDOState",), packed=True),
    State(51, "ext_AI_state", "INT32_4", ("extAIState",)),
    State(52, "ext_AO_state", "INT32_4", ("extAOState",)),
    State(53, "rbt_enable_state", "INT32", ("rbtEnableState",)),
    State(54, "joint_driver_torque", "DOUBLE_6", ("jointDriverTorque",)),
    State(55, "actual_joint_temp", "DOUBLE_6", ("jointDriverTemperature",)),
    State(56, "robot_time", "INT32_7", _members("robotTime")),
    State(57, "software_upgrade_state", "INT32", ("softwareUpgradeState",)),
    State(58, "end_lua_err_code", "INT32", ("endLuaErrCode",)),
    State(59, "std_AO0_box", "DOUBLE", ("cl_analog_output_0",)),
    State(59, "std_AO1_box", "DOUBLE", ("cl_analog_output_1",)),
    State(60, "std_AO_tool", "DOUBLE", ("tl_analog_output",)),
    State(61, "rotating_gripper_num", "DOUBLE", ("gripperRotNum",)),
    State(62, "rotating_gripper_speed", "UINT8", ("gripperRotSpeed",)),
    State(63, "rotating_gripper_tor", "UINT8", ("gripperRotTorque",)),
    State(64, "weld_break_off_state", "UINT8", ("weldingBreakOffState_breakOffState",)),
    State(64, "weld_arc_state", "UINT8", ("weldingBreakOffState_weldArcState",)),
    State(65, "target_joint_torque", "DOUBLE_6", ("jt_tgt_tor",)),
    State(66, "smarttool_state", "UINT32", ("smartToolState",)),
    State(67, "wide_voltage_ctrl_box_temp", "DOUBLE", ("wideVoltageCtrlBoxTemp",)),
    State(68, "wide_voltage_ctrl_box_fan_current", "INT32", ("wideVoltageCtrlBoxFanVel",)),
    State(69, "tool_coord", "DOUBLE_6", ("toolCoord",)),
    State(70, "wobj_coord", "DOUBLE_6", ("wobjCoord",)),
    State(71, "exTool_coord", "DOUBLE_6", ("extoolCoord",)),
    State(72, "exAxis_coord", "DOUBLE_6", ("exAxisCoord",)),
    State(73, "payload", "DOUBLE", ("load",)),
    State(74, "pay_cog", "DOUBLE_3", ("loadCog",)),
    State(75, "last_servoJ_target", "DOUBLE_6", ("lastServoTarget",)),
    State(76, "servoJ_cmd_num", "INT32", ("servoJCmdNum",)),
    State(77, "target_joint_pos", "DOUBLE_6", ("targetJointPos",)),
    State(78, "target_joint_vel", "DOUBLE_6", ("targetJointVel",)),
    State(79, "target_joint_acc", "DOUBLE_6", ("targetJointAcc",)),
    State(80, "target_joint_current", "DOUBLE_6", ("targetJointCurrent",)),
    State(81, "actual_joint_current", "DOUBLE_6", ("actualJointCurrent",)),
    State(82, "actual_TCP_force", "DOUBLE_6", ("actualTCPForce",)),
    State(83, "target_TCP_pos", "DOUBLE_6", ("targetTCPPos",)),
    State(84, "collision_level", "UINT8_6", ("collisionLevel",)),
    State(85, "speed_scaling_man", "DOUBLE", ("speedScaleManual",)),
    State(86, "speed_scaling_auto", "DOUBLE", ("speedScaleAuto",)),
    State(87, "line_number", "INT32", ("luaLineNum",)),
    State(88, "abnormal_stop", "UINT8", ("abnomalStop",)),
    State(89, "cur_lua_file_name", "UINT8_256", ("currentLuaFileName",), packed=True),
    State(90, "prog_total_line", "UINT8", ("programTotalLine",)),
    State(91, "safety_box_signal", "UINT8_6", ("safetyBoxSingal",)),
    State(92, "welding_voltage", "DOUBLE", ("weldVoltage",)),
    State(93, "welding_current", "DOUBLE", ("weldCurrent",)),
    State(94, "welding_track_speed", "DOUBLE", ("weldTrackVel",)),
    State(95, "tpd_exception", "UINT8", ("tpdException",)),
    State(96, "alarm_reboot_robot", "UINT8", ("alarmRebootRobot",)),
    State(97, "modbus_master_connect", "UINT8", ("modbusMasterConnect",)),
    State(98, "modbus_slave_connect", "UINT8", ("modbusSlaveConnect",)),
    State(99, "btn_box_stop_signal", "UINT8", ("btnBoxStopSignal",)),
    State(100, "drag_alarm", "UINT8", ("dragAlarm",)),
    State(101, "safety_door_alarm", "UINT8", ("safetyDoorAlarm",)),
    State(102, "safety_plane_alarm", "UINT8", ("safetyPlaneAlarm",)),
    State(103, "motion_alarm", "UINT8", ("motonAlarm",)),
    State(104, "interfere_alarm", "UINT8", ("interfaceAlarm",)),
    State(105, "udp_cmd_state", "INT32", ("udpCmdState",)),
    State(106, "weld_ready_state", "UINT8", ("weldReadyState",)),
    State(107, "alarm_check_emerg_stop_btn", "UINT8", ("alarmCheckEmergStopBtn",)),
    State(108, "ts_tm_cmd_com_error", "UINT8", ("tsTmCmdComError",)),
    State(109, "ts_tm_state_com_error", "UINT8", ("tsTmStateComError",)),
    State(110, "ctrl_box_error", "INT32", ("ctrlBoxError",)),
    State(111, "safety_data_state", "UINT8", ("safetyDataState",)),
    State(112, "force_sensor_err_state", "UINT8", ("forceSensorErrState",)),
    State(113, "ctrl_open_lua_errcode", "UINT8_4", ("ctrlOpenLuaErrCode",)),
    State(114, "strange_pos_flag", "UINT8", ("strangePosFlag",)),
    State(115, "alarm", "UINT8", ("alarm",)),
    State(116, "dr_alarm", "UINT8", ("driverAlarm",)),
    State(117, "alive_slave_num_error", "UINT8", ("aliveSlaveNumError",)),
    State(118, "slave_com_error", "UINT8_8", ("slaveComError",)),
    State(119, "cmd_point_error", "UINT8", ("cmdPointError",)),
    State(120, "IO_error", "UINT8", ("IOError",)),
    State(121, "gripper_error", "UINT8", ("gripperError",)),
    State(122, "file_error", "UINT8", ("fileError",)),
    State(123, "para_error", "UINT8", ("paraError",)),
    State(124, "exaxis_out_slimit_error", "UINT8", ("exaxisOutLimitError",)),
    State(125, "dr_com_err", "UINT8_6", ("driverComError",)),
    State(126, "dr_err", "UINT8", ("driverError",)),
    State(127, "out_sflimit_err", "UINT8", ("outSoftLimitError",)),
    State(128, "axle_gen_com_data", "UINT8_130", ("axleGenComData",), packed=True),
    State(129, "socket_conn_timeout", "UINT8", ("socketConnTimeout",)),
    State(130, "socket_read_timeout", "UINT8", ("socketReadTimeout",)),
    State(131, "ts_web_state_com_err", "UINT8", ("tsWebStateComErr",)),
    State(132, "exaxis_coord_id", "UINT8", ("exaxisCoordID",)),
    State(133, "program_run_state", "UINT8", ("programRunState",)),
)

# States that only the CNDE introduction names; their fields exist in no legacy frame, so they have no offset there.
CNDE_FIELDS = (
    Field(name="run_up_time", offset=0, type="f64", unit="s", meaning="Time since power-on"),
    Field(name="timestamp_us", offset=0, type="u64", unit="us", meaning="Controller's system time"),
    Field(name="servoj_time", offset=0, type="u64", count=5, meaning="ServoJ time stamps, ns"),
)
CNDE_STATES = (
    State(None, "run_up_time", "DOUBLE", ("run_up_time",)),
    State(None, "timestamp_us", "UINT64", ("timestamp_us",)),
    State(None, "servoj_time", "UINT64_5", ("servoj_time",)),
)
