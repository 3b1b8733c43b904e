"""Samples on core NATS, at the configured rate and from the bus's own latest values: nothing is done per frame."""

from __future__ import annotations

import time

import anyio
import anyio.lowlevel

from gateway.api.model import GROUPS
from gateway.config.exports import NatsTable
from gateway.core.bus import Bus, Change, Reading, Topic
from gateway.export.connection import Connection
from gateway.export.encoding import Encoder
from gateway.export.subjects import subject

_A_TURN = 4  # so many samples are written, then others have their turn


class Samples:
    """Sends the newest sample of each topic, if it is another one than last time.

    Args:
        table: At which rate, and which groups.
        bus: Where they are.
        encoder: Writes them.

    Attributes:
        n_sent: How many were sent.
        n_left_out: How many rounds were left out because the server took too little.
    """

    def __init__(self, table: NatsTable, bus: Bus, encoder: Encoder) -> None:
        self._table = table
        self._bus = bus
        self._encoder = encoder
        self._groups = {name for name in table.groups if GROUPS[name].delivery == "sample"}
        self._topics: list[tuple[Topic, str]] | None = None
        self.n_sent = 0
        self.n_left_out = 0

    def on_topics(self, change: Change) -> None:  # noqa: ARG002 - a watcher's signature
        """Topics have come or gone: look again."""
        self._topics = None

    async def run(self, connection: Connection) -> None:
        """Send for as long as it is not cancelled."""
        if not self._table.samples_hz or not self._groups:
            await anyio.sleep_forever()
        self._bus.watch(self)
        try:
            await self._send(connection)
        finally:
            self._bus.unwatch(self)

    async def _send(self, connection: Connection) -> None:
        period_s = 1 / self._table.samples_hz
        due_s = time.monotonic()
        last: dict[str, Reading] = {}
        self._topics = None
        while True:
            due_s = max(due_s + period_s, time.monotonic())
            if connection.backed_up:
                self.n_left_out += 1
            else:
                await self._round(connection, last)
                connection.well("samples")
            await anyio.sleep(max(0.0, due_s - time.monotonic()))

    async def _round(self, connection: Connection, last: dict[str, Reading]) -> None:
        if self._topics is None:
            self._topics = self._found()
        publish, limit = connection.client.publish, connection.client.max_payload
        n_turn = 0
        for topic, name in self._topics:
            reading = topic.latest
            if reading is None or last.get(name) is reading:
                continue
            last[name] = reading
            payload = self._encoder.sample(topic, reading)
            if len(payload) <= limit:
                await publish(name, payload)
                self.n_sent += 1
            n_turn += 1
            if n_turn % _A_TURN == 0:
                await anyio.lowlevel.checkpoint()

    def _found(self) -> list[tuple[Topic, str]]:
        plant, cell = self._table.plant, self._table.cell
        return [
            (topic, subject(plant, cell, topic.robot, topic.group.name))
            for topic in self._bus.topics.values()
            if topic.group.name in self._groups
        ]
