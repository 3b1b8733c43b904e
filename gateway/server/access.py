"""Who may talk to the doors: only pages and programs of this machine, until access is configured."""

from __future__ import annotations

import ipaddress
from collections.abc import Awaitable, Callable
from urllib.parse import urlsplit

from aiohttp import web

_LOCAL_NAMES = {"localhost", "localhost.localdomain"}


def is_local(host: str) -> bool:
    """Whether a host name or address means this machine."""
    if host.lower() in _LOCAL_NAMES:
        return True
    try:
        return ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return False


@web.middleware
async def refuse_foreign(
    request: web.Request,
    handler: Callable[[web.Request], Awaitable[web.StreamResponse]],
) -> web.StreamResponse:
    """Refuse a foreign Host (DNS rebinding) and a foreign Origin (a page of another site in this machine's browser)."""
    host = urlsplit(f"//{request.host}").hostname or ""
    if not is_local(host):
        raise web.HTTPForbidden(text=f"Host {request.host!r} is not this machine: use localhost or 127.0.0.1\n")
    origin = request.headers.get("Origin")
    if origin is not None and urlsplit(origin).netloc.lower() != request.host.lower():
        raise web.HTTPForbidden(text=f"Origin {origin!r} is not this gateway: its pages may not read it\n")
    return await handler(request)
