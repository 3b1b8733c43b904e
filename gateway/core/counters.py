"""What a link counts: totals since the start, and the frames of the last second."""

from __future__ import annotations

import statistics
from collections import Counter
from collections.abc import Sequence

from gateway.api.decoder import Event, Frame, Reject, Skipped
from gateway.api.model import LinkStats

# A reached rate is said anew when it differs by more than this share: it is for people, and each change is published.
_RATE_STEP = 0.02


class LinkCounters:
    """The counters of one link."""

    def __init__(self) -> None:
        self.frames = self.skipped = self.sessions = self.n_bytes = 0
        self.rejects: Counter[str] = Counter()
        self.last_frame_s: float | None = None
        self.reached_hz: float | None = None
        self._times_s: list[float] = []
        self._decode_s = 0.0
        self._reads = 0

    def take(self, n_bytes: int, events: Sequence[Event], at_s: float, decode_s: float) -> None:
        """Count what one read has brought."""
        self.n_bytes += n_bytes
        self._reads += 1
        self._decode_s += decode_s
        for event in events:
            if type(event) is Frame:
                self.frames += 1
                self._times_s.append(at_s)
                self.last_frame_s = at_s
            elif type(event) is Reject:
                self.rejects[event.reason] += 1
            elif type(event) is Skipped:
                self.skipped += 1

    def second(self, now_s: float, bad_values: int) -> LinkStats:
        """Close the last second and return the counters.

        Args:
            now_s: Monotonic time.
            bad_values: Groups that held NaN or infinity.
        """
        intervals = sorted(after - before for before, after in zip(self._times_s, self._times_s[1:], strict=False))
        self._update_rate(intervals)
        stats = LinkStats(
            frames=self.frames,
            skipped=self.skipped,
            rejects=dict(self.rejects),
            bad_values=bad_values,
            gaps=None,
            sessions=self.sessions,
            n_bytes=self.n_bytes,
            age=None if self.last_frame_s is None else round(now_s - self.last_frame_s, 6),
            interval_p50=round(statistics.median(intervals), 6) if intervals else None,
            interval_p99=round(intervals[int(len(intervals) * 0.99)], 6) if intervals else None,
            decode_time=round(self._decode_s / self._reads, 9) if self._reads else None,
        )
        self._times_s = self._times_s[-1:]
        self._decode_s = 0.0
        self._reads = 0
        return stats

    def _update_rate(self, intervals: Sequence[float]) -> None:
        """Rate of the frames of the last second; said anew only when it has really changed."""
        rate_hz = round(len(intervals) / sum(intervals), 1) if intervals else 0.0
        known = self.reached_hz
        if known is None or rate_hz == 0 or abs(rate_hz - known) > _RATE_STEP * known:
            self.reached_hz = rate_hz
