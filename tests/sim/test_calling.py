"""Virtual controllers that call a gateway: from their own address, again and again, dying and coming back."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Sequence

import anyio
import msgspec
import pytest

from gateway.cli.simulate import _announce
from gateway.core.tcp_server import TcpServer
from gateway.core.transport import Connection
from gateway.sim import calling
from gateway.sim.server import SimulatorError, serve
from gateway.sim.simulator import Port, Simulator, VirtualRobot
from tests.core.fakes import received


class Options(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Whom to call."""

    port: int = 0
    host: str = "127.0.0.1"


class Echo:
    """Answers each byte with three of it."""

    period_s: float | None = None

    def __init__(self, _robot: VirtualRobot, _options: msgspec.Struct) -> None:
        pass

    def received(self, data: bytes, _now_s: float) -> list[bytes]:
        """Answer."""
        return [bytes([byte]) * 3 for byte in data]

    def due(self, _now_s: float) -> list[bytes]:
        """Push nothing."""
        return []


def gateway_of(options: msgspec.Struct) -> tuple[str, int] | None:
    assert isinstance(options, Options)
    return (options.host, options.port) if options.port else None


CALLER = Simulator(ports=(Port(protocol="p", port=7, session=Echo, calls=gateway_of),), options=Options)
BOTH = Simulator(ports=(*CALLER.ports, Port(protocol=None, port=6, session=Echo)), options=Options)


@pytest.fixture(autouse=True)
def _impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(calling, "RETRY_S", 0.01)


def free_port() -> int:
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return int(one.getsockname()[1])


async def taken(server: TcpServer) -> Connection:
    with anyio.fail_after(5):
        return await server.connect()


async def asked(connection: Connection, data: bytes, size: int) -> bytes:
    await connection.send(data)
    answer = b""
    with anyio.fail_after(5):
        while len(answer) < size:
            answer += await received(connection)
    return answer


async def test_a_controller_calls_and_is_asked() -> None:
    server = TcpServer("127.0.0.1", free_port(), "127.0.0.2")
    async with serve(CALLER, options=Options(port=server.port)) as (controller,):
        connection = await taken(server)
        assert await asked(connection, b"ab", 6) == b"aaabbb"
        assert controller.robot.connections == 1
        assert (controller.ports, controller.calls) == ((), (("p", f"127.0.0.1:{server.port}"),))
        assert controller.number_of("p", "tcp_server") == controller.port == server.port
        await connection.aclose()
        await server.aclose()


async def test_a_controller_calls_again_when_the_gateway_hung_up() -> None:
    server = TcpServer("127.0.0.1", free_port(), "127.0.0.2")
    async with serve(CALLER, options=Options(port=server.port)) as (controller,):
        for number in range(1, 4):
            connection = await taken(server)
            assert await asked(connection, b"a", 3) == b"aaa"
            assert controller.robot.connections == number
            assert len(controller.connections) == 1
            await connection.aclose()
        await server.aclose()


async def test_a_controller_dies_and_comes_back() -> None:
    server = TcpServer("127.0.0.1", free_port(), "127.0.0.2")
    async with serve(CALLER, options=Options(port=server.port)) as (controller,):
        connection = await taken(server)
        await controller.stop()
        with pytest.raises(Exception, match="connection"):
            await asked(connection, b"a", 3)
        await connection.aclose()
        with anyio.move_on_after(0.1):
            pytest.fail(f"a dead controller called: {await server.connect()}")
        await controller.start()
        await controller.start()  # it is started already
        connection = await taken(server)
        assert await asked(connection, b"a", 3) == b"aaa"
        assert controller.robot.connections == 2
        await connection.aclose()
        await server.aclose()


async def test_a_controller_is_stopped_while_nobody_listens() -> None:
    async with serve(CALLER, options=Options(port=free_port())) as (controller,):
        await anyio.sleep(0.03)
        await controller.stop()
        assert controller.robot.connections == 0
        await controller.stop()


async def test_controllers_are_told_apart_by_their_addresses() -> None:
    port = free_port()
    first = TcpServer("127.0.0.1", port, "127.0.0.2")
    async with serve(CALLER, options=Options(port=port), count=2) as controllers:
        assert [controller.host for controller in controllers] == ["127.0.0.2", "127.0.0.3"]
        connection = await taken(first)
        assert await asked(connection, b"a", 3) == b"aaa"
        await connection.aclose()
        with anyio.fail_after(5):
            while not first.refused:
                await (await first.connect()).aclose()
        assert set(first.refused) == {"127.0.0.3"}
        await first.aclose()


async def test_chaos_strikes_calls_too() -> None:
    server = TcpServer("127.0.0.1", free_port(), "127.0.0.2")
    async with serve(CALLER, options=Options(port=server.port), chaos="double=1") as (controller,):
        connection = await taken(server)
        assert await asked(connection, b"a", 6) == b"aaaaaa"
        assert controller.robot.faults == {"double": 1}
        await connection.aclose()
        await server.aclose()


async def test_one_port_calls_while_another_listens(capsys: pytest.CaptureFixture[str]) -> None:
    server = TcpServer("127.0.0.1", free_port(), "127.0.0.2")
    async with serve(BOTH, port=0, options=Options(port=server.port)) as (controller,):
        ((protocol, number),) = controller.ports
        assert protocol is None
        reader, writer = await asyncio.open_connection(controller.host, number)
        writer.write(b"a")
        assert await reader.readexactly(3) == b"aaa"
        writer.close()
        _announce("kilo", controller)
        told = f"kilo 127.0.0.2:{number} (no state), 127.0.0.2 calls 127.0.0.1:{server.port} (p)\n"
        assert capsys.readouterr().out == told
        await (await taken(server)).aclose()
        await server.aclose()


async def test_a_port_whose_options_name_no_gateway_listens() -> None:
    async with serve(CALLER, port=0) as (controller,):
        assert controller.calls == ()
        assert controller.number_of("p") == controller.port
        reader, writer = await asyncio.open_connection(controller.host, controller.port)
        writer.write(b"a")
        assert await reader.readexactly(3) == b"aaa"
        writer.close()


async def test_an_address_that_is_not_there_is_named() -> None:
    with pytest.raises(SimulatorError, match="no such address"):
        async with serve(CALLER, host="192.0.2.1", options=Options(port=9)):
            pass


async def test_the_bodys_exception_leaves_as_it_is() -> None:
    with pytest.raises(KeyError, match="of the body"):
        async with serve(CALLER, options=Options(port=free_port())):
            raise KeyError("of the body")


async def test_numbers_of_no_use_are_refused_as_they_are() -> None:
    with pytest.raises(ValueError, match="port 70000 would need"):
        async with serve(CALLER, port=70000):
            pass


@pytest.mark.parametrize("turns", range(6))
async def test_a_controller_that_dies_at_any_moment_of_its_call_leaves_nothing_behind(turns: int) -> None:
    with socket.create_server(("127.0.0.1", 0)) as gateway:
        gateway.settimeout(0)
        async with serve(CALLER, options=Options(port=gateway.getsockname()[1])) as (controller,):
            for _ in range(turns):
                await asyncio.sleep(0)
            await controller.stop()
            await anyio.sleep(0.03)
            assert not controller.connections
            for one in _waiting(gateway):
                with one:
                    assert _ended(one)


def _waiting(gateway: socket.socket) -> Sequence[socket.socket]:
    found = []
    while True:
        try:
            found.append(gateway.accept()[0])
        except BlockingIOError:
            return found


def _ended(one: socket.socket) -> bool:
    one.settimeout(1)
    try:
        return one.recv(1) == b""
    except ConnectionResetError:
        return True


async def test_a_call_that_the_system_has_joined_to_itself_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    answers = iter((True,))
    monkeypatch.setattr(calling, "_is_itself", lambda _transport: next(answers, False))
    server = TcpServer("127.0.0.1", free_port(), "127.0.0.2")
    async with serve(CALLER, options=Options(port=server.port)) as (controller,):
        with anyio.fail_after(5):
            while controller.robot.connections < 2:
                with anyio.move_on_after(0.05):
                    await (await server.connect()).aclose()
        await server.aclose()


def test_all_of_it_works_on_the_loop_of_simulate() -> None:
    async def look() -> None:
        await test_a_controller_calls_again_when_the_gateway_hung_up()
        await test_a_controller_dies_and_comes_back()
        await test_a_controller_is_stopped_while_nobody_listens()
        for turns in range(6):
            await test_a_controller_that_dies_at_any_moment_of_its_call_leaves_nothing_behind(turns)

    anyio.run(look, backend_options={"use_uvloop": True})
