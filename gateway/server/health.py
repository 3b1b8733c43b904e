"""Whether the gateway lives (`/healthz`), whether it has something to tell (`/readyz`), and how late its loop is."""

from __future__ import annotations

import time
from bisect import bisect_left
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from http import HTTPStatus

import msgspec
from aiohttp import web

from gateway import __version__
from gateway.api.messages import RobotInfo
from gateway.api.model import LinkState
from gateway.server.access import cell_of
from gateway.server.answers import Failure, answer, failure, parameters
from gateway.server.cell import CELL
from gateway.server.repeating import repeating

BEAT_S = 0.1
HUNG_S = 5.0
# Upper bounds of the histogram of the lag; timers themselves are exact to 1 or 2 ms.
LAG_BOUNDS_S = (0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5)


class Health(msgspec.Struct, frozen=True, kw_only=True):
    """The loop turns."""

    status: str = "ok"
    gateway: str = __version__


class Readiness(msgspec.Struct, frozen=True, kw_only=True):
    """Every link has been tried."""

    status: str = "ready"
    robots: int


class Waiting(Failure, frozen=True, kw_only=True):
    """Some links have not been tried; those that the caller may not see are counted in the message only."""

    waiting: list[str]


class Pulse:
    """A timer that measures how late it is called.

    Args:
        now: The monotonic clock, in s.

    Attributes:
        counts: How many beats were late by no more than each bound of `LAG_BOUNDS_S` and more than the one before;
            the last: by more than all.
        lag_sum: All lags together, in s.
    """

    def __init__(self, now: Callable[[], float] = time.monotonic) -> None:
        self._now = now
        self._due_s = now() + BEAT_S
        self.counts = [0] * (len(LAG_BOUNDS_S) + 1)
        self.lag_sum = 0.0

    @property
    def overdue_s(self) -> float:
        """How late the next beat is by now; below 0: it is not due yet."""
        return self._now() - self._due_s

    def beat(self) -> None:
        """Count one beat; the next is due a period from now."""
        lag_s = max(0.0, self.overdue_s)
        self.counts[bisect_left(LAG_BOUNDS_S, lag_s)] += 1
        self.lag_sum += lag_s
        self._due_s = self._now() + BEAT_S

    @contextmanager
    def beating(self) -> Iterator[None]:
        """Beat on the running loop for as long as the context lasts."""
        self._due_s = self._now() + BEAT_S
        with repeating(BEAT_S, self.beat):
            yield


PULSE = web.AppKey("pulse", Pulse)


async def healthz(request: web.Request) -> web.Response:
    """Answer while the loop turns; one that hangs answers nothing, and one that hung a moment ago 503."""
    parameters(request)
    overdue_s = request.app[PULSE].overdue_s
    if overdue_s > HUNG_S:
        words = f"the loop has not turned for {overdue_s + BEAT_S:.1f} s"
        return failure(HTTPStatus.SERVICE_UNAVAILABLE, "HUNG", words)
    return answer(Health())


async def readyz(request: web.Request) -> web.Response:
    """Answer whether every configured link has been tried at least once, and which have not.

    Who asks without a token learns how many there are, and no names.
    """
    parameters(request)
    infos = request.app[CELL].infos()
    untried = [info.name for info in infos if not was_tried(info)]
    if not untried:
        return answer(Readiness(robots=len(infos)))
    visible = cell_of(request).robots
    waiting = [name for name in untried if name in visible]
    n_hidden = len(untried) - len(waiting)
    named = [*waiting, *([f"{n_hidden} of {len(infos)} robots"] if n_hidden else [])]
    words = f"not tried yet: {', '.join(named)}"
    return answer(Waiting(code="NOT_READY", message=words, waiting=waiting), status=HTTPStatus.SERVICE_UNAVAILABLE)


def was_tried(info: RobotInfo) -> bool:
    """Whether the first attempt to reach a robot has come to something, be it a reason why it failed."""
    begun = info.link.state not in {LinkState.DISCONNECTED, LinkState.CONNECTING}
    return begun or info.link.last_error is not None
