"""The check of the whole way, on real sockets: virtual controller, link, bus, WebSocket; dead, and back again."""

from __future__ import annotations

from collections.abc import AsyncIterator

import anyio

from gateway.api.messages import Data
from gateway.api.model import LinkState, Quality, Sample
from gateway.client import Client, Pushed, connect
from gateway.core.registry import Registry
from gateway.testing.cell import VirtualCell, virtual_cell
from gateway.testing.simulator_checks import simulator_answers
from gateway.testing.subject import CheckFailed, Subject

_SAMPLES = 5
_PATIENCE_S = 15.0
_ALIVE = {Quality.GOOD, Quality.SUBSTITUTED, Quality.UNCERTAIN}


async def data_arrives_and_returns(subject: Subject) -> None:
    """Samples of the virtual controller reach a WebSocket client; its death is said; it returns and they go on."""
    if "simulator_answers" not in subject.vendor.exempt:
        simulator_answers(subject)  # what fails at once needs no waiting
    registry = Registry([subject.folder.parent]) if subject.vendor.name not in Registry().names() else Registry()
    try:
        with anyio.fail_after(_PATIENCE_S):
            async with (
                virtual_cell(subject.vendor.name, protocol=subject.protocol.name, registry=registry) as cell,
                connect(cell.url) as client,
            ):
                await _live_and_die(cell, client)
    except TimeoutError:
        raise CheckFailed(f"no data within {_PATIENCE_S:g} s: run `robot-gateway simulate` and `run` by hand") from None


async def _live_and_die(cell: VirtualCell, client: Client) -> None:
    await client.subscribe(["r1/vendor"], mode="all")
    messages = client.pushed()
    first = await _alive(messages)
    await cell.controllers[0].stop()
    last = await _silent(messages)
    if last.t_last is None or any(value is not None for value in _leaves(last.data)):
        raise CheckFailed("the last sample after the controller's death must hold nulls and the time of the last frame")
    (robot,) = await client.robots()
    if robot.link.state is LinkState.ONLINE:
        raise CheckFailed("the link is ONLINE although the controller is dead")
    await cell.controllers[0].start()
    again = await _alive(messages)
    if again.epoch == first.epoch:
        raise CheckFailed("a new session must have a new epoch")


async def _alive(messages: AsyncIterator[Pushed]) -> Sample:
    """Wait for some live samples whose seq has no gap; return the last."""
    found: list[Sample] = []
    async for sample in _samples(messages):
        if sample.q in _ALIVE:
            if found and sample.seq != found[-1].seq + 1:
                raise CheckFailed(f"seq goes from {found[-1].seq} to {sample.seq} for a client that asked for all")
            found.append(sample)
        if len(found) == _SAMPLES:
            return found[-1]
    raise CheckFailed("the connection has ended")


async def _silent(messages: AsyncIterator[Pushed]) -> Sample:
    async for sample in _samples(messages):
        if sample.q not in _ALIVE:
            return sample
    raise CheckFailed("the connection has ended")


async def _samples(messages: AsyncIterator[Pushed]) -> AsyncIterator[Sample]:
    async for message in messages:
        if isinstance(message, Data):
            for sample in message.samples:
                yield sample


def _leaves(data: object) -> list[object]:
    return list(data.values()) if isinstance(data, dict) else [data]
