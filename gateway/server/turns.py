"""The turns of a door: one timer for all its clients, in which everything that is due leaves.

A callback of the loop, not a task: there is nothing to wait for, and nothing to wake up for each client.
"""

from __future__ import annotations

import asyncio
import math
import time

from gateway.core.clock import deadline_s
from gateway.server.cohort import Cohorts, Shared
from gateway.server.frames import frame
from gateway.server.wire import Cut


class Turns:
    """Lets out what is due, when it is due.

    Args:
        flush_s: How long samples without a rate may be collected into one message.

    Attributes:
        cohorts: Who waits for what.
        n_bytes: So many bytes were written to clients, frames included.
        n_missed: So many samples clients were told that they have missed.
    """

    def __init__(self, flush_s: float) -> None:
        self._loop = asyncio.get_running_loop()
        self._next: asyncio.Handle | None = None
        self.cohorts = Cohorts(flush_s, time.monotonic, self._wake)
        self.n_bytes = 0
        self.n_missed = 0

    def _wake(self, at_s: float) -> None:
        if self._next is not None:
            self._next.cancel()
        if at_s <= time.monotonic():
            self._next = self._loop.call_soon(self._turn)
        elif at_s < math.inf:
            self._next = self._loop.call_at(deadline_s(at_s), self._turn)

    def _turn(self) -> None:
        self._next = None
        shared = Shared(_framed)
        for owner in self.cohorts.distribute():
            owner.flush(shared)
        self.n_missed += shared.n_missed


def _framed(cut: Cut, message: bytes) -> bytes:
    return frame(message, text=cut.encoding.text)
