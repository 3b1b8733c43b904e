"""How much one address may ask of the doors, and how long a connection may be silent."""

from __future__ import annotations

import asyncio
import os
import resource
import socket
import ssl
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import AsyncExitStack, asynccontextmanager, suppress
from pathlib import Path
from typing import cast

import aiohttp
import anyio
import msgspec
import pytest
import structlog
from aiohttp import web
from anyio.abc import SocketStream
from hypothesis import given
from hypothesis import strategies as st

from gateway.config.file import parse
from gateway.config.keys import PeerLimits
from gateway.server.accepting import accepting, bounded
from gateway.server.cell import Cell
from gateway.server.http import listening
from gateway.server.limits import BURST_S, PEERS, RESERVED, RESERVED_PER_ROBOT, Bucket, Lease, Peers, Quota, name_of
from gateway.server.refusals import REFUSALS, Refusals
from gateway.server.settings import DoorSettings, Limits, door_settings
from tests.client.secured import certificate, needs_openssl
from tests.server import kit
from tests.server.kit import Now

_FOXGLOVE = "foxglove.websocket.v1"


def peers(limits: Limits, now: Now | None = None, descriptors: int = 100_000, robots: int = 0) -> Peers:
    return Peers(limits, Refusals(now or Now()), lambda: robots, now or Now(), lambda: descriptors)


def admit(held: Peers, address: str) -> Lease:
    lease = held.admit(address)
    assert lease is not None
    return lease


def test_an_address_has_so_many_connections_and_another_its_own() -> None:
    held = peers(Limits(connections=2))
    first, _ = admit(held, "192.0.2.1"), admit(held, "192.0.2.1")
    assert held.admit("192.0.2.1") is None
    assert held.refusals.counts["connections"] == 1
    admit(held, "192.0.2.2")
    first.release()
    first.release()
    admit(held, "192.0.2.1")
    assert held.admit("192.0.2.1") is None
    assert held.n_open == 3


def test_the_robots_links_keep_their_file_descriptors() -> None:
    held = peers(Limits(connections=1000), descriptors=RESERVED + 5 * RESERVED_PER_ROBOT + 40, robots=5)
    assert held.most_open == 40
    leases = [admit(held, f"192.0.2.{number}") for number in range(40)]
    assert held.admit("192.0.2.99") is None
    assert held.refusals.counts["all_connections"] == 1
    leases[0].release()
    admit(held, "192.0.2.99")


def test_one_address_leaves_some_connections_to_the_others() -> None:
    held = peers(Limits(connections=1000), descriptors=RESERVED + 40)
    n_admitted = sum(held.admit("192.0.2.1") is not None for _ in range(100))
    assert n_admitted == 35
    admit(held, "192.0.2.2")


def test_where_few_files_may_be_open_some_connections_are_still_taken() -> None:
    assert peers(Limits(), descriptors=20).most_open == 16
    assert peers(Limits(), descriptors=-1).most_open > 100_000


@pytest.mark.parametrize(
    ("address", "name"),
    [
        ("192.0.2.1", "192.0.2.1"),
        ("::ffff:192.0.2.1", "192.0.2.1"),
        ("2001:db8:1:2:3:4:5:6", "2001:db8:1:2::/64"),
        ("2001:db8:1:2:ffff::1", "2001:db8:1:2::/64"),
        ("fe80::1%eth0", "fe80::/64"),
        ("::1", "::1"),
        ("not:an:address", "not:an:address"),
        (None, ""),
    ],
)
def test_an_ipv6_address_counts_as_its_network(address: str | None, name: str) -> None:
    assert name_of(address) == name


def test_the_addresses_of_one_ipv6_network_share_their_connections() -> None:
    held = peers(Limits(connections=2))
    admit(held, "2001:db8::1")
    admit(held, "2001:db8::2")
    assert held.admit("2001:db8::3") is None
    admit(held, "2001:db8:0:1::1")


def test_after_a_rest_five_seconds_worth_of_requests_may_come_at_once() -> None:
    now = Now()
    held = peers(Limits(handshakes_per_s=2), now)
    assert [held.handshake_wait_s("192.0.2.1") for _ in range(10)] == [0.0] * 10
    assert 0 < held.handshake_wait_s("192.0.2.1") <= 0.5
    assert held.handshake_wait_s("192.0.2.2") == 0
    now.at_s += 0.5
    assert held.handshake_wait_s("192.0.2.1") == 0
    assert held.handshake_wait_s("192.0.2.1") > 0
    assert held.refusals.counts["handshakes"] == 2


@given(rate=st.floats(0.1, 10_000), steps=st.lists(st.floats(0, 3), min_size=1, max_size=200))
def test_a_bucket_never_gives_more_than_its_rate_and_a_burst(rate: float, steps: list[float]) -> None:
    bucket, now_s, n_taken = Bucket(), 1000.0, 0
    for step_s in steps:
        now_s += step_s
        if bucket.wait_s(rate, now_s) <= 0:
            bucket.take(rate, now_s)
            n_taken += 1
    assert n_taken <= sum(steps) * rate + max(1.0, BURST_S * rate) + 1
    assert Bucket().wait_s(rate, now_s) == 0


def test_other_limits_hold_at_once_and_take_nothing_away() -> None:
    now = Now()
    held = peers(Limits(connections=3, handshakes_per_s=1, messages_per_s=1000, subscriptions=2), now)
    leases = [admit(held, "192.0.2.1") for _ in range(3)]
    quota = Quota(held, "192.0.2.1")
    assert quota.take()
    assert quota.take()
    held.replace(Limits(connections=1, handshakes_per_s=1000, messages_per_s=0.1, subscriptions=3))
    assert held.n_open == 3
    leases[0].release()
    assert held.admit("192.0.2.1") is None
    assert quota.take()
    assert not quota.take()
    assert [held.handshake_wait_s("192.0.2.1") for _ in range(100)] == [0.0] * 100
    assert quota.message_wait_s() > 0  # it was 2000 at once, and is one in ten seconds


def test_subscriptions_count_over_all_connections_of_an_address() -> None:
    held = peers(Limits(subscriptions=3))
    one, two, other = Quota(held, "192.0.2.1"), Quota(held, "192.0.2.1"), Quota(held, "192.0.2.2")
    assert one.take()
    assert one.take()
    assert two.take()
    assert not two.take()
    assert other.take()
    assert held.refusals.counts["subscriptions"] == 1
    one.give()
    assert two.take()
    one.close()
    one.close()
    assert two.take()
    assert not two.take()


def test_messages_that_come_too_fast_are_read_later_and_that_is_said_once() -> None:
    now = Now()
    held = peers(Limits(messages_per_s=10), now)
    quota = Quota(held, "192.0.2.1")
    waits = [quota.message_wait_s() for _ in range(52)]
    assert waits == pytest.approx([0.0] * 49 + [0.1, 0.2, 0.3])
    assert held.refusals.counts["messages"] == 1
    now.at_s += 10
    assert quota.message_wait_s() == 0


def test_the_peers_that_have_left_are_remembered_up_to_a_bound() -> None:
    now = Now()
    held = peers(Limits(handshakes_per_s=0.1), now)
    stays = admit(held, "192.0.2.1")
    assert held.handshake_wait_s("192.0.2.1") == 0
    assert held.handshake_wait_s("192.0.2.1") > 0
    for number in range(5000):
        admit(held, f"10.0.{number // 256}.{number % 256}").release()
    assert len(held._gone) <= 1024
    assert len(held._here) == 1
    assert held.handshake_wait_s("192.0.2.1") > 0
    stays.release()
    assert held.handshake_wait_s("192.0.2.1") > 0  # leaving does not make it a new one


def test_the_defaults_are_those_of_the_configuration() -> None:
    configured = parse("", "gateway.toml")
    assert door_settings(configured).limits == Limits()
    assert msgspec.structs.asdict(PeerLimits()).keys() == set(Limits.__slots__)
    changed = parse("[server.limits]\nsubscriptions = 7\n", "gateway.toml")
    assert door_settings(changed).limits == Limits(subscriptions=7)


@asynccontextmanager
async def door(**limits: float) -> AsyncIterator[str]:
    """The doors with some limits; yields the native one's address."""
    bus, robots = kit.cell()
    settings = DoorSettings(limits=msgspec.convert(limits, Limits))
    async with kit.running_door(bus, robots, settings=settings) as url:
        yield url


def port_of(url: str) -> int:
    return int(url.rsplit(":", 1)[1].partition("/")[0])


async def is_closed(stream: SocketStream) -> bool:
    """Wait until a connection is closed; False: it sends something instead."""
    with anyio.fail_after(5):
        try:
            return not await stream.receive()
        except (anyio.EndOfStream, anyio.BrokenResourceError):
            return True


async def asked(stream: SocketStream, path: str = "/") -> bytes:
    """Ask over a connection that stays open; the answer's first line."""
    await stream.send(f"GET {path} HTTP/1.1\r\nHost: localhost\r\n\r\n".encode())
    with anyio.fail_after(5):
        return (await stream.receive()).partition(b"\r\n")[0]


async def test_a_connection_too_many_is_closed_at_once_even_if_the_others_never_ask_anything() -> None:
    async with door(connections=3) as url, AsyncExitStack() as stack:
        port = port_of(url)
        silent = [await stack.enter_async_context(await anyio.connect_tcp("127.0.0.1", port)) for _ in range(2)]
        asking = await stack.enter_async_context(await anyio.connect_tcp("127.0.0.1", port))
        assert b"200" in await asked(asking, "/healthz")
        assert await is_closed(await stack.enter_async_context(await anyio.connect_tcp("127.0.0.1", port)))
        await silent[0].aclose()
        for _ in range(500):  # until the gateway has noticed
            again = await stack.enter_async_context(await anyio.connect_tcp("127.0.0.1", port))
            try:
                assert b"200" in await asked(again, "/healthz")
                break
            except (anyio.EndOfStream, anyio.BrokenResourceError):
                await anyio.sleep(0.01)
        else:
            pytest.fail("there is no room although a connection was closed")


async def test_who_asks_too_often_is_told_when_to_come_again() -> None:
    async with door(handshakes_per_s=1) as url, aiohttp.ClientSession() as session:
        http = f"http://127.0.0.1:{port_of(url)}/healthz"
        statuses = []
        for _ in range(7):
            async with session.get(http) as answer:
                statuses.append(answer.status)
                body, retry = await answer.json(), answer.headers.get("Retry-After")
        assert statuses == [200] * 5 + [429] * 2
        assert body["code"] == "TOO_MANY_REQUESTS"
        assert "handshakes_per_s" in body["message"]
        assert retry == "1"
        with pytest.raises(aiohttp.WSServerHandshakeError) as refused:
            await session.ws_connect(url)
        assert refused.value.status == 429


async def test_a_reload_changes_the_limits_of_who_is_connected() -> None:
    bus, robots = kit.cell()
    async with (
        listening(Cell(robots, bus), "127.0.0.1", 0, DoorSettings()) as listener,
        kit.talking(f"ws://127.0.0.1:{listener.port}/ws") as talk,
    ):
        assert (await talk.ask("subscribe", id="a", topics=["r1/joints"]))["op"] == "result"
        await listener.apply(DoorSettings(limits=Limits(subscriptions=1)), "127.0.0.1", 0)
        assert (await talk.ask("subscribe", id="b", topics=["r1/joints"]))["op"] == "error"
        await listener.apply(DoorSettings(), "127.0.0.1", 0)
        assert (await talk.ask("subscribe", id="b", topics=["r1/joints"]))["op"] == "result"


async def test_subscriptions_of_two_clients_are_counted_together_and_given_back() -> None:
    async with door(subscriptions=2) as url, kit.talking(url) as first:
        await first.ask("subscribe", id="a", topics=["r1/joints"])
        async with kit.talking(url) as second:
            await second.ask("subscribe", id="b", topics=["r1/joints"])
            assert (await second.ask("subscribe", id="b", topics=["r2/joints"]))["op"] == "result"  # in its place
            refused = await second.ask("subscribe", id="c", topics=["r1/joints"])
            assert (refused["op"], refused["code"]) == ("error", "TOO_MUCH")
            assert "server.limits.subscriptions" in str(refused["message"])
            assert (await first.ask("unsubscribe", id="a"))["op"] == "result"
            assert (await second.ask("subscribe", id="c", topics=["r1/joints"]))["op"] == "result"
            assert (await first.ask("subscribe", id="a", topics=["r1/joints"]))["op"] == "error"
        for _ in range(500):  # until the gateway has noticed that the second has left
            answer = await first.ask("subscribe", id="a", topics=["r1/joints"])
            if answer["op"] == "result":
                break
            await anyio.sleep(0.01)
        assert answer["op"] == "result"


async def test_the_other_doors_count_their_subscriptions_too() -> None:
    async with door(subscriptions=2) as url, aiohttp.ClientSession() as session:
        host = f"127.0.0.1:{port_of(url)}"
        async with session.ws_connect(f"ws://{host}/foxglove", protocols=[_FOXGLOVE]) as socket:
            channels: list[int] = []
            while len(channels) < 3:
                told = await socket.receive_json()
                channels += [channel["id"] for channel in told.get("channels", [])]
            wanted = [{"id": number, "channelId": channel} for number, channel in enumerate(channels[:3])]
            await socket.send_json({"op": "subscribe", "subscriptions": wanted})
            while (told := await anext(message async for message in texts(socket)))["op"] != "status":
                pass
            assert "subscription 2: one address has at most 2" in told["message"]
            async with session.get(f"http://{host}/api/v1/stream?topics=r1/joints") as answer:
                assert (answer.status, (await answer.json())["code"]) == (400, "TOO_MUCH")
            await socket.send_json({"op": "unsubscribe", "subscriptionIds": [0]})
            for _ in range(500):
                async with session.get(f"http://{host}/api/v1/stream?topics=r1/joints") as answer:
                    if answer.status == 200:
                        break
                await anyio.sleep(0.01)
            assert answer.status == 200


async def texts(socket: aiohttp.ClientWebSocketResponse) -> AsyncIterator[dict[str, str]]:
    """The text messages that come."""
    async for message in socket:
        if message.type is aiohttp.WSMsgType.TEXT:
            yield message.json()


async def test_a_flood_of_messages_is_answered_to_the_last_one() -> None:
    async with door(messages_per_s=20) as url, kit.talking(url) as talk:
        for number in range(105):
            await talk.send({"op": "ping", "id": number})
        assert [(await talk.receive("result"))["id"] for _ in range(105)] == list(range(105))


async def test_a_client_that_is_slowed_down_is_told_at_once_when_the_gateway_goes() -> None:
    codes: list[int | None] = []

    async def read_to_the_end(talk: kit.Talk) -> None:
        codes.append(await talk.close_code())

    async with (
        aiohttp.ClientSession() as session,
        anyio.create_task_group() as tasks,
        door(messages_per_s=0.1) as url,
    ):
        talk = kit.Talk(await session.ws_connect(url))
        for number in range(20):
            await talk.send({"op": "ping", "id": number})
        await talk.receive("result")
        tasks.start_soon(read_to_the_end, talk)
    assert codes == [1001]


@asynccontextmanager
async def watched(
    handler: Callable[[web.Request], Awaitable[web.StreamResponse]],
    *,
    header_s: float = 30,
    idle_s: float = 30,
    limits: Limits = Limits(),  # noqa: B008 - it never changes
    tls: ssl.SSLContext | None = None,
) -> AsyncIterator[tuple[int, Refusals]]:
    """A bare application behind the listener; yields its port, and who was refused."""
    app = web.Application(middlewares=[bounded])
    app[REFUSALS] = Refusals()
    app[PEERS] = Peers(limits, app[REFUSALS])
    app.router.add_get("/", handler)
    runner = web.AppRunner(app, access_log=None, shutdown_timeout=0.1)
    await runner.setup()
    try:
        server = cast("web.Server", runner.server)
        async with accepting(app, server, "127.0.0.1", 0, tls, header_s=header_s, idle_s=idle_s) as port:
            yield port, app[REFUSALS]
            for _ in range(500):
                if app[PEERS].n_open == 0:
                    break
                await anyio.sleep(0.01)
            assert app[PEERS].n_open == 0
    finally:
        await runner.cleanup()


async def at_once(request: web.Request) -> web.StreamResponse:
    return web.Response(text="here")


async def test_a_connection_that_asks_nothing_is_closed() -> None:
    async with watched(at_once, header_s=0.05) as (port, refusals):
        async with await anyio.connect_tcp("127.0.0.1", port) as stream:
            assert await is_closed(stream)
        assert refusals.counts["idle"] == 1


async def test_a_header_that_never_ends_is_cut_off_although_bytes_keep_coming() -> None:
    async with watched(at_once, header_s=0.2) as (port, refusals):
        async with await anyio.connect_tcp("127.0.0.1", port) as stream, anyio.create_task_group() as tasks:
            tasks.start_soon(trickle, stream)
            assert await is_closed(stream)
            tasks.cancel_scope.cancel()
        assert refusals.counts["idle"] == 1


async def test_the_header_of_a_later_request_has_no_more_time() -> None:
    async with watched(at_once, header_s=0.2) as (port, refusals):
        async with await anyio.connect_tcp("127.0.0.1", port) as stream, anyio.create_task_group() as tasks:
            assert b"200" in await asked(stream)
            tasks.start_soon(trickle, stream)
            assert await is_closed(stream)
            tasks.cancel_scope.cancel()
        assert refusals.counts["idle"] == 1


async def trickle(stream: SocketStream) -> None:
    """Send a header byte by byte, for ever."""
    try:
        await stream.send(b"GET / HTTP/1.1\r\nHost: localhost\r\nX: ")
        while True:
            await stream.send(b"x")
            await anyio.sleep(0.01)
    except anyio.BrokenResourceError:
        return


async def test_a_connection_that_was_answered_may_be_silent_for_a_while_and_is_closed_then() -> None:
    async with watched(at_once, header_s=0.05, idle_s=0.3) as (port, refusals):
        async with await anyio.connect_tcp("127.0.0.1", port) as stream:
            for _ in range(5):
                assert b"200" in await asked(stream)
                await anyio.sleep(0.1)  # longer than a header may take, shorter than a silence
            assert await is_closed(stream)
        assert refusals.counts["idle"] == 0


async def test_an_answer_may_take_as_long_as_it_takes() -> None:
    async def slow(request: web.Request) -> web.StreamResponse:
        await asyncio.sleep(0.3)
        return web.Response(text="at last")

    async with (
        watched(slow, header_s=0.05, idle_s=0.05) as (port, _),
        await anyio.connect_tcp("127.0.0.1", port) as stream,
    ):
        assert b"200" in await asked(stream)


async def test_who_does_not_take_its_answer_is_cut_off() -> None:
    async def endless(request: web.Request) -> web.StreamResponse:
        return web.Response(body=bytes(64 << 20))

    async with watched(endless, idle_s=0.2) as (port, _), await anyio.connect_tcp("127.0.0.1", port) as stream:
        await stream.send(b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\n")
        await anyio.sleep(0.4)
        assert await n_received(stream) < 64 << 20


async def n_received(stream: SocketStream) -> int:
    """Read to the end; how many bytes came."""
    found = 0
    with suppress(anyio.EndOfStream, anyio.BrokenResourceError), anyio.fail_after(10):
        while True:
            found += len(await stream.receive())
    return found


@needs_openssl
async def test_a_tls_client_counts_before_its_handshake_and_has_only_so_long_for_it(tmp_path: Path) -> None:
    files = certificate(tmp_path)
    serving, asking = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH), ssl.create_default_context()
    serving.load_cert_chain(files.certificate, files.key)
    asking.load_verify_locations(files.certificate)
    limits = Limits(connections=1)
    async with (
        watched(at_once, header_s=0.3, limits=limits, tls=serving) as (port, refusals),
        await anyio.connect_tcp("127.0.0.1", port) as silent,
    ):
        async with await anyio.connect_tcp("127.0.0.1", port) as second:
            assert await is_closed(second)
        assert refusals.counts["connections"] == 1
        assert await is_closed(silent)
        async with aiohttp.ClientSession() as session:
            for _ in range(500):  # until the gateway has noticed
                try:
                    async with session.get(f"https://127.0.0.1:{port}/", ssl=asking) as answer:
                        assert await answer.text() == "here"
                    break
                except aiohttp.ClientConnectionError:
                    await anyio.sleep(0.01)
            else:
                pytest.fail("nobody is let in although nobody is there")


async def test_where_no_file_can_be_opened_the_listener_rests_and_goes_on() -> None:
    async with watched(at_once) as (port, _):
        waiting = [socket.socket() for _ in range(8)]
        soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
        first_free = os.dup(0)
        os.close(first_free)
        resource.setrlimit(resource.RLIMIT_NOFILE, (first_free + 3, hard))
        try:
            with structlog.testing.capture_logs() as logged:
                for client in waiting:
                    client.connect(("127.0.0.1", port))
                for _ in range(500):
                    if any(line["event"] == "connection.refused" for line in logged):
                        break
                    await anyio.sleep(0.01)
                else:
                    pytest.fail("nothing was said")
        finally:
            resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
        for client in waiting:
            client.setblocking(False)  # noqa: FBT003 - its signature
            async with await SocketStream.from_socket(client) as stream:
                assert b"200" in await asked(stream)


async def test_what_the_body_raises_comes_out_as_it_was() -> None:
    with pytest.raises(KeyError):
        async with watched(at_once):
            raise KeyError("mine")
