"""The native WebSocket door: one reader and one writer for each client; see `gateway.api.messages` for the protocol."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import Callable
from weakref import WeakSet

import anyio
import msgspec
import structlog
from aiohttp import WSCloseCode, WSMessage, WSMsgType, web

from gateway import __version__
from gateway.api import messages
from gateway.api.model import Event
from gateway.core.bus import Topic
from gateway.server.cell import Cell
from gateway.server.outbox import QUEUED_EVENTS, QUEUED_SAMPLES, Outbox, Subscription, Wish
from gateway.server.wire import ENCODINGS, JSON, Cut, Encoding, encode_response

_LOG = structlog.get_logger()
# A message this much over the limit is not even read: the connection ends with 1009.
_READ_LIMIT = 16 * messages.MAX_MESSAGE_BYTES
# So many wrong messages in a row, and the client is sent away with 1008.
_PATIENCE = 32
# A client whose socket takes nothing for so long is sent away with 1013.
_STUCK_S = 10.0
_CLOSE_S = 1.0
_HEARTBEAT_S = 30.0

CELL = web.AppKey("cell", Cell)
FLUSH_S = web.AppKey("flush_s", float)


class OpenSockets(WeakSet[web.WebSocketResponse]):
    """The sockets of the clients that are here now."""


SOCKETS = web.AppKey("sockets", OpenSockets)


class BadRequest(Exception):  # noqa: N818 - it is an answer to the client, no error of ours
    """A request that is refused.

    Attributes:
        code: Stable, upper case.
    """

    def __init__(self, code: str, message: str) -> None:
        super().__init__(message)
        self.code = code


async def websocket(request: web.Request) -> web.StreamResponse:
    """Serve one client until it leaves or is sent away."""
    socket = web.WebSocketResponse(
        protocols=tuple(ENCODINGS),
        max_msg_size=_READ_LIMIT,
        compress=False,
        heartbeat=_HEARTBEAT_S,
        timeout=_CLOSE_S,
    )
    asked = _url_subscription(request)
    await socket.prepare(request)
    encoding = ENCODINGS.get(socket.ws_protocol or "", JSON)
    client = Client(socket, request.transport, request.app[CELL], request.app[FLUSH_S], encoding)
    request.app[SOCKETS].add(socket)
    log = _LOG.bind(peer=request.remote)
    log.debug("subscriber.connected")
    try:
        await client.serve(asked)
    finally:
        log.debug("subscriber.disconnected", reason=str(socket.close_code))
    return socket


class Client:
    """One connected client.

    Args:
        socket: The prepared WebSocket.
        transport: What it stands on; cut off when the client does not even take a farewell.
        cell: What it may read.
        flush_s: How long samples may be collected into one message.
        encoding: The one that its subprotocol has chosen.
    """

    def __init__(
        self,
        socket: web.WebSocketResponse,
        transport: asyncio.BaseTransport | None,
        cell: Cell,
        flush_s: float,
        encoding: Encoding,
    ) -> None:
        self._socket = socket
        self._transport = transport
        self._cell = cell
        self._encoding = encoding
        self._outbox = Outbox(encoding, flush_s, time.monotonic)
        self._answers: list[bytes] = []
        self._wrong_in_a_row = 0

    async def serve(self, first: messages.Subscribe | None) -> None:
        """Read and write until the client leaves."""
        self._answers.append(encode_response(self._encoding, self._welcome()))
        if first is not None:
            self._answer(first)
        self._outbox.wake_by(time.monotonic())
        try:
            async with anyio.create_task_group() as tasks:
                tasks.start_soon(self._write)
                await self._read()
                tasks.cancel_scope.cancel()
        except* ConnectionError:
            pass  # the client is gone: nobody is left to be told
        finally:
            self._outbox.close()

    async def _read(self) -> None:
        async for message in self._socket:
            if message.type is WSMsgType.ERROR:
                return
            self._take(message)
            self._outbox.wake_by(time.monotonic())
            if self._wrong_in_a_row > _PATIENCE:
                await self._close(WSCloseCode.POLICY_VIOLATION, b"too many wrong messages")
                return

    async def _write(self) -> None:
        opcode = WSMsgType.TEXT if self._encoding.text else WSMsgType.BINARY
        while True:
            await self._outbox.wait()
            answers, self._answers = self._answers, []
            for message in [*answers, *self._outbox.collect()]:
                with anyio.move_on_after(_STUCK_S) as scope:
                    await self._socket.send_frame(message, opcode)
                if scope.cancelled_caught:
                    await self._close(WSCloseCode.TRY_AGAIN_LATER, b"too slow: nothing was read")
                    return
            if self._outbox.overflowed:
                await self._close(WSCloseCode.TRY_AGAIN_LATER, b"too slow: more events than can be queued")
                return

    async def _close(self, code: int, reason: bytes) -> None:
        """Send the client away; one that does not even take the farewell is cut off."""
        self._outbox.close()
        with anyio.move_on_after(_CLOSE_S), contextlib.suppress(ConnectionError):
            await self._socket.close(code=code, message=reason)
        if isinstance(self._transport, asyncio.WriteTransport):
            self._transport.abort()

    def _take(self, message: WSMessage) -> None:
        """Answer one message; whatever it is, nothing but an answer can follow."""
        try:
            request = self._decoded(message)
        except BadRequest as error:
            self._refuse(self._id_of(message), error)
        else:
            self._answer(request)

    def _decoded(self, message: WSMessage) -> messages.Request:
        expected = WSMsgType.TEXT if self._encoding.text else WSMsgType.BINARY
        if message.type is not expected:
            raise BadRequest("BAD_MESSAGE", f"{self._encoding.name} takes {expected.name.lower()} frames")
        size = len(message.data)
        if size > messages.MAX_MESSAGE_BYTES:
            raise BadRequest("TOO_MUCH", f"a message has at most {messages.MAX_MESSAGE_BYTES} bytes, not {size}")
        try:
            return self._encoding.decode(message.data)
        except (msgspec.DecodeError, UnicodeError, RecursionError) as error:
            raise BadRequest("BAD_MESSAGE", f"{error}; see docs/protocol.md") from None

    def _id_of(self, message: WSMessage) -> int | str | None:
        try:
            found = self._encoding.decode_any(message.data)
        except (msgspec.DecodeError, UnicodeError, RecursionError, AttributeError, TypeError):
            return None
        name = found.get("id") if isinstance(found, dict) else None
        return name if isinstance(name, (int, str)) and not isinstance(name, bool) else None

    def _answer(self, request: messages.Request) -> None:
        try:
            answer = self._HANDLERS[type(request)](self, request)
        except BadRequest as error:
            self._refuse(request.id, error)
        else:
            self._wrong_in_a_row = 0
            self._answers.append(encode_response(self._encoding, answer))

    def _refuse(self, name: int | str | None, error: BadRequest) -> None:
        self._wrong_in_a_row += 1
        refusal = messages.Error(id=name, code=error.code, message=str(error))
        self._answers.append(encode_response(self._encoding, refusal))

    def _welcome(self) -> messages.Welcome:
        return messages.Welcome(
            gateway=__version__,
            robots=list(self._cell.robots),
            last_event=self._cell.bus.events.last_name,
            limits=messages.Limits(queued_samples=QUEUED_SAMPLES, queued_events=QUEUED_EVENTS),
        )

    def _matched(self, patterns: list[str]) -> list[Topic]:
        topics = self._cell.bus.match(patterns)
        if not topics:
            raise BadRequest("UNKNOWN_TOPIC", self._cell.unknown_topic(patterns))
        return topics

    def _subscribe(self, request: messages.Subscribe) -> messages.Result:
        if request.id not in self._outbox.subscriptions and (
            len(self._outbox.subscriptions) >= messages.MAX_SUBSCRIPTIONS
        ):
            raise BadRequest("TOO_MUCH", f"a client has at most {messages.MAX_SUBSCRIPTIONS} subscriptions")
        if request.mode == "all" and request.rate_hz is not None:
            raise BadRequest("BAD_REQUEST", 'mode "all" takes every sample: leave rate_hz out')
        topics = self._matched(request.topics)
        fields = request.fields
        unknown = self._cell.unknown_fields(topics, fields or [])
        if unknown:
            raise BadRequest("UNKNOWN_FIELD", f"no matched topic has {', '.join(unknown)}; ask describe for the fields")
        resumed = self._read_back(request.since, QUEUED_EVENTS, topics) if request.since is not None else None
        wish = Wish(
            period_s=None if request.rate_hz is None else 1 / request.rate_hz,
            every=request.mode == "all",
            cut=Cut(self._encoding, None if fields is None else tuple(tuple(field.split(".")) for field in fields)),
        )
        self._outbox.remove(request.id)
        self._outbox.add(request.id, Subscription(wish, topics, self._outbox, time.monotonic()))
        if resumed is not None:
            self._outbox.resume(*resumed)
        return messages.Result(id=request.id, topics=[topic.name for topic in topics])

    def _unsubscribe(self, request: messages.Unsubscribe) -> messages.Result:
        if not self._outbox.remove(request.id):
            raise BadRequest("BAD_REQUEST", f"there is no subscription {request.id!r}")
        return messages.Result(id=request.id)

    def _get(self, request: messages.Get) -> messages.Result:
        return messages.Result(id=request.id, samples=self._cell.latest(self._matched(request.topics)))

    def _events(self, request: messages.Events) -> messages.Result:
        topics = self._matched(request.topics)
        events, missed = self._read_back(request.since, request.limit, topics)
        return messages.Result(id=request.id, events=events, missed=-1 if missed is None else missed)

    def _read_back(self, since: str | None, limit: int, topics: list[Topic]) -> tuple[list[Event], int | None]:
        robots = {topic.robot for topic in topics if topic.group.delivery == "event"}
        try:
            return self._cell.bus.events.since(since, limit, lambda event: event.robot in robots)
        except ValueError as error:
            raise BadRequest("BAD_REQUEST", str(error)) from None

    def _robots(self, request: messages.Robots) -> messages.Result:
        return messages.Result(id=request.id, robots=self._cell.infos())

    def _describe(self, request: messages.Describe) -> messages.Result:
        topic = self._cell.bus.topics.get(request.topic)
        if topic is None:
            raise BadRequest("UNKNOWN_TOPIC", self._cell.unknown_topic([request.topic]))
        return messages.Result(id=request.id, description=self._cell.describe(topic))

    def _ping(self, request: messages.Ping) -> messages.Result:
        return messages.Result(id=request.id, t=time.time_ns() // 1000)

    _HANDLERS: dict[type, Callable[..., messages.Result]] = {  # noqa: RUF012 - a table, never changed
        messages.Subscribe: _subscribe,
        messages.Unsubscribe: _unsubscribe,
        messages.Get: _get,
        messages.Events: _events,
        messages.Robots: _robots,
        messages.Describe: _describe,
        messages.Ping: _ping,
    }


def _url_subscription(request: web.Request) -> messages.Subscribe | None:
    """The subscription that a URL asks for: `/ws?topics=*/joints&rate_hz=30`."""
    query = request.query
    if "topics" not in query:
        return None
    wish: dict[str, object] = {"op": "subscribe", "id": "url", "topics": query["topics"].split(",")}
    wish.update({key: query[key] for key in ("rate_hz", "mode", "since") if key in query})
    if "fields" in query:
        wish["fields"] = query["fields"].split(",")
    try:
        return msgspec.convert(wish, messages.Subscribe, strict=False)
    except msgspec.ValidationError as error:
        raise web.HTTPBadRequest(text=f"URL parameters: {error}\n") from None
