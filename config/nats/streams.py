"""Makes the hub's stream of events and bucket of states, which fetch from the cells; run again it takes more cells in.

HUB_ADMIN=… python config/nats/streams.py nats://plant.example.com:4222 plant1 cell1 cell2
"""

from __future__ import annotations

import asyncio
import os
import sys

import nats
from nats.js import JetStreamContext
from nats.js.api import ExternalStream, StorageType, StreamConfig, StreamSource, SubjectTransform
from nats.js.errors import NotFoundError

DAYS = 90


def source(stream: str, cell: str, take: str, to: str) -> StreamSource:
    """What is fetched of a cell: only its own subjects, whatever else it may have put into its stream."""
    return StreamSource(
        name=stream,
        external=ExternalStream(api=f"$JS.{cell}.API", deliver=f"fetch.{cell}"),
        subject_transforms=[SubjectTransform(src=take, dest=to)],
    )


def streams(plant: str, cells: list[str]) -> list[StreamConfig]:
    """The two streams of the hub."""
    events = StreamConfig(
        name=f"{plant}-events",
        storage=StorageType.FILE,
        max_age=DAYS * 86_400.0,
        allow_direct=True,
        sources=[source(f"{cell}-events", cell, f"{plant}.{cell}.>", f"{plant}.{cell}.>") for cell in cells],
    )
    states = StreamConfig(
        name=f"KV_{plant}",
        storage=StorageType.FILE,
        max_msgs_per_subject=1,
        allow_rollup_hdrs=True,
        deny_delete=True,
        allow_direct=True,
        sources=[source(f"KV_{cell}", cell, f"$KV.{cell}.{cell}.>", f"$KV.{plant}.{cell}.>") for cell in cells],
    )
    return [events, states]


async def make(jetstream: JetStreamContext, plant: str, cells: list[str]) -> None:
    """Make the streams, or give them more sources."""
    for config in streams(plant, cells):
        try:
            await jetstream.stream_info(str(config.name))
        except NotFoundError:
            await jetstream.add_stream(config)
        else:
            await jetstream.update_stream(config)


async def main(url: str, plant: str, *cells: str) -> None:
    """Connect and make them."""
    client = await nats.connect(url, user="admin", password=os.environ["HUB_ADMIN"])
    await make(client.jetstream(), plant, list(cells))
    await client.close()


if __name__ == "__main__":
    if len(sys.argv) < 4:  # noqa: PLR2004 - address, plant, and a cell
        sys.exit(__doc__)
    asyncio.run(main(*sys.argv[1:]))
