"""The channels that a client is offered: for each topic of the bus its samples, and what else Foxglove's panels read.

r1/joints, r1/status …   /r1/joints …   the sample, schema robot_gateway.joints …
r1/tcp                   /r1/tcp        the sample
                         /r1/tcp/pose   foxglove.PoseInFrame
                         /r1/tf         foxglove.FrameTransforms
r1/events                /r1/events     foxglove.Log
r1/commands              /r1/commands   the event, schema robot_gateway.commands
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from functools import cache, lru_cache

import msgspec

from gateway.api import plain_schemas as schemas
from gateway.api.describe import vendor_schema
from gateway.api.model import Event, Sample
from gateway.api.vendor import Protocol
from gateway.core.bus import Reading, Topic
from gateway.core.settings import RobotSettings
from gateway.server.cell import Cell
from gateway.server.foxglove import messages, payloads
from gateway.server.foxglove.payloads import Same
from gateway.server.wire import JSON, Cut

_WHOLE = Cut(JSON, None)  # the native door's own bytes
_KEPT_SCHEMAS = 256


@dataclass(frozen=True, slots=True, kw_only=True)
class Channel:
    """One channel of one client.

    Args:
        id: Never used again for another channel of this client.
        name: Of the channel, as Foxglove shows it.
        topic: Where it comes from.
        schema_name: Name of its schema.
        schema: As it is advertised.
        derive: Makes its payload of a sample; None: it is the sample, as every door sends it.
        tell: Makes its payload of an event; None: it carries samples.
    """

    id: int
    name: str
    topic: Topic
    schema_name: str
    schema: msgspec.Raw
    derive: Callable[[Sample], bytes] | None = None
    tell: Callable[[Event], bytes] | None = None

    def payload(self, reading: Reading) -> bytes:
        """What a reading says on this channel, made once for all clients; `payloads.NOTHING` where it says nothing."""
        if self.derive is None:
            return _WHOLE.encoded(self.topic, reading)
        key = (self.topic.group.name, self.schema_name)
        found = reading.encoded.get(key)
        if found is None:
            found = reading.encoded[key] = self.derive(reading.sample(self.topic))
        return found

    @property
    def advertised(self) -> messages.Channel:
        """Its line in an advertisement."""
        return messages.Channel(id=self.id, topic=self.name, schema_name=self.schema_name, schema=self.schema)


class Channels:
    """What one client is offered, kept in step with the bus.

    Args:
        cell: The robots and the bus.
        globs: Only channels whose name matches one of them; a leading slash counts for nothing.

    Attributes:
        by_id: The channels that are advertised.
    """

    def __init__(self, cell: Cell, globs: Sequence[str]) -> None:
        self._cell = cell
        self._globs = [glob.removeprefix("/") for glob in globs]
        self._ids = itertools.count(1)
        self._known: dict[str, tuple[Topic, str]] = {}  # with what the schema of each follows from
        self.by_id: dict[int, Channel] = {}

    def refresh(self) -> tuple[list[list[Channel]], list[Channel]]:
        """Look at the bus again.

        Returns:
            The channels that are new, those of one robot together, and those that are gone.
        """
        now = {name: (topic, self._spoken(topic)) for name, topic in self._cell.topics.items()}
        if now == self._known:
            return [], []
        other = {name for name in {*self._known, *now} if now.get(name) != self._known.get(name)}
        gone = [channel for channel in self.by_id.values() if channel.topic.name in other]
        for channel in gone:
            del self.by_id[channel.id]
        new: dict[str, list[Channel]] = {}
        for name, (topic, _) in now.items():
            if name in other:
                wanted = [channel for channel in self._made(topic) if self._matches(channel.name)]
                self.by_id.update({channel.id: channel for channel in wanted})
                new.setdefault(topic.robot, []).extend(wanted)
        self._known = now
        return [channels for channels in new.values() if channels], gone

    def _spoken(self, topic: Topic) -> str:
        """What the schema of a topic follows from beside its group: a robot may come to speak another protocol."""
        robot = self._cell.robots.get(topic.robot) if topic.group.name == "vendor" else None
        return f"{robot.vendor.name}.{robot.protocol.name}" if isinstance(robot, RobotSettings) else ""

    def _matches(self, name: str) -> bool:
        return any(fnmatchcase(name[1:], glob) for glob in self._globs)

    def _made(self, topic: Topic) -> Iterator[Channel]:
        """The channels of a topic."""
        name, group = f"/{topic.name}", topic.group.name
        if group == "events":
            yield self._channel(name, topic, "foxglove.Log", _own("Log"), tell=payloads.log)
        elif topic.group.delivery == "event":
            yield self._channel(name, topic, f"robot_gateway.{group}", _of_group(group), tell=payloads.as_it_is)
        else:
            yield self._channel(name, topic, *self._schema(topic))
        if group == "tcp":
            pose, frames = "foxglove.PoseInFrame", "foxglove.FrameTransforms"
            yield self._channel(f"{name}/pose", topic, pose, _own("PoseInFrame"), derive=payloads.pose_in_frame)
            yield self._channel(
                f"/{topic.robot}/tf", topic, frames, _own("FrameTransforms"), derive=payloads.frame_transforms
            )

    def _channel(
        self,
        name: str,
        topic: Topic,
        schema_name: str,
        schema: msgspec.Raw,
        *,
        derive: Callable[[Sample], bytes] | None = None,
        tell: Callable[[Event], bytes] | None = None,
    ) -> Channel:
        return Channel(
            id=next(self._ids),
            name=name,
            topic=topic,
            schema_name=schema_name,
            schema=schema,
            derive=derive,
            tell=tell,
        )

    def _schema(self, topic: Topic) -> tuple[str, msgspec.Raw]:
        """Name and text of the schema of a topic's samples; the fields of a vendor are its protocol's own."""
        robot = self._cell.robots.get(topic.robot)
        group = topic.group.name
        if topic.group.struct is not None or not isinstance(robot, RobotSettings):
            return f"robot_gateway.{group}", _of_group(group)
        name = f"robot_gateway.{group}.{robot.vendor.name}.{robot.protocol.name}"
        return name, _of_vendor(Same(robot.protocol))


@cache
def _own(name: str) -> msgspec.Raw:
    own = {
        "Log": schemas.LOG,
        "PoseInFrame": schemas.POSE_IN_FRAME,
        "FrameTransforms": schemas.FRAME_TRANSFORMS,
    }
    return schemas.as_text(own[name])


@cache
def _of_group(group: str) -> msgspec.Raw:
    is_event = group in {"events", "commands"}
    return schemas.as_text(schemas.event_schema(group) if is_event else schemas.sample_schema(group))


@lru_cache(_KEPT_SCHEMAS)
def _of_vendor(protocol: Same[Protocol]) -> msgspec.Raw:
    return schemas.as_text(schemas.envelope("vendor", vendor_schema(protocol.value.longest)))
