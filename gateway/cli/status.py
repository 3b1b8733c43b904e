"""`robot-gateway status`: which robot is on, what it does, and why not."""

from __future__ import annotations

import difflib
import sys
import time
from collections.abc import Iterable
from functools import partial
from typing import Annotated

import msgspec
import typer

from gateway.api.model import LinkState, Sample
from gateway.cli.common import DEFAULT_URL, USAGE, Ca, TokenFile, Url, call, fail, tell, terminal, way
from gateway.cli.measured import Measured
from gateway.cli.nats import Credentials, NatsUrl, PlantName, access_of
from gateway.cli.view import INSECURE, export_lines, recorder_line, robots_table
from gateway.cli.watch import watch as watch_cell
from gateway.cli.why import explain
from gateway.client import CellInfo, Client, Way, connect


def status(
    url: Url = DEFAULT_URL,
    *,
    watch: Annotated[
        bool, typer.Option("--watch", "-w", help="Keep showing it until Ctrl-C; into a pipe: a block a second.")
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print everything as JSON, for programs.")] = False,
    why: Annotated[
        str | None,
        typer.Option(metavar="ROBOT", help="Explain one robot's link: what happened, and what to check next."),
    ] = None,
    token_file: TokenFile = None,
    ca: Ca = None,
    nats: NatsUrl = None,
    plant: PlantName = None,
    credentials: Credentials = None,
) -> None:
    """Show every robot of a running gateway: link, rate, power, motion, program and safety.

    A dash means: this robot cannot tell. With a token only its robots are shown. Exit code 1: no gateway answers, or it
    has no such robot.

    \b
    Examples:
      robot-gateway status
      robot-gateway status --watch
      robot-gateway status --why r1
      robot-gateway status --url wss://cell-7:8765/ws --token-file hmi.token
      robot-gateway status --nats nats://plant.example.com --plant plant1
      robot-gateway status --json | jq '.[] | [.name, .link.state]'
    """  # noqa: D301 - the \b keeps the lines apart
    if watch and as_json:
        fail(
            "--watch is for people and --json for programs: take one of them, or `robot-gateway tail --format json`",
            USAGE,
        )
    if why is not None and (watch or as_json):
        fail("--why explains one robot to people, once: leave out --watch and --json", USAGE)
    if nats is not None:
        from gateway.cli.plant_view import plant_status  # noqa: PLC0415 - nats-py may not be there

        plant_status(access_of(nats, credentials, ca), plant, as_json=as_json)
        return
    gateway = way(url, token_file, ca)
    if why is not None:
        call(partial(_why, gateway, why))
    elif watch:
        call(partial(watch_cell, gateway))
    else:
        call(partial(_once, gateway, as_json=as_json))


async def _once(gateway: Way, *, as_json: bool) -> None:
    async with connect(gateway) as client:
        _warn(client)
        (robots, recorder, exports), latest = await _ask(client)
    if as_json:
        shown = [
            {
                **msgspec.to_builtins(robot),
                "status": _data(latest, robot.name, "status"),
                "safety": _data(latest, robot.name, "safety"),
            }
            for robot in robots
        ]
        sys.stdout.write(msgspec.json.format(msgspec.json.encode(shown), indent=2).decode() + "\n")
        return
    console = terminal()
    console.print(robots_table(robots, latest, _now_us(), console.width))
    for line in export_lines(exports, _now_us()):
        console.print(line)
    if (said := recorder_line(recorder)) is not None:
        console.print(said)


def _warn(client: Client) -> None:
    """Say again what the gateway was told in its configuration; on stderr, where it is in no program's way."""
    if client.welcome.access == "insecure":
        tell("insecure:", "yellow", INSECURE)


async def _why(gateway: Way, name: str) -> None:
    async with connect(gateway) as client:
        _warn(client)
        robots = {robot.name: robot for robot in await client.robots()}
        robot = robots.get(name)
        measured = None
        if robot is not None and robot.link.state is not LinkState.FAULTED and "link_stats" in robot.groups:
            measured = await Measured.during(client, name)
            robot = next(one for one in await client.robots() if one.name == name)
    if robot is None:
        near = difflib.get_close_matches(name, robots, n=1)
        fail(
            f'there is no robot "{name}"; '
            + (f'did you mean "{near[0]}"?' if near else f"there are: {_listed(robots)}")
        )
    for line in explain(robot, _now_us(), terminal().width, measured):
        sys.stdout.write(f"{line}\n")


async def _ask(client: Client) -> tuple[CellInfo, dict[str, Sample]]:
    cell = await client.cell()
    wanted = [
        f"{robot.name}/{group}" for robot in cell.robots for group in ("status", "safety") if group in robot.groups
    ]
    latest = await client.get(wanted) if wanted else []
    return cell, {sample.topic: sample for sample in latest}


def _now_us() -> int:
    return time.time_ns() // 1000


def _data(latest: dict[str, Sample], robot: str, group: str) -> object:
    sample = latest.get(f"{robot}/{group}")
    return None if sample is None else sample.data


def _listed(names: Iterable[str]) -> str:
    return ", ".join(names) or "none"
