"""Reloads under load: who reads the robots that stay gets every sample, in one epoch, over one connection."""

from __future__ import annotations

import itertools
import json
import signal
import socket
import time
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager
from pathlib import Path
from typing import cast

import aiohttp
import anyio
import anyio.abc
import msgspec
import pytest

from gateway.config.printing import toml_value
from gateway.core.registry import Registry
from gateway.sim.server import VirtualController, serve
from gateway.sim.simulator import Simulator
from gateway.testing.cell import free_port
from tests.cli.command import PYTHON, ROOT, command, environment
from tests.end_to_end.load_faults import Rude
from tests.server.kit import talking

STAYING = 3
NATIVE_CLIENTS = 4
RELOADS = 5
SETTLE_S = 0.8


class Read:
    """What one reader got of the robots that stay: sequence numbers and epochs by topic."""

    def __init__(self, door: str) -> None:
        self.door = door
        self.seqs: dict[str, list[int]] = {}
        self.epochs: dict[str, set[str]] = {}
        self.ended = False

    def take(self, sample: dict[str, object]) -> None:
        """Note a sample."""
        topic = str(sample["topic"])
        if not topic.startswith("go"):
            self.seqs.setdefault(topic, []).append(cast("int", sample["seq"]))
            self.epochs.setdefault(topic, set()).add(str(sample["epoch"]))

    def gaps(self) -> list[str]:
        """Where a number is missing, twice there or out of order."""
        return [
            f"{self.door} {topic}: {before} then {after}"
            for topic, seqs in self.seqs.items()
            for before, after in itertools.pairwise(seqs)
            if after != before + 1
        ]


async def read_native(url: str, read: Read) -> None:
    """Read every sample at the native door."""
    async with talking(url) as talk:
        await talk.send({"op": "subscribe", "id": 1, "topics": ["*/joints"], "mode": "all"})
        async for frame in talk.socket:
            message = msgspec.json.decode(frame.data)
            assert message["op"] != "missed" or set(message["samples"]) <= {"gone/joints"}, message
            for sample in message.get("samples", []) if message["op"] == "data" else []:
                read.take(sample)
    read.ended = True


async def read_sse(url: str, read: Read) -> None:
    """Read every sample as server-sent events."""
    address = url.replace("ws://", "http://").replace("/ws", "/api/v1/stream?topics=*/joints&mode=all")
    async with aiohttp.ClientSession() as session, session.get(address) as response:
        async for line in response.content:
            if line.startswith(b"data: ") and b'"topic"' in line:
                read.take(json.loads(line[6:]))
    read.ended = True


async def read_foxglove(url: str, read: Read) -> None:
    """Read at the Foxglove door, which gives the newest: its channels of the robots that stay must stay."""
    address = url.replace("/ws", "/foxglove?topics=*/joints")
    async with (
        aiohttp.ClientSession() as session,
        session.ws_connect(address, protocols=("foxglove.websocket.v1",)) as socket,
    ):
        names: dict[int, str] = {}
        async for frame in socket:
            if frame.type is aiohttp.WSMsgType.BINARY:
                read.take(json.loads(frame.data[13:]))
                continue
            message = json.loads(frame.data)
            if message["op"] == "advertise":
                new = [one for one in message["channels"] if one["id"] not in names]
                names.update({one["id"]: one["topic"] for one in new})
                wanted = [{"id": one["id"], "channelId": one["id"]} for one in new]
                await socket.send_json({"op": "subscribe", "subscriptions": wanted})
            elif message["op"] == "unadvertise":
                assert {names[one] for one in message["channelIds"]} <= {"/gone/joints"}
    read.ended = True


def text(port: int, controllers: list[tuple[str, VirtualController]], **more: object) -> str:
    """A configuration."""
    keys = {"listen": f"127.0.0.1:{port}", **more}
    found = "[server]\n" + "".join(f"{key} = {toml_value(value)}\n" for key, value in keys.items())
    for name, controller in controllers:
        entry: dict[str, object] = {"name": name, "vendor": "fairino", "protocol": "cnde", "host": controller.host}
        entry |= {"port": controller.number_of("cnde"), "cnde": {"period_ms": 8}}
        found += "\n[[robots]]\n" + "".join(f"{key} = {toml_value(value)}\n" for key, value in entry.items())
    return found


@asynccontextmanager
async def gateway(folder: Path, config: str) -> AsyncIterator[tuple[anyio.abc.Process, Path]]:
    """The gateway as a process; its control socket."""
    await anyio.Path(folder).chmod(0o755)
    (folder / "gateway.toml").write_text(config, "utf-8")
    arguments = [*PYTHON, "run", "--config", str(folder / "gateway.toml"), "--log-level", "error"]
    env = environment(RUNTIME_DIRECTORY=str(folder), PYTHONWARNINGS="default")
    async with await anyio.open_process(arguments, env=env, cwd=ROOT, stderr=None, stdout=None) as process:
        try:
            yield process, folder / "control.sock"
        finally:
            if process.returncode is None:
                process.kill()


async def until_online(url: str, count: int) -> None:
    """Wait until all robots are online."""
    with anyio.fail_after(15):
        while True:
            try:
                async with talking(url) as talk:
                    robots = cast("list[dict[str, dict[str, str]]]", (await talk.ask("robots"))["robots"])
                    if sum(robot["link"]["state"] == "ONLINE" for robot in robots) == count:
                        return
            except OSError:
                pass
            await anyio.sleep(0.1)


@pytest.mark.limit(60)
async def test_subscribers_of_the_robots_that_stay_notice_nothing_of_five_reloads(tmp_path: Path) -> None:
    simulator, port = cast("Simulator", Registry().simulator("fairino")), free_port()
    url = f"ws://127.0.0.1:{port}/ws"
    reads = [*(Read(f"native {n}") for n in range(NATIVE_CLIENTS)), Read("sse"), Read("foxglove")]
    async with AsyncExitStack() as stack:
        controllers = await stack.enter_async_context(
            serve(simulator, host="127.0.48.1", port=0, count=STAYING + 1, scenario="steady")
        )
        staying = [(f"r{number}", one) for number, one in enumerate(controllers[:STAYING], start=1)]
        both = [text(port, [*staying, ("gone", controllers[-1])]), text(port, staying, flush_ms=4.0)]
        process, control = await stack.enter_async_context(gateway(tmp_path, both[1]))
        await until_online(url, STAYING)
        tasks = await stack.enter_async_context(anyio.create_task_group())
        for read in reads[:NATIVE_CLIENTS]:
            tasks.start_soon(read_native, url, read)
        tasks.start_soon(read_sse, url, reads[-2])
        tasks.start_soon(read_foxglove, url, reads[-1])
        await anyio.sleep(SETTLE_S)
        for number in range(RELOADS):
            (tmp_path / "gateway.toml").write_text(both[number % 2], "utf-8")
            if number % 2:
                process.send_signal(signal.SIGHUP)
            else:
                done = await command("reload", "--control", str(control), env={"PYTHONWARNINGS": "default"})
                assert done.code == 0, done.err
            await anyio.sleep(SETTLE_S)
        assert not any(read.ended for read in reads)
        tasks.cancel_scope.cancel()
    for read in reads:
        assert len(read.seqs) == STAYING, read.door
        assert all(len(epochs) == 1 for epochs in read.epochs.values()), read.door
        assert min(map(len, read.seqs.values())) > 125 * SETTLE_S * RELOADS * (0.5 if read.door == "foxglove" else 0.9)
    assert [gap for read in reads if read.door != "foxglove" for gap in read.gaps()] == []


async def test_a_broken_configuration_is_refused_with_every_problem_and_78(tmp_path: Path) -> None:
    port = free_port()
    async with gateway(tmp_path, text(port, [])) as (_, control):
        await until_online(f"ws://127.0.0.1:{port}/ws", 0)
        (tmp_path / "gateway.toml").write_text('[server]\nflush_ms = "fast"\n[[robots]]\nname = "R"\n', "utf-8")
        done = await command("reload", "--control", str(control), env={"PYTHONWARNINGS": "default"})
        assert done.code == 78
        assert "gateway.toml:2: server.flush_ms" in done.err
        assert "gateway.toml:4" in done.err
        await until_online(f"ws://127.0.0.1:{port}/ws", 0)


async def test_a_gateway_that_is_not_there_is_said(tmp_path: Path) -> None:
    done = await command("reload", "--control", str(tmp_path / "control.sock"))
    assert done.code == 1
    assert "is the gateway running?" in done.err


@pytest.mark.limit(40)
async def test_sigterm_ends_in_two_seconds_with_clients_that_do_not_read_and_a_silent_robot(tmp_path: Path) -> None:
    simulator, port = cast("Simulator", Registry().simulator("fairino")), free_port()
    url = f"ws://127.0.0.1:{port}/ws"
    async with AsyncExitStack() as stack:
        pushing = await stack.enter_async_context(serve(simulator, host="127.0.49.1", port=0, scenario="steady"))
        silent = stack.enter_context(socket.create_server(("127.0.0.1", 0)))
        more = (
            f'[[robots]]\nname = "silent"\nvendor = "rainbow"\nhost = "127.0.0.1"\nport = {silent.getsockname()[1]}\n'
        )
        process, _ = await stack.enter_async_context(gateway(tmp_path, text(port, [("r1", pushing[0])]) + more))
        await until_online(url, 1)
        rude = Rude("127.0.0.1", port)
        rude.never_reads()
        stack.enter_context(rude._kept[0])
        stream = stack.enter_context(socket.socket())
        stream.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1024)
        stream.connect(("127.0.0.1", port))
        stream.sendall(b"GET /api/v1/stream?topics=*&mode=all HTTP/1.1\r\nHost: localhost\r\n\r\n")
        await anyio.sleep(3)
        begun_s = time.monotonic()
        process.send_signal(signal.SIGTERM)
        assert await process.wait() == 0
        took_s = time.monotonic() - begun_s
        assert took_s < 2
