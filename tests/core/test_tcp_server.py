"""The controller calls the gateway: one peer is let in, at any time, and no call is lost or leaked."""

from __future__ import annotations

import errno
import gc
import os
import socket
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from types import SimpleNamespace
from typing import cast

import anyio
import anyio.lowlevel
import pytest

from gateway.app import connector, connector_of
from gateway.core import tcp_server
from gateway.core.settings import RobotSettings
from gateway.core.tcp_server import CALL_TIMEOUT_S, MOST_IN_A_TURN, MOST_NAMED, OTHERS, QUIET_S, RETRY_S, TcpServer
from gateway.core.transport import Connection, TcpClient
from gateway.core.udp import UdpClient
from gateway.errors import LinkClosed
from tests.core.fakes import received, run_jumping

CONTROLLER = "127.0.0.2"
STRANGER = "127.0.0.9"


def closed_port() -> int:
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return int(one.getsockname()[1])


def call(server: TcpServer, host: str = CONTROLLER, to: str = "127.0.0.1") -> socket.socket:
    """Call as a controller does: it is in the queue of the system when this returns."""
    one = socket.create_connection((to, server.port), timeout=5, source_address=(host, 0))
    one.settimeout(0)
    return one


async def heard(one: socket.socket) -> bytes:
    """What the gateway says on a call; nothing: it has hung up."""
    with anyio.fail_after(5):
        await anyio.wait_readable(one)
    return one.recv(100)


async def until(fact: Callable[[], bool]) -> None:
    """Let the loop run until something is so."""
    with anyio.fail_after(5):
        while not fact():
            await anyio.lowlevel.checkpoint()


def open_sockets() -> int:
    """How many sockets this process has."""
    found = 0
    for name in os.listdir("/proc/self/fd"):  # noqa: PTH208 - a path is read for each
        try:
            found += os.readlink(f"/proc/self/fd/{name}").startswith("socket:")  # noqa: PTH115
        except FileNotFoundError:  # that of the listing itself
            continue
    return found


@asynccontextmanager
async def listening(host: str = CONTROLLER, listen: str = "127.0.0.1") -> AsyncIterator[TcpServer]:
    """A server whose socket is open: one connect() has been given up."""
    server = TcpServer(listen, 0, host)
    try:
        with anyio.CancelScope() as scope:
            scope.cancel()
            await server.connect()
        yield server
    finally:
        await server.aclose()
        gc.collect()  # a socket that nobody closed is a warning here, and so an error


async def connected(server: TcpServer) -> Connection:
    with anyio.fail_after(5):
        return await server.connect()


async def read_once(server: TcpServer) -> bytes:
    connection = await connected(server)
    try:
        return await received(connection)
    finally:
        await connection.aclose()


async def test_the_controllers_call_is_a_connection_on_which_the_gateway_asks() -> None:
    async with listening() as server:
        with call(server) as controller:
            connection = await connected(server)
            await connection.send(b"ask")
            assert await heard(controller) == b"ask"
            controller.send(b"answer")
            assert await received(connection) == b"answer"
            assert not connection.datagrams
            raw = connection._stream._raw_socket  # type: ignore[attr-defined]
            assert raw.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY)
            assert raw.getsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE)
            await connection.aclose()
        assert (server.notes, server.rejects) == ([], {})


async def test_a_call_is_waited_for() -> None:
    async with listening() as server, anyio.create_task_group() as tasks:
        found: list[Connection] = []

        async def connect() -> None:
            found.append(await connected(server))

        tasks.start_soon(connect)
        await anyio.wait_all_tasks_blocked()
        assert not found
        with call(server):
            await anyio.wait_all_tasks_blocked()
            while not found:
                await anyio.lowlevel.checkpoint()
            await found[0].aclose()


async def test_a_stranger_is_refused_and_counted_while_the_controller_is_waited_for() -> None:
    async with listening() as server:
        strangers = [call(server, STRANGER) for _ in range(3)]
        other = call(server, "127.0.0.8")
        with call(server) as controller:
            connection = await connected(server)
            for one in (*strangers, other):
                assert await heard(one) == b""
                one.close()
            await connection.send(b"ask")
            assert await heard(controller) == b"ask"
            await connection.aclose()
        assert server.refused == {STRANGER: 3, "127.0.0.8": 1}
        assert server.rejects == {"foreign_peer": 4}
        assert server.notes == [
            f"calls from {STRANGER} were refused: only {CONTROLLER} may call (3 times)",
            f"calls from 127.0.0.8 were refused: only {CONTROLLER} may call (once)",
        ]


async def test_strangers_that_call_during_a_session_are_refused_at_once() -> None:
    async with listening() as server:
        with call(server) as controller:
            connection = await connected(server)
            before = open_sockets()
            for number in range(1, 4):
                with call(server, STRANGER) as stranger:
                    assert await heard(stranger) == b""
                    assert server.rejects == {"foreign_peer": number}
            assert open_sockets() == before
            controller.send(b"still here")
            assert await received(connection) == b"still here"
            await connection.aclose()


async def test_strangers_that_call_between_two_sessions_are_refused_at_once() -> None:
    async with listening() as server:
        with call(server):
            await (await connected(server)).aclose()
        with call(server, STRANGER) as stranger:
            assert await heard(stranger) == b""
        assert server.rejects == {"foreign_peer": 1}


async def test_more_strangers_than_are_kept_by_name_are_counted_together() -> None:
    async with listening() as server:
        for number in range(MOST_NAMED + 4):
            call(server, f"127.0.1.{number + 1}").close()
        call(server, "127.0.1.1").close()
        with call(server):
            await (await connected(server)).aclose()
        assert len(server.refused) == MOST_NAMED + 1
        assert (server.refused[OTHERS], server.refused["127.0.1.1"]) == (4, 2)
        assert server.rejects == {"foreign_peer": MOST_NAMED + 5}


async def test_of_several_calls_the_controllers_newest_is_taken() -> None:
    async with listening() as server:
        half_open = call(server)
        before = await connected(server)
        given_up = call(server)
        await until(lambda: server._held is not None)
        newest = call(server)
        assert await heard(given_up) == b""
        await before.aclose()
        after = await connected(server)
        await after.send(b"ask")
        assert await heard(newest) == b"ask"
        await after.aclose()
        for one in (half_open, given_up, newest):
            one.close()


def test_a_controller_that_calls_again_ends_the_silent_session() -> None:
    async def look() -> None:
        async with listening() as server:
            half_open = call(server)
            before = await server.connect()
            await anyio.sleep(60)
            start_s = anyio.current_time()
            newest = call(server)
            with pytest.raises(LinkClosed, match=r"^the controller has called again$"):
                await received(before)
            assert anyio.current_time() - start_s == pytest.approx(0, abs=0.01)
            await before.aclose()
            after = await server.connect()
            await after.send(b"ask")
            assert await heard(newest) == b"ask"
            await after.aclose()
            half_open.close()
            newest.close()

    run_jumping(look)


def test_a_session_that_waits_for_bytes_is_ended_too() -> None:
    async def look() -> None:
        async with listening() as server, anyio.create_task_group() as tasks:
            half_open = call(server)
            before = await server.connect()
            start_s = anyio.current_time()
            ended: list[float] = []

            async def receive() -> None:
                with pytest.raises(LinkClosed, match="has called again"):
                    await received(before)
                ended.append(anyio.current_time())

            tasks.start_soon(receive)
            await anyio.sleep(QUIET_S / 2)
            newest = call(server)
            await anyio.sleep(QUIET_S)
            assert ended == [pytest.approx(start_s + QUIET_S, abs=0.01)]
            await before.aclose()
            half_open.close()
            newest.close()

    run_jumping(look)


def test_a_controller_that_calls_without_end_does_not_end_the_session_that_works() -> None:
    async def look() -> None:
        async with listening() as server:
            speaking = call(server)
            connection = await server.connect()
            before = open_sockets()
            calls: list[socket.socket] = []
            for number in range(500):
                calls.append(call(server))
                if number % 50 == 0:  # each 0.5 s
                    speaking.send(b"x")
                    assert await received(connection) == b"x"
                await anyio.sleep(0.01)
            assert open_sockets() == before + len(calls) + 1  # the newest is held
            assert [one.recv(1) for one in calls[:-1]] == [b""] * (len(calls) - 1)
            with pytest.raises(BlockingIOError):
                calls[-1].recv(1)
            await connection.aclose()
            for one in (speaking, *calls):
                one.close()
        assert server.rejects == {}

    run_jumping(look)


def test_each_session_has_its_time_however_often_the_controller_calls() -> None:
    async def look() -> None:
        async with listening() as server, anyio.create_task_group() as tasks:
            calls: list[socket.socket] = []

            async def call_on_and_on() -> None:
                while True:
                    calls.append(call(server))
                    await anyio.sleep(0.01)

            tasks.start_soon(call_on_and_on)
            start_s = anyio.current_time()
            for _ in range(5):
                connection = await server.connect()
                with pytest.raises(LinkClosed, match=r"called again|closed the connection"):
                    await received(connection)
                await connection.aclose()
            assert anyio.current_time() - start_s == pytest.approx(5 * QUIET_S, abs=0.1)
            tasks.cancel_scope.cancel()
        for one in calls:
            one.close()

    run_jumping(look)


@pytest.mark.parametrize("resets", [False, True])
def test_a_second_call_that_was_hung_up_ends_no_session(resets: bool) -> None:  # noqa: FBT001
    async def look() -> None:
        async with listening() as server:
            with call(server) as controller:
                connection = await server.connect()
                second = call(server)
                await anyio.sleep(0.1)
                if resets:
                    second.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\1\0\0\0\0\0\0\0")
                second.close()
                with anyio.move_on_after(60):
                    await received(connection)
                    pytest.fail("nothing came")
                assert server._held is None
                controller.send(b"still here")
                assert await received(connection) == b"still here"
                await connection.aclose()

    run_jumping(look)


async def test_a_receive_that_is_cancelled_while_another_call_waits_is_cancelled() -> None:
    async with listening() as server:
        with call(server) as controller, call(server):
            connection = await connected(server)
            with call(server):
                await until(lambda: server._held is not None)
                with anyio.move_on_after(0.01) as scope:
                    await received(connection)
                assert scope.cancelled_caught
                controller.close()
            await connection.aclose()


async def test_a_call_between_two_sessions_is_not_refused() -> None:
    async with listening() as server:
        for _ in range(3):
            with call(server) as controller:
                connection = await connected(server)
                await connection.send(b"ask")
                assert await heard(controller) == b"ask"
                await connection.aclose()


async def test_a_controller_that_hung_up_before_it_was_taken_ends_one_session_only() -> None:
    async with listening() as server:
        gone = call(server)
        gone.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\1\0\0\0\0\0\0\0")  # closing resets
        gone.close()
        with pytest.raises(LinkClosed):
            await read_once(server)
        with call(server):
            await (await connected(server)).aclose()


def test_nobody_calls() -> None:
    async def look() -> None:
        server = TcpServer("127.0.0.1", 0, "192.0.2.160")
        start_s = anyio.current_time()
        with pytest.raises(LinkClosed) as caught:
            await server.connect()
        assert anyio.current_time() - start_s == pytest.approx(CALL_TIMEOUT_S)
        told = f"no call from 192.0.2.160 on 127.0.0.1:{server.port} within 10 s: is it on"
        assert caught.value.reason.startswith(told)
        assert "Only this machine can call 127.0.0.1: set listen" in caught.value.reason
        assert caught.value.refused
        assert server.peer == f"192.0.2.160 (calls 127.0.0.1:{server.port})"
        await server.aclose()

    run_jumping(look)


def test_where_the_controller_can_reach_the_address_nothing_is_said_of_it() -> None:
    async def look() -> None:
        for listen, host in (("0.0.0.0", "192.0.2.160"), ("localhost", CONTROLLER)):  # noqa: S104 - for a moment
            server = TcpServer(listen, 0, host)
            with pytest.raises(LinkClosed) as caught:
                await server.connect()
            assert "set listen" not in caught.value.reason
            await server.aclose()

    run_jumping(look)


def test_a_stranger_does_not_prolong_the_wait() -> None:
    async def look() -> None:
        async with listening() as server:
            start_s = anyio.current_time()
            with call(server, STRANGER), pytest.raises(LinkClosed, match="no call from"):
                await server.connect()
            assert anyio.current_time() - start_s == pytest.approx(CALL_TIMEOUT_S)
            assert server.rejects == {"foreign_peer": 1}

    run_jumping(look)


async def test_a_cancelled_connect_leaves_the_call_for_the_next() -> None:
    async with listening() as server:
        with call(server) as controller:
            with anyio.CancelScope() as scope:
                scope.cancel()
                await server.connect()
            assert scope.cancelled_caught
            connection = await connected(server)
            await connection.send(b"ask")
            assert await heard(controller) == b"ask"
            await connection.aclose()


@pytest.mark.parametrize("turns", range(8))
async def test_a_connect_that_is_cancelled_at_any_moment_gives_the_call_or_leaves_it(turns: int) -> None:
    async with listening() as server:
        found: list[Connection] = []

        async def connect() -> None:
            found.append(await server.connect())

        async with anyio.create_task_group() as tasks:
            tasks.start_soon(connect)
            await anyio.wait_all_tasks_blocked()
            controller = call(server)
            for _ in range(turns):
                await anyio.lowlevel.checkpoint()
            tasks.cancel_scope.cancel()
        connection = found[0] if found else await connected(server)
        await connection.send(b"ask")
        assert await heard(controller) == b"ask"
        controller.close()
        await connection.aclose()


async def test_a_port_in_use_is_named_with_what_to_do() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        server = TcpServer("127.0.0.1", port, CONTROLLER)
        with pytest.raises(LinkClosed, match=rf"cannot listen on 127\.0\.0\.1:{port}: the port is in use") as caught:
            await server.connect()
        assert not caught.value.refused
    with anyio.CancelScope() as scope:  # it is free again: the next connect has it
        scope.cancel()
        await server.connect()
    call(server).close()
    await server.aclose()


async def test_two_robots_need_two_ports() -> None:
    async with listening() as first:
        second = TcpServer("127.0.0.1", first.port, "127.0.0.3")
        with pytest.raises(LinkClosed, match="each robot needs its own"):
            await second.connect()
        await second.aclose()


@pytest.mark.parametrize(
    ("listen", "told"),
    [
        ("192.0.2.1", "this machine has no such address: set listen"),
        ("robot", '"robot", which is no IP address'),
        ("1", "is no IP address"),
        ("", "is no IP address"),
    ],
)
async def test_an_address_of_no_use_is_named_with_what_to_do(listen: str, told: str) -> None:
    with pytest.raises(LinkClosed, match=told):
        await TcpServer(listen, 0, CONTROLLER).connect()


@pytest.mark.parametrize(
    ("number", "told"), [(errno.EACCES, "below 1024 need privileges"), (errno.ENETUNREACH, "network unreachable")]
)
def test_what_cannot_be_bound_is_told_in_words(number: int, told: str) -> None:
    assert told in tcp_server._advice(OSError(number, "as the system says it"))


async def test_a_closed_server_refuses_calls_and_opens_again_on_the_same_port() -> None:
    async with listening() as server:
        waiting = call(server)
        await server.aclose()
        with pytest.raises(ConnectionResetError):
            await heard(waiting)
        waiting.close()
        with pytest.raises(ConnectionRefusedError):
            call(server)
        await server.aclose()
        with anyio.CancelScope() as scope:
            scope.cancel()
            await server.connect()
        with call(server):
            await (await connected(server)).aclose()


async def test_closing_ends_a_connect_that_waits() -> None:
    async with listening() as server, anyio.create_task_group() as tasks:

        async def connect() -> None:
            with pytest.raises(LinkClosed, match="no longer listening"):
                await server.connect()

        tasks.start_soon(connect)
        await anyio.wait_all_tasks_blocked()
        await server.aclose()


class Names:
    """A name service whose answers can be set; an exception is raised."""

    def __init__(self, answer: str | Exception) -> None:
        self.answer = answer
        self.asked = 0

    async def getaddrinfo(self, host: str, _port: object, **_: object) -> list[tuple[object, ...]]:
        assert host == "robot.example"
        self.asked += 1
        await anyio.lowlevel.checkpoint()
        if isinstance(self.answer, Exception):
            raise self.answer
        return [(socket.AF_INET, socket.SOCK_STREAM, 6, "", (self.answer, 0))]


def named(monkeypatch: pytest.MonkeyPatch, answer: str | Exception) -> Names:
    names = Names(answer)
    monkeypatch.setattr(anyio, "getaddrinfo", names.getaddrinfo)
    return names


async def test_a_name_is_looked_up_once_while_its_controller_calls(monkeypatch: pytest.MonkeyPatch) -> None:
    names = named(monkeypatch, CONTROLLER)
    server = TcpServer("127.0.0.1", closed_port(), "robot.example")
    async with anyio.create_task_group() as tasks:
        for _ in range(3):
            tasks.start_soon(_call_when_open, server)
            await (await connected(server)).aclose()
    assert names.asked == 1
    await server.aclose()


async def _call_when_open(server: TcpServer) -> None:
    while server._listener is None:
        await anyio.lowlevel.checkpoint()
    call(server).close()


def test_a_name_is_looked_up_again_when_nobody_called(monkeypatch: pytest.MonkeyPatch) -> None:
    names = named(monkeypatch, "192.0.2.7")

    async def look() -> None:
        server = TcpServer("127.0.0.1", 0, "robot.example")
        with pytest.raises(LinkClosed, match=r"no call from robot\.example"):
            await server.connect()
        names.answer = CONTROLLER
        with call(server):
            await (await server.connect()).aclose()
        await server.aclose()

    run_jumping(look)


async def test_a_controller_whose_name_has_moved_is_known_by_its_next_call(monkeypatch: pytest.MonkeyPatch) -> None:
    names = named(monkeypatch, "127.0.0.3")
    server = TcpServer("127.0.0.1", 0, "robot.example")
    async with anyio.create_task_group() as tasks:
        tasks.start_soon(_move_and_call, server, names)
        await (await connected(server)).aclose()
    assert server.rejects == {"foreign_peer": 1}
    await server.aclose()


async def _move_and_call(server: TcpServer, names: Names) -> None:
    while not server._allowed:
        await anyio.lowlevel.checkpoint()
    names.answer = CONTROLLER
    with call(server) as first:
        assert await heard(first) == b""
    call(server).close()


async def test_a_name_that_cannot_be_resolved_is_told_and_tried_again(monkeypatch: pytest.MonkeyPatch) -> None:
    names = named(monkeypatch, socket.gaierror(socket.EAI_NONAME, "Name or service not known"))
    server = TcpServer("127.0.0.1", 0, "robot.example")
    told = r"^robot\.example, which alone may call 127\.0\.0\.1:\d+: the name cannot be resolved \(Name or"
    with pytest.raises(LinkClosed, match=told):
        await server.connect()
    names.answer = UnicodeError("label too long")
    with pytest.raises(LinkClosed, match="the name cannot be resolved"):
        await server.connect()
    with call(server):  # it listened all the time
        names.answer = CONTROLLER
        await (await connected(server)).aclose()
    await server.aclose()


async def test_what_was_resolved_stays_while_the_name_service_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    names = named(monkeypatch, CONTROLLER)
    server = TcpServer("127.0.0.1", 0, "robot.example")
    async with anyio.create_task_group() as tasks:
        tasks.start_soon(_call_when_open, server)
        await (await connected(server)).aclose()
    names.answer = socket.gaierror(socket.EAI_AGAIN, "Temporary failure in name resolution")
    call(server, STRANGER).close()
    with call(server):
        await (await connected(server)).aclose()
    await server.aclose()


def test_a_name_service_that_does_not_answer_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    async def silent(*_: object, **__: object) -> None:
        await anyio.sleep_forever()

    monkeypatch.setattr(anyio, "getaddrinfo", silent)

    async def look() -> None:
        server = TcpServer("127.0.0.1", 0, "robot.example")
        with pytest.raises(LinkClosed, match="the name is not resolved within 3 s"):
            await server.connect()
        await server.aclose()

    run_jumping(look)


@pytest.mark.parametrize("host", [CONTROLLER, f"::ffff:{CONTROLLER}"])
async def test_an_address_is_the_same_in_its_ipv6_form(host: str) -> None:
    if not socket.has_dualstack_ipv6():
        pytest.skip("this machine has no IPv6")
    async with listening(host, "::") as server:
        with call(server):
            await (await connected(server)).aclose()
        assert server.rejects == {}


def test_addresses_are_compared_without_their_zone() -> None:
    assert tcp_server._canonical("fe80::1%eth0") == tcp_server._canonical("FE80:0::1")


def failing(monkeypatch: pytest.MonkeyPatch, *failures: OSError) -> list[OSError]:
    """Let the next calls be taken with these failures."""
    left = list(failures)
    accept = socket.socket.accept

    def broken(listener: socket.socket) -> object:
        if left:
            raise left.pop(0)
        return accept(listener)

    monkeypatch.setattr(socket.socket, "accept", broken)
    return left


async def test_a_socket_that_cannot_take_calls_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    async with listening() as server:
        aborted = ConnectionAbortedError(errno.ECONNABORTED, "gone")
        failing(monkeypatch, aborted, OSError(errno.EMFILE, "full"))
        with call(server):
            with pytest.raises(LinkClosed, match=r"cannot take calls on .*: Too many open files"):
                await connected(server)
            await (await connected(server)).aclose()


def test_calls_that_could_not_be_taken_during_a_session_are_taken_a_little_later(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    async def look() -> None:
        async with listening() as server:
            with call(server):
                connection = await server.connect()
                left = failing(monkeypatch, OSError(errno.EMFILE, "full"), OSError(errno.EMFILE, "full"))
                with call(server, STRANGER) as stranger:
                    await anyio.sleep(RETRY_S / 2)
                    assert len(left) == 1  # it is not tried without end
                    await anyio.sleep(RETRY_S)
                    assert (left, server.rejects) == ([], {})
                    await anyio.sleep(RETRY_S)
                    assert server.rejects == {"foreign_peer": 1}
                    assert await heard(stranger) == b""
                failing(monkeypatch, OSError(errno.EMFILE, "full"))
                call(server, STRANGER).close()
                await anyio.sleep(RETRY_S / 2)
                await server.aclose()  # ends the retry, too
                await anyio.sleep(2 * RETRY_S)
                await connection.aclose()

    run_jumping(look)


async def test_a_flood_of_strangers_leaves_the_controller_its_turn() -> None:
    async with listening() as server:
        strangers = [call(server, STRANGER) for _ in range(MOST_IN_A_TURN)]
        with call(server):
            await (await connected(server)).aclose()
        for one in strangers:
            one.close()
        assert server.rejects == {"foreign_peer": MOST_IN_A_TURN}


async def test_no_more_calls_are_taken_in_a_turn_than_the_loop_can_spare() -> None:
    async with listening() as server:
        listener = cast("socket.socket", server._listener)
        strangers = [call(server, STRANGER) for _ in range(MOST_IN_A_TURN + 3)]
        server._take_calls(listener)
        assert server.rejects == {"foreign_peer": MOST_IN_A_TURN}
        await until(lambda: server.rejects == {"foreign_peer": MOST_IN_A_TURN + 3})
        for one in strangers:
            one.close()


async def test_a_controller_that_reboots_in_a_flood_of_strangers_is_taken_promptly() -> None:
    before = open_sockets()
    async with listening() as server:
        half_open = call(server)
        connection = await connected(server)
        half_open.send(b"the last before the reboot")
        assert await received(connection) == b"the last before the reboot"

        def flood() -> list[socket.socket]:
            return [call(server, f"127.0.2.{number % 250 + 1}") for number in range(300)]

        start_s = anyio.current_time()
        strangers = await anyio.to_thread.run_sync(flood)
        rebooted = await anyio.to_thread.run_sync(call, server)
        with pytest.raises(LinkClosed, match="has called again"), anyio.fail_after(5):
            await received(connection)
        await connection.aclose()
        again = await connected(server)
        await again.send(b"ask")
        assert await heard(rebooted) == b"ask"
        assert anyio.current_time() - start_s < QUIET_S + 2
        assert server.rejects == {"foreign_peer": 300}
        for one in strangers:
            assert await heard(one) == b""
        await again.aclose()
        for one in (half_open, rebooted, *strangers):
            one.close()
    assert open_sockets() == before


async def test_closing_ends_everything_but_the_connection_that_was_given_away() -> None:
    before = open_sockets()
    server = TcpServer("127.0.0.1", closed_port(), CONTROLLER)
    with anyio.CancelScope() as scope:
        scope.cancel()
        await server.connect()
    controller = call(server)
    connection = await connected(server)
    held = call(server)
    await until(lambda: server._held is not None)
    await server.aclose()
    assert await heard(held) == b""
    with pytest.raises(ConnectionRefusedError):
        call(server)
    await connection.send(b"bye")
    assert await heard(controller) == b"bye"
    await connection.aclose()
    controller.close()
    held.close()
    await anyio.sleep(0.01)
    assert open_sockets() == before


async def test_a_cancelled_scope_closes_all_the_same() -> None:
    before = open_sockets()
    with anyio.CancelScope() as scope:
        server = TcpServer("127.0.0.1", 0, CONTROLLER)
        try:
            with anyio.move_on_after(0.01):
                await server.connect()
            first, second = call(server), call(server)
            await (await connected(server)).aclose()
            with call(server):
                await until(lambda: server._held is not None)
                scope.cancel()
                await server.connect()
        finally:
            first.close()
            second.close()
            await server.aclose()
    assert scope.cancelled_caught
    await anyio.sleep(0.01)
    assert open_sockets() == before


def test_all_of_it_works_on_the_loop_of_the_daemon() -> None:
    async def look() -> None:
        await test_a_stranger_is_refused_and_counted_while_the_controller_is_waited_for()
        await test_strangers_that_call_during_a_session_are_refused_at_once()
        await test_of_several_calls_the_controllers_newest_is_taken()
        await test_a_controller_that_reboots_in_a_flood_of_strangers_is_taken_promptly()
        await test_a_receive_that_is_cancelled_while_another_call_waits_is_cancelled()
        await test_closing_ends_everything_but_the_connection_that_was_given_away()
        await test_a_cancelled_scope_closes_all_the_same()
        await test_a_cancelled_connect_leaves_the_call_for_the_next()
        await test_closing_ends_a_connect_that_waits()

    anyio.run(look, backend_options={"use_uvloop": True})


@pytest.mark.parametrize("client", [TcpClient(CONTROLLER, 1), UdpClient(CONTROLLER, 1)])
async def test_a_connector_that_calls_holds_nothing(client: TcpClient | UdpClient) -> None:
    await client.aclose()
    assert (client.notes, client.rejects) == ((), {})


def robot(transport: str, **options: str) -> RobotSettings:
    protocol = SimpleNamespace(transport=lambda _options: transport)
    settings = SimpleNamespace(protocol=protocol, options=SimpleNamespace(**options), host=CONTROLLER, port=4320)
    return cast("RobotSettings", settings)


def test_the_robots_options_say_where_its_calls_are_taken() -> None:
    assert connector_of(robot("tcp_server", listen="10.0.0.1")).peer == f"{CONTROLLER} (calls 10.0.0.1:4320)"
    assert connector_of(robot("tcp_server")).peer == f"{CONTROLLER} (calls 127.0.0.1:4320)"
    assert connector_of(robot("tcp")) == TcpClient(CONTROLLER, 4320)
    assert connector_of(robot("udp")) == UdpClient(CONTROLLER, 4320)


def test_a_controller_that_calls_is_not_called() -> None:
    with pytest.raises(ValueError, match="cannot be called"):
        connector("tcp_server", CONTROLLER, 4320)
