"""Virtual controllers on real sockets: they answer, die, come back, and say what is in the way."""

from __future__ import annotations

import asyncio
import socket

import msgspec
import pytest

from gateway.sim.server import SimulatorError, addresses, serve
from gateway.sim.simulator import Port, Simulator, VirtualRobot


class Echo:
    """Answers each byte with a segment of three; fails on `!`."""

    period_s: float | None = None

    def __init__(self, robot: VirtualRobot, _options: msgspec.Struct) -> None:
        self.robot = robot

    def received(self, data: bytes, now_s: float) -> list[bytes]:
        """Answer."""
        if b"!" in data:
            raise RuntimeError("a fault of the session")
        for _ in data:
            self.robot.count(data, now_s, dict)
        return [bytes([byte]) * 3 for byte in data]

    def due(self, _now_s: float) -> list[bytes]:
        """Push nothing."""
        return []


class Pusher(Echo):
    """Pushes without being asked."""

    period_s: float | None = 0.001

    def due(self, _now_s: float) -> list[bytes]:
        """Push a word."""
        return [b"tick"]


ECHO = Simulator(ports=(Port(protocol="p", port=7, session=Echo), Port(protocol=None, port=6, session=Echo)))
PUSHER = Simulator(ports=(Port(protocol="p", port=7, session=Pusher),))


async def ask(host: str, port: int, data: bytes, size: int) -> bytes:
    reader, writer = await asyncio.open_connection(host, port)
    try:
        writer.write(data)
        return await reader.readexactly(size)
    finally:
        writer.close()
        await writer.wait_closed()


async def test_a_client_is_answered() -> None:
    async with serve(ECHO, host="127.0.0.1", port=0) as (controller,):
        assert await ask(controller.host, controller.port, b"ab", 6) == b"aaabbb"
        assert controller.robot.frames == 2
        assert controller.robot.connections == 1


async def test_every_port_answers() -> None:
    async with serve(ECHO, host="127.0.0.1", port=0) as (controller,):
        assert [protocol for protocol, _ in controller.ports] == ["p", None]
        for _, port in controller.ports:
            assert await ask(controller.host, port, b"a", 3) == b"aaa"
        assert controller.robot.connections == 1


async def test_a_pushing_session_is_called_at_its_period() -> None:
    async with serve(PUSHER, host="127.0.0.1", port=0) as (controller,):
        assert await ask(controller.host, controller.port, b"", 40) == b"tick" * 10


async def test_a_controller_dies_and_comes_back_on_the_same_port() -> None:
    async with serve(ECHO, host="127.0.0.1", port=0) as (controller,):
        reader, writer = await asyncio.open_connection(controller.host, controller.port)
        port = controller.port
        await controller.stop()
        with pytest.raises((ConnectionError, asyncio.IncompleteReadError)):
            await reader.readexactly(1)
        writer.close()
        with pytest.raises(ConnectionRefusedError):
            await asyncio.open_connection(controller.host, port)
        await controller.start()
        assert await ask(controller.host, port, b"a", 3) == b"aaa"


async def test_a_failing_session_costs_its_own_client_only() -> None:
    failures: list[str] = []
    asyncio.get_running_loop().set_exception_handler(lambda _, context: failures.append(context["message"]))
    async with serve(ECHO, host="127.0.0.1", port=0) as (controller,):
        with pytest.raises((ConnectionError, asyncio.IncompleteReadError)):
            await ask(controller.host, controller.port, b"!", 3)
        assert await ask(controller.host, controller.port, b"a", 3) == b"aaa"
    assert failures == ["a virtual controller's session failed"]


async def test_chaos_strikes_the_state_port_only() -> None:
    async with serve(ECHO, host="127.0.0.1", port=0, chaos="double=1") as (controller,):
        (_, state), (_, other) = controller.ports
        assert await ask(controller.host, state, b"a", 6) == b"aaaaaa"
        assert await ask(controller.host, other, b"ab", 6) == b"aaabbb"
        assert controller.robot.faults == {"double": 1}


async def test_a_cut_closes_the_connection() -> None:
    async with serve(ECHO, host="127.0.0.1", port=0, chaos="cut=0.01") as (controller,):
        with pytest.raises((ConnectionError, asyncio.IncompleteReadError)):
            await ask(controller.host, controller.port, b"", 1)
        assert controller.robot.faults == {"cut": 1}


async def test_a_taken_port_is_named_with_what_to_do() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(SimulatorError, match=rf"^127.0.0.1:{port}: the port is taken: stop what") as caught:
            async with serve(PUSHER, host="127.0.0.1", port=port):
                pass
        assert (caught.value.host, caught.value.port) == ("127.0.0.1", port)


async def test_a_taken_port_without_state_is_done_without() -> None:
    host = "127.0.0.231"  # on an address that nothing else uses the next port is free
    with socket.create_server((host, 0)) as taken:
        port = taken.getsockname()[1]
        async with serve(ECHO, host=host, port=port + 1) as (controller,):
            assert controller.ports == (("p", port + 1),)
            assert [problem.port for problem in controller.missing] == [port]


async def test_an_address_that_is_not_there_is_named() -> None:
    with pytest.raises(SimulatorError, match="no such address"):
        async with serve(ECHO, host="192.0.2.1", port=0):
            pass


def test_controllers_stand_on_consecutive_addresses() -> None:
    assert addresses("127.0.0.254", 3) == ["127.0.0.254", "127.0.0.255", "127.0.1.0"]


@pytest.mark.parametrize(
    ("host", "count", "message"),
    [("robot", 1, "no IP address"), ("127.0.0.1", 0, "1 or more"), ("255.255.255.255", 2, "no 2 addresses")],
)
def test_useless_addresses_are_refused(host: str, count: int, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        addresses(host, count)


async def flood(writer: asyncio.StreamWriter) -> None:
    while True:
        writer.write(b"a" * 1_000_000)
        await writer.drain()


async def test_a_client_that_asks_without_end_and_never_reads_is_not_read_from_for_ever() -> None:
    async with serve(ECHO, host="127.0.0.1", port=0) as (controller,):
        _, writer = await asyncio.open_connection(controller.host, controller.port)
        with pytest.raises(TimeoutError):
            await asyncio.wait_for(flood(writer), 1.0)
        (connection,) = controller.connections
        assert len(connection._owed) <= 64 + 2048
        writer.transport.abort()
        assert await ask(controller.host, controller.port, b"a", 3) == b"aaa"
