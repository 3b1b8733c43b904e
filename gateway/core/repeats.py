"""What is worth a log line: a fault that repeats is said once a minute, with how often it was left out."""

from __future__ import annotations

import math

QUIET_S = 60.0


class Repeats:
    """Decides for one link whether a loss is logged; its recovery is logged exactly when the loss was."""

    def __init__(self) -> None:
        self._said: object = None
        self._said_s = -math.inf
        self._left_out = 0
        self._open = False

    def loss(self, what: object, now_s: float) -> int | None:
        """Take a loss.

        Args:
            what: What makes it the same as before.
            now_s: Monotonic time.

        Returns:
            How many like it were left out since the last line; None where this one is left out too.
        """
        if what == self._said and now_s - self._said_s < QUIET_S:
            self._left_out += 1
            return None
        left_out, self._left_out = self._left_out, 0
        self._said, self._said_s, self._open = what, now_s, True
        return left_out

    def recovery(self) -> bool:
        """Take a recovery; whether it is logged: after a loss that was, and the first time."""
        first = self._said is None
        was_open, self._open = self._open, False
        return was_open or first
