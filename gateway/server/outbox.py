"""What one client is owed: the samples of its subscriptions, queued events, and counts of what it missed.

Subscriptions stand in cohorts; the outbox collects what is due into as few messages as possible. Nothing here waits
for a socket: a client that does not read costs these bounds of memory and no more.
"""

from __future__ import annotations

import heapq
import math
from collections import Counter, deque
from collections.abc import Callable, Mapping, Sequence

import anyio

from gateway.api.messages import Missed
from gateway.api.model import Event
from gateway.core.bus import Topic
from gateway.core.clock import deadline_s
from gateway.server.backlog import Backlog
from gateway.server.cohort import QUEUED_SAMPLES, Batch, Cohorts, Shared, Source, Wish
from gateway.server.wire import Cut, Encoding, encode_events, encode_response

__all__ = ["QUEUED_EVENTS", "QUEUED_SAMPLES", "Outbox", "Source", "Subscription", "Wish"]

QUEUED_EVENTS = 20_000
# So many events, or samples of a backlog, leave in one turn: encoding more must not hold up the other clients.
EVENTS_A_MESSAGE = 500
SAMPLES_A_TURN = 200
# A client is told what it missed at most once in so many seconds.
MISSED_PERIOD_S = 1.0


def _no_turn(_: Shared) -> None:
    """Send nothing."""


class Subscription:
    """One subscription of one client: a member of the cohort of all that want the same.

    Args:
        wish: What was asked for.
        topics: What it matches.
        outbox: Where its samples leave.
        source: Where it finds further topics; None: it takes no others.
    """

    def __init__(self, wish: Wish, topics: Sequence[Topic], outbox: Outbox, source: Source | None = None) -> None:
        self._topics = tuple(topics)
        self._source = source
        self.wish = wish
        self._outbox = outbox
        self.backlog = Backlog(outbox.missed, every=wish.every)

    def open(self) -> None:
        """Start listening; the latest readings are due at once."""
        cohort = self._outbox.cohorts.join(self.wish, self._topics, self, self._source)
        first = [(topic, topic.latest) for topic in cohort.topics if topic.latest is not None]
        if first:
            self.receive(Batch(self.wish.cut, first))

    def close(self) -> None:
        """Stop listening."""
        self._outbox.cohorts.leave(self.wish, self._topics, self, self._source)

    def receive(self, batch: Batch) -> None:
        """Take readings that are due."""
        if self._outbox.behind:
            self.backlog.put(batch)
        else:
            self._outbox.owe(self, batch)

    def occurred(self, event: Event) -> None:
        """Take an event."""
        self._outbox.add_event(event)

    def lose(self, missed: Mapping[str, int]) -> None:
        """Take note of samples that will not come."""
        if missed:
            self._outbox.missed.update(missed)
            self._outbox.wake_by(self._outbox.missed_due_s)


class _Bell:
    """Wakes the one task of an outbox that stands alone; its cohorts know the bell and not the outbox."""

    def __init__(self) -> None:
        self._rung = anyio.Event()

    def ring(self, _: float) -> None:
        """Something is due by a monotonic time."""
        self._rung.set()

    async def rung(self) -> None:
        """Wait until it is rung."""
        self._rung = anyio.Event()
        await self._rung.wait()


class Outbox:
    """Everything that one client is owed.

    A door with many clients gives all of them the same cohorts, and calls `messages` when it is the client's turn. An
    outbox that stands alone has its own, and one task that calls `wait` and `collect`.

    Args:
        encoding: The client's encoding.
        flush_s: How long samples without a rate may be collected into one message.
        now: The monotonic clock, in s.
        cohorts: Those of the door; None: its own.
        on_turn: Called when something is due, with what is made in this turn.

    Attributes:
        missed: Samples that the client asked for and will not get, by topic.
        overflowed: Whether more events came than the bound allows: the client must go.
        behind: Whether samples wait in the backlogs because the client did not read.
        cohorts: Where its subscriptions stand.
    """

    def __init__(
        self,
        encoding: Encoding,
        flush_s: float,
        now: Callable[[], float],
        cohorts: Cohorts | None = None,
        on_turn: Callable[[Shared], None] = _no_turn,
    ) -> None:
        self.encoding = encoding
        self._bell = _Bell()
        self.cohorts = Cohorts(flush_s, now, self._bell.ring) if cohorts is None else cohorts
        self.flush = on_turn
        self.missed: Counter[str] = Counter()
        self.overflowed = False
        self.behind = False
        self.subscriptions: dict[int | str, Subscription] = {}
        self._cut = Cut(encoding, None)
        self._owed: list[tuple[Subscription, Batch]] = []
        self._events: deque[Event] = deque()
        self._last_seqs: dict[str, int] = {}  # by ring
        self._events_gone: int | None = 0
        self._missed_said_s = -math.inf
        self._is_closed = False

    @property
    def due_s(self) -> float:
        """Monotonic time when something is due."""
        return self.cohorts.due_s

    @property
    def missed_due_s(self) -> float:
        """Monotonic time when the client may be told again what it missed."""
        return self._missed_said_s + MISSED_PERIOD_S

    @property
    def has_more(self) -> bool:
        """Whether something is left that did not fit into the last messages."""
        return bool(self._events) or self.behind

    def add(self, name: int | str, subscription: Subscription) -> None:
        """Open a subscription; one of the same name is closed. Not when the client is on its way out."""
        if self._is_closed:
            return
        self.remove(name)
        self.subscriptions[name] = subscription
        subscription.open()

    def remove(self, name: int | str) -> bool:
        """Close a subscription; whether there was one."""
        found = self.subscriptions.pop(name, None)
        if found is not None:
            found.close()
            self._owed = [owed for owed in self._owed if owed[0] is not found]
        return found is not None

    def close(self) -> None:
        """Close every subscription; there are no more turns."""
        for name in list(self.subscriptions):
            self.remove(name)
        self.cohorts.forget(self)
        self.flush = _no_turn
        self._is_closed = True

    def pace(self, flush_s: float) -> None:
        """Collect samples without a rate for another time from now on, as all do that share its cohorts."""
        self.cohorts.pace(flush_s)

    def owe(self, subscription: Subscription, batch: Batch) -> None:
        """Take readings that are due."""
        self._owed.append((subscription, batch))
        self.cohorts.ask(self)

    def fall_behind(self) -> None:
        """Put what is due into the backlogs: the client cannot be written to."""
        self.behind = True
        for subscription, batch in self._owed:
            subscription.backlog.put(batch)
        self._owed.clear()

    def add_event(self, event: Event) -> None:
        """Queue an event; two subscriptions that match it deliver it once."""
        if event.seq <= self._last_seqs.get(event.boot, 0):
            return
        self._last_seqs[event.boot] = event.seq
        if len(self._events) >= QUEUED_EVENTS:
            self.overflowed = True
        else:
            self._events.append(event)
        self.cohorts.ask(self)

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
        self.cohorts.ask(self)

    def wake_by(self, at_s: float) -> None:
        """Make `wait` return, or the client's turn come, by a monotonic time."""
        self.cohorts.ask(self, at_s)

    async def wait(self) -> None:
        """Wait until something is due; only for an outbox that stands alone."""
        while self.due_s > self.cohorts.now():
            with anyio.CancelScope(deadline=deadline_s(self.due_s)):
                await self._bell.rung()

    def collect(self) -> list[bytes]:
        """Everything that is due now, as messages; only for an outbox that stands alone."""
        self.cohorts.distribute()
        return self.messages(Shared())

    def messages(self, shared: Shared) -> list[bytes]:
        """Everything that is owed now: events first, then all samples in one message, then what was missed."""
        messages = []
        if self._events:
            messages.append(self._next_events(shared))
        if self.behind:
            self._take_backlog()
        if self._owed:
            messages += shared.data(tuple([batch for _, batch in self._owed]))
            self._owed.clear()
        if self.missed or self._events_gone != 0:
            self._say_missed(shared, messages)
        if self._events or self.behind:
            self.cohorts.ask(self)
        return messages

    def _next_events(self, shared: Shared) -> bytes:
        events = [self._events.popleft() for _ in range(min(EVENTS_A_MESSAGE, len(self._events)))]
        names = tuple([event.name for event in events])
        return shared.other(self._cut, names, lambda: encode_events(self.encoding, events))

    def _take_backlog(self) -> None:
        """Owe the next piece of the backlogs; with the last one the client has caught up."""
        left = SAMPLES_A_TURN
        waiting = [subscription for subscription in self.subscriptions.values() if len(subscription.backlog)]
        for index, subscription in enumerate(waiting):  # each has its share: one that never ends holds up no other
            taken = subscription.backlog.take(max(1, left // (len(waiting) - index)))
            self._owed.append((subscription, Batch(subscription.wish.cut, taken)))
            left -= len(taken)
        self.behind = any(len(subscription.backlog) for subscription in self.subscriptions.values())

    def _say_missed(self, shared: Shared, messages: list[bytes]) -> None:
        now_s = self.cohorts.now()
        if self._events_gone == 0 and now_s < self.missed_due_s:
            self.cohorts.ask(self, self.missed_due_s)
            return
        message = Missed(samples=dict(self.missed), events=self._events_gone)
        shared.n_missed += self.missed.total()
        self.missed.clear()
        self._events_gone = 0
        self._missed_said_s = now_s
        key = ("missed", tuple(message.samples.items()), message.events)
        messages.append(shared.other(self._cut, key, lambda: encode_response(self.encoding, message)))
