"""One client of a WebSocket door, whatever it speaks there: how it comes, is read, and leaves."""

from __future__ import annotations

import asyncio
import contextlib
from abc import ABC, abstractmethod
from collections.abc import AsyncIterator, Awaitable, Callable, Sequence
from contextlib import asynccontextmanager
from typing import Protocol, cast

import anyio
import anyio.lowlevel
import structlog
from aiohttp import WSCloseCode, WSMessage, WSMsgType, web

from gateway.api.messages import MAX_MESSAGE_BYTES
from gateway.core.aside import until_given_up
from gateway.server.access import ACCESS, REVOKED, Caller, announced, caller_of, parted
from gateway.server.frames import Wire
from gateway.server.limits import Quota

_LOG = structlog.get_logger()
# A message this much over the limit is not even read: the connection ends with 1009.
_READ_LIMIT = 16 * MAX_MESSAGE_BYTES
# So many wrong messages in a row, and the client is sent away with 1008.
_PATIENCE = 32
# While so many bytes of answers are not taken, no further request is read.
_UNREAD_ANSWERS = 1 << 20
_CLOSE_S = 1.0
_HEARTBEAT_S = 30.0
STOPPING = "the gateway is stopping"


class Owed(Protocol):
    """What a client is owed."""

    def close(self) -> None:
        """End everything that it listens to."""
        ...

    def pace(self, flush_s: float) -> None:
        """Collect samples without a rate for another time from now on."""
        ...


class Guest(ABC):
    """One connected client; what it says and is told is its door's part.

    Args:
        socket: The prepared WebSocket.
        wire: The way to it; cut off when the client does not even take a farewell.
        owed: What it is owed.
        quota: What it may take of its peer's share; None: as much as it wants.

    Attributes:
        sent_away: Why the gateway has ended the connection; None: it has not.
        caller: Who it is, once it is served.
    """

    def __init__(self, socket: web.WebSocketResponse, wire: Wire, owed: Owed, quota: Quota | None) -> None:
        self._socket = socket
        self._wire = wire
        self._owed = owed
        self._quota = quota
        self._leaving = anyio.Event()
        self._n_unread = 0  # bytes of answers that the socket has not taken
        self._taken = anyio.Event()
        self.sent_away: str | None = None
        self.caller: Caller | None = None

    @property
    def transport(self) -> asyncio.BaseTransport:
        """What the connection stands on."""
        return self._wire.transport

    def pace(self, flush_s: float) -> None:
        """Collect its samples for another time from now on."""
        self._owed.pace(flush_s)

    @property
    def close_code(self) -> int | None:
        """How the connection has ended."""
        return self._socket.close_code

    @property
    @abstractmethod
    def wrong_in_a_row(self) -> int:
        """How many of its last messages were wrong."""

    @abstractmethod
    async def take(self, message: WSMessage) -> None:
        """Answer one message; whatever it is, nothing but an answer can follow."""

    async def close(self, code: int, reason: str) -> None:
        """Send the client away; one that does not even take the farewell is cut off."""
        self.sent_away = reason
        self._leaving.set()
        self._owed.close()
        try:
            with anyio.move_on_after(_CLOSE_S, shield=True):
                with contextlib.suppress(ConnectionError):  # aiohttp's own drain fails after one that was cancelled
                    await self._socket.close(code=code, message=reason.encode(), drain=False)
                await self._wire.emptied()
        finally:
            self._wire.cut()
            self._taken.set()

    async def read(self) -> None:
        """Take messages until the client leaves, or has to; who says farewell is answered."""
        async for message in self._socket:
            if message.type is WSMsgType.ERROR:
                return
            await self.take(message)
            if self.wrong_in_a_row > _PATIENCE:
                await self.close(WSCloseCode.POLICY_VIOLATION, "too many wrong messages")
                return
            while self._n_unread > _UNREAD_ANSWERS and self.sent_away is None:
                self._taken = anyio.Event()
                await self._taken.wait()
            await anyio.lowlevel.checkpoint()  # many requests at once do not hold up the other clients
            wait_s = self._quota.message_wait_s() if self._quota is not None else 0.0
            if wait_s > 0:
                with anyio.move_on_after(wait_s):
                    await self._leaving.wait()
        if not self._socket.closed:
            # aiohttp takes 1006 for a code that a client may send (RFC 6455, 7.4.1: it must not)
            is_wrong = self._socket.close_code == WSCloseCode.ABNORMAL_CLOSURE
            await self._socket.close(code=WSCloseCode.PROTOCOL_ERROR if is_wrong else WSCloseCode.OK, drain=False)

    async def read_beside(self, work: Callable[[], Awaitable[None]]) -> None:
        """Read, with some work beside it, until the client leaves."""
        work_scope = anyio.CancelScope()
        try:
            async with anyio.create_task_group() as tasks:
                tasks.start_soon(until_given_up, work_scope, work)
                with contextlib.suppress(ConnectionError):
                    await self.read()
                work_scope.cancel()
        except* ConnectionError:
            pass  # the client is gone: nobody is left to be told

    def leave(self) -> None:
        """Give back what the client has taken of its peer's share, and end what would keep it in memory."""
        failure = self._socket.exception()
        if failure is not None:  # aiohttp keeps it, and it keeps the frames that it has gone through
            failure.__traceback__ = failure.__context__ = None
        if self._quota is not None:
            self._quota.close()


async def opened(
    request: web.Request, subprotocols: Sequence[str]
) -> tuple[web.WebSocketResponse, Wire] | tuple[web.StreamResponse, None]:
    """Shake hands with a client; one that has gone before its turn came gets an answer, but there is no way to it."""
    socket = web.WebSocketResponse(
        protocols=subprotocols,
        max_msg_size=_READ_LIMIT,
        compress=False,
        autoclose=False,  # `Guest.read` does it
        heartbeat=_HEARTBEAT_S,
        timeout=_CLOSE_S,
    )
    try:
        writer = await socket.prepare(request)
    except ConnectionError:  # it has gone again: no reason for a traceback in the log
        return web.Response(), None
    if request.transport is None:
        return socket, None
    return socket, Wire(socket, cast("asyncio.WriteTransport", request.transport), writer)  # uvloop's is no subclass


@asynccontextmanager
async def hosted(request: web.Request, guests: set[Guest], guest: Guest) -> AsyncIterator[None]:
    """Have a client among the guests while it is served; a mistake of ours is logged, and sends it away."""
    guest.caller = caller_of(request)
    guests.add(guest)
    log = announced(request)
    try:
        if not request.app[ACCESS].is_current(guest.caller):  # its token went while it shook hands
            await guest.close(WSCloseCode.POLICY_VIOLATION, REVOKED)
        yield
    except Exception:
        log.exception("subscriber.failed")
        await guest.close(WSCloseCode.INTERNAL_ERROR, "internal error, see the gateway's log")
    finally:
        guests.discard(guest)
        guest.leave()
        if guest.sent_away in {None, STOPPING}:
            parted(request, log, guest.sent_away or str(guest.close_code))
        else:
            log.info("subscriber.sent_away", reason=guest.sent_away)
