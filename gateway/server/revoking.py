"""What a change of access does to those who are connected: who would not be let in now, to see the same, has to go."""

from __future__ import annotations

from typing import TYPE_CHECKING

import anyio
import structlog
from aiohttp import WSCloseCode, web

from gateway.server.access import ACCESS, REVOKED
from gateway.server.native import CLIENTS
from gateway.server.sse import STREAMS
from gateway.server.tls import TLS

if TYPE_CHECKING:
    from gateway.server.settings import AccessSettings, DoorSettings

_LOG = structlog.get_logger()


async def apply_access(app: web.Application, settings: DoorSettings) -> None:
    """Let in by other settings from now on, and send away who is not let in by them any longer.

    The certificate is read again, whether or not its files have changed. A listener that is to begin to speak TLS, or
    to stop, must be opened anew with `app[TLS].context`.

    Args:
        app: The doors.
        settings: What they are told now.
    """
    access = app[ACCESS]
    access.replace(settings.access)
    warn_insecure(settings.access)
    app[TLS].reload(settings.tls)
    streams, clients = app[STREAMS], app[CLIENTS]
    for stream in streams:
        if not access.is_current(stream.caller):
            stream.stop(REVOKED)
    async with anyio.create_task_group() as tasks:
        for client in list(clients):
            if client.caller is not None and not access.is_current(client.caller):
                tasks.start_soon(client.close, WSCloseCode.POLICY_VIOLATION, REVOKED)


def warn_insecure(settings: AccessSettings, listen: str = "") -> None:
    """Say at each start that everybody is let in, where it is so."""
    if settings.mode == "insecure":
        what = "everybody who reaches this address can read everything: set server.tokens"
        _LOG.warning("doors.insecure", reason=what, **({"listen": listen} if listen else {}))
