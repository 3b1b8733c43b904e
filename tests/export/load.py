"""One program that is many cells: gateways' worth of samples, states and events, each through its own exporter.

`python -m tests.export.load --server nats://127.0.0.1:4222 --cells 50 --robots 8 --seconds 10 --folder /tmp/load`
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import anyio
import msgspec

from gateway import logs
from gateway.api.model import Joints, Link, LinkState, Motion, Quality, Safety, SafetyState, Sample, Status, Tcp
from gateway.core.bus import ValueReading
from tests.export.kit import Plant, exporting, now_us, settings

STEP_S = 0.1
GROUPS = ("tcp", "safety")


class Load(msgspec.Struct, kw_only=True):
    """What is simulated.

    Attributes:
        server: Address of the server.
        folder: Where the outboxes are.
        cells: How many gateways.
        robots: How many robots each.
        samples_hz: How often each exporter sends the samples of each topic.
        events_hz: How many events each cell has in a second.
        states_hz: How many changes of a state.
        seconds: How long.
        first: Number of the first cell.
    """

    server: str
    folder: str
    cells: int = 1
    robots: int = 8
    samples_hz: float = 1.0
    events_hz: float = 2.0
    states_hz: float = 2.0
    seconds: float = 10.0
    first: int = 1


def plants(load: Load) -> list[Plant]:
    """The cells."""
    made = []
    for number in range(load.first, load.first + load.cells):
        keys = {"cell": f"cell{number}", "samples_hz": load.samples_hz, "heartbeat_s": 2.0}
        plant = Plant(
            settings(load.server, Path(load.folder) / f"cell{number}", **keys),
            *(f"r{one}" for one in range(1, load.robots + 1)),
        )
        plant.bus.events.boot = f"{time.time_ns():x}"
        for name in (robot.name for robot in plant.robots):
            plant.bus.add(name, GROUPS)
        made.append(plant)
    return made


def say(plant: Plant, name: str, group: str, seq: int, data: object) -> None:
    """Publish one sample on the bus of a cell."""
    topic = f"{name}/{group}"
    sample = Sample(topic=topic, seq=seq, epoch="e.1", t=now_us(), q=Quality.GOOD, origin="sim", data=data)
    plant.bus.publish(plant.bus.topics[topic], ValueReading(sample))


def live(plant: Plant, seq: int) -> None:
    """Let every robot of a cell say where it stands."""
    for robot in plant.robots:
        say(plant, robot.name, "joints", seq, Joints(position=[0.01 * seq, -1.2, 0.3, 1.1, -0.7, 2.9]))
        say(plant, robot.name, "tcp", seq, Tcp(speed=0.1))


def begin(plant: Plant) -> None:
    """Let every robot say what it is."""
    for robot in plant.robots:
        link = Link(state=LinkState.ONLINE, since=now_us(), protocol="polled", peer="192.0.2.1:1", reached_hz=125.0)
        say(plant, robot.name, "link", 1, link)
        say(plant, robot.name, "safety", 1, Safety(state=SafetyState.NORMAL))


async def work(load: Load, made: list[Plant]) -> int:
    """Let the cells live; how many events they had."""
    begun_s = time.monotonic()
    count = states = seq = 0
    for plant in made:
        begin(plant)
    while (passed_s := time.monotonic() - begun_s) < load.seconds:
        seq += 1
        for plant in made:
            live(plant, seq)
        while count < passed_s * load.events_hz * len(made):
            plant = made[count % len(made)]
            plant.happen(f"r{1 + count // len(made) % load.robots}")
            count += 1
        while states < passed_s * load.states_hz * len(made):
            plant = made[states % len(made)]
            motion = Motion.MOVING if states % 2 else Motion.STANDSTILL
            say(plant, f"r{1 + states // len(made) % load.robots}", "status", states + 2, Status(motion=motion))
            states += 1
        await anyio.sleep(STEP_S)
    return count


async def main(load: Load) -> None:
    """Simulate, and tell what it came to."""
    made = plants(load)
    async with exporting(*(plant.exporter for plant in made)):
        cpu_s = time.process_time()
        begun_s = time.monotonic()
        count = await work(load, made)
        cpu_share = (time.process_time() - cpu_s) / (time.monotonic() - begun_s)
        with anyio.move_on_after(10):
            while sum(plant.exporter.info().sent["events"] for plant in made) < count:  # noqa: ASYNC110 - many
                await anyio.sleep(0.05)
        infos = [plant.exporter.info() for plant in made]
        told = {
            "events": count,
            "acknowledged": sum(info.sent["events"] for info in infos),
            "samples": sum(info.sent["samples"] for info in infos),
            "states": sum(info.sent["states"] for info in infos),
            "waiting": sum(info.waiting_events for info in infos),
            "cpu_share": round(cpu_share, 3),
        }
        sys.stdout.write(msgspec.json.encode(told).decode() + "\n")
        sys.stdout.flush()


if __name__ == "__main__":
    logs.configure("error")
    parser = argparse.ArgumentParser(description=__doc__)
    for field in msgspec.structs.fields(Load):
        parser.add_argument(f"--{field.name}", type=field.type, required=field.required, default=field.default)
    anyio.run(main, Load(**vars(parser.parse_args())))
