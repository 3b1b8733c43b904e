"""Fakes of the core's tests: a loop whose time jumps, and connections with faults."""

from __future__ import annotations

import asyncio
import contextlib
import selectors
from collections import deque
from collections.abc import Awaitable, Callable, Iterable

import anyio

from gateway.core.transport import Connection, Pulled
from gateway.errors import LinkClosed

EPOCH_US = 1_700_000_000_000_000


class _JumpingSelector(selectors.DefaultSelector):
    """Waits by moving the time of its loop on."""

    loop: JumpingLoop

    def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        ready = super().select(0)
        if ready or not timeout:
            return ready if timeout is not None else super().select(None)
        self.loop.now_s += timeout
        return []


class JumpingLoop(asyncio.SelectorEventLoop):
    """An event loop in which waiting takes no time."""

    def __init__(self) -> None:
        self.now_s = 1000.0
        selector = _JumpingSelector()
        selector.loop = self
        super().__init__(selector)

    def time(self) -> float:
        """The virtual time in s."""
        return self.now_s


def run_jumping(function: Callable[[], Awaitable[None]]) -> None:
    """Run an async test in virtual time."""
    anyio.run(function, backend_options={"loop_factory": JumpingLoop})


class LoopClock:
    """A clock that follows the loop; its wall clock can be set."""

    def __init__(self) -> None:
        self.set_by_us = 0

    def monotonic(self) -> float:
        """The loop's time in s."""
        return anyio.current_time()

    def utc_us(self) -> int:
        """The wall clock, µs UTC."""
        return EPOCH_US + int(self.monotonic() * 1e6) + self.set_by_us


class _EnoughError(Exception):
    """One piece is all that was wanted."""


async def received(connection: Connection) -> bytes:
    """The next piece; what comes after it waits."""
    pieces: list[bytes] = []

    def take(data: bytes) -> None:
        pieces.append(data)
        raise _EnoughError

    with contextlib.suppress(_EnoughError):
        await connection.deliver(take)
    assert len(pieces) == 1
    return pieces[0]


class FakeConnection(Pulled):
    """A connection whose other end is a function: what it gets is answered after a delay, or never.

    Args:
        answer: Makes the pieces to receive of what was sent; each piece arrives on its own.
        delay_s: How long an answer takes.
    """

    datagrams = False

    def __init__(self, answer: Callable[[bytes], Iterable[bytes]] = lambda _: (), delay_s: float = 0.001) -> None:
        self._answer = answer
        self._delay_s = delay_s
        self._arrived: deque[bytes | None] = deque()
        self._news = anyio.Event()
        self.sent: list[bytes] = []
        self.closed = False

    def push(self, data: bytes) -> None:
        """Let bytes arrive."""
        self._arrived.append(data)
        self._news.set()

    def end(self) -> None:
        """Let the controller close the connection."""
        self._arrived.append(None)
        self._news.set()

    async def receive(self) -> bytes:
        """Wait for bytes."""
        while not self._arrived:
            self._news = anyio.Event()
            await self._news.wait()
        data = self._arrived.popleft()
        if data is None:
            raise LinkClosed("the controller closed the connection")
        return data

    async def send(self, data: bytes) -> None:
        """Keep what is sent and let the answer arrive."""
        self.sent.append(data)
        await anyio.sleep(self._delay_s)
        for piece in self._answer(data):
            self.push(piece)

    async def aclose(self) -> None:
        """Close it."""
        self.closed = True


class FakeConnector:
    """Gives out connections in order; an exception in the list is raised instead. After the last, nobody answers."""

    peer = "192.0.2.1:5001"

    def __init__(self, *outcomes: Connection | Exception) -> None:
        self._outcomes = list(outcomes)
        self.attempts_s: list[float] = []
        self.notes: list[str] = []
        self.rejects: dict[str, int] = {}
        self.closed = False

    async def aclose(self) -> None:
        """Release what is held between connections."""
        self.closed = True

    async def connect(self) -> Connection:
        """Give out the next connection."""
        self.attempts_s.append(anyio.current_time())
        await anyio.sleep(0.01)
        outcome = self._outcomes.pop(0) if self._outcomes else LinkClosed("connection refused")
        if isinstance(outcome, Exception):
            raise outcome
        return outcome
