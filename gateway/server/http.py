"""The listener: one port for every door."""

from __future__ import annotations

import errno
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from functools import partial

from aiohttp import hdrs, web

from gateway.errors import GatewayError
from gateway.server import foxglove, openapi, pages, rest
from gateway.server.access import refuse_foreign
from gateway.server.answers import in_json, secure
from gateway.server.cell import Cell
from gateway.server.health import PULSE, Pulse, healthz, readyz
from gateway.server.metrics import REGISTRY, metrics, registry_of
from gateway.server.native import CELL, CLIENTS, PACE, Client, Clients, Pace, websocket
from gateway.server.sse import STREAMS, Streams, stream
from gateway.server.traffic import DOORS, Doors, Traffic

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


_ROUTES: dict[str, pages.Handler] = {
    "/ws": websocket,
    "/foxglove": foxglove.websocket,
    "/healthz": healthz,
    "/readyz": readyz,
    "/metrics": metrics,
    "/api/v1/robots": rest.robots,
    "/api/v1/robots/{name}": rest.robot,
    "/api/v1/topics/{topic:.+}": rest.topic,
    "/api/v1/events": rest.events,
    "/api/v1/schema": rest.schemas,
    "/api/v1/schema/{topic:.+}": rest.schema,
    "/api/v1/stream": stream,
    "/api/v1/openapi.json": openapi.document,
}


def make_app(cell: Cell, pace: Pace, pulse: Pulse) -> web.Application:
    """All doors of the listener."""
    app = web.Application(middlewares=[in_json, refuse_foreign])
    app[CELL] = cell
    app[PACE] = pace
    app[CLIENTS] = Clients()
    app[STREAMS] = Streams()
    app[DOORS] = Doors(native=Traffic(), foxglove=Traffic(), sse=Traffic())
    app[PULSE] = pulse
    app[REGISTRY] = registry_of(cell, partial(_delivered, app[DOORS], app[CLIENTS]), pulse)
    app.on_response_prepare.append(secure)
    app.on_shutdown.append(_say_goodbye)
    page = pages.routes(pages.load())
    for path, handler in {**page, "/": _front(page.get("/")), **_ROUTES}.items():
        app.router.add_get(path, handler)
    return app


def _front(index: pages.Handler | None) -> pages.Handler:
    """What stands at `/`: the page for a browser, the Foxglove door for a client of its protocol."""

    async def front(request: web.Request) -> web.StreamResponse:
        if request.headers.get(hdrs.UPGRADE, "").lower() == "websocket":
            return await foxglove.websocket(request)
        if index is None:
            raise web.HTTPNotFound
        return await index(request)

    return front


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
    pulse = Pulse()
    app = make_app(cell, Pace(flush_s=flush_s, stuck_s=stuck_s), pulse)
    runner = web.AppRunner(app, access_log=None, shutdown_timeout=_SHUTDOWN_S)
    await runner.setup()
    try:
        site = web.TCPSite(runner, host, port)
        try:
            await site.start()
        except OSError as error:
            raise ListenError(f"{host}:{port}", _advice(error)) from error
        with pulse.beating():
            yield int(runner.addresses[0][1])
    finally:
        await runner.cleanup()


def _delivered(doors: Doors, clients: Clients) -> Doors:
    """The traffic of every door; the native one counts in its turns."""
    native = doors["native"]
    native.clients = sum(isinstance(client, Client) for client in clients)  # those of Foxglove are among them
    if clients.turns is not None:
        native.n_bytes, native.missed_samples = clients.turns.n_bytes, clients.turns.n_missed
    return doors


async def _say_goodbye(app: web.Application) -> None:
    """Tell every client that the gateway is going."""
    app[STREAMS].stop()
    await app[CLIENTS].send_away()


def _advice(error: OSError) -> str:
    if error.errno == errno.EADDRINUSE:
        return "the port is in use, perhaps by another gateway: end that one, or set server.listen to another port"
    if error.errno == errno.EACCES:
        return "not permitted: take a port above 1023"
    if error.errno == errno.EADDRNOTAVAIL:
        return "this machine has no such address: set server.listen to one that it has"
    return error.strerror or str(error)
