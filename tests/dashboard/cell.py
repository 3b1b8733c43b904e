"""A cell of eight virtual robots of all vendors: most at work, one in emergency stop, one to be lost."""

from __future__ import annotations

from collections.abc import AsyncIterator, Mapping
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import dataclass, field
from typing import cast

from gateway.api.model import Power, ProgramState
from gateway.app import Gateway, running
from gateway.config import parse
from gateway.config.printing import toml_value
from gateway.core.registry import Registry
from gateway.sim.scenario import Fault, FaultKind, Phase, Scenario
from gateway.sim.server import VirtualController, serve
from gateway.sim.simulator import Simulator

_HOUR_S = 3600
_ESTOP = Scenario("held", "", (Phase(name="emergency stop", seconds=_HOUR_S, power=Power.OFF, estop=True),))
_PAUSED = Scenario("held", "", (Phase(name="paused", seconds=_HOUR_S, program=ProgramState.PAUSED),))
_BROKEN = Scenario("held", "", (Phase(name="fault", seconds=_HOUR_S, fault=Fault(FaultKind.OVER_CURRENT, 2)),))
LOST = "press-1"
ESTOPPED = "weld-2"


@dataclass(frozen=True, slots=True)
class _Entry:
    """One virtual robot and how the gateway reads it."""

    name: str
    vendor: str
    protocol: str
    scenario: str | Scenario = "steady"
    keys: Mapping[str, object] = field(default_factory=dict)


_CELL = (
    _Entry("weld-1", "rainbow", "reqdata", "steady", {"estop_polarity": "active_low"}),
    _Entry(ESTOPPED, "rainbow", "reqdata", _ESTOP, {"estop_polarity": "active_low"}),
    _Entry("pick-1", "fairino", "cnde"),
    _Entry("pick-2", "fairino", "cnde", _BROKEN),
    _Entry(LOST, "fairino", "legacy"),
    _Entry("glue-1", "xcore", "objects"),
    _Entry(
        "glue-2", "xcore", "external", _PAUSED, {"estop_polarity": "active_high", "external": {"torque_unit": "Nm"}}
    ),
    _Entry("teach-1", "fairino", "status", "freedrive"),
)


@dataclass(slots=True)
class EightRobots:
    """A running gateway and its robots.

    Attributes:
        gateway: Its bus and doors.
        controllers: By the robot's name; one that is stopped is a lost link.
    """

    gateway: Gateway
    controllers: dict[str, VirtualController]


@asynccontextmanager
async def eight_robots(port: int = 0) -> AsyncIterator[EightRobots]:
    """Run eight virtual robots and a gateway that reads them.

    Args:
        port: Where its doors are; 0 takes a free port.
    """
    registry = Registry()
    text = f'[server]\nlisten = "127.0.0.1:{port}"\n'
    controllers: dict[str, VirtualController] = {}
    async with AsyncExitStack() as everything:
        for number, entry in enumerate(_CELL):
            simulator = cast("Simulator", registry.simulator(entry.vendor))
            served = serve(
                simulator, host=f"127.0.0.{2 + number}", port=0, scenario=entry.scenario, calls=lambda _number: {}
            )
            (controller,) = await everything.enter_async_context(served)
            controllers[entry.name] = controller
            keys = {
                "name": entry.name,
                "vendor": entry.vendor,
                "protocol": entry.protocol,
                "host": controller.host,
                **simulator.keys(entry.protocol),
                **dict(entry.keys),
                "port": controller.number_of(entry.protocol, "tcp"),
            }
            text += "\n[[robots]]\n" + "".join(f"{key} = {toml_value(value)}\n" for key, value in keys.items())
        gateway = await everything.enter_async_context(running(parse(text, "eight robots", registry)))
        yield EightRobots(gateway, controllers)
