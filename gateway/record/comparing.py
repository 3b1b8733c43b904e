"""Compares the samples that were recorded with those that the same bytes give now."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field

import msgspec

from gateway.api.model import Event as ModelEvent
from gateway.core.bus import Reading, Topic
from gateway.record.reading import Entry

_JSON = msgspec.json.Encoder()
_REPLAY = b'"origin":"replay"'
_ORIGINS = (b'"origin":"live"', b'"origin":"sim"')


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
        changed: How many are not, by topic; missing and added ones are not among them.
        counts: How many changes there are, by topic and what changed.
        first: The first change of each.
    """

    same: Counter[str] = field(default_factory=Counter)
    changed: Counter[str] = field(default_factory=Counter)
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
        to_t: Until then; None: to the end.
    """

    def __init__(self, topics: Collection[str], from_t: int, to_t: int | None = None) -> None:
        self._topics = set(topics)
        self._from_t = from_t
        self._to_t = to_t
        self._recorded: dict[_Name, bytes] = {}
        self._replayed: dict[_Name, bytes] = {}
        self._decode = msgspec.json.Decoder(_Envelope).decode
        self.found = Differences()

    def recorded(self, entry: Entry) -> None:
        """Take a recorded sample."""
        if entry.topic in self._topics:
            envelope = self._decode(entry.data)
            name = (envelope.topic, envelope.epoch, envelope.seq)
            self._take(name, envelope.t, _as_replayed(entry.data), self._recorded, self._replayed)

    def on_reading(self, topic: Topic, reading: Reading) -> None:
        """Take a sample of the replay."""
        if topic.name in self._topics:
            sample = reading.sample(topic)
            name = (sample.topic, sample.epoch, sample.seq)
            self._take(name, sample.t, _JSON.encode(sample), self._replayed, self._recorded)

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

    def _take(self, name: _Name, t: int, data: bytes, own: dict[_Name, bytes], other: dict[_Name, bytes]) -> None:
        if t < self._from_t or (self._to_t is not None and t > self._to_t):  # or the state that stood at the beginning
            return
        found = other.pop(name, None)
        if found is None:
            own[name] = data
            return
        before, after = (found, data) if own is self._replayed else (data, found)
        changes = [] if before == after else list(_changes(_plain(before), _plain(after), ""))
        if not changes:
            self.found.same[name[0]] += 1
        else:
            self.found.changed[name[0]] += 1
        for path, old, new in changes:
            self.found.add(Change(name[0], t, path, old, new))


class _Envelope(msgspec.Struct):
    """Of a sample, its name and time."""

    topic: str
    epoch: str
    seq: int
    t: int


def _as_replayed(data: bytes) -> bytes:
    """A recorded sample with the origin of a replay: most are the same then, byte by byte."""
    for origin in _ORIGINS:
        if origin in data:
            return data.replace(origin, _REPLAY, 1)
    return data


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
