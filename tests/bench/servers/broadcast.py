"""`websockets.broadcast` on uvloop, carrying the same bytes to every client.

    python -m tests.bench.servers.broadcast COUNT RATE_HZ aligned|spread ENCODING FILE

It reads no robot and encodes nothing: FILE has the payload. It tells its port, and ends with its standard input.
"""

from __future__ import annotations

import asyncio
import os
import sys
import time
from pathlib import Path
from typing import cast

import uvloop
from websockets.asyncio.server import Server, ServerConnection, broadcast, serve

from tests.bench.schedule import Phases, groups


async def _listen(connection: ServerConnection) -> None:
    await connection.wait_closed()


async def _publish(server: Server, turns: list[range], rate_hz: float, payload: bytes) -> None:
    step_s, due_s, text = 1 / rate_hz / len(turns), time.monotonic(), payload.startswith(b"{")
    while True:
        for group in turns:
            now_s = time.monotonic()
            due_s = max(due_s + step_s, now_s - 0.1)
            for _ in group:
                broadcast(server.connections, payload, text=text)
            await asyncio.sleep(max(0.0, due_s - time.monotonic()))


async def run(count: int, rate_hz: float, phases: Phases, payload: bytes) -> None:
    """Publish until the standard input ends."""
    async with serve(_listen, "127.0.0.1", 0, compression=None, ping_interval=None) as server:
        print(next(iter(server.sockets)).getsockname()[1], flush=True)
        loop = asyncio.get_running_loop()
        ended = loop.run_in_executor(None, os.read, 0, 1)
        ended.add_done_callback(lambda _: os._exit(0))
        await _publish(server, groups(count, rate_hz, phases), rate_hz, payload)


if __name__ == "__main__":
    _, robots, rate, phasing, _kind, file = sys.argv
    with asyncio.Runner(loop_factory=uvloop.new_event_loop) as runner:
        runner.run(run(int(robots), float(rate), cast("Phases", phasing), Path(file).read_bytes()))
