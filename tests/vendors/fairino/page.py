"""The page's structs, transcribed apart from the table: the C# declarations in their order, and nothing else.

Source: FAIRINO, Data Structure Description, 2.8 to 2.10. EXT_AXIS_STATUS and ROBOT_TIME are not on the page: their
members are those of the vendor's SDKs (FAIR-INNOVATION/fairino-cpp-sdk, robot_types.h).
"""

from __future__ import annotations

import re
from collections.abc import Iterator

ROBOT_STATE_PKG = """
UInt16 frame_head
byte frame_cnt
UInt16 data_len
byte program_state
byte robot_state
int main_code
int sub_code
byte robot_mode
double[6] jt_cur_pos
double[6] tl_cur_pos
double[6] flange_cur_pos
double[6] actual_qd
double[6] actual_qdd
double[2] target_TCP_CmpSpeed
double[6] target_TCP_Speed
double[2] actual_TCP_CmpSpeed
double[6] actual_TCP_Speed
double[6] jt_cur_tor
int tool
int user
byte cl_dgt_output_h
byte cl_dgt_output_l
byte tl_dgt_output_l
byte cl_dgt_input_h
byte cl_dgt_input_l
byte tl_dgt_input_l
UInt16[2] cl_analog_input
UInt16 tl_anglog_input
double[6] ft_sensor_raw_data
double[6] ft_sensor_data
byte ft_sensor_active
byte EmergencyStop
int motion_done
byte gripper_motiondone
int mc_queue_len
byte collisionState
int trajectory_pnum
byte safety_stop0_state
byte safety_stop1_state
byte gripper_fault_id
UInt16 gripper_fault
UInt16 gripper_active
byte gripper_position
byte gripper_speed
byte gripper_current
int gripper_temp
int gripper_voltage
ROBOT_AUX_STATE auxState
EXT_AXIS_STATUS[4] extAxisStatus
UInt16[8] extDIState
UInt16[8] extDOState
UInt16[4] extAIState
UInt16[4] extAOState
int rbtEnableState
double[6] jointDriverTorque
double[6] jointDriverTemperature
ROBOT_TIME robotTime
int softwareUpgradeState
UInt16 endLuaErrCode
UInt16[2] cl_analog_output
UInt16 tl_analog_output
float gripperRotNum
byte gripperRotSpeed
byte gripperRotTorque
WELDING_BREAKOFF_STATE weldingBreakOffState
double[6] jt_tgt_tor
int smartToolState
float wideVoltageCtrlBoxTemp
UInt16 wideVoltageCtrlBoxFanVel
double[6] toolCoord
double[6] wobjCoord
double[6] extoolCoord
double[6] exAxisCoord
double load
double[3] loadCog
double[6] lastServoTarget
int servoJCmdNum
double[6] targetJointPos
double[6] targetJointVel
double[6] targetJointAcc
double[6] targetJointCurrent
double[6] actualJointCurrent
double[6] actualTCPForce
double[6] targetTCPPos
byte[6] collisionLevel
double speedScaleManual
double speedScaleAuto
int luaLineNum
byte abnomalStop
byte[256] currentLuaFileName
byte programTotalLine
byte[6] safetyBoxSingal
double weldVoltage
double weldCurrent
double weldTrackVel
byte tpdException
byte alarmRebootRobot
byte modbusMasterConnect
byte modbusSlaveConnect
byte btnBoxStopSignal
byte dragAlarm
byte safetyDoorAlarm
byte safetyPlaneAlarm
byte motonAlarm
byte interfaceAlarm
int udpCmdState
byte weldReadyState
byte alarmCheckEmergStopBtn
byte tsTmCmdComError
byte tsTmStateComError
int ctrlBoxError
byte safetyDataState
byte forceSensorErrState
byte[4] ctrlOpenLuaErrCode
byte strangePosFlag
byte alarm
byte driverAlarm
byte aliveSlaveNumError
byte[8] slaveComError
byte cmdPointError
byte IOError
byte gripperError
byte fileError
byte paraError
byte exaxisOutLimitError
byte[6] driverComError
byte driverError
byte outSoftLimitError
byte[130] axleGenComData
byte socketConnTimeout
byte socketReadTimeout
byte tsWebStateComErr
UInt16 check_sum
"""

# Behind tsWebStateComErr in the SDKs of 3.9.6 and 3.9.8; the checksum moves on.
LATER = """
byte exaxisCoordID
byte programRunState
"""

STRUCTS = {
    "ROBOT_AUX_STATE": """
        byte servoId
        int servoErrCode
        int servoState
        double servoPos
        float servoVel
        float servoTorque
    """,
    "EXT_AXIS_STATUS": """
        double pos
        double vel
        int errorCode
        byte ready
        byte inPos
        byte alarm
        byte flerr
        byte nlimit
        byte pLimit
        byte mdbsOffLine
        byte mdbsTimeout
        byte homingStatus
    """,
    "ROBOT_TIME": """
        UInt16 year
        byte mouth
        byte day
        byte hour
        byte minute
        byte second
        UInt16 millisecond
    """,
    "WELDING_BREAKOFF_STATE": """
        byte breakOffState
        byte weldArcState
    """,
}

CODES = {"byte": "B", "UInt16": "H", "int": "i", "float": "f", "double": "d"}
_ROW = re.compile(r"(\w+?)(?:\[(\d+)\])? (\w+)")


def members(declarations: str) -> Iterator[tuple[str, str, int | None]]:
    """The name, type and count of each declaration; a count of None is a scalar."""
    for line in filter(None, map(str.strip, declarations.splitlines())):
        found = _ROW.fullmatch(line)
        assert found is not None, line
        kind, count, name = found.groups()
        yield name, kind, int(count) if count else None


def scalars() -> Iterator[tuple[str, str, int]]:
    """Every scalar or array up to the checksum: its name, its C# type, and how many; structs are opened."""
    for name, kind, count in members(ROBOT_STATE_PKG + LATER):
        if name == "check_sum":
            continue
        if kind not in STRUCTS:
            yield name, kind, count or 1
            continue
        for index in range(count or 1):
            prefix = f"{name}_{index}" if count else name
            for member, member_kind, member_count in members(STRUCTS[kind]):
                yield f"{prefix}_{member}", member_kind, member_count or 1
