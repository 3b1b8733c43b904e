"""The cells of a plant, as they have been told, on a bus: robots are named `cell/robot`, and a silent cell is off.

A cell lives while its heartbeat comes, by the clock of this machine alone. What it has told last is kept, and never
shown as live without a heartbeat.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field

import msgspec

from gateway.api.model import GROUPS, Event, Link, LinkState, Quality, Sample
from gateway.core.bus import Bus, Topic, ValueReading
from gateway.core.settings import ToldRobot
from gateway.export.readings import ToldReading, told_event
from gateway.export.subjects import Beat, Card

_BEATS = 3.5  # so many periods without a heartbeat, and a cell is silent
_EPOCH = "silent"
_EARLY = 10_000  # so many events may wait for their robot to be told


@dataclass(slots=True)
class CellSeen:
    """What is known of one cell.

    Attributes:
        beat: The last heartbeat; None: none has come.
        heard_s: When it came, monotonic.
        fresh: Whether a heartbeat has come since we listen, not only the one that was kept.
        live: Whether its robots are shown as they are told.
        cards: Its robots.
        boots: The gateways that have beaten lately, and when: more than one share a name.
    """

    beat: Beat | None = None
    heard_s: float = 0.0
    fresh: bool = False
    live: bool = False
    cards: dict[str, Card] = field(default_factory=dict)
    boots: dict[str, float] = field(default_factory=dict)

    def timeout_s(self) -> float:
        """How long it may say nothing."""
        return _BEATS * (2.0 if self.beat is None else self.beat.period)

    def is_shared(self, now_s: float) -> bool:
        """Whether two gateways say that they are this cell."""
        return sum(now_s - heard_s < 2 * self.timeout_s() for heard_s in self.boots.values()) > 1


class Cells:
    """Keeps a bus as the cells are told.

    Args:
        bus: Of the plant.
        on_robots: Called when there are other robots, before anybody is told of their topics.
        now: The monotonic clock, s.

    Attributes:
        n_wrong: How many messages were none of ours.
        connection: Why there is no word from the plant at all; None: there is.
    """

    def __init__(
        self, bus: Bus, on_robots: Callable[[list[ToldRobot]], None], now: Callable[[], float] = time.monotonic
    ) -> None:
        self._bus = bus
        self._on_robots = on_robots
        self._now = now
        self._told: dict[str, ToldReading] = {}  # by topic: the last word of each cell
        self._early: list[tuple[str, Event]] = []  # of robots that are not known yet
        self.cells: dict[str, CellSeen] = {}
        self.n_wrong = 0
        self.connection: str | None = "connecting"

    def connected(self) -> None:
        """The plant's server is there: which cells live is not known before they beat."""
        self.connection = None

    def lost(self, reason: str) -> None:
        """The plant's server is gone: nothing is live."""
        self.connection = reason
        for name, cell in self.cells.items():
            cell.fresh = False
            self._silence(name, cell)

    def beat(self, name: str, beat: Beat, *, kept: bool = False) -> None:
        """Take a heartbeat; one that was kept from before says nothing about now."""
        cell = self.cells.setdefault(name, CellSeen())
        cell.beat = beat
        if kept or self.connection is not None:
            return
        now_s = self._now()
        cell.heard_s, cell.fresh = now_s, True
        cell.boots = {boot: at_s for boot, at_s in cell.boots.items() if now_s - at_s < 2 * cell.timeout_s()}
        cell.boots[beat.boot] = now_s
        if not cell.live:
            cell.live = True
            self._say_again(name, cell)

    def robots(self, name: str, cards: list[Card]) -> None:
        """Take the robots that a cell has now."""
        cell = self.cells.setdefault(name, CellSeen())
        cell.cards = {card.name: card for card in cards}
        wanted = {f"{name}/{card.name}": card for card in cards}
        there = set(self._bus.topics)
        new: list[Topic] = []
        kept: set[str] = set()
        for robot, card in wanted.items():
            groups = [group for group in (*card.groups, "link") if group in GROUPS]
            made = self._bus.add(robot, dict.fromkeys(groups))
            kept.update(topic.name for topic in made.values())
            new += [topic for topic in made.values() if topic.name not in there]
        gone = [
            topic
            for topic in self._bus.topics.values()
            if topic.name.partition("/")[0] == name and topic.name not in kept
        ]
        self._bus.remove(gone)
        for topic in gone:
            self._told.pop(topic.name, None)
        for topic in new:
            self._say(topic, cell)
        self._on_robots(
            [
                ToldRobot(name=f"{cell_name}/{card.name}", vendor=card.vendor, protocol=card.protocol)
                for cell_name, one in sorted(self.cells.items())
                for card in one.cards.values()
            ]
        )
        self._bus.announce(new, gone)
        early, self._early = self._early, []
        for topic_name, event in early:
            found = self._bus.topics.get(topic_name)
            if found is None:
                self._early.append((topic_name, event))
            else:
                self._raise(found, event)

    def sample(self, cell_name: str, robot: str, group: str, payload: bytes) -> None:
        """Take a sample or a state."""
        try:
            reading = ToldReading(payload)
        except msgspec.DecodeError:
            self.n_wrong += 1
            return
        name = f"{cell_name}/{robot}/{group}"
        self._told[name] = reading
        topic = self._bus.topics.get(name)
        cell = self.cells.get(cell_name)
        if topic is not None and cell is not None and cell.live:
            self._bus.publish(topic, reading)

    def forget(self, cell_name: str, robot: str, group: str) -> None:
        """A state was taken out of the bucket."""
        self._told.pop(f"{cell_name}/{robot}/{group}", None)

    def event(self, cell_name: str, robot: str, group: str, payload: bytes) -> None:
        """Take an event: it gets a name of the plant's own ring."""
        try:
            event = told_event(payload)
        except msgspec.DecodeError:
            self.n_wrong += 1
            return
        name = f"{cell_name}/{robot}/{group}"
        topic = self._bus.topics.get(name)
        if topic is not None:
            self._raise(topic, event)
        elif len(self._early) < _EARLY:
            self._early.append((name, event))

    def _raise(self, topic: Topic, event: Event) -> None:
        self._bus.raise_event(topic, event.t, event.kind, event.before, event.after, event.raw)

    def wrong(self) -> None:
        """Something came that was none of ours."""
        self.n_wrong += 1

    def look(self) -> None:
        """Find the cells that have fallen silent; to be called now and then."""
        now_s = self._now()
        for name, cell in self.cells.items():
            if cell.live and now_s - cell.heard_s > cell.timeout_s():
                self._silence(name, cell)

    def why_silent(self, cell: CellSeen) -> str:
        """Why nothing of a cell is live."""
        if self.connection is not None:
            return f"no connection to the plant's server: {self.connection}"
        if not cell.fresh:
            return "no word of the cell's gateway since this page was started"
        return f"no word of the cell's gateway for more than {cell.timeout_s():.0f} s"

    def _silence(self, name: str, cell: CellSeen) -> None:
        """Let every robot of a cell be off."""
        cell.live = False
        for robot in cell.cards:
            for topic in self._bus.of(f"{name}/{robot}"):
                self._say(topic, cell)

    def _say_again(self, name: str, cell: CellSeen) -> None:
        """The cell is back: what it has told last counts again."""
        for robot in cell.cards:
            for topic in self._bus.of(f"{name}/{robot}"):
                self._say(topic, cell)

    def _say(self, topic: Topic, cell: CellSeen) -> None:
        """Publish what a topic says now: what it was told last, or that nothing is known."""
        if topic.ring is not None:
            return
        told = self._told.get(topic.name)
        if told is not None and cell.live:
            self._bus.publish(topic, told)
        elif topic.group.name == "link":
            self._bus.publish(topic, ValueReading(self._silent(topic, told, self._no_link(topic, told, cell))))
        elif topic.group.name != "link_stats" or told is not None:
            struct = topic.group.struct
            empty: object = {} if struct is None else struct()
            self._bus.publish(topic, ValueReading(self._silent(topic, told, empty)))

    def _silent(self, topic: Topic, told: ToldReading | None, data: object) -> Sample:
        last = None if told is None else told.sample(topic)
        return Sample(
            topic=topic.name,
            seq=0 if last is None else last.seq,
            epoch=_EPOCH,  # a word of ours, not the next one of its session
            t=time.time_ns() // 1000,
            t_last=None if last is None else last.t,
            q=Quality.GOOD if isinstance(data, Link) else Quality.DISCONNECTED,
            origin="live" if last is None else last.origin,
            data=data,
        )

    def _no_link(self, topic: Topic, told: ToldReading | None, cell: CellSeen) -> Link:
        card = cell.cards.get(topic.robot.partition("/")[2])
        last = None if told is None else told.sample(topic).data
        peer = last.peer if isinstance(last, Link) else ""
        return Link(
            state=LinkState.DISCONNECTED,
            reason=self.why_silent(cell),
            since=time.time_ns() // 1000,
            protocol="" if card is None else card.protocol,
            peer=peer,
        )
