"""Clients that stay healthy while faults happen, and check that every robot but the one under fault goes on."""

from __future__ import annotations

import time
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass, field

import anyio
from anyio.abc import TaskGroup

from gateway.api.messages import Data, Missed
from gateway.api.model import Quality, Sample
from gateway.client import Client, ClientError, connect

SILENT = frozenset({Quality.STALE, Quality.DISCONNECTED})
_POLL_S = 0.01
_FIRST_S = 30.0


@dataclass(slots=True)
class Course:
    """What one topic has said.

    Attributes:
        last: Its newest sample.
        at_s: When that came, on the monotonic clock.
        alive_s: When the newest came that was not silent.
        n_samples: How many came.
        n_silent: How many of them said that nothing comes.
        pause_s: The longest time between two.
    """

    last: Sample
    at_s: float
    alive_s: float = 0.0
    n_samples: int = 0
    n_silent: int = 0
    pause_s: float = 0.0


@dataclass
class Watch:
    """One client of the native door that checks what it gets.

    Attributes:
        url: The gateway's door.
        topics: What it asks for.
        rate_hz: None: every sample; then none may be missing.
        struck: Whether a robot is under fault now, so that its topics are not checked.
        courses: By topic.
        broken: What must not have happened, in words.
    """

    url: str
    topics: tuple[str, ...] = ("*/joints",)
    rate_hz: float | None = None
    struck: Callable[[str], bool] = lambda _robot: False
    courses: dict[str, Course] = field(default_factory=dict)
    broken: list[str] = field(default_factory=list)

    async def run(self) -> None:
        """Read until cancelled, or until the connection ends."""
        try:
            async with connect(self.url) as client:
                mode = "all" if self.rate_hz is None else "latest"
                await client.subscribe(self.topics, mode=mode, rate_hz=self.rate_hz)  # type: ignore[arg-type]
                await self._read(client)
        except ClientError as error:
            self.broken.append(f"a healthy client lost its connection: {error.reason}")

    async def _read(self, client: Client) -> None:
        async for message in client.pushed():
            now_s = time.monotonic()
            if isinstance(message, Data):
                for sample in message.samples:
                    self._take(sample, now_s)
            elif isinstance(message, Missed) and self.rate_hz is None:
                missed = {topic: count for topic, count in message.samples.items() if not self._is_struck(topic)}
                if missed:
                    self.broken.append(f"a healthy client was told that it missed {missed}")

    def _take(self, sample: Sample, now_s: float) -> None:
        course = self.courses.get(sample.topic)
        if course is None:
            course = self.courses[sample.topic] = Course(sample, now_s)
        elif not self._is_struck(sample.topic):
            self._check(course.last, sample)
            course.pause_s = max(course.pause_s, now_s - course.at_s)
        if sample.q not in SILENT:
            course.alive_s = now_s
        else:
            course.n_silent += 1
        course.last, course.at_s = sample, now_s
        course.n_samples += 1

    def _check(self, before: Sample, sample: Sample) -> None:
        step = sample.seq - before.seq
        if sample.q in SILENT:
            self.broken.append(f"{sample.topic} fell silent ({sample.q}) at seq {sample.seq}")
        elif sample.epoch != before.epoch:
            self.broken.append(f"{sample.topic} has a new epoch: {before.epoch} → {sample.epoch}")
        elif step != 1 if self.rate_hz is None else step < 1:
            self.broken.append(f"{sample.topic} goes from seq {before.seq} to {sample.seq}")
        elif sample.t < before.t:
            self.broken.append(f"{sample.topic} goes back in time by {before.t - sample.t} µs")

    def _is_struck(self, topic: str) -> bool:
        return self.struck(topic.partition("/")[0])

    def of(self, robot: str) -> list[Course]:
        """The courses of a robot's topics."""
        return [course for topic, course in self.courses.items() if topic.partition("/")[0] == robot]

    def alive_since(self, robot: str) -> float:
        """When a robot last said something, monotonic; 0: never."""
        return max((course.alive_s for course in self.of(robot)), default=0.0)

    def is_silent(self, robot: str) -> bool:
        """Whether the last that was said of a robot is that nothing comes."""
        return all(course.last.q in SILENT for course in self.of(robot))

    async def back(self, robot: str, since_s: float, within_s: float, what: str = "live samples") -> float:
        """Wait until a robot says something again.

        Args:
            robot: Its name.
            since_s: When it could again, monotonic.
            within_s: How long it may take.
            what: Is awaited, in words.

        Returns:
            How long it took, in s.
        """
        await self.until(lambda: self.alive_since(robot) > since_s, within_s, f"{what} of {robot}")
        return self.alive_since(robot) - since_s

    def epochs(self, robot: str) -> set[str]:
        """The newest epochs of a robot's topics."""
        return {course.last.epoch for course in self.of(robot)}

    async def renewed(self, robot: str, epochs: set[str], within_s: float) -> float:
        """Wait until a robot says something in a new session: what was under way of the old one counts for nothing.

        Args:
            robot: Its name.
            epochs: Those before its session ended.
            within_s: How long it may take.

        Returns:
            How long it took, in s.
        """
        since_s = time.monotonic()
        await self.until(
            lambda: not self.is_silent(robot) and not epochs & self.epochs(robot),
            within_s,
            f"a new session of {robot}",
        )
        return time.monotonic() - since_s

    async def lost(self, robot: str, within_s: float) -> None:
        """Wait until the gateway says that nothing comes from a robot."""
        await self.until(lambda: self.is_silent(robot), within_s, f"the loss of {robot}")

    async def until(self, holds: Callable[[], bool], within_s: float, what: str) -> None:
        """Wait for something; fail where it takes too long."""
        with anyio.move_on_after(within_s):
            while not holds():  # noqa: ASYNC110 - what comes is many things
                await anyio.sleep(_POLL_S)
            return
        raise AssertionError(f"{what} did not come within {within_s:g} s")

    async def begun(self, robots: set[str]) -> None:
        """Wait until some robots are alive."""
        await self.until(
            lambda: all(self.alive_since(robot) for robot in robots), _FIRST_S, f"the first samples of {robots}"
        )


@asynccontextmanager
async def watching(tasks: TaskGroup, *watches: Watch) -> AsyncIterator[None]:
    """Let clients read while the context lasts."""
    scopes = []

    async def run(watch: Watch) -> None:
        with anyio.CancelScope() as scope:
            scopes.append(scope)
            await watch.run()

    for watch in watches:
        tasks.start_soon(run, watch)
    try:
        yield
    finally:
        for scope in scopes:
            scope.cancel()
