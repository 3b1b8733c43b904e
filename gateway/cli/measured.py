"""What a link receives while somebody watches: `status --why` tells it beside the totals."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import anyio

from gateway.api.messages import Data
from gateway.api.model import LinkStats
from gateway.client import Client, typed

# The counters come once a second: so many of them are waited for, for so long at most.
_MEASURED = 3
_MEASURE_S = 3.5


@dataclass(frozen=True, slots=True)
class Measured:
    """What has come while somebody watched.

    Attributes:
        seconds: How long that was.
        stats: The counters at the end.
        frames: Good frames in that time.
        n_bytes: Bytes in that time.
        rejects: Rejects in that time, by reason.
    """

    seconds: float
    stats: LinkStats
    frames: int
    n_bytes: int
    rejects: Mapping[str, int]

    @classmethod
    async def during(cls, client: Client, name: str) -> Measured | None:
        """Watch the counters of a robot for two or three of their seconds; None: they did not come."""
        told: list[tuple[int, LinkStats]] = []
        await client.subscribe([f"{name}/link_stats"])
        with anyio.move_on_after(_MEASURE_S):
            while len(told) < _MEASURED:
                message = await client.next_pushed()
                samples = message.samples if isinstance(message, Data) else ()
                told += [(one.t, stats) for one in map(typed, samples) if isinstance(stats := one.data, LinkStats)]
        return cls.between(*told[0], *told[-1]) if len(told) > 1 else None

    @classmethod
    def between(cls, t_first: int, first: LinkStats, t_last: int, last: LinkStats) -> Measured:
        """The difference of the counters of two moments, µs."""
        grown = {reason: count - first.rejects.get(reason, 0) for reason, count in last.rejects.items()}
        return cls(
            seconds=max(1, t_last - t_first) / 1e6,
            stats=last,
            frames=last.frames - first.frames,
            n_bytes=last.n_bytes - first.n_bytes,
            rejects={reason: count for reason, count in grown.items() if count > 0},
        )

    @property
    def rejected(self) -> float:
        """Share of all that came that was no good frame."""
        bad = sum(self.rejects.values())
        return bad / (bad + self.frames) if bad else 0.0
