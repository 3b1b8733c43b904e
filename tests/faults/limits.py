"""The gateway meets a limit of the machine: file descriptors, and the disk that it logs to."""

from __future__ import annotations

import contextlib
import os
import socket
import subprocess
import time
from collections.abc import AsyncIterator, Iterator
from contextlib import AsyncExitStack, asynccontextmanager, contextmanager
from dataclasses import dataclass
from pathlib import Path
from random import Random

import anyio

from tests.end_to_end.load_faults import masked, subscribe
from tests.faults.cell import BACK_S, hosts, steady_robots
from tests.faults.kit import Fault, Series, Stage
from tests.faults.processes import gateway
from tests.faults.report import Seen
from tests.faults.robots import Controllers, Robot, configured
from tests.faults.tunlink import run

_FDS = 96
_CLIENTS = 150
_LOST_S = 10.0
_HOLD_S = 2.0
_TEXT = 0x81
_DISK = "256k"
_PAGE = 4096


@dataclass
class LimitsStage(Stage):
    """A gateway with limits, and controllers that can be started anew.

    Attributes:
        victims: They, by robot.
    """

    victims: dict[str, Controllers]

    async def restarted(self, robot: str) -> float:
        """Kill a controller and start it anew; how long its robot took to come back."""
        async with self.striking(robot):
            await self.victims[robot].kill()
            await self.watch.lost(robot, _LOST_S)
            since_s = time.monotonic()
            await self.victims[robot].start()
            return await self.watch.back(robot, since_s, BACK_S)


@asynccontextmanager
async def limits(folder: Path, prefix: tuple[str, ...] = (), log: Path | None = None) -> AsyncIterator[LimitsStage]:
    """Run the cell with limits."""
    host = hosts(120 if log is None else 121)
    steady = steady_robots(host)
    victims = [Robot(name=name, vendor="rainbow", protocol="reqdata", host=host()) for name in ("v1", "v2")]
    async with AsyncExitStack() as stack:
        tasks = await stack.enter_async_context(anyio.create_task_group())
        near = Controllers(steady, folder)
        controllers = {robot.name: Controllers([robot], folder) for robot in victims}
        for each in (near, *controllers.values()):
            stack.push_async_callback(each.kill)
            await each.start()
        text = configured([*steady, *victims])
        running = await stack.enter_async_context(gateway(text, folder, prefix=prefix, log=log))
        names = frozenset(robot.name for robot in steady)
        stage = LimitsStage(running, tasks, folder, names, controllers)
        await stack.enter_async_context(stage.watched({*names, *controllers}))
        yield stage


@asynccontextmanager
async def few_descriptors(folder: Path) -> AsyncIterator[LimitsStage]:
    """Run the cell with few file descriptors."""
    async with limits(folder, ("prlimit", f"--nofile={_FDS}:{_FDS}")) as stage:
        yield stage


@contextmanager
def crowd(listen: str, number: int, request: bytes = b"") -> Iterator[list[socket.socket]]:
    """Clients that connect, ask, and never read; those that are turned away are let go.

    Args:
        listen: Host and port of the gateway.
        number: How many.
        request: What they send after the handshake.
    """
    host, _, port = listen.rpartition(":")
    hello = (
        f"GET /ws HTTP/1.1\r\nHost: {listen}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
        "Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n\r\n"
    ).encode()
    made: list[socket.socket] = []
    try:
        for _ in range(number):
            client = socket.socket()
            made.append(client)
            client.settimeout(0.2)
            with contextlib.suppress(OSError):
                client.connect((host, int(port)))
                client.sendall(hello + request)
        yield made
    finally:
        for client in made:
            client.close()


async def no_descriptors(stage: LimitsStage, random: Random) -> Seen:
    """More clients come than there are file descriptors; meanwhile a controller is started anew."""
    request = masked(_TEXT, subscribe(["*/joints"]))
    with crowd(stage.gateway.listen, _CLIENTS, request):
        await anyio.sleep(_HOLD_S)
        n_fds = stage.gateway.usage_seen().fds
        recovery_s = await stage.restarted("v1")
    assert n_fds <= _FDS
    return Seen(recovery_s, f"{_CLIENTS} clients at a limit of {_FDS}: {n_fds} used; the robot reconnects all the same")


DESCRIPTORS = Series(
    name="file descriptors",
    open=few_descriptors,
    faults=(
        Fault(
            name="file descriptors used up", strike=no_descriptors, logs=frozenset({"asyncio", "descriptors.exhausted"})
        ),
    ),
    stay_s=60.0,
)


def why_no_disk() -> str | None:
    """Why there can be no full disk here; None: there can."""
    if os.getuid() != 0:
        return "a small disk of its own needs root"
    try:
        run("unshare", "--mount", "mount", "-t", "tmpfs", "-o", "size=64k", "tmpfs", "/mnt")
    except (OSError, subprocess.CalledProcessError) as error:
        return f"no tmpfs: {error}"
    return None


@contextmanager
def small_disk(path: Path) -> Iterator[Path]:
    """A disk of a few pages for as long as the context lasts."""
    path.mkdir(exist_ok=True)
    run("mount", "-t", "tmpfs", "-o", f"size={_DISK}", "tmpfs", str(path))
    try:
        yield path
    finally:
        run("umount", "--lazy", str(path))


@asynccontextmanager
async def on_small_disk(folder: Path) -> AsyncIterator[LimitsStage]:
    """Run the cell with its log on a small disk."""
    with small_disk(folder / "disk") as disk:
        async with limits(folder, log=disk / "gateway.log") as stage:
            yield stage


async def disk_full(stage: LimitsStage, random: Random) -> Seen:
    """The disk of the log is full while there is much to log; then there is room again."""
    log = stage.gateway.log
    filler = log.with_name("filler")
    with log.open("ab") as file:  # the rest of its last page: it has been given to the file
        file.write(b"\n" * (_PAGE - stage.gateway.n_said % _PAGE))
    with filler.open("wb", buffering=0) as file, contextlib.suppress(OSError):
        while True:
            file.write(bytes(_PAGE))
    try:
        before = stage.gateway.n_said
        recovery_s = await stage.restarted("v1")
        assert stage.gateway.n_said == before, "the disk is not full"
    finally:
        filler.unlink()
    await stage.restarted("v2")  # what happens to one robot again and again would be counted, not logged
    assert stage.gateway.n_said > before, "nothing is logged although there is room again"
    return Seen(recovery_s, "goes on without a log, and logs again when there is room")


DISK = Series(
    name="disk",
    open=on_small_disk,
    faults=(Fault(name="disk full", strike=disk_full),),
    stay_s=0.0,
)
