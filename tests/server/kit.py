"""What the tests of the doors share: a bus with hand-made readings, a door on a free port, a plain client."""

from __future__ import annotations

import dataclasses
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager

import aiohttp
import anyio
import msgspec

from gateway.api.messages import JSON_SUBPROTOCOL
from gateway.api.model import EventKind, Joints, Link, LinkState, Quality, Sample, Status
from gateway.core.bus import Bus, Topic, ValueReading
from gateway.core.events import EventRing
from gateway.core.settings import BrokenRobot, RobotSettings
from gateway.server.cell import Cell
from gateway.server.http import listening
from gateway.server.settings import DoorSettings
from tests.core import toy

BOOT = "b00t"
T = 1_700_000_000_000_000
Robot = RobotSettings | BrokenRobot
Message = dict[str, object]


class Now:
    """A monotonic clock that stands until it is set."""

    def __init__(self, at_s: float = 1000.0) -> None:
        self.at_s = at_s

    def __call__(self) -> float:
        """The time in s."""
        return self.at_s


class CountingReading(ValueReading):
    """A reading that counts how often it is normalised."""

    asked = 0

    def sample(self, topic: Topic) -> Sample:
        """The sample."""
        self.asked += 1
        return super().sample(topic)


def cell(*names: str, ring: int = 10_000, command_ring: int | None = None) -> tuple[Bus, list[Robot]]:
    """A bus with some robots of the toy vendor; of their topics only the link has a value.

    Args:
        names: Of the robots.
        ring: How many events are kept.
        command_ring: How many command objects are kept; None: the robots tell of none.
    """
    bus = Bus(EventRing(ring, BOOT), command_ring or 1)
    robots: list[Robot] = [dataclasses.replace(toy.settings(), name=name) for name in names or ("r1", "r2")]
    for robot in robots:
        bus.add(robot.name, ["joints", "status", "events", "link", "link_stats", "vendor"])
        if command_ring:
            bus.add(robot.name, ["commands"])
        link = Link(state=LinkState.ONLINE, since=T, protocol="polled", peer="192.0.2.1:1")
        publish(bus, f"{robot.name}/link", 1, link)
    return bus, robots


def reading(topic: str, seq: int, data: object = None) -> CountingReading:
    """A reading of joints whose first position is its seq, or of other data."""
    told = Joints(position=[float(seq), None]) if data is None else data
    return CountingReading(Sample(topic=topic, seq=seq, epoch="e.1", t=T + seq, q=Quality.GOOD, data=told))


def publish(bus: Bus, topic: str, seq: int, data: object = None) -> CountingReading:
    """Publish one reading."""
    made = reading(topic, seq, data)
    bus.publish(bus.topics[topic], made)
    return made


def publish_status(bus: Bus, topic: str, seq: int, *, in_motion: bool) -> None:
    """Publish a state."""
    publish(bus, topic, seq, Status(in_motion=in_motion))


def raise_event(bus: Bus, robot: str) -> None:
    """Raise an event."""
    bus.raise_event(bus.topics[f"{robot}/events"], T, EventKind.MOTION_STARTED, "STANDSTILL", "MOVING", {"word": 1})


def raise_command(bus: Bus, robot: str, number: int = 0, t: int = T) -> str:
    """Tell of a command object; its name."""
    topic = bus.topics[f"{robot}/commands"]
    bus.raise_event(topic, t, EventKind.COMMAND_ISSUED, None, number, {})
    return last_name(bus, topic.name)


def last_name(bus: Bus, name: str) -> str:
    """The name of the newest event of a topic's ring."""
    ring = bus.topics[name].ring
    assert ring is not None
    return ring.last_name


@asynccontextmanager
async def running_door(
    bus: Bus,
    robots: Sequence[Robot],
    *,
    flush_s: float = 0.0,
    stuck_s: float = 10.0,
    settings: DoorSettings | None = None,
) -> AsyncIterator[str]:
    """Open the doors on a free port; yields the address of the native one."""
    async with listening(Cell(robots, bus), "127.0.0.1", 0, settings or DoorSettings(flush_s=flush_s), stuck_s) as one:
        yield f"ws://127.0.0.1:{one.port}/ws"


class Talk:
    """A client that sends and receives plain objects."""

    def __init__(self, socket: aiohttp.ClientWebSocketResponse) -> None:
        self.socket = socket
        self.text = socket.protocol in {None, JSON_SUBPROTOCOL}

    async def send(self, message: object) -> None:
        """Send one message."""
        if self.text:
            await self.socket.send_str(msgspec.json.encode(message).decode())
        else:
            await self.socket.send_bytes(msgspec.msgpack.encode(message))

    async def receive(self, op: str | None = None) -> Message:
        """Receive the next message, or the next with some `op`."""
        with anyio.fail_after(5):
            while True:
                frame = await self.socket.receive()
                assert frame.type is (aiohttp.WSMsgType.TEXT if self.text else aiohttp.WSMsgType.BINARY), frame
                found = msgspec.json.decode(frame.data) if self.text else msgspec.msgpack.decode(frame.data)
                assert isinstance(found, dict)
                if op is None or found["op"] == op:
                    return found

    async def ask(self, op: str, **values: object) -> Message:
        """Send a request and receive its answer."""
        request = {"op": op, "id": 7, **values}
        await self.send(request)
        while True:
            answer = await self.receive()
            if answer["op"] in {"result", "error"}:
                return answer

    async def samples(self) -> list[Message]:
        """The samples of the next data message."""
        found = (await self.receive("data"))["samples"]
        assert isinstance(found, list)
        return found

    async def close_code(self) -> int | None:
        """Read to the end; the code of the close frame."""
        with anyio.fail_after(5):
            async for _ in self.socket:
                pass
        return self.socket.close_code


@asynccontextmanager
async def talking(url: str, protocol: str = JSON_SUBPROTOCOL) -> AsyncIterator[Talk]:
    """Connect and take the welcome."""
    async with aiohttp.ClientSession() as session, session.ws_connect(url, protocols=(protocol,)) as socket:
        talk = Talk(socket)
        assert (await talk.receive())["op"] == "welcome"
        yield talk
