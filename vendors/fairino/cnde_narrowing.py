"""Which states does a controller grant? It refuses a configuration as a whole, and its words do not say reliably why.

Refused sets are halved, and what was granted stays in every further try, so that each answer tells of the rest.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence

from vendors.fairino.cnde_states import ALL_STATES

# The two states that every known client gets: they are tried at last where halving has found nothing.
FIRST_STATES = ("actual_joint_pos", "actual_TCP_pos")
_MANY_MORE = 6  # times as many unknown names as suspect ones are tried at once
# The highest id of each firmware from 3.6 on: an older controller refuses all that came later.
_LAST_IDS = (46, 47, 53, 58, 63, 64, 66, 68, 74, 76, 131, 132, 133)


class Narrowing:
    """The search for the largest set that is granted.

    What is not granted yet is either suspect, in sets that must hold a refused name, or merely unknown. Mostly there is
    one refused name, so the largest suspect set is halved first; the unknown names are tried together as soon as they
    are many more than the suspects.

    Args:
        states: What is wanted, in the order of the configuration.

    Attributes:
        granted: Names that the controller accepts together.
        refused: Names that it refuses, each found alone.
        untried: Names of refused sets that were not taken apart before the tries were used up.
        done: Whether the search is over: the last accepted configuration is the one to use.
    """

    # How many configurations the search may take, the last one included.
    MOST_TRIES = 12

    def __init__(self, states: Sequence[str]) -> None:
        self._wanted = tuple(states)
        self._trial: tuple[str, ...] = self._wanted
        self._sibling: tuple[str, ...] = ()  # the other half of a suspect set of which the trial is one half
        self._suspect: list[tuple[str, ...]] = []
        self._unknown: frozenset[str] = frozenset()
        self._tries = 0
        self.granted: frozenset[str] = frozenset()
        self.refused: list[str] = []
        self.untried: tuple[str, ...] = ()
        self.done = False

    @property
    def proposal(self) -> tuple[str, ...]:
        """The configuration to try next, or the one to use when the search is done."""
        return tuple(name for name in self._wanted if name in self.granted or name in self._trial)

    @property
    def failed(self) -> bool:
        """Whether nothing at all is granted."""
        return not self.done and not self.proposal

    def accept(self) -> None:
        """The proposal was accepted: then it is the other half that holds a refused name."""
        self.granted |= frozenset(self._trial)
        if self._sibling:
            self._suspect.append(self._sibling)
        self._next(settled=True)

    def refuse(self) -> None:
        """The proposal was refused: of the other half nothing is known."""
        if self._trial:
            self._suspect.append(self._trial)
            self._unknown |= frozenset(self._sibling)
        else:  # even what was granted before
            self.granted = frozenset()
        self._next(settled=False)

    def drop(self, names: Collection[str]) -> None:
        """The proposal was accepted, but some of its names cannot be used."""
        self.refused += [name for name in self.proposal if name in names]
        self._unknown |= frozenset(self._trial) | frozenset(self._sibling)
        self._unknown -= frozenset(names)
        self.granted -= frozenset(names)
        self._next(settled=False)

    def _next(self, *, settled: bool) -> None:
        """Choose the next trial.

        Args:
            settled: Whether the controller's configuration is what is granted.
        """
        self._tries += 1
        self._trial = self._sibling = ()
        self.refused += [name for part in self._suspect if len(part) == 1 for name in part]
        self._suspect = sorted((part for part in self._suspect if len(part) > 1), key=len)
        left = self.MOST_TRIES - self._tries
        if left > 1:
            self._choose(nearly_over=left == 2)  # noqa: PLR2004 - one try, and one for what it grants
        if not self._trial:
            rest = self._unknown.union(*self._suspect)
            self.untried = tuple(name for name in self._wanted if name in rest)
            self.done = settled and bool(self.granted)

    def _choose(self, *, nearly_over: bool) -> None:
        largest = len(self._suspect[-1]) if self._suspect else 0
        if nearly_over and not self.granted:
            self._trial = self._first_states()
        if not self._trial and self._unknown and len(self._unknown) >= _MANY_MORE * largest:
            self._trial = tuple(name for name in self._wanted if name in self._unknown)
            self._unknown = frozenset()
        elif not self._trial and self._suspect:
            self._trial, self._sibling = _halves(self._suspect.pop())

    def _first_states(self) -> tuple[str, ...]:
        """Take out what is granted most likely; of the sets that it stood in nothing is known any more."""
        first = frozenset(FIRST_STATES)
        touched = [part for part in self._suspect if first.intersection(part)]
        found = first & self._unknown.union(*touched)
        self._suspect = [part for part in self._suspect if part not in touched]
        self._unknown = self._unknown.union(*touched) - found
        return tuple(name for name in self._wanted if name in found)


def _halves(states: tuple[str, ...]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Split a set: where firmware once grew, if that is in its middle third, else in the middle."""
    middle = len(states) // 2
    grown = [
        at
        for at in range(1, len(states))
        if len(states) <= 3 * at <= 2 * len(states)
        and any(_age(states[at - 1]) <= last < _age(states[at]) for last in _LAST_IDS)
    ]
    at = min(grown, key=lambda at: abs(at - middle), default=middle)
    return states[:at], states[at:]


def _age(name: str) -> int:
    """The id of a state; those without one are known last."""
    state = ALL_STATES.get(name)
    return 1000 if state is None or state.id is None else state.id
