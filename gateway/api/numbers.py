"""Counting the frames that a controller has numbered and that never came."""

from __future__ import annotations


class Numbers:
    """Follows the numbers of one session's frames.

    Args:
        modulus: The number after which they begin again at 0; None: they only grow.
    """

    def __init__(self, modulus: int | None = None) -> None:
        self._modulus = modulus
        self._last: int | None = None
        self._missing = 0
        self._moves = False

    @property
    def gaps(self) -> int | None:
        """How many frames are missing; None while the number was never seen to move: it tells nothing then."""
        return self._missing if self._moves else None

    def take(self, number: int) -> None:
        """Follow the next frame's number; one that was overtaken was counted as missing, and is not any more."""
        before, self._last = self._last, number
        if before is None or number == before:
            return
        self._moves = True
        step = number - before
        late = step < 0
        if self._modulus is not None:
            step %= self._modulus
            late = step > self._modulus // 2
        if late:
            self._missing = max(0, self._missing - 1)
            self._last = before
        else:
            self._missing += step - 1
