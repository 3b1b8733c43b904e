"""Runs the exporters, each in a task and a scope of its own: one that fails is started again, and no door notices."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import anyio
import structlog
from anyio.abc import TaskGroup

from gateway.api.messages import ExportInfo
from gateway.config.exports import ExportSettings, NatsSettings
from gateway.core.backoff import REFUSED_S
from gateway.export import Exporter, Source

_LOG = structlog.get_logger()
_END_S = 5.0


def _nats(settings: object, source: Source) -> Exporter:
    from gateway.export.nats import NatsExporter  # noqa: PLC0415 - nats-py may not be there

    if not isinstance(settings, NatsSettings):
        raise TypeError(settings)
    return NatsExporter(settings, source)


# By the name of their table in `[export]`.
MAKERS: Mapping[str, Callable[[object, Source], Exporter]] = {"nats": _nats}


@dataclass(slots=True)
class _Running:
    settings: object
    exporter: Exporter
    scope: anyio.CancelScope = field(default_factory=anyio.CancelScope)
    ended: anyio.Event = field(default_factory=anyio.Event)


class Exports:
    """The exporters of a gateway.

    Args:
        settings: Which there are.
        source: What they read.
    """

    def __init__(self, settings: ExportSettings, source: Source) -> None:
        self._settings = settings
        self._source = source
        self._running: dict[str, _Running] = {}
        self._tasks: TaskGroup | None = None

    def infos(self) -> list[ExportInfo]:
        """How each of them does."""
        return [one.exporter.info() for one in self._running.values()]

    async def run(self) -> None:
        """Run them for ever."""
        async with anyio.create_task_group() as self._tasks:
            await self.apply(self._settings)
            await anyio.sleep_forever()

    async def apply(self, settings: ExportSettings) -> None:
        """Take other settings: only what has changed is ended or started."""
        self._settings = settings
        if self._tasks is None:
            return
        for name, make in MAKERS.items():
            wanted = getattr(settings, name)
            running = self._running.get(name)
            if running is not None and running.settings != wanted:
                del self._running[name]
                running.scope.cancel()
                with anyio.move_on_after(_END_S):
                    await running.ended.wait()
            if wanted is not None and name not in self._running:
                one = self._running[name] = _Running(wanted, make(wanted, self._source))
                self._tasks.start_soon(self._keep, name, one)

    async def _keep(self, name: str, one: _Running) -> None:
        """Run one until its scope is cancelled, whatever it raises."""
        try:
            with one.scope:
                while True:
                    try:
                        await one.exporter.run()
                    except Exception:  # noqa: BLE001 - which costs the exporter alone
                        _LOG.exception("export.failed", subscriber=name)
                        await anyio.sleep(REFUSED_S)
        finally:
            one.ended.set()
