"""Processes of the benchmarks: started, told words in lines, measured, ended."""

from __future__ import annotations

import os
import resource
import select
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

ROOT = Path(__file__).parents[2]
_PATIENCE_S = 60.0
_GOODBYE_S = 5.0


class ProcessEndedError(Exception):
    """A process of the benchmark has ended, or says nothing."""


class Process:
    """A process that is told words and answers in lines.

    Args:
        running: Its pipes are open.
    """

    def __init__(self, running: subprocess.Popen[bytes]) -> None:
        self._running = running
        self._left = b""

    @property
    def pid(self) -> int:
        """Its number."""
        return self._running.pid

    def line(self) -> bytes:
        """Its next line.

        Raises:
            ProcessEndedError: It has ended, or says nothing for a minute.
        """
        assert self._running.stdout is not None
        until_s = time.monotonic() + _PATIENCE_S
        while b"\n" not in self._left:
            ready, _, _ = select.select([self._running.stdout], [], [], max(0.0, until_s - time.monotonic()))
            data = os.read(self._running.stdout.fileno(), 1 << 16) if ready else b""
            if not data:
                raise ProcessEndedError(f"{self._running.args!r} {'has ended' if ready else 'says nothing'}")
            self._left += data
        line, _, self._left = self._left.partition(b"\n")
        return line

    def ask(self, word: str) -> bytes:
        """Tell it a word, and read its answer."""
        assert self._running.stdin is not None
        self._running.stdin.write(word.encode() + b"\n")
        self._running.stdin.flush()
        return self.line()

    def cpu_s(self) -> float:
        """CPU time so far, of user and system, all its threads: by its own clock, clock_getcpuclockid(3)."""
        return time.clock_gettime(~self.pid << 3 | 2)

    def memory_mb(self) -> float:
        """Resident memory, MB."""
        return int(Path(f"/proc/{self.pid}/statm").read_text().split()[1]) * resource.getpagesize() / 1e6


@contextmanager
def running(arguments: Sequence[str]) -> Iterator[Process]:
    """Run Python with some arguments from the project's folder; it is to end when its standard input does."""
    pipe = subprocess.PIPE
    command = [sys.executable, *arguments]
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, cwd=ROOT, bufsize=0) as started:  # noqa: S603 - our own
        try:
            yield Process(started)
        finally:
            assert started.stdin is not None
            started.stdin.close()
            started.terminate()
            try:
                started.wait(_GOODBYE_S)
            except subprocess.TimeoutExpired:
                started.kill()


def part(server: Process, *others: Process) -> None:
    """Give a server one core, and what loads it the others: neither takes the other's time."""
    first, *rest = sorted(os.sched_getaffinity(0))
    _keep_to(server.pid, {first})
    for process in others:
        _keep_to(process.pid, set(rest) or {first})


def _keep_to(pid: int, cores: set[int]) -> None:
    """Let all threads of a process run on some cores only."""
    for thread in Path(f"/proc/{pid}/task").iterdir():
        os.sched_setaffinity(int(thread.name), cores)


def module(name: str, *arguments: object) -> list[str]:
    """The arguments that run a module of the benchmarks."""
    return ["-m", f"tests.bench.{name}", *map(str, arguments)]
