"""Plays a recording through the decoders again, and compares what they say with what was recorded."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, field

import msgspec

from gateway.api.decoder import Event
from gateway.api.model import Event as ModelEvent
from gateway.api.model import Sample
from gateway.core.bus import Bus, Reading, Topic
from gateway.core.settings import RobotSettings
from gateway.record.chunks import Chunk, Silence
from gateway.record.mcapfile import Mark
from gateway.record.reading import Entry
from gateway.record.replayer import Replayer

_MARK = msgspec.json.Decoder(Mark)
_JSON = msgspec.json.Encoder()


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

    def take(self, entry: Entry) -> Sequence[Event]:
        """Take the next raw bytes or mark of the robot; what its decoder made of it."""
        kind = entry.topic.rpartition("/")[2]
        if kind == "session":
            return self._mark(entry)
        chunk = Chunk(entry.t, "received" if kind == "received" else "sent", entry.data, self._epoch, None)
        return self._replayer.read(chunk) if self._opening else self._replayer.play(chunk)

    def _mark(self, entry: Entry) -> Sequence[Event]:
        mark = _MARK.decode(entry.data)
        self._epoch = mark.epoch
        self._opening = mark.kind == "opening"
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


@dataclass(frozen=True, slots=True)
class Change:
    """One sample that is another one now.

    Attributes:
        topic: Its topic.
        t: Its time, µs UTC.
        what: `missing`: recorded, and not told again; `added`: the other way round; else the path in it that differs.
        before: As recorded.
        after: As told now.
    """

    topic: str
    t: int
    what: str
    before: object = None
    after: object = None


@dataclass(slots=True)
class Differences:
    """What a comparison has found.

    Attributes:
        same: How many samples are the same, by topic.
        counts: How many changes there are, by topic and what changed.
        first: The first change of each.
    """

    same: Counter[str] = field(default_factory=Counter)
    counts: Counter[tuple[str, str]] = field(default_factory=Counter)
    first: dict[tuple[str, str], Change] = field(default_factory=dict)

    def add(self, change: Change) -> None:
        """Count a change."""
        key = (change.topic, change.what)
        self.counts[key] += 1
        self.first.setdefault(key, change)


_Name = tuple[str, str, int]  # topic, epoch, seq


class Comparison:
    """Compares recorded samples with those that a replay publishes; a listener of its topics.

    Args:
        topics: The topics that were recorded.
        from_t: Samples were recorded from then on, µs UTC.
    """

    def __init__(self, topics: Collection[str], from_t: int) -> None:
        self._topics = set(topics)
        self._from_t = from_t
        self._recorded: dict[_Name, bytes] = {}
        self._replayed: dict[_Name, bytes] = {}
        self._decode = msgspec.json.Decoder(_Envelope).decode
        self.found = Differences()

    def recorded(self, entry: Entry) -> None:
        """Take a recorded sample."""
        envelope = self._decode(entry.data)
        if envelope.t < self._from_t:  # the state that stood when the recording began
            return
        self._meet(envelope, entry.data, self._recorded, self._replayed)

    def on_reading(self, topic: Topic, reading: Reading) -> None:
        """Take a sample of the replay."""
        if topic.name not in self._topics:
            return
        sample: Sample = reading.sample(topic)
        if sample.t >= self._from_t:
            data = _JSON.encode(sample)
            self._meet(self._decode(data), data, self._replayed, self._recorded)

    def on_event(self, topic: Topic, event: ModelEvent) -> None:
        """Events are not compared: the replay names them anew."""

    def finish(self) -> Differences:
        """What was found; call it when everything was taken."""
        for what, left in (("missing", self._recorded), ("added", self._replayed)):
            for (topic, _, _), data in left.items():
                sides = (data, None) if what == "missing" else (None, data)
                before, after = (None if side is None else msgspec.json.decode(side).get("data") for side in sides)
                self.found.add(Change(topic, self._decode(data).t, what, before, after))
            left.clear()
        return self.found

    def _meet(self, envelope: _Envelope, data: bytes, own: dict[_Name, bytes], other: dict[_Name, bytes]) -> None:
        name = (envelope.topic, envelope.epoch, envelope.seq)
        found = other.pop(name, None)
        if found is None:
            own[name] = data
            return
        before, after = (found, data) if own is self._replayed else (data, found)
        changes = list(_changes(_plain(before), _plain(after), ""))
        if not changes:
            self.found.same[envelope.topic] += 1
        for path, old, new in changes:
            self.found.add(Change(envelope.topic, envelope.t, path, old, new))


class _Envelope(msgspec.Struct):
    """Of a sample, its name and time."""

    topic: str
    epoch: str
    seq: int
    t: int


def _plain(data: bytes) -> dict[str, object]:
    """A sample without where it comes from, which a replay changes on purpose."""
    found: dict[str, object] = msgspec.json.decode(data)
    found.pop("origin", None)
    return found


def _changes(before: object, after: object, path: str) -> Iterator[tuple[str, object, object]]:
    """The leaves that differ, with their paths."""
    if isinstance(before, dict) and isinstance(after, dict):
        for key in dict.fromkeys([*before, *after]):
            yield from _changes(before.get(key), after.get(key), f"{path}.{key}" if path else str(key))
    elif before != after:
        yield path, before, after
