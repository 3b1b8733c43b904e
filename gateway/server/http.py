"""The listener: one port for every door."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from functools import partial
from typing import cast

import anyio
from aiohttp import web

from gateway.server import foxglove, openapi, pages, rest
from gateway.server.accepting import bounded
from gateway.server.access import ACCESS, PUBLIC, Access, allow_foreign, is_upgrade, refuse_foreign
from gateway.server.answers import in_json, secure
from gateway.server.cell import CELL, Cell
from gateway.server.health import PULSE, Pulse, healthz, readyz
from gateway.server.limits import PEERS, Peers
from gateway.server.listener import Listener
from gateway.server.metrics import SCRAPES, Scrapes, metrics
from gateway.server.native import CLIENTS, PACE, Client, Clients, Pace, websocket
from gateway.server.refusals import REFUSALS, Refusals
from gateway.server.revoking import warn_insecure
from gateway.server.settings import DoorSettings
from gateway.server.sse import STREAMS, Streams, stream
from gateway.server.tls import TLS, Tls
from gateway.server.traffic import DOORS, Doors, Traffic

_SHUTDOWN_S = 0.3  # of this and the farewells the gateway may take 2 s in all
_STUCK_S = 10.0


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


def make_app(cell: Cell, pace: Pace, pulse: Pulse, settings: DoorSettings) -> web.Application:
    """All doors of the listener."""
    app = web.Application(middlewares=[bounded, in_json, refuse_foreign])
    app[CELL] = cell
    app[PACE] = pace
    app[CLIENTS] = Clients()
    app[STREAMS] = Streams()
    app[DOORS] = Doors(native=Traffic(), foxglove=Traffic(), sse=Traffic())
    app[PULSE] = pulse
    app[REFUSALS] = Refusals()
    app[PEERS] = Peers(settings.limits, app[REFUSALS], lambda: len(cell.robots))
    app[ACCESS] = Access(settings.access)
    delivered = partial(_delivered, app[DOORS], app[CLIENTS])
    app[SCRAPES] = Scrapes(delivered=delivered, pulse=pulse, refused=app[REFUSALS].counts)
    app.on_response_prepare.append(allow_foreign)
    app.on_response_prepare.append(secure)
    app.on_shutdown.append(_say_goodbye)
    page = pages.routes(pages.load())
    app[PUBLIC] = frozenset({*page, "/", "/healthz", "/readyz"})
    for path, handler in {**page, "/": _front(page.get("/")), **_ROUTES}.items():
        app.router.add_get(path, handler)
    return app


def _front(index: pages.Handler | None) -> pages.Handler:
    """What stands at `/`: the page for a browser, the Foxglove door for a client of its protocol."""

    async def front(request: web.Request) -> web.StreamResponse:
        if is_upgrade(request):
            return await foxglove.websocket(request)
        if index is None:
            raise web.HTTPNotFound
        return await index(request)

    return front


@asynccontextmanager
async def listening(
    cell: Cell,
    host: str,
    port: int,
    settings: DoorSettings,
    stuck_s: float = _STUCK_S,
) -> AsyncIterator[Listener]:
    """Open the listener for as long as the context lasts.

    Args:
        cell: What the doors show.
        host: Address to listen on.
        port: Port; 0 takes a free one.
        settings: How they send, who may talk to them, and how much.
        stuck_s: A client whose socket takes nothing for so long is sent away.

    Yields:
        What tells the port, and can be moved and told other settings.

    Raises:
        ListenError: The address is taken or not allowed.
        CertificateError: The certificate cannot be used.
    """
    pulse = Pulse()
    app = make_app(cell, Pace(flush_s=settings.flush_s, stuck_s=stuck_s), pulse, settings)
    app[TLS] = tls = Tls(settings.tls)
    runner = web.AppRunner(app, access_log=None, shutdown_timeout=_SHUTDOWN_S)
    await runner.setup()
    try:
        async with anyio.create_task_group() as tasks:
            listener = Listener(app, cast("web.Server", runner.server), tasks, settings)
            await listener.open(host, port)
            warn_insecure(settings.access, f"{host}:{listener.port}")
            with pulse.beating(), tls.watching():
                yield listener
            tasks.cancel_scope.cancel()
    except BaseExceptionGroup as group:
        if len(group.exceptions) > 1:
            raise
        raise group.exceptions[0] from None  # what the body raised, as it was
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
