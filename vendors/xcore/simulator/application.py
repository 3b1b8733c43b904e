"""The cell's virtual application: what it appends while the program runs, and what it and the agent are told.

One for each robot, whoever is connected. It writes a row of messages, which every session reads from where it stands;
nothing here knows a connection, a sequence number or a line.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from datetime import UTC, datetime, timedelta
from itertools import islice
from typing import NamedTuple, cast

import msgspec

from gateway.api.model import Power, ProgramState
from gateway.sim.scenario import Fault, FaultKind, Phase
from gateway.sim.simulator import VirtualRobot
from vendors.xcore.encoding import Json, to_builtins
from vendors.xcore.objects import LogInfo
from vendors.xcore.simulator import moves, telling
from vendors.xcore.simulator.options import XcoreOptions

BEGIN = datetime(2026, 1, 1, tzinfo=UTC)  # the agent's clock when that of the sessions was at 0
MOST_BEHIND_S = 2.0  # what happens while nobody reads for longer is lost
_SETTING = "application"  # key of VirtualRobot.settings
_KEPT = 24_000  # messages that a session may still read: more than ever happens in MOST_BEHIND_S
_LOGS_KEPT = 100
_SLOWEST_MOVE_S = 1.5
_RL_S = 2.0
_RL_FILE, _RL_LINES, _LOOKAHEAD = "main.mod", 20, 2

ESTOP, COLLISION, POWER_OFF, POWER_UP, READY, STARTED = 50101, 50201, 10101, 10102, 10103, 10201
_FAULTS: Mapping[FaultKind, tuple[int, str]] = {
    FaultKind.OVER_CURRENT: (50002, "over-current"),
    FaultKind.ENCODER: (50003, "encoder failure"),
    FaultKind.FOLLOWING_ERROR: (50004, "following error"),
    FaultKind.OVER_TEMPERATURE: (50005, "over-temperature"),
}


class Message(NamedTuple):
    """A message without its sequence number and time.

    Args:
        kind: Its type.
        body: Its further members as JSON, without braces.
        is_state: It tells something of the robot's state, not of a command.
    """

    kind: str
    body: bytes
    is_state: bool


class Waypoint(NamedTuple):
    """A command that is being carried out.

    Args:
        due_s: When it will have been, in seconds of running.
        list_number: Of its list.
        place: Where it stands there.
        number: Its own running number.
    """

    due_s: float
    list_number: int
    place: int
    number: int


def application_of(robot: VirtualRobot, options: XcoreOptions) -> Application:
    """The application of a robot, which outlasts connections."""
    if _SETTING not in robot.settings:
        robot.settings[_SETTING] = Application(robot, options)
    return cast("Application", robot.settings[_SETTING])


def clock_us(now_s: float) -> int:
    """The agent's clock, in microseconds since 1970 UTC, which is pushed along with that of the sessions."""
    return int(BEGIN.timestamp()) * 1_000_000 + round(now_s * 1_000_000)


class Application:
    """Appends lists, and writes down what happens.

    Args:
        robot: What it works with.
        options: How much it appends.
    """

    def __init__(self, robot: VirtualRobot, options: XcoreOptions) -> None:
        self._robot = robot
        self._hz = options.commands_hz
        self._size = options.commands_per_list
        self._kinds = moves.kinds(options.axes)
        self._row: deque[Message] = deque(maxlen=_KEPT)
        self._logs: deque[tuple[str, Json]] = deque(maxlen=_LOGS_KEPT)
        self._now_s: float | None = None
        self._phase: Phase | None = None
        self._running_s = 0.0
        self._next_list_s = 0.0
        self._next_rl_s = 0.0
        self._waypoints: deque[Waypoint] = deque()
        self._lists = 0
        self._commands = 0
        self.end = 0

    def since(self, place: int) -> tuple[int, list[Message]]:
        """Read on.

        Args:
            place: Where the reader stands: how many messages were written before.

        Returns:
            How many messages it has missed, and those that are left.
        """
        found = list(islice(reversed(self._row), self.end - place))
        return self.end - place - len(found), found[::-1]

    def logs(self, levels: frozenset[str], count: int, offset: int) -> list[Json]:
        """The newest entries of the controller's log, the newest first."""
        found = [log for level, log in reversed(self._logs) if level in levels]
        return found[offset : offset + count]

    def advance(self, now_s: float) -> None:
        """Let everything happen until now; another session may have been further already."""
        phase = self._robot.state(now_s).phase
        if self._now_s is None:
            self._now_s, self._phase = now_s, phase
            self._event("connection", {"connected": True})
        if now_s < self._now_s:
            return
        passed_s, self._now_s = now_s - self._now_s, now_s
        before, self._phase = self._phase, phase
        if before is not None and before is not phase:
            self._change(before, phase)
        if phase.program is ProgramState.RUNNING:
            if passed_s > MOST_BEHIND_S:
                self._lose(passed_s)
                passed_s = 0.0
            self._run(passed_s)

    def _run(self, passed_s: float) -> None:
        """Append lists and hear of them, in the order of time."""
        self._running_s += passed_s
        if self._running_s >= self._next_rl_s:
            self._tell_rl()
            self._next_rl_s = self._running_s + _RL_S
        while self._hz:
            first = self._waypoints[0].due_s if self._waypoints else self._next_list_s
            if min(first, self._next_list_s) > self._running_s:
                break
            if self._waypoints and first <= self._next_list_s:
                self._feed_back(self._waypoints.popleft(), reached=True)
            else:
                self._append()

    def _append(self) -> None:
        kind = self._kinds[self._lists % len(self._kinds)]
        size = self._size if kind.moves else 1
        began_s = self._next_list_s
        each_s = min(_SLOWEST_MOVE_S, 1 / self._hz)
        self._lists += 1
        first = self._commands + 1
        self._write("issued", kind.body(self._lists, first, size))
        if kind.moves:
            self._waypoints.extend(
                Waypoint(began_s + (index + 1) * each_s, self._lists, index, first + index) for index in range(size)
            )
        self._commands += size
        self._next_list_s += size / self._hz

    def _lose(self, seconds: float) -> None:
        """Go on by whole turns of all classes, of which nobody hears."""
        n_moving = sum(kind.moves for kind in self._kinds) * self._size
        n_commands = n_moving + sum(not kind.moves for kind in self._kinds)
        turns = int(seconds * self._hz / n_commands)
        if not turns:
            return
        count = len(self._waypoints) + turns * (len(self._kinds) + n_moving)
        self._waypoints.clear()
        self._lists += turns * len(self._kinds)
        self._commands += turns * n_commands
        self._write("lost", b'"count":%d' % count)

    def _feed_back(self, waypoint: Waypoint, *, reached: bool, error: int = 0, text: str = "") -> None:
        data = b'{"cmdID":"cmd-%d","reachTarget":%b,"wayPointIndex":%d,"error":{"ec":%d,"message":"%b"}' % (
            waypoint.list_number,
            b"true" if reached else b"false",
            waypoint.place,
            error,
            text.encode(),
        )
        rest = b',"remark":"","customInfo":"%b"}' % moves.info(waypoint.number).encode()
        self._write("event", b'"event":"moveExecution","data":' + data + rest)

    def _change(self, before: Phase, phase: Phase) -> None:
        """Tell what a new phase brings."""
        self._tell_fault(before, phase)
        self._tell_collision(before, phase)
        self._tell_power(before, phase)
        if before.program is not ProgramState.STOPPED and phase.program is not ProgramState.RUNNING:
            self._interrupt(phase)
            self._tell_rl()
        elif phase.program is ProgramState.RUNNING and before.program is ProgramState.STOPPED:
            self._log("info", STARTED, "The virtual program has started.")
            self._next_list_s = self._next_rl_s = self._running_s

    def _interrupt(self, phase: Phase) -> None:
        """What was being carried out fails, waits for a paused program, or is done."""
        failed = _failure(phase)
        if failed is None and phase.program is ProgramState.PAUSED:
            return
        while self._waypoints:
            error, text = failed or (0, "")
            self._feed_back(self._waypoints.popleft(), reached=failed is None, error=error, text=text)

    def _tell_fault(self, before: Phase, phase: Phase) -> None:
        if phase.fault is not None and phase.fault != before.fault:
            number, content = _described(phase.fault)
            joint = phase.fault.joint + 1
            repair = (
                f"Check joint {joint} and clear the alarm; a virtual joint is whole again when its scenario says so."
            )
            self._log("error", number, content, repair)
        if before.fault is not None and phase.fault is None:
            self._log("info", READY, "The virtual fault is cleared.")

    def _tell_collision(self, before: Phase, phase: Phase) -> None:
        if phase.collision is before.collision:
            return
        self._event("safety", {"collided": phase.collision})
        if phase.collision:
            repair = "Take away what stands in the way; the virtual robot goes on when its scenario says so."
            self._log("warning", COLLISION, "A virtual collision has stopped the robot.", repair)

    def _tell_power(self, before: Phase, phase: Phase) -> None:
        if phase.estop and not before.estop:
            repair = "Release the button and switch the power on; the virtual button is released by the scenario."
            self._log("error", ESTOP, "The virtual emergency stop is pressed.", repair)
        if phase.power is before.power:
            return
        if phase.power is Power.OFF and not phase.estop:
            self._log("warning", POWER_OFF, "The virtual motors have no power.", "Switch the power on.")
        elif phase.power is Power.BOOTING:
            self._log("info", POWER_UP, "The virtual motors are being powered up.")
            self._event("connection", {"connected": False})
            self._event("connection", {"connected": True})
        elif phase.power is Power.ENABLED:
            self._log("info", READY, "The virtual robot is ready.")

    def _tell_rl(self) -> None:
        line = 1 + int(self._running_s) % _RL_LINES
        data = {
            "taskName": telling.TASK,
            "lookaheadLine": line + _LOOKAHEAD,
            "lookaheadFile": _RL_FILE,
            "executeLine": line,
            "executeFile": _RL_FILE,
        }
        self._event("rlExecution", data)

    def _log(self, level: str, number: int, content: str, repair: str = "") -> None:
        at = BEGIN + timedelta(seconds=int(self._now_s or 0))
        log = to_builtins(LogInfo(id=number, timestamp=f"{at:%Y-%m-%d %H:%M:%S}", content=content, repair=repair))
        self._logs.append((level, log))
        body = b'"level":"%b","log":%b' % (level.encode(), msgspec.json.encode(log))
        self._write("log", body, is_state=True)

    def _event(self, name: str, data: Mapping[str, object]) -> None:
        body = b'"event":"%b","data":%b' % (name.encode(), msgspec.json.encode(data))
        self._write("event", body, is_state=True)

    def _write(self, kind: str, body: bytes, *, is_state: bool = False) -> None:
        self._row.append(Message(kind, body, is_state))
        self.end += 1


def _failure(phase: Phase) -> tuple[int, str] | None:
    """The number and the words of what stops the robot, where something does."""
    if phase.fault is not None:
        return _described(phase.fault)
    if phase.estop:
        return ESTOP, "virtual emergency stop"
    return (COLLISION, "virtual collision") if phase.collision else None


def _described(fault: Fault) -> tuple[int, str]:
    number, what = _FAULTS[fault.kind]
    return number, f"Virtual {what} in joint {fault.joint + 1}."
