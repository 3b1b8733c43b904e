"""`robot-gateway replay`: a recording through the decoders again, to look at, to serve, or to judge a plugin by."""

from __future__ import annotations

import signal
from collections.abc import Callable
from contextlib import AbstractAsyncContextManager
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Annotated

import anyio
import anyio.lowlevel
import msgspec
import typer

from gateway import logs
from gateway.api.model import Event, Sample
from gateway.cli.check import fail as fail_config
from gateway.cli.common import USAGE, call, fail, tell
from gateway.cli.compared import compare
from gateway.cli.recorded import Job, job_of, play, put, skip, warn
from gateway.cli.view import event_line, sample_lines, units_of
from gateway.config import parse
from gateway.config.printing import toml_value
from gateway.core.bus import Reading, Topic
from gateway.errors import ConfigError
from gateway.record.reading import said_of
from gateway.record.replaying import Replay, Tally
from gateway.server.cell import Cell
from gateway.server.http import listening
from gateway.server.listener import Listener
from gateway.server.settings import door_settings

_DEFAULT_LISTEN = "127.0.0.1:8765"
_AT_ONCE = 200  # messages that are read before others may do something
_NOT_COMPARED = {"link", "link_stats", "events", "commands", "session"}
_SHOWN = 60  # characters of a value that has changed

File = Annotated[Path, typer.Argument(help="The recording, MCAP.", metavar="FILE")]
Names = Annotated[
    list[str] | None, typer.Option("--robot", "-r", metavar="NAME", help="Only this robot; may be repeated.")
]
From = Annotated[
    str | None,
    typer.Option(
        "--from", metavar="MOMENT", help="Seconds from the beginning, -seconds from the end, or a time: 03:12:07."
    ),
]
To = Annotated[str | None, typer.Option("--to", metavar="MOMENT", help="As --from.")]
Speed = Annotated[
    float | None,
    typer.Option(
        metavar="FACTOR", min=0, help="1: as it was, 2: twice as fast, 0: at once. Default: 0, and 1 with --serve."
    ),
]
ConfigFile = Annotated[
    Path | None,
    typer.Option(
        "--config", "-c", metavar="FILE", help="A configuration whose robots and vendor_dirs replace the recorded ones."
    ),
]
Dirs = Annotated[
    list[Path] | None, typer.Option("--vendor-dir", metavar="DIR", help="A folder of further vendors; may be repeated.")
]


def replay(
    file: File,
    *,
    robot: Names = None,
    from_: From = None,
    to: To = None,
    speed: Speed = None,
    topic: Annotated[
        list[str] | None,
        typer.Option("--topic", "-t", metavar="GLOB", help="Print the samples of these topics too; may be repeated."),
    ] = None,
    config: ConfigFile = None,
    vendor_dir: Dirs = None,
    serve: Annotated[bool, typer.Option("--serve", help="Open the doors and the dashboard on it.")] = False,
    listen: Annotated[
        str, typer.Option(metavar="HOST:PORT", help="Where, with --serve; port 0: a free one.")
    ] = _DEFAULT_LISTEN,
    diff: Annotated[bool, typer.Option("--diff", help="Compare the samples with the recorded ones.")] = False,
    json: Annotated[bool, typer.Option("--json", help="Print a JSON object a line, for programs.")] = False,
) -> None:
    """Replay a recording: its raw bytes go through the decoders of the installed plugins again.

    Without --serve and --diff it prints the events, and then what was read of each robot. Samples say origin: replay.

    Exit codes: 0 success, with --diff nothing changed; 1 failure, or something changed; 2 wrong usage; 78 wrong
    configuration.

    \b
    Examples:
      robot-gateway replay stop.mcap
      robot-gateway replay stop.mcap --from -10 --topic r1/tcp
      robot-gateway replay stop.mcap --serve --listen 127.0.0.1:9000
      robot-gateway replay field.mcap --diff --vendor-dir ./my-vendors
    """  # noqa: D301 - the \b keeps the lines apart
    if serve and diff:
        fail("--serve and --diff exclude each other", USAGE)
    logs.configure("error")
    job = job_of(file, robot or [], from_, to, config, vendor_dir or [])
    if diff:
        compare(job, json=json)
    elif serve:
        _serve(job, listen, 1.0 if speed is None else speed)
    else:
        call(lambda: _print(job, speed or 0.0, topic or [], json=json))


class _Printed:
    """Prints events and samples as they are published; a listener.

    Args:
        json: A JSON object a line.
        from_t: Nothing from before then, µs UTC.
        units: Unit by path, by topic.
    """

    def __init__(self, from_t: int, units: dict[str, dict[str, str]], *, json: bool) -> None:
        self._from_t = from_t
        self._units = units
        self._json = json

    def on_reading(self, topic: Topic, reading: Reading) -> None:
        """Print a sample."""
        if reading.sample(topic).t < self._from_t:
            return
        sample = msgspec.json.decode(msgspec.json.encode(reading.sample(topic)), type=Sample)
        if self._json:
            put(msgspec.json.encode(sample).decode())
            return
        for line in sample_lines(sample, self._units.get(topic.name, {})):
            put(line)

    def on_event(self, topic: Topic, event: Event) -> None:  # noqa: ARG002 - a listener's signature
        """Print an event."""
        if event.t >= self._from_t:
            put(msgspec.json.encode(event).decode() if self._json else event_line(event))


async def _print(job: Job, speed: float, globs: list[str], *, json: bool) -> None:
    replay = Replay(job.robots, job.recording.begins_t)
    cell = Cell(job.robots.values(), replay.bus)
    wanted = [topic for topic in replay.bus.topics.values() if any(fnmatchcase(topic.name, glob) for glob in globs)]
    if globs and not wanted:
        fail(cell.unknown_topic(globs), USAGE)
    units = {topic.name: units_of(cell.describe(topic).schema) for topic in wanted if topic.ring is None}
    printed = _Printed(job.from_t, units, json=json)
    events = [topic for topic in replay.bus.topics.values() if topic.ring is not None and not globs]
    for topic in (*wanted, *events):
        topic.listeners.append(printed)
    await play(job, replay, skip(job, replay, job.entries()), speed)
    for name, tally in replay.tallies.items():
        put(msgspec.json.encode({"robot": name, **_plain(tally)}).decode() if json else _summary(job, name, tally))
    warn(replay)


def _summary(job: Job, name: str, tally: Tally) -> str:
    robot = job.robots[name]
    counts = [
        f"{tally.sessions} session{'' if tally.sessions == 1 else 's'}",
        f"{tally.frames} frames",
        *([f"{tally.occurrences} occurrences"] if tally.occurrences else []),
        *([f"{tally.skipped} without state"] if tally.skipped else []),
        ", ".join(f"{count} rejected: {reason}" for reason, count in tally.rejects.items()) or "0 rejected",
        f"{tally.events.total()} events",
        f"{tally.n_received} bytes received, {tally.n_sent} sent",
    ]
    return f"{name}  {robot.vendor.name}:{robot.protocol.name}  {', '.join(counts)}"


def _plain(tally: Tally) -> dict[str, object]:
    return {
        "sessions": tally.sessions,
        "frames": tally.frames,
        "occurrences": tally.occurrences,
        "skipped": tally.skipped,
        "rejects": dict(tally.rejects),
        "events": dict(tally.events),
        "n_received": tally.n_received,
        "n_sent": tally.n_sent,
        "problem": tally.problem or None,
    }


def _serve(job: Job, listen: str, speed: float) -> None:
    try:
        config = parse(f"[server]\nlisten = {toml_value(listen)}\n", "--listen")
    except ConfigError as error:
        fail_config(error)
    host, port = config.server.address

    def doors(cell: Cell) -> AbstractAsyncContextManager[Listener]:
        return listening(cell, host, port, door_settings(config))

    call(lambda: served_until_signal(job, host, doors, speed))


async def served_until_signal(
    job: Job, host: str, doors: Callable[[Cell], AbstractAsyncContextManager[Listener]], speed: float
) -> None:
    """Serve a recording until SIGINT or SIGTERM; see `served`."""
    async with anyio.create_task_group() as tasks:
        with anyio.open_signal_receiver(signal.SIGINT, signal.SIGTERM) as signals:
            tasks.start_soon(served, job, host, doors, speed)
            async for _ in signals:
                tasks.cancel_scope.cancel()
                return


async def served(
    job: Job, host: str, doors: Callable[[Cell], AbstractAsyncContextManager[Listener]], speed: float
) -> None:
    """Open the doors on a recording and play it; they stay open when it is over.

    Args:
        job: What is replayed.
        host: Where the doors are.
        doors: Opens them.
        speed: How many times as fast as it was; 0: at once.
    """
    replay = Replay(job.robots, job.recording.begins_t)
    entries = skip(job, replay, job.entries())
    first = next(entries, None)
    async with doors(Cell(job.robots.values(), replay.bus)) as opened:
        shown = f"[{host}]" if ":" in host else host
        tell("replaying:", "green", f"{job.recording.path} of {said_of(job.recording)}")
        tell("open:", "green", f"http://{shown}:{opened.port}/ - end it with Ctrl-C")
        if first is not None:
            replay.take(first)
        await play(job, replay, entries, speed)
        warn(replay)
        replay.end(job.recording.last_t)
        tell("over:", "yellow", "the recording has ended; the doors stay open until Ctrl-C")
        await anyio.sleep_forever()
