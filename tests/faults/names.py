"""A name service that fails: controllers known by name, while it says nothing, denies them, or gives new addresses."""

from __future__ import annotations

import asyncio
import os
import socket
import struct
import subprocess
import time
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from random import Random
from typing import cast

import anyio

from tests.faults.cell import BACK_S, hosts, steady_robots
from tests.faults.kit import Fault, Series, Stage
from tests.faults.processes import gateway
from tests.faults.report import Seen
from tests.faults.robots import Controllers, Robot, configured
from tests.faults.tunlink import run

_NAME = "cell7.rgw.test"
_HEADER = 12
_TYPE_A = 1
_NO_ERROR, _NO_SUCH_NAME = 0x8180, 0x8183
_TTL_S = 0
_LOST_S = 10.0
# A look-up that nobody answers takes resolv.conf's 1 s twice for each kind of address; then there is the back-off.
_BACK_S = BACK_S + 5.0


class Answer(StrEnum):
    """What the name service does."""

    TRUE = "true"
    SILENT = "silent"
    NO_SUCH_NAME = "no such name"


class NameServer(asyncio.DatagramProtocol):
    """Answers questions for IPv4 addresses over UDP.

    Attributes:
        addresses: By name.
        answer: What it does now.
        n_asked: How often it was asked.
    """

    def __init__(self) -> None:
        self.addresses: dict[str, str] = {}
        self.answer = Answer.TRUE
        self.n_asked = 0
        self._transport: asyncio.DatagramTransport

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Keep what it answers through."""
        self._transport = cast("asyncio.DatagramTransport", transport)  # which the loop's own is no subclass of

    def datagram_received(self, data: bytes, addr: tuple[str, int]) -> None:
        """Answer a question, or do not."""
        self.n_asked += 1
        if self.answer is not Answer.SILENT:
            self._transport.sendto(self.answered(data), addr)

    def answered(self, question: bytes) -> bytes:
        """The answer to a question, both in the form of RFC 1035."""
        end = question.index(b"\0", _HEADER) + 5
        labels, at = [], _HEADER
        while question[at]:
            labels.append(question[at + 1 : at + 1 + question[at]].decode("ascii"))
            at += 1 + question[at]
        (kind,) = struct.unpack_from("!H", question, at + 1)
        address = self.addresses.get(".".join(labels).lower())
        known = address is not None and self.answer is Answer.TRUE
        records = b""
        if known and kind == _TYPE_A and address is not None:
            records = struct.pack("!HHHIH", 0xC00C, _TYPE_A, 1, _TTL_S, 4) + socket.inet_aton(address)
        flags = _NO_ERROR if known else _NO_SUCH_NAME
        head = question[:2] + struct.pack("!HHHHH", flags, 1, bool(records), 0, 0)
        return head + question[_HEADER:end] + records


def why_not() -> str | None:
    """Why a process cannot have a resolv.conf of its own here; None: it can."""
    if os.getuid() != 0:
        return "a resolv.conf of one process needs root"
    try:
        run("unshare", "--mount", "true")
    except (OSError, subprocess.CalledProcessError) as error:
        return f"no mount namespaces: {error}"
    return None


def own_resolver(folder: Path, server: str) -> tuple[str, ...]:
    """What gives the process behind it a resolv.conf of its own."""
    path = folder / "resolv.conf"
    path.write_text(f"nameserver {server}\noptions timeout:1 attempts:2\n", "utf-8")
    return ("unshare", "--mount", "sh", "-c", 'mount --bind "$0" /etc/resolv.conf && exec "$@"', str(path))


@dataclass
class NamesStage(Stage):
    """A gateway that knows some controllers by name.

    Attributes:
        server: The name service.
        named: The controller that is known by name.
        numbered: One that is known by its address.
        elsewhere: The controller of the same name at another address; it does not run.
    """

    server: NameServer
    named: Controllers
    numbered: Controllers
    elsewhere: Controllers


@asynccontextmanager
async def names(folder: Path) -> AsyncIterator[NamesStage]:
    """Run the cell with a name service."""
    host = hosts(40)
    steady = steady_robots(host)[:3]
    address = host()
    one, two = (Robot(name="d1", vendor="rainbow", protocol="reqdata", host=host()) for _ in range(2))
    by_number = Robot(name="a1", vendor="rainbow", protocol="reqdata", host=host())
    async with AsyncExitStack() as stack:
        tasks = await stack.enter_async_context(anyio.create_task_group())
        loop = asyncio.get_running_loop()
        transport, server = await loop.create_datagram_endpoint(NameServer, local_addr=(address, 53))
        stack.callback(transport.close)
        server.addresses[_NAME] = one.host
        running = [Controllers([robot], folder) for robot in (one, by_number, two)]
        near = Controllers(steady, folder)
        for each in (near, *running):
            stack.push_async_callback(each.kill)
        for each in (near, *running[:2]):
            await each.start()
        seen = Robot(name="d1", vendor="rainbow", protocol="reqdata", host=one.host, seen_at=(_NAME, one.port))
        text = configured([*steady, by_number, seen])
        process = await stack.enter_async_context(gateway(text, folder, prefix=own_resolver(folder, address)))
        known = frozenset(robot.name for robot in steady)
        stage = NamesStage(process, tasks, folder, known, server, *running)
        await stack.enter_async_context(stage.watched({*known, "d1", "a1"}))
        yield stage


async def _gone(stage: NamesStage, answer: Answer) -> Seen:
    """The name cannot be looked up while both controllers are started anew; the one without a name is not held up."""
    async with stage.striking("d1", "a1"):
        stage.server.answer = answer
        try:
            for controllers, name in ((stage.named, "d1"), (stage.numbered, "a1")):
                await controllers.kill()
                await stage.watch.lost(name, _LOST_S)
                await controllers.start()
            await stage.watch.back("a1", time.monotonic(), BACK_S)
            asked = stage.server.n_asked
            await stage.watch.until(lambda: stage.server.n_asked > asked, BACK_S, "a look-up")
            assert stage.watch.is_silent("d1")
        finally:
            stage.server.answer = Answer.TRUE
        recovery_s = await stage.watch.back("d1", time.monotonic(), _BACK_S)
    return Seen(recovery_s, "that link only; a robot with an address reconnects meanwhile")


async def silent(stage: NamesStage, random: Random) -> Seen:
    """Nobody answers look-ups."""
    return await _gone(stage, Answer.SILENT)


async def no_such_name(stage: NamesStage, random: Random) -> Seen:
    """The name service denies that there is such a name."""
    return await _gone(stage, Answer.NO_SUCH_NAME)


async def moved(stage: NamesStage, random: Random) -> Seen:
    """The controller comes back at another address."""
    async with stage.striking("d1"):
        await stage.named.kill()
        stage.named, stage.elsewhere = stage.elsewhere, stage.named
        stage.server.addresses[_NAME] = stage.named.robots[0].host
        since_s = time.monotonic()
        await stage.named.start()
        recovery_s = await stage.watch.back("d1", since_s, BACK_S)
    return Seen(recovery_s, "the name is looked up for each attempt")


NAMES = Series(
    name="names",
    open=names,
    faults=(
        Fault(name="name service silent", strike=silent),
        Fault(name="name unknown", strike=no_such_name),
        Fault(name="controller at another address", strike=moved),
    ),
)
