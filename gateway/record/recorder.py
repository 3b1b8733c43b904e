"""The flight recorder of a running gateway: a ring for each robot, and a file of the whole cell when something happens.

It decodes nothing. What it keeps goes to a process of its own that writes the file: the loop is never held up, and a
full disk costs the recording.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path

import anyio
import anyio.to_thread
import msgspec
import structlog

from gateway import __version__
from gateway.api.model import Event
from gateway.core.bus import Bus, Reading, Topic
from gateway.core.clock import Clock
from gateway.record import retention
from gateway.record.chunks import Block
from gateway.record.filing import Filing
from gateway.record.ring import Ring
from gateway.record.settings import RecorderSettings
from gateway.record.spool import Begin, End, Message, Outcome, Raw, Said

_LOG = structlog.get_logger()
# Topics that do not follow from bytes: they are kept as they are told.
TOLD_GROUPS = ("link", "link_stats", "events", "commands")
_EVENTS = ("/events", "/commands")
# Read so much earlier than asked for: what frames tell in parts is complete then.
WARM_UP_S = 5.0
# A recording that is triggered again and again ends after so long; the next trigger begins another.
LONGEST_S = 600.0
_MOST_TOLD = 50_000
_LOOK_S = 1.0
_CLOCK_STEP_US = 2_000_000
_JSON = msgspec.json.Encoder()


@dataclass(frozen=True, slots=True)
class Trigger:
    """Why a recording is made.

    Args:
        kind: Kind of the event, or `snapshot`.
        robot: The robot that it happened to; "" for a snapshot of the cell.
        t: When, µs UTC.
    """

    kind: str
    robot: str
    t: int


@dataclass(slots=True)
class RecorderState:
    """What the operator may know of the recorder.

    Attributes:
        recording: The file that is being written, or None.
        n_recordings: How many were written since the start.
        n_failed: How many could not be written.
        last: The last file that was written, or None.
        error: Why the last one could not be written; None: it could.
    """

    recording: str | None = None
    n_recordings: int = 0
    n_failed: int = 0
    last: str | None = None
    error: str | None = None


@dataclass(slots=True)
class _Open:
    """A recording under way: who made it begin, and what is still to be handed over."""

    triggers: list[Trigger]
    end_s: float
    waiting: deque[Message] = field(default_factory=deque)
    more: anyio.Event = field(default_factory=anyio.Event)

    def put(self, message: Message) -> None:
        self.waiting.append(message)
        self.more.set()


class Recorder:
    """Keeps what the robots of a cell said lately, and writes it down.

    Args:
        settings: How much is kept, and when it is written.
        bus: Where the robots are published.
        clock: Both times.
        robots: Gives the robots as understood, TOML, and the folders of further plugins.

    Attributes:
        state: What the operator may know.
    """

    def __init__(
        self,
        settings: RecorderSettings,
        bus: Bus,
        clock: Clock,
        robots: Callable[[], tuple[str, list[str]]],
    ) -> None:
        self._settings = settings
        self._bus = bus
        self._clock = clock
        self._robots = robots
        self._rings: dict[str, Ring] = {}
        self._told: deque[tuple[float, Said]] = deque(maxlen=_MOST_TOLD)
        self._standing: dict[str, Said] = {}  # by topic: what was told last before that
        self._heard: set[Topic] = set()
        self._pending: list[Trigger] = []
        self._wanted = anyio.Event()
        self._open: _Open | None = None
        self.state = RecorderState()

    def tap(self, robot: str) -> Ring:
        """A new ring for a robot, in the place of the one that it had."""
        self.forget(robot)
        ring = self._rings[robot] = Ring(robot, self._settings.ring_s, self._settings.ring_bytes)
        if self._open is not None:
            ring.readers.append(self)
        return ring

    def forget(self, robot: str) -> None:
        """A robot is no longer there."""
        ring = self._rings.pop(robot, None)
        if ring is not None:
            ring.close_block()
            ring.readers.clear()

    @property
    def rings(self) -> dict[str, Ring]:
        """The rings of the robots, by name."""
        return self._rings

    def snapshot(self) -> str | None:
        """Ask for a recording of now; why there will be none, or None."""
        if self._settings.directory is None:
            return "no folder for recordings is configured: set recorder.directory"
        self.trigger(Trigger("snapshot", "", self._clock.utc_us()))
        return None

    def trigger(self, trigger: Trigger) -> None:
        """Something has happened that is worth a recording; one that is under way is made longer."""
        if self._settings.directory is None:
            return
        if self._open is not None and self._clock.monotonic() < self._open.end_s:
            self._open.triggers.append(trigger)
            self._open.end_s = self._clock.monotonic() + self._settings.after_s
        else:
            self._pending.append(trigger)
            self._wanted.set()

    def capture(self, robot: str, seconds: float) -> Iterator[Message]:
        """What a robot said in the last seconds, for one who writes it elsewhere.

        Raises:
            KeyError: There is none of this name.
        """
        since_s = self._clock.monotonic() - seconds
        blocks = self._rings[robot].blocks(since_s - WARM_UP_S)
        now = self._clock.utc_us()
        yield self._begin([Trigger("capture", robot, now)], seconds, blocks)
        yield from (Raw(robot=robot, block=block) for block in blocks)
        yield from (said for said in self._told_since(since_s) if said.topic.startswith(f"{robot}/"))
        yield End(to_t=now)

    async def run(self) -> None:
        """Write recordings until cancelled."""
        directory = self._settings.directory
        async with anyio.create_task_group() as tasks:
            tasks.start_soon(self._listen)
            if directory is None:
                return
            await self._prepare(directory)
            while True:
                await self._wanted.wait()
                self._wanted = anyio.Event()
                triggers, self._pending = self._pending, []
                await self._record(directory, triggers)

    def on_reading(self, topic: Topic, reading: Reading) -> None:
        """Keep what a topic that follows from no bytes says."""
        sample = reading.sample(topic)
        self._tell(Said(topic=topic.name, t=sample.t, seq=sample.seq, data=_JSON.encode(sample)))

    def on_event(self, topic: Topic, event: Event) -> None:
        """Keep an event; some trigger a recording."""
        self._tell(Said(topic=topic.name, t=event.t, seq=event.seq, data=_JSON.encode(event)))
        if event.kind.value in self._settings.on:
            self.trigger(Trigger(event.kind.value, event.robot, event.t))

    def on_block(self, robot: str, block: Block) -> None:
        """Hand a block on to the recording that is under way."""
        if self._open is not None:
            self._open.put(Raw(robot=robot, block=block))

    def _tell(self, said: Said) -> None:
        now_s = self._clock.monotonic()
        self._told.append((now_s, said))
        while now_s - self._told[0][0] > self._settings.ring_s:
            _, old = self._told.popleft()
            self._standing[old.topic] = old
        if self._open is not None:
            self._open.put(said)

    def _told_since(self, since_s: float) -> list[Said]:
        """What was told since a monotonic time, s, behind the states that stood then."""
        standing = {name: said for name, said in self._standing.items() if not name.endswith(_EVENTS)}
        found = []
        for at_s, said in self._told:
            if at_s >= since_s:
                found.append(said)
            elif not said.topic.endswith(_EVENTS):
                standing[said.topic] = said
        return [*standing.values(), *found]

    async def _listen(self) -> None:
        """Listen to every robot, also to those that come later."""
        while True:
            topics = {topic for topic in self._bus.topics.values() if topic.group.name in TOLD_GROUPS}
            for topic in topics - self._heard:
                topic.listeners.append(self)
            self._heard = topics
            await anyio.sleep(_LOOK_S)

    async def _prepare(self, directory: Path) -> None:
        """Make the folder, and remove what an interrupted recording has left."""
        try:
            await anyio.to_thread.run_sync(lambda: directory.mkdir(mode=0o750, parents=True, exist_ok=True))
            for path in await anyio.to_thread.run_sync(retention.sweep, directory):
                _LOG.warning("recording.abandoned", reason=f"{path} was not finished: removed")
        except OSError as error:
            self.state.error = f"{directory}: {error.strerror}"
            _LOG.error("recording.failed", reason=self.state.error)

    async def _record(self, directory: Path, triggers: list[Trigger]) -> None:
        """Write one recording, from before its trigger until after it."""
        settings, now_s = self._settings, self._clock.monotonic()
        opened = self._open = _Open(triggers, now_s + settings.after_s)
        path = _free_name(directory, triggers[0])
        self.state.recording = str(path)
        since_s = now_s - settings.before_s
        for ring in self._rings.values():
            for block in ring.blocks(since_s - WARM_UP_S):
                opened.put(Raw(robot=ring.robot, block=block))
            ring.readers.append(self)
        for said in self._told_since(since_s):
            opened.put(said)
        blocks = [message.block for message in opened.waiting if isinstance(message, Raw)]
        opened.waiting.appendleft(self._begin(triggers, settings.before_s, blocks))
        try:
            async with Filing.opened(path) as filing:
                await self._hand_over(opened, filing, now_s + LONGEST_S)
                self._stop(opened)
                opened.put(End(to_t=self._clock.utc_us(), more=_again(opened.triggers)))
                await self._drain(opened, filing)
                outcome = await filing.finished()
        except OSError as failure:
            outcome = Outcome(error=f"the process that writes it did not start: {failure}")
        finally:
            self._stop(opened)
            self._open = None
            self.state.recording = None
        await self._conclude(directory, path, triggers, outcome)

    async def _hand_over(self, opened: _Open, filing: Filing, last_s: float) -> None:
        """Hand everything over until the recording has its length, or its writer is gone."""
        while (left_s := min(opened.end_s, last_s) - self._clock.monotonic()) > 0 and not filing.broken:
            with anyio.move_on_after(left_s):
                await opened.more.wait()
            await self._drain(opened, filing)

    async def _drain(self, opened: _Open, filing: Filing) -> None:
        opened.more = anyio.Event()
        while opened.waiting and not filing.broken:
            await filing.send(opened.waiting.popleft())

    def _stop(self, opened: _Open) -> None:
        """What comes from now on belongs to this recording no more."""
        for ring in self._rings.values():
            if self in ring.readers:
                ring.close_block()
                ring.readers.remove(self)
        opened.end_s = 0.0

    async def _conclude(self, directory: Path, path: Path, triggers: list[Trigger], outcome: Outcome) -> None:
        self.state.error = outcome.error or None
        if outcome.error:
            self.state.n_failed += 1
            _LOG.error("recording.failed", reason=outcome.error)
            return
        for note in outcome.notes:
            _LOG.warning("recording.noted", reason=note)
        self.state.n_recordings += 1
        self.state.last = str(path)
        _LOG.info("recording.written", reason=_words(triggers), n_bytes=outcome.n_bytes, path=str(path))
        try:
            gone = await anyio.to_thread.run_sync(retention.tidy, directory, self._settings, self._clock.utc_us() / 1e6)
        except OSError as failure:
            _LOG.warning("recordings.not_removed", reason=f"{directory}: {failure.strerror}")
        else:
            for old in gone:
                _LOG.info("recording.removed", path=str(old))

    def _begin(self, triggers: list[Trigger], before_s: float, blocks: list[Block]) -> Begin:
        """The first message; after a jump of the clock nothing is left out by its time."""
        robots, vendor_dirs = self._robots()
        from_t = self._clock.utc_us() - int(before_s * 1e6)
        early = from_t - int(WARM_UP_S * 1e6) - _CLOCK_STEP_US
        if any(block.last_t < early for block in blocks):
            from_t = 0
        about = {"trigger": triggers[0].kind, "robot": triggers[0].robot, "t": str(triggers[0].t)}
        return Begin(robots=robots, vendor_dirs=vendor_dirs, from_t=from_t, reason=about, gateway=__version__)


def _again(triggers: list[Trigger]) -> dict[str, str]:
    """What happened while a recording was made."""
    return {"again": _words(triggers[1:])} if len(triggers) > 1 else {}


def _words(triggers: list[Trigger]) -> str:
    return ", ".join(dict.fromkeys(f"{trigger.kind} {trigger.robot}".strip() for trigger in triggers))


def _free_name(directory: Path, trigger: Trigger) -> Path:
    """A name that no recording has: time, robot and reason."""
    time = datetime.fromtimestamp(trigger.t / 1e6, UTC).strftime("%Y-%m-%dT%H-%M-%SZ")
    robot = trigger.robot or "cell"
    number = 1
    while True:
        again = f"-{number}" if number > 1 else ""
        path = directory / f"{time}{again}_{robot}_{trigger.kind}.mcap"
        if not path.exists() and not path.with_name(f"{path.name}.part").exists():
            return path
        number += 1
