"""What exporting costs on the cell's machine: `python -m tests.export.cost [seconds]`.

A gateway with 16 virtual robots, without and with `[export.nats]` (samples at 10 Hz, states, events), each in a process
of its own; printed is what the process computes, as a share of one core.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import anyio

from gateway.client import connect
from tests.export.kit import free_port, nats_server
from tests.export.many import cpu_s, rss_mb

ROBOTS = 16
SETTLE_S = 3.0
EXPORT = """
[export.nats]
servers = ["{url}"]
plant = "plant1"
cell = "cell1"
samples_hz = 10
outbox = "{folder}/outbox"
"""


@contextmanager
def process(*arguments: str) -> Iterator[subprocess.Popen[bytes]]:
    """A command of the gateway for as long as the context lasts."""
    with subprocess.Popen(  # noqa: S603 - our own program
        [sys.executable, "-m", "gateway", *arguments], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    ) as one:
        try:
            yield one
        finally:
            one.terminate()


def config(folder: Path, port: int, robot_port: int, export: str) -> Path:
    """The configuration of a gateway with all robots."""
    text = f'[server]\nlisten = "127.0.0.1:{port}"\ncontrol = "{folder}/{port}.sock"\n{export}'
    for number in range(1, ROBOTS + 1):
        text += f'\n[[robots]]\nname = "r{number}"\nvendor = "rainbow"\n'
        text += f'host = "127.0.0.{number + 1}"\nport = {robot_port}\n'
    file = folder / f"{port}.toml"
    file.write_text(text)
    return file


def share(folder: Path, robot_port: int, export: str, seconds: float) -> tuple[float, float, str]:
    """What a gateway computes, as a share of a core; its memory, MB; and what it says of its exporter."""
    port = free_port()
    with process("run", "--config", str(config(folder, port, robot_port, export))) as one:
        time.sleep(SETTLE_S)
        begun = (time.monotonic(), cpu_s(one.pid))
        time.sleep(seconds)
        used = (cpu_s(one.pid) - begun[1]) / (time.monotonic() - begun[0])
        return used, rss_mb(one.pid), anyio.run(_told, port)


async def _told(port: int) -> str:
    async with connect(f"ws://127.0.0.1:{port}/ws") as client:
        online = sum(robot.link.state == "ONLINE" for robot in await client.robots())
        return f"{online} online, " + ", ".join(f"{one.sent}" for one in await client.exports())


def main(seconds: float = 15.0) -> None:
    """Measure in turns: without, with, and both once more."""
    with tempfile.TemporaryDirectory() as name, nats_server(Path(name) / "hub") as server:
        folder, robot_port = Path(name), free_port()
        export = EXPORT.format(url=server.url, folder=name)
        with process("simulate", "rainbow", "--count", str(ROBOTS), "--host", "127.0.0.2", "--port", str(robot_port)):
            time.sleep(1.0)
            for what, text in (("without", ""), ("with", export), ("without", ""), ("with", export)):
                used, memory, told = share(folder, robot_port, text, seconds)
                print(f"{what:8} {used:6.3f} of a core  {memory:5.0f} MB  {told}", flush=True)


if __name__ == "__main__":
    os.environ.setdefault("PYTHONUNBUFFERED", "1")
    main(*(float(one) for one in sys.argv[1:2]))
