"""The exporter to NATS: samples on core NATS, states in a key-value bucket, events through the outbox into a stream."""

from __future__ import annotations

import itertools
import time
from collections.abc import Awaitable, Callable

import anyio
import structlog

from gateway.api.messages import ExportInfo
from gateway.config.exports import NatsSettings
from gateway.core.backoff import Backoff, backoff
from gateway.core.repeats import Repeats
from gateway.export import Source
from gateway.export.connection import Connection, Trouble, connected
from gateway.export.encoding import Encoder
from gateway.export.heartbeat import Heart
from gateway.export.outbox import Outbox
from gateway.export.sampling import Samples
from gateway.export.sending import Sender
from gateway.export.states import States
from gateway.export.subjects import EVENT_GROUPS
from gateway.export.taking import EventTaker

_LOG = structlog.get_logger()
_NAME = "nats"
_DAY_S = 86_400.0
_STEADY_S = 5.0  # a connection that lasts so long was a good one


class NatsExporter:
    """Sends the cell to NATS.

    Args:
        settings: Where, and what of it.
        source: What there is to send.
        delays: Makes a new series of delays between attempts.
    """

    def __init__(self, settings: NatsSettings, source: Source, delays: Backoff = backoff) -> None:
        table = settings.table
        self._settings = settings
        self._clock = source.clock
        self._delays = delays
        self._repeats = Repeats()
        self._since = source.clock.utc_us()
        self._connection: Connection | None = None
        self._reason: str | None = "connecting"
        encoder = Encoder(table.format)
        groups = tuple(group for group in table.groups if group in EVENT_GROUPS)
        path = settings.outbox / f"nats.{table.plant}.{table.cell}.sqlite"
        self._outbox = Outbox(path, table.outbox_mb * 1e6, table.outbox_days * _DAY_S)
        self._taker = EventTaker(source.bus, self._outbox, groups, encoder.encode)
        self._sender = Sender(table, self._outbox, self._taker)
        self._samples = Samples(table, source.bus, encoder)
        self._states = States(table, source, encoder)
        self._heart = Heart(table, source, self._outbox)

    def info(self) -> ExportInfo:
        """How it does."""
        table, fill = self._settings.table, self._outbox.fill
        where = self._settings.access.servers[0] if self._connection is None else self._connection.address
        troubles = {} if self._connection is None else dict(self._connection.troubles)
        if self._taker.trouble is not None:
            troubles["outbox"] = f"events cannot be stored: {self._taker.trouble}"
        notes = [*troubles.values(), *self._heart.notes, *self._states.notes, *self._sender.notes]
        return ExportInfo(
            name=_NAME,
            target=f"{table.plant}.{table.cell} at {where}",
            connected=self._connection is not None,
            since=self._since,
            reason=self._reason,
            waiting_events=fill.events,
            waiting_bytes=fill.n_bytes,
            oldest=None if fill.oldest is None else max(0.0, time.time() - fill.oldest),
            sent={
                "samples": self._samples.n_sent,
                "states": self._states.n_sent,
                "events": self._sender.n_sent,
            },
            dropped_events=fill.dropped,
            notes=list(dict.fromkeys(notes)),
        )

    async def run(self) -> None:
        """Send for ever."""
        async with anyio.create_task_group() as tasks:
            tasks.start_soon(self._taker.run)
            tasks.start_soon(self._stay_connected)

    async def _stay_connected(self) -> None:
        delays = self._delays()
        with self._states.listening():
            for server in itertools.cycle(self._settings.access.servers):
                begun_s = time.monotonic()
                try:
                    await self._connect(server)
                except Trouble as trouble:
                    self._lose(trouble.reason)
                except Exception as error:  # noqa: BLE001 - the doors go on, and so does this
                    _LOG.exception("export.failed", subscriber=_NAME)
                    self._lose(f"internal error, see the log: {error!r}")
                if time.monotonic() - begun_s > _STEADY_S:
                    delays = self._delays()
                await anyio.sleep(next(delays))

    async def _connect(self, server: str) -> None:
        """Be connected until it ends.

        Raises:
            Trouble: Why it has ended, or could not begin.
        """
        table = self._settings.table
        async with connected(self._settings.access, server, f"robot-gateway {table.plant}.{table.cell}") as connection:
            self._connection, self._reason, self._since = connection, None, self._clock.utc_us()
            if self._repeats.recovery():
                _LOG.info("export.connected", subscriber=_NAME, peer=connection.address)
            async with anyio.create_task_group() as tasks:
                for name, work in (
                    ("events", self._sender.run),
                    ("states", self._states.run),
                    ("heartbeat", self._heart.run),
                    ("samples", self._samples.run),
                ):
                    tasks.start_soon(self._keep, name, work, connection)
                await connection.ended.wait()
                tasks.cancel_scope.cancel()
            raise Trouble(f"{connection.address}: {connection.why_ended()}")

    async def _keep(self, name: str, work: Callable[[Connection], Awaitable[None]], connection: Connection) -> None:
        """Do one kind of work for as long as the connection lasts; what goes wrong in it is retried by itself."""
        delays = self._delays()
        while not connection.client.is_closed:
            begun_s = time.monotonic()
            try:
                await work(connection)
            except Exception as error:  # noqa: BLE001 - whatever it is, it costs this kind of work only
                if not connection.client.is_closed:
                    self._note(connection, name, _only(error))
            if time.monotonic() - begun_s > _STEADY_S:
                delays = self._delays()
            await anyio.sleep(next(delays))

    def _note(self, connection: Connection, name: str, error: Exception) -> None:
        ours = isinstance(error, Trouble)
        reason = error.reason if isinstance(error, Trouble) else f"{name}: internal error, see the log: {error!r}"
        connection.troubles[name] = reason
        left_out = self._repeats.loss((name, reason), time.monotonic())
        if left_out is not None:
            told = None if ours else error
            _LOG.warning("export.troubled", subscriber=_NAME, reason=reason, exc_info=told, **_more(left_out))

    def _lose(self, reason: str) -> None:
        if self._connection is not None or self._reason == "connecting":
            self._since = self._clock.utc_us()
        self._connection, self._reason = None, reason
        left_out = self._repeats.loss("lost", time.monotonic())
        if left_out is not None:
            _LOG.warning("export.lost", subscriber=_NAME, reason=reason, **_more(left_out))


def _more(left_out: int) -> dict[str, int]:
    return {"n_dropped": left_out} if left_out else {}


def _only(error: Exception) -> Exception:
    """The first error of a group."""
    while isinstance(error, ExceptionGroup):
        error = error.exceptions[0]
    return error
