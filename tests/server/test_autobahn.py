"""The Autobahn cases against the WebSocket set-up that both doors share, with an echo in the place of a door.

Everything but the echo is the doors' own: the listener, the middlewares, the handshake, the limits, the reader, the way
back and the close. The tool is kosoku, which runs Autobahn's own case files.
"""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import cast

import anyio
import msgspec
import pytest
from aiohttp import WSMessage, WSMsgType, web

from gateway.server.accepting import accepting
from gateway.server.cell import Cell
from gateway.server.frames import frame
from gateway.server.guest import Guest, hosted, opened
from gateway.server.health import Pulse
from gateway.server.http import make_app
from gateway.server.limits import PEERS, Quota
from gateway.server.native import CLIENTS, Pace
from gateway.server.settings import DoorSettings
from tests.server import kit

_TOOL = Path(sys.executable).with_name("kosoku")
# Long messages (16 MB: our limit is 1 MiB), and compression, which we do not offer: 296 of the 517 cases.
_LONG, _COMPRESSED = "9.*", ("12.*", "13.*")
_GOOD = {"OK", "NON-STRICT", "INFORMATIONAL"}


class Case(msgspec.Struct, rename="camel"):
    """What came of one case."""

    behavior: str
    behavior_close: str
    remote_close_code: int | None = None


Report = dict[str, Case]


class _Nothing:
    """An echo owes nothing but its echo."""

    def close(self) -> None: ...

    def pace(self, flush_s: float) -> None: ...


class _Echo(Guest):
    """Sends back what comes."""

    @property
    def wrong_in_a_row(self) -> int:
        return 0

    async def take(self, message: WSMessage) -> None:
        is_text = message.type is WSMsgType.TEXT
        self._wire.write(frame(message.data.encode() if is_text else bytes(message.data), text=is_text))
        await self._wire.drained()


async def echo(request: web.Request) -> web.StreamResponse:
    opening = await opened(request, ())
    if opening[1] is None:
        return opening[0]
    socket, wire = opening
    clients = request.app[CLIENTS]
    guest = _Echo(socket, wire, _Nothing(), Quota(request.app[PEERS], request.remote))
    async with hosted(request, clients, guest):
        await guest.read()
    return socket


@asynccontextmanager
async def echoing() -> AsyncIterator[str]:
    """The doors with an echo beside them; yields its address."""
    bus, robots = kit.cell()
    app = make_app(Cell(robots, bus), Pace(flush_s=0.0, stuck_s=10.0), Pulse(), DoorSettings())
    app.router.add_get("/echo", echo)
    runner = web.AppRunner(app, access_log=None, shutdown_timeout=1.0)
    await runner.setup()
    try:
        async with accepting(app, cast("web.Server", runner.server), "127.0.0.1", 0) as port:
            yield f"ws://127.0.0.1:{port}/echo"
    finally:
        await runner.cleanup()


async def reported(folder: Path, *arguments: str) -> Report:
    """Run cases against the echo; what came of each."""
    async with echoing() as url:
        command = [str(_TOOL), "-m", "fuzzingclient", *arguments, "-p", "8", "-o", str(folder), url]
        done = await anyio.run_process(command, check=False)
    report = folder / "index.json"
    assert report.exists(), done.stderr.decode()
    agents = msgspec.json.decode(report.read_bytes(), type=dict[str, Report])
    return {name: case for results in agents.values() for name, case in results.items()}


def wrong(results: Report) -> Report:
    """The cases that failed, in what they did or in how they closed."""
    good = _GOOD | {"UNIMPLEMENTED"}
    return {
        name: result
        for name, result in results.items()
        if result.behavior not in good or result.behavior_close not in good
    }


def counted(results: Report) -> Counter[str]:
    """How many cases came out how."""
    return Counter(result.behavior for result in results.values())


@pytest.mark.limit(60)
async def test_no_case_of_the_protocol_fails(tmp_path: Path) -> None:
    excluded = [argument for case in (_LONG, *_COMPRESSED) for argument in ("-x", case)]
    results = await reported(tmp_path, *excluded)
    assert wrong(results) == {}
    assert "UNIMPLEMENTED" not in counted(results)
    assert len(results) >= 240


@pytest.mark.limit(60)
async def test_compression_is_not_taken_up(tmp_path: Path) -> None:
    results = await reported(tmp_path, *[argument for case in _COMPRESSED for argument in ("-i", case)])
    assert set(counted(results)) == {"UNIMPLEMENTED"}
    assert len(results) >= 210


@pytest.mark.limit(60)
async def test_of_the_long_messages_those_over_our_limit_end_with_1009(tmp_path: Path) -> None:
    results = await reported(tmp_path, "-i", _LONG)
    assert {case.remote_close_code for case in wrong(results).values()} == {1009}
    assert counted(results)["OK"] >= 16
