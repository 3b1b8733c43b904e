"""Serves virtual controllers on real sockets: many of them, on consecutive addresses, from one cheap process.

Callbacks of the loop and no task per connection: this is the load generator of the acceptance runs.
"""

from __future__ import annotations

import asyncio
import errno
import ipaddress
from collections import deque
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import asynccontextmanager
from functools import partial
from random import Random
from typing import TYPE_CHECKING, cast

import msgspec

from gateway.errors import GatewayError
from gateway.sim.chaos import CALM, Chaos, ChaosPlan, Delivery, parse_chaos
from gateway.sim.scenario import Scenario, find_scenario
from gateway.sim.simulator import Port, Simulator, VirtualRobot

if TYPE_CHECKING:
    from asyncio import AbstractServer, Handle, Transport

# Controllers of one run begin this much apart in the scenario, so that they are not all doing the same.
SPREAD_S = 3.7
# Bytes that are read at once, and sends that may be owed before no more is read.
_READ_SIZE = 2048
_MOST_OWED = 64


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
    """One virtual controller: its robot and its listeners.

    Args:
        simulator: What it speaks.
        robot: What it speaks of.
        host: Its address.
        port: Its main port; None is the vendor's, 0 lets the system choose.
        options: Of the simulator's own struct.
        plan: The chaos that its state ports suffer.

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
    ) -> None:
        self.robot = robot
        self.host = host
        self.options = options
        self.plan = plan
        self.missing: list[SimulatorError] = []
        self.connections: set[_Connection] = set()
        self.start_s = 0.0
        self._listeners = simulator.ports
        self._numbers = list(simulator.port_numbers(port))
        self._servers: list[AbstractServer] = []

    @property
    def port(self) -> int:
        """The main port, as bound."""
        return self._numbers[0]

    @property
    def ports(self) -> tuple[tuple[str | None, int], ...]:
        """Each port that is served: its protocol, or None, and its number."""
        missing = {problem.port for problem in self.missing}
        pairs = zip(self._listeners, self._numbers, strict=True)
        return tuple((port.protocol, number) for port, number in pairs if number not in missing)

    async def start(self) -> None:
        """Begin to listen; after a stop, on the same ports as before.

        Raises:
            SimulatorError: A state port cannot be had.
        """
        if self._servers:
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
        """Die: every listener and every connection is closed at once."""
        servers, self._servers = self._servers, []
        for server in servers:
            server.close()
        for connection in list(self.connections):
            connection.abort()
        for server in servers:
            await server.wait_closed()

    async def _listen(self, index: int, port: Port) -> None:
        loop = asyncio.get_running_loop()
        number = self._numbers[index]
        try:
            server = await loop.create_server(lambda: _Connection(self, port, loop), self.host, number)
        except OSError as error:
            raise SimulatorError(self.host, number, _advice(error)) from None
        self._servers.append(server)
        self._numbers[index] = server.sockets[0].getsockname()[1]


class _Connection(asyncio.BufferedProtocol):
    """One client. What it is owed leaves in order; the next send waits for the one before."""

    def __init__(self, controller: VirtualController, port: Port, loop: asyncio.AbstractEventLoop) -> None:
        self._controller = controller
        self._port = port
        self._loop = loop
        self._plan = controller.plan if port.protocol is not None else CALM
        self._chaos: Chaos | None = None
        self._session = port.session(controller.robot, controller.options)
        self._owed: deque[Delivery] = deque()
        self._timers: dict[str, Handle] = {}
        self._buffer = bytearray(_READ_SIZE)
        self._held = b""
        self._full = False

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Take the connection; both loops set TCP_NODELAY by themselves."""
        self._transport = cast("Transport", transport)
        self._controller.connections.add(self)
        robot = self._controller.robot
        if self._port.protocol is not None:
            robot.connections += 1
        if not self._plan.is_calm:
            random = Random(f"{robot.seed}/{robot.number}/{robot.connections}")  # noqa: S311 - faults, not secrets
            fillers = self._port.fillers
            self._chaos = Chaos(self._plan, random, header=self._port.header, fillers=fillers, counts=robot.faults)
            if self._plan.cut_every_s:
                end = self._transport.abort if random.getrandbits(1) else self._transport.close
                self._timers["cut"] = self._loop.call_later(self._plan.cut_every_s, self._cut, end)
        if self._session.period_s is not None:
            self._push(self._loop.time(), self._session.period_s)

    def get_buffer(self, _size_hint: int) -> bytearray:
        """Lend the buffer: a small one, because a client may send requests without end."""
        return self._buffer

    def buffer_updated(self, size: int) -> None:
        """Let the session answer."""
        data = bytes(self._buffer[:size])
        left_s = self._plan.silence_left_s(self._loop.time() - self._controller.start_s)
        if left_s or self._held:
            self._controller.robot.faults["stall"] += 1
            self._held += data
            if "stall" not in self._timers:
                self._timers["stall"] = self._loop.call_later(left_s, self._end_stall)
        else:
            self._answer(data)

    def _end_stall(self) -> None:
        """Answer what was asked during a stall, like a controller whose process has hung."""
        held, self._held = self._held, b""
        del self._timers["stall"]
        self._answer(held)

    def _answer(self, data: bytes) -> None:
        try:
            self._send(self._session.received(data, self._loop.time()))
        except Exception as error:  # noqa: BLE001 - one client's bytes must not stop the others
            self._failed(error)

    def connection_lost(self, _exc: Exception | None) -> None:
        """Forget the client."""
        self._controller.connections.discard(self)
        self._owed.clear()
        for timer in self._timers.values():
            timer.cancel()

    def pause_writing(self) -> None:
        """Stop reading the requests of a client that does not read the answers."""
        self._full = True
        self._balance()

    def resume_writing(self) -> None:
        """Go on."""
        self._full = False
        self._balance()

    def _balance(self) -> None:
        """Read on only while what is owed leaves."""
        if self._transport.is_closing():
            return
        if self._full or len(self._owed) > _MOST_OWED:
            self._transport.pause_reading()
        else:
            self._transport.resume_reading()

    def abort(self) -> None:
        """Close without a word."""
        self._transport.abort()

    def _cut(self, end: Callable[[], None]) -> None:
        self._controller.robot.faults["cut"] += 1
        end()

    def _push(self, at_s: float, period_s: float) -> None:
        """Call `due` at fixed times; what a slow client or a late loop missed is left out."""
        now_s = self._loop.time()
        next_s = max(at_s + period_s, now_s)
        self._timers["push"] = self._loop.call_at(next_s, self._push, next_s, period_s)
        silent = self._chaos is not None and self._plan.silent(now_s - self._controller.start_s)
        if self._full or silent:
            return
        try:
            self._send(self._session.due(now_s))
        except Exception as error:  # noqa: BLE001 - as above
            self._failed(error)

    def _send(self, segments: Sequence[bytes]) -> None:
        if self._chaos is not None:
            self._owe(self._chaos.deliver(segments))
        elif len(segments) == 1 and not self._owed:
            self._transport.write(segments[0])
        elif segments:
            self._owe([Delivery(0.0, segment) for segment in segments])

    def _owe(self, deliveries: Sequence[Delivery]) -> None:
        idle = not self._owed
        self._owed.extend(deliveries)
        if idle and self._owed:
            self._next()
        if len(self._owed) > _MOST_OWED:
            self._balance()

    def _next(self) -> None:
        """Have the head sent when its time comes."""
        wait_s = self._owed[0].wait_s
        call = self._loop.call_soon if wait_s <= 0 else partial(self._loop.call_later, wait_s)
        self._timers["send"] = call(self._write)

    def _write(self) -> None:
        """Send the head: never two sends in one turn of the loop, which might join them."""
        if not self._owed or self._transport.is_closing():
            return
        self._transport.write(self._owed.popleft().data)
        if self._owed:
            self._next()
        if len(self._owed) == _MOST_OWED:
            self._balance()

    def _failed(self, error: Exception) -> None:
        context = {"message": "a virtual controller's session failed", "exception": error, "protocol": self}
        self._loop.call_exception_handler(context)
        self._transport.abort()


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

    Yields:
        The controllers, listening.

    Raises:
        SimulatorError: An address or a state port cannot be had; none is served then.
        ValueError: The host, the port, the count, the scenario or the chaos is of no use.
    """
    loop = asyncio.get_running_loop()
    played = find_scenario(scenario) if isinstance(scenario, str) else scenario
    plan = parse_chaos(chaos) if isinstance(chaos, str) else chaos
    controllers = tuple(
        VirtualController(
            simulator,
            VirtualRobot(played, start_s=loop.time() - number * SPREAD_S, number=number, seed=seed, keep=keep),
            host=address,
            port=port,
            options=simulator.options() if options is None else options,
            plan=plan,
        )
        for number, address in enumerate(addresses(host, count))
    )
    try:
        for controller in controllers:
            await controller.start()
        yield controllers
    finally:
        for controller in controllers:
            await controller.stop()
