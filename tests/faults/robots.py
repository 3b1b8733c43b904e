"""Virtual controllers in processes of their own, so that they can be killed and stopped, and their robots' entries.

    python -m tests.faults.robots '[{"vendor": "rainbow", "host": "127.0.3.4", …}]'

It says `serving` when every one listens.
"""

from __future__ import annotations

import sys
from collections.abc import AsyncIterator, Mapping, Sequence
from contextlib import AsyncExitStack, asynccontextmanager
from functools import cache
from pathlib import Path
from subprocess import Popen
from typing import cast

import anyio
import msgspec

from gateway.config.printing import toml_value
from gateway.core.registry import Registry
from gateway.sim.server import serve
from gateway.sim.simulator import Simulator
from tests.faults.processes import said, spawned

# What a healthy robot may be late by on a busy machine before its silence is called so.
PATIENT_S = 5.0
_PERIOD_MS = 20
_RATES: dict[tuple[str, str], dict[str, object]] = {
    ("rainbow", "reqdata"): {"rate_hz": 50},
    ("fairino", "cnde"): {"cnde": {"period_ms": _PERIOD_MS}},
}


class Robot(msgspec.Struct, frozen=True, kw_only=True):
    """One robot of the cell with its virtual controller.

    Attributes:
        name: In the configuration.
        vendor: The plugin.
        protocol: What is spoken.
        host: Address of the controller; each has its own, and the vendor's ports.
        calls: The port of the gateway that it calls, where it calls.
        chaos: What the bytes that it sends suffer.
        seen_at: Host and port that the gateway is told, where that is another.
        keys: Further keys of its entry.
    """

    name: str
    vendor: str
    protocol: str
    host: str
    calls: int | None = None
    chaos: str = ""
    seen_at: tuple[str, int] | None = None
    keys: dict[str, object] = {}

    @property
    def port(self) -> int:
        """The port of its protocol."""
        transport = "udp" if "udp" in str(self.keys) else "tcp"
        ports = _simulator(self.vendor).ports
        return next(port.port for port in ports if (port.protocol, port.transport) == (self.protocol, transport))

    @property
    def entry(self) -> str:
        """Its entry in the configuration."""
        host, port = self.seen_at or (self.host, self.calls or self.port)
        usual = {**_simulator(self.vendor).keys(self.protocol), **_RATES.get((self.vendor, self.protocol), {})}
        own: dict[str, object] = {**usual, **_deep(usual, self.keys)}
        if self.calls:
            own = {**own, **_deep(own, {self.protocol: {"role": "server"}})}
        entry = {
            "name": self.name,
            "vendor": self.vendor,
            "protocol": self.protocol,
            "host": host,
            **own,
            "port": port,
        }
        return "\n[[robots]]\n" + "".join(f"{key} = {toml_value(value)}\n" for key, value in entry.items())


def configured(
    robots: Sequence[Robot], more: str = "", listen: str = "127.0.0.1:0", top: str = "", server: str = ""
) -> str:
    """The configuration of a gateway that reads some robots.

    Args:
        robots: They.
        more: Further entries.
        listen: Where its doors are.
        top: What stands before all tables.
        server: Further lines of the server's table.
    """
    return top + f'[server]\nlisten = "{listen}"\n{server}' + "".join(robot.entry for robot in robots) + more


class Controllers:
    """The process of some virtual controllers, which can be started anew.

    Args:
        robots: Theirs.
        folder: Takes the log.
        prefix: What is run before it and becomes it, such as `ip netns exec`.
    """

    def __init__(self, robots: Sequence[Robot], folder: Path, prefix: Sequence[str] = ()) -> None:
        self.robots = tuple(robots)
        self._folder = folder
        self._prefix = prefix
        self._stack = AsyncExitStack()
        self._starts = 0
        self.process: Popen[bytes] | None = None

    async def start(self) -> None:
        """Serve; returns when every controller listens."""
        self._starts += 1
        log = self._folder / f"controllers-{self.robots[0].name}-{self._starts}.log"
        asked = msgspec.json.encode(self.robots).decode()
        command = [*self._prefix, sys.executable, "-m", "tests.faults.robots", asked]
        self.process = self._stack.enter_context(spawned(command, log))
        await said(log, "serving", self.process)

    def send(self, number: int) -> None:
        """Send the process a signal."""
        assert self.process is not None
        self.process.send_signal(number)

    async def kill(self) -> None:
        """Kill the process: the system closes its connections."""
        stack, self._stack = self._stack, AsyncExitStack()
        await stack.aclose()


@asynccontextmanager
async def serving(robots: Sequence[Robot], folder: Path, prefix: Sequence[str] = ()) -> AsyncIterator[Controllers]:
    """Run the virtual controllers of some robots in one process."""
    controllers = Controllers(robots, folder, prefix)
    try:
        await controllers.start()
        yield controllers
    finally:
        await controllers.kill()


@cache  # finding plugins takes its time
def _simulator(vendor: str) -> Simulator:
    return cast("Simulator", Registry().simulator(vendor))


def _deep(usual: Mapping[str, object], keys: Mapping[str, object]) -> dict[str, object]:
    """Keys, where those that are tables are added to the usual ones."""
    merged: dict[str, object] = {}
    for key, value in keys.items():
        before = usual.get(key)
        both = isinstance(value, Mapping) and isinstance(before, Mapping)
        merged[key] = {**cast("Mapping[str, object]", before), **cast("Mapping[str, object]", value)} if both else value
    return merged


async def _serve(robots: Sequence[Robot]) -> None:
    async with AsyncExitStack() as stack:
        for number, robot in enumerate(robots):
            calls = {robot.protocol: ("127.0.0.1", robot.calls)} if robot.calls else {}
            await stack.enter_async_context(
                serve(
                    _simulator(robot.vendor),
                    host=robot.host,
                    chaos=robot.chaos,
                    seed=number,
                    calls=lambda _, calls=calls: calls,  # type: ignore[misc]  # bound for each
                )
            )
        print("serving", flush=True)
        await anyio.sleep_forever()


if __name__ == "__main__":
    anyio.run(_serve, msgspec.json.decode(sys.argv[1], type=list[Robot]), backend_options={"use_uvloop": True})
