"""Server-sent events: samples, events and what was missed as a stream that curl and a browser's EventSource read.

Each event carries an `id:` from which the whole stream, all its rings, is resumed by `Last-Event-ID`.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Sequence
from typing import cast

import anyio
import anyio.lowlevel
import msgspec
import structlog
from aiohttp import hdrs, web

from gateway.api.messages import Missed, Request, Subscribe
from gateway.server.access import ACCESS, REVOKED, announced, caller_of, cell_of, parted
from gateway.server.answers import converted, parameters, splitted
from gateway.server.bookmark import Bookmark
from gateway.server.limits import PEERS, Quota
from gateway.server.native import PACE
from gateway.server.outbox import Outbox
from gateway.server.requests import BadRequest, Requests
from gateway.server.traffic import DOORS, Traffic
from gateway.server.wire import JSON, Named

_LOG = structlog.get_logger()
HEARTBEAT_S = 15.0
# So often a stream that has nothing to say looks whether its client is still there.
_WATCH_S = 1.0
_RETRY_MS = 1000
# A client that is told to go has so long to take what is being written, and as long for the farewell.
_FAREWELL_S = 0.4
_STOPPING = "the gateway is stopping"
_HEADERS = {
    hdrs.CONTENT_TYPE: "text/event-stream",
    hdrs.CACHE_CONTROL: "no-store",
    "X-Accel-Buffering": "no",  # a proxy must not collect a stream
}
_LAST_ID = "Last-Event-ID"


class _Name(msgspec.Struct):
    """Of an encoded event, its name."""

    name: str


class Sse:
    """The encoding of one stream: its frames, and the id that each event moves on.

    Args:
        traffic: Where it is counted what the client missed.

    Attributes:
        bookmark: How far the client has read.
    """

    name = JSON.name  # a sample's JSON is that of the native door, and made once for both
    text = True

    def __init__(self, traffic: Traffic) -> None:
        self.bookmark = Bookmark((), None)
        self._traffic = traffic
        self._encode = msgspec.json.Encoder().encode
        self._name = msgspec.json.Decoder(_Name).decode

    def encode(self, message: object) -> bytes:
        """Encode a sample or an event as it stands in its frame, or a whole frame of anything else."""
        data = self._encode(message)
        if not isinstance(message, Missed):
            return data
        self._traffic.miss(message)
        return _frame(b"missed", data)

    def list_message(self, op: str, key: str, items: Sequence[bytes]) -> bytes:  # noqa: ARG002 - an encoding's signature
        """Frame encoded items, one by one."""
        if op != "event":
            return b"".join(_frame(b"sample", item) for item in items)
        return b"".join(self._event(item) for item in items)

    def decode(self, message: bytes | str) -> Request:  # noqa: ARG002 - as above
        """Nothing is asked on a stream."""
        raise msgspec.DecodeError("a stream takes no requests")

    def decode_id(self, message: bytes | str) -> Named:  # noqa: ARG002 - as above
        """Nothing is asked on a stream."""
        raise msgspec.DecodeError("a stream takes no requests")

    def _event(self, item: bytes) -> bytes:
        self.bookmark.move(self._name(item).name)
        return b"id: %b\n%b" % (str(self.bookmark).encode(), _frame(b"event", item))


class Stream:
    """One client of the door.

    Args:
        request: What it asked.
        response: The prepared response.
        outbox: What it is owed.
        encoding: The encoding of its outbox.
    """

    def __init__(self, request: web.Request, response: web.StreamResponse, outbox: Outbox, encoding: Sse) -> None:
        self._request = request
        self._response = response
        self._outbox = outbox
        self._encoding = encoding
        self._stuck_s = request.app[PACE].stuck_s
        self._traffic = request.app[DOORS]["sse"]
        self._writing = anyio.CancelScope()
        self._written_s = time.monotonic()
        self.caller = caller_of(request)
        self.ended: str | None = None
        self._farewell: str | None = None

    @property
    def transport(self) -> asyncio.BaseTransport | None:
        """What the connection stands on; None: it is lost."""
        return self._request.transport

    def pace(self, flush_s: float) -> None:
        """Collect its samples for another time from now on."""
        self._outbox.pace(flush_s)

    def stop(self, why: str = _STOPPING) -> None:
        """End the stream: the gateway is going, or does not let this client in any longer."""
        self.ended = self._farewell = why
        self._stuck_s = min(self._stuck_s, _FAREWELL_S)
        self._writing.deadline = min(self._writing.deadline, anyio.current_time() + self._stuck_s)
        self._outbox.wake_by(time.monotonic())

    async def serve(self) -> None:
        """Write until the client leaves, falls behind, or the gateway goes.

        Raises:
            ConnectionError: The client has left.
        """
        await self._send(b": robot-gateway\nretry: %d\n%b\n" % (_RETRY_MS, self._id()))
        while self.ended is None:
            with anyio.move_on_after(_WATCH_S) as idle:
                await self._outbox.wait()
            if self._request.transport is None:
                raise ConnectionResetError
            if not idle.cancelled_caught:
                await self._send(b"".join(self._outbox.collect()))
                if self._outbox.overflowed:
                    self._cut("too slow: more events than can be queued")
                await anyio.lowlevel.checkpoint()  # the other clients have their turn
            elif time.monotonic() - self._written_s >= HEARTBEAT_S:
                await self._beat()
        if self._farewell is not None:
            await self._send(b": %b\n\n" % self._farewell.encode())

    async def _beat(self) -> None:
        """Show that the stream lives; a client that has been idle for long is spared old holes of its rings."""
        if self._outbox.due_s > time.monotonic():
            self._encoding.bookmark.move_to_end()
        await self._send(b": heartbeat\n%b\n" % self._id())

    async def _send(self, frames: bytes) -> None:
        """Write; a client that does not take it in time is cut off."""
        if not frames:
            return
        with anyio.move_on_after(self._stuck_s) as self._writing:
            await self._response.write(frames)
        self._written_s = time.monotonic()
        self._traffic.n_bytes += len(frames)
        if self._writing.cancelled_caught:
            self._cut("too slow: nothing was read")

    def _cut(self, reason: str) -> None:
        self.ended = self.ended or reason
        self._traffic.sent_away += 1
        transport = cast("asyncio.WriteTransport | None", self._request.transport)
        if transport is not None:
            transport.abort()

    def _id(self) -> bytes:
        name = str(self._encoding.bookmark)
        return b"id: %b\n" % name.encode() if name else b""


class Streams(set[Stream]):
    """The streams that are open now."""

    def stop(self) -> None:
        """End them all."""
        for stream in self:
            stream.stop()


STREAMS = web.AppKey("streams", Streams)


async def stream(request: web.Request) -> web.StreamResponse:
    """Serve one client until it leaves or is sent away.

    Raises:
        BadRequest: It asked for what there is not.
    """
    traffic = request.app[DOORS]["sse"]
    encoding = Sse(traffic)
    outbox = Outbox(encoding, request.app[PACE].flush_s, time.monotonic)
    quota = Quota(request.app[PEERS], request.remote)
    try:
        _subscribe(request, outbox, encoding, quota)
        if request.method == hdrs.METH_HEAD:
            return web.Response(headers=_HEADERS)
        response = web.StreamResponse(headers=_HEADERS)
        try:
            await response.prepare(request)
        except ConnectionError:  # it has gone again: no reason for a traceback in the log
            return web.Response()
        open_stream = Stream(request, response, outbox, encoding)
        request.app[STREAMS].add(open_stream)
        traffic.clients += 1
        try:
            await _serve(open_stream, request)
        finally:
            traffic.clients -= 1
            request.app[STREAMS].discard(open_stream)
        return response
    finally:
        outbox.close()
        quota.close()


def _subscribe(request: web.Request, outbox: Outbox, encoding: Sse, quota: Quota) -> None:
    """Open what the URL asks for; a `Last-Event-ID` is newer than the `since` that a page began with."""
    found = parameters(request, "topics", "rate_hz", "mode", "fields", "since")
    if "topics" not in found:
        raise BadRequest("BAD_REQUEST", "URL parameters: topics is missing, such as topics=*/joints")
    last_id = request.headers.get(_LAST_ID)
    if last_id:
        found["since"] = last_id
    wish = converted({"id": "url", **splitted(found, "topics", "fields", "since")}, Subscribe)
    cell = cell_of(request)
    Requests(cell, encoding, outbox, quota).answer(wish)
    since = [wish.since] if isinstance(wish.since, str) else wish.since
    encoding.bookmark = Bookmark(cell.match(wish.topics), since)


async def _serve(open_stream: Stream, request: web.Request) -> None:
    log = announced(request)
    if not request.app[ACCESS].is_current(open_stream.caller):  # its token went while the response began
        open_stream.stop(REVOKED)
    try:
        await open_stream.serve()
    except ConnectionError:
        parted(request, log)
        return
    except Exception:
        log.exception("subscriber.failed")
        raise
    if open_stream.ended == _STOPPING:
        parted(request, log, open_stream.ended)
    else:
        log.info("subscriber.sent_away", reason=open_stream.ended)


def _frame(kind: bytes, data: bytes) -> bytes:
    return b"event: %b\ndata: %b\n\n" % (kind, data)
