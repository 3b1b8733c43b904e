"""What is read of the robot by itself: its Info, the state in a cycle, and the text of the logs that it reports.

All of it runs on the worker's thread, as generators that make one SDK call between two yields.
"""

from __future__ import annotations

import logging
import time
from collections import OrderedDict, deque
from typing import Any, Callable, Deque, Dict, List, NamedTuple, Optional, Tuple

from robot_gateway_xcore_agent import sdk
from robot_gateway_xcore_agent.lines import Members, number, numbers
from robot_gateway_xcore_agent.objects import encode, enum_name
from robot_gateway_xcore_agent.sdk import Answer
from robot_gateway_xcore_agent.worker import Program, Running, Worker

log = logging.getLogger("robot_gateway_xcore_agent")

Publish = Callable[[str, Members], None]
POSES = ("flangeInBase", "endInRef")
LEVELS = ("error", "warning", "info")
LOGS_ASKED = 10
"""The SDK gives no more at once."""
REMEMBERED = 256
"""Log entries that are known to have been published."""
REPEAT_S = 10.0
"""A code whose text was not found counts as a repeat for so many seconds."""
READ_ONCE_MORE_S = 1.0
"""Seconds between attempts to read the Info."""


class Port(NamedTuple):
    """One input or output of a board, and the name under which it is published."""

    name: str
    board: int
    port: int


class Ports(NamedTuple):
    """What is read besides the state that every robot has."""

    di: Tuple[Port, ...] = ()
    do: Tuple[Port, ...] = ()
    ai: Tuple[Port, ...] = ()


class Identity:
    """What the hello says; written by the worker, read by the stream."""

    def __init__(self) -> None:
        self.info: Optional[Members] = None
        self.sdk_version: Optional[str] = None

    @property
    def joint_num(self) -> Optional[int]:
        """Number of axes; None before the Info has been read."""
        found = None if self.info is None else self.info.get("joint_num")
        return found if isinstance(found, int) and found > 0 else None


def split(values: object, joint_num: int) -> Tuple[List[Optional[float]], List[Optional[float]]]:
    """Cut what the SDK gives to the robot's axes; the rest belongs to external axes."""
    found = numbers(values) or []
    return found[:joint_num], found[joint_num:]


class Reader:
    """Reads the robot.

    Args:
        robot: The SDK's robot.
        module: The SDK.
        identity: Where the Info goes.
        publish: Where states and logs go.
        period_s: Seconds from one state to the next.
        ports: Inputs and outputs that are read too.
    """

    def __init__(
        self,
        robot: object,
        module: Any,
        identity: Identity,
        publish: Publish,
        *,
        period_s: float,
        ports: Optional[Ports] = None,
    ) -> None:
        self.robot = robot
        self.module = module
        self.identity = identity
        self.worker: Optional[Worker] = None
        self.n_abandoned = 0
        self._publish = publish
        self._period_s = period_s
        self._timeout_s = 0.0
        ports = ports or Ports()
        self._ports = (("di", "getDI", ports.di), ("do", "getDO", ports.do), ("ai", "getAI", ports.ai))
        self._keypad = hasattr(robot, "getKeypadState")
        self._identified_at = float("-inf")
        self._codes: Deque[Tuple[int, str]] = deque(maxlen=REMEMBERED)

    def attach(self, worker: Worker, timeout_s: float) -> None:
        """Say on whose thread it runs, and after how many seconds a call counts as hanging."""
        self.worker = worker
        self._timeout_s = timeout_s

    def call(
        self, name: str, *args: object, after: Tuple[object, ...] = (), timeout_s: Optional[float] = None
    ) -> Answer:
        """Call the SDK; on the worker's thread only."""
        if self.worker is None:
            raise RuntimeError("no worker")
        return self.worker.timed(name, lambda: sdk.call(self.robot, name, *args, after=after), timeout_s)

    def identify(self) -> Answer:
        """Read the Info."""
        self._identified_at = time.monotonic()
        answer = self.call("robotInfo")
        if answer.ok:
            self.identity.info = encode(answer.value)
        return answer

    def version(self) -> None:
        """Read the SDK's version; it needs no connection."""
        found = self.call("sdkVersion").value
        self.identity.sdk_version = found if isinstance(found, str) else None

    def run(self) -> Program:
        """Read states for ever, and the text of logs as they are reported."""
        while True:
            due = time.monotonic() + self._period_s
            try:
                yield from self._cycle()
                yield from self._texts()
            except Exception:  # a value that no code of ours expected costs its cycle
                log.exception("state.dropped reason='a mistake of the agent'")
                yield self._period_s
            while True:
                left = due - time.monotonic()
                if left <= 0:
                    break
                yield left

    def members(self) -> List[str]:
        """Name what a cycle reads."""
        names = ["jointPos", "jointVel", "jointTorque", "posture", "cartPosture"]
        names += ["powerState", "operateMode", "operationState"]
        names += ["keypad"] if self._keypad else []
        return names + [name for name, _, ports in self._ports if ports]

    def unanswered(self, hanging: Running) -> Members:
        """Give the state while a call hangs: nothing is known, and each member says why."""
        names = self.members()
        state: Members = dict.fromkeys(names)
        timeout = {"ec": 0, "message": f"{hanging.name} has not returned", "error": "timeout"}
        busy = {"ec": 0, "message": f"waits for {hanging.name}", "error": "busy"}
        state["errors"] = {name: timeout if _CALLS.get(name, name) == hanging.name else busy for name in names}
        return state

    def _cycle(self) -> Program:
        if self.identity.info is None and time.monotonic() - self._identified_at > READ_ONCE_MORE_S:
            self.identify()
            yield 0.0
        cycle = _Cycle(self)
        for read in self._reads():
            started_at = time.monotonic()
            read(cycle)
            if time.monotonic() - started_at > self._timeout_s:
                self.n_abandoned += 1  # what was read before the call hung is old by now
                return
            yield 0.0
        self._publish("state", cycle.state())

    def _reads(self) -> List[Callable[[_Cycle], object]]:
        joints = self.identity.joint_num
        reads: List[Callable[[_Cycle], object]] = [
            lambda cycle: cycle.joints("jointPos", joints, external=True),
            lambda cycle: cycle.joints("jointVel", joints, external=False),
            lambda cycle: cycle.joints("jointTorque", joints, external=False),
            lambda cycle: cycle.pose(POSES[0]),
            lambda cycle: cycle.pose(POSES[1]),
            lambda cycle: cycle.one("cartPosture", "cartPosture", encode, self.coordinates(POSES[1])),
        ]
        reads.extend(_reading(name) for name in ("powerState", "operateMode", "operationState"))
        if self._keypad:
            reads.append(self._read_keypad)
        for member, name, ports in self._ports:
            reads.extend(_reading_port(member, name, port) for port in ports)
        return reads

    def _read_keypad(self, cycle: _Cycle) -> None:
        answer = cycle.one("keypad", "getKeypadState", encode)
        if not answer.ok and cycle.has("powerState"):
            log.info("keypad.disabled reason=%r", answer.message)
            self._keypad = False  # models without one answer with an error: it is not asked again

    def coordinates(self, name: str) -> Any:
        """Find the SDK's CoordinateType of that name; its name where the SDK has none, for a call that then fails."""
        try:
            return sdk.member(self.module, "CoordinateType", name)
        except AttributeError:
            return name

    def reported(self, info: Dict[str, object]) -> None:
        """Note what logReporter says; on any thread, and quick."""
        code, detail = reported_log(info)
        if code is not None:
            self._codes.append((code, detail))

    def _texts(self) -> Program:
        """Fetch the text of the reported codes, one level after another, since an entry does not say its level."""
        wanted: OrderedDict[int, str] = OrderedDict()
        while self._codes:
            code, detail = self._codes.popleft()
            wanted[code] = detail
        for level in LEVELS:
            if not wanted:
                return
            try:
                levels = {sdk.member(self.module, "LogInfoLevel", level)}
            except AttributeError:
                break
            answer = self.call("queryControllerLog", LOGS_ASKED, levels)
            for entry in answer.value if answer.ok and isinstance(answer.value, (list, tuple)) else ():
                found = encode(entry)
                if wanted.pop(found.get("id"), None) is not None:  # the first of a code is its newest
                    self._publish("log", {"level": level, "log": found})
            yield 0.0
        for code, detail in wanted.items():
            self._publish("log", {"level": None, "log": textless(code, detail)})


class LogBook:
    """Knows which entries were published: the controller repeats the same one."""

    def __init__(self) -> None:
        self._known: OrderedDict[Tuple[object, ...], float] = OrderedDict()

    def is_new(self, level: object, entry: Members, now: float) -> bool:
        """Say whether an entry is none of the known, and know it from now on.

        Args:
            level: Its level.
            entry: The LogInfo.
            now: Seconds of time.monotonic(): an entry without a time counts as a repeat for `REPEAT_S`.
        """
        key = (level, entry.get("id"), entry.get("timestamp"), entry.get("content"))
        known_at = self._known.pop(key, None)
        self._known[key] = now
        while len(self._known) > REMEMBERED:
            self._known.popitem(last=False)
        return known_at is None or not (entry.get("timestamp") or now - known_at < REPEAT_S)


def reported_log(info: Dict[str, object]) -> Tuple[Optional[int], str]:
    """Read what logReporter gives, in both spellings: the log's number and what detail there is."""
    code = sdk.code_of(info.get("Ecode", info.get("ecode")))
    return code, str(info.get("Edetail", info.get("edetail", "")) or "")


def textless(code: int, detail: str) -> Members:
    """Make a log entry of a code whose text is not known."""
    return {"id": code, "timestamp": "", "content": detail, "repair": ""}


_CALLS = {"keypad": "getKeypadState", "di": "getDI", "do": "getDO", "ai": "getAI"}
"""Members of the state whose call has another name."""


class _Cycle:
    """The state while it is being read."""

    def __init__(self, reader: Reader) -> None:
        self._reader = reader
        self._state: Members = {}
        self._errors: Dict[str, Members] = {}

    def state(self) -> Members:
        return {**self._state, "errors": self._errors} if self._errors else self._state

    def has(self, member: str) -> bool:
        return self._state.get(member) is not None

    def one(
        self, member: str, name: str, encoded: Callable[[Any], object], *args: object, place: Optional[str] = None
    ) -> Answer:
        answer = self._reader.call(name, *args)
        value = None
        if answer.ok:
            try:
                value = _whole(encoded(answer.value))
            except Exception as error:  # noqa: BLE001 - an object that is not what the SDK documents
                answer, value = Answer(None, sdk.FAILED, f"{type(error).__name__}: {error}"), None
        if not answer.ok:
            self._errors[member] = {"ec": answer.ec, "message": answer.message}
        if place is None:
            self._state[member] = value
        else:
            self._state.setdefault(member, {})[place] = value
        return answer

    def joints(self, member: str, joint_num: Optional[int], *, external: bool) -> None:
        if joint_num is None:
            self._state[member] = None
            self._errors[member] = {"ec": 0, "message": "the number of axes is not known: robotInfo failed"}
            return

        def axes(values: object) -> object:
            found = split(values, joint_num)[0]
            if len(found) != joint_num:
                raise ValueError(f"{len(found)} values for {joint_num} axes")
            return found

        answer = self.one(member, member, axes)
        rest = split(answer.value, joint_num)[1] if answer.ok and external else []
        if rest:
            self._state["external"] = None if None in rest else rest

    def pose(self, name: str) -> None:
        self.one("posture", "posture", numbers, self._reader.coordinates(name), place=name)

    def port(self, member: str, name: str, port: Port) -> None:
        encoded: Callable[[Any], object] = number if member == "ai" else switch
        self.one(member, name, encoded, port.board, port.port, place=port.name)


def _whole(value: object) -> object:
    """A value with a hole is not read: one number of a pose or of the joints that is NaN spoils the rest.

    Raises:
        ValueError: Some of it is null.
    """
    holes = [value]
    while holes:
        part = holes.pop()
        if part is None:
            raise ValueError("it holds what is no finite number, or nothing")
        if isinstance(part, dict):
            holes.extend(part.values())
        elif isinstance(part, list):
            holes.extend(part)
    return value


def _reading(name: str) -> Callable[[_Cycle], object]:
    return lambda cycle: cycle.one(name, name, enum_name)


def _reading_port(member: str, name: str, port: Port) -> Callable[[_Cycle], object]:
    return lambda cycle: cycle.port(member, name, port)


def switch(value: object) -> Optional[bool]:
    """Give a switch as true or false; null if it is neither."""
    return bool(value) if isinstance(value, (bool, int)) else None
