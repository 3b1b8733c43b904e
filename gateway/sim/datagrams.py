"""Virtual controllers over UDP: each address that sends something is a client, served like a connection."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import cast

from gateway.sim.connection import Connection


class Datagrams(asyncio.DatagramProtocol):
    """Gives each client a connection of its own, which forgets it when it is closed.

    Args:
        connect: Makes what serves one client.
    """

    def __init__(self, connect: Callable[[], Connection]) -> None:
        self._connect = connect
        self._clients: dict[object, tuple[_Client, Connection]] = {}

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Take the socket."""
        self._transport = cast("asyncio.DatagramTransport", transport)

    def datagram_received(self, data: bytes, addr: tuple[str, int]) -> None:
        """Hand a datagram to its client's connection."""
        if addr not in self._clients:
            served = self._connect()
            client = _Client(self._transport, addr, lambda: self._forget(addr))
            self._clients[addr] = client, served
            served.connection_made(client)
        self._clients[addr][1].take(data)

    def error_received(self, _exc: Exception) -> None:
        """A client has gone without a word: nothing says which."""

    def _forget(self, addr: object) -> None:
        _, served = self._clients.pop(addr, (None, None))
        if served is not None:
            served.connection_lost(None)


class _Client(asyncio.Transport):
    """The way back to one client."""

    def __init__(self, transport: asyncio.DatagramTransport, addr: tuple[str, int], forget: Callable[[], None]) -> None:
        super().__init__()
        self._transport = transport
        self._addr = addr
        self._forget = forget
        self._closed = False

    def write(self, data: bytes | bytearray | memoryview) -> None:
        """Send one datagram."""
        if not self.is_closing():
            self._transport.sendto(data, self._addr)

    def is_closing(self) -> bool:
        """Whether the client, or the whole socket, is closed."""
        return self._closed or self._transport.is_closing()

    def close(self) -> None:
        """Forget the client; its next datagram makes it a new one."""
        if not self._closed:
            self._closed = True
            self._forget()

    def abort(self) -> None:
        """Forget the client."""
        self.close()

    def pause_reading(self) -> None:
        """Nothing holds a sender of datagrams back."""

    def resume_reading(self) -> None:
        """Nothing was held back."""
