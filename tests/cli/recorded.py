"""A gateway with a virtual robot, a recorder and a control socket, for the commands that speak to it."""

from __future__ import annotations

from collections import Counter
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass
from pathlib import Path

import anyio
from mcap.reader import make_reader

from gateway.notify import Notifier
from gateway.reloading import attended
from gateway.testing.cell import VirtualCell, virtual_cell


@dataclass(frozen=True, slots=True)
class Recorded:
    """A cell and its control socket."""

    cell: VirtualCell
    control: str


@asynccontextmanager
async def recorded_cell(folder: Path, count: int = 1, **recorder: object) -> AsyncIterator[Recorded]:
    """Robots that are online."""
    control = folder / "run" / "control.sock"
    control.parent.mkdir(mode=0o755, exist_ok=True)
    settings = {"before_s": 1.0, "after_s": 0.2, **recorder}
    doors = {"control": str(control)}
    async with virtual_cell("rainbow", count=count, scenario="steady", server=doors, recorder=settings) as cell:
        gateway = cell.gateway
        async with attended(gateway, Notifier(None), {}):
            with anyio.fail_after(5):
                while not all(info.link.state == "ONLINE" for info in gateway.infos()):  # noqa: ASYNC110
                    await anyio.sleep(0.02)
            yield Recorded(cell, str(control))


def topics(path: Path) -> Counter[str]:
    """How many messages each topic of a file has, as a reader of others sees it."""
    with path.open("rb") as file:
        return Counter(channel.topic for _, channel, _ in make_reader(file, validate_crcs=True).iter_messages())
