"""What the commands that read recordings share: opening one, choosing a part of it, and playing it."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import anyio
import anyio.lowlevel
import typer

from gateway.cli.check import fail as fail_config
from gateway.cli.common import USAGE, fail, tell
from gateway.cli.moments import moment
from gateway.core.settings import RobotSettings
from gateway.errors import ConfigError
from gateway.record.reading import Entry, Recording, RecordingError, open_recording, said_of
from gateway.record.replaying import Replay
from gateway.record.robots import robots_of

_AT_ONCE = 200  # messages that are read before others may do something


@dataclass(frozen=True, slots=True)
class Job:
    """What is replayed: a recording, its robots, and which part of it (µs UTC)."""

    recording: Recording
    robots: dict[str, RobotSettings]
    left_out: dict[str, str]
    from_t: int
    to_t: int

    def entries(self) -> Iterator[Entry]:
        """What the recording holds until the end of the part; the robots' states need what came before it."""
        for entry in self.recording.entries():
            if entry.t > self.to_t:
                return
            yield entry


def opened(file: Path) -> Recording:
    """Open a recording, or say why not; of a damaged one say what is wrong with it."""
    try:
        recording = open_recording(file)
    except RecordingError as error:
        fail(str(error))
    if recording.problem:
        tell("damaged:", "yellow", f"{file}: {recording.problem}")
    if not recording.names:
        fail(f"{file}: is empty: no robot said anything while it was made ({said_of(recording)})")
    return recording


def job_of(
    file: Path, names: list[str], from_: str | None, to: str | None, config: Path | None, vendor_dirs: list[Path]
) -> Job:
    """What is replayed of a file, by the options of the command; end with a message where nothing can be."""
    recording = opened(file)
    try:
        found = robots_of(recording, names=names, config=config, vendor_dirs=vendor_dirs)
    except ConfigError as error:
        fail_config(error)
    except KeyError as error:
        fail(f"{file} holds nothing of a robot {error.args[0]!r}: it has {', '.join(recording.names)}", USAGE)
    for name, reason in found.left_out.items():
        tell("left out:", "yellow", f"{name}: {reason}")
    if not found.usable:
        fail(f"{file}: none of its robots can be replayed")
    begins_t, ends_t = recording.begins_t, recording.last_t
    from_t = begins_t if from_ is None else _moment("--from", from_, begins_t, ends_t)
    to_t = ends_t if to is None else _moment("--to", to, begins_t, ends_t)
    if from_t > min(to_t, ends_t) or to_t < begins_t:
        fail(f"nothing was recorded then: {file} is of {said_of(recording)}", USAGE)
    return Job(recording, found.usable, found.left_out, from_t, to_t)


def _moment(option: str, text: str, begins_t: int, ends_t: int) -> int:
    try:
        return moment(text, begins_t, ends_t)
    except ValueError as error:
        raise typer.BadParameter(str(error), param_hint=option) from None


async def play(job: Job, replay: Replay, entries: Iterator[Entry], speed: float) -> None:
    """Publish what entries hold.

    Args:
        job: What is replayed.
        replay: Where it is published.
        entries: What is left of it.
        speed: How many times as fast as it was; 0: at once.
    """
    began_s = anyio.current_time()
    for number, entry in enumerate(entries):
        if speed:
            left_s = began_s + (entry.t - job.from_t) / 1e6 / speed - anyio.current_time()
            if left_s > 0:
                await anyio.sleep(left_s)
        if not number % _AT_ONCE:
            await anyio.lowlevel.checkpoint()
        replay.take(entry)


def skip(job: Job, replay: Replay, entries: Iterator[Entry]) -> Iterator[Entry]:
    """Take what came before the part that is replayed, at once; what is left."""
    for entry in entries:
        if entry.t >= job.from_t:
            yield entry
            break
        replay.take(entry)
    yield from entries


def warn(replay: Replay) -> None:
    """Say what of a recording could not be replayed."""
    for name, tally in replay.tallies.items():
        if tally.problem:
            tell("failed:", "red", f"{name}: {tally.problem}; what follows of it is not read")
    if replay.unreadable:
        tell("left out:", "yellow", f"{replay.unreadable} events or samples, which another version has written")


def put(text: str) -> None:
    """Print a line."""
    sys.stdout.write(f"{text}\n")
