"""`robot-gateway demo`: a virtual controller of each vendor and protocol with the gateway on them, in one process."""

from __future__ import annotations

import contextlib
import dataclasses
import signal
import socket
import sys
import time
from collections.abc import AsyncIterator, Iterator, Mapping
from contextlib import AsyncExitStack
from functools import partial
from typing import Annotated, cast

import anyio
import typer
from rich.console import Group, RenderableType
from rich.live import Live
from rich.text import Text

from gateway import logs
from gateway.app import Gateway, running
from gateway.cli.common import USAGE, call, fail, tell, terminal
from gateway.cli.view import UNKNOWN, robots_table, spoken
from gateway.client import Client, connect
from gateway.config import Config, parse
from gateway.config.printing import toml_value
from gateway.core.registry import Registry
from gateway.core.settings import BrokenRobot, RobotSettings
from gateway.errors import ConfigError, VendorError
from gateway.server.listener import ListenError
from gateway.sim.server import SimulatorError, VirtualController, serve
from gateway.sim.simulator import Simulator

DEFAULT_LISTEN = "127.0.0.1:8765"
_FREE_LISTEN = "127.0.0.1:0"
_REFRESH_S = 0.25
_LINES_S = 1.0
_FIRST_ADDRESS = 2  # 127.0.0.2, as the documentation says


def demo(
    seconds: Annotated[
        float | None, typer.Option(min=0.1, metavar="S", help="End by itself after so many seconds.")
    ] = None,
    listen: Annotated[
        str | None,
        typer.Option(
            metavar="HOST:PORT", help=f"Where the doors are. Default: {DEFAULT_LISTEN}, or a free port if it is in use."
        ),
    ] = None,
) -> None:
    """Show the gateway at work without a robot: virtual controllers, real sockets, live data.

    While it runs, other terminals can use `robot-gateway status` and `tail`, and programs can subscribe. Without a
    terminal it prints a line a second for each robot.

    \b
    Examples:
      robot-gateway demo
      robot-gateway demo --seconds 20
      robot-gateway demo --listen 127.0.0.1:9000
    """  # noqa: D301 - the \b keeps the lines apart
    logs.configure("error")
    registry = Registry()
    try:
        config = parse(demo_toml(registry, listen or DEFAULT_LISTEN), "demo", registry)
    except ConfigError as error:
        fail(f"--listen {listen}: {error}", USAGE)
    call(partial(_demo, config, seconds, may_move=listen is None), uvloop=True)


def demo_toml(registry: Registry, listen: str = DEFAULT_LISTEN) -> str:
    """The configuration of the demo: one robot for each way of reading a virtual controller."""
    lines = [
        "# The configuration of `robot-gateway demo`: one virtual controller of each vendor and protocol.",
        "# By hand: `robot-gateway simulate VENDOR --host ADDRESS` in other terminals, then",
        "# `robot-gateway run --config config/demo.toml`.",
        "",
        "[server]",
        f'listen = "{listen}"',
    ]
    served = [(vendor, demo) for vendor, simulator in _simulators(registry) for demo in simulator.demos]
    for number, (vendor, demo) in enumerate(served, start=1):
        lines += ["", "[[robots]]", f'name = "r{number}"', f'vendor = "{vendor}"', f'protocol = "{demo.protocol}"']
        lines.append(f'host = "127.0.0.{_FIRST_ADDRESS + number - 1}"')
        options = demo.robot.get(demo.protocol, {})
        lines += [f"{key} = {toml_value(value)}" for key, value in demo.robot.items() if value is not options]
        if isinstance(options, Mapping) and options:
            lines.append(f"[robots.{demo.protocol}]")
            lines += [f"{key} = {toml_value(value)}" for key, value in options.items()]
    return "\n".join(lines) + "\n"


async def _demo(config: Config, seconds: float | None, *, may_move: bool) -> None:
    with anyio.open_signal_receiver(signal.SIGINT, signal.SIGTERM) as signals:
        async with anyio.create_task_group() as tasks:
            tasks.start_soon(_end_at_signal, signals, tasks.cancel_scope)
            with anyio.move_on_after(seconds):
                await _run(config, may_move=may_move)
            tasks.cancel_scope.cancel()


async def _end_at_signal(signals: AsyncIterator[signal.Signals], scope: anyio.CancelScope) -> None:
    await anext(signals)
    scope.cancel()


async def _run(config: Config, *, may_move: bool) -> None:
    async with AsyncExitStack() as stack:
        simulators = dict(_simulators(config.registry))
        robots = [await _served(robot, simulators, stack) for robot in config.robots]
        config = dataclasses.replace(config, robots=tuple(robots))
        try:
            gateway = await stack.enter_async_context(running(config))
        except ListenError as error:
            if not may_move:
                raise
            tell("warning:", "yellow", f"{error.address} is in use: taking a free port")
            server = parse(f'[server]\nlisten = "{_FREE_LISTEN}"', "demo", config.registry).server
            gateway = await stack.enter_async_context(running(dataclasses.replace(config, server=server)))
        await _show(gateway, robots)


async def _served(
    robot: RobotSettings | BrokenRobot,
    simulators: dict[str, Simulator],
    stack: AsyncExitStack,
) -> RobotSettings:
    """Serve the virtual controller of a robot, on a free port if the vendor's is taken, and point the robot at it."""
    if isinstance(robot, BrokenRobot):
        raise robot.error
    transport, protocol = robot.protocol.transport(robot.options), robot.protocol.name
    calls: dict[str, tuple[str, int]] = {}
    if transport == "tcp_server":
        calls[protocol] = ("127.0.0.1", _free(robot.port))
    served = partial(serve, simulators[robot.vendor.name], calls=lambda _number: calls)
    controller: VirtualController | None = None
    for host, port in ((robot.host, None), (robot.host, 0)):
        try:
            (controller,) = await stack.enter_async_context(served(host=host, port=port))
            break
        except SimulatorError:
            continue
    if controller is None:  # no such address: on macOS there is only one
        (controller,) = await stack.enter_async_context(served(host="127.0.0.1", port=0))
    return dataclasses.replace(
        robot, host=controller.host, port=controller.number_of(protocol, transport), origin="sim"
    )


def _free(port: int) -> int:
    """The port, if it may be listened on, or another that may."""
    for number in (port, 0):
        with contextlib.suppress(OSError), socket.create_server(("127.0.0.1", number)) as found:
            return int(found.getsockname()[1])
    return port


async def _show(gateway: Gateway, robots: list[RobotSettings]) -> None:
    console = terminal()
    async with connect(gateway.url) as client:
        if not sys.stdout.isatty():
            await _show_lines(client, gateway, robots)
        with Live(console=console, auto_refresh=False, transient=False) as live:
            while True:
                live.update(await _picture(client, gateway, console.width, console.height), refresh=True)
                await anyio.sleep(_REFRESH_S)


async def _picture(client: Client, gateway: Gateway, width: int, height: int) -> RenderableType:
    robots = await client.robots()
    latest = {sample.topic: sample for sample in await client.get(["*/status", "*/safety", "*/joints", "*/tcp"])}
    rows: list[RenderableType] = [robots_table(robots, latest, time.time_ns() // 1000, width), Text("")]
    both = 3 * len(robots) + 6 <= height
    for robot in robots:
        joints, tcp = (latest.get(f"{robot.name}/{group}") for group in ("joints", "tcp"))
        rows.append(Text(f"{robot.name}  joints  {_joints(joints and joints.data)}"))
        if both:
            rows.append(Text(f"{'':{len(robot.name)}}  tcp     {_position(tcp and tcp.data)}"))
    events = gateway.bus.events
    rows.append(Text(f"\n{gateway.url}   {events.last_seq} events so far   Ctrl-C ends it", style="dim"))
    return Group(*rows)


async def _show_lines(client: Client, gateway: Gateway, served: list[RobotSettings]) -> None:
    tell("demo:", "green", f"doors at {gateway.url}")
    for one in served:
        tell("demo:", "green", f"{one.name} is a virtual {one.vendor.name} controller at {one.host}:{one.port}")
    while True:
        await anyio.sleep(_LINES_S)
        latest = {sample.topic: sample.data for sample in await client.get(["*/joints", "*/status"])}
        for robot in await client.robots():
            rate = UNKNOWN if robot.link.reached_hz is None else f"{robot.link.reached_hz:.0f} Hz"
            joints = _joints(latest.get(f"{robot.name}/joints"))
            sys.stdout.write(f"{robot.name}  {spoken(robot)}  {robot.link.state}  {rate}  joints {joints}\n")
        sys.stdout.flush()


def _joints(data: object) -> str:
    position = data.get("position") if isinstance(data, dict) else None
    return UNKNOWN if position is None else f"{_numbers(position)} rad"


def _position(data: object) -> str:
    pose = data.get("pose") if isinstance(data, dict) else None
    position = pose.get("position") if isinstance(pose, dict) else None
    return UNKNOWN if position is None else f"{_numbers(position)} m"


def _numbers(values: list[float | None]) -> str:
    return " ".join(f"{UNKNOWN:>7}" if value is None else f"{value:7.3f}" for value in values)


def _simulators(registry: Registry) -> Iterator[tuple[str, Simulator]]:
    for name in registry.names():
        try:
            yield name, cast("Simulator", registry.simulator(name))
        except VendorError as error:
            tell("warning:", "yellow", str(error))
