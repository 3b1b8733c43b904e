"""A TCP connection to a controller as the loop's own protocol: what comes is taken where the loop has read it.

anyio's stream stops and starts the reading around each receive, and wakes a task for it: two changes of the poll and
three further turns of the loop for every frame (ADR 0021).
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import cast

import anyio.lowlevel

from gateway.errors import LinkClosed

# So many bytes may wait to be decoded before no more is read: a megabyte is minutes of the fastest controller.
_MOST_WAITING = 1 << 20


class TcpStream(asyncio.Protocol):
    """One open connection; see `gateway.core.transport.Connection`.

    Args:
        describe: Says in words why the connection ended, where it did not end in order.
    """

    datagrams = False

    def __init__(self, describe: Callable[[BaseException], str]) -> None:
        self._describe = describe
        self._transport: asyncio.Transport
        self._data = b""  # what came while nobody took it
        self._take: Callable[[bytes], None] | None = None
        self._over: asyncio.Future[None] | None = None
        self._failure: BaseException | None = None
        self._ended: str | None = None  # why
        self._is_full = self._is_lost = False
        self._writable = asyncio.Event()
        self._writable.set()

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """The connection is open."""
        self._transport = cast("asyncio.Transport", transport)

    def data_received(self, data: bytes) -> None:
        """Hand bytes on, or keep them for who takes them next."""
        if self._take is not None and self._over is not None and not self._over.done():  # not given up already
            try:
                self._take(data)
            except BaseException as error:  # noqa: BLE001 - raised again where `deliver` is awaited
                self._failure = error
                self._stop()
            return
        self._data = self._data + data if self._data else data
        if len(self._data) > _MOST_WAITING:
            self._is_full = True
            self._transport.pause_reading()

    def eof_received(self) -> bool:
        """The controller sends no more; the connection is closed by its owner."""
        self._end("the controller closed the connection")
        return True

    def connection_lost(self, error: Exception | None) -> None:
        """The connection is no more."""
        reason = "the controller closed the connection" if error is None else self._describe(error)
        self._is_lost = True
        self._end(reason)
        self._writable.set()

    def pause_writing(self) -> None:
        """The controller does not read."""
        self._writable.clear()

    def resume_writing(self) -> None:
        """It does again."""
        self._writable.set()

    async def deliver(self, take: Callable[[bytes], None]) -> None:
        """Hand on what comes, at once; see `gateway.core.transport.Connection`. What came before comes first."""
        if self._failure is None and self._data:
            data, self._data = self._data, b""
            if self._is_full:
                self._is_full = False
                self._transport.resume_reading()
            take(data)
        if self._ended is None and self._failure is None:
            self._take, self._over = take, asyncio.get_running_loop().create_future()
            try:
                await self._over
            finally:
                self._take = None
        failure, self._failure = self._failure or self._closed(), None
        try:
            raise failure
        finally:
            del failure  # its traceback holds this frame: a circle that only the collector of garbage would end

    async def send(self, data: bytes) -> None:
        """Send bytes, once those before have found room."""
        await self._writable.wait()
        if self._transport.is_closing():
            raise self._closed()
        self._transport.write(data)

    async def aclose(self) -> None:
        """Close the connection: what is still under way has one turn of the loop."""
        if not self._transport.is_closing():
            self._transport.close()
            await anyio.lowlevel.checkpoint()
        if not self._is_lost:  # asyncio's own transport does not take it twice
            self._transport.abort()

    def _closed(self) -> LinkClosed:
        return LinkClosed(self._ended or "the connection is closed")

    def _end(self, why: str) -> None:
        self._ended = self._ended or why
        self._stop()

    def _stop(self) -> None:
        """Hand on nothing more."""
        self._take = None
        if self._over is not None and not self._over.done():
            self._over.set_result(None)
