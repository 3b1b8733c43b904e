"""MCAP files of recordings: which channels they have, and how they are written so that a file is whole or not there."""

from __future__ import annotations

import os
from contextlib import suppress
from functools import lru_cache
from pathlib import Path
from types import TracebackType
from typing import IO, Literal, Self

import msgspec
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter

from gateway.api.model import GROUPS, Fault, Quality
from gateway.api.plain_schemas import event_schema, plain, sample_schema
from gateway.record.settings import PART

LAYOUT = "1"
PROFILE = "robot-gateway"
METADATA = "robot-gateway"
ROBOTS = "gateway.toml"
SET_BACK = "set_back"  # key of the metadata: the clock was set back while it was recorded
OCTETS = "octets"
Way = Literal["received", "sent"]


class Mark(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """One line of a robot's `session` channel: what a replay must know besides the bytes.

    Attributes:
        kind: `begin`, `end`: of a session. `resume`: the recording begins here, in the middle of one; what was
            exchanged until its first good frame stands between `opening` and this, and is only read. `number`: the
            next sample is numbered so. `silent`, `expired`: the gateway said so.
        epoch: The epoch that runs.
        seqs: The number of the last sample; by group, where frames bring the state in parts.
        faults: `resume`: the faults that stand.
        quality: `silent`: what was told.
        t_last: `silent`: the time of the last frame, µs UTC.
    """

    kind: Literal["begin", "opening", "resume", "number", "silent", "expired", "end"]
    epoch: str
    seqs: int | dict[str, int] = 0
    faults: list[Fault] = []
    quality: Quality | None = None
    t_last: int | None = None


class Writer:
    """Writes one recording; the file has its name only when it is whole.

    Args:
        path: The file, which must not exist yet.

    Attributes:
        path: The file.
        part: Where it stands until it is whole.
        n_messages: How many messages it has.

    Raises:
        OSError: It cannot be made.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.part = path.with_name(path.name + PART)
        self._file: IO[bytes] = self.part.open("xb")
        self._writer = McapWriter(self._file, compression=CompressionType.ZSTD, enable_data_crcs=True)
        self._writer.start(profile=PROFILE, library=PROFILE)
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}
        self.n_messages = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Give the file up, unless it was finished."""
        self.abandon()

    @property
    def n_bytes(self) -> int:
        """What is written so far."""
        return self._file.tell()

    def raw(self, robot: str, way: Way, t: int, data: bytes, index: int) -> None:
        """Write bytes that were received or sent.

        Args:
            robot: Name of the robot.
            way: Which way they went.
            t: When, µs UTC.
            data: The bytes.
            index: The running number of the robot's chunks.
        """
        self._add(self._channel(f"{robot}/raw/{way}", OCTETS, None), t, data, index)

    def mark(self, robot: str, t: int, mark: Mark, index: int) -> None:
        """Write a line of a robot's `session` channel, at µs UTC, with the running number of the robot's chunks."""
        channel = self._channel(f"{robot}/session", "json", "session")
        self._add(channel, t, msgspec.json.encode(mark), index)

    def said(self, topic: str, t: int, seq: int, data: bytes) -> None:
        """Write the JSON of a sample or an event of a topic, at µs UTC, with its number."""
        self._add(self._channel(topic, "json", topic.rpartition("/")[2]), t, data, seq)

    def about(self, values: dict[str, str]) -> None:
        """Write what the recording is; what is written later adds to it."""
        self._writer.add_metadata(METADATA, {"layout": LAYOUT, **values})

    def robots(self, robots: str, t: int) -> None:
        """Write the robots as they were configured at a time, µs UTC."""
        self._writer.add_attachment(t * 1000, t * 1000, ROBOTS, "application/toml", robots.encode())

    def finish(self) -> None:
        """Make the file whole, on the disk, under its name.

        Raises:
            OSError: The disk is full, or gone.
        """
        self._writer.finish()  # type: ignore[no-untyped-call] # of the library
        self._file.flush()
        os.fsync(self._file.fileno())
        self._file.close()
        self.part.rename(self.path)
        folder = os.open(self.path.parent, os.O_RDONLY | os.O_DIRECTORY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)

    def abandon(self) -> None:
        """Leave no file, if it was not finished."""
        self.leave()
        self.part.unlink(missing_ok=True)

    def leave(self) -> None:
        """Write no more, and leave what there is under its unfinished name; `replay` reads it as far as it goes."""
        with suppress(OSError):  # what is buffered cannot be written to a full disk
            self._file.close()

    def _add(self, channel: int, t: int, data: bytes, index: int) -> None:
        self.n_messages += 1
        self._writer.add_message(channel, t * 1000, data, t * 1000, index & 0xFFFFFFFF)

    def _channel(self, topic: str, encoding: str, schema: str | None) -> int:
        found = self._channels.get(topic)
        if found is None:
            identity = 0 if schema is None else self._schema(schema)
            found = self._channels[topic] = self._writer.register_channel(topic, encoding, identity)
        return found

    def _schema(self, group: str) -> int:
        found = self._schemas.get(group)
        if found is None:
            text = _schema_of(group)
            found = self._schemas[group] = self._writer.register_schema(f"robot-gateway.{group}", "jsonschema", text)
        return found


@lru_cache(maxsize=64)
def _schema_of(group: str) -> bytes:
    if group == "session":
        schema = plain(msgspec.json.schema(Mark))
    elif group not in GROUPS:
        schema = {"type": "object", "title": group}
    else:
        schema = event_schema(group) if GROUPS[group].delivery == "event" else sample_schema(group)
    return msgspec.json.encode(schema)
