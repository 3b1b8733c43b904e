"""What the service manager is told: by a notifier alone, and by the gateway as a process."""

from __future__ import annotations

import itertools
import os
import signal
import socket
import sys
import time
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager, contextmanager
from pathlib import Path

import anyio
import anyio.abc
import pytest

from gateway.api.messages import RobotInfo
from gateway.api.model import Link, LinkState
from gateway.notify import Notifier, status_line
from tests.cli.command import ROOT, environment

WATCHDOG_S = 0.8


@contextmanager
def receiver(address: str) -> Iterator[socket.socket]:
    """The service manager's socket."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as found:
        found.setblocking(False)  # noqa: FBT003 - its signature
        found.bind("\0" + address[1:] if address.startswith("@") else address)
        yield found


def received(found: socket.socket) -> list[str]:
    """Every datagram that has come."""
    messages = []
    while True:
        try:
            messages.append(found.recv(4096).decode())
        except BlockingIOError:
            return messages


def robot(name: str, state: LinkState, error: str | None = None) -> RobotInfo:
    """A robot whose link is in some state."""
    link = Link(state=state, since=0, protocol="polled", peer="", last_error=error)
    return RobotInfo(name=name, vendor="toy", protocol="polled", groups=[], link=link)


@pytest.mark.parametrize("abstract", [False, True])
def test_a_notifier_sends_one_datagram_a_message(tmp_path: Path, *, abstract: bool) -> None:
    address = f"@robot-gateway-{os.getpid()}" if abstract else str(tmp_path / "notify")
    with receiver(address) as found:
        notifier = Notifier.of_environment({"NOTIFY_SOCKET": address})
        before_us = time.clock_gettime_ns(time.CLOCK_MONOTONIC) // 1000
        notifier.ready()
        notifier.reloading()
        notifier.status("7 of 8\nrobots on")
        notifier.status("7 of 8 robots on")
        notifier.stopping()
        ready, reloading, status, stopping = received(found)
    assert (ready, status, stopping) == ("READY=1", "STATUS=7 of 8 robots on", "STOPPING=1")
    kind, _, stamp = reloading.partition("\nMONOTONIC_USEC=")
    assert kind == "RELOADING=1"
    assert int(stamp) >= before_us


def test_a_reason_that_is_no_text_is_told_all_the_same(tmp_path: Path) -> None:
    address = str(tmp_path / "notify")
    with receiver(address) as found:
        Notifier(address).status("off: r1 (what a plugin said: \udcff)")
        assert received(found) == ["STATUS=off: r1 (what a plugin said: ?)"]


@pytest.mark.parametrize("env", [{}, {"NOTIFY_SOCKET": ""}, {"NOTIFY_SOCKET": "vsock:2:1234"}])
def test_without_a_socket_nothing_is_sent_and_nothing_fails(env: dict[str, str]) -> None:
    notifier = Notifier.of_environment({**env, "WATCHDOG_USEC": "1000000"})
    notifier.ready()
    assert notifier.watchdog_s is None


def test_a_receiver_that_is_not_there_stops_nothing_and_gets_it_when_it_is(tmp_path: Path) -> None:
    address = str(tmp_path / "notify")
    notifier = Notifier(address)
    notifier.ready()
    with receiver(address) as found:
        notifier.stopping()
        assert received(found) == ["READY=1", "STOPPING=1"]


@pytest.mark.parametrize(
    ("env", "watchdog_s"),
    [
        ({"WATCHDOG_USEC": "30000000"}, 30.0),
        ({"WATCHDOG_USEC": "30000000", "WATCHDOG_PID": "7"}, 30.0),
        ({"WATCHDOG_USEC": "30000000", "WATCHDOG_PID": "8"}, None),
        ({"WATCHDOG_USEC": "soon"}, None),
        ({}, None),
    ],
)
def test_the_watchdog_is_fed_where_it_is_ours(env: dict[str, str], watchdog_s: float | None) -> None:
    assert Notifier.of_environment({"NOTIFY_SOCKET": "/x", **env}, pid=7).watchdog_s == watchdog_s


def test_the_status_says_what_is_on_and_what_is_off_and_why() -> None:
    on, off = robot("r1", LinkState.ONLINE), robot("r2", LinkState.DISCONNECTED, "no route to host")
    assert status_line([]) == "no robot is configured"
    assert status_line([on]) == "1 of 1 robot on"
    assert status_line([on, off]) == "1 of 2 robots on; off: r2 (no route to host)"
    assert status_line([off] * 9).endswith("and 3 more")
    assert len(status_line([robot("r2", LinkState.FAULTED, "x" * 500)])) < 120


class Manager:
    """A gateway as a process, and what it tells its service manager."""

    def __init__(self, found: socket.socket, process: anyio.abc.Process) -> None:
        self._found = found
        self.process = process
        self.heard: list[tuple[float, str]] = []

    async def until(self, text: str) -> None:
        """Wait until a message begins with a text that has not been asked for."""
        begun = len(self.heard)
        with anyio.fail_after(10):
            while not any(message.startswith(text) for _, message in self.heard[begun:]):
                await anyio.wait_readable(self._found)
                self.heard += [(time.monotonic(), message) for message in received(self._found)]

    async def during(self, seconds: float) -> list[tuple[float, str]]:
        """What it says for so long."""
        begun = len(self.heard)
        with anyio.move_on_after(seconds):
            await self.until("never")
        return self.heard[begun:]


@asynccontextmanager
async def managed(folder: Path, config: str) -> AsyncIterator[Manager]:
    """Run the gateway as a service manager does."""
    (folder / "gateway.toml").write_text(config, "utf-8")
    address = str(folder / "notify")
    env = environment(NOTIFY_SOCKET=address, WATCHDOG_USEC=str(int(WATCHDOG_S * 1e6)))
    arguments = [sys.executable, "-m", "gateway", "run", "--config", str(folder / "gateway.toml")]
    with receiver(address) as found:
        async with await anyio.open_process(arguments, env={**env, "PYTHONWARNINGS": "default"}, cwd=ROOT) as process:
            try:
                yield Manager(found, process)
            finally:
                if process.returncode is None:
                    process.kill()


NOBODY = '[server]\nlisten = "127.0.0.1:0"\n[[robots]]\nname = "r1"\nvendor = "rainbow"\nhost = "127.0.0.1"\nport = 1\n'


@pytest.mark.limit(40)
async def test_the_gateway_is_ready_alive_reloading_and_stopping(tmp_path: Path) -> None:
    async with managed(tmp_path, NOBODY) as manager:
        await manager.until("READY=1")
        await manager.until("STATUS=0 of 1 robot on; off: r1 (")
        beats = [at_s for at_s, message in await manager.during(4.5) if message == "WATCHDOG=1"]
        periods = [after - before for before, after in itertools.pairwise(beats)]
        assert len(periods) >= 5
        assert 0.8 < sorted(periods)[len(periods) // 2] / (WATCHDOG_S / 2) < 1.3
        manager.process.send_signal(signal.SIGHUP)
        await manager.until("RELOADING=1\nMONOTONIC_USEC=")
        if manager.heard[-1][1] != "READY=1":
            await manager.until("READY=1")
        (tmp_path / "gateway.toml").write_text("wrong", "utf-8")
        manager.process.send_signal(signal.SIGHUP)
        await manager.until("RELOADING=1")
        if manager.heard[-1][1] != "READY=1":
            await manager.until("READY=1")
        begun_s = time.monotonic()
        manager.process.send_signal(signal.SIGTERM)
        await manager.until("STOPPING=1")
        assert await manager.process.wait() == 0
        assert time.monotonic() - begun_s < 2
        stderr = manager.process.stderr
        assert stderr is not None
        log = b"".join([chunk async for chunk in stderr]).decode()
    assert '"event": "reload.applied"' in log
    assert '"event": "reload.refused"' in log


HANGING = """
import dataclasses
import time

from vendors.rainbow import VENDOR as RAINBOW


class Hanging:
    ready, notes, gaps = False, (), None

    def __init__(self):
        self.begun = time.monotonic()

    def feed(self, data):
        return []

    def end(self):
        return []

    def outgoing(self):
        return b""

    def tick(self):
        while time.monotonic() - self.begun < 60:
            pass
        return b""

    def goodbye(self):
        return b""


PROTOCOL = dataclasses.replace(
    RAINBOW.protocols[0], name="hangs", request=None, tick_s=0.9, rate_hz=None, make_decoders=lambda *_: Hanging
)
VENDOR = dataclasses.replace(RAINBOW, name="hanging", protocols=(PROTOCOL,))
"""


@pytest.mark.limit(40)
async def test_a_loop_that_hangs_feeds_no_watchdog(tmp_path: Path) -> None:
    plugin = tmp_path / "plugins" / "hanging" / "__init__.py"
    plugin.parent.mkdir(parents=True)
    plugin.write_text(HANGING, "utf-8")
    with socket.create_server(("127.0.0.1", 0)) as controller:
        robot = (
            f'[[robots]]\nname = "r1"\nvendor = "hanging"\nhost = "127.0.0.1"\nport = {controller.getsockname()[1]}\n'
        )
        config = f'vendor_dirs = ["{plugin.parents[1]}"]\n[server]\nlisten = "127.0.0.1:0"\n{robot}'
        async with managed(tmp_path, config) as manager:
            await manager.until("READY=1")
            await manager.until("WATCHDOG=1")
            await manager.during(2.5)  # by now it hangs
            assert not [message for _, message in await manager.during(3 * WATCHDOG_S) if message == "WATCHDOG=1"]
