"""How events come from the rings of the bus into the outbox: they are read from the ring, never queued beside it.

The bus only wakes the taker. What could not be stored, because the disk was full or the exporter was not there, is
still in the ring, and is read from where the outbox says that it was read last.
"""

from __future__ import annotations

import anyio
import structlog

from gateway.api.model import Event
from gateway.core.bus import Bus, Change, Reading, Topic
from gateway.core.events import EventRing
from gateway.export.encoding import Encode, encoded_event
from gateway.export.outbox import Outbox, OutboxError, Row

_LOG = structlog.get_logger()
_BATCH = 500
_RETRY_S = 2.0
_LAST_S = 1.0
_SWEEP_S = 60.0  # what is too old goes also when nothing comes


class EventTaker:
    """Brings the events of some groups into an outbox.

    Args:
        bus: Whose.
        outbox: Where to; it is opened here.
        groups: `events`, `commands`.
        encode: Writes one.

    Attributes:
        stored: Set when there is something new in the outbox.
        trouble: Why it cannot be used; None: it can.
    """

    def __init__(self, bus: Bus, outbox: Outbox, groups: tuple[str, ...], encode: Encode) -> None:
        self._bus = bus
        self._outbox = outbox
        self._groups = groups
        self._encode = encode
        self._rings: dict[EventRing, str] = {}
        self._taken: dict[str, int] = {}
        self._woken = anyio.Event()
        self.stored = anyio.Event()
        self.trouble: str | None = None

    def on_reading(self, topic: Topic, reading: Reading) -> None:
        """Event topics have none."""

    def on_event(self, topic: Topic, event: Event) -> None:  # noqa: ARG002 - a listener's signature
        """An event is in a ring."""
        self._woken.set()

    def on_topics(self, change: Change) -> None:
        """Listen to the robots that have come."""
        self._listen(list(change.added))
        for topic in change.removed:
            topic.listeners = [one for one in topic.listeners if one is not self]
        self._woken.set()

    async def run(self) -> None:
        """Take events for ever; when cancelled, once more what is there."""
        self._bus.watch(self)
        self._listen(list(self._bus.topics.values()))
        try:
            while True:
                try:
                    await self._work()
                except OutboxError as error:
                    if self.trouble is None:
                        _LOG.error("outbox.failed", reason=error.reason)
                    self.trouble = error.reason
                    await anyio.sleep(_RETRY_S)
        finally:
            self._bus.unwatch(self)
            for topic in self._bus.topics.values():
                topic.listeners = [one for one in topic.listeners if one is not self]
            with anyio.CancelScope(shield=True), anyio.move_on_after(_LAST_S):
                await self._end()

    async def _work(self) -> None:
        self._taken = dict(await self._outbox.open())
        self.stored.set()
        while True:
            self._woken = anyio.Event()
            await self._take_all()
            if self.trouble is not None:
                self.trouble = None
                _LOG.info("outbox.recovered")
            with anyio.move_on_after(_SWEEP_S) as quiet:
                await self._woken.wait()
            if quiet.cancelled_caught:
                await self._put([], {}, 0)

    async def _take_all(self) -> None:
        for ring, group in list(self._rings.items()):
            while self._taken.get(ring.boot, -1) < ring.last_seq and await self._take(ring, group):
                pass
        alive = {topic.ring for topic in self._bus.topics.values()}
        self._rings = {ring: group for ring, group in self._rings.items() if ring in alive}

    async def _take(self, ring: EventRing, group: str) -> bool:
        """Take some events of a ring; whether there may be more."""
        at = self._taken.get(ring.boot)
        events, missed = ring.since(None if at is None else f"{ring.boot}:{at}", _BATCH)
        if at is None and events:
            missed = events[0].seq - 1  # gone before the first look
        if not events:
            self._taken[ring.boot] = ring.last_seq
            return False
        rows = [Row(event.name, event.robot, group, encoded_event(self._encode, event)) for event in events]
        last = events[-1].seq
        await self._put(rows, {ring.boot: last}, missed or 0)
        self._taken[ring.boot] = last
        self.stored.set()
        return len(events) == _BATCH

    async def _put(self, rows: list[Row], taken: dict[str, int], missed: int) -> None:
        gone = await self._outbox.put(rows, taken, missed)
        if gone or missed:
            why = "gone from the ring before it was stored" if missed else "no room in the outbox, or too old"
            _LOG.warning("export.dropped", n_dropped=gone + missed, reason=why)

    async def _end(self) -> None:
        try:
            if self._outbox.is_open:
                await self._take_all()
            await self._outbox.close()
        except OutboxError as error:
            _LOG.error("outbox.failed", reason=error.reason)

    def _listen(self, topics: list[Topic]) -> None:
        for topic in topics:
            if topic.ring is not None and topic.group.name in self._groups:
                self._rings[topic.ring] = topic.group.name
                topic.listeners = [*topic.listeners, self]
