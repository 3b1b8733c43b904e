"""Faults of the network between the gateway and its controllers, which are in a network namespace of their own."""

from __future__ import annotations

import contextlib
import os
import subprocess
import time
from collections.abc import AsyncIterator, Iterator
from contextlib import AsyncExitStack, asynccontextmanager, contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from random import Random

import anyio

from tests.faults.cell import hosts, steady_robots
from tests.faults.kit import Fault, Series, Stage
from tests.faults.processes import gateway
from tests.faults.report import Seen
from tests.faults.robots import Controllers, Robot, configured
from tests.faults.tunlink import FAIR, TunLink, Weather, run, tunlink

_BACK_S = 12.0
_LOST_S = 20.0
_WEATHER_S = 2.0
_DROPPING = (
    "table inet cut {"
    " chain input { type filter hook input priority 0; policy drop; };"
    " chain output { type filter hook output priority 0; policy drop; };"
    " }"
)
_VICTIMS = (("rainbow", "reqdata"), ("fairino", "cnde"), ("fairino", "legacy"), ("xcore", "objects"))


def why_not() -> str | None:
    """Why there can be no namespaces here; None: there can."""
    if os.getuid() != 0:
        return "network namespaces need root"
    if not Path("/dev/net/tun").exists():
        return "there is no /dev/net/tun"
    try:
        with namespace("rgw-try"):
            run("ip", "netns", "exec", "rgw-try", "nft", "list", "ruleset")
    except (OSError, subprocess.CalledProcessError) as error:
        return f"no network namespaces, or no nft: {error}"
    return None


@contextmanager
def namespace(name: str) -> Iterator[None]:
    """A network namespace with a loopback device, for as long as the context lasts."""
    with contextlib.suppress(subprocess.CalledProcessError):
        run("ip", "netns", "del", name)  # what a killed test has left
    run("ip", "netns", "add", name)
    try:
        run("ip", "-n", name, "link", "set", "lo", "up")
        yield
    finally:
        run("ip", "netns", "del", name)


@dataclass
class NetStage(Stage):
    """A gateway that reaches some of its controllers through a bad network.

    Attributes:
        link: The network.
        namespace: Where the controllers are.
        controllers: Their process.
        far: The names of their robots.
    """

    link: TunLink
    namespace: str
    controllers: Controllers
    far: tuple[str, ...]


@asynccontextmanager
async def network(folder: Path) -> AsyncIterator[NetStage]:
    """Run the cell with half of it behind a bad network."""
    here, there = _subnet(), f"rgw-{os.getpid()}"
    steady = steady_robots(hosts(20))
    far = [
        Robot(name=f"n{number}", vendor=vendor, protocol=protocol, host=f"{here}.{10 + number}")
        for number, (vendor, protocol) in enumerate(_VICTIMS, start=1)
    ]
    async with AsyncExitStack() as stack:
        tasks = await stack.enter_async_context(anyio.create_task_group())
        stack.enter_context(namespace(there))
        link = await stack.enter_async_context(tunlink(there, there, f"{here}.1/30", f"{here}.2/30"))
        run("ip", "route", "add", f"{here}.0/24", "via", f"{here}.2", "dev", there)
        for robot in far:
            run("ip", "-n", there, "addr", "add", f"{robot.host}/32", "dev", "lo")
        near = Controllers(steady, folder)
        controllers = Controllers(far, folder, ("ip", "netns", "exec", there))
        for one in (near, controllers):
            stack.push_async_callback(one.kill)
            await one.start()
        running = await stack.enter_async_context(gateway(configured([*steady, *far]), folder))
        names = frozenset(robot.name for robot in steady)
        stage = NetStage(running, tasks, folder, names, link, there, controllers, tuple(robot.name for robot in far))
        await stack.enter_async_context(stage.watched({*names, *stage.far}))
        yield stage


def _subnet() -> str:
    """The first three bytes of a network for measurements (RFC 2544) that no other run uses."""
    return f"198.{18 + os.getpid() // 256 % 2}.{os.getpid() % 256}"


async def _all_back(stage: NetStage, since_s: float) -> float:
    """Wait until every far robot is back; how long that took."""
    return max([await stage.watch.back(name, since_s, _BACK_S) for name in stage.far])


async def _bad_weather(weather: Weather, stage: NetStage, random: Random) -> Seen:
    counts = stage.link.counts.copy()
    async with stage.striking(*stage.far):
        stage.link.weather = weather
        try:
            await anyio.sleep(_WEATHER_S)
        finally:
            stage.link.weather = FAIR
        recovery_s = await _all_back(stage, time.monotonic())
        await anyio.sleep(weather.delay_s + weather.jitter_s)
    found = stage.link.counts - counts
    packets = found.pop("packets", 0)
    return Seen(
        recovery_s,
        f"of {packets} packets " + (", ".join(f"{count} {name}" for name, count in found.items()) or "none lost"),
    )


async def cut(stage: NetStage, random: Random) -> Seen:
    """Nothing gets through for a while, and nobody is told."""
    async with stage.striking(*stage.far):
        stage.link.weather = Weather(cut=True)
        try:
            for name in stage.far:
                await stage.watch.lost(name, _LOST_S)
        finally:
            stage.link.weather = FAIR
        recovery_s = await _all_back(stage, time.monotonic())
    return Seen(recovery_s, "stale, then on again")


async def half_open(stage: NetStage, random: Random) -> Seen:
    """The controllers are started anew while their packets are dropped: no FIN and no RST ever tells of it."""
    async with stage.striking(*stage.far):
        run("ip", "netns", "exec", stage.namespace, "nft", "-f", "-", text=_DROPPING)
        try:
            await stage.controllers.kill()
            for name in stage.far:
                await stage.watch.lost(name, _LOST_S)
            await stage.controllers.start()
        finally:
            run("ip", "netns", "exec", stage.namespace, "nft", "flush", "ruleset")
        recovery_s = await _all_back(stage, time.monotonic())
    return Seen(recovery_s, "stale, or noticed by keep-alive; reconnected")


async def unplugged(stage: NetStage, random: Random) -> Seen:
    """The device is down for a while: there is no route to the controllers."""
    async with stage.striking(*stage.far):
        run("ip", "-n", stage.namespace, "link", "set", stage.namespace, "down")
        try:
            for name in stage.far:
                await stage.watch.lost(name, _LOST_S)
            await anyio.sleep(random.uniform(0.0, 2.0))
        finally:
            run("ip", "-n", stage.namespace, "link", "set", stage.namespace, "up")
        recovery_s = await _all_back(stage, time.monotonic())
    return Seen(recovery_s, "stale, then on again")


NETWORK = Series(
    name="network",
    open=network,
    faults=(
        Fault(name="10 % loss", strike=partial(_bad_weather, Weather(loss=0.1))),
        Fault(name="200 ± 100 ms delay", strike=partial(_bad_weather, Weather(delay_s=0.2, jitter_s=0.1))),
        Fault(name="reordering", strike=partial(_bad_weather, Weather(delay_s=0.02, reorder=0.3))),
        Fault(name="duplication", strike=partial(_bad_weather, Weather(duplicate=0.3))),
        Fault(name="corruption", strike=partial(_bad_weather, Weather(corrupt=0.1))),
        Fault(name="cut", strike=cut),
        Fault(name="half-open connections", strike=half_open),
        Fault(name="cable pulled", strike=unplugged),
    ),
)
