"""Tells the service manager how the gateway is, by the protocol of sd_notify; without `$NOTIFY_SOCKET` nothing is sent.

A message is one datagram of lines `KEY=value`. The watchdog is fed by a timer of the event loop itself: a loop that
hangs feeds nothing, and the service manager starts the gateway anew.
"""

from __future__ import annotations

import os
import socket
import time
from collections import deque
from collections.abc import Callable, Iterable, Mapping

import anyio
import structlog

from gateway.api.messages import RecorderInfo, RobotInfo
from gateway.api.model import LinkState

_LOG = structlog.get_logger()
STATUS_PERIOD_S = 1.0
_NAMED = 6  # so many robots that are off are named
_LONGEST_REASON = 80
_MOST_OWED = 32


class Notifier:
    """Sends notifications, or nothing.

    A message that the receiver has no room for is sent later, in order.

    Args:
        address: The receiver's socket: a path, or a name in the abstract namespace with `@` before it; None: nobody.
        watchdog_s: Longest time that the receiver waits for a sign of life; None: it does not wait.
    """

    def __init__(self, address: str | None, watchdog_s: float | None = None) -> None:
        self._address = None if address is None else _unabstracted(address)
        self.watchdog_s = None if self._address is None else watchdog_s
        self._owed: deque[bytes] = deque(maxlen=_MOST_OWED)
        self._failed = False
        self._status = ""

    @classmethod
    def of_environment(cls, env: Mapping[str, str], pid: int | None = None) -> Notifier:
        """What the service manager has asked for: `NOTIFY_SOCKET`, `WATCHDOG_USEC` and `WATCHDOG_PID`.

        Args:
            env: The environment.
            pid: Of this process; None: ask the system.
        """
        address = env.get("NOTIFY_SOCKET", "")
        usec, whose = env.get("WATCHDOG_USEC", ""), env.get("WATCHDOG_PID", "")
        ours = not whose or whose == str(os.getpid() if pid is None else pid)
        watched = ours and usec.isascii() and usec.isdigit() and int(usec) > 0
        return cls(address if address[:1] in {"/", "@"} else None, int(usec) / 1e6 if watched else None)

    def ready(self) -> None:
        """The doors are open, or a reload is over."""
        self._say("READY=1")

    def stopping(self) -> None:
        """The gateway is about to end."""
        self._say("STOPPING=1")

    def reloading(self) -> None:
        """A reload has begun; `ready` says that it is over."""
        self._say("RELOADING=1", f"MONOTONIC_USEC={time.clock_gettime_ns(time.CLOCK_MONOTONIC) // 1000}")

    def status(self, text: str) -> None:
        """Say in one line how the gateway is, if that has changed."""
        line = " ".join(text.split())
        if line != self._status:
            self._status = line
            self._say(f"STATUS={line}")

    async def keep_telling(self, text: Callable[[], str]) -> None:
        """Keep the status current, for ever: looked at once a second."""
        while self._address is not None:
            self.status(text())
            self._send_owed()
            await anyio.sleep(STATUS_PERIOD_S)

    async def feed_watchdog(self) -> None:
        """Give a sign of life at half the period that the receiver waits, for ever."""
        while self.watchdog_s is not None:
            self._send(b"WATCHDOG=1")  # one that cannot be sent now is of no use later
            await anyio.sleep(self.watchdog_s / 2)

    def _say(self, *lines: str) -> None:
        if self._address is not None:
            self._owed.append("\n".join(lines).encode(errors="replace"))  # a reason may hold what is no UTF-8
            self._send_owed()

    def _send_owed(self) -> None:
        while self._owed and self._send(self._owed[0]):
            self._owed.popleft()

    def _send(self, message: bytes) -> bool:
        """Send one datagram without waiting; whether it is gone."""
        if self._address is None:
            return True
        try:
            with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sender:
                sender.setblocking(False)  # noqa: FBT003 - its signature
                sender.sendto(message, self._address)
        except BlockingIOError:
            return False
        except OSError as error:
            if not self._failed:
                _LOG.warning("notification.failed", peer=self._address, reason=error.strerror)
            self._failed = True
            return False
        self._failed = False
        return True


def status_line(infos: Iterable[RobotInfo], recorder: RecorderInfo | None = None) -> str:
    """What is on and what is off, and why, in one line; and whether the last recording failed."""
    failed = f"; recording failed: {recorder.error}" if recorder is not None and recorder.error else ""
    return _robots(infos) + failed


def _robots(infos: Iterable[RobotInfo]) -> str:
    robots = list(infos)
    if not robots:
        return "no robot is configured"
    off = [robot for robot in robots if robot.link.state is not LinkState.ONLINE]
    on = f"{len(robots) - len(off)} of {len(robots)} robot{'' if len(robots) == 1 else 's'} on"
    named = [f"{robot.name} ({_reason(robot)})" for robot in off[:_NAMED]]
    more = [f"and {len(off) - _NAMED} more"] if len(off) > _NAMED else []
    return f"{on}; off: {', '.join([*named, *more])}" if off else on


def _reason(robot: RobotInfo) -> str:
    said = robot.link.last_error or robot.link.reason or robot.link.state.value.lower()
    return said if len(said) <= _LONGEST_REASON else f"{said[: _LONGEST_REASON - 1]}…"


def _unabstracted(address: str) -> str:
    """A name of the abstract namespace begins with a zero byte."""
    return "\0" + address[1:] if address.startswith("@") else address
