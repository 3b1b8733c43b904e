"""The listener: who may come in, health, a port that is taken, and going away."""

from __future__ import annotations

import contextlib
import re
import socket
import time
from contextlib import AsyncExitStack
from pathlib import Path

import aiohttp
import anyio
import pytest
import websockets
from websockets.asyncio.client import connect as foreign_connect
from yarl import URL

from gateway.api.messages import JSON_SUBPROTOCOL
from gateway.core.bus import Bus
from gateway.core.events import EventRing
from gateway.server import pages
from gateway.server.access import Access, is_own
from gateway.server.cell import Cell
from gateway.server.http import _ROUTES, listening
from gateway.server.listener import ListenError
from gateway.server.settings import AccessSettings, DoorSettings
from tests.server.kit import cell, publish, running_door, talking

KNOWN = ["localhost", "LOCALHOST:8765", "127.0.0.1", "127.0.0.1:8765", "127.9.9.9:1", "[::1]", "[::1]:8765"]
# No page of another site comes from an address that is this machine's.
ADDRESSES = ["192.168.0.1:8765", "10.0.0.1", "[::]:8765", "[fe80::1]"]
FOREIGN = [
    "",
    "evil.example",
    "evil.example:8765",
    "127.0.0.1.evil.example",
    "localhost.evil.example",
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


@pytest.mark.parametrize("host", [*KNOWN, *ADDRESSES])
def test_this_machine_is_known_by_its_names_and_by_any_address(host: str) -> None:
    assert Access(AccessSettings()).knows_host(host)


@pytest.mark.parametrize("host", FOREIGN)
def test_no_other_name_passes_for_this_machine(host: str) -> None:
    assert not Access(AccessSettings()).knows_host(host)


def test_a_page_is_our_own_only_if_it_came_from_the_same_host_and_port() -> None:
    assert is_own("http://127.0.0.1:8765", "127.0.0.1:8765")
    assert is_own("https://LOCALHOST:8765", "localhost:8765")
    for origin in ("null", "", "http://evil.example", "http://127.0.0.1:80", "http://[::1", "file://127.0.0.1:8765"):
        assert not is_own(origin, "127.0.0.1:8765")


EVERY_PATH = ["/", "/zzz", *(path.replace("{name}", "r1").replace("{topic:.+}", "r1/link") for path in _ROUTES)]
SAFE = {
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
}


def door(url: str, path: str = "/healthz") -> str:
    return url.replace("ws://", "http://").replace("/ws", path)


@pytest.mark.parametrize("host", [host for host in FOREIGN if host.strip() == host != ""])
async def test_a_foreign_host_is_refused_at_every_door(host: str) -> None:
    bus, robots = cell()
    async with running_door(bus, robots) as url, aiohttp.ClientSession() as session:
        for path in EVERY_PATH:
            answer = await session.get(door(url, path), headers={"Host": host})
            assert answer.status in {400, 403}, path


@pytest.mark.parametrize("origin", ["http://evil.example", "null", "http://127.0.0.1:1", "http://[::1", "", "ws://x"])
async def test_a_foreign_origin_is_refused(origin: str) -> None:
    bus, robots = cell()
    async with running_door(bus, robots) as url, aiohttp.ClientSession() as session:
        with pytest.raises(aiohttp.WSServerHandshakeError) as refused:
            await session.ws_connect(url, headers={"Origin": origin})
        assert refused.value.status == 403
        for path in EVERY_PATH:
            answer = await session.get(door(url, path), headers={"Origin": origin})
            assert (answer.status, (await answer.json())["code"]) == (403, "FORBIDDEN"), path


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


@pytest.mark.parametrize(
    "path", ["/zzz", "/api/v1/zzz", "/api", "/api/v1/robots/", "/index.html/", "/%2e%2e/app.py", "/.."]
)
async def test_an_address_that_is_none_says_where_to_look(path: str) -> None:
    async with running_door(*cell()) as url, aiohttp.ClientSession() as session:
        answer = await session.get(URL(door(url, path), encoded=True))
        body = await answer.json()
        assert (answer.status, body["code"]) == (404, "NOT_FOUND")
        assert "/api/v1/openapi.json" in body["message"]


@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE", "PATCH", "TRACE"])
async def test_the_doors_only_read(method: str) -> None:
    async with running_door(*cell()) as url, aiohttp.ClientSession() as session:
        for path in EVERY_PATH:
            answer = await session.request(method, door(url, path), data=b"x")
            if path == "/zzz":
                assert answer.status == 404
            else:
                assert (answer.status, (await answer.json())["code"]) == (405, "METHOD_NOT_ALLOWED"), path
                assert answer.headers["Allow"] == "GET, HEAD, OPTIONS"


async def test_options_tell_the_methods_and_head_the_headers() -> None:
    bus, robots = cell("r1")
    async with running_door(bus, robots) as url, aiohttp.ClientSession() as session:
        for path in EVERY_PATH:
            answer = await session.options(door(url, path))
            if path != "/zzz":
                assert (answer.status, answer.headers["Allow"]) == (204, "GET, HEAD, OPTIONS"), path
            assert not [name for name in answer.headers if name.startswith("Access-Control")], path
        for path in ("/healthz", "/metrics", "/api/v1/robots", "/api/v1/topics/r1/link"):
            head, get = await session.head(door(url, path)), await session.get(door(url, path))
            assert (head.status, head.content_type, await head.read()) == (200, get.content_type, b""), path


async def test_every_answer_is_safe_to_come_near_a_browser() -> None:
    async with running_door(*cell("r1")) as url, aiohttp.ClientSession() as session:
        for path in EVERY_PATH:
            async with session.get(door(url, path)) as answer:
                assert SAFE.items() <= answer.headers.items(), path
                policy = answer.headers["Content-Security-Policy"]
                assert "default-src 'none'" in policy, path
                assert "frame-ancestors 'none'" in policy, path
                assert "unsafe" not in policy, path


async def test_the_page_is_served_with_its_types_and_only_when_it_has_changed() -> None:
    async with running_door(*cell()) as url, aiohttp.ClientSession() as session:
        index = await session.get(door(url, "/"))
        assert (index.status, index.content_type) == (200, "text/html")
        assert index.headers["Cache-Control"] == "no-cache"
        host = URL(url).authority
        assert f"connect-src 'self' ws://{host} wss://{host};" in index.headers["Content-Security-Policy"]
        for name, file in pages.load().items():
            answer = await session.get(door(url, f"/{name}"))
            assert (answer.status, await answer.read()) == (200, file.body), name
            assert answer.headers["Content-Type"] == file.content_type
            for known, status in ((answer.headers["ETag"], 304), (f"W/{answer.headers['ETag']}", 304), ('"old"', 200)):
                again = await session.get(door(url, f"/{name}"), headers={"If-None-Match": known})
                assert again.status == status, (name, known)


async def test_the_page_asks_nobody_else() -> None:
    for name, file in pages.load().items():
        if name.endswith((".html", ".css")):
            assert not re.search(rb"(?:src|href|url\()\s*=?\s*[\"'(]?\s*(?:https?:)?//", file.body), name
        if name.endswith(".html"):
            assert not re.search(rb"<script(?![^>]*\ssrc=)|\son[a-z]+=|\sstyle=|<style", file.body), name


def test_only_files_of_a_known_kind_are_of_the_page(tmp_path: Path) -> None:
    for name in ("index.html", "a.js", ".hidden.js", "notes.md", "b.py", "deep/c.css", ".git/d.js"):
        path = tmp_path / name
        path.parent.mkdir(exist_ok=True)
        path.write_text(name, "utf-8")
    (tmp_path / "folder.js").mkdir()
    assert set(pages.load(tmp_path)) == {"index.html", "a.js", "deep/c.css"}
    assert set(pages.routes(pages.load(tmp_path))) == {"/", "/index.html", "/a.js", "/deep/c.css"}
    assert pages.load(tmp_path / "none") == {}


def test_the_package_holds_the_page() -> None:
    assert {"index.html"} <= set(pages.load())
    assert (pages.FOLDER.parent / "__init__.py").exists(), "hatch puts what stands inside a package into the wheel"


async def test_a_websocket_at_the_root_is_for_foxglove_and_another_is_told_where_to_go() -> None:
    async with running_door(*cell()) as url, aiohttp.ClientSession() as session:
        for path in ("/", "/foxglove"):
            for protocol in ("foxglove.sdk.v1", "foxglove.websocket.v1"):
                async with session.ws_connect(door(url, path), protocols=(protocol,)) as websocket:
                    assert websocket.protocol == protocol
                    assert "serverInfo" in (await websocket.receive()).data
        with pytest.raises(aiohttp.WSServerHandshakeError) as refused:
            await session.ws_connect(door(url, "/"), protocols=(JSON_SUBPROTOCOL,))
        assert refused.value.status == 400


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
    async with (
        listening(Cell(robots, bus), "::1", 0, DoorSettings()) as doors,
        talking(f"ws://[::1]:{doors.port}/ws") as talk,
    ):
        assert (await talk.ask("ping"))["op"] == "result"


async def test_a_port_in_use_says_which_and_what_to_do() -> None:
    bus, robots = cell()
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(ListenError, match=rf"127\.0\.0\.1:{port}: the port is in use.*server\.listen") as error:
            async with listening(Cell(robots, bus), "127.0.0.1", port, DoorSettings()):
                pass
    assert error.value.address == f"127.0.0.1:{port}"


async def test_an_address_of_another_machine_says_so() -> None:
    bus, robots = cell()
    with pytest.raises(ListenError, match="no such address"):
        async with listening(Cell(robots, bus), "192.0.2.1", 0, DoorSettings()):
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
    async with listening(Cell([], bus), "127.0.0.1", 0, DoorSettings()) as doors:
        port = doors.port
    async with listening(Cell([], bus), "127.0.0.1", port, DoorSettings()) as again:
        assert again.port == port
