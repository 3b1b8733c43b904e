"""Sends what waits in the outbox to a JetStream stream: in order of each robot, acknowledged before it leaves.

Of one robot there is never more than one event on the way: if it is not acknowledged, nothing of the robot has
overtaken it. The robots do not wait for each other. A resend carries the same `Nats-Msg-Id`. As the server remembers
those for a short while only, the first thing that is asked of each robot's subject after an interruption is which event
the stream has last: what is there is not sent again, however long the interruption was.
"""

from __future__ import annotations

import json
from collections.abc import Iterable

import anyio
import msgspec
import nats.errors
import nats.js.errors
import structlog
from nats.js.api import RetentionPolicy, StorageType, StreamConfig

from gateway.config.exports import NatsTable
from gateway.export.connection import MESSAGE_TOO_LARGE, Connection, Trouble
from gateway.export.encoding import without_values
from gateway.export.outbox import Outbox, OutboxError, Row
from gateway.export.subjects import covers, event_subjects, message_id, subject
from gateway.export.taking import EventTaker

_LOG = structlog.get_logger()
MESSAGE_ID = "Nats-Msg-Id"
BATCH = 256
_HEADER_BYTES = 256  # what the header of an event takes at most
_DAY_S = 86_400.0
_DUPLICATES_S = 120.0
_IDLE_S = 5.0


class Sender:
    """Empties the outbox.

    Args:
        table: Where to.
        outbox: What waits.
        taker: Tells when there is more.

    Attributes:
        n_sent: How many events were acknowledged.
        n_known: How many of them the stream had already.
        n_shortened: How many were too large for the server and went without their values.
    """

    def __init__(self, table: NatsTable, outbox: Outbox, taker: EventTaker) -> None:
        self._table = table
        self._outbox = outbox
        self._taker = taker
        self.n_sent = 0
        self.n_known = 0
        self.n_shortened = 0
        self._n_too_large = 0

    @property
    def notes(self) -> list[str]:
        """What the operator should know."""
        notes = []
        if self.n_shortened:
            notes.append(f"{self.n_shortened} events were larger than the server takes and went without their values")
        if self._n_too_large:
            notes.append(f"{self._n_too_large} events were larger than the server takes and were dropped")
        return notes

    async def run(self, connection: Connection) -> None:
        """Send for as long as it is not cancelled.

        Raises:
            Trouble: The stream does not take them.
        """
        await self._find_stream(connection)
        sure: set[str] = set()  # subjects of which the last event is known
        while True:
            self._taker.stored = anyio.Event()
            try:
                rows = await self._outbox.first(BATCH) if self._outbox.is_open else []
                if rows:
                    await self._send(connection, rows, sure)
                    continue
            except OutboxError as error:
                raise Trouble(f"events cannot be read: {error.reason}") from None
            connection.well("events")
            with anyio.move_on_after(_IDLE_S):
                await self._taker.stored.wait()

    async def _find_stream(self, connection: Connection) -> None:
        """Find the stream, or make it.

        Raises:
            Trouble: There can be none, or it does not take our subjects.
        """
        table, name = self._table, self._table.stream_name
        try:
            info = await connection.jetstream.stream_info(name)
        except nats.js.errors.NotFoundError:
            await self._make_stream(connection)
            return
        except (nats.errors.Error, TimeoutError) as error:
            if connection.denied is None:
                raise connection.trouble(error, f"stream {name}") from None
            connection.denied = None  # may not be looked at; whether it may be written to is another question
            return
        ours = subject(table.plant, table.cell, "r", "events")
        if not any(covers(pattern, ours) for pattern in info.config.subjects or []):
            held = ", ".join(info.config.subjects or []) or "nothing but copies"
            raise Trouble(
                f"stream {name} exists with another configuration: it takes {held}, not {ours}; add the subject to "
                "it, or name another stream in export.nats.stream"
            )

    async def _make_stream(self, connection: Connection) -> None:
        table = self._table
        config = StreamConfig(
            name=table.stream_name,
            description="The events of every robot, by robot-gateway",
            subjects=event_subjects(table.plant),
            retention=RetentionPolicy.LIMITS,
            storage=StorageType.FILE,
            max_bytes=int(table.stream_mb * 1e6) or -1,
            max_age=table.stream_days * _DAY_S,
            duplicate_window=min(_DUPLICATES_S, table.stream_days * _DAY_S or _DUPLICATES_S),
            allow_direct=True,
        )
        try:
            await connection.jetstream.add_stream(config)
        except (nats.errors.Error, TimeoutError) as error:
            raise connection.trouble(error, f"stream {table.stream_name} cannot be made") from None

    async def _send(self, connection: Connection, rows: list[Row], sure: set[str]) -> None:
        """Send some events, and let those go that are acknowledged, whatever becomes of the others."""
        lanes: dict[str, list[Row]] = {}
        for row in rows:
            lanes.setdefault(row.robot, []).append(row)
        done: list[int] = []
        too_large: list[int] = []
        failed: list[Trouble] = []

        async def send(lane: list[Row]) -> None:
            try:
                await self._send_lane(connection, lane, sure, done, too_large)
            except Trouble as trouble:
                sure.difference_update(self._subjects(lane))
                failed.append(trouble)

        try:
            async with anyio.create_task_group() as tasks:
                for lane in lanes.values():
                    tasks.start_soon(send, lane)
        finally:
            with anyio.CancelScope(shield=True):
                await self._outbox.remove([*done, *too_large], dropped=len(too_large))
        if failed:
            raise failed[0]

    async def _send_lane(
        self, connection: Connection, lane: list[Row], sure: set[str], done: list[int], too_large: list[int]
    ) -> None:
        known: set[str] = set()
        for name in self._subjects(lane):
            if name not in sure:
                known |= await self._known(connection, name, lane)
                sure.add(name)
        for row in lane:
            if row.name in known:
                self.n_known += 1
            elif not await self._publish(connection, row):
                too_large.append(row.id)
                continue
            self.n_sent += 1
            done.append(row.id)

    def _subjects(self, lane: Iterable[Row]) -> list[str]:
        return list(dict.fromkeys(self._subject(row) for row in lane))

    def _subject(self, row: Row) -> str:
        return subject(self._table.plant, self._table.cell, row.robot, row.group)

    async def _known(self, connection: Connection, name: str, lane: list[Row]) -> set[str]:
        """The events of a subject that the stream has already: those up to the one that it has last."""
        try:
            last = await connection.jetstream.get_last_msg(self._table.stream_name, name, direct=False)
        except nats.js.errors.NotFoundError:
            return set()
        except (nats.errors.Error, TimeoutError) as error:
            if connection.denied is not None:  # may not be asked: the server's own memory of the last minutes must do
                connection.denied = None
                return set()
            raise connection.trouble(error, f"stream {self._table.stream_name}") from None
        last_id = (last.headers or {}).get(MESSAGE_ID)
        ours = [row.name for row in lane if self._subject(row) == name]
        ids = [message_id(self._table.cell, one) for one in ours]
        return set(ours[: ids.index(last_id) + 1]) if last_id in ids else set()

    async def _publish(self, connection: Connection, row: Row) -> bool:
        """Send one event and wait for its acknowledgement; whether it could be sent at all.

        Raises:
            Trouble: It is not acknowledged.
        """
        name = self._subject(row)
        headers = {MESSAGE_ID: message_id(self._table.cell, row.name)}
        payload, limit = row.payload, connection.client.max_payload - _HEADER_BYTES
        for _ in range(2):
            if len(payload) <= limit:
                try:
                    done = await connection.jetstream.publish(name, payload, headers=dict(headers))
                except nats.js.errors.APIError as error:
                    if error.err_code != MESSAGE_TOO_LARGE:
                        raise connection.trouble(error, f"stream {self._table.stream_name}") from None
                except (nats.errors.Error, TimeoutError, json.JSONDecodeError) as error:
                    raise connection.trouble(error, f"stream {self._table.stream_name}") from None
                else:
                    self.n_known += bool(done.duplicate)
                    self.n_shortened += payload is not row.payload
                    return True
            try:
                payload = without_values(row.payload)
            except msgspec.DecodeError:
                break
        self._n_too_large += 1
        _LOG.warning("export.dropped", robot=row.robot, n_bytes=len(row.payload), reason="larger than the server takes")
        return False
