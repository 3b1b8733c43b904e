"""Cohorts: subscriptions that want the same of the same topics share one inbox, one encoding and one message.

What is due is given out in turns, for all clients of a door at once. Nothing here knows of a socket or of a loop.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

from gateway.api.model import Event
from gateway.core.bus import Bus, Change, Reading, Topic
from gateway.server.inbox import Every, Inbox, Newest, Rated
from gateway.server.wire import Cut

QUEUED_SAMPLES = 10_000
# No message is much longer: many clients' libraries take 1 MiB at most.
MESSAGE_BYTES = 1 << 19
Due = tuple[Topic, Reading]


@dataclass(frozen=True, slots=True, kw_only=True)
class Wish:
    """What one subscription asked for.

    Args:
        period_s: Shortest time between two samples of a topic; None: every change, coalesced within the flush time.
        every: Whether every sample is wanted, up to the bound.
        cut: Fields and encoding.
    """

    period_s: float | None
    every: bool
    cut: Cut


@dataclass(frozen=True, slots=True, kw_only=True)
class Source:
    """Where a subscription finds its topics, now and when others come.

    Args:
        bus: Has the topics.
        patterns: Globs of those that were asked for.
        scope: Globs of those that the client may see; None: all.
    """

    bus: Bus
    patterns: tuple[str, ...]
    scope: tuple[str, ...] | None

    def new(self, change: Change) -> list[Topic]:
        """The topics of a change that it finds."""
        found = change.matching(self.patterns)
        return found if self.scope is None else [topic for topic in found if topic in change.matching(self.scope)]


class Batch:
    """Readings that leave together, encoded when the first of their receivers is written to.

    Args:
        cut: Fields and encoding.
        readings: In order per topic.
    """

    __slots__ = ("_parts", "cut", "readings")

    def __init__(self, cut: Cut, readings: Sequence[Due]) -> None:
        self.cut = cut
        self.readings = readings
        self._parts: list[bytes] | None = None

    @property
    def parts(self) -> list[bytes]:
        """The encoded samples."""
        if self._parts is None:
            encoded = self.cut.encoded
            self._parts = [encoded(topic, reading) for topic, reading in self.readings]
        return self._parts


class Member(Protocol):
    """One subscription in a cohort. Nothing of it may raise or wait."""

    def receive(self, batch: Batch) -> None:
        """Take readings that are due; the same object goes to every member."""
        ...

    def occurred(self, event: Event) -> None:
        """Take an event."""
        ...

    def lose(self, missed: Mapping[str, int]) -> None:
        """Take note of samples that will not come, by topic."""
        ...


class Owner(Protocol):
    """One client: who gets a turn when something for it is due."""

    def flush(self, shared: Shared) -> None:
        """Send what is due."""
        ...


class Shared:
    """What has been made in one turn, so that equal messages are made once for all clients.

    Args:
        finish: What a door does to each message, such as putting it into a frame; also made once.

    Attributes:
        n_missed: How many samples clients were told in this turn that they have missed.
    """

    def __init__(self, finish: Callable[[Cut, bytes], bytes] = lambda _, message: message) -> None:
        self._finish = finish
        self._data: dict[tuple[Batch, ...], list[bytes]] = {}
        self._others: dict[object, bytes] = {}
        self.n_missed = 0

    def data(self, batches: tuple[Batch, ...]) -> list[bytes]:
        """The samples of some batches of one encoding: one message, or several where it would be very long."""
        found = self._data.get(batches)
        if found is None:
            cut = batches[0].cut
            pieces = _pieces([part for batch in batches for part in batch.parts])
            made = [cut.encoding.list_message("data", "samples", piece) for piece in pieces]
            found = self._data[batches] = [self._finish(cut, message) for message in made]
        return found

    def other(self, cut: Cut, key: object, make: Callable[[], bytes]) -> bytes:
        """Another message, known by a key within its encoding."""
        found = self._others.get((cut.encoding.name, key))
        if found is None:
            found = self._others[cut.encoding.name, key] = self._finish(cut, make())
        return found


class Cohort:
    """A listener on some topics for all who want the same of them. What is latched goes at once, samples when due.

    Args:
        wish: What was asked for.
        topics: What it matches.
        turns: Who lets out what is due.
        source: Where further topics come from; None: there will be no others.

    Attributes:
        topics: What it matches now.
        collects: Whether its samples wait for others of the same flush time, not for a slot of their own.
        samples_due_s: Monotonic time when samples are due.
        due_s: Monotonic time when something is due.
    """

    def __init__(self, wish: Wish, topics: Sequence[Topic], turns: Cohorts, source: Source | None = None) -> None:
        self._cut = wish.cut
        self.topics = tuple(topics)
        self._source = source
        self._turns = turns
        self._missed = Counter[str]()
        self._members: dict[Member, None] = {}
        self._newcomers: dict[Member, dict[Topic, Reading | None]] = {}
        self.collects = wish.period_s is None
        self._states, self._samples = _inboxes(wish, turns, self._missed)
        self.due_s = math.inf

    @property
    def samples_due_s(self) -> float:
        """Monotonic time when samples are due."""
        return self._samples.due_s

    def add(self, member: Member) -> None:
        """Take in a subscription: nothing that waits now is for it, for it is given the latest values by itself."""
        if not self._members:
            self._listen(self.topics)
            if self._source is not None:
                self._source.bus.watch(self)
        else:
            self.give(math.inf if self.collects else self._turns.now(), closing=True)
            if not self.collects:
                self._newcomers[member] = {topic: topic.latest for topic in self.topics}
        self._members[member] = None

    def remove(self, member: Member) -> bool:
        """Let a subscription go; whether it was the last."""
        self._tell_missed()
        del self._members[member]
        self._newcomers.pop(member, None)
        if not self._members:
            self._leave(self.topics)
            if self._source is not None:
                self._source.bus.unwatch(self)
        return not self._members

    def on_topics(self, change: Change) -> None:
        """Take in the topics that have come, with what they say now, and let go those that have gone."""
        new = [] if self._source is None else self._source.new(change)
        self._leave([topic for topic in self.topics if topic in change.removed])
        self._listen(new)
        self.topics = (*(topic for topic in self.topics if topic not in change.removed), *new)
        for topic in new:
            if topic.latest is not None:
                self.on_reading(topic, topic.latest)

    def pace(self, flush_s: float) -> None:
        """Collect samples for another time from now on."""
        if self.collects:
            self._samples.pace(flush_s)

    def on_reading(self, topic: Topic, reading: Reading) -> None:
        """Take a reading from the bus."""
        inbox = self._states if topic.group.delivery == "state" else self._samples
        inbox.put(topic, reading, self._turns.now())
        if inbox.due_s < self.due_s:
            self.due_s = inbox.due_s
            self._turns.expect(self)

    def on_event(self, topic: Topic, event: Event) -> None:  # noqa: ARG002 - a listener's signature
        """Take an event from the bus."""
        for member in self._members:
            member.occurred(event)

    def give(self, now_s: float, *, closing: bool) -> None:
        """Give every member what is due.

        Args:
            now_s: The monotonic time.
            closing: Whether samples that wait for others wait no longer.
        """
        readings = self._states.take(now_s)
        readings += self._samples.take(math.inf if closing and self.collects else now_s)
        self.due_s = min(self._states.due_s, self._samples.due_s)
        if self._missed:
            self._tell_missed()
        if readings and self._newcomers:
            self._give_each(readings)
        elif readings:
            batch = Batch(self._cut, readings)
            for member in self._members:
                member.receive(batch)

    def _give_each(self, readings: Sequence[Due]) -> None:
        """The same, where some members have been given a part of it when they came."""
        whole = Batch(self._cut, readings)
        for member in self._members:
            known = self._newcomers.get(member)
            batch = whole
            if known is not None:
                batch = Batch(self._cut, [(topic, one) for topic, one in readings if one is not known.get(topic)])
            if batch.readings:
                member.receive(batch)
        if self._samples.due_s == math.inf:
            self._newcomers.clear()

    def _listen(self, topics: Iterable[Topic]) -> None:
        for topic in topics:
            topic.listeners = [*topic.listeners, self]

    def _leave(self, topics: Iterable[Topic]) -> None:
        for topic in topics:
            topic.listeners = [listener for listener in topic.listeners if listener is not self]

    def _tell_missed(self) -> None:
        for member in self._members:
            member.lose(self._missed)
        self._missed.clear()


class Cohorts:
    """All cohorts of a door, and who of its clients wants a turn.

    Args:
        flush_s: How long samples without a rate may be collected into one message.
        now: The monotonic clock, in s.
        wake: Called with the monotonic time by which `distribute` wants to be called.

    Attributes:
        start_s: Slot 0 of every rate: what is due in the slots of several cohorts leaves in one turn.
        due_s: Monotonic time when something is due.
    """

    def __init__(self, flush_s: float, now: Callable[[], float], wake: Callable[[float], None]) -> None:
        self.flush_s = flush_s
        self.start_s = now()
        self.now = now
        self.due_s = math.inf
        self._wake = wake
        self._cohorts: dict[object, Cohort] = {}
        self._waiting: dict[Cohort, None] = {}
        self._turns: dict[Owner, float] = {}

    def __len__(self) -> int:
        return len(self._cohorts)

    def join(self, wish: Wish, topics: tuple[Topic, ...], member: Member, source: Source | None = None) -> Cohort:
        """Let a subscription listen, together with those that want the same."""
        key = (wish, source or topics)
        cohort = self._cohorts.get(key)
        if cohort is None:
            cohort = self._cohorts[key] = Cohort(wish, topics, self, source)
        cohort.add(member)
        return cohort

    def leave(self, wish: Wish, topics: tuple[Topic, ...], member: Member, source: Source | None = None) -> None:
        """Let a subscription go that has joined with the same words."""
        key = (wish, source or topics)
        cohort = self._cohorts[key]
        if cohort.remove(member):
            del self._cohorts[key]
            self._waiting.pop(cohort, None)

    def pace(self, flush_s: float) -> None:
        """Collect samples without a rate for another time from now on."""
        self.flush_s = flush_s
        for cohort in self._cohorts.values():
            cohort.pace(flush_s)

    def expect(self, cohort: Cohort) -> None:
        """Something waits in a cohort."""
        self._waiting[cohort] = None
        self._wake_by(cohort.due_s)

    def ask(self, owner: Owner, at_s: float = -math.inf) -> None:
        """Give a client a turn by a monotonic time."""
        if at_s < self._turns.get(owner, math.inf):
            self._turns[owner] = at_s
            self._wake_by(at_s)

    def forget(self, owner: Owner) -> None:
        """A client has gone."""
        self._turns.pop(owner, None)

    def distribute(self) -> list[Owner]:
        """Give out what is due, everything that is collected at one time; returns whose turn it is."""
        now_s = self.now()
        self.due_s = -math.inf  # nobody need be woken for what is given out here
        closing = any(cohort.samples_due_s <= now_s for cohort in self._waiting)
        for cohort in list(self._waiting):
            if cohort.due_s <= now_s or (closing and cohort.collects):
                cohort.give(now_s, closing=closing)
            if cohort.due_s == math.inf:
                del self._waiting[cohort]
        turns = [owner for owner, at_s in self._turns.items() if at_s <= now_s]
        for owner in turns:
            del self._turns[owner]
        self.due_s = math.inf
        next_s = min((cohort.due_s for cohort in self._waiting), default=math.inf)
        self._wake_by(min(next_s, min(self._turns.values(), default=math.inf)))
        return turns

    def _wake_by(self, at_s: float) -> None:
        if at_s < self.due_s:
            self.due_s = at_s
            self._wake(at_s)


def _pieces(parts: list[bytes]) -> list[list[bytes]]:
    """Cut a long list of samples where it comes to the length of a message."""
    if sum(map(len, parts)) <= MESSAGE_BYTES:
        return [parts]
    pieces: list[list[bytes]] = [[]]
    size = 0
    for part in parts:
        size += len(part)
        if size > MESSAGE_BYTES and pieces[-1]:
            pieces.append([])
            size = len(part)
        pieces[-1].append(part)
    return pieces


def _inboxes(wish: Wish, turns: Cohorts, missed: Counter[str]) -> tuple[Inbox, Inbox]:
    """Make the inboxes of the state topics and of the sample topics."""
    if wish.every:
        return Every(0.0, QUEUED_SAMPLES, missed), Every(turns.flush_s, QUEUED_SAMPLES, missed)
    if wish.period_s is None:
        return Newest(0.0, None), Newest(turns.flush_s, missed)
    return Newest(0.0, None), Rated(wish.period_s, turns.start_s, missed)
