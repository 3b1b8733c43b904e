"""Faults of plugins: they raise at each of their entry points, cannot be loaded, or block the loop."""

from __future__ import annotations

import shutil
import struct
import time
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from random import Random

import aiohttp
import anyio
import msgspec
from anyio.abc import SocketStream

from tests.faults.cell import hosts, steady_robots
from tests.faults.kit import Fault, Series, Stage
from tests.faults.processes import gateway
from tests.faults.relay import listening
from tests.faults.report import Seen
from tests.faults.robots import Controllers, configured

_FOLDER = Path(__file__).parent / "bad_plugins"
_PERIOD_S = 0.02
_FRAME = struct.pack("<BHBffI", 0x24, 12, 3, 1.0, 2.0, 7)
# Refused and faulted links are tried again every 10 s.
_BACK_S = 13.0
_SHOWN_S = 3.0
_BLOCK_S = 3.0
# entry point -> the state of the link while it raises: of a session that may be closed, and of one that is kept.
# Some are asked only what nothing depends on: then the link stays as it is.
_STATES = {
    "decoder": ("FAULTED", "FAULTED"),
    "feed": ("FAULTED", "REFUSED"),
    "tick": ("FAULTED", "ONLINE"),  # kept: the next good frame ends the trouble
    "outgoing": ("FAULTED", "ONLINE"),
    "end": ("FAULTED", ""),
    "goodbye": ("FAULTED", ""),
    "ready": ("ONLINE", "ONLINE"),
    "notes": ("ONLINE", "ONLINE"),
    "gaps": ("ONLINE", "ONLINE"),
}
# Entry points that are reached when a session ends or begins.
_AT_THE_ENDS = frozenset({"decoder", "end", "goodbye"})
_UNLOADABLE = ("early", "exits", "nothing", "maker")


class Pusher:
    """A controller that pushes the same frame for ever, to whoever connects."""

    def __init__(self) -> None:
        self._streams: set[SocketStream] = set()

    async def serve(self, stream: SocketStream) -> None:
        """Serve one connection."""
        self._streams.add(stream)
        try:
            async with stream:
                while True:
                    await stream.send(_FRAME)
                    await anyio.sleep(_PERIOD_S)
        except (anyio.BrokenResourceError, anyio.ClosedResourceError):
            return
        finally:
            self._streams.discard(stream)

    async def cut(self) -> None:
        """End every connection."""
        for stream in list(self._streams):
            await stream.aclose()


@dataclass
class PluginStage(Stage):
    """A gateway with robots of a vendor that breaks on demand.

    Attributes:
        pushers: Their controllers, by entry point.
    """

    pushers: dict[str, Pusher]

    def flag(self, entry_point: str) -> Path:
        """The file while which an entry point raises."""
        return self.folder / f"breaks-{entry_point}"

    async def state(self, robot: str) -> tuple[str, str]:
        """State of a robot's link, and its reason."""
        _, text = await self.gateway.fetched(f"/api/v1/robots/{robot}")
        link = msgspec.json.decode(text)["link"]
        return str(link["state"]), str(link["reason"])


@asynccontextmanager
async def plugins(folder: Path) -> AsyncIterator[PluginStage]:
    """Run the cell with bad plugins in it."""
    steady = steady_robots(hosts(80))
    vendor_dir = folder / "plugins"
    shutil.copytree(_FOLDER, vendor_dir, ignore=shutil.ignore_patterns("__pycache__"))
    for path in (vendor_dir, *vendor_dir.rglob("*")):
        path.chmod(0o700)
    async with AsyncExitStack() as stack:
        tasks = await stack.enter_async_context(anyio.create_task_group())
        near = Controllers(steady, folder)
        stack.push_async_callback(near.kill)
        await near.start()
        pushers, entries, fickle = {}, "", set()
        for entry_point in (*_STATES, "block", "signal"):
            pusher = pushers[entry_point] = Pusher()
            protocols = (
                ("close", "keep") if entry_point in _STATES else ("signal" if entry_point == "signal" else "close",)
            )
            for protocol in protocols:
                name = f"{entry_point}-{protocol}"
                port = await stack.enter_async_context(listening(tasks, pusher.serve))
                options = f'at = "{entry_point}"\nwhile_there = "{folder / f"breaks-{entry_point}"}"\n'
                entries += _entry(name, "fickle", protocol, port) + f"[robots.{protocol}]\n{options}"
                fickle.add(name)
        for vendor in _UNLOADABLE:
            port = await stack.enter_async_context(listening(tasks, Pusher().serve))
            entries += _entry(vendor, vendor, None, port)
        text = configured(steady, entries, top=f'vendor_dirs = ["{vendor_dir}"]\n')
        running = await stack.enter_async_context(gateway(text, folder))
        names = frozenset(robot.name for robot in steady)
        stage = PluginStage(running, tasks, folder, names, pushers)
        await stack.enter_async_context(stage.watched({*names, *fickle}))
        yield stage


def _entry(name: str, vendor: str, protocol: str | None, port: int) -> str:
    said = f'protocol = "{protocol}"\n' if protocol else ""
    return f'\n[[robots]]\nname = "{name}"\nvendor = "{vendor}"\n{said}host = "127.0.0.1"\nport = {port}\n'


async def raising(entry_points: tuple[str, ...], stage: PluginStage, random: Random) -> Seen:
    """A plugin raises at some entry points, in sessions that may be closed and in those that are kept."""
    robots = [f"{entry_point}-{protocol}" for entry_point in entry_points for protocol in ("close", "keep")]
    async with stage.striking(*robots):
        for entry_point in entry_points:
            stage.flag(entry_point).touch()
        try:
            for entry_point in _AT_THE_ENDS.intersection(entry_points):
                await stage.pushers[entry_point].cut()
            await _shown(stage, entry_points)
        finally:
            for entry_point in entry_points:
                stage.flag(entry_point).unlink()
        since_s = time.monotonic()
        recovery_s = max([await stage.watch.back(robot, since_s, _BACK_S) for robot in robots])
    return Seen(recovery_s, "that link only: FAULTED and retried, or kept open and REFUSED; back when the plugin is")


async def _shown(stage: PluginStage, entry_points: tuple[str, ...]) -> None:
    """Wait until the links say what the plugin does."""
    waiting = {
        f"{entry_point}-{protocol}": state
        for entry_point in entry_points
        for protocol, state in zip(("close", "keep"), _STATES[entry_point], strict=True)
        if state
    }
    since_s = time.monotonic()
    await anyio.sleep(0.5)
    found: dict[str, tuple[str, str]] = {}
    while time.monotonic() < since_s + _SHOWN_S:
        found = {robot: await stage.state(robot) for robot in waiting}
        if all(found[robot][0] == state for robot, state in waiting.items()):
            return
        await anyio.sleep(0.1)
    wrong = {robot: found[robot] for robot, state in waiting.items() if found[robot][0] != state}
    raise AssertionError(f"while the plugin raises: {wrong}")


async def unloadable(stage: PluginStage, random: Random) -> Seen:
    """Plugins that raise at their import, end the process, export nothing, or make no decoders."""
    states = {vendor: await stage.state(vendor) for vendor in _UNLOADABLE}
    assert all(state == "FAULTED" and reason != "None" for state, reason in states.values()), states
    return Seen(note=f"those robots only, FAULTED with the reason: {states['early'][1]!r}")


async def false_signal(stage: PluginStage, random: Random) -> Seen:
    """A function of a signal row raises for every frame."""
    _, text = await stage.gateway.fetched("/api/v1/topics/signal-signal/status")
    assert '"q":"BAD"' in text, text
    assert (await stage.state("signal-signal"))[0] == "ONLINE"
    return Seen(note="that group only: null with quality BAD; the other groups of the robot go on")


async def blocking(stage: PluginStage, random: Random) -> Seen:
    """A plugin blocks the loop for seconds: nothing is answered meanwhile, and nothing is lost by it."""
    before = await _late_beats(stage)
    flag = stage.flag("block")
    new = flag.with_suffix(".new")
    new.write_text(str(_BLOCK_S), "ascii")
    new.replace(flag)
    while flag.exists():  # noqa: ASYNC110 - another process removes it
        await anyio.sleep(0.005)
    since_s = time.monotonic()
    answered = await _healthy_within(stage, _BLOCK_S / 2)
    assert not answered, "/healthz was answered while the loop was blocked"
    end_s = since_s + _BLOCK_S
    recovery_s = max([await stage.watch.back(robot, end_s - 0.2, 5.0) for robot in sorted(stage.steady)]) - 0.2
    assert await _late_beats(stage) > before, "the lag of the loop is in no metric"
    status, _ = await stage.gateway.fetched("/healthz")
    assert status == 200, f"/healthz says {status} after the block"
    return Seen(
        max(0.0, recovery_s), f"{_BLOCK_S:g} s: /healthz answers nothing, the lag is in /metrics, no gap, no link lost"
    )


async def _healthy_within(stage: PluginStage, seconds: float) -> bool:
    timeout = aiohttp.ClientTimeout(total=seconds)
    try:
        async with (
            aiohttp.ClientSession(timeout=timeout) as session,
            session.get(stage.gateway.http("/healthz")) as answer,
        ):
            return answer.status == 200
    except TimeoutError:
        return False


async def _late_beats(stage: PluginStage) -> float:
    """How many beats of the loop were later than the highest bound."""
    name = "robot_gateway_loop_lag_seconds_bucket{le="
    every, shorter = await stage.gateway.metrics(f'{name}"+Inf"', f'{name}"2.5"')
    return every - shorter


_LOGS = frozenset({"link.faulted"})
PLUGINS = Series(
    name="plugins",
    open=plugins,
    faults=(
        Fault(name="plugins that cannot be loaded", strike=unloadable),
        Fault(name="a signal function raises", strike=false_signal),
        Fault(name="a plugin raises at every entry point", strike=partial(raising, tuple(_STATES)), logs=_LOGS),
        Fault(name="a plugin blocks the loop", strike=blocking),
    ),
    more=tuple(
        Fault(name=f"a plugin raises at {entry_point}", strike=partial(raising, (entry_point,)), logs=_LOGS)
        for entry_point in _STATES
    ),
)
