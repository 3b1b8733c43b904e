"""A live reader of the recorder: gets what is kept as it comes, and loses some of it when it is too slow."""

from __future__ import annotations

from collections import deque
from collections.abc import AsyncIterator, Callable
from typing import Protocol

import anyio

from gateway.record.spool import Lost, Message, encode

# What waits for a reader that is too slow: about 20 s of 16 robots.
MOST_BYTES = 16_000_000


class Sink(Protocol):
    """Takes what is kept, as it comes. It must return at once, and never raises."""

    def put(self, robot: str, message: Message) -> None:
        """Take one message of a robot; "": of the cell."""
        ...


class Feed:
    """Hands the messages of some robots on, encoded; what does not fit is left out and counted.

    Args:
        wanted: Says which robots are wanted.
        most_bytes: How much may wait.

    Attributes:
        lost: How many messages were left out.
    """

    def __init__(self, wanted: Callable[[str], bool], most_bytes: int = MOST_BYTES) -> None:
        self._wanted = wanted
        self._most_bytes = most_bytes
        self._waiting: deque[bytes] = deque()
        self._n_bytes = 0
        self._left_out, self._left_out_bytes = 0, 0
        self._more = anyio.Event()
        self.lost = 0

    def put(self, robot: str, message: Message) -> None:
        """Take one message of a robot; "": of the cell."""
        if robot and not self._wanted(robot):
            return
        data = encode(message)
        if self._n_bytes + len(data) > self._most_bytes:
            self.lost += 1
            self._left_out += 1
            self._left_out_bytes += len(data)
            return
        if self._left_out:
            self._append(encode(Lost(n_messages=self._left_out, n_bytes=self._left_out_bytes)))
            self._left_out = self._left_out_bytes = 0
        self._append(data)

    def _append(self, data: bytes) -> None:
        self._waiting.append(data)
        self._n_bytes += len(data)
        self._more.set()

    async def pieces(self) -> AsyncIterator[bytes]:
        """What waits, for ever, as it comes."""
        while True:
            await self._more.wait()
            self._more = anyio.Event()
            while self._waiting:
                data = self._waiting.popleft()
                self._n_bytes -= len(data)
                yield data
