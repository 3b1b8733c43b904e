"""Serves virtual controllers on real sockets: many of them, on consecutive addresses, from one cheap process.

Callbacks of the loop and no task per connection: this is the load generator of the acceptance runs. Only a controller
that calls a gateway has a task, which makes its calls.
"""

from __future__ import annotations

import asyncio
import errno
import ipaddress
from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import asynccontextmanager
from functools import partial
from typing import TYPE_CHECKING

import anyio
import msgspec
from anyio.abc import TaskGroup

from gateway.api.vendor import Transport
from gateway.errors import GatewayError
from gateway.sim.calling import Caller
from gateway.sim.chaos import CALM, ChaosPlan, parse_chaos
from gateway.sim.connection import Connection
from gateway.sim.datagrams import Datagrams
from gateway.sim.scenario import Scenario, find_scenario
from gateway.sim.simulator import Port, Simulator, VirtualRobot

if TYPE_CHECKING:
    from asyncio import AbstractServer, DatagramTransport

# Controllers of one run begin this much apart in the scenario, so that they are not all doing the same.
SPREAD_S = 3.7


class SimulatorError(GatewayError):
    """A virtual controller cannot be served.

    Attributes:
        host: Address of the controller.
        port: The port that cannot be had.
        reason: What is wrong and what to do.
    """

    def __init__(self, host: str, port: int, reason: str) -> None:
        super().__init__(f"{host}:{port}: {reason}")
        self.host = host
        self.port = port
        self.reason = reason


class VirtualController:
    """One virtual controller: its robot, its listeners, and the gateways that it calls.

    Args:
        simulator: What it speaks.
        robot: What it speaks of.
        host: Its address.
        port: Its main port; None is the vendor's, 0 lets the system choose.
        options: Of the simulator's own struct.
        plan: The chaos that its state ports suffer.
        tasks: Where its calls are made.
        calls: The gateways that it calls for some protocols, as host and port, whatever the options say.

    Attributes:
        missing: The ports that it does without, each with the reason.
    """

    def __init__(
        self,
        simulator: Simulator,
        robot: VirtualRobot,
        *,
        host: str,
        port: int | None,
        options: msgspec.Struct,
        plan: ChaosPlan,
        tasks: TaskGroup,
        calls: Mapping[str, tuple[str, int]] = {},
    ) -> None:
        self.robot = robot
        self.host = host
        self.options = options
        self.plan = plan
        self.missing: list[SimulatorError] = []
        self.connections: set[Connection] = set()
        self.start_s = 0.0
        numbers = zip(simulator.ports, simulator.port_numbers(port), strict=True)
        offered = [(listener, number) for listener, number in numbers if listener.offered(options)]
        self._listeners = tuple(listener for listener, _ in offered)
        self._calls = [calls.get(port.protocol or "") or port.calls(options) for port in self._listeners]
        self._numbers = [
            number if gateway is None else gateway[1] for (_, number), gateway in zip(offered, self._calls, strict=True)
        ]
        self._tasks = tasks
        self._servers: list[AbstractServer] = []
        self._endpoints: list[DatagramTransport] = []
        self._callers: list[Caller] = []

    @property
    def port(self) -> int:
        """The main port, or the first that is offered, as bound; where it calls, the gateway's."""
        return self._numbers[0]

    @property
    def ports(self) -> tuple[tuple[str | None, int], ...]:
        """Each port that is served: its protocol, or None, and its number."""
        missing = {problem.port for problem in self.missing}
        rows = zip(self._listeners, self._numbers, self._calls, strict=True)
        return tuple((port.protocol, number) for port, number, to in rows if to is None and number not in missing)

    @property
    def calls(self) -> tuple[tuple[str | None, str], ...]:
        """Each port that calls instead: its protocol, or None, and the address of the gateway."""
        pairs = zip(self._listeners, self._calls, strict=True)
        return tuple((port.protocol, _text(*gateway)) for port, gateway in pairs if gateway is not None)

    def number_of(self, protocol: str, transport: Transport = "tcp") -> int:
        """The port of a protocol over a transport; "tcp_server" for one that calls: it is the gateway's then.

        Raises:
            KeyError: It is not served.
        """
        rows = zip(self._listeners, self._numbers, self._calls, strict=True)
        numbers: dict[tuple[str | None, Transport], int] = {
            (port.protocol, port.transport if gateway is None else "tcp_server"): number
            for port, number, gateway in rows
        }
        return numbers[protocol, transport]

    async def start(self) -> None:
        """Begin to listen, after a stop on the same ports as before, and to call.

        Raises:
            SimulatorError: A state port cannot be had.
        """
        if self._servers or self._endpoints or self._callers:
            return
        self.start_s = asyncio.get_running_loop().time()
        self.missing = []
        for index, port in enumerate(self._listeners):
            try:
                await self._listen(index, port)
            except SimulatorError as error:
                if port.protocol is not None:
                    await self.stop()
                    raise
                self.missing.append(error)

    async def stop(self) -> None:
        """Die: every listener and every connection is closed at once, and nobody is called."""
        callers, self._callers = self._callers, []
        for caller in callers:
            caller.cancel()
        servers, self._servers = self._servers, []
        for server in servers:
            server.close()
        endpoints, self._endpoints = self._endpoints, []
        for endpoint in endpoints:
            endpoint.abort()
        for connection in list(self.connections):
            connection.abort()
        for caller in callers:
            await caller.ended()
        for server in servers:
            await server.wait_closed()

    async def _listen(self, index: int, port: Port) -> None:
        loop = asyncio.get_running_loop()
        number = self._numbers[index]
        gateway = self._calls[index]
        try:
            if gateway is not None:
                caller = Caller(partial(Connection, self, port, loop), self.host, gateway)
                caller.start(self._tasks)
                self._callers.append(caller)
            elif port.transport == "udp":
                endpoint, _ = await loop.create_datagram_endpoint(
                    lambda: Datagrams(lambda: Connection(self, port, loop)), local_addr=(self.host, number)
                )
                self._endpoints.append(endpoint)
                self._numbers[index] = endpoint.get_extra_info("sockname")[1]
            else:
                server = await loop.create_server(lambda: Connection(self, port, loop), self.host, number)
                self._servers.append(server)
                self._numbers[index] = server.sockets[0].getsockname()[1]
        except OSError as error:
            raise SimulatorError(self.host, number, _advice(error)) from None


def _advice(error: OSError) -> str:
    """Say what is wrong with an address or port, and what to do."""
    if error.errno == errno.EADDRINUSE:
        return "the port is taken: stop what listens there, or choose another with --port or --host"
    if error.errno == errno.EADDRNOTAVAIL:
        return (
            "this machine has no such address: choose one with --host "
            "(on macOS every loopback address but 127.0.0.1 must be made first: sudo ifconfig lo0 alias ADDRESS)"
        )
    if error.errno in {errno.EACCES, errno.EPERM}:
        return "ports below 1024 need privileges: choose another with --port"
    return (error.strerror or str(error)).lower()


def _text(host: str, port: int) -> str:
    return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"


def addresses(host: str, count: int) -> list[str]:
    """Return consecutive addresses, from `host` on.

    Raises:
        ValueError: The host is no IP address, the count is not positive, or the addresses run out.
    """
    if count < 1:
        raise ValueError(f"count is {count}: it must be 1 or more")
    try:
        first = ipaddress.ip_address(host)
    except ValueError:
        raise ValueError(f"host {host!r} is no IP address, such as 127.0.0.2") from None
    try:
        return [str(first + number) for number in range(count)]
    except ipaddress.AddressValueError:
        raise ValueError(f"there are no {count} addresses from {host} on") from None


@asynccontextmanager
async def serve(
    simulator: Simulator,
    *,
    host: str = "127.0.0.2",
    port: int | None = None,
    count: int = 1,
    options: msgspec.Struct | None = None,
    scenario: str | Scenario = "cell",
    chaos: str | ChaosPlan = CALM,
    seed: int = 0,
    keep: int = 0,
    calls: Callable[[int], Mapping[str, tuple[str, int]]] = lambda _number: {},
) -> AsyncIterator[tuple[VirtualController, ...]]:
    """Serve virtual controllers while the context lasts.

    Args:
        simulator: A vendor's `SIMULATOR`.
        host: Address of the first; the others follow it.
        port: The main port of each; None is the vendor's, 0 lets the system choose.
        count: How many.
        options: Of the simulator's own struct; None: its defaults.
        scenario: What happens to their robots; each is a little further in it than the one before.
        chaos: What happens to the bytes that their state ports send.
        seed: For what is random.
        keep: How many of the last frames each robot keeps with what they meant.
        calls: The gateways that each controller calls, by its number from 0 and by protocol.

    Yields:
        The controllers, listening and calling.

    Raises:
        SimulatorError: An address or a state port cannot be had; none is served then.
        ValueError: The host, the port, the count, the scenario or the chaos is of no use.
    """
    loop = asyncio.get_running_loop()
    played = find_scenario(scenario) if isinstance(scenario, str) else scenario
    plan = parse_chaos(chaos) if isinstance(chaos, str) else chaos
    spoken = simulator.options() if options is None else options
    controllers: tuple[VirtualController, ...] = ()
    failure: Exception | None = None
    async with anyio.create_task_group() as tasks:
        try:
            controllers = tuple(
                VirtualController(
                    simulator,
                    VirtualRobot(played, start_s=loop.time() - number * SPREAD_S, number=number, seed=seed, keep=keep),
                    host=address,
                    port=port,
                    options=spoken,
                    plan=plan,
                    tasks=tasks,
                    calls=calls(number),
                )
                for number, address in enumerate(addresses(host, count))
            )
            for controller in controllers:
                await controller.start()
            yield controllers
        except Exception as error:  # noqa: BLE001 - it leaves as it is, below: the task group would put it in a group
            failure = error
        finally:
            with anyio.CancelScope(shield=True):
                for controller in controllers:
                    await controller.stop()
    if failure is not None:
        raise failure
