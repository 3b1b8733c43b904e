"""A bus with hand-made robots for the page: every value that it shows is chosen by a test."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import msgspec

from gateway.api.model import (
    EventKind,
    Fault,
    Joints,
    Link,
    LinkState,
    LinkStats,
    Motion,
    OperatingMode,
    Pose,
    Power,
    Program,
    ProgramState,
    Quality,
    Safety,
    SafetyState,
    Severity,
    Status,
    Tcp,
)
from gateway.api.model import Sample as BusSample
from gateway.core.bus import Bus, ValueReading
from gateway.core.events import EventRing
from gateway.core.settings import BrokenRobot, RobotSettings
from gateway.server.cell import Cell
from gateway.server.http import listening
from gateway.server.settings import DoorSettings
from tests.core import toy

GROUPS = ("joints", "tcp", "status", "safety", "link", "link_stats", "events", "vendor")
HALF = 0.7071067811865476
QUARTER = Pose(position=[0.1234, -0.5, 1.0], orientation=[0.0, 0.0, HALF, HALF])
STATUS = Status(
    operating_mode=OperatingMode.AUTOMATIC,
    power=Power.ENABLED,
    motion=Motion.MOVING,
    program=Program(state=ProgramState.RUNNING, name="weld.lua", line=42, total_lines=99),
    speed_override=0.5,
    e_stopped=False,
    faults=[],
)


class HandMade:
    """A cell whose robots say what a test lets them say.

    Attributes:
        bus: Where they say it.
        robots: As configured.
    """

    def __init__(self, *names: str, boot: str = "b00t") -> None:
        self.bus = Bus(EventRing(1000, boot))
        self.robots: list[RobotSettings | BrokenRobot] = []
        self._seq = 0
        for name in names:
            self.robots.append(dataclasses.replace(toy.settings(), name=name))
            self.bus.add(name, GROUPS)
            self.link(name, LinkState.ONLINE)

    def say(
        self, robot: str, data: object, group: str = "joints", q: Quality = Quality.GOOD, t_last: int | None = None
    ) -> None:
        """Publish one sample of a group."""
        self._seq += 1
        name = f"{robot}/{group}"
        sample = BusSample(topic=name, seq=self._seq, epoch="e.1", t=now_us(), q=q, data=data, t_last=t_last)
        self.bus.publish(self.bus.topics[name], ValueReading(sample))

    def link(self, robot: str, state: LinkState, reason: str | None = None) -> None:
        """Publish the state of a link, as if it had just begun."""
        told = Link(state=state, reason=reason, since=now_us(), protocol="polled", peer="192.0.2.1:1", reached_hz=125.0)
        self.say(robot, told, "link")
        self.say(robot, LinkStats(frames=10, age=0.008), "link_stats")

    def work(self, robot: str, turn: float = 0.5) -> None:
        """Publish a robot that is well and at work; its first joint stands at `turn`, rad."""
        self.say(robot, Joints(position=[turn, -turn, None]))
        self.say(robot, Tcp(pose=QUARTER), "tcp")
        self.say(robot, STATUS, "status")
        self.say(robot, Safety(state=SafetyState.NORMAL), "safety")
        self.say(robot, {"angle": [turn, 2.0], "word": {"raw": 3, "moving": 1}, "run_time": 1.5}, "vendor")

    def fail(self, robot: str, text: str, remedy: str) -> None:
        """Publish a fault."""
        fault = Fault(
            code="E1", main=4, sub=3, severity=Severity.ERROR, text=text, joint=2, since=now_us(), remedy=remedy
        )
        self.say(robot, msgspec.structs.replace(STATUS, faults=[fault]), "status")
        self.raise_event(robot, EventKind.FAULT_RAISED, None, fault)

    def lose(self, robot: str) -> None:
        """Publish a link that is lost, as the core does it."""
        last = now_us()
        for group, empty in (("joints", Joints()), ("tcp", Tcp()), ("status", Status()), ("safety", Safety())):
            self.say(robot, empty, group, Quality.DISCONNECTED, last)
        self.link(robot, LinkState.DISCONNECTED, "connection reset by the controller")
        self.raise_event(robot, EventKind.LINK_LOST, "ONLINE", "DISCONNECTED")

    def raise_event(self, robot: str, kind: EventKind, before: object, after: object) -> None:
        """Raise an event."""
        self.bus.raise_event(self.bus.topics[f"{robot}/events"], now_us(), kind, before, after, {"word": 1})


def now_us() -> int:
    """Now, µs since 1970 UTC."""
    return time.time_ns() // 1000


@asynccontextmanager
async def doors(cell: HandMade, port: int = 0, settings: DoorSettings | None = None) -> AsyncIterator[str]:
    """Open the doors; yields the address of the native one."""
    told = settings or DoorSettings(flush_s=0.002)
    async with listening(Cell(cell.robots, cell.bus), "127.0.0.1", port, told) as one:
        yield f"ws://127.0.0.1:{one.port}/ws"
