"""The owner: a process that holds the SDK's only connection to a robot, and lets go of it in one way.

Connecting resets the controller's motion buffer, disconnecting stops the robot. So it connects once, whatever the
gateway does, and at its end it takes back its event watchers and leaves without any destructor of the SDK being run.
"""

from __future__ import annotations

import logging
import threading
import time
from typing import Any, Callable, Dict, List, NamedTuple, Optional

from robot_gateway_xcore_agent import sdk
from robot_gateway_xcore_agent.desk import Desk
from robot_gateway_xcore_agent.lines import Members
from robot_gateway_xcore_agent.reader import Identity, Ports, Reader
from robot_gateway_xcore_agent.service import Service
from robot_gateway_xcore_agent.worker import Program, Worker

log = logging.getLogger("robot_gateway_xcore_agent")

EVENTS = ("moveExecution", "safety", "rlExecution", "logReporter")
CONNECT_TIMEOUT_S = 15.0
"""The SDK takes 10 s to find that nobody answers."""
RECONNECT_DELAYS_S = (5.0, 10.0, 20.0, 60.0)
LET_GO_S = 2.0
"""Seconds that taking back the watchers may take at the end."""

EXIT_STOPPED = 0
EXIT_MISTAKE = 1
EXIT_NOT_ACKNOWLEDGED = 3
EXIT_NO_SDK = 69
EXIT_BROKEN_SDK = 70
EXIT_ADDRESS_TAKEN = 73
EXIT_NOT_CONNECTED = 75


class Options(NamedTuple):
    """What the command line says; times in s."""

    robot: str
    robot_class: str
    listen: str
    port: int
    local_ip: str = ""
    period_s: float = 0.1
    call_timeout_s: float = 3.0
    reconnect: bool = False
    disconnect_on_exit: bool = False
    ports: Ports = Ports()


class Owner:
    """One robot, its SDK connection and its stream.

    Args:
        options: What the command line says.
        module: The SDK.
    """

    def __init__(self, options: Options, module: Any) -> None:
        self._options = options
        self._module = module
        self._identity = Identity()
        self.service = Service(self._identity)
        robot = getattr(module, options.robot_class)()
        offer = self.service.offer
        self._reader = Reader(robot, module, self._identity, offer, period_s=options.period_s, ports=options.ports)
        self._worker = Worker(self._program(), options.call_timeout_s)
        self._reader.attach(self._worker, options.call_timeout_s)
        desk = Desk(self._reader, self._worker, self.service.stream.wake)
        self.service.attach(desk, self._unanswered)
        self._watched: List[str] = []
        self._ready = False
        self._connection_lost = False
        self.stopping = False
        self.exit_code = EXIT_STOPPED

    def run(self) -> int:
        """Serve until `stopping`; answers the exit code. The caller then leaves by os._exit."""
        self._worker.start()
        warned: Optional[float] = None
        while not self.stopping:
            hanging = self._worker.overdue
            if hanging is not None and hanging.started_at != warned:
                warned = hanging.started_at
                log.warning("call.delayed reason='%s has not returned: it is left to finish'", hanging.name)
            self.service.step(accepting=self._ready or hanging is not None)
        self._let_go()
        self.service.stream.close()
        return self.exit_code

    def _unanswered(self) -> Optional[Members]:
        hanging = self._worker.overdue
        return None if hanging is None else self._reader.unanswered(hanging)

    # On the worker's thread.

    def _program(self) -> Program:
        self._reader.version()
        yield 0.0
        yield from self._connecting()
        if self.stopping:
            return
        states = self._reader.run()
        while True:
            if self._connection_lost and self._options.reconnect:
                yield from self._connecting()
            yield next(states)

    def _connecting(self) -> Program:
        delays = iter(RECONNECT_DELAYS_S)
        delay_s = 0.0
        while True:
            if self._connect():
                break
            if not self._options.reconnect:
                self.exit_code, self.stopping = EXIT_NOT_CONNECTED, True
                self.service.stream.wake()
                return
            delay_s = next(delays, delay_s)
            log.warning("session.retried robot=%s delay_s=%g", self._options.robot, delay_s)
            self._ready = True  # the gateway may hear that there is nothing yet
            again_at = time.monotonic() + delay_s
            while time.monotonic() < again_at:
                yield again_at - time.monotonic()
        yield 0.0
        yield from self._watch()
        answer = self._reader.identify()
        if not answer.ok:
            log.warning("robot.unidentified robot=%s reason=%r", self._options.robot, answer.message)
        self._ready = True
        self.service.stream.wake()

    def _connect(self) -> bool:
        where = [self._options.robot] + ([self._options.local_ip] if self._options.local_ip else [])
        answer = self._reader.call("connectToRobot", *where, timeout_s=CONNECT_TIMEOUT_S)
        if not answer.ok:
            log.error("session.failed robot=%s reason=%r", self._options.robot, answer.message)
            return False
        self._connection_lost = False
        log.info("session.opened robot=%s", self._options.robot)
        return True

    def _watch(self) -> Program:
        for name in EVENTS:
            try:
                event = sdk.member(self._module, "Event", name)
            except AttributeError:
                continue  # an older SDK
            answer = self._reader.call("setEventWatcher", event, self._hears(name))
            if answer.ok:
                if name not in self._watched:
                    self._watched.append(name)
            else:
                log.warning("event.unwatched topic=%s reason=%r", name, answer.message)
            yield 0.0
        if hasattr(self._reader.robot, "setConnectionHandler"):
            self._reader.call("setConnectionHandler", self._hears_of_the_connection)
            yield 0.0

    # On the SDK's threads: only note and return.

    def _hears(self, event: str) -> Callable[[Dict[str, object]], None]:
        def hear(info: Dict[str, object]) -> None:
            if event == "logReporter":
                self._reader.reported(info)
            else:
                self.service.offer("event", {"event": event, "data": dict(info)})

        return hear

    def _hears_of_the_connection(self, connected: bool) -> None:  # noqa: FBT001 - the SDK calls it so
        self._connection_lost = not connected
        self.service.offer("event", {"event": "connection", "data": {"connected": bool(connected)}})

    # At the end.

    def _let_go(self) -> None:
        """Take back the watchers, as the SDK wants before an exit; not longer than a moment, a call may hang."""
        done = threading.Event()

        def errand() -> None:
            for name in self._watched:
                self._reader.call("setNoneEventWatcher", sdk.member(self._module, "Event", name))
            if self._options.disconnect_on_exit:
                answer = self._reader.call("disconnectFromRobot")
                log.info("session.closed robot=%s reason=%r", self._options.robot, answer.message or "asked for")
            done.set()

        self._worker.do(errand)
        if not done.wait(LET_GO_S):
            log.warning("session.abandoned robot=%s reason='a call has not returned'", self._options.robot)
