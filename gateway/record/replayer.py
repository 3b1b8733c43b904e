"""Replays what was recorded of one robot: its bytes go through a decoder and a publisher again."""

from __future__ import annotations

from collections.abc import Sequence

import msgspec

from gateway.api.decoder import AskedDecoder, Decoder, Event, Frame, Occurrence
from gateway.api.model import Fault
from gateway.api.normaliser import Normaliser
from gateway.core.bus import Bus, Origin
from gateway.core.controller_clock import ControllerClock
from gateway.core.publisher import Publisher
from gateway.core.settings import RobotSettings
from gateway.core.tap import Seqs
from gateway.record.chunks import Chunk, Silence

_SILENCE = msgspec.json.Decoder(Silence)


class RecordedTime:
    """The time line of a recording: it stands where the chunk that is being read was received."""

    def __init__(self) -> None:
        self.t = 0

    def stamp(self, monotonic_s: float) -> int:  # noqa: ARG002 - a time line's signature
        """µs UTC."""
        return self.t


class Replayer:
    """One robot of a recording.

    Args:
        robot: As it was configured.
        bus: Where it is published.
        origin: What its samples say of where they come from.
    """

    def __init__(self, robot: RobotSettings, bus: Bus, origin: Origin = "replay") -> None:
        self._robot = robot
        self._bus = bus
        wall_clock = robot.protocol.wall_clock
        self._publisher = Publisher(
            robot.name,
            bus,
            Normaliser(robot.protocol.signals, robot.signal_options),
            origin,
            ControllerClock(wall_clock, robot.clock_zone) if wall_clock else None,
            stale_s=robot.stale_s,
            commands=robot.protocol.commands,
            io_events=robot.io_events,
        )
        self._time = RecordedTime()
        self._datagrams = robot.protocol.transport(robot.options) == "udp"
        self._decoder: Decoder | None = None
        self._epoch = ""

    @property
    def publisher(self) -> Publisher:
        """Publishes its samples."""
        return self._publisher

    def open(self, epoch: str) -> None:
        """Begin to read a session of which nothing is published yet: what is read is what opened it."""
        self._decoder = self._robot.protocol.observer(self._robot.options)
        self._epoch = epoch

    def resume(self, epoch: str, seqs: Seqs, faults: Sequence[Fault]) -> None:
        """Go on in the middle of a session.

        Args:
            epoch: The running epoch.
            seqs: The number of the last sample.
            faults: The faults that stand.
        """
        if self._decoder is None:
            self.open(epoch)
        self._epoch = epoch
        self._publisher.begin(epoch, self._time)
        self._publisher.know(faults)
        self._publisher.number(seqs)

    def play(self, chunk: Chunk) -> list[Event]:
        """Take the next chunk and publish what it completed; what that was.

        An epoch that ends inside a session, because the clock was set back, is followed.
        """
        self._time.t, at_s = chunk.t, chunk.t / 1e6
        if chunk.kind == "begin" or (self._decoder is None and chunk.kind in {"received", "sent"}):
            self.open(chunk.epoch)
            self._publisher.begin(chunk.epoch, self._time)
        elif chunk.epoch != self._epoch:
            self._epoch = chunk.epoch
            self._publisher.set_back(chunk.epoch, at_s)
        events = self.read(chunk)
        if chunk.seqs is not None and (events or chunk.kind == "silent"):
            self._publisher.number(chunk.seqs)
        for event in events:
            if isinstance(event, Frame):
                self._publisher.frame(event, at_s)
            elif isinstance(event, Occurrence):
                self._publisher.occurred(event.entries, at_s)
        if chunk.kind == "silent":
            silence = _SILENCE.decode(chunk.data)
            self._publisher.silent(silence.quality, chunk.t, silence.t_last)
        elif chunk.kind == "expired":
            self._publisher.expire(at_s)
        elif chunk.kind == "end":
            self._decoder = None
        return events

    def read(self, chunk: Chunk) -> list[Event]:
        """Show a chunk to the decoder, and publish nothing."""
        decoder = self._decoder
        if decoder is None:
            return []
        if chunk.kind == "sent" and isinstance(decoder, AskedDecoder):
            decoder.asked(chunk.data)
        elif chunk.kind == "end":
            return list(decoder.end())
        elif chunk.kind == "received":
            events = decoder.feed(chunk.data)
            return [*events, *decoder.end()] if self._datagrams else events
        return []
