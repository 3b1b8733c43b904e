"""What is worth a log line: each kind of loss is said once a minute, with how often it was left out."""

from __future__ import annotations

import math
from dataclasses import dataclass

QUIET_S = 60.0


@dataclass(slots=True)
class _Kind:
    said_s: float = -math.inf
    left_out: int = 0


class Repeats:
    """Decides for one link whether a loss is logged; its recovery is logged exactly when the loss was."""

    def __init__(self) -> None:
        self._kinds: dict[object, _Kind] = {}
        self._open = True

    def loss(self, what: object, now_s: float) -> int | None:
        """Take a loss.

        Args:
            what: What makes it the same as before.
            now_s: Monotonic time.

        Returns:
            How many like it were left out since the last line; None where this one is left out too.
        """
        kind = self._kinds.setdefault(what, _Kind())
        if now_s - kind.said_s < QUIET_S:
            kind.left_out += 1
            return None
        left_out, kind.left_out, kind.said_s = kind.left_out, 0, now_s
        self._open = True
        return left_out

    def recovery(self) -> bool:
        """Take a recovery; whether it is logged: the first one, and each after a loss that was."""
        was_open, self._open = self._open, False
        return was_open
