"""Transports: how bytes reach a controller. A `Connector` opens `Connection`s; each kind of transport is one class."""

from __future__ import annotations

import errno
import os
import socket
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import anyio
from anyio.abc import SocketAttribute, SocketStream

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


class Connection(Protocol):
    """An open way to one controller."""

    @property
    def datagrams(self) -> bool:
        """Whether each receive gives one whole datagram: a frame never goes on in the next."""
        ...

    async def receive(self) -> bytes:
        """Wait for bytes.

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


class Connector(Protocol):
    """Opens connections to one controller."""

    @property
    def peer(self) -> str:
        """The controller's address, for people."""
        ...

    async def connect(self) -> Connection:
        """Open a connection.

        Raises:
            LinkClosed: It could not be opened; the reason says why.
        """
        ...


@dataclass(frozen=True, slots=True)
class TcpClient:
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
                stream = await anyio.connect_tcp(self.host, self.port)
        except TimeoutError:
            raise LinkClosed(f"no answer from {self.peer} within {CONNECT_TIMEOUT_S:g} s") from None
        except OSError as error:
            raise LinkClosed(f"{self.peer}: {describe(error)}", refused=is_refusal(error)) from error
        raw = stream.extra(SocketAttribute.raw_socket)  # noqa: S610 - not that `extra`
        raw.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        _keep_alive(raw.setsockopt)
        return TcpConnection(stream)


class TcpConnection:
    """One open TCP connection, whoever called."""

    datagrams = False

    def __init__(self, stream: SocketStream) -> None:
        self._stream = stream

    async def receive(self) -> bytes:
        """Wait for bytes; see `Connection`."""
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


def _cause(error: BaseException) -> OSError | None:
    """The socket's own error; anyio wraps it."""
    cause: BaseException | None = error
    while cause is not None:
        if isinstance(cause, OSError) and cause.errno is not None:
            return cause
        cause = cause.__cause__ or cause.__context__
    return None


def _keep_alive(set_option: Callable[[int, int, int], None]) -> None:
    set_option(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    for name, value in KEEP_ALIVE.items():
        if hasattr(socket, name):  # macOS lacks some of them
            set_option(socket.IPPROTO_TCP, getattr(socket, name), value)
