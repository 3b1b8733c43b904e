"""A client that has left is forgotten at once: nothing of it waits for the collector of garbage."""

from __future__ import annotations

import socket
from collections import Counter
from collections.abc import Callable

import anyio
import anyio.to_thread
import pytest

from gateway.server import sse
from tests.garbage import uncollected
from tests.server.kit import cell, publish, running_door

_WAIT_S = 5.0
_UPGRADE = (
    "Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
    "Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n"
)
_FAREWELL = b"\x88\x82\0\0\0\0\x03\xe8"


def visit(port: int, path: str, head: str = "", answer: bytes = b"200 OK", last: bytes = b"") -> None:
    """Connect, ask, read what comes first, and leave; `last` is sent before that, and answered."""
    with socket.create_connection(("127.0.0.1", port), _WAIT_S) as client:
        client.sendall(f"GET {path} HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\n{head}\r\n".encode())
        got = client.recv(65536)
        assert answer in got.partition(b"\r\n")[0]
        if head:  # a stream: its first message
            while not got.partition(b"\r\n\r\n")[2]:
                got += client.recv(65536)
        if last:
            client.sendall(last)
            while client.recv(65536):
                pass


def asks(port: int) -> None:
    visit(port, "/api/v1/robots")


def streams(port: int) -> None:
    visit(port, "/api/v1/stream?topics=*/joints", "Accept: text/event-stream\r\n")


def reads_events(port: int) -> None:
    visit(port, "/api/v1/events")


def subscribes_and_is_gone(port: int) -> None:
    visit(port, "/ws?topics=*/joints", _UPGRADE, b"101")


def subscribes_and_says_farewell(port: int) -> None:
    visit(port, "/ws?topics=*/joints", _UPGRADE, b"101", _FAREWELL)


def is_foxglove_and_is_gone(port: int) -> None:
    visit(port, "/", f"{_UPGRADE}Sec-WebSocket-Protocol: foxglove.sdk.v1\r\n", b"101")


@pytest.mark.parametrize(
    "comes",
    [asks, reads_events, streams, subscribes_and_is_gone, subscribes_and_says_farewell, is_foxglove_and_is_gone],
)
def test_a_client_that_has_left_leaves_nothing_behind(
    comes: Callable[[int], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sse, "_WATCH_S", 0.01)  # so soon a stream looks whether its client is still there

    async def story() -> None:
        bus, robots = cell("r1")
        publish(bus, "r1/joints", 1)
        async with running_door(bus, robots) as url:
            port = int(url.rsplit(":", 1)[1].partition("/")[0])
            await anyio.to_thread.run_sync(comes, port)  # what is made once is made
            await anyio.wait_all_tasks_blocked()
            with uncollected() as found:
                for _ in range(5):
                    await anyio.to_thread.run_sync(comes, port)
                    await anyio.sleep(0.05)
            assert found == Counter()

    anyio.run(story, backend_options={"use_uvloop": True})  # the loop that the gateway runs on
