"""Sixty-four robots, half of them under chaos: nothing reaches the top, memory is flat, the other half has no gap."""

from __future__ import annotations

import time
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from random import Random
from typing import ClassVar

import anyio

from tests.faults.cell import hosts
from tests.faults.kit import FLAT, Fault, Series, Stage
from tests.faults.processes import gateway
from tests.faults.report import Seen
from tests.faults.robots import PATIENT_S, Controllers, Robot, configured

_ROBOTS = 64
_SPOKEN = (("rainbow", "reqdata"), ("fairino", "cnde"), ("xcore", "objects"), ("rainbow", "reqdata"))
_SLOW: dict[str, dict[str, object]] = {"rainbow": {"rate_hz": 10}, "fairino": {"cnde": {"period_ms": 100}}, "xcore": {}}
# From RATE a frame to times in s: everything that the virtual controllers can do wrong.
_CHAOS = (
    "split=0.1,coalesce=0.05,skip=0.05,double=0.01,junk=0.05,header=0.01,corrupt=0.01,checksum=0.01,tail=0.01,"
    "delay=0.02/0.3,stall=2/17,cut=11"
)
# Rings of events fill for as long as they are not full, which is no leak: here they are soon.
_SERVER = "event_ring = 500\ncommand_ring = 500\n"
SHORT_S = 10.0
LONG_S = 600.0
_LOOK_S = 1.0
# A share of the run until caches are filled and every kind of fault has happened; the short form has no time for it.
_WARM = 1 / 3
_SHORT_FLAT = 1.25
_BACK_S = 20.0


@dataclass
class ManyStage(Stage):
    """A gateway with many robots.

    Attributes:
        shaken: The names of those under chaos.
    """

    shaken: tuple[str, ...]

    slack: ClassVar[int] = 3 * _ROBOTS // 2  # some of their links are always down


@asynccontextmanager
async def many(folder: Path) -> AsyncIterator[ManyStage]:
    """Run them."""
    host = hosts(10)
    calm, shaken = (
        [
            Robot(
                name=f"{letter}{number}",
                vendor=vendor,
                protocol=protocol,
                host=host(),
                chaos=chaos,
                keys={**_SLOW[vendor], **({} if chaos else {"stale_s": PATIENT_S})},
            )
            for number, (vendor, protocol) in enumerate(_SPOKEN * (_ROBOTS // 2 // len(_SPOKEN)), start=1)
        ]
        for letter, chaos in (("h", ""), ("x", _CHAOS))
    )
    async with AsyncExitStack() as stack:
        tasks = await stack.enter_async_context(anyio.create_task_group())
        for robots in (calm, shaken):
            controllers = Controllers(robots, folder)
            stack.push_async_callback(controllers.kill)
            await controllers.start()
        running = await stack.enter_async_context(gateway(configured([*calm, *shaken], server=_SERVER), folder))
        names = tuple(robot.name for robot in shaken)
        stage = ManyStage(running, tasks, folder, frozenset(robot.name for robot in calm), names)
        async with stage.striking(*names), stage.watched():  # nothing is asked of them but that they return
            yield stage


async def chaos(seconds: float, flat: float, stage: ManyStage, random: Random) -> Seen:
    """Let half of the robots suffer for a time."""
    memory_kib = []
    since_s = time.monotonic()
    while time.monotonic() < since_s + seconds:
        await anyio.sleep(_LOOK_S)
        memory_kib.append((await stage.gateway.usage()).memory_kib)
    at_s = time.monotonic() if seconds >= LONG_S / 10 else since_s  # in the short form: at any time of it
    for name in stage.shaken:
        await stage.watch.back(name, at_s, _BACK_S)
    warm, last = memory_kib[int(len(memory_kib) * _WARM)], memory_kib[-1]
    assert last <= flat * warm, f"memory: {warm} → {last} KiB"
    samples = sum(course.n_samples for name in stage.steady for course in stage.watch.of(name))
    return Seen(
        note=f"{_ROBOTS} robots, {seconds:g} s: {samples} samples of the healthy half, memory {warm / 1024:.1f} → "
        f"{last / 1024:.1f} MiB after a third of the time; all of the others came back",
    )


def series(seconds: float) -> Series[ManyStage]:
    """The run, of some length."""
    strike = partial(chaos, seconds, FLAT if seconds >= LONG_S / 2 else _SHORT_FLAT)
    return Series(
        name="many",
        open=many,
        faults=(Fault(name="half of 64 robots under chaos", strike=strike),),
        stay_s=0.0,
        flat=False,
    )
