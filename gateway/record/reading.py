"""Reads recordings: what they hold in the order of time, also of a file that was cut off or damaged."""

from __future__ import annotations

import zlib
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import IO

from mcap.opcode import Opcode
from mcap.reader import SeekingReader
from mcap.records import Attachment, Footer, Metadata
from mcap.stream_reader import StreamReader

from gateway.errors import GatewayError
from gateway.record.mcapfile import LAYOUT, METADATA, PROFILE, ROBOTS, SET_BACK
from gateway.record.salvage import DAMAGE, LARGEST_RECORD, MAGIC, Salvaged, salvage

_FOOTER = 1 + 8 + 8 + 8 + 4  # bytes; the last four are the checksum of the summary
_DATA_END = 1 + 8 + 4  # bytes; the last four are the checksum of the data
_DATA_END_HEAD = bytes([Opcode.DATA_END]) + (4).to_bytes(8, "little")
_PIECE = 1 << 20
_LISTED = 6


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

    @property
    def robot(self) -> str:
        """Name of the robot."""
        return self.topic.partition("/")[0]

    @property
    def group(self) -> str:
        """What stands behind it: a group of the model, `session`, `raw/received` or `raw/sent`."""
        return self.topic.partition("/")[2]


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
    salvaged: Salvaged | None = None

    @property
    def from_t(self) -> int:
        """Samples are recorded from then on, µs UTC."""
        told = self.about.get("from", "")
        return int(told) if told.isascii() and told.isdigit() else 0

    @property
    def begins_t(self) -> int:
        """When it begins, µs UTC; what stood before, and what a session began with, may be older."""
        return max(self.from_t, self.first_t)

    @property
    def names(self) -> list[str]:
        """The robots that it holds bytes of."""
        return sorted({topic.split("/")[0] for topic in self.topics if "/raw/" in topic})

    def entries(self, topics: Iterable[str] | None = None) -> Iterator[Entry]:
        """What it holds, in the order of time; where the clock was set back, in the order in which it came.

        Args:
            topics: Only these; None: all.
        """
        wanted = None if topics is None else set(topics)
        if self.salvaged is not None:
            found = (
                Entry(t, topic, index, data)
                for t, topic, index, data in self.salvaged.messages
                if wanted is None or topic in wanted
            )
            yield from _as_it_came(found) if SET_BACK in self.about else sorted(found, key=lambda entry: entry.t)
        elif SET_BACK in self.about:
            yield from _as_it_came(self._read(wanted, in_order=False))
        else:
            yield from self._read(wanted, in_order=True)

    def _read(self, wanted: set[str] | None, *, in_order: bool) -> Iterator[Entry]:
        with self.path.open("rb") as file:
            reader = SeekingReader(file, record_size_limit=LARGEST_RECORD)
            for _, channel, message in reader.iter_messages(wanted, log_time_order=in_order):
                yield Entry(message.log_time // 1000, channel.topic, message.sequence, message.data)


def open_recording(path: Path) -> Recording:
    """Look into a recording; one that was cut off or damaged is read as far as it goes.

    Raises:
        RecordingError: It is none, or nothing of it can be read.
    """
    try:
        with path.open("rb") as file:
            found = _look_into(path, file)
    except FileNotFoundError:
        raise RecordingError(path, "does not exist") from None
    except IsADirectoryError:
        raise RecordingError(path, "is a folder; name the file in it") from None
    except PermissionError:
        raise RecordingError(path, f"may not be read by this user; look at: ls -l {path}") from None
    except OSError as error:
        raise RecordingError(path, f"cannot be read: {error.strerror}") from None
    layout = found.about.get("layout", LAYOUT)
    if layout != LAYOUT:
        raise RecordingError(
            path,
            f"has layout {layout!r}, and this gateway reads layout {LAYOUT!r}: use the version that made it, "
            f"{found.about.get('gateway', 'which it does not tell')}",
        )
    if not found.names and not found.about:
        raise RecordingError(path, _foreign(found))
    return found


def _look_into(path: Path, file: IO[bytes]) -> Recording:
    head = file.read(len(MAGIC))
    if not head:
        raise RecordingError(path, "is empty, it has 0 bytes")
    if head != MAGIC:
        raise RecordingError(path, "is no MCAP file, or its first bytes are damaged")
    found = _whole(path, file)
    if found is None:
        found = _part(path, file)
    return found


def _whole(path: Path, file: IO[bytes]) -> Recording | None:
    """What a file whose checksums hold holds; None: they do not, or it has no index."""
    try:
        if not _is_sound(file):
            return None
        file.seek(0)
        reader = SeekingReader(file, record_size_limit=LARGEST_RECORD)
        summary = reader.get_summary()
        if summary is None or summary.statistics is None:
            return None
        statistics = summary.statistics
        counts: Counter[str] = Counter()
        for number, channel in summary.channels.items():
            counts[channel.topic] += statistics.channel_message_counts.get(number, 0)
        found = Recording(path, topics=dict(counts))
        found.first_t, found.last_t = statistics.message_start_time // 1000, statistics.message_end_time // 1000
        _read_about(found, reader.iter_metadata(), reader.iter_attachments())
    except DAMAGE:
        return None
    return found


def _is_sound(file: IO[bytes]) -> bool:
    """Whether the checksums of the data and of the summary hold."""
    end = file.seek(0, 2) - len(MAGIC)
    if end < len(MAGIC) + _DATA_END + _FOOTER:
        return False
    file.seek(end - _FOOTER)
    tail = file.read()
    file.seek(end - _FOOTER)
    footer = next(StreamReader(file, skip_magic=True).records)
    if not isinstance(footer, Footer) or tail[_FOOTER:] != MAGIC:
        return False
    summary_at = footer.summary_start
    if not len(MAGIC) + _DATA_END <= summary_at < end:
        return False
    file.seek(0)
    checksum, left = 0, summary_at - _DATA_END
    while left and (piece := file.read(min(left, _PIECE))):
        checksum, left = zlib.crc32(piece, checksum), left - len(piece)
    data_end = file.read(_DATA_END)
    summary = file.read(end - summary_at - 4)
    told = int.from_bytes(data_end[-4:], "little")
    whole = not left and data_end.startswith(_DATA_END_HEAD)
    return whole and told == checksum and zlib.crc32(summary) == footer.summary_crc


def _part(path: Path, file: IO[bytes]) -> Recording:
    """What can be read of a file that is not as it was written."""
    salvaged = salvage(file)
    found = Recording(path, salvaged=salvaged, problem=salvaged.problem)
    _read_about(found, salvaged.metadata, salvaged.attachments)
    if not salvaged.messages and not found.about:
        raise RecordingError(path, f"holds nothing that can be read: {salvaged.problem or 'no message is in it'}")
    found.topics = dict(Counter(topic for _, topic, _, _ in salvaged.messages))
    found.first_t = min((message[0] for message in salvaged.messages), default=0)
    found.last_t = max((message[0] for message in salvaged.messages), default=0)
    return found


def _as_it_came(entries: Iterable[Entry]) -> Iterator[Entry]:
    """All entries where time went back: each robot's bytes in their order, the rest beside them by its time."""
    latest: dict[str, int] = {}
    placed: list[tuple[int, Entry]] = []
    for entry in entries:
        stream = entry.robot if entry.group.startswith(("raw/", "session")) else entry.topic
        latest[stream] = max(latest.get(stream, 0), entry.t)
        placed.append((latest[stream], entry))
    return (entry for _, entry in sorted(placed, key=lambda one: one[0]))


def _foreign(found: Recording) -> str:
    topics = sorted(found.topics)
    more = f" and {len(topics) - _LISTED} more" if len(topics) > _LISTED else ""
    has = f"its topics are {', '.join(topics[:_LISTED])}{more}" if topics else "it has no topics"
    return f"is an MCAP file, but no recording of {PROFILE}: it has no topic ROBOT/raw/received; {has}"


def _read_about(found: Recording, metadata: Iterable[Metadata], attachments: Iterable[Attachment]) -> None:
    for one in metadata:
        if one.name == METADATA:
            found.about.update(one.metadata)
    for attachment in attachments:
        if attachment.name == ROBOTS:
            found.robots = attachment.data.decode("utf-8", "replace")


def said_of(recording: Recording) -> str:
    """What a recording is, in one line for people."""
    about = recording.about
    why = " ".join(filter(None, (about.get("trigger"), about.get("robot"))))
    begins = datetime.fromtimestamp(recording.begins_t / 1e6, UTC).astimezone()
    seconds = max(0.0, (recording.last_t - recording.begins_t) / 1e6)
    parts = [f"{begins:%Y-%m-%d %H:%M:%S}, {seconds:.1f} s"]
    parts += [f"{why}"] if why else []
    parts += [f"gateway {about['gateway']}"] if "gateway" in about else []
    return "; ".join(parts)
