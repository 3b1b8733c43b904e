"""Who may talk to the doors: only pages and programs of this machine, until access is configured."""

from __future__ import annotations

import ipaddress
import re
from collections.abc import Awaitable, Callable

from aiohttp import web

_LOCAL_NAMES = {"localhost", "localhost.localdomain"}
# host, host:port or [address]:port, and nothing else
_AUTHORITY = re.compile(r"(?:\[(?P<address>[0-9a-f:.]+)\]|(?P<name>[a-z0-9._-]+))(?::[0-9]{1,5})?", re.IGNORECASE)


def is_local(authority: str) -> bool:
    """Whether a Host header means this machine."""
    match = _AUTHORITY.fullmatch(authority)
    if match is None:
        return False
    host = match["address"] or match["name"]
    if host.lower() in _LOCAL_NAMES:
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def is_own(origin: str, authority: str) -> bool:
    """Whether an Origin is a page that came from where the Host header points."""
    return origin.lower() in {f"{scheme}://{authority.lower()}" for scheme in ("http", "https")}


@web.middleware
async def refuse_foreign(
    request: web.Request,
    handler: Callable[[web.Request], Awaitable[web.StreamResponse]],
) -> web.StreamResponse:
    """Refuse a foreign Host (DNS rebinding) and a foreign Origin (a page of another site in this machine's browser)."""
    host = request.headers.get("Host", "")
    if not is_local(host):
        raise web.HTTPForbidden(text=f"Host {host!r} is not this machine: use localhost or 127.0.0.1\n")
    origin = request.headers.get("Origin")
    if origin is not None and not is_own(origin, host):
        raise web.HTTPForbidden(text=f"Origin {origin!r} is not this gateway: its pages may not read it\n")
    return await handler(request)
