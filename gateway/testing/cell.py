"""A gateway with virtual robots, for tests of this project and of integrators.

    async with virtual_cell("rainbow", count=2) as cell, connect(cell.url) as client:
        await client.subscribe(["*/joints"])

Context managers for the test's own body, never fixtures: a fixture would close the task group in another task.
"""

from __future__ import annotations

import socket
from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import dataclass
from typing import cast

import msgspec

from gateway.api.vendor import Transport
from gateway.app import Gateway, running
from gateway.config import parse
from gateway.config.printing import toml_value
from gateway.core.registry import Registry
from gateway.core.settings import RobotSettings
from gateway.core.tap import Tap
from gateway.sim.chaos import CALM, ChaosPlan
from gateway.sim.scenario import Scenario
from gateway.sim.server import VirtualController, serve
from gateway.sim.simulator import Simulator


@dataclass(frozen=True, slots=True)
class VirtualCell:
    """A running gateway and the virtual controllers that it reads.

    Attributes:
        gateway: Its bus and doors.
        controllers: Named r1, r2 … in the gateway.
    """

    gateway: Gateway
    controllers: tuple[VirtualController, ...]

    @property
    def url(self) -> str:
        """The native WebSocket door."""
        return self.gateway.url


@asynccontextmanager
async def virtual_cell(
    vendor: str,
    *,
    protocol: str | None = None,
    count: int = 1,
    host: str = "127.0.0.2",
    scenario: str | Scenario = "cell",
    chaos: str | ChaosPlan = CALM,
    seed: int = 0,
    keep: int = 0,
    settings: Mapping[str, object] | None = None,
    server: Mapping[str, object] | None = None,
    recorder: Mapping[str, object] | None = None,
    simulated: msgspec.Struct | None = None,
    registry: Registry | None = None,
    tap_of: Callable[[RobotSettings], Tap | None] | None = None,
) -> AsyncIterator[VirtualCell]:
    """Run virtual controllers and a gateway that reads them, all on free ports of this machine.

    Args:
        vendor: Name of the plugin.
        protocol: What is spoken; None: the vendor's default.
        count: How many controllers, on consecutive addresses.
        host: Address of the first.
        scenario: What happens to the robots.
        chaos: The chaos that the connections suffer.
        seed: For what is random.
        keep: How many of the last frames each controller keeps with what they meant.
        settings: Further keys of each robot's entry in the configuration, such as `rate_hz`, or `cnde` for the table of
            that protocol's options.
        server: Further keys of the table `[server]`, such as `tokens`; it listens on a free port of this
            machine unless `listen` says otherwise.
        recorder: Keys of the table `[recorder]`.
        simulated: Options of the virtual controllers; None: their defaults.
        registry: Where the plugin is found.
        tap_of: Gives what is shown every byte of a robot's sessions; None: the recorder does.

    Raises:
        VendorError: The plugin or its virtual controller cannot be loaded.
        ConfigError: The settings do not fit.
    """
    registry = registry or Registry()
    simulator = cast("Simulator", registry.simulator(vendor))
    chosen = protocol or registry.vendor(vendor).protocol().name
    keys = {**simulator.keys(chosen), **(settings or {})}
    transport = _transport(registry, vendor, chosen, keys)
    ports = [free_port() if transport == "tcp_server" else 0 for _ in range(count)]
    async with AsyncExitStack() as stack:
        controllers = await stack.enter_async_context(
            serve(
                simulator,
                host=host,
                port=0,
                count=count,
                options=simulated,
                scenario=scenario,
                chaos=chaos,
                seed=seed,
                keep=keep,
                calls=lambda number: {chosen: ("127.0.0.1", ports[number])} if ports[number] else {},
            ),
        )
        doors = {"listen": "127.0.0.1:0", **(server or {})}
        text = "[server]\n" + "".join(f"{key} = {toml_value(value)}\n" for key, value in doors.items())
        text += "[recorder]\n" + "".join(f"{key} = {toml_value(value)}\n" for key, value in (recorder or {}).items())
        for number, controller in enumerate(controllers, start=1):
            entry = {
                "name": f"r{number}",
                "vendor": vendor,
                "protocol": chosen,
                "host": controller.host,
                **keys,
                "port": controller.number_of(chosen, transport),
            }
            text += "\n[[robots]]\n" + "".join(f"{key} = {toml_value(value)}\n" for key, value in entry.items())
        gateway = await stack.enter_async_context(running(parse(text, "virtual cell", registry), tap_of=tap_of))
        yield VirtualCell(gateway, controllers)


def free_port() -> int:
    """A port of this machine that nothing listens on."""
    with socket.create_server(("127.0.0.1", 0)) as found:
        return int(found.getsockname()[1])


def _transport(registry: Registry, vendor: str, protocol: str, keys: Mapping[str, object]) -> Transport:
    """What robots with some keys of the configuration are reached over."""
    spoken = registry.vendor(vendor).protocol(protocol)
    return spoken.transport(msgspec.convert(keys.get(protocol, {}), spoken.options))
