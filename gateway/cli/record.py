"""`robot-gateway record`: writes down what the running gateway reads, for as long as one likes."""

from __future__ import annotations

import os
import re
import signal
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Annotated

import msgspec
import typer

from gateway.cli.common import USAGE, fail, tell
from gateway.cli.control import Control, answers, asked, find_socket
from gateway.record.continuous import Continuous, Limits
from gateway.record.spool import SpoolError, SpoolReader
from gateway.recording import Handed, Stream

_SIZE = re.compile(r"(\d+(?:\.\d+)?)\s*(s|m|min|h|d|kB|MB|GB)")
_SECONDS = {"s": 1.0, "m": 60.0, "min": 60.0, "h": 3600.0, "d": 86_400.0}
_BYTES = {"kB": 1_000, "MB": 1_000_000, "GB": 1_000_000_000}
_LOOK_S = 0.25
_AGAIN_S = 1.0
_BEHIND_S = 20.0  # what waits when the recording ends is still written, for so long
_LINE_S, _PIPED_LINE_S = 1.0, 10.0


def record(
    topics: Annotated[
        list[str] | None,
        typer.Argument(metavar="[TOPIC]...", help="Globs such as r1/* or '*/joints'. Default: everything."),
    ] = None,
    *,
    out: Annotated[Path, typer.Option("-o", "--out", metavar="DIR", help="Folder of the files; made if need be.")],
    rotate: Annotated[
        str, typer.Option(metavar="LIMIT", help="Begin the next file after so long, or so much: 10m, 1h, 500MB.")
    ] = "10m",
    length: Annotated[
        str | None, typer.Option("--for", metavar="TIME", help="End after so long: 30s, 10m, 1h, 2d. Default: Ctrl-C.")
    ] = None,
    raw_only: Annotated[
        bool,
        typer.Option("--raw-only", help="Leave out the samples that follow from the bytes: replay makes them again."),
    ] = False,
    no_wait: Annotated[
        bool, typer.Option("--no-wait", help="End when the gateway goes away, instead of waiting for it.")
    ] = False,
    control: Control = None,
) -> None:
    """Write down what the running gateway reads: every byte of the robots, the samples, events and links.

    Files are whole when they have their name; each can be replayed alone. The gateway never waits for this command:
    what it could not hand over is counted as dropped. Ctrl-C finishes the file.

    \b
    Examples:
      robot-gateway record -o recordings
      robot-gateway record 'r1/*' 'r2/joints' -o recordings --rotate 1h --for 2d
      robot-gateway record -o recordings --raw-only --rotate 500MB
    """  # noqa: D301 - the \b keeps the lines apart
    globs = tuple(topics or ["*"])
    for glob in globs:
        if glob != "*" and "/" not in glob:
            fail(f"{glob!r} is no topic: topics look like r1/joints, {glob}/* or */joints", USAGE)
    limits = _limits(rotate)
    end_s = None if length is None else time.monotonic() + _seconds(length)
    socket = find_socket(control, os.environ)
    try:
        out.mkdir(mode=0o750, parents=True, exist_ok=True)
    except OSError as error:
        fail(f"{out}: {error.strerror}")
    os.umask(0o027)
    writing = Continuous(
        out, globs, limits, samples=not raw_only, now_s=time.monotonic, utc_us=lambda: time.time_ns() // 1000
    )
    with _stopping() as stop:
        _Session(writing, socket, Stream(topics=list(globs)), stop, end_s, waits=not no_wait).run()


class _Stop:
    """Set by a signal."""

    asked = False


class _Session:
    """Reads the stream until it is told to stop.

    Args:
        writing: Writes it.
        socket: The control socket.
        request: What is asked for.
        stop: Set by a signal.
        end_s: When to end, monotonic, s; None: never.
        waits: Whether to wait for a gateway that has gone away.
    """

    def __init__(
        self, writing: Continuous, socket: Path, request: Stream, stop: _Stop, end_s: float | None, *, waits: bool
    ) -> None:
        self._writing = writing
        self._socket = socket
        self._request = request
        self._stop = stop
        self._end_s = end_s
        self._waits = waits
        self._began_s = self._told_s = time.monotonic()
        self._rate_bytes = 0
        self._over_us: int | None = None
        self._give_up_s = 0.0

    def run(self) -> None:
        """Record."""
        try:
            self._follow()
            while self._waits and not self._is_over():
                tell("waiting:", "yellow", f"the gateway went away; waiting for it at {self._socket}")
                while not self._is_over() and not answers(self._socket):
                    time.sleep(_AGAIN_S)
                if not self._is_over():
                    self._try_again()
        except SpoolError as error:
            self._writing.leave()
            fail(f"the gateway and this command do not fit together: {error}")
        except OSError as error:
            path = self._writing.path or "the recording"
            left = " and ".join(map(str, self._writing.leave())) or "nothing"
            fail(f"{path}: {error.strerror or error}; of what was not finished there is {left}")
        tally = self._writing.tally
        for note in tally.notes:
            tell("warning:", "yellow", note)
        words = f"{tally.n_files} file{'' if tally.n_files == 1 else 's'}, {_size(tally.n_bytes)}, {tally.lost} dropped"
        tell("recorded:", "green", words + (f"; the last one is {tally.last}" if tally.last else ""))

    def _try_again(self) -> None:
        try:
            self._follow()
        except typer.Exit:  # it has gone again, which is told
            time.sleep(_AGAIN_S)

    def _follow(self) -> None:
        """Write the stream of one connection to its end."""
        with asked(self._socket, self._request) as (answer, rest):
            if not answer.ok:
                fail(answer.message)
            robots = msgspec.json.decode(answer.result, type=Handed).robots
            tell("recording:", "green", f"{len(robots)} robot{'' if len(robots) == 1 else 's'}; Ctrl-C ends it")
            reader = SpoolReader()
            while not self._is_done():
                data = rest.read(_LOOK_S)
                if data == b"" or (data is None and self._is_over()):
                    break
                for message in reader.feed(data or b""):
                    self._writing.take(message)
                self._writing.look()
                self._tell()
            self._writing.finish()
        if sys.stderr.isatty():
            sys.stderr.write("\n")

    def _is_done(self) -> bool:
        """Whether everything until the end is written, also where this command was behind."""
        if not self._is_over():
            return False
        if self._over_us is None:
            self._over_us, self._give_up_s = time.time_ns() // 1000, time.monotonic() + _BEHIND_S
        return self._writing.newest_t >= self._over_us or time.monotonic() >= self._give_up_s

    def _is_over(self) -> bool:
        return self._stop.asked or (self._end_s is not None and time.monotonic() >= self._end_s)

    def _tell(self) -> None:
        """The line of progress: one that is written anew; into a pipe a new one now and then."""
        now_s, on_terminal = time.monotonic(), sys.stderr.isatty()
        passed_s = now_s - self._told_s
        if passed_s < (_LINE_S if on_terminal else _PIPED_LINE_S):
            return
        n_bytes = self._writing.n_bytes
        rate = max(0, n_bytes - self._rate_bytes) / passed_s
        self._told_s, self._rate_bytes = now_s, n_bytes
        minutes, seconds = divmod(int(now_s - self._began_s), 60)
        duration = f"{minutes // 60}:{minutes % 60:02}:{seconds:02}"
        name = "" if self._writing.path is None else self._writing.path.name
        line = f"{duration}  {_size(n_bytes)}  {_size(rate)}/s  {self._writing.tally.lost} dropped  {name}"
        sys.stderr.write(f"\r{line}\x1b[K" if on_terminal else f"{line}\n")
        sys.stderr.flush()


@contextmanager
def _stopping() -> Iterator[_Stop]:
    """Let SIGINT and SIGTERM end the recording, which finishes its file."""
    stop = _Stop()

    def on_signal(_number: int, _frame: FrameType | None) -> None:
        stop.asked = True

    before = {number: signal.signal(number, on_signal) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _limits(text: str) -> Limits:
    match = _SIZE.fullmatch(text.strip())
    if match is None or float(match[1]) <= 0:
        fail(f"--rotate {text!r}: is no limit like 10m, 1h or 500MB", USAGE)
    number, unit = float(match[1]), match[2]
    if unit in _BYTES:
        return Limits(n_bytes=int(number * _BYTES[unit]))
    return Limits(seconds=number * _SECONDS[unit])


def _seconds(text: str) -> float:
    match = _SIZE.fullmatch(text.strip())
    if match is None or match[2] not in _SECONDS or float(match[1]) <= 0:
        fail(f"--for {text!r}: is no time like 30s, 10m, 1h or 2d", USAGE)
    return float(match[1]) * _SECONDS[match[2]]


def _size(n_bytes: float) -> str:
    """A size in words."""
    for unit in ("GB", "MB", "kB"):
        if n_bytes >= _BYTES[unit]:
            return f"{n_bytes / _BYTES[unit]:.1f} {unit}"
    return f"{n_bytes:.0f} B"
