"""The listener: who may come in, health, a port that is taken, and going away."""

from __future__ import annotations

import contextlib
import socket
import time
from contextlib import AsyncExitStack

import aiohttp
import anyio
import pytest
import websockets
from websockets.asyncio.client import connect as foreign_connect

from gateway import __version__
from gateway.core.bus import Bus
from gateway.core.events import EventRing
from gateway.server.access import is_local, is_own
from gateway.server.cell import Cell
from gateway.server.http import ListenError, listening
from tests.server.kit import cell, publish, running_door, talking

LOCAL = ["localhost", "LOCALHOST:8765", "127.0.0.1", "127.0.0.1:8765", "127.9.9.9:1", "[::1]", "[::1]:8765"]
FOREIGN = [
    "",
    "evil.example",
    "evil.example:8765",
    "127.0.0.1.evil.example",
    "localhost.evil.example",
    "192.168.0.1:8765",
    "10.0.0.1",
    "0.0.0.0",  # noqa: S104 - nobody listens there
    "[::]:8765",
    "[fe80::1]",
    "::1",
    "[::1",
    "[::1]evil",
    "evil@127.0.0.1",
    "127.0.0.1@evil",
    "127.0.0.1/evil",
    "127.0.0.1:port",
    "127.1",
    "2130706433",
    "localhost:8765:1",
    " localhost",
]


@pytest.mark.parametrize("host", LOCAL)
def test_this_machine_is_known_by_its_names(host: str) -> None:
    assert is_local(host)


@pytest.mark.parametrize("host", FOREIGN)
def test_no_other_name_passes_for_this_machine(host: str) -> None:
    assert not is_local(host)


def test_a_page_is_our_own_only_if_it_came_from_the_same_host_and_port() -> None:
    assert is_own("http://127.0.0.1:8765", "127.0.0.1:8765")
    assert is_own("https://LOCALHOST:8765", "localhost:8765")
    for origin in ("null", "", "http://evil.example", "http://127.0.0.1:80", "http://[::1", "file://127.0.0.1:8765"):
        assert not is_own(origin, "127.0.0.1:8765")


def door(url: str, path: str = "/healthz") -> str:
    return url.replace("ws://", "http://").replace("/ws", path)


async def test_health_is_told() -> None:
    bus, robots = cell()
    async with running_door(bus, robots) as url, aiohttp.ClientSession() as session:
        answer = await session.get(door(url))
        assert answer.status == 200
        assert await answer.json() == {"status": "ok", "gateway": __version__}
        assert (await session.get(door(url, "/zzz"))).status == 404
        assert (await session.get(door(url, "/ws"))).status == 400


@pytest.mark.parametrize("host", [host for host in FOREIGN if host.strip() == host != ""])
async def test_a_foreign_host_is_refused_at_every_door(host: str) -> None:
    bus, robots = cell()
    async with running_door(bus, robots) as url, aiohttp.ClientSession() as session:
        for path in ("/healthz", "/ws", "/zzz"):
            answer = await session.get(door(url, path), headers={"Host": host})
            assert answer.status in {400, 403}, path


@pytest.mark.parametrize("origin", ["http://evil.example", "null", "http://127.0.0.1:1", "http://[::1", "", "ws://x"])
async def test_a_foreign_origin_is_refused(origin: str) -> None:
    bus, robots = cell()
    async with running_door(bus, robots) as url, aiohttp.ClientSession() as session:
        with pytest.raises(aiohttp.WSServerHandshakeError) as refused:
            await session.ws_connect(url, headers={"Origin": origin})
        assert refused.value.status == 403


async def test_our_own_page_is_let_in() -> None:
    bus, robots = cell()
    async with (
        running_door(bus, robots) as url,
        aiohttp.ClientSession() as session,
        session.ws_connect(url, origin=door(url, "")) as websocket,
    ):
        assert (await websocket.receive()).type is aiohttp.WSMsgType.TEXT


async def test_a_foreign_client_is_told_why_it_is_refused() -> None:
    bus, robots = cell()
    async with running_door(bus, robots) as url:
        with pytest.raises(websockets.InvalidStatus) as refused:
            await foreign_connect(url, origin=websockets.Origin("http://evil.example"), proxy=None)
        assert refused.value.response.status_code == 403
        assert b"evil.example" in (refused.value.response.body or b"")


async def test_bytes_that_are_no_http_do_not_disturb_the_others() -> None:
    bus, robots = cell()
    async with running_door(bus, robots) as url, talking(url) as talk:
        port = int(url.rpartition(":")[2].removesuffix("/ws"))
        for junk in (
            b"\0" * 100,
            b"GET / HTTP/1.0\r\n\r\n",
            b"GET /ws HTTP/1.1\r\nHost: [::1\r\n\r\n",
            b"\x16\x03\x01",
        ):
            async with await anyio.connect_tcp("127.0.0.1", port) as stream:
                await stream.send(junk)
                await stream.send_eof()
                with anyio.move_on_after(1), contextlib.suppress(anyio.EndOfStream, anyio.BrokenResourceError):
                    assert b" 500 " not in await stream.receive()
        assert (await talk.ask("ping"))["op"] == "result"


async def test_ipv6_works_where_the_machine_has_it() -> None:
    bus, robots = cell()
    try:
        socket.create_server(("::1", 0), family=socket.AF_INET6).close()
    except OSError:
        pytest.skip("this machine has no IPv6 loopback")
    async with listening(Cell(robots, bus), "::1", 0, 0.0) as port, talking(f"ws://[::1]:{port}/ws") as talk:
        assert (await talk.ask("ping"))["op"] == "result"


async def test_a_port_in_use_says_which_and_what_to_do() -> None:
    bus, robots = cell()
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(ListenError, match=rf"127\.0\.0\.1:{port}: the port is in use.*server\.listen") as error:
            async with listening(Cell(robots, bus), "127.0.0.1", port, 0.0):
                pass
    assert error.value.address == f"127.0.0.1:{port}"


async def test_an_address_of_another_machine_says_so() -> None:
    bus, robots = cell()
    with pytest.raises(ListenError, match="no such address"):
        async with listening(Cell(robots, bus), "192.0.2.1", 0, 0.0):
            pass


async def test_the_end_closes_every_client_with_1001_at_once() -> None:
    bus, robots = cell()
    async with AsyncExitStack() as clients, anyio.create_task_group() as readers:
        async with running_door(bus, robots) as url:
            talks = [await clients.enter_async_context(talking(url)) for _ in range(20)]
            for talk in talks:
                readers.start_soon(talk.close_code)
            begin_s = time.monotonic()
        assert time.monotonic() - begin_s < 0.8
    assert [talk.socket.close_code for talk in talks] == [1001] * 20


async def test_a_client_that_does_not_read_does_not_hold_up_the_end() -> None:
    bus, robots = cell()
    async with AsyncExitStack() as clients:
        async with running_door(bus, robots) as url:
            lazy = await clients.enter_async_context(talking(url))
            await lazy.ask("subscribe", topics=["r1/vendor"], mode="all")
            lazy.socket._conn.transport.pause_reading()  # type: ignore[union-attr]
            for seq in range(5000):
                publish(bus, "r1/vendor", seq, {"filler": "x" * 2000})
            await anyio.sleep(0.05)
            begin_s = time.monotonic()
        assert time.monotonic() - begin_s < 2.5
        lazy.socket._conn.transport.abort()  # type: ignore[union-attr]


async def test_the_listener_is_free_again_afterwards() -> None:
    bus = Bus(EventRing())
    async with listening(Cell([], bus), "127.0.0.1", 0, 0.0) as port:
        pass
    async with listening(Cell([], bus), "127.0.0.1", port, 0.0) as again:
        assert again == port
