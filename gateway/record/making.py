"""Makes a recording of what a gateway tells: bytes and marks as they are, samples by replaying the bytes."""

from __future__ import annotations

from pathlib import Path

import msgspec

from gateway.api.model import Event, Sample
from gateway.core.bus import Bus, Reading, Topic
from gateway.core.events import EventRing
from gateway.core.registry import Registry
from gateway.core.settings import RobotSettings
from gateway.errors import ConfigError
from gateway.record.chunks import Block, Chunk, Silence
from gateway.record.mcapfile import SET_BACK, Mark, Writer
from gateway.record.replayer import Replayer
from gateway.record.robots import robots_in
from gateway.record.spool import Begin, End, Message, Raw, Said, SpoolError

_SILENCE = msgspec.json.Decoder(Silence)
_JSON = msgspec.json.Encoder()


class Making:
    """Takes the messages of a spool and writes the file.

    The `vendor` group is left out: it is the bytes again, many times larger, and `replay` and `decode` show it.

    Args:
        writer: The file; finished with `End`.
        samples: Whether the samples that follow from the bytes are written as well.

    Attributes:
        finished: Whether the recording is whole.
        notes: What could not be recorded, one sentence each.
    """

    def __init__(self, writer: Writer, *, samples: bool = True) -> None:
        self._writer = writer
        self._samples = samples
        self._begin: Begin | None = None
        self._robots: dict[str, RobotSettings] = {}
        self._makers: dict[str, _RobotMaking] = {}
        self.finished = False
        self.notes: list[str] = []

    def take(self, message: Message) -> None:
        """Take the next message.

        Raises:
            SpoolError: It stands in the wrong place.
            OSError: The file cannot be written.
        """
        if isinstance(message, Begin):
            self._start(message)
        elif self._begin is None:
            raise SpoolError(f"{type(message).__name__} comes before Begin")
        elif isinstance(message, Raw):
            self._maker(message.robot, self._begin).take(message.block)
        elif isinstance(message, Said):
            self._writer.said(message.topic, message.t, message.seq, message.data)
        elif isinstance(message, End):
            set_back = {SET_BACK: "yes"} if any(maker.set_back for maker in self._makers.values()) else {}
            self._writer.about({"to": str(message.to_t), **set_back, **message.more})
            self._writer.finish()
            self.finished = True

    def _start(self, begin: Begin) -> None:
        self._begin = begin
        self._writer.about({"from": str(begin.from_t), "gateway": begin.gateway, **begin.reason})
        self._writer.robots(begin.robots, begin.from_t)
        if not self._samples:
            return
        try:
            registry = Registry([Path(one) for one in begin.vendor_dirs])
        except ConfigError as error:
            self.notes.append(f"no samples are written: {error}")
            return
        found = robots_in(begin.robots, registry)
        self._robots = found.usable
        self.notes += [f"{name}: no samples are written: {reason}" for name, reason in found.left_out.items()]

    def _maker(self, robot: str, begin: Begin) -> _RobotMaking:
        found = self._makers.get(robot)
        if found is None:
            settings = self._robots.get(robot)
            found = self._makers[robot] = _RobotMaking(robot, settings, self._writer, begin.from_t, self.notes)
        return found


class _RobotMaking:
    """One robot of a recording; None for its settings: only its bytes are written.

    It is the listener of the topics that its replay publishes.
    """

    def __init__(
        self, robot: str, settings: RobotSettings | None, writer: Writer, from_t: int, notes: list[str]
    ) -> None:
        self._robot = robot
        self._writer = writer
        self._from_t = from_t
        self._notes = notes
        self._index = 0
        self._t = 0
        self._begun = False
        self._before: dict[str, Sample] = {}  # the states that stand when the recording begins
        self.set_back = False  # the wall clock was: the order of its times is not that of its bytes
        self._replayer: Replayer | None = None
        if settings is not None:
            bus = Bus(EventRing(1), 1)
            self._replayer = Replayer(settings, bus, settings.origin)
            for topic in bus.topics.values():
                if topic.group.name != "vendor":
                    topic.listeners.append(self)

    def take(self, block: Block) -> None:
        """Write the next block of its ring, and what follows from it."""
        chunks = block.chunks()
        if not self._begun:
            self._begun = True
            if chunks[0].kind != "begin":
                self._resume(block, chunks[0])
        for chunk in chunks:
            self.set_back = self.set_back or chunk.t < self._t
            self._t = chunk.t
            self._number(chunk)
            self._write(chunk)
            self._play(chunk)

    def on_reading(self, topic: Topic, reading: Reading) -> None:
        """Write a sample."""
        sample = reading.sample(topic)
        if sample.t < self._from_t:
            if topic.group.delivery == "state":
                self._before[topic.name] = sample
            return
        if self._before:
            for standing in self._before.values():
                self._say(standing)
            self._before.clear()
        self._from_t = 0  # it has begun: a clock that is set back later leaves nothing out
        self._say(sample)

    def on_event(self, topic: Topic, event: Event) -> None:
        """Events are recorded as they were told, not as they are found again."""

    def _say(self, sample: Sample) -> None:
        self._writer.said(sample.topic, sample.t, sample.seq, _JSON.encode(sample))

    def _resume(self, block: Block, first: Chunk) -> None:
        """Begin in the middle of a session: what opened it comes first."""
        replayer, seqs = self._replayer, 0 if first.seqs is None else first.seqs
        if replayer is not None:
            replayer.open(first.epoch)
        for chunk in block.opening:
            if chunk.kind == "begin":
                self._mark(chunk.t, Mark(kind="opening", epoch=chunk.epoch))
                continue
            self._write(chunk)
            if replayer is not None:
                replayer.read(chunk)
        self._mark(first.t, Mark(kind="resume", epoch=first.epoch, seqs=seqs, faults=list(block.faults)))
        if replayer is not None:
            replayer.resume(first.epoch, seqs, block.faults)

    def _write(self, chunk: Chunk) -> None:
        if chunk.kind == "received" or chunk.kind == "sent":  # noqa: PLR1714 - so that mypy follows
            self._index += 1
            self._writer.raw(self._robot, chunk.kind, chunk.t, chunk.data, self._index)
        elif chunk.kind == "silent":
            silence = _SILENCE.decode(chunk.data)
            mark = Mark(
                kind="silent", epoch=chunk.epoch, seqs=chunk.seqs or 0, quality=silence.quality, t_last=silence.t_last
            )
            self._mark(chunk.t, mark)
        else:
            self._mark(chunk.t, Mark(kind=chunk.kind, epoch=chunk.epoch, seqs=chunk.seqs or 0))

    def _number(self, chunk: Chunk) -> None:
        """Say how the next sample is numbered, where a replay alone would number it otherwise."""
        if self._replayer is None or chunk.kind != "received" or chunk.seqs is None:
            return
        if self._replayer.publisher.seqs != chunk.seqs:
            self._mark(chunk.t, Mark(kind="number", epoch=chunk.epoch, seqs=chunk.seqs))

    def _play(self, chunk: Chunk) -> None:
        if self._replayer is None:
            return
        try:
            self._replayer.play(chunk)
        except Exception as error:  # noqa: BLE001 - a plugin's mistake costs the samples, not the bytes
            self._notes.append(f"{self._robot}: its samples end here, the plugin failed: {error!r}")
            self._replayer = None

    def _mark(self, t: int, mark: Mark) -> None:
        self._index += 1
        self._writer.mark(self._robot, t, mark, self._index)
