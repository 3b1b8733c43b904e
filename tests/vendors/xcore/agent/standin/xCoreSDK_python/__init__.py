"""A stand-in for the vendor's SDK, made from the documented names: for any Python from 3.8, and without its binary.

What it does wrong is told by the dict BEHAVIOUR, or as JSON in the environment variable XCORE_STANDIN:
`hang` {call: seconds}, `abort` call, `fail` {call: [ec, message]}, `raise` {call: text}, `external` number of values
beyond the axes, `axes`, `nan` true, `events` true. Every call of a robot's method is noted in CALLS, and in the file
that XCORE_STANDIN_CALLS names.
"""
# ruff: noqa: N801, N802, N999, FBT001, ANN401, ARG002, C408 - the SDK's names, not ours

from __future__ import annotations

import enum
import json
import os
import threading
import time
from typing import Any, Callable, Dict, List  # noqa: UP035 - Python 3.8

BEHAVIOUR: Dict[str, Any] = json.loads(os.environ.get("XCORE_STANDIN", "{}"))  # noqa: UP006 - Python 3.8
CALLS: List[str] = []  # noqa: UP006 - the same


def _enum(name: str, **members: int) -> Any:
    return enum.Enum(name, members)


PowerState = _enum("PowerState", on=0, off=1, estop=2, gstop=3, unknown=-1)
OperateMode = _enum("OperateMode", manual=0, automatic=1, unknown=-1)
OperationState = _enum("OperationState", idle=0, jog=1, moving=9, unknown=-1)
CoordinateType = _enum("CoordinateType", flangeInBase=0, endInRef=1)
CartesianPositionOffsetType = _enum("CartesianPositionOffsetType", none=0, offs=1, relTool=2)
MoveCFCommandRotType = _enum("MoveCFCommandRotType", constPose=0, rotAxis=1, fixedAxis=2)
Event = _enum("Event", moveExecution=0, safety=1, rlExecution=2, logReporter=3)
LogInfoLevel = _enum("LogInfoLevel", info=0, warning=1, error=2)


class NetworkException(Exception):  # noqa: N818 - the SDK's name
    pass


class _Record:
    def __init__(self, **values: Any) -> None:
        for key, value in values.items():
            setattr(self, key, value)


class Info(_Record):
    pass


class LogInfo(_Record):
    pass


class KeyPadState(_Record):
    pass


class RLProjectInfo(_Record):
    pass


class Frame:
    def __init__(self, pose: Any = (0.0,) * 6) -> None:
        self.trans = list(pose[:3])
        self.rpy = list(pose[3:])
        self.pos = [0.0] * 16


class CartesianPosition(Frame):
    def __init__(self, pose: Any = (0.0,) * 6) -> None:
        super().__init__(pose)
        self.elbow = 0.0
        self.hasElbow = False
        self.confData: Any = []
        self.external: Any = []


class CartesianPositionOffset:
    def __init__(self) -> None:
        self.type = CartesianPositionOffsetType.none
        self.frame = Frame()


class JointPosition:
    def __init__(self, joints: Any) -> None:
        self.joints = list(joints)
        self.external: Any = []


class Load:
    def __init__(self, mass: float, cog: Any, inertia: Any) -> None:
        self.mass, self.cog, self.inertia = mass, cog, inertia


class Toolset:
    def __init__(self) -> None:
        self.load = Load(1.5, [0.0, 0.0, 0.1], [0.0, 0.0, 0.0])
        self.end, self.ref = Frame(), Frame()


class WorkToolInfo:
    def __init__(self, name: str) -> None:
        self.name, self.alias, self.robotHeld = name, "", True
        self.pos, self.load = Frame(), Load(0.0, [0.0] * 3, [0.0] * 3)


class _Move:
    def __init__(self, target: Any, speed: float = -1.0, zone: float = -1.0) -> None:
        self.target = target
        self.speed, self.zone, self.customInfo = speed, zone, ""


class MoveAbsJCommand(_Move):
    def __init__(self, target: Any, speed: float = -1.0, zone: float = -1.0) -> None:
        super().__init__(target, speed, zone)
        self.jointSpeed = -1.0


class MoveJCommand(MoveAbsJCommand):
    def __init__(self, target: Any, speed: float = -1.0, zone: float = -1.0) -> None:
        super().__init__(target, speed, zone)
        self.offset = CartesianPositionOffset()


class MoveLCommand(_Move):
    def __init__(self, target: Any, speed: float = -1.0, zone: float = -1.0) -> None:
        super().__init__(target, speed, zone)
        self.rotSpeed = -1.0
        self.offset = CartesianPositionOffset()


class MoveCFCommand(_Move):
    """The stub shows neither target nor aux."""

    def __init__(self, angle: float) -> None:
        super().__init__(None)
        del self.target
        self.angle = angle
        self.rotType = MoveCFCommandRotType.rotAxis


class MoveSPCommand(_Move):
    def __init__(self, target: Any, radius: float, direction: bool) -> None:
        super().__init__(target)
        self.targetOffset = CartesianPositionOffset()
        self.radius, self.radius_step, self.angle, self.direction = radius, 0.0, 0.0, direction


class MoveWaitCommand:
    def __init__(self, duration: Any) -> None:
        self.duration_ = duration


class _Box:
    def __init__(self) -> None:
        self._content: Any = None

    def content(self) -> Any:
        return self._content

    def fill(self, content: Any) -> None:
        self._content = content


PyString = PyTypeBool = PyTypeInt = PyTypeFloat = _Box
PyTypeVectorBool = PyTypeVectorInt = PyTypeVectorFloat = PyTypeVectorArrayDouble2 = _Box


def _note(name: str) -> None:
    CALLS.append(name)
    file = os.environ.get("XCORE_STANDIN_CALLS")
    if file:
        with open(file, "a", encoding="utf-8") as calls:  # noqa: PTH123 - as short as it gets
            calls.write(name + "\n")


def _misbehave(name: str, args: Any) -> bool:
    if BEHAVIOUR.get("abort") == name:
        os.abort()
    time.sleep(BEHAVIOUR.get("hang", {}).get(name, 0.0))
    if name in BEHAVIOUR.get("raise", {}):
        raise NetworkException(BEHAVIOUR["raise"][name])
    ec = next((value for value in args if isinstance(value, dict)), {})
    number, message = BEHAVIOUR.get("fail", {}).get(name, (0, ""))
    ec.update(ec=number, message=message)
    return bool(number == 0)


class _Robot:
    def __init__(self, remoteIP: str = "", localIP: str = "") -> None:  # noqa: N803 - the SDK's names
        self.address = (remoteIP, localIP)
        self.watchers: Dict[str, Any] = {}  # noqa: UP006 - Python 3.8
        self.n_issued = 0

    def __getattribute__(self, name: str) -> Any:
        found = object.__getattribute__(self, name)
        if name.startswith("_") or name == "fire" or not callable(found):
            return found

        def call(*args: Any, **kwargs: Any) -> Any:
            _note(name)
            good = _misbehave(name, (*args, *kwargs.values()))
            value = found(*args, **kwargs)
            return value if good else None

        return call

    def fire(self, event: str, info: Any) -> None:
        """Call a watcher as the SDK does: on a thread of its own."""
        thread = threading.Thread(target=self.watchers[event], args=(info,), daemon=True)
        thread.start()
        thread.join(5)

    def connectToRobot(self, remoteIP: str, localIP: str = "") -> None:  # noqa: N803 - the SDK's names
        self.address = (remoteIP, localIP)

    def disconnectFromRobot(self, ec: Any) -> None:
        pass

    @staticmethod
    def sdkVersion() -> str:
        return "0.7.1"

    def robotInfo(self, ec: Any) -> Any:
        return Info(id="u1", mac="", version="3.2.1", type="stand-in", joint_num=BEHAVIOUR.get("axes", 6))

    def _joints(self) -> Any:
        values = [0.1 * index for index in range(BEHAVIOUR.get("axes", 6))]
        if BEHAVIOUR.get("nan"):
            values[0] = float("nan")
        return values + [9.0] * BEHAVIOUR.get("external", 0)

    def jointPos(self, ec: Any) -> Any:
        return self._joints()

    def jointVel(self, ec: Any) -> Any:
        return self._joints()

    def jointTorque(self, ec: Any) -> Any:
        return [1.0] * BEHAVIOUR.get("axes", 6)

    def posture(self, ct: Any, ec: Any) -> Any:
        return [float(ct.value), 0.0, 0.5, 3.1, 0.0, 3.1]

    def cartPosture(self, ct: Any, ec: Any) -> Any:
        return CartesianPosition([0.4, 0.0, 0.5, 3.1, 0.0, 3.1])

    def powerState(self, ec: Any) -> Any:
        return PowerState.on

    def operateMode(self, ec: Any) -> Any:
        return OperateMode.automatic

    def operationState(self, ec: Any) -> Any:
        return OperationState.idle

    def baseFrame(self, ec: Any) -> Any:
        return [0.0] * 6

    def toolset(self, ec: Any) -> Any:
        return Toolset()

    def toolsInfo(self, ec: Any) -> Any:
        return [WorkToolInfo("tool0")] * BEHAVIOUR.get("tools", 1)

    def wobjsInfo(self, ec: Any) -> Any:
        return [WorkToolInfo("wobj0")]

    def projectsInfo(self, ec: Any) -> Any:
        return [RLProjectInfo(name="p", taskList=["t1", "t2"])]

    def getDI(self, board: int, port: int, ec: Any) -> bool:
        return port % 2 == 1

    def getDO(self, board: int, port: int, ec: Any) -> bool:
        return True

    def getAI(self, board: int, port: int, ec: Any) -> float:
        return 2.5

    def readRegister(self, name: str, index: int, value: Any, ec: Any) -> None:
        value.fill([1, 2, 3] if name.endswith("s") else index + 0.5)

    def getSoftLimit(self, limits: Any, ec: Any) -> bool:
        limits.fill([[-3.0, 3.0]] * 6)
        return True

    def getKeypadState(self, ec: Any) -> Any:
        return KeyPadState(**{f"key{key}_state": key == 1 for key in range(1, 8)})

    def queryControllerLog(self, count: int, level: Any, ec: Any, offset: int = 0) -> Any:
        if level and LogInfoLevel.error not in level:
            return []
        return [LogInfo(id=50002, timestamp="2026-01-01 00:00:00", content="servo", repair="reset")]

    def setEventWatcher(self, eventType: Any, callback: Callable[[Any], None], ec: Any) -> None:  # noqa: N803
        self.watchers[eventType.name] = callback
        if BEHAVIOUR.get("events") and eventType.name == "logReporter":
            threading.Thread(target=self._report, daemon=True).start()

    def _report(self) -> None:
        for _ in range(20):
            time.sleep(0.1)
            self.watchers["moveExecution"](dict(cmdID="7", reachTarget=True, wayPointIndex=0, error=0, remark=""))
            self.watchers["logReporter"]({"Ecode": "50002"})

    def setNoneEventWatcher(self, eventType: Any, ec: Any) -> None:  # noqa: N803
        self.watchers.pop(eventType.name, None)

    def setConnectionHandler(self, handler: Callable[[bool], None]) -> None:
        self.watchers["connection"] = handler

    def moveAppend(self, cmds: Any, cmdID: Any, ec: Any | None = None) -> None:  # noqa: N803
        self.n_issued += 1
        cmdID.fill(f"id{self.n_issued}")

    def executeCommand(self, cmds: Any, ec: Any) -> str:
        return "ran"

    def moveReset(self, ec: Any) -> None:
        pass

    def moveStart(self, ec: Any) -> None:
        pass

    def stop(self, ec: Any) -> None:
        pass

    def setPowerState(self, on: bool, ec: Any) -> None:
        pass

    def setOperateMode(self, mode: Any, ec: Any) -> None:
        pass


class xMateRobot(_Robot):
    pass
