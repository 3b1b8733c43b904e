"""What a check looks at, and how it fails."""

from __future__ import annotations

import random
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import msgspec

from gateway.api.decoder import Frame
from gateway.api.framing import Framing, Kind
from gateway.api.layout import Layout
from gateway.api.normaliser import Normaliser
from gateway.api.record import Record
from gateway.api.vendor import ROBOT_OPTIONS, Protocol, Vendor
from gateway.testing.vectors import Vector, load


class CheckFailed(Exception):  # noqa: N818 - what has happened, like the error tree's names
    """A plugin fails a check; the message says what is wrong and what to do."""


# Why a check of one kind of protocol has nothing to look at in the other.
NOT_BINARY = "its messages are text: the checks of lines look at them"
PUSHED = "the controller pushes its frames and answers no requests"
NOT_TEXT = "its frames are binary: the checks of bytes and tables look at them"


class DoesNotApply(Exception):  # noqa: N818 - the same
    """A check has nothing to look at in a protocol of this kind; the message says why."""


@dataclass(frozen=True)
class Subject:
    """One protocol of one vendor, as the checks see it.

    Args:
        vendor: The plugin.
        protocol: The protocol under check.
        folder: The plugin's folder.
        simulator: Loads the virtual controller; None where there is no way to.
        seed: Of everything random: the same seed gives the same bytes.
    """

    vendor: Vendor
    protocol: Protocol
    folder: Path
    simulator: Callable[[], object] | None = None
    seed: int = 20260101
    _normalisers: dict[bytes, Normaliser] = field(default_factory=dict, repr=False, compare=False)

    @property
    def framing(self) -> Framing:
        """The framing of a binary protocol.

        Raises:
            DoesNotApply: It is a text protocol.
        """
        if self.protocol.framing is None:
            raise DoesNotApply(NOT_BINARY)
        return self.protocol.framing

    @property
    def records(self) -> tuple[Record, ...]:
        """The tables of a text protocol.

        Raises:
            DoesNotApply: It is a binary protocol.
        """
        if not self.protocol.records:
            raise DoesNotApply(NOT_TEXT)
        return self.protocol.records

    @property
    def polls(self) -> bool:
        """Whether the protocol asks for what it reads."""
        protocol = self.protocol
        return protocol.request is not None or (protocol.framing is None and protocol.rate_hz is not None)

    @cached_property
    def vectors(self) -> tuple[Vector, ...]:
        """The vectors of this protocol.

        Raises:
            CheckFailed: The file is missing, is not what `vectors.toml` should be, or has none of this protocol.
        """
        try:
            found = load(self.folder / "vectors.toml")
        except ValueError as error:
            raise CheckFailed(str(error)) from error
        own = tuple(vector for vector in found if vector.protocol == self.protocol.name)
        if not any(vector.layout for vector in own):
            raise CheckFailed(
                f"vectors.toml has no vector of protocol {self.protocol.name} that carries state: "
                "add frames and their values"
            )
        return own

    @property
    def states(self) -> tuple[Vector, ...]:
        """The vectors that carry state."""
        return tuple(vector for vector in self.vectors if vector.layout is not None)

    @property
    def skipped(self) -> tuple[Vector, ...]:
        """The vectors of known frames that carry no state."""
        return tuple(vector for vector in self.vectors if vector.skipped is not None)

    @property
    def told(self) -> tuple[Vector, ...]:
        """The vectors that say what has happened."""
        return tuple(vector for vector in self.vectors if vector.occurrences)

    @cached_property
    def sessions(self) -> tuple[tuple[Vector, ...], ...]:
        """Different state vectors that one session may carry, by their length where a session has only one."""
        found: dict[int, dict[bytes, Vector]] = {}
        for vector in self.states:
            length = len(vector.raw) if self.framing.one_length else 0
            found.setdefault(length, {}).setdefault(vector.raw, vector)
        return tuple(tuple(by_raw.values()) for by_raw in found.values())

    @property
    def state_kinds(self) -> tuple[Kind, ...]:
        """The kinds of frames that carry state."""
        return tuple(kind for kind in self.framing.kinds if kind.carries_state)

    def random(self) -> random.Random:
        """A source of randomness that gives the same numbers in every run."""
        return random.Random(self.seed)  # noqa: S311 - test data, no secrets

    def options(self, given: Mapping[str, object] = {}) -> msgspec.Struct:
        """The protocol's options: its defaults, but for those that are given."""
        own = {name: value for name, value in given.items() if name not in ROBOT_OPTIONS}
        try:
            return msgspec.convert(own, self.protocol.options)
        except msgspec.ValidationError as error:
            raise CheckFailed(f"options {own!r} do not fit {self.protocol.options.__name__}: {error}") from error

    def normaliser(self, given: Mapping[str, object] = {}) -> Normaliser:
        """The protocol's normaliser for a robot with some options."""
        named = msgspec.json.encode(given, order="sorted")
        if named not in self._normalisers:
            robot = {name: given.get(name) for name in ROBOT_OPTIONS}
            options = {**robot, **msgspec.structs.asdict(self.options(given))}
            self._normalisers[named] = Normaliser(self.protocol.signals, options)
        return self._normalisers[named]


def layout_of(frame: Frame) -> Layout:
    """The table of a binary frame.

    Raises:
        CheckFailed: It is a message of a text protocol.
    """
    if not isinstance(frame.layout, Layout):
        raise CheckFailed(f"{frame} is explained by a record: a binary protocol names a Layout")
    return frame.layout


def record_of(frame: Frame) -> Record:
    """The table of a message of a text protocol.

    Raises:
        CheckFailed: It is a binary frame.
    """
    if not isinstance(frame.layout, Record):
        raise CheckFailed(f"{frame} is explained by a layout: a text protocol names a Record")
    return frame.layout
