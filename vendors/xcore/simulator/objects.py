"""The virtual agent's side of `xcore-objects/1`: hello, states at a rate, what the application tells, and results."""

from __future__ import annotations

import json
from functools import partial
from typing import cast

import msgspec

from gateway.api.decoder import Reject
from gateway.api.lines import LONGEST, Lines
from gateway.sim.simulator import VirtualRobot
from vendors.xcore.encoding import Json, to_builtins
from vendors.xcore.objects import Info
from vendors.xcore.simulator.application import application_of, clock_us
from vendors.xcore.simulator.options import XcoreOptions
from vendors.xcore.simulator.results import Results
from vendors.xcore.simulator.state import state_members

SCHEMA = "xcore-objects/1"
# Key of VirtualRobot.settings: how many lines of gateways were no object, too long, or of an unknown type.
REJECTED_LINES = "rejected_lines"

FILLERS = (b'{"type":"remark","text":"a type of message that a later agent may have"}\n',)

_AGENT, _SDK = "0.1.0-virtual", "0.7.1"
_UNITS = {
    "length": "m",
    "angle": "rad",
    "speed": "mm/s",
    "zone": "mm",
    "rotSpeed": "rad/s",
    "torque": "Nm",
    "mass": "kg",
    "time": "s",
}
_OVERLONG = b'{"type":"remark","text":"' + b"x" * LONGEST + b'"}\n'


class ObjectsSession:
    """One gateway's connection to the virtual agent."""

    def __init__(self, robot: VirtualRobot, options: msgspec.Struct) -> None:
        self._robot = robot
        self._options = cast("XcoreOptions", options)
        self._application = application_of(robot, self._options)
        self._place = self._application.end
        self._info = _info(robot, self._options)
        self._results = Results(self._info, self._options, self._application)
        self._lines = Lines()
        self._greeted = False
        self._seq = 0
        self._overlong_s = 0.0  # when the next one is due; 0: not known yet
        self.period_s: float | None = 1 / self._options.objects_hz

    def received(self, data: bytes, now_s: float) -> list[bytes]:
        """Answer each command once; what is no command is counted."""
        answers = []
        for line in self._lines.feed(data):
            if isinstance(line, Reject):
                self._reject()
            elif isinstance(line, bytes) and line.strip():
                answers += self._take(line, now_s)
        return [self._greeting() + answers[0], *answers[1:]] if answers else []

    def due(self, now_s: float) -> list[bytes]:
        """Push what has happened in one send, and the state in another."""
        self._application.advance(now_s)
        missed, messages = self._application.since(self._place)
        self._place = self._application.end
        lines = [self._greeting()]
        ts = clock_us(now_s)
        if missed:
            lines.append(self._numbered("lost", ts, b'"count":%d' % missed))
        for kind, body, is_state in messages:
            lines.append(self._numbered(kind, ts, body))
            if is_state:
                self._robot.count(lines[-1], now_s, partial(_said, lines[-1]))
        if self._wants_overlong(now_s):
            lines.append(_OVERLONG)
        told = b"".join(lines)
        state = self._state(now_s, ts)
        return [told, state] if told else [state]

    def _reject(self) -> None:
        settings = self._robot.settings
        settings[REJECTED_LINES] = cast("int", settings.get(REJECTED_LINES, 0)) + 1

    def _take(self, line: bytes, now_s: float) -> list[bytes]:
        message = _parsed(line)
        if message is None or message.get("type") != "command":
            self._reject()
            return []
        self._robot.requests += 1
        result = self._results.answer(message, self._robot.state(now_s))
        line = _line({"type": "result", **result})
        if result["ok"]:
            self._robot.count(line, now_s, partial(_said, line))
        return [line]

    def _greeting(self) -> bytes:
        """The first line of the connection; nothing later."""
        if self._greeted:
            return b""
        self._greeted = True
        hello = {"schema": SCHEMA, "agent": _AGENT, "sdkVersion": _SDK, "readOnly": True, "units": _UNITS}
        return _line({"type": "hello", **hello, "info": to_builtins(self._info)})

    def _numbered(self, kind: str, ts: int, body: bytes) -> bytes:
        self._seq += 1
        return b'{"type":"%b","seq":%d,"ts":%d,%b}\n' % (kind.encode(), self._seq, ts, body)

    def _state(self, now_s: float, ts: int) -> bytes:
        members = state_members(self._robot.state(now_s), self._options)
        line = self._numbered("state", ts, msgspec.json.encode(members)[1:-1])
        self._robot.count(line, now_s, lambda: members)
        return line

    def _wants_overlong(self, now_s: float) -> bool:
        every_s = self._options.overlong_s
        due = every_s > 0 and 0 < self._overlong_s <= now_s
        if due or not self._overlong_s:
            self._overlong_s = now_s + every_s
        return due


def _info(robot: VirtualRobot, options: XcoreOptions) -> Info:
    return Info(
        id=f"virtual-{robot.number}",
        mac=f"02:00:00:00:{robot.number >> 8 & 0xFF:02x}:{robot.number & 0xFF:02x}",
        version="3.2.1-virtual",
        type=f"virtual-{options.axes}",
        joint_num=options.axes,
    )


def _line(message: Json) -> bytes:
    return msgspec.json.encode(message) + b"\n"


def _said(line: bytes) -> Json:
    """The members of a line of ours, without its envelope."""
    return {name: value for name, value in json.loads(line).items() if name not in {"type", "seq", "ts"}}


def _parsed(line: bytes) -> Json | None:
    """Read a line; None: it is no JSON object without NaN and infinities."""
    try:
        found = json.loads(line.decode("utf-8"), parse_constant=_refuse)
    except (ValueError, RecursionError):
        return None
    return found if isinstance(found, dict) else None


def _refuse(constant: str) -> None:
    raise ValueError(constant)
