"""Makes the picture of a plant's page: `python -m tests.export.pictures FOLDER`; three cells, one of them silent."""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import anyio
import anyio.abc

from gateway import logs
from gateway.config.exports import NatsAccess
from gateway.plant import open_doors, reading
from gateway.server.settings import DoorSettings
from tests.dashboard.browser import WIDE, browsing, open_page, page_url
from tests.export.kit import exporting, nats_server
from tests.export.load import Load, plants, work

_LIVE_S = 6.0
_SILENT_S = 9.0


async def picture(folder: Path) -> list[str]:
    """Take it; returns what the browser complained of."""
    with tempfile.TemporaryDirectory() as name, nats_server(Path(name) / "hub") as server:
        load = Load(server=server.url, folder=name, cells=2, robots=4, samples_hz=10, seconds=60)
        off = Load(server=server.url, folder=name, cells=1, robots=2, first=3, seconds=_LIVE_S)
        async with (
            anyio.create_task_group() as tasks,
            reading(NatsAccess(servers=(server.url,)), "plant1") as plant,
            open_doors(plant, "127.0.0.1", 0, DoorSettings(flush_s=0.002)) as doors,
            browsing(WIDE, "light") as context,
        ):
            tasks.start_soon(live, load)
            tasks.start_soon(live, off)
            watched = await open_page(context, page_url(f"ws://127.0.0.1:{doors.port}/ws"))
            await watched.until("document.querySelectorAll('.card').length === 10")
            await anyio.sleep(_LIVE_S + _SILENT_S)
            await watched.page.screenshot(path=folder / "plant-1280-light.png", full_page=True)
            tasks.cancel_scope.cancel()
        return list(watched.complaints)


async def live(load: Load) -> None:
    """Let some cells live for their time."""
    made = plants(load)
    async with exporting(*(plant.exporter for plant in made)):
        await work(load, made)


if __name__ == "__main__":
    logs.configure("error")
    print(anyio.run(picture, Path(sys.argv[1])))
