"""The set of running links: each in a cancel scope of its own, so that one is added, replaced or taken away alone."""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable, Collection, Iterable, Mapping
from contextlib import asynccontextmanager
from dataclasses import dataclass, field

import anyio
import structlog
from anyio.abc import TaskGroup

from gateway.api.model import EventKind
from gateway.core.backoff import REFUSED_S, Backoff, backoff
from gateway.core.bus import Bus, Topic
from gateway.core.clock import Clock
from gateway.core.link import BROKEN_GROUPS, Link, announce_broken
from gateway.core.settings import BrokenRobot, RobotSettings
from gateway.core.tap import Tap
from gateway.core.transport import Connector
from gateway.errors import VendorError

_LOG = structlog.get_logger()
REMOVED = "removed from the configuration"
CHANGED = "changed in the configuration: connecting anew"

Robot = RobotSettings | BrokenRobot
Said = Mapping[str, tuple[object, object]]


@dataclass(slots=True)
class _Running:
    """One robot as it runs.

    Attributes:
        robot: Its settings.
        link: None where the plugin is broken.
        scope: Ends its task.
        ended: Set when the task is over, everything closed.
    """

    robot: Robot
    link: Link | None
    scope: anyio.CancelScope = field(default_factory=anyio.CancelScope)
    ended: anyio.Event = field(default_factory=anyio.Event)

    @property
    def groups(self) -> Collection[str]:
        return BROKEN_GROUPS if self.link is None else self.link.groups


class Links:
    """Keeps the links of all robots.

    Their topics are there at once; the controllers are called after `start`, inside `running`.

    Args:
        robots: Whom to begin with.
        bus: Where they publish.
        clock: Both times.
        connector_of: How a robot is reached.
        delays: Makes a new series of delays between the attempts of a link.
        tap_of: Makes what is shown every byte of a robot's sessions; None: nothing is.
    """

    def __init__(
        self,
        robots: Iterable[Robot],
        bus: Bus,
        clock: Clock,
        connector_of: Callable[[RobotSettings], Connector],
        delays: Backoff = backoff,
        tap_of: Callable[[RobotSettings], Tap | None] | None = None,
    ) -> None:
        self._bus = bus
        self._tap_of = tap_of
        self._clock = clock
        self._connector_of = connector_of
        self._delays = delays
        self._tasks: TaskGroup | None = None
        self._running = {robot.name: _Running(robot, self._made(robot)) for robot in robots}

    @property
    def robots(self) -> dict[str, Robot]:
        """The robots as they run, by name."""
        return {name: one.robot for name, one in self._running.items()}

    @property
    def holding(self) -> frozenset[str]:
        """The robots with an open session that must not be dropped."""
        return frozenset(name for name, one in self._running.items() if one.link is not None and one.link.holds_session)

    @asynccontextmanager
    async def running(self) -> AsyncIterator[None]:
        """Hold the links' tasks for as long as the context lasts."""
        async with anyio.create_task_group() as self._tasks:
            try:
                yield
            finally:
                self._tasks.cancel_scope.cancel()

    def start(self) -> None:
        """Call every controller."""
        for one in self._running.values():
            self._start(one)

    def stop(self) -> None:
        """Let every link end, without waiting for it."""
        for one in self._running.values():
            one.scope.cancel()

    async def apply(
        self, robots: Iterable[Robot], *, stopped: Iterable[str], before_start: Callable[[], None] = lambda: None
    ) -> None:
        """Take other robots; every link but those that are named runs on and notices nothing.

        All of those have ended before the first new one begins: two of them may have exchanged their controllers.

        Args:
            robots: All that shall run, in order; those whose link stays are the records that run.
            stopped: Robots that are changed or removed.
            before_start: Called when the topics are the new ones and nobody has been told.
        """
        going = [self._running[name] for name in stopped]
        await _end(going)
        was = dict(self._running)
        topics = set(self._bus.topics.values())
        wanted = {robot.name: robot for robot in robots}
        gone = [topic for one in going for topic in self._left(one, wanted.get(one.robot.name))]
        self._bus.remove(gone)
        over = {one.robot.name for one in going}
        self._running = {
            name: was[name] if name in was and name not in over else _Running(robot, self._made(robot))
            for name, robot in wanted.items()
        }
        gone += self._vanished(over)
        before_start()
        self._bus.announce([topic for topic in self._bus.topics.values() if topic not in topics], gone)
        for name, one in self._running.items():
            if one is not was.get(name):
                kind = EventKind.ROBOT_CHANGED if name in was else EventKind.ROBOT_ADDED
                self._raise(name, kind, was[name].robot if name in was else None, one.robot)
                self._start(one)

    def wait(self, notes: Mapping[str, str], on_free: Callable[[], None]) -> None:
        """Show on some links, and on no others, that a new configuration waits; called back when a session ends.

        Args:
            notes: What to say, by robot.
            on_free: Called when one of their sessions has ended.
        """
        for name, one in self._running.items():
            if one.link is not None and name in notes:
                one.link.wait(notes[name], on_free)
            elif one.link is not None:
                one.link.wait_no_more()

    def _made(self, robot: Robot) -> Link | None:
        """The link of a robot; a plugin that cannot even begin is shown like one that cannot be loaded."""
        broken = robot
        if isinstance(robot, RobotSettings):
            try:
                tap = None if self._tap_of is None else self._tap_of(robot)
                return Link(robot, self._connector_of(robot), self._bus, self._clock, self._delays, tap)
            except (Exception, SystemExit) as error:  # noqa: BLE001 - a plugin's mistake costs its robot and no other
                broken = _as_broken(robot, error)
        if isinstance(broken, BrokenRobot):
            announce_broken(broken, self._bus, self._clock)
        return None

    def _left(self, one: _Running, successor: Robot | None) -> list[Topic]:
        """Let a link that has ended say so on its topics; those of a robot that is removed are to go."""
        name = one.robot.name
        if one.link is not None:
            one.link.leave(CHANGED if successor else REMOVED)
        if successor is not None:
            return []
        self._raise(name, EventKind.ROBOT_REMOVED, one.robot, None)
        return self._bus.of(name)

    def _vanished(self, changed: Iterable[str]) -> list[Topic]:
        """Take away the topics that changed robots had and have no longer."""
        gone: list[Topic] = []
        for name in changed:
            if name in self._running:
                kept = self._running[name].groups
                gone += [topic for topic in self._bus.of(name) if topic.group.name not in kept]
        self._bus.remove(gone)
        return gone

    def _start(self, one: _Running) -> None:
        if self._tasks is None:
            raise RuntimeError("the links do not run")
        self._tasks.start_soon(self._keep, one)

    async def _keep(self, one: _Running) -> None:
        """Run one link until its scope is cancelled; what it cannot catch by itself costs the other links nothing."""
        try:
            with one.scope:
                while one.link is not None:
                    try:
                        await one.link.run()
                    except (Exception, SystemExit):  # noqa: BLE001 - what a link itself could not catch
                        _LOG.exception("link.faulted", robot=one.robot.name)
                        one.link.leave("internal error, see the log")
                        await anyio.sleep(REFUSED_S)
        finally:
            one.ended.set()

    def _raise(self, name: str, kind: EventKind, before: Robot | None, after: Robot | None) -> None:
        topic = self._bus.topics[f"{name}/events"]
        self._bus.raise_event(topic, self._clock.utc_us(), kind, _title(before), _title(after), {})


async def _end(going: Collection[_Running]) -> None:
    """End some links, all at the same time, and wait until everything of theirs is closed."""
    for one in going:
        one.scope.cancel()
    for one in going:
        await one.ended.wait()


def _title(robot: Robot | None) -> str | None:
    """A robot in a word: its vendor and protocol."""
    if robot is None:
        return None
    if isinstance(robot, BrokenRobot):
        return f"{robot.vendor} {robot.protocol}".strip()
    return f"{robot.vendor.name} {robot.protocol.name}"


def _as_broken(robot: RobotSettings, error: BaseException) -> BrokenRobot:
    return BrokenRobot(
        name=robot.name,
        host=robot.host,
        vendor=robot.vendor.name,
        protocol=robot.protocol.name,
        error=VendorError(robot.vendor.name, f"the plugin failed before it was connected: {error!r}"),
    )
