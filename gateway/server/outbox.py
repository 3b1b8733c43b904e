"""What one subscriber is owed: the newest samples, queued events, and counts of what it missed.

Subscriptions listen to the bus; the outbox collects what is due into as few messages as possible. Nothing here waits for
a socket: a client that does not read costs these bounds of memory and no more.
"""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import anyio

from gateway.api.messages import Missed
from gateway.api.model import Event
from gateway.core.bus import Reading, Topic
from gateway.server.wire import Cut, Encoding, encode_events, encode_response

QUEUED_SAMPLES = 10_000
QUEUED_EVENTS = 10_000
# A client is told what it missed at most once in so many seconds.
MISSED_PERIOD_S = 1.0


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


class Subscription:
    """One subscription: a listener on its topics.

    Args:
        wish: What was asked for.
        topics: What it matches.
        outbox: Where its samples leave.
        start_s: Monotonic time that the slots of `period_s` are locked to.
    """

    def __init__(self, wish: Wish, topics: Sequence[Topic], outbox: Outbox, start_s: float) -> None:
        self.wish = wish
        self.topics = tuple(topics)
        self._outbox = outbox
        self._start_s = start_s
        self.newest: dict[Topic, Reading] = {}
        self.queue: deque[tuple[Topic, Reading]] = deque()
        self.due_s = math.inf

    def open(self) -> None:
        """Start listening; the latest readings are due at once."""
        for topic in self.topics:
            topic.listeners = [*topic.listeners, self]
            if topic.latest is not None:
                self.newest[topic] = topic.latest
                self._due(self._outbox.now())

    def close(self) -> None:
        """Stop listening."""
        for topic in self.topics:
            topic.listeners = [listener for listener in topic.listeners if listener is not self]

    def on_reading(self, topic: Topic, reading: Reading) -> None:
        """Take a reading from the bus."""
        if self.wish.every:
            self.queue.append((topic, reading))
            if len(self.queue) > QUEUED_SAMPLES:
                self._outbox.missed[self.queue.popleft()[0].name] += 1
        elif topic in self.newest:
            if self.wish.period_s is None and topic.group.delivery == "sample":
                self._outbox.missed[topic.name] += 1
            self.newest[topic] = reading
            return  # its time is already set
        else:
            self.newest[topic] = reading
        if topic.group.delivery == "state":
            self._due(self._outbox.now())
        elif self.wish.period_s is None:
            if self.due_s == math.inf:
                self._due(self._outbox.now() + self._outbox.flush_s)
        elif self.due_s == math.inf:
            self._due(self._next_slot_s(self._outbox.now()))

    def on_event(self, topic: Topic, event: Event) -> None:
        """Take an event from the bus."""
        self._outbox.add_event(topic, event)

    def take(self) -> list[bytes]:
        """Take everything out, encoded, in order per topic."""
        if self.wish.period_s is not None:  # slots that passed while the client could not be written to
            lost = int((self._outbox.now() - self.due_s) / self.wish.period_s)
            if lost > 0:
                self._outbox.missed.update(
                    {topic.name: lost for topic in self.newest if topic.group.delivery == "sample"}
                )
        encoded = self.wish.cut.encoded
        parts = [encoded(topic, reading) for topic, reading in self.newest.items()]
        parts += [encoded(topic, reading) for topic, reading in self.queue]
        self.newest.clear()
        self.queue.clear()
        self.due_s = math.inf
        return parts

    def _next_slot_s(self, now_s: float) -> float:
        """The next slot of the phase-locked rate."""
        period_s = self.wish.period_s or 0.0
        slots = math.floor((now_s - self._start_s) / period_s) + 1
        return self._start_s + slots * period_s

    def _due(self, at_s: float) -> None:
        if at_s < self.due_s:
            self.due_s = at_s
            self._outbox.wake_by(at_s)


class Outbox:
    """Everything that one client is owed.

    Args:
        encoding: The client's encoding.
        flush_s: How long samples without a rate may be collected into one message.
        now: The monotonic clock, in s.

    Attributes:
        missed: Samples that the client asked for and will not get, by topic.
        overflowed: Whether more events came than the bound allows: the client must go.
    """

    def __init__(self, encoding: Encoding, flush_s: float, now: Callable[[], float]) -> None:
        self.encoding = encoding
        self.flush_s = flush_s
        self.now = now
        self.missed: Counter[str] = Counter()
        self.overflowed = False
        self.subscriptions: dict[int | str, Subscription] = {}
        self._events: deque[Event] = deque()
        self._last_seq = 0
        self._events_gone: int | None = 0
        self._missed_said_s = -math.inf
        self._due_s = math.inf
        self._wake = anyio.Event()

    def add(self, name: int | str, subscription: Subscription) -> None:
        """Open a subscription."""
        self.subscriptions[name] = subscription
        subscription.open()

    def remove(self, name: int | str) -> bool:
        """Close a subscription; whether there was one."""
        found = self.subscriptions.pop(name, None)
        if found is not None:
            found.close()
        return found is not None

    def close(self) -> None:
        """Close every subscription."""
        for name in list(self.subscriptions):
            self.remove(name)

    def add_event(self, topic: Topic, event: Event) -> None:  # noqa: ARG002 - a listener's signature
        """Queue an event; two subscriptions that match it deliver it once."""
        if event.seq <= self._last_seq:
            return
        self._last_seq = event.seq
        if len(self._events) >= QUEUED_EVENTS:
            self.overflowed = True
        else:
            self._events.append(event)
        self.wake_by(self.now())

    def resume(self, events: Sequence[Event], missed: int | None) -> None:
        """Queue the events that a client reads on after; `missed` are gone from the ring (None: number not known)."""
        for event in events:
            if event.seq > self._last_seq:
                self._events.append(event)
                self._last_seq = event.seq
        if missed is None or self._events_gone is None:
            self._events_gone = None
        else:
            self._events_gone += missed
        self.wake_by(self.now())

    def wake_by(self, at_s: float) -> None:
        """Make `wait` return by a monotonic time."""
        if at_s < self._due_s:
            self._due_s = at_s
            self._wake.set()

    async def wait(self) -> None:
        """Wait until something is due."""
        while True:
            now_s = self.now()
            if self._due_s <= now_s:
                return
            self._wake = anyio.Event()
            with anyio.CancelScope(deadline=math.ceil(self._due_s * 1000) / 1000):
                await self._wake.wait()

    def collect(self) -> list[bytes]:
        """Everything that is due now, as messages: events first, then all samples in one, then what was missed."""
        now_s = self.now()
        messages = []
        if self._events:
            messages.append(encode_events(self.encoding, self._events))
            self._events.clear()
        parts: list[bytes] = []
        for subscription in self.subscriptions.values():
            if subscription.due_s <= now_s:
                parts += subscription.take()
        if parts:
            messages.append(self.encoding.list_message("data", "samples", parts))
        if self._may_say_missed(now_s):
            messages.append(self._say_missed(now_s))
        self._due_s = min((one.due_s for one in self.subscriptions.values()), default=math.inf)
        if self.missed:
            self._due_s = min(self._due_s, self._missed_said_s + MISSED_PERIOD_S)
        return messages

    def _may_say_missed(self, now_s: float) -> bool:
        return self._events_gone != 0 or (bool(self.missed) and now_s >= self._missed_said_s + MISSED_PERIOD_S)

    def _say_missed(self, now_s: float) -> bytes:
        message = Missed(samples=dict(self.missed), events=self._events_gone)
        self.missed.clear()
        self._events_gone = 0
        self._missed_said_s = now_s
        return encode_response(self.encoding, message)
