"""What one subscription is owed while its client does not read: bounded, whatever comes."""

from __future__ import annotations

from collections import Counter, deque

from gateway.core.bus import Reading, Topic
from gateway.server.cohort import QUEUED_SAMPLES, Batch, Due


class Backlog:
    """Readings that could not be sent: the newest of each topic, or every one up to a bound.

    Args:
        every: Whether every reading is kept, or the newest only.
        missed: Where samples are counted that gave way, by topic.
    """

    def __init__(self, missed: Counter[str], *, every: bool) -> None:
        self._every = every
        self._missed = missed
        # States stand apart: however many samples come, the newest value of a state gives way to a newer one only.
        self._states: deque[Due] = deque()
        self._samples: deque[Due] = deque()
        self._newest: dict[Topic, Reading] = {}

    def __len__(self) -> int:
        return len(self._states) + len(self._samples) + len(self._newest)

    def put(self, batch: Batch) -> None:
        """Take readings that are due, in order per topic."""
        for topic, reading in batch.readings:
            if self._every:
                self._append(topic, reading)
            else:
                if topic in self._newest and topic.group.delivery == "sample":
                    self._missed[topic.name] += 1
                self._newest[topic] = reading

    def take(self, count: int) -> list[Due]:
        """Give out the first so many, in order per topic."""
        taken: list[Due] = []
        for waiting in (self._states, self._samples):
            taken += [waiting.popleft() for _ in range(min(count - len(taken), len(waiting)))]
        for topic in list(self._newest)[: count - len(taken)]:
            taken.append((topic, self._newest.pop(topic)))
        return taken

    def _append(self, topic: Topic, reading: Reading) -> None:
        waiting = self._states if topic.group.delivery == "state" else self._samples
        waiting.append((topic, reading))
        if len(waiting) > QUEUED_SAMPLES:
            lost, _ = waiting.popleft()
            self._missed[lost.name] += 1
