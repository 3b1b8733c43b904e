"""The listener: one port for every door."""

from __future__ import annotations

import errno
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

from aiohttp import web

from gateway import __version__
from gateway.errors import GatewayError
from gateway.server.access import refuse_foreign
from gateway.server.cell import Cell
from gateway.server.native import CELL, CLIENTS, PACE, Clients, Pace, websocket

_SHUTDOWN_S = 1.0
_STUCK_S = 10.0


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


async def healthz(_: web.Request) -> web.Response:
    """Answer while the loop turns."""
    return web.json_response({"status": "ok", "gateway": __version__})


def make_app(cell: Cell, pace: Pace) -> web.Application:
    """All doors of the listener."""
    app = web.Application(middlewares=[refuse_foreign])
    app[CELL] = cell
    app[PACE] = pace
    app[CLIENTS] = Clients()
    app.on_shutdown.append(_say_goodbye)
    app.router.add_get("/ws", websocket)
    app.router.add_get("/healthz", healthz)
    return app


@asynccontextmanager
async def listening(cell: Cell, host: str, port: int, flush_s: float, stuck_s: float = _STUCK_S) -> AsyncIterator[int]:
    """Open the listener for as long as the context lasts.

    Args:
        cell: What the doors show.
        host: Address to listen on.
        port: Port; 0 takes a free one.
        flush_s: How long samples may be collected into one message.
        stuck_s: A client whose socket takes nothing for so long is sent away.

    Yields:
        The port.

    Raises:
        ListenError: The address is taken or not allowed.
    """
    runner = web.AppRunner(
        make_app(cell, Pace(flush_s=flush_s, stuck_s=stuck_s)), access_log=None, shutdown_timeout=_SHUTDOWN_S
    )
    await runner.setup()
    try:
        site = web.TCPSite(runner, host, port)
        try:
            await site.start()
        except OSError as error:
            raise ListenError(f"{host}:{port}", _advice(error)) from error
        yield int(runner.addresses[0][1])
    finally:
        await runner.cleanup()


async def _say_goodbye(app: web.Application) -> None:
    """Tell every client that the gateway is going."""
    await app[CLIENTS].send_away()


def _advice(error: OSError) -> str:
    if error.errno == errno.EADDRINUSE:
        return "the port is in use, perhaps by another gateway: end that one, or set server.listen to another port"
    if error.errno == errno.EACCES:
        return "not permitted: take a port above 1023"
    if error.errno == errno.EADDRNOTAVAIL:
        return "this machine has no such address: set server.listen to one that it has"
    return error.strerror or str(error)
