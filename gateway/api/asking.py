"""Who is asked next, where many questions share a budget of so many a second."""

from __future__ import annotations

from collections import Counter
from collections.abc import Container, Mapping

_DUE = 1.0 - 1e-9  # sums of shares are not exact
_SOON = 0.5  # how much of its turn must have passed for a question that stands in for another one


def turns_hz(wishes: Mapping[str, float], kinds: Mapping[str, str] = {}) -> float:
    """How many turns a second all wishes need: each one its own, and between two of a kind one that is not of it."""
    names = Counter(kinds.get(name) for name, wish in wishes.items() if wish > 0)
    of_kind = [
        sum(wish for name, wish in wishes.items() if wish > 0 and kinds.get(name) == kind)
        for kind, count in names.items()
        if kind is not None and count > 1
    ]
    return max(sum(wishes.values()), 2 * max(of_kind, default=0.0))


class Rota:
    """Questions with the rates that are wished for; the most overdue comes first.

    It has no clock: time is counted in turns, of which there are `budget_hz` a second. Where the wishes are more than
    the budget, all get their share of it.

    Two questions whose answers look alike never follow each other: an answer too many is then none to the question
    after it. Where nothing of another kind is due, a turn stays empty between them.

    Args:
        wishes: Rate of each question, in Hz; one of 0 is never asked.
        budget_hz: Questions a second.
        kinds: What the answer to each question looks like; a question that has none may follow any.
    """

    def __init__(self, wishes: Mapping[str, float], budget_hz: float, kinds: Mapping[str, str] = {}) -> None:
        self._wishes = {name: wish for name, wish in wishes.items() if wish > 0}
        self._budget_hz = budget_hz
        self._kinds = dict(kinds)
        self._last: str | None = None
        self._steps = self._shares()
        # What comes first is what is wished most often; after that everybody's turn grows from where it stood.
        self._turns = {name: 1.0 + step for name, step in self._steps.items()}

    @property
    def names(self) -> tuple[str, ...]:
        """The questions that are asked."""
        return tuple(self._steps)

    def next(self, among: Container[str] | None = None) -> str | None:
        """The question that is most overdue, one turn later; None where none is due.

        Args:
            among: Only these may be asked now, due or not; None: all.
        """
        for name, step in self._steps.items():
            self._turns[name] += step
        self._last = self._due() if among is None else self._first(among)
        if self._last is not None:
            self._turns[self._last] -= 1.0
        return self._last

    def drop(self, name: str) -> None:
        """Ask a question no more; the others share what it leaves."""
        self._wishes.pop(name, None)
        self._turns.pop(name, None)
        self._steps = self._shares()

    def _first(self, among: Container[str]) -> str | None:
        return max((name for name in self._turns if name in among), key=self._turns.__getitem__, default=None)

    def _due(self) -> str | None:
        first = self._first(self._turns)
        if first is None or self._turns[first] < _DUE:
            return None
        if self._may_follow(first):
            return first
        other = self._first([name for name in self._turns if self._may_follow(name)])
        return other if other is not None and self._turns[other] >= _SOON else None

    def _may_follow(self, name: str) -> bool:
        if self._last is None or name == self._last:
            return True
        kind = self._kinds.get(name)
        return kind is None or kind != self._kinds.get(self._last)

    def _shares(self) -> dict[str, float]:
        """How much of a turn comes due for each question with every turn."""
        shared_hz = max(self._budget_hz, turns_hz(self._wishes, self._kinds))
        return {name: wish / shared_hz for name, wish in self._wishes.items()}
