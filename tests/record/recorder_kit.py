"""A recorder without a gateway: a clock that may be set, robots that say what a test wants, writers with faults."""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import cast

import anyio

from gateway.api.model import EventKind
from gateway.core.bus import Bus
from gateway.core.events import EventRing
from gateway.record.filing import Filing
from gateway.record.recorder import Recorder
from gateway.record.settings import RecorderSettings
from gateway.record.spool import Begin, End, Message, Outcome, Raw


class Clock:
    """Both times: the monotonic one is the loop's, the other one may be set."""

    def __init__(self) -> None:
        self.offset_us = 1_700_000_000_000_000

    def monotonic(self) -> float:
        return anyio.current_time()

    def utc_us(self) -> int:
        return int(self.monotonic() * 1e6) + self.offset_us

    def stamp(self, at_s: float) -> int:
        return int(at_s * 1e6) + self.offset_us


class Told:
    """What a publisher has told so far."""

    epoch = "b00t.1"
    seqs = 0
    faults = ()


@dataclass
class FakeFiling:
    """A writer that keeps what it gets; it may be slow, or fail."""

    path: Path
    gate: anyio.Event
    outcome: Outcome
    got: list[Message] = field(default_factory=list)
    broken: bool = False
    killed: bool = False
    is_stuck: bool = False

    async def send(self, message: Message) -> None:
        await anyio.lowlevel.checkpoint()
        if self.is_stuck:
            await anyio.sleep(0.05)
        self.got.append(message)

    def kill(self) -> None:
        self.broken = self.killed = True

    async def finished(self) -> Outcome:
        await self.gate.wait()
        return self.outcome

    @property
    def begin(self) -> Begin:
        return next(message for message in self.got if isinstance(message, Begin))

    @property
    def end(self) -> End:
        return next(message for message in self.got if isinstance(message, End))

    @property
    def data(self) -> list[bytes]:
        blocks = [message.block for message in self.got if isinstance(message, Raw)]
        return [chunk.data for block in blocks for chunk in block.chunks() if chunk.kind == "received"]


class Writers:
    """Starts such writers.

    Attributes:
        made: All of them.
        gate: Lets them finish.
        outcome: What becomes of their files.
    """

    def __init__(self) -> None:
        self.made: list[FakeFiling] = []
        self.gate = anyio.Event()
        self.gate.set()
        self.outcome = Outcome(n_bytes=1)
        self.is_stuck = False

    @asynccontextmanager
    async def opened(self, path: Path) -> AsyncIterator[Filing]:
        made = FakeFiling(path, self.gate, self.outcome, is_stuck=self.is_stuck)
        self.made.append(made)
        yield cast("Filing", made)


@dataclass
class Kit:
    """A recorder that runs, and what it stands on."""

    recorder: Recorder
    bus: Bus
    clock: Clock
    writers: Writers

    def robot(self, name: str) -> None:
        """Add a robot with a session."""
        added = list(self.bus.add(name, ["link", "events"]).values())
        self.recorder.tap(name).begin(self.clock.monotonic(), self.clock.stamp, Told())
        self.bus.announce(added, [])

    def say(self, name: str, data: bytes) -> None:
        """Let a robot say something."""
        self.recorder.rings[name].received(data, self.clock.monotonic())

    def happen(self, name: str, kind: EventKind) -> None:
        """Let something happen to a robot."""
        self.bus.raise_event(self.bus.topics[f"{name}/events"], self.clock.utc_us(), kind, None, None, {})

    async def until(self, is_so: Callable[[], bool]) -> None:
        """Wait until something is so."""
        with anyio.fail_after(10):
            while not is_so():  # noqa: ASYNC110
                await anyio.sleep(0.005)


@asynccontextmanager
async def running_recorder(folder: Path, **settings: object) -> AsyncIterator[Kit]:
    """A recorder with short times that runs."""
    values: dict[str, object] = {"directory": folder, "before_s": 0.5, "after_s": 0.1, **settings}
    bus, clock, writers = Bus(EventRing(100)), Clock(), Writers()
    made = RecorderSettings(**values)  # type: ignore[arg-type]
    recorder = Recorder(made, bus, clock, lambda: ("", []), writers.opened)
    recorder.watch()
    async with anyio.create_task_group() as tasks:
        tasks.start_soon(recorder.run)
        yield Kit(recorder, bus, clock, writers)
        tasks.cancel_scope.cancel()
