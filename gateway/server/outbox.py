"""What one client is owed: the samples of its subscriptions, queued events, and counts of what it missed.

Subscriptions listen to the bus; the outbox collects what is due into as few messages as possible. Nothing here waits
for a socket: a client that does not read costs these bounds of memory and no more.
"""

from __future__ import annotations

import heapq
import math
from collections import Counter, deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import anyio

from gateway.api.messages import Missed
from gateway.api.model import Event
from gateway.core.bus import Reading, Topic
from gateway.core.clock import deadline_s
from gateway.server.inbox import Every, Inbox, Newest, Rated
from gateway.server.wire import Cut, Encoding, encode_events, encode_response

QUEUED_SAMPLES = 10_000
QUEUED_EVENTS = 20_000
# So many events go into one message: encoding a long queue must not hold up the other clients.
EVENTS_A_MESSAGE = 500
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
    """One subscription: a listener on its topics. What is latched goes at once, samples when they are due.

    Args:
        wish: What was asked for.
        topics: What it matches.
        outbox: Where its samples leave.
    """

    def __init__(self, wish: Wish, topics: Sequence[Topic], outbox: Outbox) -> None:
        self.topics = tuple(topics)
        self._encoded = wish.cut.encoded
        self._outbox = outbox
        self._first: list[tuple[Topic, Reading]] = []
        self._states, self._samples = _inboxes(wish, outbox)

    @property
    def due_s(self) -> float:
        """Monotonic time when something of it is due."""
        return -math.inf if self._first else min(self._states.due_s, self._samples.due_s)

    def open(self) -> None:
        """Start listening; the latest readings are due at once."""
        for topic in self.topics:
            topic.listeners = [*topic.listeners, self]
            if topic.latest is not None:
                self._first.append((topic, topic.latest))
        self._outbox.wake_by(self.due_s)

    def close(self) -> None:
        """Stop listening."""
        for topic in self.topics:
            topic.listeners = [listener for listener in topic.listeners if listener is not self]

    def on_reading(self, topic: Topic, reading: Reading) -> None:
        """Take a reading from the bus."""
        inbox = self._states if topic.group.delivery == "state" else self._samples
        inbox.put(topic, reading, self._outbox.now())
        self._outbox.wake_by(inbox.due_s)

    def on_event(self, topic: Topic, event: Event) -> None:  # noqa: ARG002 - a listener's signature
        """Take an event from the bus."""
        self._outbox.add_event(event)

    def take(self, now_s: float) -> list[bytes]:
        """Give out everything that is due now, encoded, in order per topic."""
        first, self._first = self._first, []
        due = [*first, *self._states.take(now_s), *self._samples.take(now_s)]
        return [self._encoded(topic, reading) for topic, reading in due]


class Outbox:
    """Everything that one client is owed.

    Args:
        encoding: The client's encoding.
        flush_s: How long samples without a rate may be collected into one message.
        now: The monotonic clock, in s.

    Attributes:
        missed: Samples that the client asked for and will not get, by topic.
        overflowed: Whether more events came than the bound allows: the client must go.
        due_s: Monotonic time when something is due.
    """

    def __init__(self, encoding: Encoding, flush_s: float, now: Callable[[], float]) -> None:
        self.encoding = encoding
        self.flush_s = flush_s
        self.now = now
        self.missed: Counter[str] = Counter()
        self.overflowed = False
        self.subscriptions: dict[int | str, Subscription] = {}
        self.due_s = math.inf
        self._events: deque[Event] = deque()
        self._last_seqs: dict[str, int] = {}  # by ring
        self._events_gone: int | None = 0
        self._missed_said_s = -math.inf
        self._wake = anyio.Event()

    def add(self, name: int | str, subscription: Subscription) -> None:
        """Open a subscription; one of the same name is closed."""
        self.remove(name)
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

    def add_event(self, event: Event) -> None:
        """Queue an event; two subscriptions that match it deliver it once."""
        if event.seq <= self._last_seqs.get(event.boot, 0):
            return
        self._last_seqs[event.boot] = event.seq
        if len(self._events) >= QUEUED_EVENTS:
            self.overflowed = True
        else:
            self._events.append(event)
        self.wake_by(-math.inf)

    def resume(self, events: Sequence[Event], missed: int | None) -> None:
        """Queue the events that a client reads on after, up to the bound: then the oldest count as missed.

        Args:
            events: In order.
            missed: How many are gone from the ring; None: their number is not known.
        """
        rings: dict[str, dict[int, Event]] = {}
        for event in (*events, *self._events):
            rings.setdefault(event.boot, {})[event.seq] = event
        for boot, by_seq in rings.items():
            self._last_seqs[boot] = max(self._last_seqs.get(boot, 0), *by_seq)
        in_order = ([by_seq[seq] for seq in sorted(by_seq)] for by_seq in rings.values())
        merged = list(heapq.merge(*in_order, key=lambda event: event.t))  # each ring stays in its own order
        over = max(0, len(merged) - QUEUED_EVENTS)
        self._events = deque(merged[over:])
        if missed is None or self._events_gone is None:
            self._events_gone = None
        else:
            self._events_gone += missed + over
        self.wake_by(-math.inf)

    @property
    def has_more(self) -> bool:
        """Whether events are left that did not fit into the last message."""
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
        """Everything that is due now, as messages: events first, then all samples in one, then what was missed."""
        now_s = self.now()
        messages = []
        if self._events:
            next_ones = [self._events.popleft() for _ in range(min(EVENTS_A_MESSAGE, len(self._events)))]
            messages.append(encode_events(self.encoding, next_ones))
        due = [subscription for subscription in self.subscriptions.values() if subscription.due_s <= now_s]
        parts = [part for subscription in due for part in subscription.take(now_s)]
        if parts:
            messages.append(self.encoding.list_message("data", "samples", parts))
        if self._events_gone != 0 or (self.missed and now_s >= self._missed_said_s + MISSED_PERIOD_S):
            messages.append(self._say_missed(now_s))
        self.due_s = min((one.due_s for one in self.subscriptions.values()), default=math.inf)
        if self._events:
            self.due_s = -math.inf
        if self.missed:
            self.due_s = min(self.due_s, self._missed_said_s + MISSED_PERIOD_S)
        return messages

    def _say_missed(self, now_s: float) -> bytes:
        message = Missed(samples=dict(self.missed), events=self._events_gone)
        self.missed.clear()
        self._events_gone = 0
        self._missed_said_s = now_s
        return encode_response(self.encoding, message)


def _inboxes(wish: Wish, outbox: Outbox) -> tuple[Inbox, Inbox]:
    """Make the inboxes of the state topics and of the sample topics."""
    if wish.every:
        return Every(0.0, QUEUED_SAMPLES, outbox.missed), Every(outbox.flush_s, QUEUED_SAMPLES, outbox.missed)
    if wish.period_s is None:
        return Newest(0.0, None), Newest(outbox.flush_s, outbox.missed)
    return Newest(0.0, None), Rated(wish.period_s, outbox.now(), outbox.missed)
