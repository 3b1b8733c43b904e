"""The Foxglove door itself: one reader and one writer for each client, and what its URL may ask for."""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence
from typing import Annotated

import anyio
import anyio.lowlevel
import msgspec
from aiohttp import WSCloseCode, WSMessage, web
from msgspec import Meta

from gateway.api.messages import MAX_RATE_HZ
from gateway.server.access import cell_of
from gateway.server.cell import Cell
from gateway.server.foxglove.messages import SUBPROTOCOLS, Response, encode
from gateway.server.foxglove.outbox import Outbox
from gateway.server.foxglove.session import Session
from gateway.server.frames import Wire, frame
from gateway.server.guest import Guest, hosted, opened
from gateway.server.limits import PEERS, Quota
from gateway.server.native import CLIENTS, PACE, Pace
from gateway.server.traffic import DOORS, Traffic

# Every so often a client is told which robots have come and gone.
_LOOK_S = 1.0
_Glob = Annotated[str, Meta(min_length=1, max_length=256)]


class Wish(msgspec.Struct, frozen=True):
    """What a URL may ask for: `/foxglove?topics=*/joints,r1/tf&rate_hz=30`."""

    topics: Annotated[list[_Glob], Meta(min_length=1, max_length=256)] = msgspec.field(default_factory=lambda: ["*"])
    rate_hz: Annotated[float, Meta(gt=0, le=MAX_RATE_HZ)] | None = None


async def websocket(request: web.Request) -> web.StreamResponse:
    """Serve one client until it leaves or is sent away.

    Raises:
        web.HTTPBadRequest: It asks for another subprotocol, or its URL for something else.
    """
    wish = _wish_of(request)
    _check_subprotocol(request)
    opening = await opened(request, SUBPROTOCOLS)
    if opening[1] is None:
        return opening[0]
    socket, wire = opening
    clients, traffic = request.app[CLIENTS], request.app[DOORS]["foxglove"]
    quota = Quota(request.app[PEERS], request.remote)
    client = Client(socket, wire, cell_of(request), request.app[PACE], wish, traffic, quota)
    traffic.clients += 1
    try:
        async with hosted(request, clients, client):
            await client.serve()
    finally:
        traffic.clients -= 1
    return socket


class Client(Guest):
    """One client of Foxglove's protocol.

    Args:
        socket: The prepared WebSocket.
        wire: The way to it; cut off when the client does not even take a farewell.
        cell: What it may read.
        pace: How fast it is served.
        wish: What its URL asks for.
        traffic: Where it is counted what the client gets.
        quota: What it may take of its peer's share.
    """

    def __init__(
        self,
        socket: web.WebSocketResponse,
        wire: Wire,
        cell: Cell,
        pace: Pace,
        wish: Wish,
        traffic: Traffic,
        quota: Quota,
    ) -> None:
        self._traffic = traffic
        self._stuck_s = pace.stuck_s
        period_s = None if wish.rate_hz is None else 1 / wish.rate_hz
        self._outbox = Outbox(pace.flush_s, time.monotonic, period_s, traffic)
        super().__init__(socket, wire, self._outbox, quota)
        self._session = Session(cell, wish.topics, self._outbox, quota)
        self._answers: list[str] = []

    @property
    def wrong_in_a_row(self) -> int:
        """How many of its last messages were wrong."""
        return self._session.wrong_in_a_row

    async def serve(self) -> None:
        """Read and write until the client leaves."""
        try:
            await self.read_beside(self._write)
        finally:
            self._outbox.close()

    async def take(self, message: WSMessage) -> None:
        """Answer one message; whatever it is, nothing but an answer can follow."""
        if isinstance(message.data, str):
            answer = self._session.take(message.data.encode())
        else:
            answer = self._session.take_binary(bytes(message.data))
        if answer is not None:
            encoded = encode(answer)
            self._answers.append(encoded)
            self._n_unread += len(encoded)
            self._outbox.wake_by(time.monotonic())

    async def _write(self) -> None:
        """Send everything that is due, for ever; a client that is too slow is sent away."""
        sent = await self._tell(self._session.hello())
        look_s = time.monotonic() + _LOOK_S
        while sent:
            self._outbox.wake_by(look_s)
            await self._outbox.wait()
            if time.monotonic() >= look_s:
                sent = await self._tell(self._session.refresh())
                look_s = time.monotonic() + _LOOK_S
            sent = sent and await self._send_due()
            if self._outbox.overflowed:
                await self._send_away("too slow: more events than can be queued")
                return
            if self._outbox.has_more:
                await anyio.lowlevel.checkpoint()  # the other clients have their turn
        await self._send_away("too slow: nothing was read")

    async def _send_away(self, reason: str) -> None:
        self._traffic.sent_away += 1
        await self.close(WSCloseCode.TRY_AGAIN_LATER, reason)

    async def _send_due(self) -> bool:
        """Send answers, then events and samples, in one write; whether the socket took them in time."""
        answers, self._answers = self._answers, []
        missed = self._outbox.word_on_missed()
        said = [] if missed is None else [encode(missed)]
        taken = await self._send([*answers, *self._outbox.collect(), *said])
        self._n_unread -= sum(map(len, answers))
        self._taken.set()
        return taken

    async def _tell(self, said: Iterable[Response]) -> bool:
        """Send some text frames, one by one; whether the socket took them in time."""
        for one in said:
            if not await self._send([encode(one)]):
                return False
            await anyio.lowlevel.checkpoint()  # an advertisement is long: the other clients have their turn
        return True

    async def _send(self, messages: Sequence[str | bytes]) -> bool:
        """Send text and binary frames in one write; whether the socket took them in time."""
        if messages and not self._wire.ended:
            made = b"".join(
                frame(one.encode(), text=True) if isinstance(one, str) else frame(one, text=False) for one in messages
            )
            self._wire.write(made)
            self._traffic.n_bytes += len(made)
        with anyio.move_on_after(self._stuck_s) as scope:
            await self._wire.drained()
        return not scope.cancelled_caught


def _check_subprotocol(request: web.Request) -> None:
    """Refuse a client that this door cannot talk to, and say where to go."""
    asked = [name.strip() for line in request.headers.getall("Sec-WebSocket-Protocol", []) for name in line.split(",")]
    if not set(SUBPROTOCOLS).intersection(asked):
        known = " or ".join(SUBPROTOCOLS)
        raise web.HTTPBadRequest(
            text=f"this is the Foxglove door: its WebSocket subprotocol is {known}; the gateway's own door is /ws\n"
        )


def _wish_of(request: web.Request) -> Wish:
    """What a URL asks for."""
    query = request.query
    unknown = [name for name in query if name not in Wish.__struct_fields__]
    if unknown:
        allowed = ", ".join(Wish.__struct_fields__)
        raise web.HTTPBadRequest(text=f"URL parameters: unknown: {', '.join(unknown)}; allowed are {allowed}\n")
    twice = [name for name in query if len(query.getall(name)) > 1]
    if twice:
        raise web.HTTPBadRequest(text=f"URL parameters: more than once: {twice[0]}; topics stand in one, with commas\n")
    wish = {name: value.split(",") if name == "topics" else value for name, value in query.items()}
    try:
        return msgspec.convert(wish, Wish, strict=False)
    except msgspec.ValidationError as error:
        raise web.HTTPBadRequest(text=f"URL parameters: {error}\n") from None
