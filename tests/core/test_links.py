from __future__ import annotations

import dataclasses
from collections.abc import Awaitable, Callable

import anyio

from gateway.core.backoff import no_waiting
from gateway.core.bus import Bus, Change, Topic
from gateway.core.events import EventRing
from gateway.core.links import Links
from gateway.core.settings import BrokenRobot, RobotSettings
from gateway.core.transport import Connector
from gateway.errors import VendorError
from tests.core import toy
from tests.core.fakes import FakeConnection, FakeConnector, LoopClock, run_jumping


def robot(name: str, **changes: object) -> RobotSettings:
    return dataclasses.replace(toy.settings(), name=name, **changes)  # type: ignore[arg-type]


class Cell:
    """Some links with fake controllers that always answer."""

    def __init__(self, *names: str, **changes: object) -> None:
        self.bus = Bus(EventRing(boot="b"))
        self.connections: dict[str, list[FakeConnection]] = {}
        self.links = Links([robot(name, **changes) for name in names], self.bus, LoopClock(), self._reach, no_waiting)

    def _reach(self, one: RobotSettings) -> Connector:
        if one.host == "broken":
            raise ValueError("the plugin's mistake")
        connection = FakeConnection(lambda _: (toy.frame(),))
        self.connections.setdefault(one.name, []).append(connection)
        return FakeConnector(connection)

    def state(self, name: str) -> str:
        topic = self.bus.topics[f"{name}/link"]
        assert topic.latest is not None
        return str(topic.latest.sample(topic).data.state.value)  # type: ignore[attr-defined]

    @property
    def kinds(self) -> list[tuple[str, str]]:
        return [(event.robot, event.kind.value) for event in self.bus.events.since(None, 1000)[0]]


def while_running(cell: Callable[[], Cell], look: Callable[[Cell], Awaitable[None]]) -> None:
    async def main() -> None:
        made = cell()
        async with made.links.running():
            made.links.start()
            await anyio.sleep(0.5)
            await look(made)

    run_jumping(main)


class Watched:
    def __init__(self, bus: Bus) -> None:
        self.changes: list[Change] = []
        bus.watch(self)

    def on_topics(self, change: Change) -> None:
        self.changes.append(change)


def test_a_link_is_added_and_another_removed_and_the_third_keeps_its_session() -> None:
    async def look(cell: Cell) -> None:
        watched = Watched(cell.bus)
        await cell.links.apply([robot("r1"), robot("r3")], stopped=["r2"])
        await anyio.sleep(0.5)
        assert {name.split("/")[0] for name in cell.bus.topics} == {"r1", "r3"}
        assert (cell.state("r1"), cell.state("r3")) == ("ONLINE", "ONLINE")
        assert len(cell.connections["r1"]) == 1
        assert not cell.connections["r1"][0].closed
        assert cell.connections["r2"][0].closed
        assert ("r2", "robot.removed") in cell.kinds
        assert ("r3", "robot.added") in cell.kinds
        (change,) = watched.changes
        assert {topic.robot for topic in change.added} == {"r3"}
        assert {topic.robot for topic in change.removed} == {"r2"}

    while_running(lambda: Cell("r1", "r2"), look)


def test_all_that_end_have_ended_before_the_first_new_one_begins() -> None:
    async def look(cell: Cell) -> None:
        await cell.links.apply([robot("r1", port=2), robot("r2", port=3)], stopped=["r1", "r2"])
        assert all(connections[0].closed for connections in cell.connections.values())
        await anyio.sleep(0.5)
        assert (cell.state("r1"), cell.state("r2")) == ("ONLINE", "ONLINE")
        assert [kind for kind in cell.kinds if kind[1] == "robot.changed"] == [
            ("r1", "robot.changed"),
            ("r2", "robot.changed"),
        ]

    while_running(lambda: Cell("r1", "r2"), look)


def test_a_changed_robot_keeps_its_topics_with_their_listeners() -> None:
    async def look(cell: Cell) -> None:
        before: dict[str, Topic] = dict(cell.bus.topics)
        await cell.links.apply([robot("r1", stale_s=5.0)], stopped=["r1"])
        assert cell.bus.topics == before

    while_running(lambda: Cell("r1"), look)


def test_only_an_open_session_of_a_protocol_that_keeps_it_is_held() -> None:
    async def look(cell: Cell) -> None:
        assert cell.links.holding == frozenset()

    while_running(lambda: Cell("r1"), look)

    async def kept(cell: Cell) -> None:
        assert cell.links.holding == {"r1"}
        freed = anyio.Event()
        cell.links.wait({"r1": "something waits"}, freed.set)
        topic = cell.bus.topics["r1/link"]
        assert topic.latest is not None
        assert topic.latest.sample(topic).data.notes == ["something waits"]  # type: ignore[attr-defined]
        cell.connections["r1"][0].end()
        await freed.wait()
        assert cell.links.holding == frozenset()

    keep = dataclasses.replace(toy.POLLED, on_stale="keep")
    while_running(lambda: Cell("r1", protocol=keep), kept)


def test_a_plugin_that_fails_at_once_is_shown_and_costs_no_other_robot() -> None:
    async def look(cell: Cell) -> None:
        broken = BrokenRobot(name="r3", host="h", vendor="v", protocol="", error=VendorError("v", "why"))
        await cell.links.apply([robot("r1"), robot("r2", host="broken"), broken], stopped=[])
        await anyio.sleep(0.5)
        assert (cell.state("r1"), cell.state("r2"), cell.state("r3")) == ("ONLINE", "FAULTED", "FAULTED")
        await cell.links.apply([robot("r1"), robot("r2")], stopped=["r2", "r3"])
        await anyio.sleep(0.5)
        assert cell.state("r2") == "ONLINE"
        assert not [name for name in cell.bus.topics if name.startswith("r3/")]

    while_running(lambda: Cell("r1"), look)
