"""Who is asked next, where many questions share a budget of so many a second."""

from __future__ import annotations

from collections.abc import Mapping

_DUE = 1.0 - 1e-9  # sums of shares are not exact


class Rota:
    """Questions with the rates that are wished for; the most overdue comes first.

    It has no clock: time is counted in turns, of which there are `budget_hz` a second. Where the wishes are more than
    the budget, all get their share of it.

    Args:
        wishes: Rate of each question, in Hz; one of 0 is never asked.
        budget_hz: Questions a second.
    """

    def __init__(self, wishes: Mapping[str, float], budget_hz: float) -> None:
        self._wishes = {name: wish for name, wish in wishes.items() if wish > 0}
        self._budget_hz = budget_hz
        self._steps = self._shares()
        # What comes first is what is wished most often; after that everybody's turn grows from where it stood.
        self._turns = {name: 1.0 + step for name, step in self._steps.items()}

    @property
    def names(self) -> tuple[str, ...]:
        """The questions that are asked."""
        return tuple(self._steps)

    def next(self) -> str | None:
        """The question that is most overdue, one turn later; None where none is due."""
        for name, step in self._steps.items():
            self._turns[name] += step
        if not self._turns:
            return None
        name = max(self._turns, key=self._turns.__getitem__)
        if self._turns[name] < _DUE:
            return None
        self._turns[name] -= 1.0
        return name

    def drop(self, name: str) -> None:
        """Ask a question no more; the others share what it leaves."""
        self._wishes.pop(name, None)
        self._turns.pop(name, None)
        self._steps = self._shares()

    def _shares(self) -> dict[str, float]:
        """How much of a turn comes due for each question with every turn."""
        shared_hz = max(self._budget_hz, sum(self._wishes.values()))
        return {name: wish / shared_hz for name, wish in self._wishes.items()}
