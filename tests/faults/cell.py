"""Faults of controllers, their connections and the gateway's clients, in a cell of every protocol."""

from __future__ import annotations

import contextlib
import itertools
import os
import signal
import socket
import struct
import time
from collections.abc import AsyncIterator, Callable
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import dataclass
from pathlib import Path
from random import Random

import aiohttp
import anyio

from tests.faults.kit import Fault, Series, Stage
from tests.faults.processes import GATEWAY, ended, gateway, spawned
from tests.faults.relay import Mode, Relay, relaying
from tests.faults.report import Seen
from tests.faults.robots import PATIENT_S, Controllers, Robot, configured, serving
from tests.faults.watch import Watch

PROTOCOLS = (
    ("rainbow", "reqdata"),
    ("fairino", "cnde"),
    ("fairino", "legacy"),
    ("fairino", "status"),
    ("xcore", "external"),
    ("xcore", "objects"),
)
_STRUCK = PROTOCOLS[:3]
# The longest delay between two attempts is 6 s, and the first good frame takes a moment.
BACK_S = 8.0
_LOST_S = 10.0
# Until a connection to nobody is noticed: keep-alive after 5 s, three times, 2 s apart.
_ADDRESS_IN_USE = 1


def hosts(block: int) -> Callable[[], str]:
    """Addresses of this machine that no other run uses.

    Args:
        block: 0 to 255; stages that run at the same time have different ones.
    """
    numbers = itertools.count(1)
    return lambda: f"127.{20 + os.getpid() % 200}.{block}.{next(numbers)}"


def steady_robots(host: Callable[[], str]) -> list[Robot]:
    """One robot of each protocol that nothing happens to."""
    return [
        Robot(name=f"h{number}", vendor=vendor, protocol=protocol, host=host(), keys={"stale_s": PATIENT_S})
        for number, (vendor, protocol) in enumerate(PROTOCOLS, start=1)
    ]


@dataclass
class CellStage(Stage):
    """Steady robots, robots whose controllers are processes of their own, and robots behind relays.

    Attributes:
        victims: By robot, its controller.
        relays: By robot, what stands between.
    """

    victims: dict[str, Controllers]
    relays: dict[str, Relay]


@asynccontextmanager
async def cell(folder: Path) -> AsyncIterator[CellStage]:
    """Run the cell."""
    host = hosts(0)
    steady = steady_robots(host)
    victims = [
        Robot(name=f"v{number}", vendor=vendor, protocol=protocol, host=host())
        for number, (vendor, protocol) in enumerate(_STRUCK, start=1)
    ]
    behind = [
        Robot(name=f"w{number}", vendor=vendor, protocol=protocol, host=host())
        for number, (vendor, protocol) in enumerate(_STRUCK, start=1)
    ]
    async with AsyncExitStack() as stack:
        tasks = await stack.enter_async_context(anyio.create_task_group())
        controllers = {robot.name: Controllers([robot], folder) for robot in victims}
        shared = Controllers([*steady, *behind], folder)
        for one in (shared, *controllers.values()):
            stack.push_async_callback(one.kill)
        async with anyio.create_task_group() as starting:
            for one in (shared, *controllers.values()):
                starting.start_soon(one.start)
        relays, seen = {}, []
        for robot in behind:
            relay = await stack.enter_async_context(relaying(tasks, robot.host, robot.port))
            relays[robot.name] = relay
            seen.append(_at(robot, relay.port))
        text = configured([*steady, *victims, *seen])
        running = await stack.enter_async_context(gateway(text, folder))
        names = frozenset(robot.name for robot in steady)
        stage = CellStage(running, tasks, folder, names, controllers, relays)
        everyone = {robot.name for robot in (*steady, *victims, *seen)}
        await stack.enter_async_context(stage.watched(everyone))
        yield stage


def _at(robot: Robot, port: int) -> Robot:
    return Robot(
        name=robot.name, vendor=robot.vendor, protocol=robot.protocol, host=robot.host, seen_at=("127.0.0.1", port)
    )


async def _killed(stage: CellStage, random: Random, away_s: float) -> Seen:
    name = random.choice(sorted(stage.victims))
    controller = stage.victims[name]
    async with stage.striking(name):
        await controller.kill()
        await stage.watch.lost(name, _LOST_S)
        await anyio.sleep(away_s)
        since_s = time.monotonic()
        await controller.start()
        recovery_s = await stage.watch.back(name, since_s, BACK_S)
    return Seen(recovery_s, "lost, said so, reconnected; the start of the controller is included")


async def killed(stage: CellStage, random: Random) -> Seen:
    """The controller's process is killed and started at once."""
    return await _killed(stage, random, 0.0)


async def rebooted(stage: CellStage, random: Random) -> Seen:
    """The controller is away for a while."""
    return await _killed(stage, random, random.uniform(2.0, 4.0))


async def hung(stage: CellStage, random: Random) -> Seen:
    """The controller's process is stopped: its connections stay open and say nothing."""
    name = random.choice(sorted(stage.victims))
    controller = stage.victims[name]
    async with stage.striking(name):
        controller.send(signal.SIGSTOP)
        try:
            await stage.watch.lost(name, _LOST_S)
        finally:
            controller.send(signal.SIGCONT)
        recovery_s = await stage.watch.back(name, time.monotonic(), BACK_S)
    return Seen(recovery_s, "stale, then on again")


async def _wrong(stage: CellStage, random: Random, mode: Mode, seconds: float, note: str) -> Seen:
    name = random.choice(sorted(stage.relays))
    relay = stage.relays[name]
    async with stage.striking(name):
        relay.mode = mode
        try:
            await anyio.sleep(seconds)
        finally:
            relay.mode = Mode.PASS
        recovery_s = await stage.watch.back(name, time.monotonic(), BACK_S)
    return Seen(recovery_s, note)


async def dripped(stage: CellStage, random: Random) -> Seen:
    """Bytes come one by one."""
    return await _wrong(stage, random, Mode.DRIP, 1.5, "frames as whole as ever, or stale where they come too late")


async def junked(stage: CellStage, random: Random) -> Seen:
    """Random bytes stand between the frames."""
    return await _wrong(stage, random, Mode.JUNK, 1.5, "rejects counted, the next whole frame is found")


async def halved(stage: CellStage, random: Random) -> Seen:
    """The second half of everything is missing."""
    return await _wrong(stage, random, Mode.HALVES, 1.5, "rejects counted, stale, on again")


async def stalled(stage: CellStage, random: Random) -> Seen:
    """Nothing gets through, and the connection stays open."""
    return await _wrong(stage, random, Mode.FROZEN, 2.5, "stale, then on again")


async def reset(stage: CellStage, random: Random) -> Seen:
    """The connection is reset, five times in a row."""
    name = random.choice(sorted(stage.relays))
    async with stage.striking(name):
        for _ in range(5):
            epochs = stage.watch.epochs(name)
            await stage.relays[name].cut()
            recovery_s = await stage.watch.renewed(name, epochs, BACK_S)
    return Seen(recovery_s, "reconnected each time")


async def flooded(stage: CellStage, random: Random) -> Seen:
    """A hundred client connections in 6 s, which is 1,000 a minute: every door, with and without a farewell."""
    n_refused = 0
    async with aiohttp.ClientSession(timeout=aiohttp.ClientTimeout(total=5)) as session:
        for number in range(100):
            kind = _KNOCKS[number % len(_KNOCKS)]
            try:
                await kind(stage, session)
            except (aiohttp.ClientError, OSError, TimeoutError):
                n_refused += 1
            await anyio.sleep(0.06 * random.uniform(0.5, 1.0))
    assert n_refused == 0, f"{n_refused} of 100 connections were refused"
    return Seen(note="all served, everything given back")


async def _native(stage: CellStage, session: aiohttp.ClientSession) -> None:
    async with session.ws_connect(stage.gateway.url) as client:
        await client.send_str('{"op": "subscribe", "id": 1, "topics": ["*"], "mode": "all"}')
        for _ in range(3):
            await client.receive(timeout=5)


async def _foxglove(stage: CellStage, session: aiohttp.ClientSession) -> None:
    url = stage.gateway.http("/foxglove")
    async with session.ws_connect(url, protocols=("foxglove.websocket.v1",)) as client:
        await client.receive(timeout=5)


async def _events(stage: CellStage, session: aiohttp.ClientSession) -> None:
    async with session.get(stage.gateway.http("/api/v1/stream?topics=*/joints&rate_hz=10")) as answer:
        await answer.content.readuntil(b"data: ")


async def _rest(stage: CellStage, session: aiohttp.ClientSession) -> None:
    for path in ("/api/v1/robots", "/healthz", "/", "/metrics"):
        async with session.get(stage.gateway.http(path)) as answer:
            assert answer.status == 200, f"{path}: {answer.status}"
            await answer.read()


async def _dropped(stage: CellStage, session: aiohttp.ClientSession) -> None:
    host, _, port = stage.gateway.listen.rpartition(":")
    with socket.create_connection((host, int(port))) as client:
        client.sendall(f"GET /ws HTTP/1.1\r\nHost: {stage.gateway.listen}\r\nUpgr".encode())
        client.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))


async def _closed(stage: CellStage, session: aiohttp.ClientSession) -> None:
    client = await session.ws_connect(stage.gateway.url)
    await client.send_str('{"op": "subscribe", "id": 1, "topics": ["*"], "mode": "all"}')
    with contextlib.suppress(AttributeError):
        client._response.connection.transport.abort()  # type: ignore[union-attr]
    await client.close()


_KNOCKS = (_native, _foxglove, _events, _rest, _dropped, _closed)


async def address_taken(stage: CellStage, random: Random) -> Seen:
    """A second gateway is started on the address of the first."""
    folder = stage.folder / "second"
    folder.mkdir(exist_ok=True)
    config, log = folder / "gateway.toml", folder / "gateway.log"
    log.unlink(missing_ok=True)
    config.write_text(configured([], listen=stage.gateway.listen), "utf-8")
    with spawned([*GATEWAY, "run", "--config", str(config)], log) as process:
        code = await ended(process, 20)
    said = log.read_text("utf-8").strip().splitlines()
    assert code == _ADDRESS_IN_USE, f"exit code {code}: {said}"
    assert "the port is in use" in said[-1], said
    assert not any("Traceback" in line for line in said), said
    return Seen(note=f"exit code {code}: {said[-1]}")


CELL = Series(
    name="cell",
    open=cell,
    faults=(
        Fault(name="controller killed", strike=killed),
        Fault(name="controller rebooted", strike=rebooted),
        Fault(name="controller hung", strike=hung),
        Fault(name="slow drip", strike=dripped),
        Fault(name="junk between the frames", strike=junked),
        Fault(name="half frames", strike=halved),
        Fault(name="stall", strike=stalled),
        Fault(name="connection reset", strike=reset),
        Fault(name="1,000 connections a minute", strike=flooded),
        Fault(name="listen address taken", strike=address_taken),
    ),
)


@asynccontextmanager
async def taken(folder: Path) -> AsyncIterator[tuple[Stage, socket.socket]]:
    """Run a gateway with a robot that calls, whose port something else listens on."""
    host = hosts(100)
    steady = steady_robots(host)
    with socket.create_server(("127.0.0.1", 0)) as taker:
        calling = Robot(name="c1", vendor="xcore", protocol="external", host=host(), calls=taker.getsockname()[1])
        async with (
            anyio.create_task_group() as tasks,
            serving([*steady, calling], folder),
            gateway(configured([*steady, calling]), folder) as running,
        ):
            stage = Stage(running, tasks, folder, frozenset(robot.name for robot in steady))
            async with stage.watched():
                yield stage, taker


async def port_given_back(stage: Stage, taker: socket.socket) -> Seen:
    """The port that a robot is to call is taken, and is given back."""
    async with stage.striking("c1"):
        status, text = await stage.gateway.fetched("/api/v1/robots/c1")
        assert status == 200
        assert "the port is in use" in text, text
        assert stage.watch.is_silent("c1")
        taker.close()
        recovery_s = await stage.watch.back("c1", time.monotonic(), BACK_S)
    return Seen(recovery_s, "that link only: the reason names the port")


__all__ = ["BACK_S", "CELL", "PROTOCOLS", "CellStage", "Watch", "cell", "hosts", "steady_robots", "taken"]
