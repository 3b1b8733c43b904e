"""One recording under way: what triggered it, what waits for its writer, and when it is over."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from contextlib import AbstractAsyncContextManager
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path

import anyio

from gateway.core.clock import Clock
from gateway.record.filing import Filing
from gateway.record.spool import Begin, End, Message, Outcome, Raw

# A recording that is triggered again and again ends after so long; the next trigger begins another.
LONGEST_S = 600.0
# A writer behind which so much waits is too slow, in bytes.
MOST_WAITING = 64_000_000
# When the gateway ends, a recording has so long to be finished with what there is.
LAST_S = 5.0
Opened = Callable[[Path], AbstractAsyncContextManager[Filing]]
_MOST_TRIGGERS = 1000
_NAMED = 20  # so many triggers are named in the file


@dataclass(slots=True)
class Asked:
    """Somebody waits for a recording.

    Attributes:
        done: Set when it is known what has become of it.
        path: The file; None: there is none.
        error: Why there is none.
    """

    done: anyio.Event = field(default_factory=anyio.Event)
    path: Path | None = None
    error: str = ""


@dataclass(frozen=True, slots=True)
class Trigger:
    """Why a recording is made.

    Args:
        kind: Kind of the event, or `snapshot`.
        robot: The robot that it happened to; "" for a snapshot of the cell.
        t: When, µs UTC.
        at_s: When, monotonic, in s.
        asked: Who waits for the recording, if somebody does.
    """

    kind: str
    robot: str
    t: int
    at_s: float
    asked: Asked | None = None

    @property
    def words(self) -> str:
        """It in words."""
        return f"{self.kind} {self.robot}".strip()


class Dump:
    """Hands one recording over to its writer.

    Args:
        triggers: What made it begin, at least one.
        after_s: How long it goes on after a trigger, in s.
        clock: Both times.
        opened: Starts a writer.

    Attributes:
        triggers: All of them so far.
    """

    def __init__(self, triggers: list[Trigger], after_s: float, clock: Clock, opened: Opened = Filing.opened) -> None:
        self.triggers = triggers
        self._opened = opened
        self._after_s = after_s
        self._clock = clock
        self._last_s = triggers[0].at_s + LONGEST_S
        self._end_s = triggers[-1].at_s + after_s
        self._waiting: deque[Message] = deque()
        self._late_bytes = 0
        self._left: set[str] = set()
        self._more = anyio.Event()
        self._is_open = True

    @property
    def is_open(self) -> bool:
        """Whether another trigger still makes it longer."""
        return self._is_open and self._clock.monotonic() < min(self._end_s, self._last_s)

    def again(self, trigger: Trigger) -> None:
        """Something else has happened."""
        if len(self.triggers) < _MOST_TRIGGERS or trigger.asked is not None:
            self.triggers.append(trigger)
        self._end_s = trigger.at_s + self._after_s
        self._more.set()

    def begin(self, begin: Begin, kept: list[Message]) -> None:
        """What was kept so far; what is put from now on is new."""
        self._waiting.append(begin)
        self._waiting.extend(kept)
        self._more.set()

    def put(self, robot: str, message: Message) -> None:
        """Take what is new of a robot."""
        if robot in self._left or isinstance(message, Begin):
            return
        self._waiting.append(message)
        self._late_bytes += message.block.n_bytes if isinstance(message, Raw) else 0
        self._more.set()

    def leave(self, robot: str) -> None:
        """A robot is another one from now on: its bytes are not those that the recording describes."""
        self._left.add(robot)

    async def write(self, path: Path, closing: Callable[[], None]) -> Outcome:
        """Hand everything over until the recording has its length; what has become of it.

        Args:
            path: The file.
            closing: Called when the time is over: what is still held back is put now, and nothing later.
        """
        try:
            async with self._opened(path) as filing:
                deadline_s = LAST_S
                try:
                    await self._follow(filing)
                    deadline_s = float("inf")
                finally:  # also when the gateway ends: what happened until then is kept
                    self._is_open = False
                    closing()
                    with anyio.move_on_after(deadline_s, shield=True):
                        outcome = await self._finish(filing)
                return outcome
        except OSError as failure:
            return Outcome(error=f"the process that writes it did not start: {failure}")

    async def _follow(self, filing: Filing) -> None:
        while not filing.broken and (left_s := min(self._end_s, self._last_s) - self._clock.monotonic()) > 0:
            with anyio.move_on_after(left_s):
                await self._more.wait()
            await self._drain(filing)

    async def _finish(self, filing: Filing) -> Outcome:
        more = {"again": words_of(self.triggers[1:])} if len(self.triggers) > 1 else {}
        if self._left:
            more["left"] = ", ".join(sorted(self._left))
        self._waiting.append(End(to_t=self._clock.utc_us(), more=more))
        await self._drain(filing)
        if self._late_bytes > MOST_WAITING:
            return Outcome(error=f"the disk is too slow: {MOST_WAITING // 1_000_000} MB waited for it")
        return await filing.finished()

    async def _drain(self, filing: Filing) -> None:
        self._more = anyio.Event()
        while self._waiting and not filing.broken:
            message = self._waiting.popleft()
            await filing.send(message)
            if self._late_bytes > MOST_WAITING:
                filing.kill()
        if not self._waiting:
            self._late_bytes = 0


def name_of(trigger: Trigger, number: int) -> str:
    """Name of a recording: time, robot and reason; the second of the same one has a number."""
    time = datetime.fromtimestamp(trigger.t / 1e6, UTC).strftime("%Y-%m-%dT%H-%M-%SZ")
    again = f"-{number}" if number > 1 else ""
    return f"{time}{again}_{trigger.robot or 'cell'}_{trigger.kind}.mcap"


def words_of(triggers: list[Trigger]) -> str:
    """Some triggers in words."""
    words = list(dict.fromkeys(trigger.words for trigger in triggers))
    more = f" and {len(words) - _NAMED} more" if len(words) > _NAMED else ""
    return ", ".join(words[:_NAMED]) + more
