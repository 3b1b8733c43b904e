"""The native WebSocket door: a reader for each client, one turn for all; `gateway.api.messages` has the protocol."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import anyio
import msgspec
from aiohttp import WSCloseCode, WSMessage, WSMsgType, web

from gateway.api import messages
from gateway.server.access import ACCESS, cell_of
from gateway.server.cell import Cell
from gateway.server.cohort import Shared
from gateway.server.frames import Wire, frame
from gateway.server.guest import STOPPING, Guest, hosted, opened
from gateway.server.limits import PEERS, Quota
from gateway.server.outbox import Outbox
from gateway.server.requests import BadRequest, Requests, decode, id_of
from gateway.server.turns import Turns
from gateway.server.wire import ENCODINGS, JSON, Encoding, encode_response

_URL_PARAMETERS = ("topics", "rate_hz", "mode", "fields", "since")


@dataclass(slots=True, kw_only=True)
class Pace:
    """How fast clients are served, and how long they are waited for; may change while they are here.

    Args:
        flush_s: How long samples may be collected into one message.
        stuck_s: A client whose socket takes nothing for so long is sent away with 1013.
    """

    flush_s: float
    stuck_s: float


class Clients(set[Guest]):
    """The clients that are here now.

    Attributes:
        turns: When they are written to; made with the first of them.
    """

    turns: Turns | None = None

    def turns_of(self, pace: Pace) -> Turns:
        """When clients are written to, all of this door together."""
        if self.turns is None:
            self.turns = Turns(pace.flush_s)
        return self.turns

    async def send_away(self) -> None:
        """Tell every client that the gateway is going; one that does not listen holds nobody up."""
        async with anyio.create_task_group() as tasks:
            for client in self:
                tasks.start_soon(client.close, WSCloseCode.GOING_AWAY, STOPPING)


PACE = web.AppKey("pace", Pace)
CLIENTS = web.AppKey("clients", Clients)


async def websocket(request: web.Request) -> web.StreamResponse:
    """Serve one client until it leaves or is sent away."""
    asked = _url_subscription(request)
    opening = await opened(request, tuple(ENCODINGS))
    if opening[1] is None:
        return opening[0]
    socket, wire = opening
    clients, pace = request.app[CLIENTS], request.app[PACE]
    quota = Quota(request.app[PEERS], request.remote)
    client = Client(socket, wire, cell_of(request), clients.turns_of(pace), pace.stuck_s, quota)
    async with hosted(request, clients, client):
        await client.serve(asked, request.app[ACCESS].mode)
    return socket


class Client(Guest):
    """One client of the native protocol.

    Args:
        socket: The prepared WebSocket.
        wire: The way to it; cut off when the client does not even take a farewell.
        cell: What it may read.
        turns: When it is written to.
        stuck_s: When its socket takes nothing for so long it is sent away.
        quota: What it may take of its peer's share.
    """

    def __init__(
        self,
        socket: web.WebSocketResponse,
        wire: Wire,
        cell: Cell,
        turns: Turns,
        stuck_s: float,
        quota: Quota,
    ) -> None:
        self._turns = turns
        self._stuck_s = stuck_s
        self._encoding: Encoding = ENCODINGS.get(socket.ws_protocol or "", JSON)
        self._outbox = Outbox(self._encoding, turns.cohorts.flush_s, turns.cohorts.now, turns.cohorts, self._on_turn)
        super().__init__(socket, wire, self._outbox, quota)
        self._requests = Requests(cell, self._encoding, self._outbox, quota)
        self._answers: list[bytes] = []  # those that the socket does not take
        self._wrong_in_a_row = 0
        self._clogged = False
        self._trouble = anyio.Event()
        self._failure: Exception | None = None
        self._waiting = anyio.CancelScope()

    @property
    def wrong_in_a_row(self) -> int:
        """How many of its last messages were wrong."""
        return self._wrong_in_a_row

    async def serve(self, first: messages.Subscribe | None, access: messages.AccessMode) -> None:
        """Read until the client leaves; it is written to when its turn comes."""
        try:
            self._owe(self._requests.welcome(access))
            if first is not None:
                await self._answer(first)
            await self.read_beside(self._look_after)
        finally:
            self._outbox.close()

    async def take(self, message: WSMessage) -> None:
        """Answer one message; whatever it is, nothing but an answer can follow."""
        data = message.data.encode() if isinstance(message.data, str) else bytes(message.data)
        try:
            request = self._decoded(message.type, data)
        except BadRequest as error:
            self._refuse(id_of(self._encoding, data), error)
        else:
            await self._answer(request)

    def _on_turn(self, shared: Shared) -> None:
        """Write what is due. A mistake in it is this client's alone."""
        if self._wire.ended:
            self._outbox.fall_behind()  # what still comes until it has left is bounded
        elif self._clogged or self._wire.full:
            self._clogged = True
            self._outbox.fall_behind()
            self._trouble.set()
            if self._outbox.overflowed:
                self._waiting.cancel()
        else:
            try:
                self._write(shared)
            except Exception as error:  # noqa: BLE001 - raised again by the client's own task
                self._failure = error
                self._trouble.set()

    def _write(self, shared: Shared) -> None:
        due = self._outbox.messages(shared)
        if self._answers:  # they were there first
            due = [*self._answers, *due]
            self._answers, self._n_unread = [], 0
            self._taken.set()
        for made in due:
            self._wire.write(made)
            self._turns.n_bytes += len(made)
        if self._outbox.overflowed:
            self._trouble.set()

    async def _look_after(self) -> None:
        """Sleep while the client keeps up; give one that does not its time, and send it away after that."""
        while True:
            await self._trouble.wait()
            self._trouble = anyio.Event()
            if self._failure is not None:
                raise self._failure
            if not self._outbox.overflowed:
                with anyio.move_on_after(self._stuck_s) as self._waiting:
                    await self._wire.drained()
            if self._outbox.overflowed:
                await self.close(WSCloseCode.TRY_AGAIN_LATER, "too slow: more events than can be queued")
                return
            if self._waiting.cancelled_caught:
                await self.close(WSCloseCode.TRY_AGAIN_LATER, "too slow: nothing was read")
                return
            self._clogged = False
            self._turns.cohorts.ask(self._outbox)

    def _decoded(self, kind: WSMsgType, data: bytes) -> messages.Request:
        expected = WSMsgType.TEXT if self._encoding.text else WSMsgType.BINARY
        if kind is not expected:
            raise BadRequest("BAD_MESSAGE", f"{self._encoding.name} takes {expected.name.lower()} frames")
        return decode(self._encoding, data)

    async def _answer(self, request: messages.Request) -> None:
        try:
            answer = await self._requests.answer_in_turns(request)
        except BadRequest as error:
            self._refuse(request.id, error)
        else:
            self._wrong_in_a_row = 0
            self._owe(answer)

    def _refuse(self, name: int | str | None, error: BadRequest) -> None:
        self._wrong_in_a_row += 1
        self._owe(messages.Error(id=name, code=error.code, message=str(error)))

    def _owe(self, answer: messages.Response) -> None:
        """Answer in this client's next turn, before anything that follows from it."""
        made = frame(encode_response(self._encoding, answer), text=self._encoding.text)
        self._answers.append(made)
        self._n_unread += len(made)
        self._turns.cohorts.ask(self._outbox)


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
