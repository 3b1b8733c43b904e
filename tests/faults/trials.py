"""Faults that need gateways of their own: killed and ended at random moments, out of memory, its log gone."""

from __future__ import annotations

import os
import resource
import signal
import time
from collections.abc import Awaitable, Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from random import Random
from subprocess import Popen

import anyio

from tests.end_to_end.load_faults import masked, subscribe
from tests.faults.cell import hosts, port_given_back, steady_robots, taken
from tests.faults.kit import made
from tests.faults.limits import crowd
from tests.faults.processes import GATEWAY, ended, gateway, said, spawned
from tests.faults.report import Report, Seen
from tests.faults.robots import Robot, configured, serving
from tests.faults.watch import Watch, watching

_END_S = 2.0
_BACK_S = 15.0
_HOLD_S = 3.0
_TEXT = 0x81
_NEVER_READ = 40
_ROOM = 4 << 20


@dataclass(frozen=True, slots=True)
class Trial:
    """A fault with gateways of its own.

    Attributes:
        name: For the report.
        strike: Makes it happen and tells what was seen; how many times in the short form is its own choice.
    """

    name: str
    strike: Callable[[Path, Random], Awaitable[Seen]]

    async def run(self, folder: Path, random: Random, report: Report, long_s: float = 0.0) -> None:  # noqa: ARG002 - a series'
        """Let it happen once, however long there would be; fills the report."""
        made(folder)
        row = report.row("gateway", self.name)
        try:
            row.add(await self.strike(folder, random))
        except (AssertionError, OSError, TimeoutError) as error:
            row.times += 1
            row.broken.append(f"{type(error).__name__}: {error}")


async def _all_alive(url: str, robots: Sequence[Robot], within_s: float = _BACK_S) -> float:
    """Wait until every robot is alive for a new client; how long that took."""
    since_s = time.monotonic()
    watch = Watch(url, struck=lambda _: True)
    async with anyio.create_task_group() as tasks, watching(tasks, watch):
        for robot in robots:
            await watch.back(robot.name, since_s, within_s)
    return time.monotonic() - since_s


async def _struck(folder: Path, random: Random, number: int, times: int) -> Seen:
    """Start a gateway again and again, and send it a signal at a random moment; the last one must be whole."""
    robots = steady_robots(hosts(140))
    took_s = []
    async with serving(robots, folder):
        config, log = folder / "gateway.toml", folder / "gateway.log"
        config.write_text(configured(robots), "utf-8")
        for _ in range(times):
            log.write_bytes(b"")
            with spawned([*GATEWAY, "run", "--config", str(config)], log) as process:
                await said(log, '"gateway.started"', process)
                with ExitStack() as stack:
                    listen = _listen(log)
                    request = masked(_TEXT, subscribe(["*"], mode="all"))
                    stack.enter_context(crowd(listen, random.randint(0, 5), request))
                    await anyio.sleep(random.uniform(0.0, 1.0))
                    since_s = time.monotonic()
                    process.send_signal(number)
                    code = await ended(process, 5.0)
                    took_s.append(time.monotonic() - since_s)
            _judge_end(number, code, took_s[-1], log)
        since_s = time.monotonic()
        async with gateway(configured(robots), folder) as running:
            await _all_alive(running.url, robots)
            back_s = time.monotonic() - since_s
    ends = "exit 0" if number == signal.SIGTERM else "killed"
    return Seen(back_s, f"{times} times: {ends} within {max(took_s):.2f} s; then a start until every robot is on")


def _listen(log: Path) -> str:
    text = log.read_text("utf-8")
    return text.split('"listen": "', 1)[1].split('"', 1)[0]


def _judge_end(number: int, code: int | None, took_s: float, log: Path) -> None:
    text = log.read_text("utf-8")
    if number == signal.SIGTERM:
        assert code == 0, f"SIGTERM: exit code {code}\n{text}"
        assert took_s <= _END_S, f"SIGTERM: took {took_s:.2f} s\n{text}"
    else:
        assert code == -signal.SIGKILL, f"SIGKILL: exit code {code}"
    assert "Traceback" not in text, text
    assert '"exception"' not in text, text


async def terminated(folder: Path, random: Random) -> Seen:
    """SIGTERM at random moments, with clients that do not read."""
    return await _struck(folder, random, signal.SIGTERM, 3)


async def killed(folder: Path, random: Random) -> Seen:
    """SIGKILL at random moments: it comes up again as if nothing had been."""
    return await _struck(folder, random, signal.SIGKILL, 2)


async def early_signal(folder: Path, random: Random) -> Seen:
    """SIGTERM while it starts: it ends at once, by the signal or with exit 0."""
    config, log = folder / "gateway.toml", folder / "gateway.log"
    config.write_text(configured([]), "utf-8")
    codes = set()
    for _ in range(3):
        with spawned([*GATEWAY, "run", "--config", str(config)], log) as process:
            await anyio.sleep(random.uniform(0.05, 0.9))
            process.send_signal(signal.SIGTERM)
            codes.add(await ended(process, _END_S))
    assert codes <= {0, -signal.SIGTERM}, codes
    return Seen(note=f"ended within {_END_S:g} s with {sorted(code for code in codes if code is not None)}")


async def out_of_memory(folder: Path, random: Random) -> Seen:
    """No memory can be had any more while clients ask for much: it dies, or what it says is right; never wrong."""
    robots = steady_robots(hosts(160))
    async with serving(robots, folder):
        async with gateway(configured(robots), folder) as running:
            await _all_alive(running.url, robots)
            judge = Watch(running.url)
            async with anyio.create_task_group() as tasks, watching(tasks, judge):
                await judge.begun({robot.name for robot in robots})
                with (
                    _no_memory(running.pid),
                    crowd(running.listen, _NEVER_READ, masked(_TEXT, subscribe(["*"], mode="all"))),
                ):
                    code = await ended(running.process, _HOLD_S)
            wrong = [text for text in judge.broken if "goes from seq" in text or "back in time" in text]
            assert not wrong, wrong
            if code is None:
                back_s = await _all_alive(running.url, robots)
                errors = sorted({str(one["event"]) for one in running.records() if one.get("level") == "error"})
                return Seen(back_s, f"lives on, says nothing wrong; logged as errors: {', '.join(errors) or 'nothing'}")
            assert code != 0, "it ended as if all were well"
        since_s = time.monotonic()
        async with gateway(configured(robots), folder) as running:
            await _all_alive(running.url, robots)
            return Seen(time.monotonic() - since_s, f"ended with code {code}, for its service to start it anew")


@contextmanager
def _no_memory(pid: int) -> Iterator[None]:
    """Give a process no more memory than it has while the context lasts."""
    status = Path(f"/proc/{pid}/status").read_text("ascii")
    size = int(next(line for line in status.splitlines() if line.startswith("VmSize:")).split()[1]) * 1024
    _, hard = resource.prlimit(pid, resource.RLIMIT_AS)
    resource.prlimit(pid, resource.RLIMIT_AS, (size + _ROOM, hard))
    try:
        yield
    finally:
        with suppress(ProcessLookupError):
            resource.prlimit(pid, resource.RLIMIT_AS, (hard, hard))


async def log_closed(folder: Path, random: Random) -> Seen:
    """Whoever reads its log goes away."""
    robots = steady_robots(hosts(180))
    config = folder / "gateway.toml"
    config.write_text(configured(robots), "utf-8")
    reader, writer = os.pipe()
    with (
        os.fdopen(reader, "rb") as log,
        os.fdopen(writer, "wb") as out,
        spawned([*GATEWAY, "run", "--config", str(config)], out) as process,
    ):
        out.close()
        listen = await _started(process, log)
        log.close()
        async with serving(robots, folder):
            back_s = await _all_alive(f"ws://{listen}/ws", robots)
        await anyio.sleep(1.5)  # the loss of every robot was to be logged
        assert process.poll() is None, f"ended with {process.returncode}"
        async with serving(robots, folder):
            back_s = await _all_alive(f"ws://{listen}/ws", robots)
        process.send_signal(signal.SIGTERM)
        code = await ended(process, _END_S)
    assert code == 0, f"exit code {code}"
    return Seen(back_s, "goes on without a log; SIGTERM ends it with exit 0")


async def _started(process: Popen[bytes], log: object) -> str:
    """Read a log until the gateway has started; its address."""
    lines = getattr(log, "readline")  # noqa: B009
    while True:
        line = (await anyio.to_thread.run_sync(lines)).decode()
        assert line, f"ended with {process.poll()}"
        if '"gateway.started"' in line:
            return str(line.split('"listen": "', 1)[1].split('"', 1)[0])


async def port_taken(folder: Path, random: Random) -> Seen:
    """The port that a controller is to call is taken."""
    async with taken(folder) as (stage, taker):
        seen = await port_given_back(stage, taker)
        broken = await stage.broken(frozenset(), 0, None)
        assert not broken, broken
    return seen


TRIALS = (
    Trial("SIGTERM at random moments", terminated),
    Trial("SIGTERM while starting", early_signal),
    Trial("kill -9 at random moments", killed),
    Trial("memory limit hit", out_of_memory),
    Trial("reader of the log gone", log_closed),
    Trial("port of a calling robot taken", port_taken),
)
