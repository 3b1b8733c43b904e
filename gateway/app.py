"""The composition root: from a configuration to links, bus and doors in one task group."""

from __future__ import annotations

import signal
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import dataclass

import anyio
import structlog

from gateway import __version__
from gateway.api.vendor import Transport
from gateway.config import Config
from gateway.core.bus import Bus
from gateway.core.clock import Clock, SystemClock
from gateway.core.events import EventRing
from gateway.core.link import Link, announce_broken
from gateway.core.settings import BrokenRobot, RobotSettings
from gateway.core.tap import Tap
from gateway.core.tcp_server import TcpServer
from gateway.core.transport import Connector, TcpClient
from gateway.core.udp import UdpClient
from gateway.server.cell import Cell
from gateway.server.http import listening

_LOG = structlog.get_logger()
# Where a robot's calls are taken whose options do not say.
DEFAULT_LISTEN = "127.0.0.1"


@dataclass(frozen=True, slots=True)
class Gateway:
    """A running gateway.

    Attributes:
        host: Where its doors are.
        port: Their port.
        bus: Its topics and events.
    """

    host: str
    port: int
    bus: Bus

    @property
    def url(self) -> str:
        """The native WebSocket door."""
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"ws://{host}:{self.port}/ws"


def connector_of(robot: RobotSettings) -> Connector:
    """How a robot is reached, or how it reaches the gateway."""
    transport = robot.protocol.transport(robot.options)
    if transport == "tcp_server":
        return TcpServer(getattr(robot.options, "listen", DEFAULT_LISTEN), robot.port, robot.host)
    return connector(transport, robot.host, robot.port)


def connector(transport: Transport, host: str, port: int) -> Connector:
    """What calls a controller over a transport.

    Raises:
        ValueError: It is the controller that calls.
    """
    if transport == "tcp_server":
        raise ValueError("a controller that calls cannot be called")
    return UdpClient(host, port) if transport == "udp" else TcpClient(host, port)


@asynccontextmanager
async def running(
    config: Config, clock: Clock | None = None, *, tap_of: Callable[[RobotSettings], Tap | None] = lambda _: None
) -> AsyncIterator[Gateway]:
    """Run the gateway for as long as the context lasts.

    The doors are open before the first link is tried, so that a subscriber sees every event.

    Args:
        config: What to run.
        clock: Tests give their own.
        tap_of: Gives what is shown every byte of a robot's sessions.

    Raises:
        ListenError: The listener could not be opened.
    """
    clock = clock or SystemClock()
    bus = Bus(EventRing(config.server.event_ring), config.server.command_ring)
    links = _links(config.robots, bus, clock, tap_of)
    host, asked_port = config.server.address
    async with AsyncExitStack() as stack:
        cell = Cell(config.robots, bus)
        port = await stack.enter_async_context(listening(cell, host, asked_port, config.server.flush_ms / 1000))
        _LOG.info("gateway.started", version=__version__, listen=f"{host}:{port}", robots=len(config.robots))
        tasks = await stack.enter_async_context(anyio.create_task_group())
        for link in links:
            tasks.start_soon(link.run)
        try:
            yield Gateway(host, port, bus)
        finally:
            tasks.cancel_scope.cancel()
            _LOG.info("gateway.stopped")


async def run_until_signal(config: Config, ready: Callable[[Gateway], None] = lambda _: None) -> None:
    """Run the gateway until SIGINT or SIGTERM.

    Args:
        config: What to run.
        ready: Called when the doors are open.
    """
    with anyio.open_signal_receiver(signal.SIGINT, signal.SIGTERM) as signals:
        async with running(config) as gateway:
            ready(gateway)
            async for number in signals:
                _LOG.info("gateway.stopping", reason=signal.Signals(number).name)
                return


def _links(
    robots: Sequence[RobotSettings | BrokenRobot],
    bus: Bus,
    clock: Clock,
    tap_of: Callable[[RobotSettings], Tap | None],
) -> list[Link]:
    links = []
    for robot in robots:
        if isinstance(robot, BrokenRobot):
            announce_broken(robot, bus, clock)
        else:
            links.append(Link(robot, connector_of(robot), bus, clock, tap=tap_of(robot)))
    return links
