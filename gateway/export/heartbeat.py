"""The heartbeat of a cell, and how two gateways with one cell name find each other.

Each beat replaces the one before it, and only that one. Where another gateway has written in between, the server
refuses it, and the key says who it was.
"""

from __future__ import annotations

import socket
import time

import anyio
import msgspec
import nats.errors
import nats.js.errors
import structlog

from gateway import __version__
from gateway.config.exports import NatsTable
from gateway.export import Source
from gateway.export.connection import WRONG_LAST, Connection
from gateway.export.outbox import Outbox
from gateway.export.subjects import GATEWAY, Beat

_LOG = structlog.get_logger()
_LAST = "Nats-Expected-Last-Subject-Sequence"
_FORGET_BEATS = 5


class Heart:
    """Beats while there is a connection.

    Args:
        table: Of which cell, and how often.
        source: Has the boot and the clock.
        outbox: What waits, told with each beat.

    Attributes:
        rival: The last beat of another gateway that says it is this cell; None: there is none.
    """

    def __init__(self, table: NatsTable, source: Source, outbox: Outbox) -> None:
        self._table = table
        self._source = source
        self._outbox = outbox
        self._n = 0
        self._boot = source.bus.events.boot
        self._key = f"$KV.{table.bucket_name}.{table.cell}.{GATEWAY}"
        self._rival_s = 0.0
        self.rival: Beat | None = None

    @property
    def notes(self) -> list[str]:
        """What the operator must know."""
        if self.rival is None:
            return []
        table, other = self._table, self.rival
        name = f"{table.plant}.{table.cell}"
        return [
            (
                f"another gateway, on {other.host}, sends as {name} too: its robots and these overwrite each other; "
                "give each cell its own name"
            )
        ]

    async def run(self, connection: Connection) -> None:
        """Beat for as long as it is not cancelled.

        Raises:
            Trouble: The bucket does not take it.
        """
        await connection.has_bucket.wait()
        last, _ = await self._found(connection)
        while True:
            last = await self._beat(connection, last)
            connection.well("heartbeat")
            if self.rival is not None and time.monotonic() - self._rival_s > _FORGET_BEATS * self._table.heartbeat_s:
                self.rival = None
                _LOG.info("export.alone", subscriber="nats")
            await anyio.sleep(self._table.heartbeat_s)

    async def _beat(self, connection: Connection, last: int) -> int:
        """Beat once; the revision that it has."""
        self._n += 1
        fill = self._outbox.fill
        beat = Beat(
            boot=self._boot,
            n=self._n,
            t=self._source.clock.utc_us(),
            period=self._table.heartbeat_s,
            gateway=__version__,
            host=socket.gethostname(),
            waiting_events=fill.events,
            dropped_events=fill.dropped,
        )
        payload = msgspec.json.encode(beat)
        while True:
            try:
                done = await connection.jetstream.publish(self._key, payload, headers={_LAST: str(last)})
            except nats.js.errors.APIError as error:
                if error.err_code not in WRONG_LAST:
                    raise connection.trouble(error, f"heartbeat in bucket {self._table.bucket_name}") from None
                last, found = await self._found(connection)
                self._look_at(found)
            except (nats.errors.Error, TimeoutError) as error:
                raise connection.trouble(error, f"heartbeat in bucket {self._table.bucket_name}") from None
            else:
                return int(done.seq)

    async def _found(self, connection: Connection) -> tuple[int, Beat | None]:
        """The newest beat that is there, and its revision; 0: there is none."""
        bucket = self._table.bucket_name
        try:
            found = await connection.jetstream.get_last_msg(f"KV_{bucket}", self._key)
        except nats.js.errors.NotFoundError:
            return 0, None
        except (nats.errors.Error, TimeoutError) as error:
            raise connection.trouble(error, f"heartbeat in bucket {bucket}") from None
        try:
            return int(found.seq or 0), msgspec.json.decode(found.data or b"", type=Beat)
        except msgspec.DecodeError:
            return int(found.seq or 0), None

    def _look_at(self, found: Beat | None) -> None:
        if found is None or found.boot == self._boot:
            return
        if self.rival is None:
            _LOG.error("export.shared", subscriber="nats", peer=found.host, reason="two gateways have one cell name")
        self.rival, self._rival_s = found, time.monotonic()
