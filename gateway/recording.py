"""The commands of the control socket that concern the recorder: a snapshot, and bytes for a reader on this machine."""

from __future__ import annotations

import difflib
from collections.abc import AsyncIterator, Iterator, Mapping
from fnmatch import fnmatchcase
from functools import lru_cache
from typing import Annotated

import msgspec
from msgspec import Meta

from gateway.record.dump import Asked
from gateway.record.recorder import NO_FOLDER, Recorder
from gateway.record.spool import Message, encode
from gateway.server.control import Command, ControlError, Streamed

NO_RECORDER = "NO_RECORDER"
UNKNOWN_ROBOT = "UNKNOWN_ROBOT"
NOT_WRITTEN = "NOT_WRITTEN"
OFF = "the recorder is off: set enabled = true in [recorder] and start the gateway again"
_NAMED = 8


class Capture(
    msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, tag_field="command", tag="capture"
):
    """Hand out what a robot said lately: the answer, then a spool until the connection ends.

    Attributes:
        robot: Its name.
        seconds: How much of it.
    """

    robot: str
    seconds: Annotated[float, Meta(gt=0, le=3600)] = 30.0


class Snapshot(
    msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, tag_field="command", tag="snapshot"
):
    """Record what the cell does now.

    Attributes:
        wait: Answer when the file is written.
    """

    wait: bool = False


class Stream(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, tag_field="command", tag="stream"):
    """Hand out what robots say from now on: the answer, then a spool until the connection ends.

    Attributes:
        topics: Globs; robots of which none is named are left out.
    """

    topics: Annotated[list[str], Meta(min_length=1, max_length=256)] = msgspec.field(default_factory=lambda: ["*"])


class Taken(msgspec.Struct, frozen=True, kw_only=True):
    """A snapshot is made.

    Attributes:
        directory: Where.
        path: The file, once it is there; None: nobody waited.
    """

    directory: str
    path: str | None = None


class Handed(msgspec.Struct, frozen=True, kw_only=True):
    """A spool follows.

    Attributes:
        robots: Of whom it tells now.
        ring_s: How far back it can reach, in s.
    """

    robots: list[str]
    ring_s: float = 0.0


def commands(recorder: Recorder | None) -> Mapping[str, Command]:
    """The commands, by name; without a recorder they say that there is none."""
    return Commands(recorder).table


class Commands:
    """Carries them out.

    Args:
        recorder: Of the gateway; None: it is off.

    Attributes:
        table: The commands, by name.
    """

    def __init__(self, recorder: Recorder | None) -> None:
        self._recorder = recorder
        self.table = {
            "capture": Command(Capture, self.capture),
            "snapshot": Command(Snapshot, self.snapshot),
            "stream": Command(Stream, self.stream),
        }

    async def capture(self, request: Capture) -> Streamed:
        """Carry a capture out.

        Raises:
            ControlError: There is no such robot, or no recorder.
        """
        recorder = self._there()
        if request.robot not in recorder.rings:
            raise ControlError(UNKNOWN_ROBOT, _unknown(request.robot, recorder))
        messages = recorder.capture(request.robot, request.seconds)
        return Streamed(Handed(robots=[request.robot], ring_s=recorder.ring_s), _encoded(messages))

    async def snapshot(self, request: Snapshot) -> Taken:
        """Carry a snapshot out.

        Raises:
            ControlError: There is no recorder, no folder, or the file could not be written.
        """
        recorder = self._there()
        asked = recorder.snapshot()
        directory = recorder.info.directory or ""
        if asked is None:
            raise ControlError(NO_RECORDER, NO_FOLDER)
        if not request.wait:
            return Taken(directory=directory)
        return await _written(asked, directory)

    async def stream(self, request: Stream) -> Streamed:
        """Begin to hand out.

        Raises:
            ControlError: No robot is named, or there is no recorder.
        """
        recorder = self._there()
        patterns = tuple(dict.fromkeys(topic.partition("/")[0] for topic in request.topics))
        robots = [name for name in recorder.rings if _is_named(name, patterns)]
        if not robots and recorder.rings:
            raise ControlError(UNKNOWN_ROBOT, _unknown(patterns[0], recorder))
        return Streamed(Handed(robots=robots, ring_s=recorder.ring_s), _live(recorder, patterns))

    def _there(self) -> Recorder:
        if self._recorder is None:
            raise ControlError(NO_RECORDER, OFF)
        return self._recorder


async def _written(asked: Asked, directory: str) -> Taken:
    await asked.done.wait()
    if asked.path is None:
        raise ControlError(NOT_WRITTEN, f"the recording was not written: {asked.error}")
    return Taken(directory=directory, path=str(asked.path))


async def _encoded(messages: Iterator[Message]) -> AsyncIterator[bytes]:
    for message in messages:
        yield encode(message)


async def _live(recorder: Recorder, patterns: tuple[str, ...]) -> AsyncIterator[bytes]:
    @lru_cache(maxsize=4096)
    def wanted(robot: str) -> bool:
        return _is_named(robot, patterns)

    with recorder.streaming(wanted) as feed:
        async for piece in feed.pieces():
            yield piece


def _is_named(robot: str, patterns: tuple[str, ...]) -> bool:
    return any(fnmatchcase(robot, pattern) for pattern in patterns)


def _unknown(name: str, recorder: Recorder) -> str:
    """Say what to do about a robot that there is not."""
    robots = list(recorder.rings)
    near = difflib.get_close_matches(name, robots, n=1)
    listed = ", ".join(robots[:_NAMED]) + (" …" if len(robots) > _NAMED else "")
    hint = f"did you mean {near[0]!r}?" if near else f"there are: {listed or 'none'}"
    return f"there is no robot {name[:40]!r}; {hint}"
