"""`robot-gateway simulate VENDOR`: virtual controllers on real sockets.

The subcommands are the vendors that the registry finds; a vendor's own options are fields of its simulator's struct.
"""

from __future__ import annotations

import inspect
import signal
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from textwrap import indent
from typing import Annotated, TypedDict, cast

import anyio
import msgspec
import typer
from typer.core import TyperCommand, TyperGroup

from gateway.cli.common import fail, tell
from gateway.cli.struct_options import VendorDirs, checked, command, parameters, read, registry_of
from gateway.core.registry import Registry
from gateway.errors import UnknownVendor, VendorError
from gateway.sim.chaos import ChaosPlan, explain, parse_chaos
from gateway.sim.scenario import SCENARIOS, Scenario, find_scenario
from gateway.sim.server import SimulatorError, VirtualController, addresses, serve
from gateway.sim.simulator import Simulator

_GROUP_HELP = """Run virtual controllers on real sockets, for trials, demos and tests.

Each vendor is a command with options of its own: see robot-gateway simulate VENDOR --help.

\b
Examples:
  robot-gateway simulate rainbow
  robot-gateway simulate rainbow --count 16 --scenario steady
"""

_VENDOR_HELP = """Run virtual {vendor} controllers until Ctrl-C.

\b
Examples:
  robot-gateway simulate {vendor}
  robot-gateway simulate {vendor} --host 127.0.0.2 --count 16
  robot-gateway simulate {vendor} --chaos junk=0.05,cut=5 --seed 7

\b
Scenarios:
{scenarios}

\b
Chaos (RATE is for each frame, 0 to 1; times in seconds):
{chaos}
"""


class VendorGroup(TyperGroup):
    """A group whose subcommands are the vendors, each made when it is asked for."""

    def list_commands(self, ctx: object) -> list[str]:
        """Return the names of the vendors."""
        return registry_of(ctx).names()

    def get_command(self, ctx: object, cmd_name: str) -> TyperCommand | None:
        """Make the command of a vendor; that of a broken vendor says what is wrong with it."""
        registry = registry_of(ctx)
        try:
            return _runner(cmd_name, _simulator(registry, cmd_name))
        except UnknownVendor as error:
            raise typer.BadParameter(error.reason, param_hint=f"VENDOR {cmd_name}") from None
        except VendorError as error:
            return _broken(cmd_name, error)


app = typer.Typer(
    cls=VendorGroup,
    help=_GROUP_HELP,
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)


@app.callback()
def choose(vendor_dir: VendorDirs = None) -> None:
    """Take the options of the group: it has read them to find the vendors."""


class _Common(TypedDict):
    host: str
    port: int | None
    count: int
    scenario: Scenario
    chaos: ChaosPlan
    seed: int
    seconds: float | None


@dataclass(frozen=True, slots=True, kw_only=True)
class _Order:
    """What is to be served, checked."""

    vendor: str
    simulator: Simulator
    options: msgspec.Struct
    common: _Common


def _common(
    *,
    host: Annotated[str, typer.Option(help="Address of the first controller; the others follow it.")] = "127.0.0.2",
    port: Annotated[
        int | None,
        typer.Option(min=0, max=65535, help="Main port, the vendor's if not given; 0 lets the system choose."),
    ] = None,
    count: Annotated[int, typer.Option(min=1, help="How many controllers, on consecutive addresses.")] = 1,
    scenario: Annotated[str, typer.Option(help="What happens to the robots: one of those above.")] = "cell",
    chaos: Annotated[str, typer.Option(metavar="NAME=VALUE,…", help="Faults of what is sent: see above.")] = "",
    seed: Annotated[int, typer.Option(help="For what is random: the same seed, the same faults.")] = 0,
    seconds: Annotated[float | None, typer.Option(min=0, help="End after so many seconds.")] = None,
) -> _Common:
    """Check the options that every vendor has, by their parameters."""
    checked("--host", partial(addresses, host, count))
    return {
        "host": host,
        "port": port,
        "count": count,
        "scenario": checked("--scenario", partial(find_scenario, scenario)),
        "chaos": checked("--chaos", partial(parse_chaos, chaos)),
        "seed": seed,
        "seconds": seconds,
    }


def _runner(vendor: str, simulator: Simulator) -> TyperCommand:
    """Make the command that runs a vendor's virtual controllers."""
    own = list(parameters(simulator.options))
    common = list(inspect.signature(_common, eval_str=True).parameters.values())
    clash = sorted({parameter.name for parameter in own} & {parameter.name for parameter in common})
    if clash:
        return _broken(
            vendor, VendorError(vendor, f"its simulator's options {', '.join(clash)} have names that are taken")
        )

    def run(**values: object) -> None:
        mine = {parameter.name: values.pop(parameter.name) for parameter in own}
        common_values = cast("Callable[..., _Common]", _common)(**values)
        options = read(simulator.options, mine)
        order = _Order(vendor=vendor, simulator=simulator, options=options, common=common_values)
        checked("--port", partial(simulator.port_numbers, order.common["port"]))
        try:
            anyio.run(_serve, order, backend_options={"use_uvloop": True})
        except SimulatorError as error:
            fail(str(error))

    width = max(map(len, SCENARIOS))
    scenarios = "\n".join(f"  {found.name:{width}}  {found.meaning}" for found in SCENARIOS.values())
    return command(
        vendor,
        _VENDOR_HELP.format(vendor=vendor, scenarios=scenarios, chaos=indent(explain(), "  ")),
        [*common, *own],
        run,
    )


def _broken(vendor: str, error: VendorError) -> TyperCommand:
    """Make the command of a vendor that cannot be simulated."""

    def run() -> None:
        fail(str(error))

    return command(vendor, f"Cannot be simulated: {error.reason}", [], run)


def _simulator(registry: Registry, vendor: str) -> Simulator:
    found = registry.simulator(vendor)
    if not isinstance(found, Simulator):
        raise VendorError(vendor, f"its SIMULATOR is no Simulator record but {type(found).__name__}")
    return found


async def _serve(order: _Order) -> None:
    """Serve until a signal comes or the time is over, and say what was sent."""
    common = order.common
    with anyio.open_signal_receiver(signal.SIGINT, signal.SIGTERM) as signals:
        async with serve(
            order.simulator,
            options=order.options,
            host=common["host"],
            port=common["port"],
            count=common["count"],
            scenario=common["scenario"],
            chaos=common["chaos"],
            seed=common["seed"],
        ) as controllers:
            for controller in controllers:
                _announce(order.vendor, controller)
            with anyio.move_on_after(common["seconds"]):
                await anext(aiter(signals))
    frames = sum(controller.robot.frames for controller in controllers)
    connections = sum(controller.robot.connections for controller in controllers)
    faults: Counter[str] = sum((controller.robot.faults for controller in controllers), Counter())
    struck = "".join(f", {name} {number}" for name, number in sorted(faults.items()))
    typer.echo(f"sent {frames} frames on {connections} connections{struck}")


def _announce(vendor: str, controller: VirtualController) -> None:
    host = controller.host
    ports = [f"{host}:{port} ({protocol or 'no state'})" for protocol, port in controller.ports]
    calls = [f"{host} calls {gateway} ({protocol or 'no state'})" for protocol, gateway in controller.calls]
    typer.echo(f"{vendor} {', '.join((*ports, *calls))}")
    for problem in controller.missing:
        tell("warning:", "yellow", f"goes on without {problem}")
