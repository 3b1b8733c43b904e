"""The typed async client of the native protocol: what the CLI uses, and anyone may.

    async with connect("ws://127.0.0.1:8765/ws") as client:
        await client.subscribe(["*/joints"], rate_hz=10)
        async for message in client.pushed():
            ...

It needs nothing of the gateway's core: only its message structs.
"""

from __future__ import annotations

import itertools
from collections import deque
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from typing import TypeVar

import aiohttp
import msgspec

from gateway.api import messages
from gateway.api.model import Event, Sample
from gateway.errors import GatewayError

_CONNECT_S = 3.0
_ENCODER = msgspec.json.Encoder()
_DECODER: msgspec.json.Decoder[messages.Response] = msgspec.json.Decoder(messages.Response)
Pushed = messages.Data | messages.EventMessage | messages.Missed
_Part = TypeVar("_Part")


class ClientError(GatewayError):
    """The gateway cannot be reached, or the connection to it has ended.

    Attributes:
        url: Where it should be.
        reason: What happened and what to do.
    """

    def __init__(self, url: str, reason: str) -> None:
        super().__init__(f"{url}: {reason}")
        self.url = url
        self.reason = reason


class RequestError(GatewayError):
    """The gateway refused a request.

    Attributes:
        code: Stable, upper case.
    """

    def __init__(self, code: str, message: str) -> None:
        super().__init__(message)
        self.code = code


class Client:
    """A connection to a gateway; made by `connect`.

    Attributes:
        welcome: What the gateway said first.
    """

    def __init__(self, socket: aiohttp.ClientWebSocketResponse, url: str, welcome: messages.Welcome) -> None:
        self._socket = socket
        self._url = url
        self._ids = itertools.count(1)
        self._waiting: deque[Pushed] = deque()
        self.welcome = welcome

    async def robots(self) -> list[messages.RobotInfo]:
        """Every robot with the state of its link."""
        return _part((await self._ask(messages.Robots(id=next(self._ids)))).robots)

    async def get(self, topics: Sequence[str]) -> list[Sample]:
        """The latest samples of some topics, once."""
        return _part((await self._ask(messages.Get(id=next(self._ids), topics=list(topics)))).samples)

    async def describe(self, topic: str) -> messages.Description:
        """What a topic holds."""
        return _part((await self._ask(messages.Describe(id=next(self._ids), topic=topic))).description)

    async def events(
        self,
        since: str | None = None,
        limit: int = 1000,
        topics: Sequence[str] = ("*",),
    ) -> list[Event]:
        """Events read back from the ring, after the one named `since`."""
        request = messages.Events(id=next(self._ids), since=since, limit=limit, topics=list(topics))
        return _part((await self._ask(request)).events)

    async def subscribe(
        self,
        topics: Sequence[str],
        *,
        rate_hz: float | None = None,
        mode: messages.Mode = "latest",
        fields: Sequence[str] | None = None,
        since: str | None = None,
    ) -> list[str]:
        """Ask for topics; returns the names that match now. Their samples come from `pushed()`."""
        request = messages.Subscribe(
            id=next(self._ids),
            topics=list(topics),
            rate_hz=rate_hz,
            mode=mode,
            fields=None if fields is None else list(fields),
            since=since,
        )
        return _part((await self._ask(request)).topics)

    async def pushed(self) -> AsyncIterator[Pushed]:
        """Everything that the gateway sends for the subscriptions, for ever.

        Raises:
            ClientError: The connection has ended.
        """
        while True:
            while self._waiting:
                yield self._waiting.popleft()
            message = await self._receive()
            if isinstance(message, Pushed):
                yield message

    async def _ask(self, request: messages.Request) -> messages.Result:
        """Send a request and wait for its answer; what comes in between is kept.

        Raises:
            RequestError: It was refused.
            ClientError: The connection has ended.
        """
        await self._socket.send_str(_ENCODER.encode(request).decode())
        while True:
            message = await self._receive()
            if isinstance(message, messages.Result) and message.id == request.id:
                return message
            if isinstance(message, messages.Error) and message.id in {request.id, None}:
                raise RequestError(message.code, message.message)
            if isinstance(message, Pushed):
                self._waiting.append(message)

    async def _receive(self) -> messages.Response:
        message = await self._socket.receive()
        if message.type is not aiohttp.WSMsgType.TEXT:
            reason = message.extra if isinstance(message.extra, str) and message.extra else "the gateway has gone"
            raise ClientError(self._url, f"the connection has ended: {reason}")
        return _DECODER.decode(message.data)


@asynccontextmanager
async def connect(url: str) -> AsyncIterator[Client]:
    """Connect to the native door of a gateway.

    Args:
        url: Such as `ws://127.0.0.1:8765/ws`.

    Raises:
        ClientError: It cannot be reached.
    """
    timeout = aiohttp.ClientTimeout(total=None, connect=_CONNECT_S)
    async with aiohttp.ClientSession(timeout=timeout) as session:
        try:
            socket = await session.ws_connect(
                url,
                protocols=(messages.JSON_SUBPROTOCOL,),
                max_msg_size=0,
                heartbeat=_CONNECT_S * 10,
            )
        except aiohttp.WSServerHandshakeError as error:
            raise ClientError(url, f"refused with HTTP status {error.status}") from None
        except (aiohttp.ClientError, TimeoutError, OSError, ValueError) as error:
            raise ClientError(url, _advice(error)) from None
        async with socket:
            message = await socket.receive()
            first = _DECODER.decode(message.data) if message.type is aiohttp.WSMsgType.TEXT else None
            if not isinstance(first, messages.Welcome):
                raise ClientError(url, "it answers, but not as a gateway does")
            yield Client(socket, url, first)


def _advice(error: Exception) -> str:
    if isinstance(error, aiohttp.ClientConnectorError):
        return "no gateway answers: start one with `robot-gateway run`, or name another with --url"
    return f"no gateway answers: {error or type(error).__name__}"


def _part(part: _Part | None) -> _Part:
    """The part of a result that belongs to the request."""
    if part is None:
        raise RequestError("BAD_ANSWER", "the gateway's answer lacks what was asked for")
    return part
