"""What the doors know of the cell: its robots, as they are configured and as the bus sees them now."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Sequence
from typing import cast

from gateway.api.describe import describe, group_schema
from gateway.api.messages import Description, RobotInfo
from gateway.api.model import GROUPS, Link, LinkStats, Sample
from gateway.core.bus import Bus, Topic
from gateway.core.settings import BrokenRobot, RobotSettings
from gateway.server.fields import LEAF, Shape, has, nearest, shape_of, vendor_shape
from gateway.server.wire import Encoding, sound_sample

_NAMED = 8  # so many globs or fields an error repeats


class Cell:
    """The robots and the bus, read by every door.

    Args:
        robots: As configured.
        bus: Where they are published.
    """

    def __init__(self, robots: Iterable[RobotSettings | BrokenRobot], bus: Bus) -> None:
        self.robots = {robot.name: robot for robot in robots}
        self.bus = bus
        self._vendor_shapes: dict[int, Shape] = {}  # by the protocol's identity

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
        if isinstance(robot, BrokenRobot):
            return Description(topic=topic.name, delivery=topic.group.delivery, schema=group_schema(group))
        return describe(topic.name, group, robot.protocol.longest, robot.protocol.signals)

    def unknown_topic(self, patterns: Sequence[str]) -> str:
        """Say what to do about globs that match nothing."""
        near = difflib.get_close_matches(patterns[0], self.bus.topics, n=1)
        hint = f'did you mean "{near[0]}"?' if near else f"topics look like {next(iter(self.bus.topics), 'r1/joints')}"
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
        if isinstance(robot, BrokenRobot):
            return []
        protocol = robot.protocol
        found = self._vendor_shapes.get(id(protocol))
        if found is None:
            found = self._vendor_shapes[id(protocol)] = vendor_shape(protocol.tables)
        told = self._data(topic)
        return [found, dict.fromkeys(set(told) - set(found), LEAF)] if isinstance(told, dict) else [found]

    def _info(self, name: str) -> RobotInfo:
        robot = self.robots[name]
        known = {group: self.bus.topics.get(f"{name}/{group}") for group in GROUPS}
        stats = self._data(known["link_stats"])
        counted = stats if isinstance(stats, LinkStats) else LinkStats()
        return RobotInfo(
            name=name,
            vendor=robot.vendor if isinstance(robot, BrokenRobot) else robot.vendor.name,
            protocol=robot.protocol if isinstance(robot, BrokenRobot) else robot.protocol.name,
            groups=[group for group, topic in known.items() if topic is not None],
            link=cast("Link", self._data(known["link"])),
            reject_counts=counted.rejects,
            frames=counted.frames,
            age=counted.age,
        )

    @staticmethod
    def _data(topic: Topic | None) -> object:
        return None if topic is None or topic.latest is None else topic.latest.sample(topic).data


def _listed(names: Sequence[str]) -> str:
    return ", ".join(names[:_NAMED]) + (f" and {len(names) - _NAMED} more" if len(names) > _NAMED else "")
