"""A real nats-server for the tests, which can be killed and started again, and a bus whose events a test makes."""

from __future__ import annotations

import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import AsyncIterator, Iterator, Sequence
from contextlib import asynccontextmanager, contextmanager
from pathlib import Path

import anyio
import msgspec
import nats
from nats.aio.client import Client

from gateway.api.model import EventKind
from gateway.config.exports import NatsAccess, NatsSettings, NatsTable
from gateway.core.backoff import no_waiting
from gateway.core.clock import SystemClock
from gateway.export import Source
from gateway.export.nats import NatsExporter
from gateway.server.cell import Cell
from tests.server.kit import cell

BINARY = shutil.which("nats-server", path=os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]]))
_START_S = 10.0
ROUND_S = 0.02


class Server:
    """One nats-server, on a port that stays the same.

    Args:
        folder: Where it keeps everything.
        config: Further lines of its configuration.
        port: Its port; 0: a free one.
    """

    def __init__(self, folder: Path, config: str = "", port: int = 0) -> None:
        self.port = port or free_port()
        self.url = f"nats://127.0.0.1:{self.port}"
        self.folder = folder
        self.configure(config)
        self._process: subprocess.Popen[bytes] | None = None

    def configure(self, config: str, *, jetstream: bool = True) -> None:
        """Write its configuration; it counts from the next start."""
        self.folder.mkdir(parents=True, exist_ok=True)
        own = f'listen: "127.0.0.1:{self.port}"\n'
        if jetstream and "jetstream" not in config:
            own += f'jetstream {{ store_dir: "{self.folder / "js"}" }}\n'
        self.write(own + config)

    def write(self, config: str) -> None:
        """Write its whole configuration."""
        self._file.write_text(config)

    @property
    def _file(self) -> Path:
        return self.folder / "nats.conf"

    def start(self) -> None:
        """Start it, and wait until it listens."""
        assert BINARY is not None
        with (self.folder / "log").open("ab") as log:
            command = [BINARY, "-c", str(self._file)]
            self._process = subprocess.Popen(command, stdout=log, stderr=log)  # noqa: S603 - the server
        until = time.monotonic() + _START_S
        while time.monotonic() < until:
            try:
                socket.create_connection(("127.0.0.1", self.port), 0.2).close()
            except OSError:
                assert self._process.poll() is None, self.log()
                time.sleep(0.01)
            else:
                return
        raise AssertionError(self.log())

    @property
    def pid(self) -> int:
        """Of its process."""
        assert self._process is not None
        return self._process.pid

    def kill(self) -> None:
        """End it at once, as a power cut would."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            self._process = None

    def reload(self) -> None:
        """Let it read its configuration again."""
        assert self._process is not None
        self._process.send_signal(signal.SIGHUP)

    def pause(self) -> None:
        """Let it answer nothing more, with every connection open."""
        assert self._process is not None
        self._process.send_signal(signal.SIGSTOP)

    def resume(self) -> None:
        """Let it go on."""
        assert self._process is not None
        self._process.send_signal(signal.SIGCONT)

    def log(self) -> str:
        """What it has logged."""
        return (self.folder / "log").read_text(errors="replace")


@contextmanager
def nats_server(folder: Path, config: str = "", *, start: bool = True, port: int = 0) -> Iterator[Server]:
    """A server for as long as the context lasts."""
    server = Server(folder, config, port)
    if start:
        server.start()
    try:
        yield server
    finally:
        if server._process is not None:
            server._process.send_signal(signal.SIGCONT)
        server.kill()


def free_port() -> int:
    """A port that nothing listens on."""
    with socket.create_server(("127.0.0.1", 0)) as found:
        return int(found.getsockname()[1])


@asynccontextmanager
async def talking(url: str, **options: str) -> AsyncIterator[Client]:
    """A plain client."""
    client = await nats.connect(url, **options)
    try:
        yield client
    finally:
        await client.close()


def settings(server: str, folder: Path, **keys: object) -> NatsSettings:
    """`[export.nats]` for a server."""
    words = {"servers": [server], "plant": "plant1", "cell": "cell1", "samples_hz": 20.0, "heartbeat_s": 0.1, **keys}
    secret = words.pop("login", None)
    table = msgspec.convert(words, NatsTable)
    access = NatsAccess(servers=tuple(table.servers), secret=None if secret is None else str(secret))
    return NatsSettings(table=table, access=access, outbox=folder / "outbox")


class Plant:
    """One cell of a plant: a bus whose robots say what a test lets them say, and its exporter.

    Args:
        settings: `[export.nats]`.
        names: Of the robots.
    """

    def __init__(self, settings: NatsSettings, *names: str, ring: int = 10_000) -> None:
        self.bus, self.robots = cell(*names, ring=ring)
        self.bus.events.boot = settings.table.cell + "boot"
        self.doors = Cell(self.robots, self.bus)
        self.exporter = exporter(settings, self.doors)

    def happen(self, robot: str, count: int = 1, value: object = "MOVING") -> None:
        """Let something happen to a robot, so many times."""
        for _ in range(count):
            self.bus.raise_event(
                self.bus.topics[f"{robot}/events"], now_us(), EventKind.MOTION_STARTED, "STANDSTILL", value, {}
            )


def exporter(settings: NatsSettings, doors: Cell) -> NatsExporter:
    """An exporter that does not wait between attempts for longer than a moment."""
    return NatsExporter(settings, Source(bus=doors.bus, infos=doors.infos, clock=SystemClock()), quick)


def quick() -> Iterator[float]:
    """Delays of a moment."""
    for _ in no_waiting():
        yield 0.05


@asynccontextmanager
async def exporting(*exporters: NatsExporter) -> AsyncIterator[None]:
    """Run exporters for as long as the context lasts."""
    async with anyio.create_task_group() as tasks:
        for one in exporters:
            tasks.start_soon(one.run)
        try:
            yield
        finally:
            tasks.cancel_scope.cancel()


async def until(is_so: object, within_s: float = 10.0) -> None:
    """Wait until something is so: a function without arguments."""
    assert callable(is_so)
    with anyio.move_on_after(within_s) as scope:
        while not is_so():  # noqa: ASYNC110 - what is looked at has no event
            await anyio.sleep(ROUND_S)
    if scope.cancelled_caught:
        raise AssertionError("it has not come to it")


async def stored(client: Client, stream: str = "plant1-events") -> list[tuple[str, str]]:
    """Everything in a stream: the subject and the message id, in order."""
    jetstream = client.jetstream()
    info = await jetstream.stream_info(stream)
    found = []
    for seq in range(info.state.first_seq, info.state.last_seq + 1):
        message = await jetstream.get_msg(stream, seq)
        found.append((str(message.subject), (message.headers or {}).get("Nats-Msg-Id", "")))
    return found


def by_robot(found: Sequence[tuple[str, str]]) -> dict[str, list[int]]:
    """The numbers of the events of each robot, in the order of the stream."""
    told: dict[str, list[int]] = {}
    for subject, name in found:
        told.setdefault(subject.split(".")[2], []).append(int(re.sub(r".*:", "", name)))
    return told


def now_us() -> int:
    """Now, µs since 1970 UTC."""
    return time.time_ns() // 1000
