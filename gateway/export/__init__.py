"""Exporters: what sends the cell on to other systems. Each is a subscriber of the bus like any other.

One more exporter, such as MQTT, would be one more file that gives:

- a class with `info()`, which tells how it does, and `run()`, which sends for ever and is cancelled to end it
  (`Exporter` below). It listens with `Topic.listeners`, watches topics come and go with `Bus.watch`, and reads
  `Topic.latest` at its own rate; it returns at once from whatever the bus calls. For events it takes an `EventTaker`,
  which brings them from the rings into an `Outbox` on disk, and sends from there what is not acknowledged;
- a row in `gateway.export.running.MAKERS`, and a table in `gateway.config.exports`.

Whatever it raises costs itself alone: `gateway.export.running` starts it again. Nothing here is imported by the doors.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from gateway.api.messages import ExportInfo, RobotInfo
from gateway.core.bus import Bus
from gateway.core.clock import Clock


@dataclass(frozen=True, slots=True, kw_only=True)
class Source:
    """What an exporter reads.

    Attributes:
        bus: The topics and the events.
        infos: Tells every robot with the state of its link.
        clock: Both times.
    """

    bus: Bus
    infos: Callable[[], list[RobotInfo]]
    clock: Clock


class Exporter(Protocol):
    """One that sends the cell on."""

    def info(self) -> ExportInfo:
        """How it does, at once."""
        ...

    async def run(self) -> None:
        """Send for ever. It never ends by itself, whatever the other side does."""
        ...
