"""The lasting association with a robot: connects, runs sessions, backs off, and never gives up."""

from __future__ import annotations

import contextlib
import secrets
from collections.abc import Callable, Sequence

import anyio
import msgspec
import structlog

from gateway.api.decoder import Decoder, Entry, Event, Frame, Occurrence, Refused, RefusedKind, Table
from gateway.api.layout import Layout
from gateway.api.model import CommandsMissed, EventKind, LinkState, Quality
from gateway.api.model import Link as LinkData
from gateway.api.normaliser import Normaliser
from gateway.api.vendor import DecoderFactory
from gateway.core.allowed import AllowedDecoder
from gateway.core.backoff import REFUSED_S, Backoff, backoff
from gateway.core.bus import Bus, Topic
from gateway.core.clock import Clock, Timeline
from gateway.core.controller_clock import ControllerClock
from gateway.core.counters import LinkCounters
from gateway.core.kept import KeptDecoder
from gateway.core.own_topic import OwnTopic
from gateway.core.publisher import Publisher
from gateway.core.repeats import Repeats
from gateway.core.session import Session
from gateway.core.settings import BrokenRobot, RobotSettings
from gateway.core.tap import Tap
from gateway.core.transport import Connector
from gateway.errors import LinkClosed, LinkError, LinkRefused, LinkStale

_LOG = structlog.get_logger()
# A session that was online for so long makes the next delays short again: a link that flaps does not flood the events.
STEADY_S = 1.0
# The topics of a robot whose plugin is broken.
BROKEN_GROUPS = ("link", "events")
_REFUSED_STATES: dict[str | None, LinkState] = {"incompatible": LinkState.INCOMPATIBLE, "refused": LinkState.REFUSED}


class Link:
    """Keeps one robot connected for ever and publishes what it says.

    Args:
        robot: What to connect to.
        connector: How to connect.
        bus: Where to publish.
        clock: Both times.
        delays: Makes a new series of delays between attempts.
        tap: Is shown every byte of its sessions, or None.

    Attributes:
        groups: The groups that it has topics of.
    """

    def __init__(
        self,
        robot: RobotSettings,
        connector: Connector,
        bus: Bus,
        clock: Clock,
        delays: Backoff = backoff,
        tap: Tap | None = None,
    ) -> None:
        self._robot = robot
        self._connector = connector
        self._bus = bus
        self._on_free: Callable[[], None] | None = None
        self._waiting: list[str] = []  # what the operator is told while a new configuration waits
        self._clock = clock
        self._tap = tap
        self._new_delays = delays
        self._delays = delays()
        self._timeline = Timeline(clock)
        normaliser = Normaliser(robot.protocol.signals, robot.signal_options)
        wall_clock = robot.protocol.wall_clock
        controller_clock = ControllerClock(wall_clock, robot.clock_zone) if wall_clock else None
        self._publisher = Publisher(
            robot.name,
            bus,
            normaliser,
            robot.origin,
            controller_clock,
            stale_s=robot.stale_s,
            commands=robot.protocol.commands,
            io_events=robot.io_events,
        )
        topics = bus.add(robot.name, ["link", "link_stats"])
        self._own = {group: OwnTopic(topic, bus, robot.origin) for group, topic in topics.items()}
        self.groups = frozenset({*self._publisher.groups, *self._own})
        self._counters = LinkCounters(parts=robot.protocol.slowest_s is not None)
        self._new_decoder: DecoderFactory | None = None
        self._decoder: Decoder | None = None
        self._layout: Table | None = None
        self._noted: list[str] = []
        self._epochs = 0
        self._boot = secrets.token_hex(4)
        self._first_frame = True
        self._in_session = False
        self._repeats = Repeats()
        self._kept: KeptDecoder | None = None
        self._online_s = 0.0
        self._outcome = LinkState.DISCONNECTED  # how the last attempt went
        self._data = LinkData(
            state=LinkState.DISCONNECTED,
            reason="not tried yet",
            since=self._timeline.now(),
            protocol=robot.protocol.name,
            peer=connector.peer,
            requested_hz=robot.rate_hz,
        )
        self._log = _LOG.bind(robot=robot.name, vendor=robot.vendor.name, protocol=robot.protocol.name)
        self._publisher.silent(Quality.DISCONNECTED, self._timeline.now(), None)
        self._say()

    @property
    def holds_session(self) -> bool:
        """Whether a session is open that must not be dropped."""
        return self._in_session and self._robot.protocol.on_stale == "keep"

    @property
    def events(self) -> Topic:
        """The robot's event topic."""
        return self._publisher.events

    def wait(self, note: str, on_free: Callable[[], None]) -> None:
        """Show that a new configuration waits for the session to end, and call back when it has ended."""
        self._waiting, self._on_free = [note], on_free
        self._show_notes()

    def wait_no_more(self) -> None:
        """Nothing waits any more."""
        if self._waiting:
            self._waiting, self._on_free = [], None
            self._show_notes()

    def leave(self, reason: str) -> None:
        """Say on every topic, when `run` has ended, that no more comes from this link, and why."""
        if self._data.state is LinkState.ONLINE:
            self._say_lost(Quality.DISCONNECTED, LinkState.DISCONNECTED, reason)
        else:
            self._fall_silent(Quality.DISCONNECTED)
        self._counters.reached_hz = None
        self._enter(LinkState.DISCONNECTED, reason, next_attempt=None, reached_hz=None, parts_hz={}, notes=[])

    async def run(self) -> None:
        """Connect and reconnect until cancelled."""
        try:
            async with anyio.create_task_group() as tasks:
                tasks.start_soon(self._count_every_second)
                while True:
                    delay_s = await self._attempt()
                    if self._on_free is not None:
                        self._on_free()
                    await anyio.sleep(delay_s)
        finally:
            with anyio.CancelScope(shield=True):
                await self._connector.aclose()

    async def _attempt(self) -> float:
        """Connect once and run the session; return the delay before the next attempt."""
        self._enter(LinkState.CONNECTING, self._data.reason, attempts=self._data.attempts + 1, next_attempt=None)
        try:
            await self._connect_and_run()
        except LinkRefused as error:
            state = _REFUSED_STATES.get(error.kind, LinkState.DISCONNECTED)
            return self._lost(state, error.reason, REFUSED_S if error.kind in _REFUSED_STATES else None)
        except LinkStale as error:
            return self._lost(LinkState.STALE, error.reason)
        except LinkError as error:
            notes = [self._robot.protocol.when_refused] if isinstance(error, LinkClosed) and error.refused else []
            return self._lost(LinkState.DISCONNECTED, error.reason, notes=notes)
        except (Exception, SystemExit) as error:  # noqa: BLE001 - the one place that catches what nobody expected
            if self._repeats.loss("faulted", self._clock.monotonic()) is not None:
                self._log.exception("link.faulted", reason=repr(error))
            return self._lost(LinkState.FAULTED, f"internal error, see the log: {error!r}", REFUSED_S)
        raise AssertionError("a session ends with an exception")

    async def _connect_and_run(self) -> None:
        robot = self._robot
        self._decoder = None
        if self._new_decoder is None:  # not before: a plugin that fails here costs its own link, not the start of all
            self._new_decoder = robot.protocol.decoders(robot.options, robot.rate_hz)
        # Before the controller is called: connecting and closing again, for a plugin that fails here, may stop a robot.
        decoder = AllowedDecoder(self._new_decoder(), robot.vendor.name, robot.protocol.outgoing)
        connection = await self._connector.connect()
        self._in_session = True
        try:
            self._publisher.begin(self._next_epoch(), self._timeline)
            if self._tap is not None:
                self._tap.begin(self._clock.monotonic(), self._timeline.stamp, self._publisher)
            self._enter(LinkState.HANDSHAKING, "connected, waiting for the first frame", layout=None, notes=[])
            self._counters.begin()
            self._first_frame = True
            self._kept = KeptDecoder(decoder) if robot.protocol.on_stale == "keep" else None
            self._decoder = self._kept or decoder
            session = Session(
                connection,
                self._decoder,
                self,
                period_s=None if robot.rate_hz is None else 1 / robot.rate_hz,
                stale_s=robot.stale_s,
                on_stale=robot.protocol.on_stale,
                clock=self._clock,
                tick_s=robot.protocol.tick_s,
                first_s=robot.protocol.handshake_s,
                quiet_s=robot.protocol.quiet / robot.rate_hz if robot.rate_hz else 0.0,
                tap=self._tap,
            )
            await session.run()
        finally:
            self._counters.end(self._gaps())
            self._in_session = False
            if self._tap is not None:
                self._tap.end(self._clock.monotonic())
            with anyio.CancelScope(shield=True):
                await connection.aclose()

    def received(self, n_bytes: int, events: Sequence[Event], at_s: float, decode_s: float) -> None:
        """Take what the session has received; see `gateway.core.session.Sink`."""
        self._counters.take(n_bytes, events, at_s, decode_s)
        for event in events:
            if type(event) is Frame:
                if self._first_frame:
                    self._online(event)
                self._publish(event, at_s)
            elif type(event) is Occurrence:
                self._publisher.occurred(event.entries, at_s)
        trouble = self._kept.trouble if self._kept is not None else None
        if trouble is not None and self._data.reason != trouble.reason:
            self._off_but_open(_REFUSED_STATES.get(trouble.kind, LinkState.STALE), trouble.reason)

    def silent(self, reason: str, kind: RefusedKind | None) -> None:
        """Take that a kept session is stale; see `gateway.core.session.Sink`."""
        self._off_but_open(_REFUSED_STATES.get(kind, LinkState.STALE), reason)

    def _publish(self, frame: Frame, at_s: float) -> None:
        try:
            self._publisher.frame(frame, at_s)
        except (Exception, SystemExit) as error:
            if self._kept is None:
                raise
            self._kept.trouble = Refused(f"the plugin failed: {error!r}", "refused")

    def _off_but_open(self, state: LinkState, reason: str) -> None:
        """Say that a session that is kept gives nothing: the next good frame makes the link online again."""
        self._off(state, reason)
        self._first_frame = True

    def _off(self, state: LinkState, reason: str, **changes: object) -> None:
        """Say that no frames come, and why."""
        self._announce_loss(state, reason)
        self._counters.reached_hz = None
        self._counters.parts_hz = {}
        self._enter(state, reason, last_error=reason, reached_hz=None, parts_hz={}, **changes)

    def _online(self, frame: Frame) -> None:
        """The first good frame of a session, or after a silence."""
        self._first_frame = False
        if self._tap is not None:
            self._tap.online()
        self._outcome = LinkState.ONLINE
        self._online_s = self._clock.monotonic()
        before = self._data.state
        layout = _title(frame.layout) + self._unexplained(frame)
        notes = self._notes()
        attempts = self._data.attempts
        self._enter(LinkState.ONLINE, None, attempts=0, layout=layout, notes=notes)
        self._raise(EventKind.LINK_ONLINE, before, LinkState.ONLINE, None)
        if self._repeats.recovery():
            self._log.info("link.connected", peer=self._connector.peer, attempts=attempts, layout=layout)
        self._layout = frame.layout
        for note in notes if notes != self._noted else ():
            self._log.warning("link.noted", reason=note)
        self._noted = notes

    def _unexplained(self, frame: Frame) -> str:
        """How many bytes of a frame its layout leaves over, in words."""
        framing = self._robot.protocol.framing
        if frame.quality is not Quality.UNCERTAIN or framing is None or not isinstance(frame.layout, Layout):
            return ""
        extra = len(frame.raw) - frame.start - frame.layout.size - framing.behind
        return f" + {extra} bytes that the layout does not explain"

    def _notes(self) -> list[str]:
        """What decoder and transport have to tell; a plugin that cannot even tell it stops nothing."""
        notes = [*self._waiting, *self._connector.notes]
        with contextlib.suppress(Exception):
            notes += [] if self._decoder is None else [str(note) for note in self._decoder.notes]
        return notes

    def _gaps(self) -> int | None:
        """How many frames of the running session are missing; a plugin that cannot tell it stops nothing."""
        with contextlib.suppress(Exception):
            return self._decoder.gaps if self._in_session and self._decoder is not None else None
        return None

    def _lost(self, state: LinkState, reason: str, delay_s: float | None = None, notes: Sequence[str] = ()) -> float:
        """Say that the session is lost, or that there was none, and when the next attempt is due."""
        if self._data.state is LinkState.ONLINE and self._clock.monotonic() - self._online_s >= STEADY_S:
            self._delays = self._new_delays()
        if delay_s is None:
            delay_s = next(self._delays)
        due = self._timeline.now() + int(delay_s * 1e6)
        self._off(state, reason, next_attempt=due, notes=[*filter(None, notes), *self._notes()])
        return delay_s

    def _announce_loss(self, state: LinkState, reason: str) -> None:
        if self._data.state is LinkState.ONLINE:
            self._say_lost(Quality.STALE if state is LinkState.STALE else Quality.DISCONNECTED, state, reason)
        if state is LinkState.INCOMPATIBLE and self._outcome is not LinkState.INCOMPATIBLE:
            self._raise(EventKind.LINK_INCOMPATIBLE, self._outcome, state, reason)
        self._outcome = state
        n_repeats = self._repeats.loss(state, self._clock.monotonic())
        if n_repeats is None:
            return
        log = self._log.bind(n_repeats=n_repeats) if n_repeats else self._log
        log.warning("link.lost", reason=reason, state=state.value, peer=self._connector.peer)

    def _say_lost(self, quality: Quality, state: LinkState, reason: str) -> None:
        """Say on every topic that a link that was online is not any more."""
        self._fall_silent(quality)
        self._raise(EventKind.LINK_LOST, LinkState.ONLINE, state, reason)
        # What was under way when the session ended is lost, and nobody can count it.
        missed = Entry(EventKind.COMMAND_MISSED, CommandsMissed(), {"reason": reason})
        self._publisher.occurred((missed,), self._clock.monotonic())

    def _fall_silent(self, quality: Quality) -> None:
        """Say on every topic of the robot that no more values come."""
        t_last, now_s = self._last_frame_t(), self._clock.monotonic()
        if self._tap is not None:
            self._tap.silent(quality, t_last, now_s)
        self._publisher.silent(quality, self._timeline.stamp(now_s), t_last)

    def _last_frame_t(self) -> int | None:
        """When the last frame came, µs UTC."""
        last_s = self._counters.last_frame_s
        return None if last_s is None else self._timeline.now() - round((self._clock.monotonic() - last_s) * 1e6)

    def _next_epoch(self) -> str:
        self._epochs += 1
        return f"{self._boot}.{self._epochs}"

    async def _count_every_second(self) -> None:
        while True:
            await anyio.sleep(1)
            self._follow_clock()
            publisher = self._publisher
            now_s = self._clock.monotonic()
            if publisher.expire(now_s) and self._tap is not None:
                self._tap.expired(now_s)
            stats = self._counters.second(
                self._clock.monotonic(),
                publisher.bad_values,
                publisher.clock_offset_s(),
                gaps=self._gaps(),
                refused=self._connector.rejects,
            )
            self._own["link_stats"].publish(stats, self._timeline.now())
            if self._data.state is LinkState.ONLINE:
                self._say_what_changed()

    def _follow_clock(self) -> None:
        """Follow a wall clock that was set: what was said in its old time is said in the new one."""
        jump_us = self._timeline.follow()
        if not jump_us:
            return
        if jump_us < 0:
            self._publisher.set_back(self._next_epoch(), self._clock.monotonic())
            for topic in self._own.values():
                topic.begin_epoch()
        due = self._data.next_attempt
        moved = None if due is None else due + jump_us
        self._data = msgspec.structs.replace(self._data, since=self._data.since + jump_us, next_attempt=moved)
        self._say()

    def _say_what_changed(self) -> None:
        """Publish what may change while the link is online."""
        counters = self._counters
        now = msgspec.structs.replace(
            self._data, reached_hz=counters.reached_hz, parts_hz=counters.parts_hz, notes=self._notes()
        )
        layout = self._publisher.layout
        if layout is not None and layout is not self._layout:  # configured again inside the session
            self._layout = layout
            now = msgspec.structs.replace(now, layout=_title(layout))
        if now != self._data:
            self._data = now
            self._say()

    def _show_notes(self) -> None:
        self._data = msgspec.structs.replace(self._data, notes=self._notes())
        self._say()

    def _enter(self, state: LinkState, reason: str | None, **changes: object) -> None:
        same = (state is LinkState.ONLINE) == (self._data.state is LinkState.ONLINE)
        since = self._data.since if same else self._timeline.now()
        self._data = msgspec.structs.replace(self._data, state=state, reason=reason, since=since, **changes)
        self._say()

    def _say(self) -> None:
        self._own["link"].publish(self._data, self._timeline.now())

    def _raise(self, kind: EventKind, before: object, after: object, reason: str | None) -> None:
        raw: dict[str, object] = {} if reason is None else {"reason": reason}
        self._bus.raise_event(self._publisher.events, self._timeline.now(), kind, before, after, raw)


def _title(table: Table) -> str:
    """A table, for the operator."""
    return table.title if isinstance(table, Layout) else table.name


def announce_broken(robot: BrokenRobot, bus: Bus, clock: Clock) -> None:
    """Show a robot whose plugin could not be loaded: its link is FAULTED and says why."""
    topic = bus.add(robot.name, BROKEN_GROUPS)["link"]
    now = clock.utc_us()
    data = LinkData(
        state=LinkState.FAULTED,
        reason=str(robot.error),
        since=now,
        protocol=robot.protocol,
        peer=robot.host,
        last_error=str(robot.error),
    )
    OwnTopic(topic, bus, "live").publish(data, now)
    _LOG.error("link.faulted", robot=robot.name, vendor=robot.vendor, reason=robot.error.reason)
