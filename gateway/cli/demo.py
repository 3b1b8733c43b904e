"""`robot-gateway demo`: a virtual controller of each vendor and protocol with the gateway on them, in one process."""

from __future__ import annotations

import signal
import sys
import time
from collections.abc import Iterator
from contextlib import AsyncExitStack
from functools import partial
from typing import Annotated, cast

import anyio
import typer
from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.text import Text

from gateway import logs
from gateway.app import Gateway, running
from gateway.cli.common import call, tell
from gateway.cli.view import UNKNOWN, robots_table
from gateway.client import Client, connect
from gateway.config import Config, parse
from gateway.core.registry import Registry
from gateway.errors import VendorError
from gateway.sim.server import serve
from gateway.sim.simulator import Simulator

_REFRESH_S = 0.25
_LINES_S = 1.0
_FIRST_ADDRESS = 2  # 127.0.0.2, as the documentation says


def demo(
    seconds: Annotated[float | None, typer.Option(min=0.1, help="End by itself after so many seconds.")] = None,
    listen: Annotated[str, typer.Option(metavar="HOST:PORT", help="Where the gateway's doors are.")] = "127.0.0.1:8765",
) -> None:
    """Show the gateway at work without a robot: virtual controllers, real sockets, live data.

    While it runs, other terminals can use `robot-gateway status` and `tail`, and programs can subscribe. Without a
    terminal it prints a line a second for each robot.

    \b
    Examples:
      robot-gateway demo
      robot-gateway demo --seconds 20
    """
    logs.configure("error")
    call(partial(_demo, seconds, listen), uvloop=True)


def demo_toml(registry: Registry, listen: str) -> str:
    """The configuration of the demo: one robot for each protocol that has a virtual controller."""
    lines = [
        "# The configuration of `robot-gateway demo`: one virtual controller of each vendor and protocol.",
        "# By hand: `robot-gateway simulate VENDOR --host ADDRESS` in other terminals, then",
        "# `robot-gateway run --config config/demo.toml`.",
        "",
        "[server]",
        f'listen = "{listen}"',
    ]
    number = 0
    for vendor, simulator in _simulators(registry):
        for protocol in {port.protocol: None for port in simulator.ports if port.protocol}:
            number += 1
            lines += ["", "[[robots]]", f'name = "r{number}"', f'vendor = "{vendor}"', f'protocol = "{protocol}"']
            lines.append(f'host = "127.0.0.{_FIRST_ADDRESS + number - 1}"')
            lines += [f"{key} = {_toml(value)}" for key, value in simulator.demo.items()]
    return "\n".join(lines) + "\n"


async def _demo(seconds: float | None, listen: str) -> None:
    registry = Registry()
    config = parse(demo_toml(registry, listen), "demo", registry)
    async with AsyncExitStack() as stack:
        simulators = dict(_simulators(registry))
        for robot in config.robots:
            vendor = robot.vendor if isinstance(robot.vendor, str) else robot.vendor.name
            await stack.enter_async_context(serve(simulators[vendor], host=robot.host))
        gateway = await stack.enter_async_context(running(config))
        with anyio.move_on_after(seconds):
            async with anyio.create_task_group() as tasks:
                tasks.start_soon(_end_at_signal, tasks.cancel_scope)
                await _show(gateway, config)


async def _end_at_signal(scope: anyio.CancelScope) -> None:
    with anyio.open_signal_receiver(signal.SIGINT, signal.SIGTERM) as signals:
        async for _ in signals:
            scope.cancel()
            return


async def _show(gateway: Gateway, config: Config) -> None:
    console = Console(highlight=False)
    async with connect(gateway.url) as client:
        if not sys.stdout.isatty():
            await _show_lines(client, gateway)
        with Live(console=console, auto_refresh=False, transient=False) as live:
            while True:
                live.update(await _picture(client, gateway, config), refresh=True)
                await anyio.sleep(_REFRESH_S)


async def _picture(client: Client, gateway: Gateway, config: Config) -> RenderableType:
    robots = await client.robots()
    latest = {sample.topic: sample for sample in await client.get(["*/status", "*/safety", "*/joints", "*/tcp"])}
    rows: list[RenderableType] = [robots_table(robots, latest, time.time_ns() // 1000), Text("")]
    for robot in config.robots:
        rows.append(Text(f"{robot.name}  joints  {_joints(latest[f'{robot.name}/joints'].data)}"))
        rows.append(Text(f"{'':{len(robot.name)}}  tcp     {_position(latest[f'{robot.name}/tcp'].data)}"))
    events = gateway.bus.events
    rows.append(Text(f"\n{gateway.url}   {events.last_seq} events so far   Ctrl-C ends it", style="dim"))
    return Group(*rows)


async def _show_lines(client: Client, gateway: Gateway) -> None:
    tell("demo:", "green", f"doors at {gateway.url}")
    while True:
        await anyio.sleep(_LINES_S)
        latest = {sample.topic: sample.data for sample in await client.get(["*/joints", "*/status"])}
        for robot in await client.robots():
            rate = UNKNOWN if robot.link.reached_hz is None else f"{robot.link.reached_hz:.0f} Hz"
            joints = _joints(latest.get(f"{robot.name}/joints"))
            sys.stdout.write(f"{robot.name}  {robot.vendor}  {robot.link.state}  {rate}  joints {joints}\n")
        sys.stdout.flush()


def _joints(data: object) -> str:
    position = data.get("position") if isinstance(data, dict) else None
    return UNKNOWN if position is None else " ".join(f"{value:7.3f}" for value in position) + " rad"


def _position(data: object) -> str:
    pose = data.get("pose") if isinstance(data, dict) else None
    return UNKNOWN if pose is None else " ".join(f"{value:7.3f}" for value in pose["position"]) + " m"


def _simulators(registry: Registry) -> Iterator[tuple[str, Simulator]]:
    for name in registry.names():
        try:
            yield name, cast("Simulator", registry.simulator(name))
        except VendorError as error:
            tell("warning:", "yellow", str(error))


def _toml(value: object) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    return f'"{value}"' if isinstance(value, str) else str(value)
