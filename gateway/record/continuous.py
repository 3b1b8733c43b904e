"""Continuous recording: one file after the other, each of which can be replayed alone, and nothing twice or not at all.

When a file is full, the next one begins at a moment: what was received before it belongs to the old file, the rest to
the new one, which also has the bytes of some seconds before, so that a replay can begin there.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from datetime import UTC, datetime
from fnmatch import fnmatchcase
from pathlib import Path

from gateway.record.chunks import before
from gateway.record.making import Making
from gateway.record.mcapfile import Writer
from gateway.record.recorder import WARM_UP_S
from gateway.record.settings import PART
from gateway.record.spool import Begin, End, Lost, Message, Raw, Said

# Blocks of what was received before a moment come so much later at most, in s: closed after a second or two, then
# gathered and compressed (`packing.GATHER_S`).
OVERLAP_S = 3.0
_EVENTS = ("/events", "/commands")


@dataclass(frozen=True, slots=True)
class Limits:
    """When a file is full.

    Args:
        seconds: After so long, in s; None: never.
        n_bytes: When it is so large; None: never.
    """

    seconds: float | None = None
    n_bytes: int | None = None


@dataclass(slots=True)
class Tally:
    """What has come of it so far.

    Attributes:
        n_bytes: Size of the finished files.
        n_files: How many there are.
        lost: Messages that the gateway could not hand over.
        notes: What could not be recorded, one sentence each.
        last: The last file that was finished.
    """

    n_bytes: int = 0
    n_files: int = 0
    lost: int = 0
    notes: list[str] = field(default_factory=list)
    last: Path | None = None


class _ChosenWriter(Writer):
    """Writes only some topics besides the raw bytes.

    Args:
        path: The file.
        globs: Of the topics.
    """

    def __init__(self, path: Path, globs: tuple[str, ...]) -> None:
        super().__init__(path)
        self._globs = globs
        self._chosen: dict[str, bool] = {}

    def said(self, topic: str, t: int, seq: int, data: bytes) -> None:
        """Write a sample or an event, if it is wanted."""
        chosen = self._chosen.get(topic)
        if chosen is None:
            chosen = self._chosen[topic] = any(fnmatchcase(topic, glob) for glob in self._globs)
        if chosen:
            super().said(topic, t, seq, data)


class _File:
    """One file that is being written."""

    def __init__(self, path: Path, globs: tuple[str, ...], begin: Begin, *, samples: bool, began_s: float) -> None:
        self.writer = Writer(path) if "*" in globs else _ChosenWriter(path, globs)
        self.began_s = began_s
        self.lost = 0
        self.from_t = begin.from_t
        self._making = Making(self.writer, samples=samples)
        try:
            self.take(begin)
        except OSError:
            self.writer.abandon()
            raise

    @property
    def notes(self) -> list[str]:
        return self._making.notes

    def take(self, message: Message) -> None:
        self._making.take(message)

    def finish(self, to_t: int) -> None:
        self.take(End(to_t=to_t, more={"dropped": str(self.lost)}))


class Continuous:
    """Writes what a gateway streams into one file after the other.

    Args:
        folder: Where.
        globs: Of the topics that are written; raw bytes are, in any case.
        limits: When a file is full.
        samples: Whether the samples that follow from the bytes are written.
        now_s: The monotonic clock, s.
        utc_us: The wall clock, µs.

    Attributes:
        tally: What has come of it so far.
        newest_t: Time of the newest message, µs UTC.
    """

    def __init__(
        self,
        folder: Path,
        globs: tuple[str, ...],
        limits: Limits,
        *,
        samples: bool,
        now_s: Callable[[], float],
        utc_us: Callable[[], int],
    ) -> None:
        self._folder = folder
        self._globs = globs
        self._limits = limits
        self._samples = samples
        self._now_s = now_s
        self._utc_us = utc_us
        self._begin: Begin | None = None
        self._file: _File | None = None
        self._old: _File | None = None
        self._recent: dict[str, deque[Raw]] = {}
        self._standing: dict[str, Said] = {}
        self.tally = Tally()
        self.newest_t = 0

    @property
    def path(self) -> Path | None:
        """The file that is being written; None: none is."""
        return None if self._file is None else self._file.writer.path

    @property
    def n_bytes(self) -> int:
        """What is on the disk."""
        return self.tally.n_bytes + sum(one.writer.n_bytes for one in (self._old, self._file) if one is not None)

    def take(self, message: Message) -> None:
        """Write the next message of the stream.

        Raises:
            OSError: The disk does not take it; what was written of the file stays (`leave`).
        """
        if isinstance(message, Begin):  # a gateway, or the same one with other robots
            self.finish()
            self._begin = message
            self._file = self._opened(message)
        elif isinstance(message, Lost):
            self.tally.lost += message.n_messages
            if self._file is not None:
                self._file.lost += message.n_messages
        elif isinstance(message, Raw):
            self._take_raw(message)
        elif isinstance(message, Said):
            self._take_said(message)

    def look(self) -> None:
        """Begin the next file if this one is full, and finish the old one if nothing more can belong to it.

        Raises:
            OSError: The disk does not take it; what was written of the file stays (`leave`).
        """
        if self._old is not None and self._file is not None and self._now_s() - self._file.began_s >= OVERLAP_S:
            self._finish_old(self._file.from_t)
        if self._old is None and self._file is not None and self._is_full(self._file):
            self._rotate(self._file)

    def finish(self) -> None:
        """Finish what is being written: nothing more comes.

        Raises:
            OSError: The disk does not take it; what was written of the file stays (`leave`).
        """
        now = self._utc_us()
        self._finish_old(now)
        self._old, self._file = self._file, None
        self._finish_old(now)
        self._recent.clear()
        self._standing.clear()

    def leave(self) -> list[Path]:
        """Leave what is not finished as it is; which files that are."""
        left = [one.writer for one in (self._old, self._file) if one is not None]
        for writer in left:
            writer.leave()
        self._old = self._file = None
        return [writer.part for writer in left if writer.part.exists()]

    def _take_raw(self, message: Raw) -> None:
        self.newest_t = message.block.last_t
        recent = self._recent.setdefault(message.robot, deque())
        recent.append(message)
        while len(recent) > 1 and abs(message.block.last_t - recent[0].block.last_t) > WARM_UP_S * 1e6:
            recent.popleft()
        if self._file is None:
            return
        if self._old is not None:
            early = before(message.block, self._file.from_t)
            if early is not None:
                self._old.take(Raw(robot=message.robot, block=early))
        self._file.take(message)

    def _take_said(self, message: Said) -> None:
        self.newest_t = message.t
        if not message.topic.endswith(_EVENTS):
            self._standing[message.topic] = message
        if self._file is None:
            return
        late = self._old is None or message.t >= self._file.from_t
        (self._file if late or self._old is None else self._old).take(message)

    def _is_full(self, file: _File) -> bool:
        limits = self._limits
        if limits.n_bytes is not None and file.writer.n_bytes >= limits.n_bytes:
            return True
        return limits.seconds is not None and self._now_s() - file.began_s >= limits.seconds

    def _rotate(self, file: _File) -> None:
        if self._begin is None:
            return
        begin = Begin(
            robots=self._begin.robots,
            vendor_dirs=self._begin.vendor_dirs,
            from_t=self._utc_us(),
            reason=self._begin.reason,
            gateway=self._begin.gateway,
        )
        new = self._opened(begin)
        self._old, self._file = file, new
        for recent in self._recent.values():
            for message in recent:
                new.take(message)
        for said in self._standing.values():
            new.take(said)

    def _finish_old(self, to_t: int) -> None:
        old = self._old
        if old is None:
            return
        old.finish(to_t)
        self._old = None
        self.tally.n_bytes += old.writer.path.stat().st_size
        self.tally.n_files += 1
        self.tally.last = old.writer.path
        self.tally.notes += [note for note in old.notes if note not in self.tally.notes]

    def _opened(self, begin: Begin) -> _File:
        path = next(path for path in _names(self._folder, self._utc_us()) if _is_free(path))
        return _File(path, self._globs, begin, samples=self._samples, began_s=self._now_s())


def _names(folder: Path, t: int) -> Iterator[Path]:
    """Names of a file that begins at a time, µs UTC; none of them is one that the flight recorder's retention takes."""
    time = datetime.fromtimestamp(t / 1e6, UTC).strftime("%Y-%m-%dT%H-%M-%SZ")
    yield folder / f"record_{time}.mcap"
    number = 2
    while True:
        yield folder / f"record_{time}_{number}.mcap"
        number += 1


def _is_free(path: Path) -> bool:
    return not path.exists() and not path.with_name(path.name + PART).exists()
