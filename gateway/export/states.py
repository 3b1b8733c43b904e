"""States: each change on its subject, and the last value of each in a key-value bucket, sent again after an outage."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial

import anyio
import nats.errors
import nats.js.errors
from nats.js.api import KeyValueConfig, StorageType, StreamInfo

from gateway.api.model import GROUPS, Event
from gateway.config.exports import NatsTable
from gateway.core.bus import Change, Reading, Topic
from gateway.export import Source
from gateway.export.connection import MESSAGE_TOO_LARGE, Connection, Trouble
from gateway.export.encoding import Encoder
from gateway.export.subjects import ROBOTS, Card, subject

_AT_A_TIME = 16
_LOOK_S = 2.0  # how often the list of robots is looked at
_DELETED = {"KV-Operation": "DEL"}


class States:
    """Keeps the bucket as the bus is.

    Args:
        table: Which bucket, and which groups.
        source: The bus and the robots.
        encoder: Writes them.

    Attributes:
        n_sent: How many values the server has acknowledged.
        notes: What the operator should know of the bucket.
    """

    def __init__(self, table: NatsTable, source: Source, encoder: Encoder) -> None:
        self._table = table
        self._source = source
        self._encoder = encoder
        self._groups = {name for name in table.groups if GROUPS[name].delivery == "state"}
        self._dirty: dict[str, Topic | None] = {}  # by topic; None: it has gone
        self._woken = anyio.Event()
        self._card = b""
        self.n_sent = 0
        self.notes: list[str] = []

    @contextmanager
    def listening(self) -> Iterator[None]:
        """Hear of every change for as long as the context lasts, connected or not: only names are kept."""
        bus = self._source.bus
        self._listen(list(bus.topics.values()))
        bus.watch(self)
        try:
            yield
        finally:
            bus.unwatch(self)
            for topic in bus.topics.values():
                topic.listeners = [one for one in topic.listeners if one is not self]

    def on_reading(self, topic: Topic, reading: Reading) -> None:  # noqa: ARG002 - a listener's signature
        """A state has changed: what it is then is looked up when it is sent."""
        self._dirty[topic.name] = topic
        self._woken.set()

    def on_event(self, topic: Topic, event: Event) -> None:
        """State topics have none."""

    def on_topics(self, change: Change) -> None:
        """Listen to what has come; what has gone leaves the bucket."""
        self._listen(list(change.added))
        for topic in change.removed:
            if self in topic.listeners:
                topic.listeners = [one for one in topic.listeners if one is not self]
                self._dirty[topic.name] = None
        self._woken.set()

    async def run(self, connection: Connection) -> None:
        """Send everything once, and then every change.

        Raises:
            Trouble: The bucket cannot be used.
        """
        ttl_s = await self._bucket(connection)
        connection.has_bucket.set()
        self._card = b""
        self._mark_all()
        refresh_s = ttl_s / 3 if ttl_s else None
        async with anyio.create_task_group() as tasks:
            if refresh_s is not None:
                tasks.start_soon(self._refresh, refresh_s)
            while True:
                await self._say_robots(connection)
                while self._dirty:
                    await self._send(connection)
                connection.well("states")
                self._woken = anyio.Event()
                if not self._dirty:
                    with anyio.move_on_after(_LOOK_S):
                        await self._woken.wait()

    async def _refresh(self, period_s: float) -> None:
        """Say everything again before the bucket forgets it."""
        while True:
            await anyio.sleep(period_s)
            self._card = b""
            self._mark_all()

    async def _bucket(self, connection: Connection) -> float:
        """Find the bucket, or make it; its TTL in s, 0: it has none.

        Raises:
            Trouble: There can be none, or it is no bucket to write to.
        """
        name = self._table.bucket_name
        what = f"bucket {name}"
        try:
            info = await connection.jetstream.stream_info(f"KV_{name}")
        except nats.js.errors.NotFoundError:
            return await self._make(connection, name)
        except (nats.errors.Error, TimeoutError) as error:
            raise connection.trouble(error, what) from None
        self.notes = self._differences(info)
        return float(info.config.max_age or 0.0)

    async def _make(self, connection: Connection, name: str) -> float:
        """Make the bucket."""
        try:
            await connection.jetstream.create_key_value(
                KeyValueConfig(
                    bucket=name,
                    description="The last state of every robot, by robot-gateway",
                    history=1,
                    ttl=self._table.ttl_s or None,
                    storage=StorageType.FILE,
                )
            )
        except (nats.errors.Error, TimeoutError) as error:
            raise connection.trouble(error, f"bucket {name} cannot be made") from None
        self.notes = []
        return self._table.ttl_s

    def _differences(self, info: StreamInfo) -> list[str]:
        """What is other about a bucket than it would be if it were made here.

        Raises:
            Trouble: It cannot be written to.
        """
        name, config = self._table.bucket_name, info.config
        if config.max_msgs_per_subject < 1:
            raise Trouble(f"bucket {name}: KV_{name} exists and is no key-value bucket: name another in bucket")
        if config.mirror is not None or f"$KV.{name}.>" not in (config.subjects or []):
            raise Trouble(f"bucket {name}: it only copies another one: send to the server that has the original")
        notes = []
        if config.max_msgs_per_subject > 1:
            notes.append(f"bucket {name} exists and keeps {config.max_msgs_per_subject} values of each key, not 1")
        ttl_s = float(config.max_age or 0.0)
        if ttl_s != self._table.ttl_s:
            is_, asked = (f"{one:g} s" if one else "none" for one in (ttl_s, self._table.ttl_s))
            notes.append(f"bucket {name} exists with another TTL: {is_}, where ttl_s says {asked}; its own counts")
        return notes

    async def _say_robots(self, connection: Connection) -> None:
        cards = [
            Card(name=one.name, vendor=one.vendor, protocol=one.protocol, groups=self._sent_groups(one.groups))
            for one in self._source.infos()
        ]
        card = self._encoder.encode(cards)
        if card != self._card:
            await self._put(connection, f"{self._table.cell}.{ROBOTS}", card, None)
            self._card = card

    def _sent_groups(self, groups: list[str]) -> list[str]:
        return [group for group in groups if group in self._table.groups]

    async def _send(self, connection: Connection) -> None:
        """Send some of what has changed; what fails is still to be sent."""
        names = list(self._dirty)[:_AT_A_TIME]
        taken = {name: self._dirty.pop(name) for name in names}
        failed: list[Trouble] = []

        async def one(name: str, topic: Topic | None) -> None:
            try:
                await self._say(connection, name, topic)
            except Trouble as trouble:
                self._dirty.setdefault(name, topic)
                failed.append(trouble)

        try:
            async with anyio.create_task_group() as tasks:
                for name, topic in taken.items():
                    tasks.start_soon(partial(one, name, topic))
        except BaseException:
            self._dirty = {**taken, **self._dirty}
            raise
        if failed:
            raise failed[0]

    async def _say(self, connection: Connection, name: str, topic: Topic | None) -> None:
        robot, _, group = name.rpartition("/")
        key = f"{self._table.cell}.{robot}.{group}"
        if topic is None:
            await self._put(connection, key, b"", _DELETED)
            return
        if topic.latest is None:
            return
        payload = self._encoder.sample(topic, topic.latest)
        if len(payload) > connection.client.max_payload:
            self._too_large(name, len(payload))
            return
        await connection.client.publish(subject(self._table.plant, self._table.cell, robot, group), payload)
        await self._put(connection, key, payload, None)

    async def _put(self, connection: Connection, key: str, payload: bytes, headers: dict[str, str] | None) -> None:
        bucket = self._table.bucket_name
        try:
            await connection.jetstream.publish(f"$KV.{bucket}.{key}", payload, headers=headers)
        except nats.js.errors.APIError as error:
            if error.err_code != MESSAGE_TOO_LARGE:
                raise connection.trouble(error, f"bucket {bucket}") from None
            self._too_large(key, len(payload))
        except (nats.errors.Error, TimeoutError, json.JSONDecodeError) as error:
            raise connection.trouble(error, f"bucket {bucket}") from None
        else:
            self.n_sent += 1

    def _too_large(self, name: str, size: int) -> None:
        note = f"the state {name} has {size} bytes, more than the server takes: it is not sent"
        self.notes = [*(one for one in self.notes if f"the state {name} " not in one), note]

    def _listen(self, topics: list[Topic]) -> None:
        for topic in topics:
            if topic.group.name in self._groups:
                topic.listeners = [*topic.listeners, self]
                self._dirty[topic.name] = topic

    def _mark_all(self) -> None:
        for topic in self._source.bus.topics.values():
            if topic.group.name in self._groups:
                self._dirty[topic.name] = topic
        self._woken.set()
