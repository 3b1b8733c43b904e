"""The processes of the suite: started, watched through /proc, and dead when their context ends, come what may."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import AsyncIterator, Iterator, Mapping, Sequence
from contextlib import asynccontextmanager, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO

import aiohttp
import anyio

ROOT = Path(__file__).parents[2]
GATEWAY = (sys.executable, "-m", "gateway")
# A process of ours ends with the test that started it, even where that is killed.
_WITH_US = ("setpriv", "--pdeathsig", "KILL")
START_S = 30.0
_POLL_S = 0.02


@dataclass(frozen=True, slots=True)
class Usage:
    """What a process has of the machine at one moment.

    Attributes:
        tasks: Of its event loop.
        fds: Open file descriptors, sockets among them.
        sockets: Open sockets.
        threads: Threads.
        memory_kib: Resident memory.
    """

    tasks: int
    fds: int
    sockets: int
    threads: int
    memory_kib: int


def environment(**more: str) -> dict[str, str]:
    """The environment of a process: nothing of this machine's settings of the gateway."""
    kept = {key: value for key, value in os.environ.items() if not key.startswith("ROBOT_GATEWAY_")}
    return {**kept, "PYTHONPATH": str(ROOT), **more}


@contextmanager
def spawned(
    command: Sequence[str], log: Path | IO[bytes], env: Mapping[str, str] | None = None
) -> Iterator[subprocess.Popen[bytes]]:
    """Run a process for as long as the context lasts.

    Args:
        command: What to run.
        log: Takes what it says.
        env: Added to its environment.
    """
    with log.open("ab") if isinstance(log, Path) else _kept_open(log) as out:
        process = subprocess.Popen(  # noqa: S603
            [*_WITH_US, *command],
            stdin=subprocess.DEVNULL,
            stdout=out,
            stderr=out,
            env=environment(**(env or {})),
            cwd=ROOT,
        )
        try:
            yield process
        finally:
            if process.poll() is None:
                process.kill()
            process.wait()


@contextmanager
def _kept_open(out: IO[bytes]) -> Iterator[IO[bytes]]:
    yield out


def text_of(log: Path) -> str:
    """What was logged."""
    return log.read_text("utf-8", "replace") if log.exists() else ""


async def said(log: Path, text: str, process: subprocess.Popen[bytes], within_s: float = START_S) -> str:
    """Wait until a process has said a line with some text; return the line.

    Raises:
        AssertionError: It has ended, or says nothing of the kind in time.
    """
    with anyio.move_on_after(within_s):
        while True:
            lines = text_of(log).splitlines()
            found = next((line for line in lines if text in line), None)
            if found is not None:
                return found
            assert process.poll() is None, f"ended with {process.returncode}:\n{text_of(log)}"
            await anyio.sleep(_POLL_S)
    raise AssertionError(f"{text!r} is not said within {within_s:g} s:\n{text_of(log)}")


async def ended(process: subprocess.Popen[bytes], within_s: float) -> int | None:
    """Wait for the end of a process; its exit code, None where it still runs."""
    with anyio.move_on_after(within_s):
        while process.poll() is None:  # noqa: ASYNC110 - a process sets no event
            await anyio.sleep(0.005)
    return process.poll()


class GatewayProcess:
    """A gateway in a process of its own.

    Args:
        process: It.
        listen: Host and port of its doors.
        log: The file that it logs to.
    """

    def __init__(self, process: subprocess.Popen[bytes], listen: str, log: Path) -> None:
        self.process = process
        self.listen = listen
        self.log = log

    @property
    def url(self) -> str:
        """The native WebSocket door."""
        return f"ws://{self.listen}/ws"

    @property
    def pid(self) -> int:
        """Its process."""
        return self.process.pid

    def http(self, path: str) -> str:
        """An address of its HTTP door."""
        return f"http://{self.listen}{path}"

    async def fetched(self, path: str) -> tuple[int, str]:
        """Status and text of one answer over HTTP."""
        timeout = aiohttp.ClientTimeout(total=10)
        async with aiohttp.ClientSession(timeout=timeout) as session, session.get(self.http(path)) as answer:
            return answer.status, await answer.text()

    async def metrics(self, *starts: str) -> list[float]:
        """Of /metrics the value of the first series whose line begins so, for each."""
        _, text = await self.fetched("/metrics")
        lines = text.splitlines()
        return [next(float(line.rpartition(" ")[2]) for line in lines if line.startswith(start)) for start in starts]

    async def usage(self) -> Usage:
        """What it has of the machine now, without what asking it takes."""
        (tasks,) = await self.metrics("robot_gateway_tasks ")
        await anyio.sleep(_POLL_S)  # the connection that asked is closed meanwhile
        return self.usage_seen(int(tasks))

    def usage_seen(self, tasks: int = 0) -> Usage:
        """What can be seen of it from outside, without asking it anything."""
        proc = Path(f"/proc/{self.pid}")
        links = [_target(link) for link in proc.joinpath("fd").iterdir()]
        status = dict(line.split(":", 1) for line in proc.joinpath("status").read_text().splitlines())
        return Usage(
            tasks=tasks,
            fds=len(links),
            sockets=sum(link.startswith("socket:") for link in links),
            threads=int(status["Threads"]),
            memory_kib=int(status["VmRSS"].split()[0]),
        )

    @property
    def n_said(self) -> int:
        """How many bytes it has logged."""
        return self.log.stat().st_size

    def records(self, since: int = 0) -> list[dict[str, object]]:
        """What it has logged; a line that is no event of ours becomes the event `stray.line`.

        Args:
            since: A former `n_said`.
        """
        text = self.log.read_bytes()[since:].decode("utf-8", "replace")
        return [_record(line) for line in text.splitlines() if line.strip()]


@asynccontextmanager
async def gateway(
    config: str,
    folder: Path,
    *,
    prefix: Sequence[str] = (),
    env: Mapping[str, str] | None = None,
    log: Path | None = None,
) -> AsyncIterator[GatewayProcess]:
    """Run a gateway until the context ends.

    Args:
        config: The text of its configuration.
        folder: Takes configuration and log.
        prefix: What is run before it and becomes it, such as `prlimit`.
        env: Added to its environment.
        log: Where it logs to; None: a file in the folder.
    """
    path = folder / "gateway.toml"
    path.write_text(config, "utf-8")
    log = log or folder / "gateway.log"
    log.unlink(missing_ok=True)
    with spawned([*prefix, *GATEWAY, "run", "--config", str(path)], log, env) as process:
        started = _record(await said(log, '"gateway.started"', process))
        yield GatewayProcess(process, str(started["listen"]), log)


def _target(link: Path) -> str:
    try:
        return str(link.readlink())
    except FileNotFoundError:  # closed meanwhile
        return ""


def _record(line: str) -> dict[str, object]:
    try:
        found = json.loads(line)
    except ValueError:
        found = None
    return found if isinstance(found, dict) else {"event": "stray.line", "level": "error", "reason": line}
