"""The virtual CNDE session, over TCP and UDP: configured by name, and each frame one send.

What the values are says the rest of the virtual controller; here they only become what was asked for.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from functools import partial

from gateway.api.decoder import Skipped
from gateway.api.framing import FramedDecoder
from gateway.api.layout import Layout
from gateway.sim.simulator import VirtualRobot
from vendors.fairino.cnde_states import ALL_STATES, HEADER, TAIL, granted
from vendors.fairino.cnde_wire import (
    CONFIGURE,
    DATA,
    DELIMITED,
    ERROR,
    FIRMWARE,
    MESSAGE,
    START,
    STOP,
    SUCCESS,
    frame,
)
from vendors.fairino.layouts import CHECKSUM_SIZE, LONGEST, STATES
from vendors.fairino.simulator.values import Writer

FILLERS = (frame(MESSAGE, b"\x01information"), frame(MESSAGE, b"\x02joint 3 is warm"))
_PERIODS_MS = range(1, 201)  # as documented; clients use 8 and more


@dataclass(frozen=True, slots=True, kw_only=True)
class CndeBehaviour:
    """How a virtual controller speaks CNDE.

    Args:
        known: The states that it knows; a configuration with any other is refused as a whole.
        types: Wire types that differ from the vendor's table, by state.
        counts: Whether it numbers its frames; firmware 3.9.7 always sends 0.
        version: What it says when it is asked for its firmware.
    """

    known: Collection[str] = tuple(ALL_STATES)
    types: Mapping[str, str] = field(default_factory=dict)
    counts: bool = False
    version: str = "FR5,V3.9.7,virtual"


def known_states(legacy_size: int) -> tuple[str, ...]:
    """The states that a firmware knows: those that its legacy frame holds, and all others too with the longest.

    Args:
        legacy_size: Bytes of the firmware's legacy frame.
    """
    end = legacy_size - CHECKSUM_SIZE
    listed = tuple(state.name for state in STATES if all(LONGEST.by_name[name].end <= end for name in state.fields))
    return listed if end < LONGEST.size else tuple(ALL_STATES)


class CndeSession:
    """One client's session.

    Args:
        robot: What it speaks of.
        behaviour: How.
        make_writer: Makes what writes the words of a configuration.
    """

    def __init__(
        self,
        robot: VirtualRobot,
        behaviour: CndeBehaviour,
        make_writer: Callable[[Layout], Writer] = Writer,
    ) -> None:
        self.period_s: float | None = None
        self._robot = robot
        self._behaviour = behaviour
        self._make_writer = make_writer
        self._frames = FramedDecoder(DELIMITED)
        self._writer: Writer | None = None
        self._configured_s = 0.0
        self._count = 0

    def received(self, data: bytes, now_s: float) -> list[bytes]:
        """Answer what clients ask; what moves or switches something is refused."""
        answers = []
        for event in self._frames.feed(data):
            if isinstance(event, Skipped):
                self._robot.requests += 1
                answer = _ANSWERS.get(event.raw[3])
                if answer is None:
                    answers.append(self._say(ERROR, "NOT_SUPPORTED"))
                else:
                    answers += answer(self, event.raw[HEADER : -len(TAIL)], now_s)
        return answers

    def due(self, now_s: float) -> list[bytes]:
        """Return the data frame of this period, once started."""
        writer = self._writer
        if self.period_s is None or writer is None:
            return []
        words = writer.words(self._robot.state(now_s))
        data = frame(DATA, writer.packer.pack(words)[HEADER:], self._next_count())
        self._robot.count(data, now_s, partial(writer.packer.named, words))
        return [data]

    def _next_count(self) -> int:
        self._count += self._behaviour.counts
        return self._count

    def _say(self, code: int, text: str) -> bytes:
        return frame(MESSAGE, bytes((code,)) + text.encode("ascii"), self._next_count())

    def _configure(self, data: bytes, _now_s: float) -> list[bytes]:
        """Take a whole configuration, or refuse it."""
        if self.period_s is not None:
            return [self._say(ERROR, "OUTPUT_IS_RUNNING")]
        names = tuple(data[2:].decode("ascii", "replace").split(","))
        if any(name not in self._behaviour.known for name in names):
            return [self._say(ERROR, "NOT_FOUND")]
        period_ms = int.from_bytes(data[:2], "little")
        if period_ms not in _PERIODS_MS:
            return [self._say(ERROR, "PERIOD_OUT_OF_RANGE")]
        types = tuple(self._behaviour.types.get(name) or ALL_STATES[name].type for name in names)
        self._writer = self._make_writer(granted(names, types).layout)
        self._configured_s = period_ms / 1000
        return [self._say(SUCCESS, ",".join(types))]

    def _start(self, _data: bytes, _now_s: float) -> list[bytes]:
        if self._writer is None:
            return [self._say(ERROR, "NOT_CONFIGURED")]
        self.period_s = self._configured_s
        return [self._say(SUCCESS, "START_OK")]

    def _stop(self, _data: bytes, _now_s: float) -> list[bytes]:
        self.period_s = None
        return [self._say(SUCCESS, "STOP_OK")]

    def _tell_version(self, _data: bytes, _now_s: float) -> list[bytes]:
        return [self._say(SUCCESS, self._behaviour.version)]

    def _take_message(self, _data: bytes, _now_s: float) -> list[bytes]:
        return []


_ANSWERS: dict[int, Callable[[CndeSession, bytes, float], list[bytes]]] = {
    CONFIGURE: CndeSession._configure,  # noqa: SLF001 - the table is part of the class
    START: CndeSession._start,  # noqa: SLF001
    STOP: CndeSession._stop,  # noqa: SLF001
    MESSAGE: CndeSession._take_message,  # noqa: SLF001
    FIRMWARE: CndeSession._tell_version,  # noqa: SLF001
}
