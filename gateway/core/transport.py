"""Transports: how bytes reach a controller. A `Connector` opens `Connection`s; each kind of transport is one class."""

from __future__ import annotations

import asyncio
import errno
import os
import socket
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Protocol

import anyio
from anyio.abc import SocketStream

from gateway.core.tcp_stream import TcpStream
from gateway.errors import LinkClosed

RECEIVE_BYTES = 65536
CONNECT_TIMEOUT_S = 3.0
# Half-open connections are noticed by the kernel after idle + count * interval s, also where silence means nothing.
KEEP_ALIVE = {"TCP_KEEPIDLE": 5, "TCP_KEEPINTVL": 2, "TCP_KEEPCNT": 3}

_WORDS = {
    errno.ECONNREFUSED: "connection refused: nothing listens on that port",
    errno.EHOSTUNREACH: "no route to the controller",
    errno.ENETUNREACH: "network unreachable",
    errno.ETIMEDOUT: "no answer from the controller's address",
    errno.ECONNRESET: "connection reset by the controller",
    errno.EPIPE: "connection closed by the controller",
}
_NONE: Mapping[str, int] = MappingProxyType({})


class Connection(Protocol):
    """An open way to one controller."""

    @property
    def datagrams(self) -> bool:
        """Whether what is handed on is one whole datagram each time: a frame never goes on in the next."""
        ...

    async def deliver(self, take: Callable[[bytes], None]) -> None:
        """Hand on what comes, as it comes, until cancelled; it never returns.

        Args:
            take: Is called with the bytes. What it raises is raised here, and nothing more is handed on.

        Raises:
            LinkClosed: The connection has ended.
        """
        ...

    async def send(self, data: bytes) -> None:
        """Send bytes.

        Raises:
            LinkClosed: The connection has ended.
        """
        ...

    async def aclose(self) -> None:
        """Close the connection."""
        ...


class Pulled(ABC):
    """The part of a `Connection` that is read piece by piece."""

    @abstractmethod
    async def receive(self) -> bytes:
        """Wait for the next bytes.

        Raises:
            LinkClosed: The connection has ended.
        """

    async def deliver(self, take: Callable[[bytes], None]) -> None:
        """Hand on what comes; see `Connection`."""
        while True:
            take(await self.receive())


class Connector(Protocol):
    """Opens connections to one controller."""

    @property
    def peer(self) -> str:
        """The controller's address, for people."""
        ...

    @property
    def notes(self) -> Sequence[str]:
        """What the operator should know beside the state of the link."""
        ...

    @property
    def rejects(self) -> Mapping[str, int]:
        """How often something was refused since the start, by reason."""
        ...

    async def connect(self) -> Connection:
        """Open a connection.

        Raises:
            LinkClosed: It could not be opened; the reason says why.
        """
        ...

    async def aclose(self) -> None:
        """Release what is held between connections; the next `connect` takes it again."""
        ...


class HoldsNothing:
    """The part of a `Connector` that holds nothing between its connections and refuses nobody."""

    __slots__ = ()

    @property
    def notes(self) -> Sequence[str]:
        """Nothing."""
        return ()

    @property
    def rejects(self) -> Mapping[str, int]:
        """None."""
        return _NONE

    async def aclose(self) -> None:
        """Release nothing."""


@dataclass(frozen=True, slots=True)
class TcpClient(HoldsNothing):
    """The gateway calls the controller over TCP.

    Args:
        host: Address or name of the controller.
        port: Its port.
    """

    host: str
    port: int

    @property
    def peer(self) -> str:
        """The controller's address, for people."""
        return address_text(self.host, self.port)

    async def connect(self) -> Connection:
        """Open a connection; see `Connector`."""
        try:
            with anyio.fail_after(CONNECT_TIMEOUT_S):
                loop = asyncio.get_running_loop()
                transport, stream = await loop.create_connection(lambda: TcpStream(describe), self.host, self.port)
        except TimeoutError:
            raise LinkClosed(f"no answer from {self.peer} within {CONNECT_TIMEOUT_S:g} s") from None
        except OSError as error:
            raise LinkClosed(f"{self.peer}: {describe(error)}", refused=is_refusal(error)) from error
        prepare(transport.get_extra_info("socket").setsockopt)
        return stream


class TcpConnection(Pulled):
    """A TCP connection that the controller has opened."""

    datagrams = False

    def __init__(self, stream: SocketStream) -> None:
        self._stream = stream

    async def receive(self) -> bytes:
        """Wait for bytes; see `Pulled`."""
        try:
            return await self._stream.receive(RECEIVE_BYTES)
        except anyio.EndOfStream:
            raise LinkClosed("the controller closed the connection") from None
        except (anyio.BrokenResourceError, anyio.ClosedResourceError, OSError) as error:
            raise LinkClosed(describe(error)) from error

    async def send(self, data: bytes) -> None:
        """Send bytes; see `Connection`."""
        try:
            await self._stream.send(data)
        except (anyio.BrokenResourceError, anyio.ClosedResourceError, OSError) as error:
            raise LinkClosed(describe(error)) from error

    async def aclose(self) -> None:
        """Close the connection."""
        await self._stream.aclose()


def describe(error: BaseException) -> str:
    """Say in words why a connection failed or ended."""
    cause = _cause(error)
    if cause is None or cause.errno is None:
        return "connection lost"
    if isinstance(cause, socket.gaierror):
        return f"the name cannot be resolved ({cause.strerror})"
    return _WORDS.get(cause.errno) or os.strerror(cause.errno)


def is_refusal(error: BaseException) -> bool:
    """Whether the host answered that nothing listens on the port."""
    cause = _cause(error)
    return cause is not None and cause.errno == errno.ECONNREFUSED


def address_text(host: str, port: int) -> str:
    """An address for people."""
    return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"


def prepare(set_option: Callable[[int, int, int], None]) -> None:
    """Set a TCP connection's options: requests leave at once, and a peer that is gone is noticed."""
    set_option(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    set_option(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    for name, value in KEEP_ALIVE.items():
        if hasattr(socket, name):  # macOS lacks some of them
            set_option(socket.IPPROTO_TCP, getattr(socket, name), value)


def _cause(error: BaseException) -> OSError | None:
    """The socket's own error; anyio wraps it."""
    cause: BaseException | None = error
    while cause is not None:
        if isinstance(cause, OSError) and cause.errno is not None:
            return cause
        cause = cause.__cause__ or cause.__context__
    return None
