"""A fault, a series of them against one gateway, and the rules that hold after each: the same code short and long."""

from __future__ import annotations

import time
from collections.abc import AsyncIterator, Awaitable, Callable, Sequence
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from dataclasses import dataclass, field
from pathlib import Path
from random import Random
from typing import ClassVar, Generic, Protocol, TypeVar

import anyio
from anyio.abc import TaskGroup

from tests.faults.processes import GatewayProcess, Usage
from tests.faults.report import Report, Seen, Stay
from tests.faults.watch import Watch, watching

# What may be there besides what was there before: a connection that is just being tried, a look at /metrics.
_SLACK = 3
# Worker threads of the loop and of its name look-ups are made once and stay: a pool has an end.
_MOST_THREADS = 24
_SETTLE_S = 8.0
_FLOW_S = 2.0
# Until the client at a rate, too, has seen the last of a fault.
_AFTERMATH_S = 0.4
# Of a short stay, in which caches still fill; the long form is held to a share.
_SHORT_GROWTH_KIB = 24 * 1024
FLAT = 1.05
_WARM_ROUNDS = 2

_Stage = TypeVar("_Stage", bound="Stage")


@dataclass
class Stage:
    """A gateway with its robots and the clients that watch it.

    Attributes:
        gateway: The process under test.
        tasks: Where a stage runs what it needs.
        folder: For files.
        steady: The robots that nothing ever happens to.
        watch: The client that gets every sample.
        second: Another client, at a rate.
        slack: How many tasks and file descriptors more than before are no leak.
    """

    slack: ClassVar[int] = _SLACK

    gateway: GatewayProcess
    tasks: TaskGroup
    folder: Path
    steady: frozenset[str]
    watch: Watch = field(init=False)
    second: Watch = field(init=False)
    _struck: set[str] = field(init=False, default_factory=set)

    def __post_init__(self) -> None:
        struck = self.is_struck
        self.watch = Watch(self.gateway.url, struck=struck)
        self.second = Watch(self.gateway.url, ("*/tcp", "*/status"), rate_hz=10.0, struck=struck)

    def is_struck(self, robot: str) -> bool:
        """Whether a robot is under fault now."""
        return robot in self._struck

    @asynccontextmanager
    async def striking(self, *robots: str) -> AsyncIterator[None]:
        """Let something happen to robots: while the context lasts they are not held to the rules."""
        self._struck.update(robots)
        try:
            yield
            await anyio.sleep(_AFTERMATH_S)
        finally:
            self._struck.difference_update(robots)

    @asynccontextmanager
    async def watched(self, robots: set[str] | None = None) -> AsyncIterator[None]:
        """Let the clients watch; begins when the robots, by default the steady ones, are alive.

        Args:
            robots: All that are alive at the start.
        """
        awaited = set(robots or self.steady)
        async with watching(self.tasks, self.watch, self.second):
            async with self.striking(*awaited):  # while they start, sessions begin
                await self.watch.begun(awaited)
            yield

    async def broken(self, allowed: frozenset[str], since: int, before: Usage | None) -> list[str]:
        """Which rules do not hold now.

        Args:
            allowed: Log events of level error that the fault may bring.
            since: From where in the log.
            before: What the gateway took before any fault; None: it is not known yet.
        """
        found = [*self.watch.broken, *self.second.broken]
        self.watch.broken.clear()
        self.second.broken.clear()
        now_s = time.monotonic()
        quiet = [robot for robot in sorted(self.steady) if now_s - self.watch.alive_since(robot) > _FLOW_S]
        if quiet:
            found.append(f"nothing comes any more of {', '.join(quiet)}")
        found += _bad_records(self.gateway, since, allowed)
        if before is not None:
            found += await self._leaks(before)
        return found

    async def _leaks(self, before: Usage) -> list[str]:
        """What of the machine has not been given back."""
        leaks: list[str] = []
        with anyio.move_on_after(_SETTLE_S):
            while True:
                now = await self.gateway.usage()
                leaks = []
                if now.tasks > before.tasks + self.slack:
                    leaks.append(f"tasks: {before.tasks} → {now.tasks}")
                if now.fds > before.fds + self.slack:
                    leaks.append(f"file descriptors: {before.fds} → {now.fds}")
                if now.threads > max(_MOST_THREADS, before.threads):
                    leaks.append(f"threads: {before.threads} → {now.threads}")
                if not leaks:
                    break
                await anyio.sleep(0.2)
        return leaks


def _bad_records(gateway: GatewayProcess, since: int, allowed: frozenset[str]) -> list[str]:
    """What of the log should not be there."""
    return [
        f"logged {record['event']}: {record.get('exception', record.get('reason', record))}"
        for record in gateway.records(since)
        if (record.get("level") in {"error", "critical"} or "exception" in record) and record["event"] not in allowed
    ]


@dataclass(frozen=True, slots=True, kw_only=True)
class Fault(Generic[_Stage]):
    """One fault.

    Attributes:
        name: For the report.
        strike: Makes it happen, ends it, and waits for the recovery.
        logs: Events of level error that it may bring.
    """

    name: str
    strike: Callable[[_Stage, Random], Awaitable[Seen]]
    logs: frozenset[str] = frozenset()


@dataclass(frozen=True, slots=True, kw_only=True)
class Series(Generic[_Stage]):
    """Faults that need the same stage.

    Attributes:
        name: For the report.
        open: Makes the stage: a fresh gateway.
        faults: What happens on it, in the short form once each.
        more: What happens besides in the long form.
        stay_s: How long one gateway lives in the long form.
        flat: Whether its memory is held to a share.
    """

    name: str
    open: Callable[[Path], AbstractAsyncContextManager[_Stage]]
    faults: Sequence[Fault[_Stage]]
    more: Sequence[Fault[_Stage]] = ()
    stay_s: float = 240.0
    flat: bool = True

    async def run(self, folder: Path, random: Random, report: Report, long_s: float = 0.0) -> None:
        """Let the faults happen: each once, or in random order for a time; fills the report.

        Args:
            folder: For files; made.
            random: Decides.
            report: Takes what is seen.
            long_s: How long at least; 0: each once in order.
        """
        made(folder)
        end_s = time.monotonic() + min(long_s, self.stay_s)
        async with self.open(folder) as stage:
            first = before = await stage.gateway.usage()
            n_strikes = 0
            while n_strikes < len(self.faults) or time.monotonic() < end_s:
                in_order = n_strikes < len(self.faults)
                fault = self.faults[n_strikes] if in_order else random.choice([*self.faults, *self.more])
                if n_strikes == len(self.faults) * _WARM_ROUNDS:
                    before = await stage.gateway.usage()
                if not await self._strike(stage, fault, random, report, first):
                    break
                n_strikes += 1
            after = await stage.gateway.usage()
            self._note_stay(stage, before, after, report, warm=n_strikes > len(self.faults) * _WARM_ROUNDS)

    async def _strike(self, stage: _Stage, fault: Fault[_Stage], random: Random, report: Report, before: Usage) -> bool:
        """Let one fault happen; whether the stage is still of use."""
        row = report.row(self.name, fault.name)
        since = stage.gateway.n_said
        try:
            row.add(await fault.strike(stage, random))
        except (AssertionError, OSError, TimeoutError) as error:
            row.times += 1
            row.broken.append(f"{type(error).__name__}: {error}")
            row.broken += _bad_records(stage.gateway, since, fault.logs)
            return stage.gateway.process.poll() is None
        row.broken += await stage.broken(fault.logs, since, before)
        return True

    def _note_stay(self, stage: _Stage, before: Usage, after: Usage, report: Report, *, warm: bool) -> None:
        steady = [course for robot in stage.steady for course in stage.watch.of(robot)]
        pause_s = max((course.pause_s for course in steady), default=0.0)
        report.stays.append(Stay(self.name, before, after, sum(course.n_samples for course in steady), pause_s))
        growth_kib = after.memory_kib - before.memory_kib
        limit_kib = before.memory_kib * (FLAT - 1) if warm else _SHORT_GROWTH_KIB
        if self.flat and growth_kib > limit_kib:
            row = report.row(self.name, "memory")
            row.broken.append(f"memory: {before.memory_kib} → {after.memory_kib} KiB")


class Turn(Protocol):
    """A series or a trial."""

    @property
    def name(self) -> str:
        """For the report."""
        ...

    async def run(self, folder: Path, random: Random, report: Report, long_s: float = 0.0) -> None:
        """Let it happen; fills the report."""
        ...


def made(folder: Path) -> Path:
    """A folder, made where it is not there."""
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def seeded(seed: int = 1) -> Random:
    """What decides in the short form: the same in every run."""
    return Random(seed)  # noqa: S311 - faults, no secret
