from __future__ import annotations

import socket

import anyio
import pytest

from gateway.core.transport import TcpClient
from gateway.core.udp import UdpClient
from gateway.errors import LinkClosed
from tests.core.fakes import received


def closed_port(kind: socket.SocketKind) -> int:
    with socket.socket(socket.AF_INET, kind) as one:
        one.bind(("127.0.0.1", 0))
        return int(one.getsockname()[1])


@pytest.fixture
def controller() -> socket.socket:
    found = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    found.bind(("127.0.0.1", 0))
    found.settimeout(5)
    return found


async def test_each_receive_is_one_whole_datagram(controller: socket.socket) -> None:
    with controller:
        connection = await UdpClient(*controller.getsockname()).connect()
        await connection.send(b"hello")
        data, gateway = controller.recvfrom(100)
        assert data == b"hello"
        for answer in (b"one", b"two", b"x" * 9000):
            controller.sendto(answer, gateway)
        assert [await received(connection) for _ in range(3)] == [b"one", b"two", b"x" * 9000]
        assert connection.datagrams
        await connection.aclose()


async def test_datagrams_of_others_never_arrive(controller: socket.socket) -> None:
    with controller, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        connection = await UdpClient(*controller.getsockname()).connect()
        await connection.send(b"hello")
        _, gateway = controller.recvfrom(100)
        other.sendto(b"wrong", gateway)
        controller.sendto(b"right", gateway)
        assert await received(connection) == b"right"
        with anyio.move_on_after(0.05):
            pytest.fail(f"received {await received(connection)!r}")
        await connection.aclose()


async def test_a_closed_port_is_told_in_words() -> None:
    connection = await UdpClient("127.0.0.1", closed_port(socket.SOCK_DGRAM)).connect()
    await connection.send(b"hello")
    with anyio.fail_after(2), pytest.raises(LinkClosed, match="nothing listens on that port") as caught:
        await received(connection)
    assert caught.value.refused
    with pytest.raises(LinkClosed):
        await connection.send(b"again")
    await connection.aclose()


async def test_tcp_says_too_that_it_was_refused() -> None:
    with pytest.raises(LinkClosed, match="nothing listens on that port") as caught:
        await TcpClient("127.0.0.1", closed_port(socket.SOCK_STREAM)).connect()
    assert caught.value.refused


async def test_a_name_that_does_not_exist_is_no_refusal() -> None:
    with pytest.raises(LinkClosed, match="cannot be resolved") as caught:
        await UdpClient("no-such-host.invalid", 9).connect()
    assert not caught.value.refused


async def test_a_closed_connection_gives_nothing_more(controller: socket.socket) -> None:
    with controller:
        connection = await UdpClient(*controller.getsockname()).connect()
        await connection.aclose()
        with pytest.raises(LinkClosed):
            await received(connection)


def test_the_peer_says_that_it_is_udp() -> None:
    assert UdpClient("192.0.2.1", 20006).peer == "192.0.2.1:20006/udp"
    assert UdpClient("2001:db8::1", 20006).peer == "[2001:db8::1]:20006/udp"
