"""`robot-gateway status --watch`: the cell at a glance, live, through every cut; into a pipe a plain block a second."""

from __future__ import annotations

import contextlib
import sys
import time
from dataclasses import dataclass, field
from datetime import UTC, datetime

import anyio
import msgspec
from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.segment import Segment, Segments
from rich.styled import Styled
from rich.text import Text

from gateway.api.messages import RobotInfo
from gateway.api.model import Event, Link, LinkStats, Sample
from gateway.cli.common import terminal
from gateway.cli.view import INSECURE, robots_table
from gateway.client import (
    Client,
    ClientError,
    Connected,
    Disconnected,
    Follower,
    Item,
    RequestError,
    Way,
    follow,
    typed,
)

_REFRESH_S = 0.5
_BLOCK_S = 1.0
_TOPICS = ("*/link", "*/link_stats", "*/status", "*/safety", "*/events")


@dataclass(slots=True)
class Seen:
    """What is known of the cell, and whether it is still so.

    Attributes:
        robots: By name, in the order of the configuration.
        latest: The status and safety samples by topic.
        lost: Why there is no connection; None: there is one.
        insecure: Whether the gateway lets anyone in.
    """

    robots: dict[str, RobotInfo] = field(default_factory=dict)
    latest: dict[str, Sample] = field(default_factory=dict)
    lost: str | None = "connecting …"
    insecure: bool = False

    def connected(self, robots: list[RobotInfo], *, insecure: bool) -> None:
        """A connection has begun: nothing of before counts."""
        self.latest.clear()
        self.lost = None
        self.insecure = insecure
        self.has(robots)

    def has(self, robots: list[RobotInfo]) -> None:
        """The cell has these robots now."""
        self.robots = {robot.name: robot for robot in robots}
        self.latest = {name: sample for name, sample in self.latest.items() if name.rpartition("/")[0] in self.robots}

    def take(self, item: Item) -> None:
        """Take what has come."""
        if isinstance(item, Disconnected):
            self.lost = item.reason
        elif isinstance(item, Sample):
            self._take(typed(item) if item.topic.rpartition("/")[2] in {"link", "link_stats"} else item)

    def _take(self, sample: Sample) -> None:
        name = sample.topic.rpartition("/")[0]
        robot = self.robots.get(name)
        if isinstance(sample.data, Link) and robot is not None:
            self.robots[name] = msgspec.structs.replace(robot, link=sample.data)
        elif isinstance(sample.data, LinkStats) and robot is not None:
            told = sample.data
            self.robots[name] = msgspec.structs.replace(
                robot, reject_counts=told.rejects, frames=told.frames, age=told.age
            )
        else:
            self.latest[sample.topic] = sample

    def picture(self, now_us: int, width: int) -> RenderableType:
        """The cell as it is, or as it was, which it says."""
        table = robots_table(self.robots.values(), self.latest, now_us, width)
        if self.insecure:
            table = Group(table, Text.assemble(("insecure: ", "yellow"), INSECURE))
        if self.lost is None:
            return table
        said = Text(f"no connection: {self.lost} - trying again", style="red")
        if not self.robots:
            return said
        return Group(said, Text("What follows is old.", style="bold"), Styled(table, "dim"))


async def watch(gateway: Way) -> None:
    """Show the cell until cancelled; a gateway that goes away is waited for."""
    console = terminal()
    seen = Seen()
    async with follow(gateway, typed=False) as follower, anyio.create_task_group() as tasks:
        for topic in _TOPICS:
            await _subscribe(follower, topic)
        tasks.start_soon(_keep_up, follower, seen)
        if sys.stdout.isatty():
            await _show(console, seen)
        else:
            with contextlib.suppress(SystemExit):  # rich's way of saying that nobody reads the pipe any more
                await _print(console, seen)
        tasks.cancel_scope.cancel()


async def _subscribe(follower: Follower, topic: str) -> None:
    try:
        await follower.subscribe([topic], rate_hz=1 / _REFRESH_S)
    except RequestError as error:
        if error.code != "UNKNOWN_TOPIC":  # no robot has it, or a token is not for it
            raise


async def _keep_up(follower: Follower, seen: Seen) -> None:
    async for item in follower:
        if isinstance(item, Connected) and follower.client is not None:
            await _begin(follower.client, seen)
        elif isinstance(item, Event) and item.kind.startswith("robot.") and follower.client is not None:
            await _look_again(follower.client, seen)
        else:
            seen.take(item)


async def _begin(client: Client, seen: Seen) -> None:
    try:
        seen.connected(await client.robots(), insecure=client.welcome.access == "insecure")
    except ClientError as error:
        seen.lost = error.reason


async def _look_again(client: Client, seen: Seen) -> None:
    """The gateway has taken a new configuration."""
    with contextlib.suppress(ClientError):  # gone, which the next item says
        seen.has(await client.robots())


async def _show(console: Console, seen: Seen) -> None:
    """A screen of its own, so that it can be resized; it is gone afterwards, as with other live tables."""
    with Live(console=console, auto_refresh=False, screen=True) as live:
        while True:
            live.update(_fitting(console, seen.picture(_now_us(), console.width)), refresh=True)
            await anyio.sleep(_REFRESH_S)


async def _print(console: Console, seen: Seen) -> None:
    while True:
        await anyio.sleep(_BLOCK_S)
        console.print(datetime.now(UTC).astimezone().strftime("%H:%M:%S"))
        console.print(seen.picture(_now_us(), console.width))
        console.print()
        sys.stdout.flush()


def _fitting(console: Console, picture: RenderableType) -> RenderableType:
    """As much as the terminal has lines for, and a word about the rest."""
    lines = console.render_lines(picture, pad=False)
    room = console.height - 1
    footer = "Ctrl-C ends it"
    if len(lines) > room:
        footer = f"{len(lines) - room} more lines: enlarge the terminal - {footer}"
    shown = [part for line in lines[:room] for part in (*line, Segment.line())]
    return Group(Segments(shown), Text(footer, style="dim", no_wrap=True))


def _now_us() -> int:
    return time.time_ns() // 1000
