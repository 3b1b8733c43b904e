"""The composition root: from a configuration to links, bus and doors in one task group."""

from __future__ import annotations

import dataclasses
import gc
import os
import signal
from collections.abc import AsyncIterator, Callable, Collection, Iterable, Mapping
from contextlib import AsyncExitStack, asynccontextmanager
from functools import partial

import anyio
import anyio.to_thread
import msgspec
import structlog

from gateway import __version__
from gateway.api.messages import ExportInfo, RobotInfo
from gateway.api.vendor import Transport
from gateway.config import Config
from gateway.config.diff import Plan, as_run, diff, effective, understand
from gateway.config.printing import robots_as_toml
from gateway.core.bus import Bus
from gateway.core.clock import Clock, SystemClock
from gateway.core.events import EventRing
from gateway.core.links import Links
from gateway.core.settings import BrokenRobot, RobotSettings
from gateway.core.tap import Tap
from gateway.core.tcp_server import TcpServer
from gateway.core.transport import Connector, TcpClient
from gateway.core.udp import UdpClient
from gateway.errors import GatewayError
from gateway.export import Source
from gateway.export.running import Exports
from gateway.notify import Notifier
from gateway.record.recorder import Recorder
from gateway.record.settings import recorder_settings
from gateway.reloading import attended
from gateway.server.cell import Cell
from gateway.server.http import listening
from gateway.server.listener import Listener
from gateway.server.settings import door_settings

_LOG = structlog.get_logger()
# Where a robot's calls are taken whose options do not say.
DEFAULT_LISTEN = "127.0.0.1"
# New objects until the youngest are searched for garbage, and how many searches until the next older ones are.
_GC_THRESHOLDS = (10_000, 10, 10)
WAITS = "a new configuration waits for this session to end; to drop it now: robot-gateway reload --drop {name}"


class Gateway:
    """A running gateway.

    Args:
        config: What it runs.
        bus: Its topics and events.
        cell: What the doors know of the robots.
        links: Its robots.
        doors: Its listener.
        exports: What sends it on.
        recorder: Keeps what the robots said lately; None: nobody does.
        env: The environment.

    Attributes:
        bus: Its topics and events.
        recorder: Keeps what the robots said lately; None: nobody does.
    """

    def __init__(
        self,
        config: Config,
        bus: Bus,
        cell: Cell,
        links: Links,
        doors: Listener,
        exports: Exports,
        recorder: Recorder | None,
        env: Mapping[str, str],
    ) -> None:
        self.bus = bus
        self.recorder = recorder
        self._env = env
        self._asked = config
        self._runs = understand(config)
        self._cell = cell
        self._links = links
        self._doors = doors
        self._exports = exports
        self._one_at_a_time = anyio.Lock()
        self._freed = anyio.Event()

    @property
    def host(self) -> str:
        """Where its doors are."""
        return self._doors.host

    @property
    def port(self) -> int:
        """Their port."""
        return self._doors.port

    @property
    def url(self) -> str:
        """The native WebSocket door."""
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"{'ws' if self._asked.tls is None else 'wss'}://{host}:{self.port}/ws"

    @property
    def config(self) -> Config:
        """The configuration that was asked for last, with the robots as they run."""
        return dataclasses.replace(self._asked, robots=tuple(self._links.robots.values()))

    @property
    def cell(self) -> Cell:
        """What the doors know of the robots."""
        return self._cell

    def exports(self) -> list[ExportInfo]:
        """How the exporters do."""
        return self._exports.infos()

    def infos(self) -> list[RobotInfo]:
        """Every robot with the state of its link."""
        return self._cell.infos()

    async def reload(self, config: Config, *, drop: Collection[str] = (), check: bool = False) -> Plan:
        """Take another configuration: only what has changed is touched.

        A robot with a session that must not be dropped keeps its old settings until the session ends by itself.

        Args:
            config: What to run now.
            drop: Robots whose session is dropped all the same.
            check: Only say what would be done.

        Returns:
            What was done.

        Raises:
            ListenError: The new address cannot be listened on: nothing has changed.
        """
        async with self._one_at_a_time:
            new = await anyio.to_thread.run_sync(understand, config, abandon_on_cancel=True)
            if not check:
                await self._doors.apply(door_settings(config), *config.server.address)
            plan = diff(self._runs, new, self._links.holding - set(drop))
            if not check:
                self.bus.resize(config.server.event_ring, config.server.command_ring)
                if self.recorder is not None and plan.recorder:
                    self.recorder.configure(recorder_settings(config.recorder, self._env))
                await self._take_robots(plan, config)
                await self._exports.apply(config.export)
                self._asked, self._runs = config, as_run(plan, self._runs, new)
            return msgspec.structs.replace(plan, warnings=list(config.warnings))

    async def _take_robots(self, plan: Plan, config: Config) -> None:
        robots = effective(plan, self._links.robots, config.robots)
        await self._links.apply(robots, stopped=plan.stopped, before_start=lambda: self._cell.replace(robots))
        if self.recorder is not None and (plan.added or plan.removed or plan.changed):
            self.recorder.robots_changed()
        self._links.wait({one.name: WAITS.format(name=one.name) for one in plan.held}, self._freed.set)

    async def follow_up(self) -> None:
        """Carry out what waits whenever a session has ended that it waited for, for ever."""
        while True:
            await self._freed.wait()
            self._freed = anyio.Event()
            try:
                plan = await self.reload(self._asked)
            except GatewayError as error:
                _LOG.warning("reload.refused", reason=str(error))
            except Exception:  # noqa: BLE001 - a mistake in a reload must not end the gateway
                _LOG.exception("reload.failed")
            else:
                done = [robot.name for robot in (*plan.added, *plan.changed, *plan.removed)]
                _LOG.info("reload.applied", reason="a session has ended", robots=done)


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


def recorder_of(
    config: Config,
    bus: Bus,
    clock: Clock,
    robots: Callable[[], Iterable[RobotSettings | BrokenRobot]],
    env: Mapping[str, str],
) -> Recorder | None:
    """The recorder that a configuration asks for; None: it wants none.

    Args:
        config: Asks for it.
        bus: Where the robots are published.
        clock: Both times.
        robots: Tells them as they run.
        env: The environment.
    """
    if not config.recorder.enabled:
        return None

    def understood() -> tuple[str, list[str]]:
        toml = robots_as_toml(robot for robot in robots() if isinstance(robot, RobotSettings))
        return toml, [str(folder) for folder in config.vendor_dirs]

    return Recorder(recorder_settings(config.recorder, env), bus, clock, understood)


def _tapped(recorder: Recorder, robot: RobotSettings) -> Tap:
    return recorder.tap(robot.name)


@asynccontextmanager
async def running(
    config: Config,
    clock: Clock | None = None,
    env: Mapping[str, str] = os.environ,
    *,
    tap_of: Callable[[RobotSettings], Tap | None] | None = None,
) -> AsyncIterator[Gateway]:
    """Run the gateway for as long as the context lasts.

    The doors are open before the first link is tried, so that a subscriber sees every event.

    Args:
        config: What to run.
        clock: Tests give their own.
        env: The environment.
        tap_of: Gives what is shown every byte of a robot's sessions, in the place of the recorder.

    Raises:
        ListenError: The listener could not be opened.
    """
    bus = Bus(EventRing(config.server.event_ring), config.server.command_ring)
    clock = clock or SystemClock()
    links: Links
    recorder = None
    if tap_of is None:
        recorder = recorder_of(config, bus, clock, lambda: tuple(links.robots.values()), env)
    if recorder is not None:
        tap_of = partial(_tapped, recorder)
    links = Links(config.robots, bus, clock, connector_of, tap_of=tap_of)
    cell = Cell(
        config.robots,
        bus,
        exports=lambda: exports.infos(),  # noqa: PLW0108 - which are made next
        recorder=lambda: None if recorder is None else recorder.info,
    )
    exports = Exports(config.export, Source(bus=bus, infos=cell.infos, clock=clock))
    if recorder is not None:
        recorder.watch()
    async with AsyncExitStack() as stack:
        await stack.enter_async_context(links.running())
        doors = await stack.enter_async_context(listening(cell, *config.server.address, door_settings(config)))
        _LOG.info(
            "gateway.started", version=__version__, listen=f"{doors.host}:{doors.port}", robots=len(config.robots)
        )
        gateway = Gateway(config, bus, cell, links, doors, exports, recorder, env)
        tasks = await stack.enter_async_context(anyio.create_task_group())
        tasks.start_soon(gateway.follow_up)
        tasks.start_soon(exports.run)
        if recorder is not None:
            tasks.start_soon(recorder.run)
        links.start()
        try:
            yield gateway
        finally:
            tasks.cancel_scope.cancel()
            links.stop()  # while the doors close
            _LOG.info("gateway.stopped")


def _settle_memory() -> None:
    """Leave what there is from the start out of every later search for garbage, and search less often.

    Such a search takes 25 ms, in which nothing else is done (ADR 0021).
    """
    gc.collect()
    gc.freeze()
    gc.set_threshold(*_GC_THRESHOLDS)


async def run_until_signal(config: Config, ready: Callable[[Gateway], None] = lambda _: None) -> None:
    """Run the gateway until SIGINT or SIGTERM; SIGHUP reads its configuration again.

    Args:
        config: What to run.
        ready: Called when the doors are open.
    """
    notifier = Notifier.of_environment(os.environ)
    with anyio.open_signal_receiver(signal.SIGINT, signal.SIGTERM, signal.SIGHUP) as signals:
        async with running(config) as gateway, attended(gateway, notifier, os.environ) as on_hangup:
            _settle_memory()
            ready(gateway)
            notifier.ready()
            async for number in signals:
                if number is signal.SIGHUP:
                    on_hangup()
                else:
                    _LOG.info("gateway.stopping", reason=signal.Signals(number).name)
                    notifier.stopping()
                    return
