from __future__ import annotations

import socket
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import anyio
import anyio.abc
import anyio.lowlevel
import pytest

from gateway.core.transport import Connection, TcpClient
from gateway.errors import LinkClosed
from tests.core.fakes import received


@asynccontextmanager
async def connected() -> AsyncIterator[tuple[Connection, anyio.abc.SocketStream]]:
    """A connection, and the controller's end of it."""
    ends: list[anyio.abc.SocketStream] = []
    there = anyio.Event()

    async def take(stream: anyio.abc.SocketStream) -> None:
        ends.append(stream)
        there.set()
        await anyio.sleep_forever()

    listener = await anyio.create_tcp_listener(local_host="127.0.0.1", local_port=0)
    port = listener.extra(anyio.abc.SocketAttribute.local_port)  # noqa: S610 - not that `extra`
    async with listener, anyio.create_task_group() as tasks:
        tasks.start_soon(listener.serve, take)
        connection = await TcpClient("127.0.0.1", port).connect()
        await there.wait()
        yield connection, ends[0]
        await connection.aclose()
        await ends[0].aclose()
        tasks.cancel_scope.cancel()


async def test_bytes_go_both_ways() -> None:
    async with connected() as (connection, controller):
        await controller.send(b"frame")
        assert await received(connection) == b"frame"
        await connection.send(b"question")
        assert await controller.receive() == b"question"


async def test_what_comes_while_nobody_waits_is_kept() -> None:
    async with connected() as (connection, controller):
        for part in (b"one", b"two", b"three"):
            await controller.send(part)
        got = b""
        while len(got) < len(b"onetwothree"):
            got += await received(connection)
        assert got == b"onetwothree"


async def test_a_receive_that_is_given_up_loses_nothing() -> None:
    async with connected() as (connection, controller):
        with anyio.move_on_after(0.01) as scope:
            await received(connection)
        assert scope.cancelled_caught
        await controller.send(b"late")
        assert await received(connection) == b"late"


@pytest.mark.parametrize("loop", ["asyncio", "uvloop"])
def test_nothing_is_handed_to_a_reader_that_was_given_up_and_nothing_is_lost(loop: str) -> None:
    async def story() -> None:
        taken: list[tuple[bytes, bool]] = []
        async with connected() as (connection, controller), anyio.create_task_group() as tasks:
            scope = anyio.CancelScope()

            async def read() -> None:
                with scope:
                    await connection.deliver(lambda data: taken.append((data, scope.cancel_called)))

            tasks.start_soon(read)
            await anyio.lowlevel.checkpoint()
            await controller.send(b"early")
            while not taken:
                await anyio.lowlevel.checkpoint()
            await controller.send(b"late")
            scope.cancel()
            await anyio.wait_all_tasks_blocked()
            got = b"".join(data for data, _ in taken)
            assert not any(given_up for _, given_up in taken)
            assert (got if got.endswith(b"late") else got + await received(connection)) == b"earlylate"

    anyio.run(story, backend_options={"use_uvloop": loop == "uvloop"})


async def test_a_failure_that_came_with_the_giving_up_is_raised_before_anything_more_is_handed_on() -> None:
    async with connected() as (connection, controller), anyio.create_task_group() as tasks:
        scope, failed = anyio.CancelScope(), anyio.Event()

        def fail(data: bytes) -> None:
            failed.set()
            scope.cancel()  # at the same moment the reader is given up
            raise ZeroDivisionError(data)

        async def read() -> None:
            with scope:
                await connection.deliver(fail)

        tasks.start_soon(read)
        await anyio.lowlevel.checkpoint()
        await controller.send(b"bad")
        with anyio.fail_after(5):
            await failed.wait()
        await controller.send(b"more")
        taken: list[bytes] = []
        with pytest.raises(ZeroDivisionError):
            await connection.deliver(taken.append)
        assert taken == []
        assert await received(connection) == b"more"


async def test_the_last_bytes_come_before_the_end() -> None:
    async with connected() as (connection, controller):
        await controller.send(b"last")
        await controller.aclose()
        assert await received(connection) == b"last"
        for _ in range(2):
            with pytest.raises(LinkClosed, match="the controller closed the connection"):
                await received(connection)


async def test_a_reset_says_so_to_who_reads_and_to_who_sends() -> None:
    async with connected() as (connection, controller):
        raw = controller.extra(anyio.abc.SocketAttribute.raw_socket)  # noqa: S610 - not that `extra`
        raw.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\1\0\0\0\0\0\0\0")
        await controller.aclose()
        with pytest.raises(LinkClosed, match="connection reset by the controller"):
            await received(connection)
        with pytest.raises(LinkClosed):
            await connection.send(b"question")


async def test_a_reader_that_is_slow_slows_the_controller_down_and_loses_nothing() -> None:
    size = 1 << 24
    async with connected() as (connection, controller), anyio.create_task_group() as tasks:
        tasks.start_soon(controller.send, bytes(size))
        with anyio.move_on_after(0.2):
            await anyio.sleep_forever()
        n_bytes = 0
        while n_bytes < size:
            data = await received(connection)
            assert len(data) < size // 2
            n_bytes += len(data)
    assert n_bytes == size


async def test_who_sends_to_a_controller_that_does_not_read_waits_and_may_give_up() -> None:
    async with connected() as (connection, _):
        with anyio.move_on_after(0.2) as scope:
            while True:
                await connection.send(bytes(1 << 20))
        assert scope.cancelled_caught


async def test_a_connection_can_be_closed_twice_and_tells_no_more() -> None:
    async with connected() as (connection, _):
        await connection.aclose()
        await connection.aclose()
        with pytest.raises(LinkClosed):
            await received(connection)
