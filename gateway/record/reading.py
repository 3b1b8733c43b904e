"""Reads recordings: what they hold in the order of time, also of a file that was cut off or damaged."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO

from mcap.exceptions import McapError
from mcap.reader import SeekingReader
from mcap.records import Attachment, Channel, Message, Metadata
from mcap.stream_reader import StreamReader
from zstandard import ZstdError

from gateway.errors import GatewayError
from gateway.record.mcapfile import LAYOUT, METADATA, PART, ROBOTS

# What a damaged file makes the library raise; whatever it is, what came before it is good.
_DAMAGE = (McapError, ZstdError, ValueError, KeyError, IndexError, EOFError, OverflowError, MemoryError, AssertionError)
_LARGEST_RECORD = 256 * 1024 * 1024


class RecordingError(GatewayError):
    """A file is no recording that can be read.

    Attributes:
        path: The file.
        reason: What is wrong with it, and what to do.
    """

    def __init__(self, path: Path, reason: str) -> None:
        super().__init__(f"{path}: {reason}")
        self.path = path
        self.reason = reason


@dataclass(frozen=True, slots=True)
class Entry:
    """One message of a recording.

    Attributes:
        t: µs UTC.
        topic: `<robot>/<group>`, `<robot>/session`, `<robot>/raw/received` or `<robot>/raw/sent`.
        index: Of raw bytes and session marks the number in the robot's order; else that of the sample or event.
        data: The bytes, or JSON.
    """

    t: int
    topic: str
    index: int
    data: bytes


@dataclass(slots=True)
class Recording:
    """What a file holds.

    Attributes:
        path: The file.
        about: What it says of itself: layout, gateway, trigger, robot, t, from, to.
        robots: The robots as they were configured, TOML; "": it does not say.
        topics: How many messages each topic has.
        first_t: Of the first message, µs UTC.
        last_t: Of the last message, µs UTC.
        problem: What is wrong with it; "": nothing.
    """

    path: Path
    about: dict[str, str] = field(default_factory=dict)
    robots: str = ""
    topics: dict[str, int] = field(default_factory=dict)
    first_t: int = 0
    last_t: int = 0
    problem: str = ""
    _whole: bool = True

    @property
    def from_t(self) -> int:
        """Samples are recorded from then on, µs UTC."""
        return int(self.about.get("from", 0))

    @property
    def names(self) -> list[str]:
        """The robots that it holds bytes of."""
        return sorted({topic.split("/")[0] for topic in self.topics if "/raw/" in topic})

    def entries(self, topics: Iterable[str] | None = None, from_t: int = 0, to_t: int | None = None) -> Iterator[Entry]:
        """What it holds, in the order of time.

        Args:
            topics: Only these; None: all.
            from_t: From then on, µs UTC.
            to_t: Until then, µs UTC; None: to the end.
        """
        wanted = None if topics is None else set(topics)
        if not self._whole:
            salvaged = [entry for entry in _salvaged(self.path)[0] if wanted is None or entry.topic in wanted]
            yield from (
                entry
                for entry in sorted(salvaged, key=lambda entry: entry.t)
                if from_t <= entry.t and (to_t is None or entry.t <= to_t)
            )
            return
        end = None if to_t is None else to_t * 1000 + 1
        with self.path.open("rb") as file:
            reader = SeekingReader(file, validate_crcs=True, record_size_limit=_LARGEST_RECORD)
            for _, channel, message in reader.iter_messages(wanted, starting_at=from_t * 1000, ending_before=end):
                yield _entry(channel, message)


def open_recording(path: Path) -> Recording:
    """Look into a recording; one that was cut off or damaged is read as far as it goes.

    Raises:
        RecordingError: It is none, or nothing of it can be read.
    """
    try:
        with path.open("rb") as file:
            found = _whole(path, file)
    except FileNotFoundError:
        raise RecordingError(path, "does not exist") from None
    except OSError as error:
        raise RecordingError(path, f"cannot be read: {error.strerror}") from None
    if found is None:
        found = _part(path)
    layout = found.about.get("layout", LAYOUT)
    if layout != LAYOUT:
        raise RecordingError(
            path, f"has layout {layout}, and this gateway reads layout {LAYOUT}: use the version that made it"
        )
    return found


def _whole(path: Path, file: IO[bytes]) -> Recording | None:
    """What a file with a sound index holds; None: it has none."""
    found = Recording(path)
    try:
        reader = SeekingReader(file, validate_crcs=True, record_size_limit=_LARGEST_RECORD)
        summary = reader.get_summary()
        if summary is None or summary.statistics is None:
            return None
        statistics = summary.statistics
        counts = statistics.channel_message_counts
        found.topics = {channel.topic: counts.get(number, 0) for number, channel in summary.channels.items()}
        found.first_t, found.last_t = statistics.message_start_time // 1000, statistics.message_end_time // 1000
        _read_about(found, reader.iter_metadata(), reader.iter_attachments())
    except _DAMAGE:
        return None
    return found


def _part(path: Path) -> Recording:
    """What can be read of a file without an index."""
    entries, about, robots, problem = _salvaged(path)
    if not entries and not about:
        hint = "; it was still being written" if path.name.endswith(PART) else ""
        raise RecordingError(path, f"is no recording: {problem or 'it is empty'}{hint}")
    found = Recording(path, about=about, robots=robots, problem=problem, _whole=False)
    for entry in entries:
        found.topics[entry.topic] = found.topics.get(entry.topic, 0) + 1
    found.first_t = min((entry.t for entry in entries), default=0)
    found.last_t = max((entry.t for entry in entries), default=0)
    return found


def _salvaged(path: Path) -> tuple[list[Entry], dict[str, str], str, str]:
    """Read a file from its beginning as far as it is good: messages, what it says of itself, robots, what is wrong."""
    entries: list[Entry] = []
    channels: dict[int, Channel] = {}
    found = Recording(path)
    problem = ""
    with path.open("rb") as file:
        try:
            for record in StreamReader(file, validate_crcs=True, record_size_limit=_LARGEST_RECORD).records:
                if isinstance(record, Channel):
                    channels[record.id] = record
                elif isinstance(record, Message):
                    entries.append(_entry(channels[record.channel_id], record))
                elif isinstance(record, Metadata):
                    _read_about(found, [record], [])
                elif isinstance(record, Attachment):
                    _read_about(found, [], [record])
        except _DAMAGE as error:
            words = str(error) or type(error).__name__
            problem = f"it is cut off or damaged after {file.tell()} bytes ({words}); what comes before is read"
    return entries, found.about, found.robots, problem


def _read_about(found: Recording, metadata: Iterable[Metadata], attachments: Iterable[Attachment]) -> None:
    for one in metadata:
        if one.name == METADATA:
            found.about.update(one.metadata)
    for attachment in attachments:
        if attachment.name == ROBOTS:
            found.robots = attachment.data.decode("utf-8", "replace")


def _entry(channel: Channel, message: Message) -> Entry:
    return Entry(message.log_time // 1000, channel.topic, message.sequence, message.data)
