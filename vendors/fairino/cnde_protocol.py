"""The record of the protocol `cnde`: what the daemon reads of it, and how a controller is probed for it."""

from __future__ import annotations

import dataclasses

from gateway.api.decoder import Event, Refused, Reject, Skipped
from gateway.api.framing import FramedDecoder, Kind
from gateway.api.vendor import Protocol
from vendors.fairino.cnde import PATIENCE_TICKS, TICK_S, CndeOptions, make_decoders
from vendors.fairino.cnde_observing import CndeObserver
from vendors.fairino.cnde_states import ALL_STATES, granted
from vendors.fairino.cnde_wire import COUNTER_AT, DATA, DELIMITED, FIRMWARE, MESSAGE, OUTGOING, frame, message
from vendors.fairino.signals import SIGNALS
from vendors.fairino.wall_clock import WALL_CLOCK


class FirmwareProbe:
    """Asks for the firmware's version, which changes nothing: neither for the controller nor for its other clients."""

    ready = True
    gaps = None

    def __init__(self) -> None:
        self._frames = FramedDecoder(DELIMITED)
        self._owed = frame(FIRMWARE)
        self._ticks = 0
        self.notes: list[str] = []

    def feed(self, data: bytes) -> list[Event]:
        """Take received bytes; a message, or an answer of the same type, tells the version."""
        events = self._frames.feed(data)
        for event in events:
            if type(event) is Skipped and event.raw[3] in {MESSAGE, FIRMWARE}:
                self.notes = [f"the controller says {message(event.raw)}"]
        return events

    def end(self) -> list[Reject]:
        """Return what is left in the buffer."""
        return self._frames.end()

    def outgoing(self) -> bytes:
        """Return the question, once."""
        owed, self._owed = self._owed, b""
        return owed

    def tick(self) -> bytes | Refused:
        """Ask again now and then: a datagram may be lost."""
        self._ticks += 1
        return b"" if self._ticks % PATIENCE_TICKS["udp"] else frame(FIRMWARE)

    def goodbye(self) -> bytes:
        """Nothing is owed: nothing was started."""
        return b""


# The frames of the default configuration, for recordings; a live session reads what its handshake has agreed on.
_DEFAULT = granted(tuple(ALL_STATES), tuple(state.type for state in ALL_STATES.values()))
FRAMING = dataclasses.replace(
    DELIMITED,
    kinds=(
        Kind(
            type=DATA,
            name="data",
            layouts=(_DEFAULT.layout,),
            smallest=_DEFAULT.frame_size,
            largest=_DEFAULT.frame_size,
        ),
        *(kind for kind in DELIMITED.kinds if kind.type in {MESSAGE, FIRMWARE}),
    ),
    counter_at=COUNTER_AT,
)

CNDE = Protocol(
    name="cnde",
    title="States asked for by name, TCP port 20005 or UDP port 20006",
    port=20005,
    udp_port=20006,
    framing=FRAMING,
    signals=SIGNALS,
    options=CndeOptions,
    make_observer=CndeObserver,
    make_decoders=make_decoders,
    tick_s=TICK_S,
    handshake_s=10.0,
    outgoing=OUTGOING,
    wall_clock=WALL_CLOCK,
    when_refused=(
        "port 20005 came with firmware 3.9.5, and port 20006 with about 3.8.2: the firmware is probably older; "
        'set transport = "udp" below [robots.cnde], and where that is refused too, protocol = "legacy", '
        "but read first what the vendor's README says of SetRobotStopOnComDisc"
    ),
    probe=FirmwareProbe,
)
