"""What a link counts: totals since the start, and the frames of the last second."""

from __future__ import annotations

import statistics
from collections import Counter
from collections.abc import Sequence

from gateway.api.decoder import Event, Frame, Reject, Skipped
from gateway.api.model import LinkStats

# A reached rate is said anew when it differs by more than this share: it is for people, and each change is published.
_RATE_STEP = 0.02
# A frame counter of one byte that goes back by less than half its range: the frame was overtaken.
_LATE = 0x80


class LinkCounters:
    """The counters of one link.

    Args:
        counter_at: Offset in a frame of the byte that numbers the frames, or None.
    """

    def __init__(self, counter_at: int | None = None) -> None:
        self._counter_at = counter_at
        self._number: int | None = None
        self._gaps = 0
        self._moves = False
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
        self._number = None
        self._times_s.clear()

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
                if self._counter_at is not None:
                    self._number_is(event.raw[self._counter_at])
            elif type(event) is Reject:
                self.rejects[event.reason] += 1
            elif type(event) is Skipped:
                self.skipped += 1

    def second(self, now_s: float, bad_values: int, clock_offset_s: float | None = None) -> LinkStats:
        """Close the last second and return the counters.

        Args:
            now_s: Monotonic time.
            bad_values: Groups that held NaN or infinity.
            clock_offset_s: The controller's clock minus ours, or None.
        """
        intervals = sorted(after - before for before, after in zip(self._times_s, self._times_s[1:], strict=False))
        self._update_rate(intervals)
        stats = LinkStats(
            frames=self.frames,
            skipped=self.skipped,
            rejects=dict(self.rejects),
            bad_values=bad_values,
            gaps=self._gaps if self._moves else None,
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

    def _number_is(self, number: int) -> None:
        """Count what is missing before a frame; a counter that was never seen to move tells nothing."""
        before, self._number = self._number, number
        step = 0 if before is None else (number - before) & 0xFF
        if step == 0:
            return
        self._moves = True
        if step > _LATE:  # an older frame, counted as missing when the newer one came
            self._gaps = max(0, self._gaps - 1)
            self._number = before
        else:
            self._gaps += step - 1

    def _update_rate(self, intervals: Sequence[float]) -> None:
        """Rate by the last intervals; said anew only when it has really changed, and kept where there was none."""
        span_s = sum(intervals)  # 0 where all came in one read
        if not span_s:
            return
        rate_hz = round(len(intervals) / span_s, 1)
        known = self.reached_hz
        if known is None or abs(rate_hz - known) > _RATE_STEP * known:
            self.reached_hz = rate_hz
