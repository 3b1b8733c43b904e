"""What the doors are told: how they send, who may talk to them, and how much."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import msgspec

from gateway.api.messages import AccessMode
from gateway.config.keys import canonical, is_loopback

if TYPE_CHECKING:
    from gateway.config import Config
    from gateway.config.certificates import TlsFiles
    from gateway.config.tokens import Token


@dataclass(frozen=True, slots=True, kw_only=True)
class AccessSettings:
    """Who may talk to the doors.

    Attributes:
        tokens: One of them is needed, and of an empty tuple nobody has one; None: nobody needs one.
        insecure: Whether other machines are let in without a token.
        allowed_hosts: Names, in lower case, that the Host header may hold besides those of this machine and addresses.
        allowed_origins: Pages of other sites that may read, as a browser writes their Origin; `*`: any.
    """

    tokens: tuple[Token, ...] | None = None
    insecure: bool = False
    allowed_hosts: frozenset[str] = frozenset()
    allowed_origins: frozenset[str] = frozenset()

    @property
    def mode(self) -> AccessMode:
        """Who is let in: programs of this machine, who has a token, or everybody."""
        if self.tokens is not None:
            return "tokens"
        return "insecure" if self.insecure else "loopback"


@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """How much one peer address may ask for.

    Attributes:
        connections: Open sockets.
        handshakes_per_s: Requests over HTTP, WebSocket handshakes among them; more after a rest.
        messages_per_s: Messages that it sends on its WebSockets; they are read no faster.
        subscriptions: Over all its connections.
    """

    connections: int = 1000
    handshakes_per_s: float = 1000.0
    messages_per_s: float = 2000.0
    subscriptions: int = 20_000


@dataclass(frozen=True, slots=True, kw_only=True)
class DoorSettings:
    """What the doors are told.

    Attributes:
        flush_s: How long samples may be collected into one message.
        access: Who may talk to them.
        tls: Certificate and key; None: the doors speak in the clear.
        limits: How much one peer may ask for.
    """

    flush_s: float = 0.0
    access: AccessSettings = field(default_factory=AccessSettings)
    tls: TlsFiles | None = None
    limits: Limits = field(default_factory=Limits)


def door_settings(config: Config) -> DoorSettings:
    """What the doors are told by a configuration."""
    server = config.server
    host, _ = server.address
    own = {canonical(host)}  # a name that is listened on is a name of this machine
    return DoorSettings(
        flush_s=server.flush_ms / 1000,
        access=AccessSettings(
            tokens=config.tokens,
            insecure=server.insecure and not is_loopback(host),
            allowed_hosts=frozenset({canonical(name) for name in server.allowed_hosts} | own),
            allowed_origins=frozenset(map(_as_sent, server.allowed_origins)),
        ),
        tls=config.tls,
        limits=Limits(**msgspec.structs.asdict(server.limits)),
    )


def _as_sent(origin: str) -> str:
    """An Origin as browsers send it: in lower case, and without the port that goes without saying."""
    plain = origin.lower()
    for scheme, port in (("http://", ":80"), ("https://", ":443")):
        if plain.startswith(scheme):
            plain = plain.removesuffix(port)
    return plain
