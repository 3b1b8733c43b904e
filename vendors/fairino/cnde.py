"""CNDE, TCP 20005 and UDP 20006: stop, configuration, types, start, and then data frames at the period asked for.

What this reads and sends is `cnde_wire`, what it asks for `cnde_states`, and what it does when that is refused
`cnde_narrowing`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from enum import Enum
from typing import Annotated, Literal, cast

import msgspec
from msgspec import Meta

from gateway.api.decoder import Event, Frame, Refused, Reject, Skipped
from gateway.api.framing import COUNTER_MODULUS, FramedDecoder
from gateway.api.numbers import Numbers
from gateway.api.vendor import DecoderFactory
from vendors.fairino.cnde_narrowing import Narrowing
from vendors.fairino.cnde_states import (
    ALL_STATES,
    HEADER,
    MOST_DATA,
    TAIL,
    Granted,
    fitting,
    granted,
    name_fault,
    parse_type,
)
from vendors.fairino.cnde_wire import (
    AROUND,
    COUNTER_AT,
    DATA,
    DELIMITED,
    ERROR,
    MAGIC,
    MESSAGE,
    START,
    STOP,
    SUCCESS,
    WARNING,
    configuration,
    frame,
    message,
)
from vendors.fairino.signals import SIGNALS
from vendors.fairino.wall_clock import WALL_CLOCK

TICK_S = 0.1
_QUIET_TICKS = 2  # after stop, nothing may come for so long before the configuration is sent
_STOP_TICKS = 5  # ticks until stop is repeated; over UDP, where the first may be lost, once more after the first tick
PATIENCE_TICKS = {"udp": 5, "tcp": 50}  # the same of other steps: a datagram may be lost, a byte of TCP is only late
WRONG_IN_A_ROW = 5
_STARTS = 3  # how often a refused start is tried again with a new configuration
_MANY = 12  # names that are listed before the rest is counted


# Over UDP: the clock, then what canonical keys follow from; what is left over has no room in one datagram.
UDP_STATES = fitting(
    WALL_CLOCK.fields,
    [source.partition(".")[0] for signal in SIGNALS for source in signal.sources],
)


class CndeOptions(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Options of the `cnde` protocol."""

    transport: Annotated[
        Literal["tcp", "udp"],
        Meta(description="tcp: port 20005, firmware 3.9.5 and later; udp: port 20006, about 3.8.2 and later."),
    ] = "tcp"
    period_ms: Annotated[int, Meta(ge=8, le=200, description="Time between two data frames, in ms.")] = 8
    states: Annotated[
        tuple[str, ...],
        Meta(
            description="The states to ask for, by the vendor's CNDE names. Empty: all that the gateway can use; over "
            "UDP as many as one datagram of 1,400 bytes holds, those of the canonical groups first."
        ),
    ] = ()

    def __post_init__(self) -> None:
        faults = [fault for fault in map(name_fault, self.states) if fault]
        faults += [f"{name!r} stands twice" for name in dict.fromkeys(self.states) if self.states.count(name) > 1]
        if len(",".join(self.states)) + 2 > MOST_DATA:
            faults.append(f"these are too many: the names may have {MOST_DATA - 2} characters, commas included")
        if faults:
            raise ValueError(f"states: {'; '.join(faults)}")

    @property
    def wanted(self) -> tuple[str, ...]:
        """The states to ask for."""
        return self.states or (UDP_STATES if self.transport == "udp" else tuple(ALL_STATES))


@dataclass(slots=True)
class Learned:
    """What the sessions with one robot have found out, kept for the run.

    Attributes:
        search: Which states it grants.
        layouts: The configurations it has accepted, by names and types: frames of the same share their layout.
        said: Its last words to a refused configuration.
    """

    search: Narrowing
    layouts: dict[tuple[tuple[str, ...], tuple[str, ...]], Granted] = field(default_factory=dict)
    said: str = ""

    def notes(self) -> list[str]:
        """What the operator should know of the states that are not granted."""
        found = []
        if self.search.refused:
            found.append(f"the controller refuses {_listed(self.search.refused)}; it says {self.said}")
        if self.search.untried:
            found.append(f"left out, among them are refused ones: {_listed(self.search.untried)}")
        return found


class Phase(Enum):
    """Where a session is, and what it waits for."""

    STOPPING = "the output is being stopped"
    CONFIGURING = "the controller has not answered the configuration yet"
    STARTING = "the configuration is accepted, but no data has come yet"
    RUNNING = ""


class CndeDecoder:
    """One session: brings the controller to send, and reads what it sends.

    Args:
        options: The robot's options.
        learned: What earlier sessions with this robot have found out; completed by this one.
    """

    def __init__(self, options: CndeOptions, learned: Learned) -> None:
        self._options = options
        self._learned = learned
        self._frames = FramedDecoder(DELIMITED)
        self._numbers = Numbers(COUNTER_MODULUS)
        self._phase = Phase.STOPPING
        self._owed = frame(STOP)
        self._ticks = 0  # since the step was sent
        self._quiet = 0  # ticks since the last byte came
        self._granted: Granted | None = None
        self._size = 0
        self._head = b""  # type and length of the data frames
        self._wrong = 0
        self._starts = 0
        self._warning = ""

    @property
    def ready(self) -> bool:
        """Whether data frames are coming."""
        return self._phase is Phase.RUNNING

    @property
    def notes(self) -> list[str]:
        """What the operator should know of this session."""
        waiting = [self._phase.value] if self._phase.value else []
        differing = self._granted.notes if self._granted else ()
        warning = [f"the controller says {self._warning}"] if self._warning else []
        return [*waiting, *self._learned.notes(), *differing, *warning]

    @property
    def gaps(self) -> int | None:
        """How many data frames are missing by the controller's counter; None while it does not move."""
        return self._numbers.gaps

    def feed(self, data: bytes) -> list[Event]:
        """Take received bytes and return what they completed."""
        if self._phase is Phase.RUNNING and self._is_next(data):
            self._wrong = self._quiet = 0
            self._numbers.take(data[COUNTER_AT])
            return [Frame(data, cast("Granted", self._granted).layout)]
        events: list[Event] = []
        for event in self._frames.feed(data):
            if type(event) is not Skipped:
                events.append(event)
                continue
            raw = event.raw
            if self._phase is Phase.RUNNING and len(raw) == self._size and raw[3] == DATA:
                self._wrong = 0
                self._numbers.take(raw[COUNTER_AT])
                events.append(Frame(raw, cast("Granted", self._granted).layout))
                continue
            react = _REACTIONS.get((self._phase, raw[3]))
            events += react(self, raw) if react else [event]
        self._quiet = 0
        return events

    def end(self) -> list[Reject]:
        """Return what is left in the buffer: a datagram or the stream has ended."""
        return self._frames.end()

    def outgoing(self) -> bytes:
        """Return the frame that is owed."""
        owed, self._owed = self._owed, b""
        return owed

    def tick(self) -> bytes | Refused:
        """Go on when the controller has fallen silent after stop, and repeat what was not answered."""
        if self._phase is Phase.RUNNING:
            return b""
        self._ticks += 1
        self._quiet += 1
        transport = self._options.transport
        if self._phase is Phase.STOPPING:
            if self._quiet < _QUIET_TICKS:
                again = not self._ticks % _STOP_TICKS or (transport == "udp" and self._ticks == 1)
                return frame(STOP) if again else b""
            return self._enter(Phase.CONFIGURING, self._configuration())
        if self._ticks % PATIENCE_TICKS[transport]:
            return b""
        return frame(START) if self._phase is Phase.STARTING else self._configuration()

    def goodbye(self) -> bytes:
        """Stop the output: nobody would read it."""
        return frame(STOP)

    def _is_next(self, data: bytes) -> bool:
        """Whether a chunk is exactly one data frame, as nearly every one is: 0.6 µs instead of 1.4 µs for each."""
        return (
            len(data) == self._size
            and data[3:HEADER] == self._head
            and data.startswith(MAGIC)
            and data.endswith(TAIL)
            and not self._frames.pending
        )

    def _enter(self, phase: Phase, sent: bytes) -> bytes:
        self._phase = phase
        self._ticks = self._quiet = 0
        return sent

    def _configuration(self) -> bytes:
        return configuration(self._learned.search.proposal, self._options.period_ms)

    def _restart(self) -> None:
        """Stop, and configure again."""
        self._owed = self._enter(Phase.STOPPING, frame(STOP))
        self._wrong = 0

    def _answered(self, raw: bytes) -> list[Event]:
        """A message while the configuration waits for its answer: types, a refusal, or something else."""
        said = message(raw)
        search = self._learned.search
        types = tuple(said.text.replace(" ", "").split(","))
        if said.code >= ERROR:
            self._learned.said = str(said)
            search.refuse()
        elif said.code != SUCCESS or not any(map(parse_type, types)):
            return [Skipped(raw, "message")]
        elif len(types) != len(search.proposal):
            self._learned.said = f"{len(types)} types for {len(search.proposal)} states"
            search.refuse()
        elif unknown := [name for name, text in zip(search.proposal, types, strict=True) if not parse_type(text)]:
            self._learned.said = f"{_listed(dict.fromkeys(text for text in types if not parse_type(text)))} for a type"
            search.drop(unknown)
        else:
            return self._accepted(raw, search.proposal, types)
        if not search.failed:
            self._restart()
            return [Skipped(raw, "answer")]
        return [Skipped(raw, "answer"), *self._give_up()]

    def _give_up(self) -> list[Event]:
        """Nothing is granted, or no longer what was: the next session begins the search anew."""
        self._learned.search = Narrowing(self._options.wanted)
        return [Refused(f"the controller refuses every configuration; it says {self._learned.said}", "refused")]

    def _accepted(self, raw: bytes, names: tuple[str, ...], types: tuple[str, ...]) -> list[Event]:
        """The types have come: go on with the search, or start the output."""
        search = self._learned.search
        found = self._learned.layouts.get((names, types))
        if not search.done:
            search.accept()
        if not search.done:
            self._restart()
            return [Skipped(raw, "answer")]
        try:
            found = found or granted(names, types)
        except ValueError as error:
            return [Skipped(raw, "answer"), Refused(str(error), "incompatible")]
        self._learned.layouts[names, types] = self._granted = found
        self._size = found.frame_size
        self._head = bytes((DATA,)) + (self._size - AROUND).to_bytes(2, "little")
        self._owed = self._enter(Phase.STARTING, frame(START))
        return [Skipped(raw, "answer")]

    def _start_answered(self, raw: bytes) -> list[Event]:
        """A message while data is waited for: only a refusal changes anything."""
        said = message(raw)
        if said.code < ERROR:
            return [Skipped(raw, "message")]
        self._starts += 1
        if self._starts < _STARTS:
            self._restart()
            return [Skipped(raw, "message")]
        return [Skipped(raw, "message"), Refused(f"the controller refuses to start; it says {said}", "refused")]

    def _data(self, raw: bytes) -> list[Event]:
        """A data frame while the output is started or running; it may overtake the answer to start."""
        if len(raw) == self._size:
            self._phase = Phase.RUNNING
            self._wrong = self._starts = 0
            self._numbers.take(raw[COUNTER_AT])
            return [Frame(raw, cast("Granted", self._granted).layout)]
        self._wrong += 1
        if self._wrong >= WRONG_IN_A_ROW:
            self._restart()
        return [Reject(raw, "length", f"a data frame of {len(raw)} bytes, configured are {self._size}")]

    def _early_data(self, raw: bytes) -> list[Event]:
        """A data frame of an earlier configuration, or of another client's."""
        return [Skipped(raw, "data before start")]

    def _told(self, raw: bytes) -> list[Event]:
        """A message in the middle of data: shown where it is a warning or worse."""
        said = message(raw)
        if said.code >= WARNING:
            self._warning = str(said)
        return [Skipped(raw, "message")]


_REACTIONS: dict[tuple[Phase, int], Callable[[CndeDecoder, bytes], list[Event]]] = {
    (Phase.STOPPING, DATA): CndeDecoder._early_data,  # noqa: SLF001 - the table is part of the class
    (Phase.CONFIGURING, DATA): CndeDecoder._early_data,  # noqa: SLF001
    (Phase.CONFIGURING, MESSAGE): CndeDecoder._answered,  # noqa: SLF001
    (Phase.STARTING, DATA): CndeDecoder._data,  # noqa: SLF001
    (Phase.STARTING, MESSAGE): CndeDecoder._start_answered,  # noqa: SLF001
    (Phase.RUNNING, DATA): CndeDecoder._data,  # noqa: SLF001
    (Phase.RUNNING, MESSAGE): CndeDecoder._told,  # noqa: SLF001
}


def make_decoders(options: msgspec.Struct, _rate_hz: float) -> DecoderFactory:
    """Make what makes the decoders of one robot; they share what was learned of it."""
    own = cast("CndeOptions", options)
    learned = Learned(Narrowing(own.wanted))
    return lambda: CndeDecoder(own, learned)


def _listed(names: Iterable[str]) -> str:
    """Some names, and how many more."""
    shown = list(names)
    more = f" and {len(shown) - _MANY} more" if len(shown) > _MANY else ""
    return ", ".join(shown[:_MANY]) + more
