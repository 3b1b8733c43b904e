"""One connection to a gateway: its requests, and what is pushed between them. When it ends, it ends.

    async with connect("ws://127.0.0.1:8765/ws") as client:
        await client.subscribe(["*/joints"], rate_hz=10)
        async for message in client.pushed():
            ...

One task at a time may use a connection.
"""

from __future__ import annotations

import itertools
from collections import deque
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from ssl import SSLContext
from typing import NamedTuple, TypeVar

import aiohttp
import anyio
import msgspec

from gateway.api import messages
from gateway.api.model import Event, Sample
from gateway.client.way import NOT_A_GATEWAY, ClientError, Way, failure, way_to
from gateway.errors import GatewayError

_CONNECT_S = 3.0
_HEARTBEAT_S = 30.0
_CLOSE_S = 1.0
_ENCODER = msgspec.json.Encoder()
_DECODER: msgspec.json.Decoder[messages.Response] = msgspec.json.Decoder(messages.Response)
_SILENT = f"no gateway answers: nothing came within {_CONNECT_S:g} s; is this the right port?"
Pushed = messages.Data | messages.EventMessage | messages.Missed
_Part = TypeVar("_Part")


class RequestError(GatewayError):
    """The gateway refused a request.

    Attributes:
        code: Stable, upper case.
    """

    def __init__(self, code: str, message: str) -> None:
        super().__init__(message)
        self.code = code


class CellInfo(NamedTuple):
    """What a gateway says of its cell, in one answer.

    Attributes:
        robots: Each with the state of its link.
        recorder: How the recorder does; None: there is none to be seen.
        exports: Where the cell is sent besides; empty: nowhere, or a token may not see all of it.
    """

    robots: list[messages.RobotInfo]
    recorder: messages.RecorderInfo | None
    exports: list[messages.ExportInfo]


class Client:
    """A connection to a gateway; made by `connect`.

    Attributes:
        welcome: What the gateway said first.
    """

    def __init__(self, socket: aiohttp.ClientWebSocketResponse, url: str) -> None:
        self._socket = socket
        self._url = url
        self._ids = itertools.count(1)
        self._waiting: deque[Pushed] = deque()
        self._ended: ClientError | None = None
        self.welcome: messages.Welcome

    async def greet(self) -> None:
        """Take the gateway's first message.

        Raises:
            ClientError: It is no welcome.
        """
        first = await self._receive()
        if not isinstance(first, messages.Welcome):
            raise ClientError(self._url, NOT_A_GATEWAY)
        self.welcome = first

    async def robots(self) -> list[messages.RobotInfo]:
        """Every robot with the state of its link."""
        return (await self.cell()).robots

    async def cell(self) -> CellInfo:
        """Every robot with the state of its link, and how the recorder and the exporters do."""
        result = await self._ask(messages.Robots(id=next(self._ids)))
        return CellInfo(_part(result.robots), result.recorder, result.exports or [])

    async def get(self, topics: Sequence[str]) -> list[Sample]:
        """The latest samples of some topics, once."""
        return _part((await self._ask(messages.Get(id=next(self._ids), topics=list(topics)))).samples)

    async def describe(self, topic: str) -> messages.Description:
        """What a topic holds."""
        return _part((await self._ask(messages.Describe(id=next(self._ids), topic=topic))).description)

    async def events(
        self,
        since: messages.Since | None = None,
        limit: int = 1000,
        topics: Sequence[str] = ("*",),
    ) -> list[Event]:
        """Events read back from the rings, after those named `since`: one name for each ring."""
        request = messages.Events(id=next(self._ids), since=since, limit=limit, topics=list(topics))
        return _part((await self._ask(request)).events)

    async def exports(self) -> list[messages.ExportInfo]:
        """Where the gateway sends what it reads besides; empty: nowhere, or a token may not see all of the cell."""
        return (await self.cell()).exports

    async def subscribe(
        self,
        topics: Sequence[str],
        *,
        rate_hz: float | None = None,
        mode: messages.Mode = "latest",
        fields: Sequence[str] | None = None,
        since: messages.Since | None = None,
    ) -> list[str]:
        """Ask for topics; returns the names that match now. Their samples come from `pushed()`."""
        asked = self.ask_for(topics, rate_hz=rate_hz, mode=mode, fields=fields, since=since)
        return _part((await asked).topics)

    async def ask_for(
        self,
        topics: Sequence[str],
        *,
        rate_hz: float | None = None,
        mode: messages.Mode = "latest",
        fields: Sequence[str] | None = None,
        since: messages.Since | None = None,
    ) -> messages.Result:
        """Ask for topics; returns the whole answer, with the newest event of each ring."""
        request = messages.Subscribe(
            id=next(self._ids),
            topics=list(topics),
            rate_hz=rate_hz,
            mode=mode,
            fields=None if fields is None else list(fields),
            since=since,
        )
        return await self._ask(request)

    async def pushed(self) -> AsyncIterator[Pushed]:
        """Everything that the gateway sends for the subscriptions, for ever.

        Raises:
            ClientError: The connection has ended.
        """
        while True:
            yield await self.next_pushed()

    async def next_pushed(self) -> Pushed:
        """The next thing that the gateway sends for the subscriptions; may be cancelled without a loss.

        Raises:
            ClientError: The connection has ended.
        """
        while not self._waiting:
            message = await self._receive()
            if isinstance(message, Pushed):
                return message
        return self._waiting.popleft()

    async def _ask(self, request: messages.Request) -> messages.Result:
        """Send a request and wait for its answer; what comes in between is kept.

        Raises:
            RequestError: It was refused.
            ClientError: The connection has ended.
        """
        try:
            await self._socket.send_str(_ENCODER.encode(request).decode())
        except ConnectionError:
            raise ClientError(self._url, "the connection has ended: the gateway has gone") from None
        while True:
            message = await self._receive()
            if isinstance(message, messages.Result) and message.id == request.id:
                return message
            if isinstance(message, messages.Error) and message.id in {request.id, None}:
                raise RequestError(message.code, message.message)
            if isinstance(message, Pushed):
                self._waiting.append(message)

    async def _receive(self) -> messages.Response:
        if self._ended is not None:  # what happened first is the reason
            raise self._ended
        message = await self._socket.receive()
        if message.type is not aiohttp.WSMsgType.TEXT:
            self._ended = ClientError(self._url, f"the connection has ended{_farewell(message)}")
            raise self._ended
        try:
            return _DECODER.decode(message.data)
        except msgspec.DecodeError:
            raise ClientError(self._url, NOT_A_GATEWAY) from None


@asynccontextmanager
async def connect(
    url: str | Way,
    *,
    token: str | None = None,
    ssl: SSLContext | None = None,
    heartbeat_s: float = _HEARTBEAT_S,
) -> AsyncIterator[Client]:
    """Connect to the native door of a gateway.

    Args:
        url: Such as `ws://127.0.0.1:8765/ws` or `wss://cell-7:8765/ws`; or a way made by `way_to`.
        token: For a gateway that asks for one.
        ssl: Whom to trust in a `wss` connection, such as `trusting("cell-7.pem")`; None: whom this machine trusts.
        heartbeat_s: How often the connection is tried out; one that has died is noticed within one and a half of it.

    Raises:
        ClientError: It cannot be reached, or does not let this client in.
    """
    way = url if isinstance(url, Way) else way_to(url, token, ssl)
    async with aiohttp.ClientSession(timeout=aiohttp.ClientTimeout(total=None)) as session:
        with anyio.move_on_after(_CONNECT_S) as patience:
            socket = await _open(session, way, heartbeat_s)
        if patience.cancelled_caught:
            raise ClientError(way.url, _SILENT)
        async with socket:
            client = Client(socket, way.url)
            with anyio.move_on_after(_CONNECT_S) as patience:
                await client.greet()
            if patience.cancelled_caught:
                raise ClientError(way.url, _SILENT)
            yield client


async def _open(session: aiohttp.ClientSession, way: Way, heartbeat_s: float) -> aiohttp.ClientWebSocketResponse:
    try:
        return await session.ws_connect(
            way.url,
            protocols=(messages.JSON_SUBPROTOCOL,),
            headers=way.headers,
            ssl=True if way.ssl is None else way.ssl,
            max_msg_size=0,
            heartbeat=heartbeat_s,
            timeout=aiohttp.ClientWSTimeout(ws_close=_CLOSE_S),
        )
    except (aiohttp.ClientError, OSError, ValueError) as error:
        failed = failure(way, error)
    raise failed  # out here it has no context: aiohttp's own error holds the headers, and the token in them


def _farewell(message: aiohttp.WSMessage) -> str:
    """The rest of the sentence about a connection that has ended."""
    if message.type is not aiohttp.WSMsgType.CLOSE:
        return " without a farewell: the gateway has gone, or ended with an internal error, see its log"
    if message.data == aiohttp.WSCloseCode.INTERNAL_ERROR:
        return " with an internal error of the gateway, see its log"
    return f": {message.extra or 'the gateway has gone'}"


def _part(part: _Part | None) -> _Part:
    """The part of a result that belongs to the request."""
    if part is None:
        raise RequestError("BAD_ANSWER", "the gateway's answer lacks what was asked for")
    return part
