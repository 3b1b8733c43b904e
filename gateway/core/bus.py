"""The bus: topics with their latest readings, and listeners that are told at once.

Publishing is synchronous and cannot block. A `Reading` is what one moment says of a topic. It is normalised only when
somebody asks for it, and once.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from fnmatch import fnmatchcase
from typing import Literal, Protocol

import msgspec

from gateway.api.decoder import Frame
from gateway.api.model import GROUPS, Event, EventKind, Group, Quality, Sample, Status, worst
from gateway.api.reader import Reader
from gateway.core.events import DEFAULT_COMMAND_RING, EventRing

Origin = Literal["live", "sim", "replay"]


class Reading(Protocol):
    """What one moment says of a topic; `encoded` is the doors' cache, so that each encoding is made once."""

    encoded: dict[object, bytes]

    @property
    def urgent(self) -> bool:
        """Whether it says that no more values come: it waits for no rate."""
        ...

    def broken(self, topic: Topic, error: Exception) -> Sample:
        """The empty sample with q BAD that takes the place of one that cannot be encoded: a plugin's mistake."""
        ...

    def sample(self, topic: Topic) -> Sample:
        """The canonical sample."""
        ...


class Listener(Protocol):
    """A subscriber's inbox. It must return at once, and never raises."""

    def on_reading(self, topic: Topic, reading: Reading) -> None:
        """A topic has something new."""
        ...

    def on_event(self, topic: Topic, event: Event) -> None:
        """An edge was found."""
        ...


class Watcher(Protocol):
    """Who wants to know when topics come and go. It must return at once, and never raises."""

    def on_topics(self, change: Change) -> None:
        """Some topics have come or gone."""
        ...


class Topic:
    """One `<robot>/<group>`.

    Attributes:
        name: As subscribers know it.
        robot: Name of the robot.
        group: The group of the model.
        latest: The newest reading; None only for event topics.
        listeners: Who is told.
        ring: Where the events of an event topic are kept; None for the others.
    """

    __slots__ = ("group", "latest", "listeners", "name", "ring", "robot")

    def __init__(self, robot: str, group: Group, ring: EventRing | None = None) -> None:
        self.name = f"{robot}/{group.name}"
        self.robot = robot
        self.group = group
        self.latest: Reading | None = None
        self.listeners: list[Listener] = []
        self.ring = ring


class ValueReading:
    """A reading whose value is at hand: the link's own topics, and the last sample of a lost one."""

    __slots__ = ("_sample", "encoded", "urgent")

    def __init__(self, sample: Sample) -> None:
        self._sample = sample
        self.urgent = sample.q in {Quality.STALE, Quality.DISCONNECTED}
        self.encoded: dict[object, bytes] = {}

    def broken(self, topic: Topic, error: Exception) -> Sample:
        """The gateway's own words can be encoded."""
        raise ValueError(f"{topic.name} cannot be encoded") from error

    def sample(self, topic: Topic) -> Sample:  # noqa: ARG002 - such a reading belongs to one topic
        """The sample."""
        return self._sample


class FrameStream:
    """What the frames of one session have in common.

    Args:
        epoch: Name of the session's epoch.
        readers: The compiled readers of its layout, by group.
        quality: Worst quality of every frame: UNCERTAIN where they are longer than the layout.
        origin: Where they come from.
        on_bad: Called when a group held NaN or infinity.
        on_broken: Called when a plugin's function failed in a group.
        stamped: Fills in since when faults stand.
        t_src: Reads the controller's own time from a frame; None where it is not known.
    """

    __slots__ = ("epoch", "on_bad", "on_broken", "origin", "quality", "readers", "stamped", "t_src")

    def __init__(
        self,
        epoch: str,
        readers: dict[str, Reader],
        quality: Quality,
        origin: Origin,
        on_bad: Callable[[], None],
        on_broken: Callable[[str, BaseException], None],
        stamped: Callable[[Status], Status],
        t_src: Callable[[Frame], int | None] | None = None,
    ) -> None:
        self.epoch = epoch
        self.readers = readers
        self.quality = quality
        self.origin: Origin = origin
        self.on_bad = on_bad
        self.on_broken = on_broken
        self.stamped = stamped
        self.t_src = t_src


class FrameReading:
    """What one frame says: one object for all its topics, normalised group by group when first asked."""

    __slots__ = ("_samples", "encoded", "frame", "seq", "stream", "t", "timed")

    def __init__(self, stream: FrameStream, frame: Frame, seq: int, t: int, timed: Frame | None = None) -> None:
        self.stream = stream
        self.frame = frame
        self.seq = seq
        self.t = t
        self.timed = timed or frame  # the one whose clock counts: of several parts the oldest
        self._samples: dict[str, Sample] = {}
        self.encoded: dict[object, bytes] = {}

    @property
    def urgent(self) -> bool:
        """A frame is never the last word."""
        return False

    def broken(self, topic: Topic, error: Exception) -> Sample:
        """Report a plugin's mistake and give the empty group in its place."""
        group = topic.group.name
        self.stream.on_broken(group, error)
        sample = msgspec.structs.replace(self.sample(topic), data=self.stream.readers[group].empty, q=Quality.BAD)
        self._samples[group] = sample
        return sample

    def sample(self, topic: Topic) -> Sample:
        """The canonical sample of a topic of this robot."""
        group = topic.group.name
        found = self._samples.get(group)
        if found is None:
            found = self._samples[group] = self._normalised(topic, self.stream.readers[group])
        return found

    def replace(self, sample: Sample, group: str) -> None:
        """Put in a sample that the core has completed (fault stamps)."""
        self._samples[group] = sample

    def _normalised(self, topic: Topic, reader: Reader) -> Sample:
        stream = self.stream
        try:
            data, quality = reader.read(self.frame)
        except (Exception, SystemExit) as error:  # noqa: BLE001 - a plugin's mistake costs its group and no more
            stream.on_broken(topic.group.name, error)
            data, quality = reader.empty, Quality.BAD
        if isinstance(data, Status):
            data = stream.stamped(data)
        if quality is Quality.BAD:
            stream.on_bad()
        if stream.quality is not Quality.GOOD:
            quality = worst(quality, stream.quality)
        return Sample(
            topic=topic.name,
            seq=self.seq,
            epoch=stream.epoch,
            t=self.t,
            t_src=None if stream.t_src is None else stream.t_src(self.timed),
            q=quality,
            origin=stream.origin,
            data=data,
        )


class Change:
    """Topics that have come and gone together.

    Args:
        added: Those that have come, with what they say now.
        removed: Those that have gone; they have said their last.
    """

    __slots__ = ("_matching", "added", "removed")

    def __init__(self, added: Sequence[Topic], removed: Sequence[Topic]) -> None:
        self.added = added
        self.removed = frozenset(removed)
        self._matching: dict[tuple[str, ...], list[Topic]] = {}

    def matching(self, patterns: tuple[str, ...]) -> list[Topic]:
        """The topics that have come and that any of some globs names; found once for all who ask for the same."""
        found = self._matching.get(patterns)
        if found is None:
            found = self._matching[patterns] = _matching(self.added, patterns)
        return found


class Bus:
    """All topics of the gateway, and the rings of its events.

    Args:
        events: The ring of every robot's edges.
        command_ring: How many events each robot's own ring of command objects keeps.
    """

    def __init__(self, events: EventRing, command_ring: int = DEFAULT_COMMAND_RING) -> None:
        self._command_ring = command_ring
        self._watchers: dict[Watcher, None] = {}
        self.topics: dict[str, Topic] = {}
        self.events = events

    def add(self, robot: str, groups: Iterable[str]) -> dict[str, Topic]:
        """The topics of a robot, by group: those that there are stay the same, with their listeners and rings."""
        made: dict[str, Topic] = {}
        for group in groups:
            found = self.topics.get(f"{robot}/{group}")
            made[group] = found or Topic(robot, GROUPS[group], self._ring(GROUPS[group]))
        self.topics.update({topic.name: topic for topic in made.values()})
        return made

    def of(self, robot: str) -> list[Topic]:
        """The topics of one robot."""
        return [topic for topic in self.topics.values() if topic.robot == robot]

    def remove(self, topics: Iterable[Topic]) -> None:
        """Take topics away; who listens is told with `announce`."""
        for topic in topics:
            del self.topics[topic.name]

    def watch(self, watcher: Watcher) -> None:
        """Tell somebody when topics come and go."""
        self._watchers[watcher] = None

    def unwatch(self, watcher: Watcher) -> None:
        """Tell it no longer."""
        self._watchers.pop(watcher, None)

    def announce(self, added: Sequence[Topic], removed: Sequence[Topic]) -> None:
        """Tell the watchers what has come and gone."""
        if added or removed:
            change = Change(added, removed)
            for watcher in list(self._watchers):
                watcher.on_topics(change)

    def resize(self, event_ring: int, command_ring: int) -> None:
        """Keep more or fewer events from now on; the newest ones stay."""
        self._command_ring = command_ring
        self.events.resize(event_ring)
        for topic in self.topics.values():
            if topic.ring is not None and topic.ring is not self.events:
                topic.ring.resize(command_ring)

    def match(self, patterns: Iterable[str]) -> list[Topic]:
        """The topics that any of some globs (`*/joints`, `r1/*`) names."""
        return _matching(self.topics.values(), list(patterns))

    def publish(self, topic: Topic, reading: Reading) -> None:
        """Keep a reading as the latest one and tell the listeners."""
        topic.latest = reading
        for listener in topic.listeners:
            listener.on_reading(topic, reading)

    def raise_event(
        self,
        topic: Topic,
        t: int,
        kind: EventKind,
        before: object,
        after: object,
        raw: dict[str, object],
    ) -> None:
        """Put an event into its topic's ring and tell the listeners."""
        if topic.ring is None:
            raise ValueError(f"{topic.name} has no events")
        event = topic.ring.append(topic.robot, t, kind, before, after, raw)
        for listener in topic.listeners:
            listener.on_event(topic, event)

    def _ring(self, group: Group) -> EventRing | None:
        if group.delivery != "event":
            return None
        return self.events if group.name == "events" else EventRing(self._command_ring)


def _matching(topics: Iterable[Topic], patterns: Sequence[str]) -> list[Topic]:
    return [topic for topic in topics if any(fnmatchcase(topic.name, one) for one in patterns)]
