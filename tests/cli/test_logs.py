"""The log: whoever writes it, a line is one JSON object."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest

from tests.cli.command import ROOT, environment

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
