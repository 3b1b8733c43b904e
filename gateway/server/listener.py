"""Where the doors stand. With clients connected they can be moved to another address and be told other settings."""

from __future__ import annotations

import asyncio
import errno
import ssl
from collections.abc import Callable, Collection, Coroutine
from dataclasses import dataclass, field
from functools import partial

import anyio
from aiohttp import WSCloseCode, web
from anyio import TASK_STATUS_IGNORED
from anyio.abc import TaskGroup, TaskStatus

from gateway.errors import GatewayError
from gateway.server.accepting import accepting
from gateway.server.access import ACCESS
from gateway.server.guest import Guest
from gateway.server.limits import PEERS
from gateway.server.native import CLIENTS, PACE
from gateway.server.revoking import apply_access
from gateway.server.settings import DoorSettings
from gateway.server.sse import STREAMS, Stream
from gateway.server.tls import TLS

Address = tuple[str, int]
Leave = Callable[[], Coroutine[object, object, None]]
MOVED = "the gateway has moved to another address: connect there"
_EVERYWHERE = {"0.0.0.0", "::"}  # noqa: S104 - compared with, not listened on


class ListenError(GatewayError):
    """The listener could not be opened.

    Attributes:
        address: Which address was asked for.
        reason: Why not, and what to do.
    """

    def __init__(self, address: str, reason: str) -> None:
        super().__init__(f"cannot listen on {address}: {reason}")
        self.address = address
        self.reason = reason


@dataclass(slots=True)
class _Place:
    """One address that is listened on.

    Attributes:
        asked: Host and port as configured; port 0: any.
        tls: For TLS; None: in the clear.
        port: As it is bound.
        scope: Closes it.
        closed: Set when it is closed.
    """

    asked: Address
    tls: ssl.SSLContext | None
    port: int = 0
    scope: anyio.CancelScope = field(default_factory=anyio.CancelScope)
    closed: anyio.Event = field(default_factory=anyio.Event)


class Listener:
    """The listener of all doors.

    Args:
        app: The doors, made by the same settings.
        server: Their server.
        tasks: Where connections are accepted.
        settings: How the doors send, who may talk to them, and how much.
    """

    def __init__(self, app: web.Application, server: web.Server, tasks: TaskGroup, settings: DoorSettings) -> None:
        self._app = app
        self._server = server
        self._tasks = tasks
        self._settings = settings
        self._place: _Place | None = None

    @property
    def host(self) -> str:
        """The host as configured."""
        return self._now.asked[0]

    @property
    def port(self) -> int:
        """The port, as bound."""
        return self._now.port

    @property
    def _now(self) -> _Place:
        if self._place is None:
            raise RuntimeError("the listener is not open yet")
        return self._place

    async def open(self, host: str, port: int) -> None:
        """Open the first address.

        Raises:
            ListenError: It is taken or not allowed.
        """
        self._place = await self._opened(_Place((host, port), self._app[TLS].context))

    async def apply(self, settings: DoorSettings, host: str, port: int) -> None:
        """Take other settings, and another address if it is one.

        The new address is open before the old one closes; where both cannot be open at a time, as with another address
        of one port, the old one closes first, and opens again if the new one cannot. Clients that came over an address
        that is not listened on any more are told, and all of them where TLS begins or ends.

        Args:
            settings: How the doors send, who may talk to them, and how much.
            host: Address to listen on.
            port: Port.

        Raises:
            ListenError: The address is taken or not allowed: nothing has changed.
        """
        was, before = self._now, self._settings
        secured = (settings.tls is None) != (before.tls is None)
        if secured or (host, port) != was.asked:
            # An address must not be open for a moment to those whom the new settings keep out.
            self._app[ACCESS].replace(settings.access)
            try:
                await self._move(was, _Place((host, port), self._context(settings)), told_all=secured)
            except BaseException:
                self._app[ACCESS].replace(before.access)
                self._app[TLS].reload(before.tls)
                raise
        self._settings = settings
        self._pace(settings.flush_s)
        self._app[PEERS].replace(settings.limits)
        await apply_access(self._app, settings)

    def _context(self, settings: DoorSettings) -> ssl.SSLContext | None:
        tls = self._app[TLS]
        if not tls.reload(settings.tls):
            raise ListenError(self._now.asked[0], "the certificate cannot be used, see the log")
        return tls.context

    async def _move(self, was: _Place, to: _Place, *, told_all: bool) -> None:
        """Listen on another address."""
        try:
            to = await self._opened(to)
            await _close(was)
            here = self._connected()
        except ListenError as error:
            if not (_is_in_use(error) and was.port == to.asked[1]):
                raise
            await _close(was)
            here = self._connected()
            try:
                to = await self._opened(to)
            except ListenError:
                await self._reopen(was)
                raise
        self._place = to
        reached = [] if told_all else await _addresses(to)
        async with anyio.create_task_group() as tasks:
            for local, leave in here:
                if not _covers(reached, to.port, local):
                    tasks.start_soon(leave)

    async def _reopen(self, was: _Place) -> None:
        """Listen again on the address from before."""
        self._place = await self._opened(_Place((was.asked[0], was.port), was.tls))
        self._place.asked = was.asked

    def _connected(self) -> list[tuple[Address | None, Leave]]:
        """Who is connected: over which address of this machine, and how it is told to go."""
        clients, streams = self._app[CLIENTS], self._app[STREAMS]
        busy = {one.transport for one in (*clients, *streams)}
        idle = [one for one in self._server.connections if one.transport not in busy]
        return [
            *((_local(client.transport), partial(_send_away, client)) for client in clients),
            *((_local(stream.transport), partial(_stop, stream)) for stream in streams),
            *((_local(one.transport), partial(_close_idle, one)) for one in idle),
        ]

    def _pace(self, flush_s: float) -> None:
        self._app[PACE].flush_s = flush_s
        clients = self._app[CLIENTS]
        if clients.turns is not None:
            clients.turns.cohorts.pace(flush_s)
        for one in (*clients, *self._app[STREAMS]):
            one.pace(flush_s)

    async def _opened(self, place: _Place) -> _Place:
        """Listen on an address.

        Raises:
            ListenError: It is taken or not allowed.
        """
        host, port = place.asked
        try:
            place.port = await self._tasks.start(self._listen, place)
        except OSError as error:
            raise ListenError(f"{host}:{port}", _advice(error)) from error
        return place

    async def _listen(self, place: _Place, *, task_status: TaskStatus[int] = TASK_STATUS_IGNORED) -> None:
        try:
            with place.scope:
                async with accepting(self._app, self._server, *place.asked, place.tls) as bound:
                    task_status.started(bound)
                    await anyio.sleep_forever()
        finally:
            place.closed.set()


async def _close(place: _Place) -> None:
    place.scope.cancel()
    await place.closed.wait()


async def _send_away(client: Guest) -> None:
    await client.close(WSCloseCode.SERVICE_RESTART, MOVED)


async def _stop(stream: Stream) -> None:
    stream.stop(MOVED)


async def _close_idle(connection: web.RequestHandler) -> None:
    """Close a connection when what it answers now is answered."""
    connection.close()


async def _addresses(place: _Place) -> list[str]:
    """The addresses of this machine that a place listens on; a wildcard stands for all of them."""
    found = await anyio.getaddrinfo(place.asked[0], place.port)
    return [str(address[0]) for *_, address in found]


def _covers(reached: Collection[str], port: int, local: Address | None) -> bool:
    """Whether one that is connected over a local address could connect there again."""
    return local is not None and local[1] == port and (local[0] in reached or not _EVERYWHERE.isdisjoint(reached))


def _local(transport: asyncio.BaseTransport | None) -> Address | None:
    name = None if transport is None else transport.get_extra_info("sockname")
    return None if name is None else (str(name[0]), int(name[1]))


def _is_in_use(error: ListenError) -> bool:
    return isinstance(error.__cause__, OSError) and error.__cause__.errno == errno.EADDRINUSE


def _advice(error: OSError) -> str:
    if error.errno == errno.EADDRINUSE:
        return "the port is in use, perhaps by another gateway: end that one, or set server.listen to another port"
    if error.errno == errno.EACCES:
        return "not permitted: take a port above 1023"
    if error.errno == errno.EADDRNOTAVAIL:
        return "this machine has no such address: set server.listen to one that it has"
    return error.strerror or str(error)
