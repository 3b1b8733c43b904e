"""Who was turned away at the doors: counted by reason, and logged without letting anybody fill the log."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass

import structlog
from aiohttp import web

from gateway.core.repeats import QUIET_S

_LOG = structlog.get_logger()
# So many pairs of reason and peer have a line of their own in a minute; further ones are only counted.
MOST_KINDS = 256


@dataclass(slots=True)
class _Kind:
    said_s: float
    left_out: int = 0


class Refusals:
    """Counts refusals, and says each kind of them once a minute, with how often it was left out.

    Args:
        now: The monotonic clock, in s.

    Attributes:
        counts: How many there were since the start, by reason.
    """

    def __init__(self, now: Callable[[], float] = time.monotonic) -> None:
        self._now = now
        self._kinds: dict[tuple[str, str], _Kind] = {}
        self.counts: Counter[str] = Counter()

    def __len__(self) -> int:
        return len(self._kinds)

    def add(self, reason: str, peer: str | None, what: str) -> None:
        """Take note of one.

        Args:
            reason: Stable, one of few.
            peer: Its address.
            what: For the log; nothing secret, and bounded.
        """
        self.counts[reason] += 1
        now_s = self._now()
        key = (reason, peer or "")
        kind = self._kinds.get(key)
        if kind is None:
            if len(self._kinds) >= MOST_KINDS and not self._forget(now_s):
                return
            kind = self._kinds[key] = _Kind(now_s)
        elif now_s - kind.said_s < QUIET_S:
            kind.left_out += 1
            return
        left_out, kind.left_out, kind.said_s = kind.left_out, 0, now_s
        _LOG.warning("request.refused", peer=peer, reason=what, **({"n_dropped": left_out} if left_out else {}))

    def _forget(self, now_s: float) -> bool:
        """Forget the kinds that have been quiet; whether there is room now."""
        self._kinds = {key: kind for key, kind in self._kinds.items() if now_s - kind.said_s < QUIET_S}
        return len(self._kinds) < MOST_KINDS


REFUSALS = web.AppKey("refusals", Refusals)
