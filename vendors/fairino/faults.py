"""The faults and warnings that FAIRINO controllers report in some fifty fields, as one table.

A field whose 0 is not documented as "none", or of which the vendor's own pages disagree (`endLuaErrCode`), is no row.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

from gateway.api.model import Fault, Severity

_AXES = range(1, 7)

_SLAVE_TEXTS = {
    1: "slave offline",
    2: "slave state differs from its setting",
    3: "slave not configured",
    4: "slave configuration error",
    5: "slave initialization error",
    6: "slave mailbox communication initialization error",
}
_REBOOT_TEXTS = {
    1: "release the emergency stop and power-cycle the control box",
    2: "joint communication fault: power-cycle the control box",
}
_DRAG_TEXTS = {1: "drag warning: automatic mode", 2: "position feedback abnormal, no switch-over"}


@dataclass(frozen=True, slots=True)
class _Row:
    """A field that is 0 while all is well.

    Args:
        source: The field: a code, or an array of codes.
        severity: As the vendor's name of the field says; None where it says nothing.
        texts: The vendor's words, by code.
        names_axis: Whether the value is the number of an axis, from 1.
        per_axis: Whether the elements belong to the axes.
    """

    source: str
    severity: Severity | None = Severity.ERROR
    texts: Mapping[int, str] = field(default_factory=dict)
    names_axis: bool = False
    per_axis: bool = False

    def faults(self, value: int | list[int]) -> Iterator[Fault]:
        """What a value of the field reports."""
        if isinstance(value, list):
            yield from (fault for index, code in enumerate(value) if code for fault in (self._element(index, code),))
        elif value and self.names_axis and value in _AXES:
            yield Fault(self.source, severity=self.severity, joint=value - 1)
        elif value:
            yield Fault(self.source, main=value, severity=self.severity, text=self.texts.get(value))

    def _element(self, index: int, code: int) -> Fault:
        text = self.texts.get(code)
        if self.per_axis:
            return Fault(self.source, main=code, severity=self.severity, text=text, joint=index)
        return Fault(f"{self.source}[{index}]", main=code, severity=self.severity, text=text)


_WARNING = Severity.WARNING
_ROWS = (
    _Row("gripper_fault"),
    _Row("auxState_servoErrCode"),
    *(_Row(f"extAxisStatus_{axis}_errorCode") for axis in range(4)),
    _Row("abnomalStop", texts={1: "abnormal stop"}),
    _Row("tpdException", None, {1: "too many TPD trajectories loaded"}),
    _Row("alarmRebootRobot", _WARNING, _REBOOT_TEXTS),
    _Row("dragAlarm", _WARNING, _DRAG_TEXTS),
    _Row("safetyDoorAlarm", _WARNING, {1: "safety door open"}),
    _Row("safetyPlaneAlarm", _WARNING, {1: "safety wall entered"}),
    _Row("motonAlarm", _WARNING),
    _Row("interfaceAlarm", _WARNING, {1: "interference zone entered"}),
    _Row("alarmCheckEmergStopBtn", texts={1: "communication abnormal: check whether the emergency stop is released"}),
    _Row("tsTmCmdComError", texts={1: "torque command communication failed"}),
    _Row("tsTmStateComError", texts={1: "torque state communication failed"}),
    _Row("ctrlBoxError"),
    _Row("safetyDataState", texts={1: "safety data abnormal"}),
    _Row("forceSensorErrState"),
    _Row("ctrlOpenLuaErrCode"),
    _Row("alarm", _WARNING),
    _Row("driverAlarm", _WARNING, names_axis=True),
    _Row("aliveSlaveNumError", texts={1: "wrong number of active slaves"}),
    _Row("slaveComError", texts=_SLAVE_TEXTS),
    _Row("cmdPointError"),
    _Row("IOError"),
    _Row("gripperError", texts={1: "gripper motion timeout"}),
    _Row("fileError"),
    _Row("paraError"),
    _Row("exaxisOutLimitError"),
    _Row("driverComError", texts={1: "drive communication fault"}, per_axis=True),
    _Row("driverError", names_axis=True),
    _Row("outSoftLimitError", names_axis=True),
    _Row("tsWebStateComErr", texts={1: "Web to torque unit communication failed"}),
)

FAULT_FIELDS = ("main_code", "sub_code", *(row.source for row in _ROWS))


def faults(main_code: int | None, sub_code: int | None, *values: int | list[int] | None) -> list[Fault] | None:
    """Every fault and warning that the frame shows; null where it has no such field at all."""
    if main_code is None and sub_code is None and all(value is None for value in values):
        return None
    found = []
    if main_code or sub_code:
        found.append(Fault("main_code", main=main_code, sub=sub_code, severity=Severity.ERROR))
    for row, value in zip(_ROWS, values, strict=True):
        if value:
            found += row.faults(value)
    return found


def in_error(main_code: int | None, sub_code: int | None, *values: int | list[int] | None) -> bool | None:
    """Whether any fault is an error. That there is none is known only where the fault codes are in the frame."""
    found = faults(main_code, sub_code, *values)
    if found and any(fault.severity is Severity.ERROR for fault in found):
        return True
    return None if main_code is None or sub_code is None else False
