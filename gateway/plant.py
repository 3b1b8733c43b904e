"""The doors of a whole plant: the same page and the same protocol as a gateway's, filled from NATS."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass

import anyio

from gateway.config.exports import NatsAccess
from gateway.core.bus import Bus
from gateway.core.events import EventRing
from gateway.export.cells import Cells
from gateway.export.plant import PlantReader
from gateway.server.cell import Cell
from gateway.server.http import listening
from gateway.server.listener import Listener
from gateway.server.settings import DoorSettings


@dataclass(frozen=True, slots=True, kw_only=True)
class Plant:
    """A plant as it is read now.

    Attributes:
        bus: Its topics and events.
        cell: What doors show: robots are named `cell/robot`.
        cells: Its cells.
        reader: Who reads it.
    """

    bus: Bus
    cell: Cell
    cells: Cells
    reader: PlantReader


@asynccontextmanager
async def reading(access: NatsAccess, name: str | None = None, ring: int = 20_000) -> AsyncIterator[Plant]:
    """Read a plant for as long as the context lasts.

    Args:
        access: How its server is reached.
        name: Of the plant; None: the only one that the server has.
        ring: How many events are kept.
    """
    bus = Bus(EventRing(ring))
    cell = Cell((), bus)
    cells = Cells(bus, cell.replace)
    reader = PlantReader(access, cells, name)
    async with anyio.create_task_group() as tasks:
        tasks.start_soon(reader.run)
        try:
            yield Plant(bus=bus, cell=cell, cells=cells, reader=reader)
        finally:
            tasks.cancel_scope.cancel()


@asynccontextmanager
async def open_doors(plant: Plant, host: str, port: int, settings: DoorSettings) -> AsyncIterator[Listener]:
    """Open the doors of a plant for as long as the context lasts.

    Raises:
        ListenError: The address is taken or not allowed.
    """
    async with listening(plant.cell, host, port, settings) as doors:
        yield doors
