"""Plays a recording again: its bytes go through the decoders, and the rest is published as it was told."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import msgspec

from gateway.api.decoder import Event, Frame, Refused, Reject, Skipped
from gateway.api.model import GROUPS, LinkState, Quality, Sample
from gateway.api.model import Event as ModelEvent
from gateway.api.model import Link as LinkData
from gateway.core.bus import Bus, ValueReading
from gateway.core.events import EventRing
from gateway.core.own_topic import OwnTopic
from gateway.core.settings import RobotSettings
from gateway.record.chunks import Chunk, Silence
from gateway.record.mcapfile import Mark
from gateway.record.reading import Entry
from gateway.record.replayer import Replayer

_MARK = msgspec.json.Decoder(Mark)
_SAMPLE = msgspec.json.Decoder(Sample)
_EVENT = msgspec.json.Decoder(ModelEvent)
_OWN = ("link", "link_stats")  # topics that the gateway itself spoke on
_NOT_TOLD = "the recording has not told yet"
_OVER = "the recording ends here"


@dataclass(slots=True)
class Tally:
    """What has been read of a robot.

    Attributes:
        n_received: Bytes received.
        n_sent: Bytes sent.
        sessions: Sessions that began, or were under way when the recording did.
        frames: Good frames.
        occurrences: Frames that tell what has happened.
        skipped: Frames without state.
        rejects: Rejects by reason.
        events: Events by kind, as they were recorded.
        problem: Why it is read no further; "": it is.
    """

    n_received: int = 0
    n_sent: int = 0
    sessions: int = 0
    frames: int = 0
    occurrences: int = 0
    skipped: int = 0
    rejects: Counter[str] = field(default_factory=Counter)
    events: Counter[str] = field(default_factory=Counter)
    problem: str = ""

    def count(self, events: Sequence[Event]) -> None:
        """Count what a decoder has made of some bytes."""
        for event in events:
            if isinstance(event, Frame):
                self.frames += 1
            elif isinstance(event, Reject):
                self.rejects[event.reason] += 1
            elif isinstance(event, Skipped):
                self.skipped += 1
            elif not isinstance(event, Refused):
                self.occurrences += 1


class RobotReplay:
    """One robot of a recording.

    Args:
        robot: As it was configured.
        bus: Where it is published; its samples say `origin: replay`.
    """

    def __init__(self, robot: RobotSettings, bus: Bus) -> None:
        self._replayer = Replayer(robot, bus, "replay")
        self._epoch = ""
        self._opening = False
        self.tally = Tally()

    def silent(self, quality: Quality, t: int, t_last: int | None) -> None:
        """Say on every topic, at µs UTC, that no values come."""
        self._replayer.publisher.silent(quality, t, t_last)

    def take(self, entry: Entry) -> Sequence[Event]:
        """Take the next raw bytes or mark of the robot; what its decoder made of it.

        A plugin that fails costs what follows of this robot.
        """
        if self.tally.problem:
            return ()
        try:
            events = self._take(entry)
        except (Exception, SystemExit) as error:  # noqa: BLE001 - it is a plugin that is judged here
            self.tally.problem = f"its plugin failed: {error!r}"
            return ()
        self.tally.count(events)
        return events

    def _take(self, entry: Entry) -> Sequence[Event]:
        kind = entry.topic.rpartition("/")[2]
        if kind == "session":
            return self._mark(entry)
        if kind == "received":
            self.tally.n_received += len(entry.data)
        else:
            self.tally.n_sent += len(entry.data)
        chunk = Chunk(entry.t, "received" if kind == "received" else "sent", entry.data, self._epoch, None)
        return self._replayer.read(chunk) if self._opening else self._replayer.play(chunk)

    def _mark(self, entry: Entry) -> Sequence[Event]:
        mark = _MARK.decode(entry.data)
        self._epoch = mark.epoch
        self._opening = mark.kind == "opening"
        self.tally.sessions += mark.kind in {"begin", "opening"}
        if mark.kind == "opening":
            self._replayer.open(mark.epoch)
        elif mark.kind == "resume":
            self._replayer.resume(mark.epoch, mark.seqs, mark.faults)
        elif mark.kind == "number":
            self._replayer.publisher.number(mark.seqs)
        elif mark.kind == "silent" and mark.quality is not None:
            silence = msgspec.json.encode(Silence(mark.quality, mark.t_last))
            return self._replayer.play(Chunk(entry.t, "silent", silence, mark.epoch, mark.seqs))
        elif mark.kind in {"begin", "expired", "end"}:
            return self._replayer.play(Chunk(entry.t, mark.kind, b"", mark.epoch, None))
        return ()


class Replay:
    """A recorded cell on a bus of its own.

    Bytes and marks go through the decoders of their robots, and what these say is published with `origin: replay`. What
    does not follow from bytes (`link`, `link_stats`, events, commands) is published as it was told; samples that were
    recorded are left out.

    Args:
        robots: The robots, by name; what the recording holds of others is left out.
        begins_t: When it begins, µs UTC.

    Attributes:
        bus: Where they are published.
        unreadable: How many messages another version of the gateway seems to have written.
    """

    def __init__(self, robots: Mapping[str, RobotSettings], begins_t: int) -> None:
        self.bus = Bus(EventRing())
        self.unreadable = 0
        self._settings = robots
        self._robots: dict[str, RobotReplay] = {}
        for name, robot in robots.items():
            own = Bus(EventRing(1), 1)  # edges that are found again are not told twice
            self._robots[name] = RobotReplay(robot, own)
            self.bus.topics.update(
                {topic.name: topic for topic in own.topics.values() if topic.group.delivery != "event"}
            )
            self.bus.add(name, [*_OWN, "events", *(["commands"] if robot.protocol.commands else [])])
        self._silence(begins_t, None, _NOT_TOLD)

    @property
    def tallies(self) -> dict[str, Tally]:
        """What has been read, by robot."""
        return {name: replay.tally for name, replay in self._robots.items()}

    def take(self, entry: Entry) -> Sequence[Event]:
        """Take the next message of the recording; what a decoder made of it."""
        replay, group = self._robots.get(entry.robot), entry.group
        if replay is None:
            return ()
        if group.startswith("raw/") or group == "session":
            return replay.take(entry)
        try:
            if group in _OWN:
                self._publish(entry)
            elif group in GROUPS and GROUPS[group].delivery == "event":
                self._raise(entry, replay.tally)
        except msgspec.MsgspecError:
            self.unreadable += 1
        return ()

    def end(self, t: int) -> None:
        """Say on every topic, at µs UTC, that nothing more comes."""
        self._silence(t, t, _OVER)

    def _silence(self, t: int, t_last: int | None, reason: str) -> None:
        for name, replay in self._robots.items():
            replay.silent(Quality.DISCONNECTED, t, t_last)
            robot = self._settings[name]
            data = LinkData(
                state=LinkState.DISCONNECTED,
                reason=reason,
                since=t,
                protocol=robot.protocol.name,
                peer=f"{robot.host}:{robot.port}",
            )
            OwnTopic(self.bus.topics[f"{name}/link"], self.bus, "replay").publish(data, t)

    def _publish(self, entry: Entry) -> None:
        """Publish what the gateway itself said."""
        topic = self.bus.topics[entry.topic]
        sample = _SAMPLE.decode(entry.data)
        struct = topic.group.struct
        data = sample.data if struct is None else msgspec.convert(sample.data, struct)
        self.bus.publish(topic, ValueReading(msgspec.structs.replace(sample, data=data, origin="replay")))

    def _raise(self, entry: Entry, tally: Tally) -> None:
        topic = self.bus.topics.get(entry.topic)
        if topic is not None:
            event = _EVENT.decode(entry.data)
            tally.events[event.kind.value] += 1
            self.bus.raise_event(topic, event.t, event.kind, event.before, event.after, event.raw)
