"""The client: what it asks, and what it says when there is no gateway, another server, or none any more."""

from __future__ import annotations

from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager

import anyio
import anyio.abc
import msgspec
import pytest
from aiohttp import web

from gateway.api.messages import Data, EventMessage, Limits, Welcome
from gateway.client import ClientError, RequestError, connect
from tests.server.kit import BOOT, cell, last_name, publish, raise_command, raise_event, running_door


async def test_every_request_has_a_method() -> None:
    bus, robots = cell("r1")
    publish(bus, "r1/joints", 4)
    raise_event(bus, "r1")
    async with running_door(bus, robots) as url, connect(url) as client:
        assert client.welcome.robots == ["r1"]
        (robot,) = await client.robots()
        assert robot.link.state == "ONLINE"
        (sample,) = await client.get(["r1/joints"])
        assert sample.seq == 4
        assert (await client.describe("r1/joints")).topic == "r1/joints"
        (event,) = await client.events()
        assert event.name == f"{BOOT}:1"
        assert await client.subscribe(["r1/joints"], fields=["position"], rate_hz=50) == ["r1/joints"]
        message = await anext(client.pushed())
        assert isinstance(message, Data)
        assert message.samples[0].data == {"position": [4.0, None]}


async def test_what_is_pushed_between_question_and_answer_is_kept() -> None:
    bus, robots = cell("r1")
    async with running_door(bus, robots) as url, connect(url) as client:
        await client.subscribe(["r1/joints", "r1/events"], mode="all")
        for seq in range(1, 4):
            publish(bus, "r1/joints", seq)
            raise_event(bus, "r1")
            await client.robots()
        seqs: list[int] = []
        n_events = 0
        with anyio.fail_after(5):
            async for message in client.pushed():
                if isinstance(message, Data):
                    seqs += [sample.seq for sample in message.samples]
                elif isinstance(message, EventMessage):
                    n_events += len(message.events)
                if len(seqs) == n_events == 3:
                    break
        assert seqs == [1, 2, 3]


async def test_events_of_several_rings_are_read_on_by_one_name_each() -> None:
    bus, robots = cell("r1", command_ring=100)
    raise_event(bus, "r1")
    names = [raise_command(bus, "r1", number) for number in range(3)]
    async with running_door(bus, robots) as url, connect(url) as client:
        assert [event.name for event in await client.events([f"{BOOT}:1", names[0]])] == names[1:]
        assert [event.name for event in await client.events(names[1], topics=["*/commands"])] == names[2:]
        await client.subscribe(["*/events", "*/commands"], since=[f"{BOOT}:1", names[1]])
        message = await anext(client.pushed())
        assert isinstance(message, EventMessage)
        assert [event.name for event in message.events] == names[2:] == [last_name(bus, "r1/commands")]


async def test_a_refusal_has_its_code_and_the_connection_goes_on() -> None:
    bus, robots = cell("r1")
    async with running_door(bus, robots) as url, connect(url) as client:
        with pytest.raises(RequestError, match="did you mean") as refused:
            await client.subscribe(["r1/jonts"])
        assert refused.value.code == "UNKNOWN_TOPIC"
        assert await client.robots()


async def test_a_gateway_that_stops_says_so_in_the_middle_of_the_stream() -> None:
    bus, robots = cell("r1")
    async with running_door(bus, robots) as url:
        client = await (manager := connect(url)).__aenter__()
        await client.subscribe(["*"])
    with pytest.raises(ClientError, match="the connection has ended: the gateway is stopping"):
        async for _ in client.pushed():
            pass
    with pytest.raises(ClientError, match="the connection has ended"):
        await client.robots()
    await manager.__aexit__(None, None, None)


@pytest.mark.parametrize(
    ("code", "says"), [(1011, "ended with an internal error of the gateway"), (1013, "ended: why")]
)
async def test_a_farewell_is_told_by_its_code(code: int, says: str) -> None:
    with pytest.raises(ClientError, match=says):
        await leave(lambda socket: socket.close(code=code, message=b"why"))


async def test_an_end_without_a_farewell_is_told_from_one_with() -> None:
    async def cut(socket: web.WebSocketResponse) -> None:
        transport = socket._req.transport if socket._req else None
        assert transport is not None
        transport.abort()

    with pytest.raises(ClientError, match="without a farewell: the gateway has gone, or ended with an internal error"):
        await leave(cut)


@pytest.mark.parametrize(
    "url", ["", "foo", "ws:/x", "ws://", "ftp://127.0.0.1/ws", "ws://127.0.0.1:99999/ws", "ws://[::1/"]
)
async def test_an_address_that_is_none_says_what_one_looks_like(url: str) -> None:
    with pytest.raises(ClientError, match=r"one looks like ws://127\.0\.0\.1:8765/ws"):
        async with connect(url):
            pass


async def test_nobody_there_says_how_to_start_a_gateway() -> None:
    with pytest.raises(ClientError, match="start one with `robot-gateway run`"):
        async with connect("ws://127.0.0.1:1/ws"):
            pass


Handler = Callable[[anyio.abc.ByteStream], Awaitable[None]]


@asynccontextmanager
async def serving(handler: Handler) -> AsyncIterator[str]:
    """A TCP server that is no gateway."""
    listener = await anyio.create_tcp_listener(local_host="127.0.0.1")
    port = listener.extra(anyio.abc.SocketAttribute.local_port)  # noqa: S610 - no Django here
    async with listener, anyio.create_task_group() as tasks:
        tasks.start_soon(listener.serve, handler)
        yield f"ws://127.0.0.1:{port}/ws"
        tasks.cancel_scope.cancel()


async def silent(stream: anyio.abc.ByteStream) -> None:
    """Say nothing."""
    async with stream:
        await anyio.sleep_forever()


async def hang_up(stream: anyio.abc.ByteStream) -> None:
    """Close at once."""
    await stream.aclose()


async def talk_ssh(stream: anyio.abc.ByteStream) -> None:
    """Say something else."""
    async with stream:
        await stream.send(b"SSH-2.0-OpenSSH_9.2\r\n")
        await stream.receive()


async def talk_tls(stream: anyio.abc.ByteStream) -> None:
    """Answer plain HTTP with a TLS alert."""
    async with stream:
        await stream.receive()
        await stream.send(b"\x15\x03\x03\x00\x02\x02\x46")


@asynccontextmanager
async def greeting(text: str, then: Callable[[web.WebSocketResponse], Awaitable[object]]) -> AsyncIterator[str]:
    """A WebSocket server that says one thing and then does another."""

    async def greet(request: web.Request) -> web.WebSocketResponse:
        socket = web.WebSocketResponse()
        await socket.prepare(request)
        await socket.send_str(text)
        await then(socket)
        return socket

    app = web.Application()
    app.router.add_get("/ws", greet)
    runner = web.AppRunner(app)
    await runner.setup()
    site = web.TCPSite(runner, "127.0.0.1", 0)
    await site.start()
    try:
        yield f"ws://127.0.0.1:{runner.addresses[0][1]}/ws"
    finally:
        await runner.cleanup()


async def leave(end: Callable[[web.WebSocketResponse], Awaitable[object]]) -> None:
    """Follow a gateway that ends the connection after its welcome."""
    welcome = Welcome(gateway="0", robots=[], last_event="b:0", limits=Limits(queued_samples=1, queued_events=1))
    async with greeting(msgspec.json.encode(welcome).decode(), end) as url, connect(url) as client:
        async for _ in client.pushed():
            pass


async def test_a_server_that_says_nothing_is_not_waited_for_for_ever() -> None:
    async with serving(silent) as url:
        with anyio.fail_after(5), pytest.raises(ClientError, match="nothing came within 3 s"):
            async with connect(url):
                pass


@pytest.mark.parametrize("handler", [hang_up, talk_ssh, talk_tls])
async def test_another_server_is_told_from_a_gateway(handler: Handler) -> None:
    async with serving(handler) as url:
        with anyio.fail_after(5), pytest.raises(ClientError, match="not as a gateway does"):
            async with connect(url):
                pass


async def test_tls_where_there_is_none_says_so() -> None:
    bus, robots = cell("r1")
    async with running_door(bus, robots) as url:
        with pytest.raises(ClientError, match="ws://"):
            async with connect(url.replace("ws://", "wss://")):
                pass


async def test_a_wrong_path_says_which_is_right() -> None:
    bus, robots = cell("r1")
    async with running_door(bus, robots) as url:
        with pytest.raises(ClientError, match=r"HTTP 404.*path of a gateway is /ws"):
            async with connect(f"{url}x"):
                pass


@pytest.mark.parametrize("text", ["hello", '{"op":"other"}', '{"op":"data","samples":[]}', "[]"])
async def test_another_websocket_is_told_from_a_gateway(text: str) -> None:
    async with greeting(text, lambda socket: socket.receive()) as url:
        with pytest.raises(ClientError, match="not as a gateway does"):
            async with connect(url):
                pass
