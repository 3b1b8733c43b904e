"""The one thread that calls the SDK. A call past its deadline is reported, and left to finish."""

from __future__ import annotations

import logging
import threading
import time
from collections import deque
from typing import Any, Callable, Deque, Generator, NamedTuple, Optional, TypeVar

log = logging.getLogger("robot_gateway_xcore_agent")

T = TypeVar("T")
Program = Generator[float, None, None]
"""Makes at most one SDK call between two yields, and yields the seconds until it wants to go on."""


class Running(NamedTuple):
    """A call that the SDK has not answered yet; times in s of time.monotonic()."""

    name: str
    started_at: float
    deadline: float

    def overdue(self, now: float) -> bool:
        """Whether it has taken longer than it may."""
        return now > self.deadline


class Worker:
    """Runs errands as they come, and a program of its own between them.

    Args:
        program: What it does by itself.
        timeout_s: How long a call may take before it counts as hanging.
    """

    def __init__(self, program: Program, timeout_s: float) -> None:
        self._program: Optional[Program] = program
        self._timeout_s = timeout_s
        self._errands: Deque[Callable[[], None]] = deque()
        self._news = threading.Condition()
        self._running: Optional[Running] = None
        self._ended = False
        self._thread = threading.Thread(target=self._run, name="xcore-agent-sdk", daemon=True)

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    @property
    def overdue(self) -> Optional[Running]:
        """The call that hangs now, if one does."""
        running = self._running
        return running if running is not None and running.overdue(time.monotonic()) else None

    def timed(self, name: str, act: Callable[[], T], timeout_s: Optional[float] = None) -> T:
        """Do something under the eyes of `overdue`; on this thread only."""
        now = time.monotonic()
        self._running = Running(name, now, now + (self._timeout_s if timeout_s is None else timeout_s))
        try:
            return act()
        finally:
            self._running = None

    def do(self, errand: Callable[[], None]) -> None:
        """Queue an errand; it runs before the program goes on."""
        with self._news:
            self._errands.append(errand)
            self._news.notify()

    def end(self) -> None:
        """Let the thread end once its call has returned; errands that wait are still run."""
        with self._news:
            self._ended = True
            self._news.notify()

    def _run(self) -> None:
        while True:
            while self._errands:
                self._guarded(self._errands.popleft())
            if self._ended:
                return
            wait_s = self._guarded(self._advance)
            with self._news:
                if not self._errands and not self._ended and wait_s != 0:
                    self._news.wait(wait_s)

    def _advance(self) -> Optional[float]:
        if self._program is None:
            return None
        return next(self._program, None)

    def _guarded(self, act: Callable[[], Any]) -> Any:
        try:
            return act()
        except Exception:
            log.exception("sdk.failed reason='a mistake of the agent'")
            return None
