"""Where the readings of one subscription wait until they are due: one class for each way of being delivered.

They share one small interface (`Inbox`) and know nothing of encodings, sockets or the clock.
"""

from __future__ import annotations

import math
from collections import Counter, deque
from dataclasses import dataclass
from typing import Protocol

from gateway.core.bus import Reading, Topic

Missed = Counter[str]  # by topic: samples that were asked for and will not be sent


class Inbox(Protocol):
    """Readings on their way to one client.

    Attributes:
        due_s: Monotonic time when the first of them is due, at once for an urgent one; infinite while there is none.
    """

    due_s: float

    def put(self, topic: Topic, reading: Reading, now_s: float) -> None:
        """Take a reading that has come now."""
        ...

    def take(self, now_s: float) -> list[tuple[Topic, Reading]]:
        """Give out what is due now, in order per topic."""
        ...

    def pace(self, flush_s: float) -> None:
        """Let readings wait for others for so long from now on, where they wait for others."""
        ...


class Newest:
    """The newest reading of each topic, a little later, so that several leave in one message.

    Args:
        flush_s: How long a reading may wait for others.
        missed: Where a reading is counted that a newer one has replaced; None: values in between may merge.
    """

    def __init__(self, flush_s: float, missed: Missed | None) -> None:
        self.due_s = math.inf
        self._flush_s = flush_s
        self._missed = missed
        self._readings: dict[Topic, Reading] = {}

    def put(self, topic: Topic, reading: Reading, now_s: float) -> None:
        """Take a reading that has come now."""
        if not self._readings:
            self.due_s = now_s + self._flush_s
        elif self._missed is not None and topic in self._readings:
            self._missed[topic.name] += 1
        self._readings[topic] = reading
        if reading.urgent:
            self.due_s = now_s

    def take(self, now_s: float) -> list[tuple[Topic, Reading]]:
        """Give out what is due now."""
        if now_s < self.due_s:
            return []
        taken = list(self._readings.items())
        self._readings.clear()
        self.due_s = math.inf
        return taken

    def pace(self, flush_s: float) -> None:
        """Let readings wait for others for so long from now on."""
        self._flush_s = flush_s


class Every:
    """Every reading, in order, up to a bound; then the oldest give way.

    Args:
        flush_s: How long a reading may wait for others.
        bound: How many may wait.
        missed: Where those that gave way are counted.
    """

    def __init__(self, flush_s: float, bound: int, missed: Missed) -> None:
        self.due_s = math.inf
        self._flush_s = flush_s
        self._bound = bound
        self._missed = missed
        self._readings: deque[tuple[Topic, Reading]] = deque()

    def put(self, topic: Topic, reading: Reading, now_s: float) -> None:
        """Take a reading that has come now."""
        if not self._readings:
            self.due_s = now_s + self._flush_s
        self._readings.append((topic, reading))
        if len(self._readings) > self._bound:
            lost, _ = self._readings.popleft()
            self._missed[lost.name] += 1
        if reading.urgent:
            self.due_s = now_s

    def take(self, now_s: float) -> list[tuple[Topic, Reading]]:
        """Give out what is due now."""
        if now_s < self.due_s:
            return []
        taken = list(self._readings)
        self._readings.clear()
        self.due_s = math.inf
        return taken

    def pace(self, flush_s: float) -> None:
        """Let readings wait for others for so long from now on."""
        self._flush_s = flush_s


@dataclass(slots=True)
class _Waiting:
    """The newest reading of a topic: the slots that it is due in and came for, and how many have passed between."""

    reading: Reading
    due: int
    newest: int
    passed: int = 0
    urgent: bool = False


class Rated:
    """The newest reading of each topic in the slots of a fixed rate: exact over any time, and the last one comes.

    An urgent reading waits for no slot, and takes none. A client that could not be written to when a slot was due gets
    the newest reading late; only whole slots that it lost by that are missed.

    Args:
        period_s: Time between two slots.
        start_s: Monotonic time of slot 0.
        missed: Where lost slots are counted.
    """

    def __init__(self, period_s: float, start_s: float, missed: Missed) -> None:
        self.due_s = math.inf
        self._period_s = period_s
        self._start_s = start_s
        self._missed = missed
        self._taken = 0  # whole numbers, so that rounding can never serve a slot twice
        self._waiting: dict[Topic, _Waiting] = {}

    def put(self, topic: Topic, reading: Reading, now_s: float) -> None:
        """Take a reading that has come now."""
        slot = max(math.floor((now_s - self._start_s) / self._period_s), self._taken) + 1
        waiting = self._waiting.get(topic)
        if waiting is None:
            waiting = self._waiting[topic] = _Waiting(reading, slot, slot)
            self.due_s = min(self.due_s, self._time_s(slot))
        waiting.reading = reading
        if slot > waiting.newest:
            waiting.newest = slot
            waiting.passed += 1
        if reading.urgent:
            waiting.urgent = True
            self.due_s = min(self.due_s, now_s)

    def take(self, now_s: float) -> list[tuple[Topic, Reading]]:
        """Give out what is due now."""
        if now_s < self.due_s:
            return []
        due = {topic: one for topic, one in self._waiting.items() if one.urgent or self._time_s(one.due) <= now_s}
        for topic, one in due.items():
            del self._waiting[topic]
            if self._time_s(one.due) <= now_s:
                self._taken = max(self._taken, one.due)
            served = one.passed + (self._time_s(one.newest) <= now_s)
            if served > 1:
                self._missed[topic.name] += served - 1
        self.due_s = min((self._time_s(one.due) for one in self._waiting.values()), default=math.inf)
        return [(topic, one.reading) for topic, one in due.items()]

    def pace(self, flush_s: float) -> None:
        """A rate has its own slots."""

    def _time_s(self, slot: int) -> float:
        return self._start_s + slot * self._period_s
