"""Who may talk to the doors: the Host and the Origin of a request, its token, and what of the cell it may see.

What was said here of a token is its hash and its name. The token itself is taken off the request before any handler
sees it: it cannot come into a log, an error or an answer.
"""

from __future__ import annotations

import hashlib
import hmac
import ipaddress
import re
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from http import HTTPStatus

import structlog
from aiohttp import hdrs, web
from multidict import CIMultiDict

from gateway.api.messages import TOKEN_SUBPROTOCOL, AccessMode
from gateway.server.cell import CELL, Cell
from gateway.server.refusals import REFUSALS
from gateway.server.settings import AccessSettings

_LOG: structlog.typing.FilteringBoundLogger = structlog.get_logger()
_LOCAL_NAMES = {"localhost", "localhost.localdomain"}
# host, host:port or [address]:port, and nothing else
_AUTHORITY = re.compile(r"(?:\[(?P<address>[0-9a-f:.]+)\]|(?P<name>[a-z0-9._-]+))(?::[0-9]{1,5})?", re.IGNORECASE)
_DEFAULT_PORTS = {"http": ":80", "https": ":443"}
_PARAMETER = "token"
# A token has 47 characters. Hashing a much longer text would cost us more than sending it costs a stranger.
_LONGEST_TOKEN = 256
_SHOWN = 100  # characters of a foreign header that are repeated
_PREFLIGHT = {
    hdrs.ACCESS_CONTROL_ALLOW_METHODS: "GET, HEAD, OPTIONS",
    hdrs.ACCESS_CONTROL_ALLOW_HEADERS: "Authorization, Last-Event-ID",
    hdrs.ACCESS_CONTROL_MAX_AGE: "600",
}
_CHALLENGE = {hdrs.WWW_AUTHENTICATE: 'Bearer realm="robot-gateway"'}
REVOKED = "token revoked"
_HOW = "send Authorization: Bearer TOKEN, offer the WebSocket subprotocol bearer.TOKEN, or add ?token=TOKEN"
_Handler = Callable[[web.Request], Awaitable[web.StreamResponse]]


@dataclass(frozen=True, slots=True)
class Caller:
    """Who asks.

    Attributes:
        name: The name of its token; None: it has none.
        topics: Globs of what it may read; None: everything.
        key: The hash of its token: another token of the same name is another caller.
    """

    name: str | None
    topics: tuple[str, ...] | None
    key: bytes = field(default=b"", repr=False)


# Where nobody needs a token, and who has none where one is needed.
_EVERYBODY = Caller(None, None)
_STRANGER = Caller(None, ())


class Access:
    """Who is let in now.

    Args:
        settings: Who may talk to the doors.
    """

    def __init__(self, settings: AccessSettings) -> None:
        self.replace(settings)

    def replace(self, settings: AccessSettings) -> None:
        """Take other settings; who is connected already is not looked at, see `gateway.server.revoking`."""
        self.settings = settings
        self._views: dict[tuple[str, ...], Cell] = {}
        tokens = settings.tokens or ()
        # A glob that names every topic is no limit: such a caller has the cell itself.
        self._callers = [
            Caller(token.name, None if "*" in token.topics else token.topics, token.sha256) for token in tokens
        ]

    @property
    def mode(self) -> AccessMode:
        """Who is let in: programs of this machine, who has a token, or everybody."""
        return self.settings.mode

    def is_current(self, caller: Caller) -> bool:
        """Whether a caller that was let in would be let in now, to see the same."""
        return caller in self._callers if self.settings.tokens is not None else caller == _EVERYBODY

    def known(self, token: str) -> Caller | None:
        """Whose token this is.

        All hashes are compared whole, so that the time does not tell how near a wrong one came.
        """
        if len(token) > _LONGEST_TOKEN:
            return None
        digest = hashlib.sha256(token.encode("utf-8", "surrogateescape")).digest()
        found = None
        for caller in self._callers:
            if hmac.compare_digest(caller.key, digest):
                found = caller
        return found

    def view(self, cell: Cell, caller: Caller) -> Cell:
        """The cell as a caller may see it; callers that may see the same share it."""
        if caller.topics is None:
            return cell
        found = self._views.get(caller.topics)
        if found is None:
            found = self._views[caller.topics] = cell.limited(caller.topics)
        return found

    def knows_host(self, authority: str) -> bool:
        """Whether a Host header names this machine.

        An address always does. DNS rebinding, which makes a browser believe that a page of another site came from
        here, needs a name that its author can point here: no page comes from an address that is not its own.
        """
        match = _AUTHORITY.fullmatch(authority)
        if match is None:
            return False
        host = (match["address"] or match["name"]).lower()
        return host in _LOCAL_NAMES or _is_address(host) or host.rstrip(".") in self.settings.allowed_hosts

    def allows_origin(self, origin: str) -> bool:
        """Whether pages of another site may read."""
        allowed = self.settings.allowed_origins
        return "*" in allowed or origin.lower() in allowed


ACCESS = web.AppKey("access", Access)
CALLER = web.RequestKey("caller", Caller)
_FOREIGN = web.RequestKey("foreign_origin", str)
# The canonical paths that are answered without a token.
PUBLIC = web.AppKey("public", frozenset[str])


def caller_of(request: web.Request) -> Caller:
    """Who asks."""
    return request[CALLER]


def announced(request: web.Request) -> structlog.typing.FilteringBoundLogger:
    """Log that a client is here, by name where it has one; returns the log of what becomes of it."""
    caller = caller_of(request)
    if caller.name is None:
        log = _LOG.bind(peer=request.remote)
        log.debug("subscriber.connected")
    else:
        log = _LOG.bind(peer=request.remote, subscriber=caller.name)
        log.info("subscriber.connected")
    return log


def parted(request: web.Request, log: structlog.typing.FilteringBoundLogger, reason: str | None = None) -> None:
    """Say in the log who has left, and why; None: of its own will."""
    more = {} if reason is None else {"reason": reason}
    if caller_of(request).name is None:
        log.debug("subscriber.disconnected", **more)
    else:
        log.info("subscriber.disconnected", **more)


def cell_of(request: web.Request) -> Cell:
    """The cell as the caller may see it: every handler reads this one, and no other."""
    return request.app[ACCESS].view(request.app[CELL], caller_of(request))


def is_upgrade(request: web.Request) -> bool:
    """Whether a WebSocket is asked for."""
    return request.headers.get(hdrs.UPGRADE, "").lower() == "websocket"


def is_own(origin: str, authority: str, *, tls: bool = False) -> bool:
    """Whether an Origin is a page that came from where the Host header points.

    Args:
        origin: The Origin header.
        authority: The Host header.
        tls: Whether the request came over TLS. Without it the page may still have: a proxy may have taken it off.
    """
    asked, host = origin.lower(), authority.lower()
    schemes = ("https",) if tls else ("http", "https")
    return any(_plain(asked, scheme) == _plain(f"{scheme}://{host}", scheme) for scheme in schemes)


@web.middleware
async def refuse_foreign(request: web.Request, handler: _Handler) -> web.StreamResponse:
    """Refuse a foreign Host (DNS rebinding), a foreign Origin (a page of another site), and who has no token."""
    access = request.app[ACCESS]
    _check_host(request, access)
    _check_origin(request, access)
    if _FOREIGN in request and _is_preflight(request):
        return web.Response(status=HTTPStatus.NO_CONTENT, headers=_PREFLIGHT)
    token = _presented(request)
    inner = request if token is None else _without_token(request)
    inner[CALLER] = _admitted(request, access, token)
    return await handler(inner)


async def allow_foreign(request: web.Request, response: web.StreamResponse) -> None:
    """Let a browser give an answer to a page of another site that may read."""
    if request.app[ACCESS].settings.allowed_origins:
        response.headers.add(hdrs.VARY, hdrs.ORIGIN)
    origin = request.get(_FOREIGN)
    if origin is not None:
        response.headers[hdrs.ACCESS_CONTROL_ALLOW_ORIGIN] = origin
        response.headers["Cross-Origin-Resource-Policy"] = "cross-origin"


def _check_host(request: web.Request, access: Access) -> None:
    host = request.headers.get(hdrs.HOST)
    if host is None:  # HTTP/1.0, as health checks of proxies speak it: every browser names a host
        return
    if not access.knows_host(host):
        what = f"Host {host[:_SHOWN]!r} is not known here"
        request.app[REFUSALS].add("host", request.remote, what)
        raise web.HTTPForbidden(text=f"{what}: use localhost or an address, or add it to server.allowed_hosts\n")


def _check_origin(request: web.Request, access: Access) -> None:
    origin = request.headers.get(hdrs.ORIGIN)
    if origin is None or is_own(origin, request.headers.get(hdrs.HOST, ""), tls=request.secure):
        return
    if not access.allows_origin(origin):
        what = f"Origin {origin[:_SHOWN]!r} is not this gateway"
        request.app[REFUSALS].add("origin", request.remote, what)
        raise web.HTTPForbidden(text=f"{what}: only its pages and those in server.allowed_origins may read it\n")
    request[_FOREIGN] = origin


def _is_preflight(request: web.Request) -> bool:
    """Whether a browser asks what a page may ask: it never sends a token along."""
    return request.method == hdrs.METH_OPTIONS and hdrs.ACCESS_CONTROL_REQUEST_METHOD in request.headers


def _admitted(request: web.Request, access: Access, token: str | None) -> Caller:
    """Who asks.

    Raises:
        web.HTTPUnauthorized: A token is needed, and this is none.
    """
    if access.settings.tokens is None:
        return _EVERYBODY
    caller = access.known(token) if token else None
    if caller is not None:
        return caller
    is_public = _is_public(request)
    if token:
        request.app[REFUSALS].add("token", request.remote, "its token is not known")
    elif not is_public:
        request.app[REFUSALS].add("no_token", request.remote, "it has no token")
    if is_public:
        return _STRANGER
    what = "the token is not known here, or no longer" if token else "a token is needed"
    raise web.HTTPUnauthorized(text=f"{what}: {_HOW}\n", headers=_CHALLENGE)


def _is_public(request: web.Request) -> bool:
    resource = request.match_info.route.resource
    return resource is not None and resource.canonical in request.app[PUBLIC] and not is_upgrade(request)


def _presented(request: web.Request) -> str | None:
    """The token that a request brings, in any of the three ways; empty where it is; None: it brings none."""
    scheme, _, value = request.headers.get(hdrs.AUTHORIZATION, "").partition(" ")
    if scheme.lower() == "bearer":
        return value.strip()
    offered = [name.removeprefix(TOKEN_SUBPROTOCOL) for name in _subprotocols(request) if _is_token(name)]
    return offered[0] if offered else request.query.get(_PARAMETER)


def _without_token(request: web.Request) -> web.Request:
    """The same request without its token, wherever it stood."""
    headers = CIMultiDict(
        (name, value)
        for name, value in request.headers.items()
        if name.lower() not in {"authorization", "sec-websocket-protocol"} and value.isprintable()
    )
    kept = [name for name in _subprotocols(request) if not _is_token(name) and name.isprintable()]
    if kept:
        headers[hdrs.SEC_WEBSOCKET_PROTOCOL] = ", ".join(kept)
    return request.clone(rel_url=request.rel_url.without_query_params(_PARAMETER), headers=headers)


def _subprotocols(request: web.Request) -> list[str]:
    lines = request.headers.getall(hdrs.SEC_WEBSOCKET_PROTOCOL, ())
    return [name.strip() for line in lines for name in line.split(",")]


def _is_token(subprotocol: str) -> bool:
    return subprotocol.startswith(TOKEN_SUBPROTOCOL)


def _is_address(host: str) -> bool:
    try:
        ipaddress.ip_address(host)
    except ValueError:
        return False
    return True


def _plain(origin: str, scheme: str) -> str:
    return origin.removesuffix(_DEFAULT_PORTS[scheme])
