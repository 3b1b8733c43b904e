"""The flight recorder of a running gateway: a ring for each robot, and a file of the whole cell when something happens.

It decodes nothing. What it keeps goes to a process of its own that writes the file: the loop is never held up, and a
full disk costs the recording.
"""

from __future__ import annotations

import errno
import os
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import anyio
import anyio.to_thread
import msgspec
import structlog

from gateway import __version__
from gateway.api.messages import RecorderInfo
from gateway.api.model import Event
from gateway.core.bus import Bus, Change, Reading, Topic
from gateway.core.clock import Clock
from gateway.record import retention
from gateway.record.chunks import Block
from gateway.record.dump import Asked, Dump, Opened, Trigger, name_of, words_of
from gateway.record.feed import Feed, Sink
from gateway.record.filing import Filing
from gateway.record.packing import Packer
from gateway.record.ring import Ring
from gateway.record.settings import PART, RecorderSettings
from gateway.record.spool import Begin, End, Message, Outcome, Raw, Said
from gateway.record.told import TOLD_GROUPS, ToldLog

_LOG = structlog.get_logger()
NO_FOLDER = "no folder for recordings is configured: set recorder.directory"
# Read so much earlier than asked for: what frames tell in parts is complete then.
WARM_UP_S = 5.0
_LOOK_S = 1.0
_CLOCK_STEP_US = 2_000_000
_MOST_PENDING = 1000
_JSON = msgspec.json.Encoder()


class Recorder:
    """Keeps what the robots of a cell said lately, and writes it down.

    Args:
        settings: How much is kept, and when it is written.
        bus: Where the robots are published.
        clock: Both times.
        robots: Gives the robots as understood, TOML, and the folders of further plugins.
        opened: Starts a writer.

    Attributes:
        is_subscriber: It is a part of the gateway: it does not count among those who listen to a topic.
    """

    is_subscriber = False

    def __init__(
        self,
        settings: RecorderSettings,
        bus: Bus,
        clock: Clock,
        robots: Callable[[], tuple[str, list[str]]],
        opened: Opened = Filing.opened,
    ) -> None:
        self._opened = opened
        self._settings = settings
        self._bus = bus
        self._clock = clock
        self._robots = robots
        self._rings: dict[str, Ring] = {}
        self._packer = Packer()
        self._told = ToldLog(settings.ring_s)
        self._sinks: list[Sink] = []
        self._dump: Dump | None = None
        self._pending: list[Trigger] = []
        self._wanted = anyio.Event()
        self._info = RecorderInfo(directory=_text(settings.directory))
        self._is_short = False

    @property
    def info(self) -> RecorderInfo:
        """What the operator may know."""
        return msgspec.structs.replace(self._info, ring_bytes=sum(ring.n_bytes for ring in self._rings.values()))

    @property
    def rings(self) -> dict[str, Ring]:
        """The rings of the robots, by name."""
        return self._rings

    @property
    def ring_s(self) -> float:
        """How far back it can tell, in s."""
        return self._settings.ring_s

    def tap(self, robot: str) -> Ring:
        """A new ring for a robot, in the place of the one that it had."""
        if robot in self._rings:
            self.forget(robot)
            if self._dump is not None:
                self._dump.leave(robot)
        ring = self._rings[robot] = Ring(robot, self._settings.ring_s, self._settings.ring_bytes, self._packer)
        ring.readers.append(self)
        return ring

    def forget(self, robot: str) -> None:
        """A robot is no longer there."""
        ring = self._rings.get(robot)
        if ring is not None:
            ring.close_block()
            ring.readers.clear()
            del self._rings[robot]

    def watch(self) -> None:
        """Listen to the bus from now on, and to the topics that come later."""
        self._bus.watch(self)
        self._attach(list(self._bus.topics.values()))

    def configure(self, settings: RecorderSettings) -> None:
        """Take other settings; a recording that is under way ends as it began."""
        self._settings = settings
        self._told.keep_s = settings.ring_s
        self._is_short = False
        for ring in self._rings.values():
            ring.resize(settings.ring_s, settings.ring_bytes)
        self._info = msgspec.structs.replace(self._info, directory=_text(settings.directory))

    def robots_changed(self) -> None:
        """The robots are others now: tell whoever reads on."""
        for sink in list(self._sinks):
            sink.put("", self._begin(Trigger("record", "", self._clock.utc_us(), 0.0), self._clock.utc_us()))

    def snapshot(self) -> Asked | None:
        """Ask for a recording of now; None: there is no folder for it."""
        if self._settings.directory is None:
            return None
        asked = Asked()
        self._trigger("snapshot", "", self._clock.utc_us(), asked)
        return asked

    def capture(self, robot: str, seconds: float) -> Iterator[Message]:
        """What a robot said in the last seconds, for one who writes it elsewhere.

        Raises:
            KeyError: There is none of this name.
        """
        now_s, now = self._clock.monotonic(), self._clock.utc_us()
        trigger = Trigger("capture", robot, now, now_s)
        blocks = self._rings[robot].blocks(now_s - seconds - WARM_UP_S)
        begin = self._begin(trigger, self._from_t(seconds, blocks))
        said = [said for said in self._told.since(now_s - seconds) if said.topic.startswith(f"{robot}/")]
        return iter([begin, *(Raw(robot=robot, block=block) for block in blocks), *said, End(to_t=now)])

    @contextmanager
    def streaming(self, wanted: Callable[[str], bool]) -> Iterator[Feed]:
        """Hand out what is kept of some robots from now on, behind what is needed to read it.

        Args:
            wanted: Says which robots.
        """
        feed, now_s = Feed(wanted), self._clock.monotonic()
        feed.put("", self._begin(Trigger("record", "", self._clock.utc_us(), now_s), self._clock.utc_us()))
        for robot, message in self._kept(now_s):
            feed.put(robot, message)
        self._sinks.append(feed)
        try:
            yield feed
        finally:
            self._sinks.remove(feed)

    async def run(self) -> None:
        """Write recordings until cancelled."""
        if self._settings.directory is not None:
            await self._prepared(self._settings.directory, None)
        async with anyio.create_task_group() as tasks:
            tasks.start_soon(self._packer.run)
            tasks.start_soon(self._close_old_blocks)
            while True:
                await self._wanted.wait()
                self._wanted = anyio.Event()
                triggers, self._pending = self._pending, []
                if triggers:
                    await self._record(triggers)

    def on_topics(self, change: Change) -> None:
        """Listen to the topics that have come; a robot whose link has gone is no longer there."""
        self._attach(change.added)
        for topic in change.removed:
            self._told.forget(topic.name)
            if topic.group.name == "link":
                self.forget(topic.robot)

    def on_reading(self, topic: Topic, reading: Reading) -> None:
        """Keep what a topic that follows from no bytes says."""
        sample = reading.sample(topic)
        self._tell(topic.robot, Said(topic=topic.name, t=sample.t, seq=sample.seq, data=_JSON.encode(sample)))

    def on_event(self, topic: Topic, event: Event) -> None:
        """Keep an event; some trigger a recording."""
        self._tell(topic.robot, Said(topic=topic.name, t=event.t, seq=event.seq, data=_JSON.encode(event)))
        if event.kind.value in self._settings.on:
            self._trigger(event.kind.value, event.robot, event.t)

    def on_block(self, robot: str, block: Block) -> None:
        """Hand a block on to whoever reads, and keep the rings in their bounds."""
        for sink in self._sinks:
            sink.put(robot, Raw(robot=robot, block=block))
        rings = self._rings.values()
        while sum(ring.n_bytes for ring in rings) > self._settings.ring_bytes:
            largest = max(rings, key=lambda ring: ring.n_bytes)
            if not largest.shorten():
                break
            self._note_short(largest)

    def _note_short(self, ring: Ring) -> None:
        """Say once that less is kept than a recording wants."""
        if not self._is_short and ring.span_s < self._settings.before_s:
            self._is_short = True
            words = f"{self._settings.ring_bytes / 1e6:g} MB hold {ring.span_s:.0f} s of it: raise recorder.ring_mb"
            _LOG.warning("ring.shortened", robot=ring.robot, reason=words)

    def _attach(self, topics: Iterable[Topic]) -> None:
        for topic in topics:
            if topic.group.name in TOLD_GROUPS and self not in topic.listeners:
                topic.listeners.append(self)
                if topic.latest is not None:
                    self.on_reading(topic, topic.latest)

    def _tell(self, robot: str, said: Said) -> None:
        self._told.add(self._clock.monotonic(), said)
        for sink in self._sinks:
            sink.put(robot, said)

    def _trigger(self, kind: str, robot: str, t: int, asked: Asked | None = None) -> None:
        """Something has happened that is worth a recording; one that is under way is made longer."""
        if self._settings.directory is None:
            return
        trigger = Trigger(kind, robot, t, self._clock.monotonic(), asked)
        if self._dump is not None and self._dump.is_open:
            self._dump.again(trigger)
        elif len(self._pending) < _MOST_PENDING or asked is not None:
            self._pending.append(trigger)
            self._wanted.set()

    async def _close_old_blocks(self) -> None:
        """See to it that readers get what a robot said before it fell silent."""
        while True:
            await anyio.sleep(_LOOK_S)
            now_s = self._clock.monotonic()
            for ring in list(self._rings.values()):
                ring.close_old_block(now_s)

    async def _record(self, triggers: list[Trigger]) -> None:
        """Write one recording, from before its first trigger until after its last."""
        directory = self._settings.directory
        if directory is None:
            return
        dump = self._dump = Dump(triggers, self._settings.after_s, self._clock, self._opened)
        try:
            path = await self._prepared(directory, triggers[0])
            if path is None:
                outcome = Outcome(error=self._info.error or "")
            else:
                self._info = msgspec.structs.replace(self._info, recording=str(path))
                self._open(dump)
                outcome = await dump.write(path, lambda: self._close(dump))
        finally:
            self._dump = None
            self._close(dump)
            self._info = msgspec.structs.replace(self._info, recording=None)
        await self._conclude(directory, path, dump.triggers, outcome)

    def _open(self, dump: Dump) -> None:
        before_s = self._settings.before_s + self._clock.monotonic() - dump.triggers[0].at_s
        since_s = self._clock.monotonic() - before_s
        kept = [message for _, message in self._kept(since_s)]
        blocks = [message.block for message in kept if isinstance(message, Raw)]
        dump.begin(self._begin(dump.triggers[0], self._from_t(before_s, blocks)), kept)
        self._sinks.append(dump)

    def _close(self, dump: Dump) -> None:
        if dump in self._sinks:
            for ring in self._rings.values():
                ring.close_block()
            self._sinks.remove(dump)

    def _kept(self, since_s: float) -> Iterator[tuple[str, Message]]:
        """What is kept since a monotonic time, s, and some time before that."""
        for ring in list(self._rings.values()):
            for block in ring.blocks(since_s - WARM_UP_S):
                yield ring.robot, Raw(robot=ring.robot, block=block)
        for said in self._told.since(since_s):
            yield said.topic.partition("/")[0], said

    async def _prepared(self, directory: Path, trigger: Trigger | None) -> Path | None:
        """A free name in the folder, which is made if it is not there; None: it cannot be, and that is told."""
        prepare = partial(_prepare, directory, trigger)
        try:
            path, swept = await anyio.to_thread.run_sync(prepare, abandon_on_cancel=True)
        except OSError as error:
            reason = f"{directory}: {error.strerror or error}"
            if trigger is None:
                _LOG.error("recording.failed", reason=reason)
            self._info = msgspec.structs.replace(self._info, error=reason)
            return None
        for left in swept:
            _LOG.warning("recording.abandoned", reason=f"{left} was not finished: removed")
        return path

    async def _conclude(self, directory: Path, path: Path | None, triggers: list[Trigger], outcome: Outcome) -> None:
        info, written = self._info, path is not None and not outcome.error
        if written:
            self._info = msgspec.structs.replace(info, recordings=info.recordings + 1, last=str(path), error=None)
            for note in outcome.notes:
                _LOG.warning("recording.noted", reason=note)
            _LOG.info("recording.written", reason=words_of(triggers), n_bytes=outcome.n_bytes, path=str(path))
        else:
            self._info = msgspec.structs.replace(info, failed=info.failed + 1, error=outcome.error)
            _LOG.error("recording.failed", reason=outcome.error)
        for trigger in triggers:
            if trigger.asked is not None:
                trigger.asked.path, trigger.asked.error = path if written else None, outcome.error
                trigger.asked.done.set()
        if written:
            await self._tidy(directory)

    async def _tidy(self, directory: Path) -> None:
        tidy = partial(retention.tidy, directory, self._settings, self._clock.utc_us() / 1e6)
        try:
            gone = await anyio.to_thread.run_sync(tidy, abandon_on_cancel=True)
        except OSError as failure:
            _LOG.warning("recordings.not_removed", reason=f"{directory}: {failure.strerror}")
        else:
            for old in gone:
                _LOG.info("recording.removed", path=str(old))

    def _from_t(self, before_s: float, blocks: list[Block]) -> int:
        """When a recording begins, µs UTC; after a jump of the clock nothing is left out by its time."""
        from_t = self._clock.utc_us() - int(before_s * 1e6)
        early = from_t - int(WARM_UP_S * 1e6) - _CLOCK_STEP_US
        firsts = [block.first_t for block in blocks if block.last_t < early]
        return min(firsts, default=from_t)

    def _begin(self, trigger: Trigger, from_t: int) -> Begin:
        robots, vendor_dirs = self._robots()
        about = {"trigger": trigger.kind, "robot": trigger.robot, "t": str(trigger.t)}
        return Begin(robots=robots, vendor_dirs=vendor_dirs, from_t=from_t, reason=about, gateway=__version__)


def _prepare(directory: Path, trigger: Trigger | None) -> tuple[Path, list[Path]]:
    """Make the folder and remove what interrupted recordings have left; a free name, and what was removed."""
    directory.mkdir(mode=0o750, parents=True, exist_ok=True)
    if not os.access(directory, os.W_OK | os.X_OK):
        raise PermissionError(errno.EACCES, "may not be written to by the gateway's user, or is read-only")
    swept = retention.sweep(directory)
    number = 1
    while trigger is not None:
        path = directory / name_of(trigger, number)
        if not path.exists() and not path.with_name(path.name + PART).exists():
            return path, swept
        number += 1
    return directory, swept


def _text(path: Path | None) -> str | None:
    return None if path is None else str(path)
