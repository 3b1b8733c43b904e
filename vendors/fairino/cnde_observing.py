"""Reads a CNDE session that was held before: its configuration follows from what was sent and answered."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import cast

import msgspec

from gateway.api.decoder import Event, Frame, Reject, Skipped
from gateway.api.framing import COUNTER_MODULUS, FramedDecoder
from gateway.api.numbers import Numbers
from vendors.fairino.cnde import WRONG_IN_A_ROW, CndeOptions, Phase
from vendors.fairino.cnde_states import ALL_STATES, Granted, granted, parse_type
from vendors.fairino.cnde_wire import (
    CONFIGURE,
    COUNTER_AT,
    DATA,
    DELIMITED,
    MESSAGE,
    START,
    STOP,
    SUCCESS,
    asked_states,
    message,
)

# Sessions with the same configuration share their layout, and so its readers.
_granted = lru_cache(maxsize=64)(granted)
_OF_THE_STEP = {STOP: Phase.STOPPING, CONFIGURE: Phase.CONFIGURING, START: Phase.STARTING}


class CndeObserver:
    """Reads one session and sends nothing; a `gateway.api.decoder.AskedDecoder`.

    Where it sees no configuration, as in a recording of what was received alone, it takes the frames for those of the
    robot's options with the types of the vendor's table.

    Args:
        options: The robot's options.
    """

    def __init__(self, options: msgspec.Struct) -> None:
        names = cast("CndeOptions", options).wanted
        known = [ALL_STATES[name].type if name in ALL_STATES else "" for name in names]
        self._frames, self._questions = FramedDecoder(DELIMITED), FramedDecoder(DELIMITED)
        self._numbers = Numbers(COUNTER_MODULUS)
        self._phase = Phase.RUNNING
        self._names = names
        self._granted: Granted | None = _granted(names, tuple(known)) if all(known) else None
        self._wrong = 0

    @property
    def ready(self) -> bool:
        """Whether data frames may come."""
        return self._phase is Phase.RUNNING

    @property
    def notes(self) -> Sequence[str]:
        """In what the controller's types differ from the vendor's table."""
        return self._granted.notes if self._granted else ()

    @property
    def gaps(self) -> int | None:
        """How many data frames are missing by the controller's counter; None while it does not move."""
        return self._numbers.gaps

    def asked(self, data: bytes) -> None:
        """Take what was sent."""
        for event in self._questions.feed(data):
            if type(event) is not Skipped or event.raw[3] not in _OF_THE_STEP:
                continue
            if event.raw[3] == CONFIGURE:
                self._names = asked_states(event.raw)
            self._phase, self._wrong = _OF_THE_STEP[event.raw[3]], 0

    def feed(self, data: bytes) -> list[Event]:
        """Take received bytes and return what they completed."""
        return [self._read(event.raw) if type(event) is Skipped else event for event in self._frames.feed(data)]

    def end(self) -> list[Reject]:
        """Return what is left in the buffer: a datagram or the stream has ended."""
        return self._frames.end()

    def outgoing(self) -> bytes:
        """Nothing is owed: it only reads."""
        return b""

    def tick(self) -> bytes:
        """Nothing is asked: it only reads."""
        return b""

    def goodbye(self) -> bytes:
        """Nothing is owed before a close."""
        return b""

    def _read(self, raw: bytes) -> Event:
        """What a whole frame says."""
        if raw[3] == DATA:
            return self._data(raw)
        if raw[3] == MESSAGE and self._phase is Phase.CONFIGURING:
            said = message(raw)
            types = tuple(said.text.replace(" ", "").split(","))
            if said.code == SUCCESS and len(types) == len(self._names) and all(map(parse_type, types)):
                self._accept(types)
        return Skipped(raw, "message")

    def _accept(self, types: tuple[str, ...]) -> None:
        """The controller grants what it was asked for."""
        try:
            self._granted = _granted(self._names, types)
        except ValueError:  # more than a frame may carry: the session ended here
            self._granted = None
        self._phase = Phase.STARTING

    def _data(self, raw: bytes) -> Event:
        if self._phase not in {Phase.STARTING, Phase.RUNNING} or self._granted is None:
            return Skipped(raw, "data before start")
        size = self._granted.frame_size
        if len(raw) != size:
            self._wrong += 1
            if self._wrong >= WRONG_IN_A_ROW:  # the gateway configured it anew
                self._phase = Phase.STOPPING
            return Reject(raw, "length", f"a data frame of {len(raw)} bytes, configured are {size}")
        self._phase, self._wrong = Phase.RUNNING, 0
        self._numbers.take(raw[COUNTER_AT])
        return Frame(raw, self._granted.layout)
