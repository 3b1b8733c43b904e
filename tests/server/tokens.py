"""What the tests of access share: tokens, doors that ask for them, and a client that speaks plain HTTP."""

from __future__ import annotations

import hashlib
from collections.abc import AsyncIterator, Mapping
from contextlib import asynccontextmanager
from dataclasses import dataclass

import aiohttp

from gateway.api.messages import JSON_SUBPROTOCOL
from gateway.config.certificates import TlsFiles
from gateway.config.tokens import Token
from gateway.core.bus import Bus
from gateway.server.cell import Cell
from gateway.server.http import listening
from gateway.server.listener import Listener
from gateway.server.settings import AccessSettings, DoorSettings, Limits
from tests.server.kit import Robot

PLENTY = Limits(connections=10_000, handshakes_per_s=1e6, messages_per_s=1e6, subscriptions=10_000)
ALL = "rgw_" + "all-of-it_" * 4 + "abc"
R1 = "rgw_" + "only-r1-0_" * 4 + "abc"
WRONG = "rgw_" + "wrong-one_" * 4 + "abc"
HIDDEN, ABSENT = "secret9", "secret8"  # a robot that R1 may not read, and one that is not there


def token(name: str, secret: str, *topics: str) -> Token:
    """What the gateway knows of a token."""
    return Token(name, hashlib.sha256(secret.encode()).digest(), topics or ("*",))


TOKENS = (token("hmi", ALL), token("cell-one", R1, "r1/*"))


def guarded(
    *tokens: Token, hosts: tuple[str, ...] = (), origins: tuple[str, ...] = (), tls: TlsFiles | None = None
) -> DoorSettings:
    """Doors that ask for one of some tokens."""
    access = AccessSettings(tokens=tokens or TOKENS, allowed_hosts=frozenset(hosts), allowed_origins=frozenset(origins))
    return DoorSettings(access=access, tls=tls, limits=PLENTY)


@asynccontextmanager
async def doors(bus: Bus, robots: list[Robot], settings: DoorSettings | None = None) -> AsyncIterator[Listener]:
    """Open doors that ask for a token."""
    async with listening(Cell(robots, bus), "127.0.0.1", 0, settings or guarded()) as listener:
        yield listener


@dataclass(frozen=True, slots=True)
class Answer:
    """What came over HTTP."""

    status: int
    headers: Mapping[str, str]
    text: str


class Browser:
    """A client of the doors.

    Args:
        session: Of aiohttp.
        port: Of the doors.
        scheme: http or https.
    """

    def __init__(self, session: aiohttp.ClientSession, port: int, scheme: str = "http") -> None:
        self.session = session
        self.base = f"{scheme}://127.0.0.1:{port}"

    async def get(
        self, path: str, secret: str | None = None, *, method: str = "GET", headers: Mapping[str, str] | None = None
    ) -> Answer:
        """Ask for an address; of a stream no more than its first piece."""
        sent = {**({} if secret is None else {"Authorization": f"Bearer {secret}"}), **(headers or {})}
        async with self.session.request(method, self.base + path, headers=sent) as response:
            endless = response.content_type == "text/event-stream"
            text = (await response.content.readany()).decode() if endless else await response.text()
            return Answer(response.status, {**response.headers}, text)

    @asynccontextmanager
    async def websocket(
        self, path: str = "/ws", *protocols: str, headers: Mapping[str, str] | None = None
    ) -> AsyncIterator[aiohttp.ClientWebSocketResponse]:
        """Open a WebSocket."""
        asked = protocols or (JSON_SUBPROTOCOL,)
        async with self.session.ws_connect(self.base + path, protocols=asked, headers=headers) as socket:
            yield socket


@asynccontextmanager
async def browsing(port: int) -> AsyncIterator[Browser]:
    """A client of some doors."""
    async with aiohttp.ClientSession() as session:
        yield Browser(session, port)


def bearer(secret: str) -> dict[str, str]:
    """The header that says a token."""
    return {"Authorization": f"Bearer {secret}"}
