"""What one Foxglove client is owed: the newest reading of each topic, events in order, and a word on what it missed.

It listens to the bus once for each topic, however many channels of it the client has. Nothing here waits for a socket:
a client that does not read costs these bounds of memory and no more.
"""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Callable

import anyio

from gateway.api.model import Event
from gateway.core.bus import Reading, Topic
from gateway.core.clock import deadline_s
from gateway.server.foxglove.channels import Channel
from gateway.server.foxglove.messages import WARNING, Status, data_frame
from gateway.server.foxglove.payloads import NOTHING
from gateway.server.inbox import Inbox, Newest, Rated
from gateway.server.outbox import QUEUED_EVENTS
from gateway.server.traffic import Traffic

# So many events leave at a time: encoding a long queue must not hold up the other clients.
EVENTS_AT_A_TIME = 500
# A client is told what it missed at most once in so many seconds: its user reads it.
MISSED_PERIOD_S = 10.0


class Outbox:
    """Everything that one client is owed.

    Args:
        flush_s: How long samples without a rate may wait for others.
        now: The monotonic clock, in s.
        period_s: Shortest time between two samples of a topic; None: every change, coalesced within the flush time.
        traffic: Where it is counted what the client misses.

    Attributes:
        missed: Samples that the client asked for and will not get, by topic.
        overflowed: Whether more events came than the bound allows: the client must go.
        due_s: Monotonic time when something is due.
    """

    def __init__(
        self,
        flush_s: float,
        now: Callable[[], float],
        period_s: float | None = None,
        traffic: Traffic | None = None,
    ) -> None:
        self.now = now
        self._traffic = traffic or Traffic()
        self.missed: Counter[str] = Counter()
        self.overflowed = False
        self.due_s = math.inf
        self._states: Inbox = Newest(0.0, None)
        self._samples: Inbox = Newest(flush_s, self.missed) if period_s is None else Rated(period_s, now(), self.missed)
        self._channels: dict[Topic, dict[int, Channel]] = {}  # by subscription
        self._first: dict[int, tuple[Channel, Reading]] = {}
        self._told_first: dict[int, Reading] = {}
        self._events: deque[tuple[Topic, Event]] = deque()
        self._missed_said_s = now()
        self._wake = anyio.Event()

    def subscribe(self, name: int, channel: Channel) -> None:
        """Owe a channel; what is latched of it is due at once."""
        topic = channel.topic
        known = self._channels.setdefault(topic, {})
        if not known:
            topic.listeners = [*topic.listeners, self]
        known[name] = channel
        if channel.tell is None and topic.latest is not None:
            self._first[name] = (channel, topic.latest)
            self.wake_by(-math.inf)

    def unsubscribe(self, name: int, channel: Channel) -> None:
        """Owe it no longer."""
        topic = channel.topic
        self._first.pop(name, None)
        self._told_first.pop(name, None)
        known = self._channels[topic]
        del known[name]
        if not known:
            self._leave(topic)

    def close(self) -> None:
        """Owe nothing any more."""
        for topic in list(self._channels):
            self._leave(topic)

    def pace(self, flush_s: float) -> None:
        """Collect samples without a rate for another time from now on."""
        self._samples.pace(flush_s)

    def on_reading(self, topic: Topic, reading: Reading) -> None:
        """Take a reading from the bus."""
        inbox = self._states if topic.group.delivery == "state" else self._samples
        inbox.put(topic, reading, self.now())
        self.wake_by(inbox.due_s)

    def on_event(self, topic: Topic, event: Event) -> None:
        """Take an event from the bus."""
        if len(self._events) >= QUEUED_EVENTS:
            self.overflowed = True
        else:
            self._events.append((topic, event))
        self.wake_by(-math.inf)

    @property
    def has_more(self) -> bool:
        """Whether events are left that were too many to leave at once."""
        return bool(self._events)

    def wake_by(self, at_s: float) -> None:
        """Make `wait` return by a monotonic time."""
        if at_s < self.due_s:
            self.due_s = at_s
            self._wake.set()

    async def wait(self) -> None:
        """Wait until something is due."""
        while self.due_s > self.now():
            self._wake = anyio.Event()
            with anyio.CancelScope(deadline=deadline_s(self.due_s)):
                await self._wake.wait()

    def collect(self) -> list[bytes]:
        """The binary frames of everything that is due now: events in order, then what is latched, then samples."""
        now_s = self.now()
        frames = [
            data_frame(name, event.t, channel.tell(event))
            for topic, event in self._next_events()
            for name, channel in self._channels.get(topic, {}).items()
            if channel.tell is not None
        ]
        for name, (channel, reading) in self._first.items():
            self._told_first[name] = reading
            frames += _frame(name, channel, reading)
        self._first.clear()
        for topic, reading in (*self._states.take(now_s), *self._samples.take(now_s)):
            for name, channel in self._channels.get(topic, {}).items():
                if self._told_first.pop(name, None) is not reading:
                    frames += _frame(name, channel, reading)
        self.due_s = -math.inf if self._events else min(self._states.due_s, self._samples.due_s)
        if self.missed:
            self.due_s = min(self.due_s, self._missed_said_s + MISSED_PERIOD_S)
        return frames

    def word_on_missed(self) -> Status | None:
        """Tell what was left out since the last word; None: nothing, or it is too early."""
        now_s = self.now()
        if not self.missed or now_s < self._missed_said_s + MISSED_PERIOD_S:
            return None
        (worst, _), *_ = self.missed.most_common(1)
        text = f"{self.missed.total()} samples were left out, most of {worst}: this client is slower than they come"
        self._traffic.missed_samples += self.missed.total()
        self.missed.clear()
        self._missed_said_s = now_s
        return Status(level=WARNING, message=text, id="missed")

    def _next_events(self) -> list[tuple[Topic, Event]]:
        return [self._events.popleft() for _ in range(min(EVENTS_AT_A_TIME, len(self._events)))]

    def _leave(self, topic: Topic) -> None:
        del self._channels[topic]
        topic.listeners = [listener for listener in topic.listeners if listener is not self]


def _frame(name: int, channel: Channel, reading: Reading) -> list[bytes]:
    """The frame of a reading, if it says anything on a channel."""
    payload = channel.payload(reading)
    return [] if payload == NOTHING else [data_frame(name, reading.sample(channel.topic).t, payload)]
