"""What the doors know of the cell: its robots, as they are configured and as the bus sees them now."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Sequence
from typing import cast

from gateway.api.describe import describe, group_schema
from gateway.api.messages import Description, RobotInfo
from gateway.api.model import GROUPS, Link, LinkStats, Sample
from gateway.api.signals import keys_of
from gateway.core.bus import Bus, Topic
from gateway.core.settings import BrokenRobot, RobotSettings

_NAMED = 8  # so many globs an error repeats


class Cell:
    """The robots and the bus, read by every door.

    Args:
        robots: As configured.
        bus: Where they are published.
    """

    def __init__(self, robots: Iterable[RobotSettings | BrokenRobot], bus: Bus) -> None:
        self.robots = {robot.name: robot for robot in robots}
        self.bus = bus

    def latest(self, topics: Iterable[Topic]) -> list[Sample]:
        """The latest samples of some topics."""
        return [topic.latest.sample(topic) for topic in topics if topic.latest is not None]

    def infos(self) -> list[RobotInfo]:
        """Every robot with the state of its link."""
        return [self._info(name) for name in self.robots]

    def describe(self, topic: Topic) -> Description:
        """What a topic holds."""
        robot = self.robots[topic.robot]
        group = topic.group.name
        if isinstance(robot, BrokenRobot):
            return Description(topic=topic.name, delivery=topic.group.delivery, schema=group_schema(group))
        longest = max(robot.protocol.layouts, key=lambda layout: layout.size)
        return describe(topic.name, group, longest, robot.protocol.signals)

    def unknown_topic(self, patterns: Sequence[str]) -> str:
        """Say what to do about globs that match nothing."""
        near = difflib.get_close_matches(patterns[0], self.bus.topics, n=1)
        hint = f'did you mean "{near[0]}"?' if near else f"topics look like {next(iter(self.bus.topics), 'r1/joints')}"
        named = ", ".join(patterns[:_NAMED]) + (f" and {len(patterns) - _NAMED} more" if len(patterns) > _NAMED else "")
        return f"no topic matches {named}; {hint}"

    def unknown_fields(self, topics: Iterable[Topic], fields: Iterable[str]) -> list[str]:
        """The fields that none of some topics has."""
        known = {key for topic in topics for key in self._keys(topic)}
        return [field for field in fields if not any(field == key or field.startswith(f"{key}.") for key in known)]

    def _keys(self, topic: Topic) -> list[str]:
        struct = GROUPS[topic.group.name].struct
        if struct is not None:
            return keys_of(struct)
        robot = self.robots[topic.robot]
        layouts = () if isinstance(robot, BrokenRobot) else robot.protocol.layouts
        return [field.name for layout in layouts for field in layout.fields]

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
