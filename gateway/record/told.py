"""What was told lately that follows from no bytes: states of links, their numbers, and events."""

from __future__ import annotations

from collections import deque

from gateway.record.spool import Said

# Topics that do not follow from bytes: they are kept as they are told.
TOLD_GROUPS = ("link", "link_stats", "events", "commands")
# A storm of events fills no more memory than this.
MOST_BYTES = 8_000_000
_EVENTS = ("/events", "/commands")
_OVERHEAD = 300  # bytes that one takes besides its text


class ToldLog:
    """Keeps what was told for some time, and of each state what stood before that.

    Args:
        keep_s: How long, in s.
        most_bytes: How much memory it may take.
    """

    def __init__(self, keep_s: float, most_bytes: int = MOST_BYTES) -> None:
        self.keep_s = keep_s
        self._most_bytes = most_bytes
        self._said: deque[tuple[float, Said]] = deque()  # with their monotonic times, s
        self._standing: dict[str, Said] = {}  # by topic: what was told last before the oldest of these
        self.n_bytes = 0

    def add(self, now_s: float, said: Said) -> None:
        """Keep what is told now, at a monotonic time, s."""
        self._said.append((now_s, said))
        self.n_bytes += len(said.data) + _OVERHEAD
        while now_s - self._said[0][0] > self.keep_s or (self.n_bytes > self._most_bytes and len(self._said) > 1):
            _, old = self._said.popleft()
            self.n_bytes -= len(old.data) + _OVERHEAD
            if not old.topic.endswith(_EVENTS):
                self._standing[old.topic] = old

    def forget(self, topic: str) -> None:
        """A topic is no longer there: what it said stays for its time, what stood does not."""
        self._standing.pop(topic, None)

    def since(self, since_s: float) -> list[Said]:
        """What was told since a monotonic time, s, behind the states that stood then."""
        standing = dict(self._standing)
        found = []
        for at_s, said in self._said:
            if at_s >= since_s:
                found.append(said)
            elif not said.topic.endswith(_EVENTS):
                standing[said.topic] = said
        return [*standing.values(), *found]
