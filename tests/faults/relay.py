"""A relay of bytes between the gateway and a controller, which can do wrong with what the controller sends."""

from __future__ import annotations

import contextlib
import random
import socket
import struct
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from enum import StrEnum

import anyio
from anyio.abc import SocketAttribute, SocketStream, TaskGroup, TaskStatus

_DRIP_S = 0.002
_MOST_JUNK = 200
_JUNK_RATE = 0.3


class Mode(StrEnum):
    """What happens to what the controller sends."""

    PASS = "pass"  # noqa: S105 - not that pass
    DRIP = "drip"
    JUNK = "junk"
    HALVES = "halves"
    FROZEN = "frozen"


class Relay:
    """Takes connections and makes one to the controller for each.

    Args:
        host: Of the controller.
        port: Its port.
        seed: For the junk.

    Attributes:
        mode: What happens now.
        port: Where it listens, on 127.0.0.1.
    """

    def __init__(self, host: str, port: int, seed: int = 0) -> None:
        self._target = (host, port)
        self._random = random.Random(seed)  # noqa: S311 - junk, no secret
        self._streams: set[SocketStream] = set()
        self._thawed = anyio.Event()
        self._mode = Mode.PASS
        self.port = 0

    @property
    def mode(self) -> Mode:
        """What happens now."""
        return self._mode

    @mode.setter
    def mode(self, mode: Mode) -> None:
        self._mode = mode
        if mode is not Mode.FROZEN:
            self._thawed.set()
            self._thawed = anyio.Event()

    async def cut(self) -> None:
        """Reset every connection: no FIN, but RST."""
        for stream in list(self._streams):
            raw = stream.extra(SocketAttribute.raw_socket)  # noqa: S610 - not that `extra`
            with contextlib.suppress(OSError):
                raw.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            await anyio.aclose_forcefully(stream)

    async def serve(self, stream: SocketStream) -> None:
        """Serve one connection to its end."""
        async with stream:
            try:
                upstream = await anyio.connect_tcp(*self._target)
            except OSError:
                return
            async with upstream:
                self._streams |= {stream, upstream}
                try:
                    async with anyio.create_task_group() as tasks:
                        tasks.start_soon(self._forward, stream, upstream)
                        await self._forward(upstream, stream, self._do_wrong)
                        tasks.cancel_scope.cancel()
                finally:
                    self._streams -= {stream, upstream}

    async def _forward(
        self,
        one: SocketStream,
        other: SocketStream,
        send: Callable[[SocketStream, bytes], Awaitable[None]] | None = None,
    ) -> None:
        with contextlib.suppress(anyio.BrokenResourceError, anyio.ClosedResourceError, OSError):
            async for data in one:
                while self._mode is Mode.FROZEN:
                    await self._thawed.wait()
                await (other.send(data) if send is None else send(other, data))
        for stream in (one, other):
            await anyio.aclose_forcefully(stream)

    async def _do_wrong(self, stream: SocketStream, data: bytes) -> None:
        match self._mode:
            case Mode.DRIP:
                for at in range(len(data)):
                    await stream.send(data[at : at + 1])
                    if self._mode is Mode.DRIP:
                        await anyio.sleep(_DRIP_S)
            case Mode.JUNK if self._random.random() < _JUNK_RATE:
                await stream.send(self._random.randbytes(self._random.randint(1, _MOST_JUNK)) + data)
            case Mode.HALVES:
                await stream.send(data[: len(data) // 2])
            case _:
                await stream.send(data)


@asynccontextmanager
async def listening(tasks: TaskGroup, serve: Callable[[SocketStream], Awaitable[None]]) -> AsyncIterator[int]:
    """Take connections on a free port of 127.0.0.1 while the context lasts; gives the port."""
    listener = await anyio.create_tcp_listener(local_host="127.0.0.1")
    scope = anyio.CancelScope()

    async def run(*, task_status: TaskStatus[None]) -> None:
        try:
            with scope:
                task_status.started()
                await listener.serve(serve)
        finally:
            with anyio.CancelScope(shield=True):
                await listener.aclose()

    await tasks.start(run)
    try:
        yield int(listener.extra(SocketAttribute.local_port))  # noqa: S610 - not that `extra`
    finally:
        scope.cancel()


@asynccontextmanager
async def relaying(tasks: TaskGroup, host: str, port: int) -> AsyncIterator[Relay]:
    """Relay connections to a controller while the context lasts."""
    relay = Relay(host, port)
    async with listening(tasks, relay.serve) as relay.port:
        yield relay
