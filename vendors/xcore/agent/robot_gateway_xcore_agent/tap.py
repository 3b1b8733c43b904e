"""The tap: a stand-in for an application's robot object that publishes what the application appends and hears of.

Every call goes to the SDK unchanged, on the application's thread. What is published is copied there, handed over with
a deque's append, and encoded and sent by a daemon thread.
"""

from __future__ import annotations

import logging
import os
import threading
import time
import weakref
from typing import Any, Dict, Iterable, List, Optional, Tuple, TypeVar

from robot_gateway_xcore_agent import sdk
from robot_gateway_xcore_agent.desk import Desk
from robot_gateway_xcore_agent.lines import Members
from robot_gateway_xcore_agent.objects import snapshot
from robot_gateway_xcore_agent.outbox import Limits
from robot_gateway_xcore_agent.proxy import Tapped, proxy_class
from robot_gateway_xcore_agent.reader import Identity, Reader, reported_log, textless
from robot_gateway_xcore_agent.service import Issued, Service
from robot_gateway_xcore_agent.worker import Program, Worker

log = logging.getLogger("robot_gateway_xcore_agent")

RobotT = TypeVar("RobotT")
DEFAULT_PORT = 5920
LISTEN_AGAIN_S = 5.0
MIN_STATE_PERIOD_S = 0.02
MAX_STATE_PERIOD_S = 1.0
_live: weakref.WeakSet[Tap] = weakref.WeakSet()


def tap(
    robot: RobotT,
    *,
    host: str = "127.0.0.1",
    port: int = DEFAULT_PORT,
    state_period_s: Optional[float] = None,
    call_timeout_s: float = 3.0,
    limits: Optional[Limits] = None,
) -> RobotT:
    """Wrap an application's robot; use what it returns instead of the robot.

    Args:
        robot: The SDK's robot object, connected or not.
        host: Address to listen on; the stream has no authentication.
        port: Port to listen on; 0 takes a free one, see `tap_of`.
        state_period_s: Seconds between states that the tap reads by calls of its own, 0.02 to 1. None: it makes no
            call at all, and its states are heartbeats.
        call_timeout_s: Seconds after which such a call counts as hanging.
        limits: What a slow gateway may leave unread.

    Returns:
        A stand-in that passes everything on. An address that cannot be had does not raise: it is tried again.

    Raises:
        ValueError: state_period_s is outside of its range.
    """
    if state_period_s is not None and not MIN_STATE_PERIOD_S <= state_period_s <= MAX_STATE_PERIOD_S:
        raise ValueError(f"state_period_s must be {MIN_STATE_PERIOD_S} to {MAX_STATE_PERIOD_S}")
    if not 0 <= port <= 65_535:  # noqa: PLR2004 - TCP's
        raise ValueError("port must be 0 to 65535")
    tapped = Tap(robot, host, port, limits)
    if state_period_s is not None:
        tapped.read(state_period_s, call_timeout_s)
    tapped.start()
    proxy: RobotT = proxy_class(type(robot))(robot, tapped)
    return proxy


class Tap:
    """What stands behind a tapped robot; `tap_of` gives it."""

    def __init__(self, robot: object, host: str, port: int, limits: Optional[Limits]) -> None:
        self._robot = robot
        self._place = (host, port)
        self._identity = Identity()
        self._service = Service(self._identity, limits)
        self._reader: Optional[Reader] = None
        self._worker: Optional[Worker] = None
        self._open = True
        self._thread = threading.Thread(target=self._run, name="xcore-agent-tap", daemon=True)

    @property
    def address(self) -> Optional[Tuple[str, int]]:
        """Host and port that it listens on; None while it cannot."""
        return self._service.stream.address

    @property
    def connected(self) -> bool:
        """Whether a gateway is connected."""
        return self._service.connected

    @property
    def n_lost(self) -> int:
        """Messages that no gateway got, since the start."""
        return self._service.n_lost

    def close(self) -> None:
        """Stop publishing; the robot keeps working. Not needed at the end of a program."""
        self._open = False
        self._service.stream.wake()

    def read(self, period_s: float, timeout_s: float) -> None:
        """Read states by own calls of the SDK; before `start`."""
        try:
            reader = Reader(self._robot, sdk.load(), self._identity, self._service.offer, period_s=period_s)
        except Exception as error:  # noqa: BLE001 - an application must not fail for it
            log.warning("state.disabled reason=%r", str(error))
            return
        worker = Worker(_reading(reader), timeout_s)
        reader.attach(worker, timeout_s)
        desk = Desk(reader, worker, self._service.stream.wake)
        self._reader, self._worker = reader, worker

        def unanswered() -> Optional[Members]:
            hanging = worker.overdue
            return None if hanging is None else reader.unanswered(hanging)

        self._service.attach(desk, unanswered)

    def start(self) -> None:
        """Listen, and start the threads."""
        self._listen()
        _live.add(self)
        if self._worker is not None:
            self._worker.start()
        self._thread.start()

    def abandon(self) -> None:
        """Let go of the sockets: this is a forked child, and they are its parent's."""
        self._open = False
        self._service.stream.abandon()

    def _listen(self) -> None:
        try:
            self._service.stream.listen(*self._place)
        except OSError as error:
            log.warning("listener.failed reason=%r delay_s=%g", str(error), LISTEN_AGAIN_S)

    def _run(self) -> None:
        tried_at = time.monotonic()
        while self._open:
            if not self._service.stream.listening and time.monotonic() - tried_at > LISTEN_AGAIN_S:
                tried_at = time.monotonic()
                self._listen()
            self._service.step()
        if self._worker is not None:
            self._worker.end()
        self._service.stream.close()

    # What the application's threads call: nothing here waits, nothing but KeyboardInterrupt gets out.

    def issued(self, args: Tuple[object, ...], kwargs: Dict[str, object], returned: object) -> None:
        """Publish what the application has appended, unless the SDK refused it."""
        service = self._service
        try:
            commands, box, error = _appended(args, kwargs)
            if not commands or (error is not None and error.get("ec", 0)):
                return
            if not service.connected:
                service.miss()
                return
            content = box.content() if box is not None else returned
            command_id = content if isinstance(content, str) else ""
            service.offer("issued", Issued(command_id, [snapshot(command) for command in commands]))
        except Exception:  # noqa: BLE001 - whatever the objects of an application raise
            service.miss()

    def happened(self, event: str, args: Tuple[object, ...]) -> None:
        """Publish what the application is being told."""
        service = self._service
        try:
            told = args[0]
            if event == "logReporter":
                info = dict(told)  # type: ignore[call-overload]
                if self._reader is not None:
                    self._reader.reported(info)
                    return
                code, detail = reported_log(info)
                if code is None:
                    service.miss()
                else:
                    service.offer("log", {"level": None, "log": textless(code, detail)})
                return
            if not service.connected:
                service.miss()
                return
            data = {"connected": bool(told)} if event == "connection" else dict(told)  # type: ignore[call-overload]
            service.offer("event", {"event": event, "data": data})
        except Exception:  # noqa: BLE001 - whatever the objects of an application raise
            service.miss()


def _reading(reader: Reader) -> Program:
    reader.version()
    yield 0.0
    yield from reader.run()


def _appended(
    args: Tuple[object, ...], kwargs: Dict[str, object]
) -> Tuple[List[object], Optional[Any], Optional[Dict[str, Any]]]:
    """Tell a call's arguments apart: the commands, the box for the id, and the dict for the error."""
    box = error = commands = None
    for value in (*args, *kwargs.values()):
        if isinstance(value, dict):
            error = value
        elif callable(getattr(value, "content", None)):
            box = value
        elif commands is None:
            commands = value
    if commands is None:
        return [], box, error
    return list(commands) if isinstance(commands, (list, tuple)) else [commands], box, error


def tap_of(robot: object) -> Tap:
    """Give what stands behind a tapped robot.

    Raises:
        TypeError: It is not tapped.
    """
    if not isinstance(robot, Tapped):
        raise TypeError("not a tapped robot")
    found: Tap = object.__getattribute__(robot, "_xcore_agent_tap")
    return found


def _abandon_all(taps: Iterable[Tap] = _live) -> None:
    for tapped in list(taps):
        tapped.abandon()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_abandon_all)
