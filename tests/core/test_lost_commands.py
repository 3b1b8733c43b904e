"""What is lost when a session ends shows on the topic of command objects."""

from __future__ import annotations

import dataclasses

import anyio

from gateway.api.model import CommandsMissed, EventKind
from gateway.core.bus import Bus
from gateway.core.events import EventRing
from gateway.core.link import Link
from tests.core import toy
from tests.core.fakes import FakeConnection, FakeConnector, LoopClock, run_jumping


def test_the_end_of_a_session_is_a_gap_of_unknown_size_in_the_commands() -> None:
    async def main() -> None:
        settings = toy.settings()
        protocol = dataclasses.replace(settings.protocol, commands=True)
        connection = FakeConnection(lambda _: (toy.frame(),))
        bus = Bus(EventRing())
        link = Link(dataclasses.replace(settings, protocol=protocol), FakeConnector(connection), bus, LoopClock())
        async with anyio.create_task_group() as tasks:
            tasks.start_soon(link.run)
            await anyio.sleep(1)
            connection.end()
            await anyio.sleep(1)
            tasks.cancel_scope.cancel()
        ring = bus.topics[f"{settings.name}/commands"].ring
        assert ring is not None
        events, _ = ring.since(None, 10)
        assert [(event.kind, event.after) for event in events] == [(EventKind.COMMAND_MISSED, CommandsMissed())]

    run_jumping(main)
