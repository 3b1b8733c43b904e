"""Reads a whole plant back from NATS: the bucket of states, the samples as they come, the events from the stream."""

from __future__ import annotations

import itertools
import time
from collections.abc import Awaitable, Callable, Collection
from datetime import UTC, datetime, timedelta
from typing import Protocol, cast

import anyio
import msgspec
import nats.errors
import nats.js.errors
import structlog
from nats.aio.msg import Msg
from nats.js.api import ConsumerConfig, DeliverPolicy
from nats.js.kv import KeyValue

from gateway.api.model import GROUPS
from gateway.config.exports import NatsAccess
from gateway.core.backoff import Backoff, backoff
from gateway.export.connection import Connection, Trouble, connected
from gateway.export.readings import decoded
from gateway.export.subjects import EVENT_GROUPS, GATEWAY, ROBOTS, Beat, Card

_LOG = structlog.get_logger()
_LOOK_S = 0.25
_SAMPLES = tuple(name for name, group in GROUPS.items() if group.delivery == "sample")
_HISTORY_S = 3600.0  # so far back events are read at the first connection
_BUCKET = "KV_"
_KEY_WORDS, _SUBJECT_WORDS = 3, 4


class Told(Protocol):
    """Who is told what a plant says: `Cells` keeps a bus by it, `tail` prints it."""

    connection: str | None

    def connected(self) -> None:
        """The server is there."""
        ...

    def lost(self, reason: str) -> None:
        """The server is gone."""
        ...

    def look(self) -> None:
        """Time goes by."""
        ...

    def wrong(self) -> None:
        """Something came that was none of ours."""
        ...

    def beat(self, name: str, beat: Beat, *, kept: bool = False) -> None:
        """A cell lives, or did when this was kept."""
        ...

    def robots(self, name: str, cards: list[Card]) -> None:
        """A cell has these robots."""
        ...

    def sample(self, cell_name: str, robot: str, group: str, payload: bytes) -> None:
        """A sample, or a state."""
        ...

    def forget(self, cell_name: str, robot: str, group: str) -> None:
        """A state is there no more."""
        ...

    def event(self, cell_name: str, robot: str, group: str, payload: bytes) -> None:
        """An event."""
        ...


class PlantReader:
    """Reads a plant for as long as it is let.

    Args:
        access: How the server is reached.
        cells: Who is told.
        plant: Its name; None: the only one that the server has.
        groups: Which sample groups are wanted.
        history_s: So far back events are read at first.
        delays: Makes a new series of delays between attempts.

    Attributes:
        ready: Set when everything that is kept has been read for the first time.
        notes: What does not work, by what it is.
    """

    def __init__(
        self,
        access: NatsAccess,
        cells: Told,
        plant: str | None = None,
        *,
        groups: Collection[str] = _SAMPLES,
        history_s: float = _HISTORY_S,
        delays: Backoff = backoff,
    ) -> None:
        self._groups = groups
        self._access = access
        self._cells = cells
        self._delays = delays
        self._n_lost = 0
        self._history_s = history_s
        self._last_event = 0  # its place in the stream
        self.plant = plant
        self.ready = anyio.Event()
        self.notes: dict[str, str] = {}

    async def run(self) -> None:
        """Read for ever."""
        delays = self._delays()
        async with anyio.create_task_group() as tasks:
            tasks.start_soon(self._look)
            for server in itertools.cycle(self._access.servers):
                begun_s = time.monotonic()
                try:
                    await self._connect(server)
                except Trouble as trouble:
                    if self._cells.connection is None or self._n_lost == 0:
                        _LOG.warning("plant.lost", reason=trouble.reason)
                    self._n_lost += 1
                    self._cells.lost(trouble.reason)
                if time.monotonic() - begun_s > 5:  # noqa: PLR2004 - s: it was a good one
                    delays = self._delays()
                await anyio.sleep(next(delays))

    async def _look(self) -> None:
        while True:
            await anyio.sleep(_LOOK_S)
            self._cells.look()

    async def _connect(self, server: str) -> None:
        async with connected(self._access, server, "robot-gateway plant") as connection:
            self.plant = self.plant or await find_plant(connection)
            self._cells.connected()
            _LOG.info("plant.connected", peer=connection.address, topic=self.plant)
            async with anyio.create_task_group() as tasks:
                for name, work in (("states", self._states), ("samples", self._samples), ("events", self._events)):
                    tasks.start_soon(self._keep, name, work, connection)
                await connection.ended.wait()
                tasks.cancel_scope.cancel()
            raise Trouble(f"{connection.address}: {connection.why_ended()}")

    async def _keep(self, name: str, work: Callable[[Connection], Awaitable[None]], connection: Connection) -> None:
        delays = self._delays()
        while True:
            try:
                await work(connection)
            except Exception as error:  # noqa: BLE001 - it costs this kind of reading only
                if connection.client.is_closed:
                    return
                ours = isinstance(error, Trouble | nats.errors.Error | TimeoutError)
                trouble = error if isinstance(error, Trouble) else connection.trouble(error, name)
                if self.notes.get(name) != trouble.reason:
                    _LOG.warning("plant.troubled", reason=trouble.reason, exc_info=None if ours else error)
                self.notes[name] = trouble.reason
            await anyio.sleep(next(delays))

    async def _states(self, connection: Connection) -> None:
        bucket = await connection.jetstream.key_value(self.plant or "")
        kept = (await bucket.status()).values > 0
        watcher = await bucket.watchall()
        self.notes.pop("states", None)
        if not kept:
            self.ready.set()
        async for entry in watcher:
            told = cast("KeyValue.Entry | None", entry)
            if told is None:  # nats-py's sign that what was kept is over may come too early: the count below does not
                continue
            if told.operation is not None:
                self._forget(told.key)
            else:
                self._take(told.key, told.value or b"", kept=kept)
            if kept and not told.delta:
                kept = False
                self.ready.set()

    def _take(self, key: str, payload: bytes, *, kept: bool) -> None:
        cell, _, rest = key.partition(".")
        try:
            if rest == GATEWAY:
                self._cells.beat(cell, decoded(payload, Beat), kept=kept)
            elif rest == ROBOTS:
                self._cells.robots(cell, decoded(payload, list[Card]))
            elif len(key.split(".")) == _KEY_WORDS:
                robot, _, group = rest.partition(".")
                self._cells.sample(cell, robot, group, payload)
        except msgspec.DecodeError:
            self._cells.wrong()

    def _forget(self, key: str) -> None:
        words = key.split(".")
        if len(words) == _KEY_WORDS:
            self._cells.forget(*words)

    async def _samples(self, connection: Connection) -> None:
        for group in self._groups:
            await connection.client.subscribe(f"{self.plant}.*.*.{group}", cb=self._on_sample)
        self.notes.pop("samples", None)
        await connection.ended.wait()

    async def _on_sample(self, message: Msg) -> None:
        words = message.subject.split(".")
        if len(words) == _SUBJECT_WORDS:
            self._cells.sample(words[1], words[2], words[3], message.data)

    async def _events(self, connection: Connection) -> None:
        """Read the events from the stream, once each, after the robots are known; without a stream as they come."""
        await self.ready.wait()
        stream, jetstream = f"{self.plant}-events", connection.jetstream
        try:
            info = await jetstream.stream_info(stream)
        except nats.js.errors.NotFoundError:
            for group in EVENT_GROUPS:
                await connection.client.subscribe(f"{self.plant}.*.*.{group}", cb=self._on_live_event)
            await connection.ended.wait()
            return
        if info.state.last_seq < self._last_event:  # the stream was made anew
            self._last_event = 0
        if self._last_event:
            config = ConsumerConfig(deliver_policy=DeliverPolicy.BY_START_SEQUENCE, opt_start_seq=self._last_event + 1)
        else:
            begin = datetime.now(UTC) - timedelta(seconds=self._history_s)
            config = ConsumerConfig(deliver_policy=DeliverPolicy.BY_START_TIME, opt_start_time=begin)
        await jetstream.subscribe(
            f"{self.plant}.>", stream=stream, ordered_consumer=True, config=config, cb=self._on_event
        )
        self.notes.pop("events", None)
        await connection.ended.wait()

    async def _on_event(self, message: Msg) -> None:
        self._last_event = message.metadata.sequence.stream
        await self._on_live_event(message)

    async def _on_live_event(self, message: Msg) -> None:
        words = message.subject.split(".")
        if len(words) == _SUBJECT_WORDS and words[3] in EVENT_GROUPS:
            self._cells.event(words[1], words[2], words[3], message.data)


async def find_plant(connection: Connection) -> str:
    """The only plant that a server has.

    Raises:
        Trouble: There is none, or more than one.
    """
    try:
        streams = await connection.jetstream.streams_info()
    except (nats.errors.Error, TimeoutError) as error:
        raise connection.trouble(error, "the plants of this server cannot be listed; name one with --plant") from None
    names = [str(one.config.name) for one in streams]
    plants = [name.removeprefix(_BUCKET) for name in names if name.startswith(_BUCKET)]
    told = [name for name in plants if f"{name}-events" in names] or plants
    if not told:
        raise Trouble(f"{connection.address}: no gateway has sent anything there yet: it has no bucket of a plant")
    if len(told) > 1:
        raise Trouble(f"{connection.address}: has several plants: name one with --plant: {', '.join(sorted(told))}")
    return told[0]
