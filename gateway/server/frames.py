"""WebSocket frames made once and written to many clients: the one place that goes past aiohttp to the transport.

aiohttp has no call for a prebuilt frame, and its own sending is a coroutine that makes the header anew for each client
and waits for it: with fifty clients that is most of the work. A server's data frames are not masked, so that one frame
fits all. It may come between aiohttp's own frames (ping, pong, close) because both sides hand over whole frames only,
without a wait in between. Only what aiohttp and asyncio publish is used: the request's transport, and the stream writer
that `prepare` returns, whose `drain` waits until the transport takes more.
"""

from __future__ import annotations

import asyncio
import struct

import anyio
from aiohttp import web
from aiohttp.abc import AbstractStreamWriter

# While more bytes than this are not taken, a client is not written to.
UNSENT_BYTES = 1 << 16
_WHOLE_TEXT, _WHOLE_BINARY = 0x81, 0x82
_POLL_S = 0.01


def frame(message: bytes, *, text: bool) -> bytes:
    """Put a message into one unmasked frame (RFC 6455, 5.2)."""
    first, size = _WHOLE_TEXT if text else _WHOLE_BINARY, len(message)
    if size < 126:  # noqa: PLR2004 - 126 and 127 announce a longer size
        return struct.pack("!BB", first, size) + message
    if size < 1 << 16:
        return struct.pack("!BBH", first, 126, size) + message
    return struct.pack("!BBQ", first, 127, size) + message


class Wire:
    """The way to one client.

    Args:
        socket: The prepared WebSocket.
        transport: What it stands on.
        writer: What `prepare` returned.
    """

    def __init__(
        self, socket: web.WebSocketResponse, transport: asyncio.WriteTransport, writer: AbstractStreamWriter
    ) -> None:
        self._socket = socket
        self._transport = transport
        self._writer = writer
        transport.set_write_buffer_limits(high=UNSENT_BYTES)

    @property
    def transport(self) -> asyncio.BaseTransport:
        """What the connection stands on."""
        return self._transport

    @property
    def ended(self) -> bool:
        """Whether nothing more may be written: the close frame has gone out, or the connection is lost."""
        return self._socket.closed or self._transport.is_closing()

    @property
    def full(self) -> bool:
        """Whether the client takes less than it is given."""
        return self._transport.get_write_buffer_size() > UNSENT_BYTES

    def write(self, made: bytes) -> None:
        """Write one whole frame, at once."""
        self._transport.write(made)

    async def drained(self) -> None:
        """Wait until the client has taken what was written to it.

        Raises:
            ConnectionError: It has gone.
        """
        await self._writer.drain()
        while self.full and not self.ended:  # noqa: ASYNC110 - where the transport's own limits could not be set
            await anyio.sleep(_POLL_S)

    async def emptied(self) -> None:
        """Wait until every byte has been taken."""
        while self._transport.get_write_buffer_size():  # noqa: ASYNC110 - a transport has no event for it
            await anyio.sleep(_POLL_S)

    def cut(self) -> None:
        """Cut the connection if it has not come to its end."""
        if self._transport.get_write_buffer_size() or not self._transport.is_closing():
            self._transport.abort()
