"""The native WebSocket door: one reader and one writer for each client; see `gateway.api.messages` for the protocol."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import cast

import anyio
import anyio.lowlevel
import msgspec
import structlog
from aiohttp import WSCloseCode, WSMessage, WSMsgType, web

from gateway.api import messages
from gateway.server.cell import Cell
from gateway.server.outbox import Outbox
from gateway.server.requests import BadRequest, Requests, decode, id_of
from gateway.server.wire import ENCODINGS, JSON, Encoding, encode_response

_LOG = structlog.get_logger()
# A message this much over the limit is not even read: the connection ends with 1009.
_READ_LIMIT = 16 * messages.MAX_MESSAGE_BYTES
# So many wrong messages in a row, and the client is sent away with 1008.
_PATIENCE = 32
# While so many bytes of answers are not taken, no further request is read.
_UNREAD_ANSWERS = 1 << 20
_CLOSE_S = 1.0
_HEARTBEAT_S = 30.0
_STOPPING = "the gateway is stopping"
_URL_PARAMETERS = ("topics", "rate_hz", "mode", "fields", "since")


@dataclass(frozen=True, slots=True, kw_only=True)
class Pace:
    """How fast clients are served, and how long they are waited for.

    Args:
        flush_s: How long samples may be collected into one message.
        stuck_s: A client whose socket takes nothing for so long is sent away with 1013.
    """

    flush_s: float
    stuck_s: float


class Clients(set["Client"]):
    """The clients that are here now."""

    async def send_away(self) -> None:
        """Tell every client that the gateway is going; one that does not listen holds nobody up."""
        async with anyio.create_task_group() as tasks:
            for client in self:
                tasks.start_soon(client.close, WSCloseCode.GOING_AWAY, _STOPPING)


CELL = web.AppKey("cell", Cell)
PACE = web.AppKey("pace", Pace)
CLIENTS = web.AppKey("clients", Clients)


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
    transport = cast("asyncio.WriteTransport", request.transport)  # uvloop's is no subclass
    client = Client(socket, transport, request.app[CELL], request.app[PACE])
    request.app[CLIENTS].add(client)
    log = _LOG.bind(peer=request.remote)
    log.debug("subscriber.connected")
    try:
        await client.serve(asked)
    except Exception:
        log.exception("subscriber.failed")
        await client.close(WSCloseCode.INTERNAL_ERROR, "internal error, see the gateway's log")
    finally:
        request.app[CLIENTS].discard(client)
        if client.sent_away in {None, _STOPPING}:
            log.debug("subscriber.disconnected", reason=client.sent_away or str(socket.close_code))
        else:
            log.info("subscriber.sent_away", reason=client.sent_away)
    return socket


class Client:
    """One connected client.

    Args:
        socket: The prepared WebSocket.
        transport: What it stands on; cut off when the client does not even take a farewell.
        cell: What it may read.
        pace: How fast it is served.

    Attributes:
        sent_away: Why the gateway has ended the connection; None: it has not.
    """

    def __init__(
        self,
        socket: web.WebSocketResponse,
        transport: asyncio.WriteTransport,
        cell: Cell,
        pace: Pace,
    ) -> None:
        self._socket = socket
        self._transport = transport
        self._pace = pace
        self._encoding: Encoding = ENCODINGS.get(socket.ws_protocol or "", JSON)
        self._outbox = Outbox(self._encoding, pace.flush_s, time.monotonic)
        self._requests = Requests(cell, self._encoding, self._outbox)
        self._answers: list[bytes] = []
        self._n_unread = 0  # bytes of answers that the socket has not taken
        self._taken = anyio.Event()
        self._wrong_in_a_row = 0
        self.sent_away: str | None = None

    async def serve(self, first: messages.Subscribe | None) -> None:
        """Read and write until the client leaves."""
        self._owe(self._requests.welcome())
        if first is not None:
            self._answer(first)
        try:
            async with anyio.create_task_group() as tasks:
                tasks.start_soon(self._write)
                await self._read()
                tasks.cancel_scope.cancel()
        except* ConnectionError:
            pass  # the client is gone: nobody is left to be told
        finally:
            self._outbox.close()

    async def close(self, code: int, reason: str) -> None:
        """Send the client away; one that does not even take the farewell is cut off."""
        self.sent_away = reason
        self._outbox.close()
        try:
            with anyio.move_on_after(_CLOSE_S, shield=True):
                with contextlib.suppress(ConnectionError):  # aiohttp's own drain fails after one that was cancelled
                    await self._socket.close(code=code, message=reason.encode(), drain=False)
                while self._transport.get_write_buffer_size():  # noqa: ASYNC110 - a transport has no event for it
                    await anyio.sleep(_CLOSE_S / 100)
        finally:
            if self._transport.get_write_buffer_size() or not self._transport.is_closing():
                self._transport.abort()
            self._taken.set()

    async def _read(self) -> None:
        async for message in self._socket:
            if message.type is WSMsgType.ERROR:
                return
            self._take(message)
            if self._wrong_in_a_row > _PATIENCE:
                await self.close(WSCloseCode.POLICY_VIOLATION, "too many wrong messages")
                return
            while self._n_unread > _UNREAD_ANSWERS and self.sent_away is None:
                self._taken = anyio.Event()
                await self._taken.wait()

    async def _write(self) -> None:
        while True:
            await self._outbox.wait()
            answers, self._answers = self._answers, []
            for message in [*answers, *self._outbox.collect()]:
                if not await self._send(message):
                    await self.close(WSCloseCode.TRY_AGAIN_LATER, "too slow: nothing was read")
                    return
            if self._outbox.has_more:
                await anyio.lowlevel.checkpoint()  # the other clients have their turn
            self._n_unread -= sum(map(len, answers))
            self._taken.set()
            if self._outbox.overflowed:
                await self.close(WSCloseCode.TRY_AGAIN_LATER, "too slow: more events than can be queued")
                return

    async def _send(self, message: bytes) -> bool:
        """Send one message; whether the socket took it in time."""
        with anyio.move_on_after(self._pace.stuck_s) as scope:
            await self._socket.send_frame(message, WSMsgType.TEXT if self._encoding.text else WSMsgType.BINARY)
        return not scope.cancelled_caught

    def _take(self, message: WSMessage) -> None:
        """Answer one message; whatever it is, nothing but an answer can follow."""
        data = message.data.encode() if isinstance(message.data, str) else bytes(message.data)
        try:
            request = self._decoded(message.type, data)
        except BadRequest as error:
            self._refuse(id_of(self._encoding, data), error)
        else:
            self._answer(request)

    def _decoded(self, kind: WSMsgType, data: bytes) -> messages.Request:
        expected = WSMsgType.TEXT if self._encoding.text else WSMsgType.BINARY
        if kind is not expected:
            raise BadRequest("BAD_MESSAGE", f"{self._encoding.name} takes {expected.name.lower()} frames")
        return decode(self._encoding, data)

    def _answer(self, request: messages.Request) -> None:
        try:
            answer = self._requests.answer(request)
        except BadRequest as error:
            self._refuse(request.id, error)
        else:
            self._wrong_in_a_row = 0
            self._owe(answer)

    def _refuse(self, name: int | str | None, error: BadRequest) -> None:
        self._wrong_in_a_row += 1
        self._owe(messages.Error(id=name, code=error.code, message=str(error)))

    def _owe(self, answer: messages.Response) -> None:
        encoded = encode_response(self._encoding, answer)
        self._answers.append(encoded)
        self._n_unread += len(encoded)
        self._outbox.wake_by(time.monotonic())


def _query_fault(names: Sequence[str]) -> str | None:
    """Say what is wrong with the names of a URL's parameters; None: nothing."""
    unknown = [name for name in names if name not in _URL_PARAMETERS]
    if unknown:
        return f"unknown: {', '.join(dict.fromkeys(unknown))}; allowed are {', '.join(_URL_PARAMETERS)}"
    twice = [name for name in dict.fromkeys(names) if names.count(name) > 1]
    if twice:
        return f"more than once: {', '.join(twice)}; several topics or fields stand in one, with commas"
    return f"{', '.join(names)} without topics, such as topics=*/joints" if names and "topics" not in names else None


def _url_subscription(request: web.Request) -> messages.Subscribe | None:
    """The subscription that a URL asks for: `/ws?topics=*/joints&rate_hz=30`."""
    query = request.query
    fault = _query_fault([name for name, _ in query.items()])
    if fault:
        raise web.HTTPBadRequest(text=f"URL parameters: {fault}\n")
    if not query:
        return None
    wish: dict[str, object] = {"op": "subscribe", "id": "url", "topics": query["topics"].split(",")}
    wish.update({key: query[key] for key in ("rate_hz", "mode") if key in query})
    wish.update({key: query[key].split(",") for key in ("fields", "since") if key in query})
    try:
        return msgspec.convert(wish, messages.Subscribe, strict=False)
    except msgspec.ValidationError as error:
        raise web.HTTPBadRequest(text=f"URL parameters: {error}\n") from None
