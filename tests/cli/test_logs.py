"""The log: whoever writes it, a line is one JSON object."""

from __future__ import annotations

import errno
import io
import json
import subprocess
import sys
from typing import TYPE_CHECKING

import pytest

from gateway import logs
from tests.cli.command import ROOT, environment

if TYPE_CHECKING:
    from _typeshed import ReadableBuffer

SCRIPT = """
import logging, warnings
import structlog
from gateway import logs

logs.configure({level!r})
logs.configure({level!r})
structlog.get_logger().error("link.lost", robot="r1")
logging.getLogger("aiohttp.server").info("not this")
logging.getLogger("aiohttp.access").warning("two\\nlines %s", "é")
try:
    1 / 0
except ZeroDivisionError:
    logging.getLogger("asyncio").exception("Task exception was never retrieved")
warnings.warn("old")
"""


def logged(level: str) -> list[dict[str, object]]:
    """What a program logs from a level on, line by line."""
    env = environment() | {"PYTHONWARNINGS": "default"}
    done = subprocess.run(  # noqa: S603
        [sys.executable, "-c", SCRIPT.format(level=level)],
        env=env,
        cwd=ROOT,
        check=True,
        capture_output=True,
        text=True,
        timeout=15,
    )
    assert done.stdout == ""
    return [json.loads(line) for line in done.stderr.splitlines()]


@pytest.mark.parametrize("level", ["debug", "info", "warning"])
def test_what_libraries_log_is_one_json_object_a_line_like_our_own(level: str) -> None:
    own, access, failed, old = logged(level)
    assert (own["event"], own["robot"], own["level"]) == ("link.lost", "r1", "error")
    assert (access["event"], access["logger"], access["level"]) == ("two\nlines é", "aiohttp.access", "warning")
    assert (failed["event"], failed["logger"]) == ("Task exception was never retrieved", "asyncio")
    assert "ZeroDivisionError" in str(failed["exception"])
    assert "old" in str(old["event"])
    assert all("timestamp" in line for line in (own, access, failed, old))


def test_at_level_error_the_warnings_of_libraries_are_left_out() -> None:
    assert [line["event"] for line in logged("error")] == ["link.lost", "Task exception was never retrieved"]


class FullDisk(io.RawIOBase):
    """A file on a disk that is full at times, and takes two bytes at once otherwise."""

    def __init__(self) -> None:
        self.full = False
        self.taken = b""

    def writable(self) -> bool:
        return True

    def write(self, data: ReadableBuffer) -> int:
        if self.full:
            raise OSError(errno.ENOSPC, "No space left on device")
        part = bytes(data)[:2]
        self.taken += part
        return len(part)


def test_lines_that_cannot_be_written_are_lost_and_nothing_else_happens() -> None:
    disk = FullDisk()
    out = logs.Unfailing(io.TextIOWrapper(io.BufferedWriter(disk), "utf-8"))
    print("one é", file=out, flush=True)
    disk.full = True
    print("two", file=out, flush=True)
    disk.full = False
    print("three", file=out, flush=True)
    assert disk.taken.decode() == "one é\nthree\n"


def test_a_stream_without_a_file_is_written_as_it_is() -> None:
    stream = io.StringIO()
    print("one", file=logs.Unfailing(stream), flush=True)
    assert stream.getvalue() == "one\n"
