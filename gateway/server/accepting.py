"""The sockets of the listener: which are let in, and how long one may be silent.

aiohttp's own site accepts whatever comes, and learns of a TLS client only after its handshake. Here every socket counts
from the moment it is accepted, and one too many is closed before anything is made for it.
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
import math
import socket
import ssl
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from contextlib import AsyncExitStack, asynccontextmanager, contextmanager, nullcontext
from functools import partial
from http import HTTPStatus

import anyio
import structlog
from aiohttp import web
from aiohttp.http_exceptions import HttpProcessingError
from anyio.abc import TaskGroup

from gateway.server.answers import failure
from gateway.server.limits import PEERS, Lease, Peers

_LOG = structlog.get_logger()
# A client has so long for its TLS handshake, and then for the whole header of a request from its first byte on.
HEADER_S = 10.0
# A connection that has been answered may be silent for so long; reverse proxies keep theirs for 60 s.
IDLE_S = 75.0
_BACKLOG = 512
_AT_A_TIME = 32
_NO_ROOM = {errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM}
_NO_ROOM_S = 0.5
_TOO_OFTEN = "too many requests from this address: ask less often, or raise server.limits.handshakes_per_s"
_NOT_HERE = {errno.EADDRNOTAVAIL, errno.EAFNOSUPPORT}


class Bounded(web.RequestHandler):
    """aiohttp's handler of one connection, cut off when it is silent for too long while nothing is being answered.

    Args:
        server: Of the application.
        lease: Counts the socket; released with it.
        loop: The running loop.
        header_s: Time for the header of a request, in s.
        idle_s: Time between an answer and the next request, in s.
    """

    __slots__ = ("_answering", "_begun", "_due_s", "_header_s", "_idle_s", "_lease", "_timer")

    def __init__(
        self, server: web.Server, lease: Lease, loop: asyncio.AbstractEventLoop, header_s: float, idle_s: float
    ) -> None:
        super().__init__(server, loop=loop, access_log=None)  # type: ignore[arg-type] # None: it has none
        self._lease = lease
        self._header_s = header_s
        self._idle_s = idle_s
        self._answering = False
        self._begun = True  # whether the header's time runs
        self._due_s = 0.0
        self._timer: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Begin."""
        super().connection_made(transport)
        self._wait(self._header_s)

    def connection_lost(self, exc: BaseException | None) -> None:
        """End."""
        self._lease.release()
        if self._timer is not None:
            self._timer.cancel()
        super().connection_lost(exc)
        with contextlib.suppress(AttributeError):  # nothing of aiohttp's that it promises
            self._data_received_cb = None  # it is left: with the WebSocket and its request a circle

    def data_received(self, data: bytes) -> None:
        """Take bytes; those of the next request begin its header."""
        if not (self._begun or self._answering):
            self._begun = True
            self._wait(self._header_s)
        super().data_received(data)

    def handle_error(
        self,
        request: web.BaseRequest,
        status: int = HTTPStatus.INTERNAL_SERVER_ERROR,
        exc: BaseException | None = None,
        message: str | None = None,
    ) -> web.StreamResponse:
        """Answer bytes that are no HTTP; aiohttp would log them, with the token that may stand in them."""
        if not isinstance(exc, HttpProcessingError):
            return super().handle_error(request, status, exc, message)
        _LOG.debug("request.failed", peer=request.remote, reason=type(exc).__name__)
        if request.writer.output_size > 0:
            raise ConnectionResetError
        answer = failure(status, HTTPStatus(status).name, message or "this is no HTTP")
        answer.force_close()
        return answer

    @contextmanager
    def answering(self) -> Iterator[None]:
        """Let the connection be silent while its request is answered: a WebSocket may be for ever."""
        self._answering = True
        try:
            yield
        finally:
            self._answering = self._begun = False
            self._wait(self._idle_s)

    def _wait(self, for_s: float) -> None:
        """Look in so many seconds whether it is still silent."""
        loop = asyncio.get_running_loop()
        self._due_s = loop.time() + for_s
        if self._timer is not None and self._timer.when() > self._due_s:
            self._timer.cancel()
            self._timer = None
        if self._timer is None and self.transport is not None:
            self._timer = loop.call_at(self._due_s, self._look)

    def _look(self) -> None:
        self._timer = None
        if self._answering or self.transport is None:
            return
        loop = asyncio.get_running_loop()
        if loop.time() < self._due_s:
            self._timer = loop.call_at(self._due_s, self._look)
            return
        if self._begun:
            self._lease.idle()
        self.transport.abort()  # not close: what it does not read would keep it open


@web.middleware
async def bounded(
    request: web.Request,
    handler: Callable[[web.Request], Awaitable[web.StreamResponse]],
) -> web.StreamResponse:
    """Answer a peer that asks too often with 429, and let a connection be silent while it is answered.

    It stands before every other middleware: what costs more comes behind it.
    """
    connection = request.protocol
    with connection.answering() if isinstance(connection, Bounded) else nullcontext():
        wait_s = request.app[PEERS].handshake_wait_s(request.remote)
        if wait_s > 0:
            retry = {"Retry-After": str(math.ceil(wait_s))}
            return failure(HTTPStatus.TOO_MANY_REQUESTS, "TOO_MANY_REQUESTS", _TOO_OFTEN, retry)
        return await handler(request)


@asynccontextmanager
async def accepting(
    app: web.Application,
    server: web.Server,
    host: str,
    port: int,
    tls: ssl.SSLContext | None = None,
    *,
    header_s: float = HEADER_S,
    idle_s: float = IDLE_S,
) -> AsyncIterator[int]:
    """Take connections for an application for as long as the context lasts; those that are open then stay open.

    Args:
        app: Holds the peers; `bounded` must be its first middleware.
        server: Of the application.
        host: Address or name to listen on: on each of its addresses.
        port: Port; 0 takes a free one.
        tls: For TLS; None: in the clear.
        header_s: Time for a TLS handshake, and for the header of a request, in s.
        idle_s: Time between an answer and the next request, in s.

    Yields:
        The port.

    Raises:
        OSError: The address is taken or not allowed.
    """
    loop = asyncio.get_running_loop()
    made = partial(Bounded, server, loop=loop, header_s=header_s, idle_s=idle_s)
    door = _Door(app[PEERS], made, tls, header_s)
    async with AsyncExitStack() as stack:
        listeners = await _bound(host, port)
        for listener in listeners:
            stack.enter_context(listener)
        try:
            async with anyio.create_task_group() as tasks:
                for listener in listeners:
                    tasks.start_soon(door.accept, listener, tasks)
                yield int(listeners[0].getsockname()[1])
                tasks.cancel_scope.cancel()
        except BaseExceptionGroup as group:
            if len(group.exceptions) > 1:
                raise
            raise group.exceptions[0] from None  # what the body raised, as it was


class _Door:
    """Accepts sockets and hands them to aiohttp.

    Args:
        peers: Who is let in.
        made: Makes the handler of a connection.
        tls: For TLS.
        handshake_s: Time for a TLS handshake, in s.
    """

    def __init__(
        self, peers: Peers, made: Callable[[Lease], Bounded], tls: ssl.SSLContext | None, handshake_s: float
    ) -> None:
        self._peers = peers
        self._made = made
        self._tls = tls
        self._handshake_s = handshake_s

    async def accept(self, listener: socket.socket, tasks: TaskGroup) -> None:
        """Accept for ever; where the process may open no more files, rest for a moment."""
        loop = asyncio.get_running_loop()
        while True:
            full = anyio.Event()
            loop.add_reader(listener, self._on_readable, listener, tasks, full)
            try:
                await full.wait()
            finally:
                loop.remove_reader(listener)
            await anyio.sleep(_NO_ROOM_S)

    def _on_readable(self, listener: socket.socket, tasks: TaskGroup, full: anyio.Event) -> None:
        try:
            for _ in range(_AT_A_TIME):
                self._take(*listener.accept(), tasks)
        except BlockingIOError:
            return
        except OSError as error:  # most are of one connection that has gone again
            if error.errno in _NO_ROOM:
                _LOG.error("connection.refused", reason=error.strerror)
                full.set()

    def _take(self, connection: socket.socket, address: tuple[str, int], tasks: TaskGroup) -> None:
        lease = self._peers.admit(address[0])
        if lease is None:
            connection.close()
            return
        tasks.start_soon(self._connect, connection, lease)

    async def _connect(self, connection: socket.socket, lease: Lease) -> None:
        """Make a transport and a handler for a socket; whatever goes wrong costs that socket alone."""
        connected = False
        try:
            connection.setblocking(False)  # noqa: FBT003 - its signature
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            await asyncio.get_running_loop().connect_accepted_socket(
                partial(self._made, lease),
                connection,
                ssl=self._tls,
                ssl_handshake_timeout=self._handshake_s if self._tls else None,
            )
            connected = True
        except (OSError, ssl.SSLError) as error:  # it left again, or speaks no TLS
            _LOG.debug("connection.failed", peer=lease.peer.name, reason=str(error))
        except Exception:  # noqa: BLE001 - a mistake of ours in one connection must not close the door
            _LOG.exception("connection.failed", peer=lease.peer.name)
        finally:
            if not connected:
                lease.release()
                connection.close()


async def _bound(host: str, port: int) -> list[socket.socket]:
    """Listening sockets on every address of a host that this machine has, all with one port."""
    found = await anyio.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
    bound: list[socket.socket] = []
    missing = OSError(errno.EADDRNOTAVAIL, "no such address")
    for family, _, _, _, address in dict.fromkeys(found):
        asked = bound[0].getsockname()[1] if bound else port
        try:
            bound.append(_listener(family, (address[0], asked, *address[2:])))
        except OSError as error:
            missing = error
            if error.errno not in _NOT_HERE:
                for listener in bound:
                    listener.close()
                raise
    if not bound:
        raise missing
    return bound


def _listener(family: int, address: tuple[str | int, ...]) -> socket.socket:
    listener = socket.socket(family, socket.SOCK_STREAM)
    try:
        listener.setblocking(False)  # noqa: FBT003 - its signature
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        if family == socket.AF_INET6:
            listener.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 1)
        listener.bind(address)
        listener.listen(_BACKLOG)
    except OSError:
        listener.close()
        raise
    return listener
