"""The machine's clock is set, as the gateway sees it: libfaketime in its process, never the machine's own clock."""

from __future__ import annotations

import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass
from pathlib import Path
from random import Random

import anyio

from tests.faults.cell import hosts, steady_robots
from tests.faults.kit import Fault, Series, Stage
from tests.faults.processes import gateway
from tests.faults.report import Seen
from tests.faults.robots import configured, serving

_LIBRARIES = sorted(Path("/usr/lib").glob("*/faketime/libfaketimeMT.so.1"))
# libfaketime looks at its file once a second, the links at their clock as often.
_FOLLOW_S = 10.0
_NEAR_US = 2_000_000
_HOUR_S = 3600


def why_not() -> str | None:
    """Why the clock of one process cannot be set here; None: it can."""
    return None if _LIBRARIES else "libfaketime is missing: apt-get install faketime"


@dataclass
class ClockStage(Stage):
    """A gateway whose clock can be set.

    Attributes:
        offset_s: What its clock is off by.
    """

    offset_s: int = 0

    def set(self, offset_s: int) -> None:
        """Set its clock, relative to the machine's."""
        _write(self.folder / "clock", offset_s)
        self.offset_s = offset_s

    def off_us(self, topic: str) -> int:
        """By how much the newest sample of a topic is off the clock that was set, as far as that can be told."""
        course = self.watch.courses[topic]
        return round(abs(course.last.t - (time.time() + self.offset_s) * 1e6))

    async def followed(self) -> float:
        """Wait until the samples of every robot follow the clock; how long that took."""
        since_s = time.monotonic()
        await self.watch.until(
            lambda: all(self.off_us(topic) < _NEAR_US for topic in self.watch.courses), _FOLLOW_S, "the new time"
        )
        return time.monotonic() - since_s


def _write(path: Path, offset_s: int) -> None:
    """Tell libfaketime; it must never read half a line."""
    new = path.with_suffix(".new")
    new.write_text(f"{offset_s:+d}\n", "ascii")
    new.replace(path)


@asynccontextmanager
async def clock(folder: Path) -> AsyncIterator[ClockStage]:
    """Run the cell with a clock that can be set."""
    steady = steady_robots(hosts(60))
    _write(folder / "clock", 0)
    env = {
        "LD_PRELOAD": str(_LIBRARIES[0]),
        "FAKETIME_TIMESTAMP_FILE": str(folder / "clock"),
        "FAKETIME_CACHE_DURATION": "1",
        "FAKETIME_DONT_FAKE_MONOTONIC": "1",
        "DONT_FAKE_MONOTONIC": "1",
    }
    async with (
        anyio.create_task_group() as tasks,
        serving(steady, folder),
        gateway(configured(steady), folder, env=env) as running,
    ):
        stage = ClockStage(running, tasks, folder, frozenset(robot.name for robot in steady))
        async with stage.watched():
            yield stage


async def forward(stage: ClockStage, random: Random) -> Seen:
    """The clock is set forward by hours: the epochs go on."""
    stage.set(stage.offset_s + random.randint(1, 5) * _HOUR_S)
    followed_s = await stage.followed()
    return Seen(followed_s, "same epoch, no gap, nothing stale; the times follow")


async def back(stage: ClockStage, random: Random) -> Seen:
    """The clock is set back by hours: a new epoch begins, and nothing falls silent."""
    courses = stage.watch.courses
    silent = {topic: course.n_silent for topic, course in courses.items()}
    epochs = {topic: course.last.epoch for topic, course in courses.items()}
    async with stage.striking(*stage.steady):  # a new epoch is what is asked for
        stage.set(stage.offset_s - random.randint(1, 5) * _HOUR_S)
        followed_s = await stage.followed()
    assert silent == {topic: course.n_silent for topic, course in courses.items()}, "something fell silent"
    same = [topic for topic, course in courses.items() if course.last.epoch == epochs[topic]]
    assert not same, f"no new epoch on {same}"
    return Seen(followed_s, "a new epoch, nothing stale; the times follow")


CLOCK = Series(
    name="clock",
    open=clock,
    faults=(
        Fault(name="clock set forward by hours", strike=forward),
        Fault(name="clock set back by hours", strike=back),
    ),
)
