"""The floor: what controllers send goes to every client as it came, on the gateway's own kind of loop.

    python -m tests.bench.servers.relay PORT…

The vendor's handshake is done by the gateway's decoder, because without it nothing comes; then nothing is looked at.
It tells its port, and ends with its standard input.
"""

from __future__ import annotations

import asyncio
import os
import sys
from functools import partial
from typing import cast

import uvloop

from vendors.fairino.cnde import CndeDecoder, CndeOptions, Learned
from vendors.fairino.cnde_narrowing import Narrowing

_TICK_S = 0.1


class Guest(asyncio.Protocol):
    """One client."""

    def __init__(self, guests: set[asyncio.Transport]) -> None:
        self._guests = guests

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Give it everything from now on."""
        self._transport = cast("asyncio.Transport", transport)
        self._guests.add(self._transport)

    def connection_lost(self, _: Exception | None) -> None:
        """Forget it."""
        self._guests.discard(self._transport)


class Source(asyncio.Protocol):
    """One controller."""

    def __init__(self, guests: set[asyncio.Transport]) -> None:
        self._guests = guests
        options = CndeOptions()
        self._decoder = CndeDecoder(options, Learned(Narrowing(options.wanted)))
        self._running = False

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Begin the handshake."""
        self._transport = cast("asyncio.Transport", transport)
        self._transport.write(self._decoder.outgoing())
        self._tick()

    def _tick(self) -> None:
        if not self._running:
            self._transport.write(cast("bytes", self._decoder.tick()))
            asyncio.get_running_loop().call_later(_TICK_S, self._tick)

    def data_received(self, data: bytes) -> None:
        """Pass it on; before the first frame it is the handshake's."""
        if self._running:
            for guest in self._guests:
                guest.write(data)
            return
        self._decoder.feed(data)
        self._transport.write(self._decoder.outgoing())
        self._running = self._decoder.ready


async def run(ports: list[int]) -> None:
    """Relay until the standard input ends."""
    loop = asyncio.get_running_loop()
    guests: set[asyncio.Transport] = set()
    server = await loop.create_server(partial(Guest, guests), "127.0.0.1", 0)
    sources = [(await loop.create_connection(partial(Source, guests), "127.0.0.1", port))[1] for port in ports]
    while not all(source._running for source in sources):  # noqa: ASYNC110 - once, before anything is measured
        await asyncio.sleep(_TICK_S)
    print(server.sockets[0].getsockname()[1], flush=True)
    await loop.run_in_executor(None, os.read, 0, 1)
    os._exit(0)


if __name__ == "__main__":
    with asyncio.Runner(loop_factory=uvloop.new_event_loop) as runner:
        runner.run(run([int(port) for port in sys.argv[1:]]))
