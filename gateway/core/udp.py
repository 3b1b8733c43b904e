"""UDP as a transport: a connected socket, so that the system drops what others send and reports a refusal."""

from __future__ import annotations

import asyncio
from collections import deque
from dataclasses import dataclass
from typing import cast

import anyio
import anyio.lowlevel

from gateway.core.transport import (
    CONNECT_TIMEOUT_S,
    Connection,
    HoldsNothing,
    Pulled,
    address_text,
    describe,
    is_refusal,
)
from gateway.errors import LinkClosed

# Datagrams that may wait to be read: seconds of the fastest controller. Beyond, the oldest are dropped.
_WAITING = 1024


@dataclass(frozen=True, slots=True)
class UdpClient(HoldsNothing):
    """The gateway calls the controller over UDP.

    Args:
        host: Address or name of the controller.
        port: Its port.
    """

    host: str
    port: int

    @property
    def peer(self) -> str:
        """The controller's address, for people."""
        return f"{address_text(self.host, self.port)}/udp"

    async def connect(self) -> Connection:
        """Open a connection; see `Connector`. That it opens does not say that anybody is there."""
        loop = asyncio.get_running_loop()
        try:
            with anyio.fail_after(CONNECT_TIMEOUT_S):
                _, protocol = await loop.create_datagram_endpoint(_Datagrams, remote_addr=(self.host, self.port))
        except TimeoutError:
            raise LinkClosed(f"the name {self.host} is not resolved within {CONNECT_TIMEOUT_S:g} s") from None
        except OSError as error:
            raise LinkClosed(f"{self.peer}: {describe(error)}") from error
        return UdpConnection(protocol)


class UdpConnection(Pulled):
    """One open UDP socket, connected to its controller."""

    datagrams = True

    def __init__(self, protocol: _Datagrams) -> None:
        self._protocol = protocol

    async def receive(self) -> bytes:
        """Wait for a datagram; see `Pulled`."""
        protocol = self._protocol
        if not protocol.waiting:
            protocol.news.clear()
            while not protocol.waiting and protocol.error is None:
                await protocol.news.wait()
        else:
            await anyio.lowlevel.checkpoint()
        if protocol.waiting:
            return protocol.waiting.popleft()
        raise _closed(protocol.error)

    async def send(self, data: bytes) -> None:
        """Send a datagram; see `Connection`."""
        await anyio.lowlevel.checkpoint()
        protocol = self._protocol
        if protocol.error is not None:
            raise _closed(protocol.error)
        protocol.transport.sendto(data)

    async def aclose(self) -> None:
        """Close the socket when what was sent has left."""
        self._protocol.transport.close()
        await anyio.lowlevel.checkpoint()


class _Datagrams(asyncio.DatagramProtocol):
    """What has arrived, and why nothing more can; anyio's own UDP socket keeps a refusal to itself."""

    def __init__(self) -> None:
        self.waiting: deque[bytes] = deque(maxlen=_WAITING)
        self.error: Exception | None = None
        self.news = asyncio.Event()

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self.transport = cast("asyncio.DatagramTransport", transport)

    def datagram_received(self, data: bytes, _addr: object) -> None:
        self.waiting.append(data)
        self.news.set()

    def error_received(self, exc: Exception) -> None:
        self._end(exc)

    def connection_lost(self, exc: Exception | None) -> None:
        self._end(exc or ConnectionAbortedError("closed"))

    def _end(self, error: Exception) -> None:
        self.error = self.error or error
        self.news.set()


def _closed(error: Exception | None) -> LinkClosed:
    if error is None:
        return LinkClosed("connection lost")
    return LinkClosed(describe(error), refused=is_refusal(error))
