"""Which states does a controller grant? It refuses a configuration as a whole, and its words do not say reliably why.

Refused sets are halved, and what was granted stays in every further try, so that each answer tells of the rest.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence

from vendors.fairino.cnde_states import ALL_STATES

# The two states that every known client gets: they are tried at last where halving has found nothing.
FIRST_STATES = ("actual_joint_pos", "actual_TCP_pos")
_SDK_DEFAULT = 75  # ids up to here are the SDK's own default set
_ON_THE_PAGE = 131  # ids up to here stand on the vendor's page; later ones, and states without an id, are often unknown


class Narrowing:
    """The search for the largest set that is granted.

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
        self._todo: list[tuple[str, ...]] = []
        self._tries = 0
        self._known_bad: tuple[str, ...] = ()  # a set that must hold a refused name, since its other half is granted
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
        """The proposal was accepted."""
        self._tries += 1
        self.granted |= frozenset(self._trial)
        self._trial = ()
        self._next(settled=True)

    def refuse(self) -> None:
        """The proposal was refused."""
        self._tries += 1
        trial, self._trial = self._trial, ()
        if not trial:  # even what was granted before
            self.granted = frozenset()
        elif len(trial) == 1:
            self._isolate(trial)
        else:
            self._split(trial)
        self._next(settled=False)

    def drop(self, names: Collection[str]) -> None:
        """The proposal was accepted, but some of its names cannot be used."""
        self._tries += 1
        self.refused += [name for name in self.proposal if name in names]
        self._wanted = tuple(name for name in self._wanted if name not in names)
        self.granted -= frozenset(names)
        rest = tuple(name for name in self._trial if name not in names)
        self._trial = self._known_bad = ()
        self._todo = [*([rest] if rest else []), *self._todo]
        self._next(settled=False)

    def _next(self, *, settled: bool) -> None:
        """Choose the next trial.

        Args:
            settled: Whether the controller's configuration is what is granted.
        """
        if self._known_bad and settled:
            bad, self._known_bad = self._known_bad, ()
            self._todo.remove(bad)
            if len(bad) == 1:
                self._isolate(bad)
            else:
                self._split(bad)
        left = self.MOST_TRIES - self._tries
        if left == 2 and not self.granted:  # noqa: PLR2004 - one try, and one for what it grants
            self._keep_first_states()
        if left > 1 and self._todo:
            self._trial = self._todo.pop(0)
            return
        self.untried = tuple(name for part in self._todo for name in part)
        self.done = settled and bool(self.granted)

    def _split(self, states: tuple[str, ...]) -> None:
        low, high = _halves(states)
        self._todo = [low, high, *self._todo]
        self._known_bad = high

    def _keep_first_states(self) -> None:
        """Bring to the front what is granted most likely."""
        first = tuple(name for name in FIRST_STATES if any(name in part for part in self._todo))
        if first:
            self._todo = [first, *(tuple(name for name in part if name not in first) for part in self._todo)]

    def _isolate(self, state: tuple[str, ...]) -> None:
        """One refused name is found: all the rest may be good, so it is tried together."""
        self.refused += state
        self._known_bad = ()
        rest = frozenset(name for part in self._todo for name in part)
        self._todo = [tuple(name for name in self._wanted if name in rest)] if rest else []


def _halves(states: tuple[str, ...]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Split a set: first by how likely its states are known, then in the middle."""
    likeliest = max(_rank(name) for name in states)
    low = tuple(name for name in states if _rank(name) < likeliest)
    if low:
        return low, tuple(name for name in states if _rank(name) == likeliest)
    middle = len(states) // 2
    return states[:middle], states[middle:]


def _rank(name: str) -> int:
    """How unlikely it is that a controller knows a state, from 0."""
    state = ALL_STATES.get(name)
    if state is None or state.id is None or state.id > _ON_THE_PAGE:
        return 2
    return 0 if state.id <= _SDK_DEFAULT else 1
