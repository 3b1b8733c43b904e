"""The acceptance runs of xCore: one controller read in two ways, and command objects that all arrive."""

from __future__ import annotations

import os
from collections.abc import AsyncIterator, Iterable, Iterator
from contextlib import asynccontextmanager
from typing import cast

import anyio
import pytest

from gateway.api.messages import EventMessage, Missed
from gateway.api.model import Event, EventKind
from gateway.api.rotations import quaternion_from_rpy
from gateway.app import Gateway, running
from gateway.client import Client, connect
from gateway.config import parse
from gateway.core.events import EventRing
from gateway.core.registry import Registry
from gateway.sim.scenario import Phase, Scenario
from gateway.sim.server import VirtualController, serve
from gateway.sim.simulator import Simulator
from gateway.testing.cell import virtual_cell
from vendors.xcore.simulator import SIMULATOR
from vendors.xcore.simulator.options import XcoreOptions

SOAK_S = float(os.environ.get("SOAK_SECONDS", "0"))
RUN_S = min(SOAK_S, 30.0) or 6.0
AWAY_S = 5.0 if SOAK_S else 2.0
COMMANDS_HZ = 1000
TOLERANCE = 1e-6
ROBOTS = ("r1", "r2")


def stopped_after(seconds: float) -> Scenario:
    """An arm that has moved for a while and stands still since."""
    go = Phase(name="go", seconds=seconds, rate=1.0, ramp_s=0.0)
    return Scenario("stopped", "an arm that has stopped", (go, Phase(name="still", seconds=3600, ramp_s=0.0)))


@asynccontextmanager
async def read_in_both_ways(scenario: str) -> AsyncIterator[tuple[Gateway, VirtualController]]:
    """One virtual controller as two robots of one gateway: r1 over `external`, r2 over `objects`."""
    simulator: Simulator = SIMULATOR
    async with serve(simulator, host="127.0.0.4", port=0, scenario=scenario) as (controller,):
        text = f"""
            [server]
            listen = "127.0.0.1:0"
            [[robots]]
            name = "r1"
            vendor = "xcore"
            protocol = "external"
            host = "{controller.host}"
            port = {controller.number_of("external")}
            external.torque_unit = "Nm"
            [[robots]]
            name = "r2"
            vendor = "xcore"
            protocol = "objects"
            host = "{controller.host}"
            port = {controller.number_of("objects")}
        """
        async with running(parse(text, "both ways", Registry())) as gateway:
            yield gateway, controller


async def told(client: Client, robot: str, group: str) -> dict[str, object]:
    """A group of a robot, when it tells something."""
    while True:
        samples = await client.get([f"{robot}/{group}"])
        data = cast("dict[str, object]", samples[0].data) if samples else {}
        if any(value is not None and value != [] for value in data.values()):
            return data
        await anyio.sleep(0.05)


async def test_both_ways_of_reading_one_controller_give_the_same_pose() -> None:
    async with read_in_both_ways("idle") as (gateway, _), connect(gateway.url) as client:
        poses = [cast("dict[str, list[float]]", (await told(client, robot, "tcp"))["pose"]) for robot in ("r1", "r2")]
        joints = [await told(client, robot, "joints") for robot in ("r1", "r2")]
    for part in ("position", "orientation"):
        assert poses[0][part] == pytest.approx(poses[1][part], abs=TOLERANCE)
    assert joints[0]["position"] == pytest.approx(joints[1]["position"], abs=TOLERANCE)


async def test_wherever_the_arm_stops_both_ways_tell_the_pose_of_the_arm() -> None:
    async with read_in_both_ways("idle") as (gateway, controller), connect(gateway.url) as client:
        for place_s in (2.0, 5.0, 9.0):
            controller.robot.play(stopped_after(place_s), anyio.current_time() - place_s - 1)
            arm = controller.robot.state(anyio.current_time()).tcp
            poses: list[dict[str, list[float]]] = []
            with anyio.fail_after(10):
                while not all(pose["position"] == pytest.approx(arm.position, abs=TOLERANCE) for pose in poses) or (
                    len(poses) < len(ROBOTS)
                ):
                    await anyio.sleep(0.1)
                    data = [await told(client, robot, "tcp") for robot in ROBOTS]
                    poses = [cast("dict[str, list[float]]", one["pose"]) for one in data]
            assert poses[0]["orientation"] == pytest.approx(poses[1]["orientation"], abs=TOLERANCE)
            assert poses[0]["orientation"] == pytest.approx(quaternion_from_rpy(*arm.rpy), abs=TOLERANCE)


async def commands(client: Client) -> AsyncIterator[Event]:
    """The events of the topic `commands`; nothing may be missed."""
    async for message in client.pushed():
        assert not isinstance(message, Missed)
        if isinstance(message, EventMessage):
            for event in message.events:
                yield event


def numbers(events: Iterable[Event]) -> Iterator[int]:
    """The running number that the virtual application gives to each command object; a MoveWait only takes one."""
    last = 0
    for event in events:
        if event.kind is EventKind.COMMAND_ISSUED:
            custom = cast("dict[str, dict[str, str]]", event.after)["object"].get("customInfo")
            last = int(custom.removeprefix("n-")) if custom else last + 1
            yield last


def ring(gateway: Gateway) -> EventRing:
    """Where the gateway keeps the events of the topic."""
    found = gateway.bus.topics["r1/commands"].ring
    assert found is not None
    return found


@pytest.mark.soak
@pytest.mark.limit(RUN_S + 40)
async def test_every_command_object_arrives_in_order_also_at_a_client_that_was_away() -> None:
    simulated = XcoreOptions(commands_hz=COMMANDS_HZ, commands_per_list=20)
    steady: list[Event] = []
    returning: list[Event] = []
    async with (
        virtual_cell("xcore", protocol="objects", scenario="steady", simulated=simulated) as cell,
        anyio.create_task_group() as tasks,
    ):
        first = f"{ring(cell.gateway).boot}:0"

        async def follow(found: list[Event], since: str) -> None:
            async with connect(cell.url) as client:
                await client.subscribe(["r1/commands"], since=since)
                async for event in commands(client):
                    found.append(event)  # noqa: PERF401 - others look at it meanwhile

        async def come_and_go() -> None:
            with anyio.move_on_after((RUN_S - AWAY_S) / 2):
                await follow(returning, first)
            await anyio.sleep(AWAY_S)
            await follow(returning, returning[-1].name)

        tasks.start_soon(follow, steady, first)
        tasks.start_soon(come_and_go)
        await anyio.sleep(RUN_S)
        last = ring(cell.gateway).last_seq
        with anyio.fail_after(10):
            while min(len(steady), len(returning)) < last:  # noqa: ASYNC110 - the clients' lists are no events
                await anyio.sleep(0.01)
        tasks.cancel_scope.cancel()
    for got in (steady, returning):
        assert [event.seq for event in got[:last]] == list(range(1, last + 1))
        issued = list(numbers(got))
        assert issued == list(range(issued[0], issued[0] + len(issued)))
    n_issued = sum(event.kind is EventKind.COMMAND_ISSUED for event in steady[:last])
    print(f"\n{RUN_S:g} s: {n_issued} command objects and {last - n_issued} feedbacks in order; away for {AWAY_S:g} s")
    assert n_issued > COMMANDS_HZ * RUN_S * 0.7
