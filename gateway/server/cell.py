"""What the doors know of the cell: its robots, as they are configured and as the bus sees them now."""

from __future__ import annotations

import difflib
from collections.abc import Callable, Iterable, Mapping, Sequence
from fnmatch import fnmatchcase
from typing import cast

from aiohttp import web

from gateway.api.describe import describe, group_schema
from gateway.api.messages import Description, ExportInfo, RecorderInfo, RobotInfo
from gateway.api.model import GROUPS, Link, LinkStats, Sample
from gateway.api.vendor import Protocol
from gateway.core.bus import Bus, Topic
from gateway.core.settings import BrokenRobot, RobotSettings, ToldRobot
from gateway.server.fields import LEAF, Shape, has, nearest, shape_of, vendor_shape
from gateway.server.wire import Encoding, sound_sample

Robot = RobotSettings | BrokenRobot | ToldRobot

_NAMED = 8  # so many globs or fields an error repeats


class Cell:
    """The robots and the bus, read by every door.

    Args:
        robots: As configured.
        bus: Where they are published.
        exports: Tells how the exporters do.
        recorder: Tells how the recorder does; None: there is none.
    """

    def __init__(
        self,
        robots: Iterable[Robot],
        bus: Bus,
        *,
        exports: Callable[[], list[ExportInfo]] = list,
        recorder: Callable[[], RecorderInfo | None] = lambda: None,
    ) -> None:
        self._recorder = recorder
        self._robots = {robot.name: robot for robot in robots}
        self._exports = exports
        self.bus = bus
        self._vendor_shapes: dict[int, tuple[Protocol, Shape]] = {}  # by the protocol's identity

    @property
    def robots(self) -> Mapping[str, Robot]:
        """The robots by name, in the order of the configuration."""
        return self._robots

    @property
    def topics(self) -> Mapping[str, Topic]:
        """The topics of the bus that there are here, by name."""
        return self.bus.topics

    @property
    def recorder(self) -> RecorderInfo | None:
        """How the recorder does; None: there is none, or not all of the cell may be seen."""
        return self._recorder()

    @property
    def last_event(self) -> str:
        """The name of the newest event of the common ring."""
        return self.bus.events.last_name

    @property
    def scope(self) -> tuple[str, ...] | None:
        """Globs of the topics that may be seen; None: all."""
        return None

    def exports(self) -> list[ExportInfo]:
        """Where the cell is sent besides; of that nothing to who may not see all of it."""
        return self._exports()

    def replace(self, robots: Iterable[Robot]) -> None:
        """Take other robots, as configured now; their topics are the bus's."""
        self._robots = {robot.name: robot for robot in robots}
        self._vendor_shapes.clear()

    def limited(self, globs: Sequence[str]) -> Cell:
        """What is left of the cell when only some topics may be seen: the others are as if they did not exist."""
        return LimitedCell(self, globs)

    def match(self, patterns: Iterable[str]) -> list[Topic]:
        """The topics that any of some globs (`*/joints`, `r1/*`) names."""
        return self.bus.match(patterns)

    def latest(self, topics: Iterable[Topic], encoding: Encoding) -> list[Sample]:
        """The latest samples of some topics, all of which can be encoded."""
        return [sound_sample(encoding, topic, topic.latest) for topic in topics if topic.latest is not None]

    def infos(self) -> list[RobotInfo]:
        """Every robot with the state of its link."""
        return [self._info(name) for name in self.robots]

    def describe(self, topic: Topic) -> Description:
        """What a topic holds."""
        robot = self.robots[topic.robot]
        group = topic.group.name
        if not isinstance(robot, RobotSettings):
            return Description(topic=topic.name, delivery=topic.group.delivery, schema=group_schema(group))
        return describe(topic.name, group, robot.protocol.longest, robot.protocol.signals)

    def unknown_topic(self, patterns: Sequence[str]) -> str:
        """Say what to do about globs that match nothing."""
        topics = self.topics
        near = difflib.get_close_matches(patterns[0], topics, n=1)
        hint = f'did you mean "{near[0]}"?' if near else f"topics look like {next(iter(topics), 'r1/joints')}"
        return f"no topic matches {_listed(patterns)}; {hint}"

    def unknown_fields(self, topics: Iterable[Topic], fields: Iterable[str]) -> str | None:
        """Say what to do about fields that none of some topics has; None: there are none."""
        shapes = list({id(shape): shape for topic in topics for shape in self._shapes(topic)}.values())
        unknown = [field for field in fields if not any(has(shape, field.split(".")) for shape in shapes)]
        if not unknown:
            return None
        near = nearest(unknown[0], shapes)
        hint = f'did you mean "{near}"?' if near else "ask describe for the fields"
        return f"no matched topic has {_listed(unknown)}; {hint}"

    def _shapes(self, topic: Topic) -> list[Shape]:
        """The paths that a topic may have: by its tables, and what its robot was asked for besides."""
        if topic.group.delivery == "event":
            return []
        robot = self.robots[topic.robot]
        if topic.group.struct is not None:
            return [shape_of(topic.group.struct)]
        if not isinstance(robot, RobotSettings):
            return []
        protocol = robot.protocol
        found = self._vendor_shapes.get(id(protocol))
        if found is None:
            found = self._vendor_shapes[id(protocol)] = (protocol, vendor_shape(protocol.tables))
        told, shape = self._data(topic), found[1]
        return [shape, dict.fromkeys(set(told) - set(shape), LEAF)] if isinstance(told, dict) else [shape]

    def _info(self, name: str) -> RobotInfo:
        robot = self.robots[name]
        topics = self.topics
        known = {group: topics.get(f"{name}/{group}") for group in GROUPS}
        stats = self._data(known["link_stats"])
        counted = stats if isinstance(stats, LinkStats) else LinkStats()
        return RobotInfo(
            name=name,
            vendor=robot.vendor.name if isinstance(robot, RobotSettings) else robot.vendor,
            protocol=robot.protocol.name if isinstance(robot, RobotSettings) else robot.protocol,
            groups=[group for group, topic in known.items() if topic is not None],
            link=self._link(name),
            reject_counts=counted.rejects,
            frames=counted.frames,
            age=counted.age,
        )

    def _link(self, name: str) -> Link:
        """The link of a robot; of one whose topic may not be seen no more than the quality of any sample says."""
        link = cast("Link", self._data(self.bus.topics.get(f"{name}/link")))
        if f"{name}/link" in self.topics:
            return link
        return Link(state=link.state, since=link.since, protocol=link.protocol, peer="")

    @staticmethod
    def _data(topic: Topic | None) -> object:
        return None if topic is None or topic.latest is None else topic.latest.sample(topic).data


class LimitedCell(Cell):
    """A cell of which only some topics may be seen, and the robots that have one of them.

    Args:
        whole: The whole cell; what changes in it changes here.
        globs: The topics that may be seen.
    """

    def __init__(self, whole: Cell, globs: Sequence[str]) -> None:
        super().__init__((), whole.bus)
        self._whole = whole
        self._globs = tuple(globs)
        self._visible: dict[str, Topic] = {}
        # what there was when this was found
        self._looked_at: tuple[Mapping[str, Topic], Mapping[str, Robot]] = {}, {}

    @property
    def robots(self) -> Mapping[str, Robot]:
        """The robots of which any topic may be seen."""
        self._look()
        return self._robots

    @property
    def topics(self) -> Mapping[str, Topic]:
        """The topics that may be seen."""
        self._look()
        return self._visible

    @property
    def scope(self) -> tuple[str, ...] | None:
        """Globs of the topics that may be seen."""
        return self._globs

    def match(self, patterns: Iterable[str]) -> list[Topic]:
        """The topics that any of some globs names, and that may be seen."""
        visible = self.topics
        return [topic for topic in self.bus.match(patterns) if topic.name in visible]

    def _look(self) -> None:
        """Find anew what may be seen, when the bus has other topics or the configuration other robots."""
        topics, robots = self._looked_at
        if self.bus.topics == topics and self._whole.robots is robots:
            return
        self._looked_at = dict(self.bus.topics), self._whole.robots
        self._visible = {name: topic for name, topic in self.bus.topics.items() if self._shows(name)}
        seen = {topic.robot for topic in self._visible.values()}
        self.replace(robot for name, robot in self._whole.robots.items() if name in seen)

    def _shows(self, name: str) -> bool:
        return any(fnmatchcase(name, glob) for glob in self._globs)


CELL = web.AppKey("cell", Cell)


def _listed(names: Sequence[str]) -> str:
    return ", ".join(names[:_NAMED]) + (f" and {len(names) - _NAMED} more" if len(names) > _NAMED else "")
