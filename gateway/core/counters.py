"""What a link counts: totals since the start, and the frames of the last second."""

from __future__ import annotations

import statistics
from collections import Counter, deque
from collections.abc import Mapping, Sequence

from gateway.api.decoder import Event, Frame, Occurrence, Reject, Skipped
from gateway.api.model import LinkStats

# A reached rate is said anew when it differs by more than this share: it is for people, and each change is published.
_RATE_STEP = 0.02
_PART_STEP = 0.2
# The rate of a part follows from so many of its last arrivals: some come once in a few seconds.
_PART_ARRIVALS = 8


class LinkCounters:
    """The counters of one link.

    Args:
        parts: Whether the rate of each value is of interest: they are asked for in turn.
    """

    def __init__(self, *, parts: bool = False) -> None:
        self._parts = parts
        self._gaps: int | None = None  # of the sessions that are over
        self._parts_s: dict[str, deque[float]] = {}
        self.parts_hz: dict[str, float] = {}
        self.frames = self.skipped = self.sessions = self.n_bytes = 0
        self.rejects: Counter[str] = Counter()
        self.last_frame_s: float | None = None
        self.reached_hz: float | None = None
        self._times_s: list[float] = []
        self._decode_s = 0.0
        self._reads = 0

    def begin(self) -> None:
        """A session has begun: its first frame has no predecessor."""
        self.sessions += 1
        self._times_s.clear()
        self._parts_s.clear()

    def end(self, gaps: int | None) -> None:
        """A session is over, in which so many frames were missing."""
        self._gaps = _sum(self._gaps, gaps)

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
                for name in event.values if self._parts else ():
                    self._parts_s.setdefault(name, deque(maxlen=_PART_ARRIVALS)).append(at_s)
            elif type(event) is Reject:
                self.rejects[event.reason] += 1
            elif type(event) is Skipped or type(event) is Occurrence:
                self.skipped += 1

    def second(
        self,
        now_s: float,
        bad_values: int,
        clock_offset_s: float | None = None,
        *,
        gaps: int | None = None,
        refused: Mapping[str, int] = {},
    ) -> LinkStats:
        """Close the last second and return the counters.

        Args:
            now_s: Monotonic time.
            bad_values: Groups that held NaN or infinity.
            clock_offset_s: The controller's clock minus ours, or None.
            gaps: Frames that are missing in the session that runs, or None.
            refused: What the transport has refused, by reason.
        """
        intervals = sorted(after - before for before, after in zip(self._times_s, self._times_s[1:], strict=False))
        self._update_rate(intervals)
        self._update_parts()
        stats = LinkStats(
            frames=self.frames,
            skipped=self.skipped,
            rejects={**self.rejects, **refused},
            bad_values=bad_values,
            gaps=_sum(self._gaps, gaps),
            sessions=self.sessions,
            n_bytes=self.n_bytes,
            age=None if self.last_frame_s is None else round(now_s - self.last_frame_s, 6),
            interval_p50=round(statistics.median(intervals), 6) if intervals else None,
            interval_p99=round(intervals[int(len(intervals) * 0.99)], 6) if intervals else None,
            decode_time=round(self._decode_s / self._reads, 9) if self._reads else None,
            clock_offset=None if clock_offset_s is None else round(clock_offset_s, 6),
        )
        self._times_s = self._times_s[-1:]
        self._decode_s = 0.0
        self._reads = 0
        return stats

    def _update_parts(self) -> None:
        """Rates of the parts, said anew only where one has really changed."""
        told = {name: rate for name, times_s in self._parts_s.items() if (rate := _rate(times_s)) is not None}
        known = self.parts_hz
        if told.keys() != known.keys() or any(
            abs(rate - known[name]) > _PART_STEP * rate for name, rate in told.items()
        ):
            self.parts_hz = told

    def _update_rate(self, intervals: Sequence[float]) -> None:
        """Rate by the last intervals; said anew only when it has really changed, and kept where there was none."""
        span_s = sum(intervals)  # 0 where all came in one read
        if not span_s:
            return
        rate_hz = round(len(intervals) / span_s, 1)
        known = self.reached_hz
        if known is None or abs(rate_hz - known) > _RATE_STEP * known:
            self.reached_hz = rate_hz


def _rate(times_s: Sequence[float]) -> float | None:
    span_s = times_s[-1] - times_s[0] if times_s else 0.0
    return round((len(times_s) - 1) / span_s, 2) if span_s else None


def _sum(before: int | None, now: int | None) -> int | None:
    return before if now is None else now if before is None else before + now
