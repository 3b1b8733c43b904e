"""The client that goes on for ever: cuts, restarts, refusals, and what its consumer is told of them."""

from __future__ import annotations

import itertools
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager

import anyio
import anyio.abc
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.api.messages import Missed
from gateway.api.model import Event, Joints, LinkState, Sample, Status
from gateway.client import (
    ClientError,
    Connected,
    Disconnected,
    Follower,
    Item,
    Refused,
    RequestError,
    follow,
    typed,
)
from gateway.client.following import backoff
from gateway.core.bus import Bus
from gateway.core.events import EventRing
from gateway.server.cell import Cell
from gateway.server.http import listening
from gateway.server.settings import DoorSettings
from gateway.testing.cell import free_port
from tests.server.kit import BOOT, Robot, cell, publish, raise_command, raise_event, reading, running_door


def at_once() -> Iterator[float]:
    """Delays without the waiting."""
    return itertools.repeat(0.01)


@asynccontextmanager
async def door(bus: Bus, robots: list[Robot], port: int) -> AsyncIterator[None]:
    """The doors of a gateway on a port of one's choice."""
    async with listening(Cell(robots, bus), "127.0.0.1", port, DoorSettings()):
        yield


class Wire:
    """A TCP relay between client and gateway that can be cut, and lets nobody through while it is `closed`."""

    def __init__(self, port: int) -> None:
        self._to = port
        self._streams: list[anyio.abc.SocketStream] = []
        self.port = 0
        self.closed = False

    async def cut(self) -> None:
        """Cut every connection that stands, in the middle of whatever is under way."""
        for stream in self._streams:
            await anyio.aclose_forcefully(stream)
        self._streams.clear()

    async def serve(self, *, task_status: anyio.abc.TaskStatus[None]) -> None:
        """Relay connections until cancelled."""
        async with await anyio.create_tcp_listener(local_host="127.0.0.1") as listener:
            self.port = listener.extra(anyio.abc.SocketAttribute.local_port)  # noqa: S610 - no Django here
            task_status.started()
            await listener.serve(self._relay)

    async def _relay(self, near: anyio.abc.SocketStream) -> None:
        if self.closed:
            await anyio.aclose_forcefully(near)
            return
        async with near, await anyio.connect_tcp("127.0.0.1", self._to) as far:
            self._streams += [near, far]
            async with anyio.create_task_group() as tasks:
                for one, other in ((near, far), (far, near)):
                    tasks.start_soon(self._pump, one, other, tasks.cancel_scope)

    async def _pump(self, one: anyio.abc.SocketStream, other: anyio.abc.SocketStream, scope: anyio.CancelScope) -> None:
        try:
            async for chunk in one:
                await other.send(chunk)
        except (anyio.BrokenResourceError, anyio.ClosedResourceError):
            pass
        scope.cancel()


@asynccontextmanager
async def wired(url: str) -> AsyncIterator[tuple[Wire, str]]:
    """A relay to a door, and its address."""
    wire = Wire(int(url.rpartition(":")[2].partition("/")[0]))
    async with anyio.create_task_group() as tasks:
        await tasks.start(wire.serve)
        yield wire, f"ws://127.0.0.1:{wire.port}/ws"
        tasks.cancel_scope.cancel()


async def until(follower: Follower, kind: type[Item]) -> list[Item]:
    """Everything up to the next item of a kind."""
    found: list[Item] = []
    with anyio.fail_after(5):
        async for item in follower:
            found.append(item)
            if isinstance(item, kind):
                return found
    raise AssertionError


async def events(follower: Follower, count: int) -> list[str]:
    """The names of the next events."""
    names: list[str] = []
    while len(names) < count:
        item = (await until(follower, Event))[-1]
        assert isinstance(item, Event)
        names.append(item.name)
    return names


async def test_samples_come_typed_and_events_beside_them() -> None:
    bus, robots = cell("r1")
    publish(bus, "r1/joints", 4)
    async with running_door(bus, robots) as url, follow(url) as follower:
        await follower.subscribe(["r1/joints", "r1/events"])
        assert follower.topics == ["r1/joints", "r1/events"]
        (connected, sample) = await until(follower, Sample)
        assert isinstance(connected, Connected)
        assert connected.welcome.robots == ["r1"]
        assert isinstance(sample, Sample)
        assert isinstance(sample.data, Joints)
        assert sample.data.position == [4.0, None]
        raise_event(bus, "r1")
        assert await events(follower, 1) == [f"{BOOT}:1"]


async def test_a_choice_of_fields_and_a_vendors_own_data_stay_as_they_came() -> None:
    bus, robots = cell("r1")
    publish(bus, "r1/joints", 1)
    publish(bus, "r1/vendor", 1, {"a": 1})
    async with running_door(bus, robots) as url, follow(url) as follower:
        await follower.subscribe(["r1/joints"], fields=["position"])
        await follower.subscribe(["r1/vendor"])
        found = [*await until(follower, Sample), *await until(follower, Sample)]
        assert [item.data for item in found if isinstance(item, Sample)] == [{"position": [1.0, None]}, {"a": 1}]


def test_data_that_only_a_later_gateway_knows_stays_as_it_came() -> None:
    whole = reading("r1/status", 1, Status()).sample
    (topic,) = cell("r1")[0].match(["r1/status"])
    sample = whole(topic)
    told = dict.fromkeys(Status.__struct_fields__) | {"power": "HOVERING"}
    strange = Sample(topic="r1/status", seq=1, epoch="e", t=1, q=sample.q, data=told)
    assert typed(strange) is strange
    assert typed(Sample(topic="r1/events", seq=1, epoch="e", t=1, q=sample.q, data={})).data == {}


async def test_a_cut_loses_no_event_and_doubles_none_in_any_ring() -> None:
    bus, robots = cell("r1", "r2", command_ring=1000)
    raise_event(bus, "r1")
    async with running_door(bus, robots) as url, wired(url) as (wire, through), follow(through, delays=at_once) as one:
        await one.subscribe(["*/events", "*/commands"])
        await one.subscribe(["r1/*"], rate_hz=5)  # the same events again
        expected: list[str] = []
        told: list[str] = []
        for round_ in range(4):
            for number in range(30):
                raise_event(bus, "r1")
                raise_event(bus, "r2")
                expected += [f"{BOOT}:{bus.events.last_seq - 1}", f"{BOOT}:{bus.events.last_seq}"]
                expected.append(raise_command(bus, "r1", number))
                if number == 15:
                    told += await events(one, 1 + 20 * (round_ > 0))
                    await wire.cut()
        told += await events(one, len(expected) - len(told))
        for ring in {name.partition(":")[0] for name in expected}:
            assert [name for name in told if name.startswith(ring)] == [
                name for name in expected if name.startswith(ring)
            ]
        assert one.missed_events == 0


async def test_its_consumer_is_told_of_a_cut_before_anything_new_comes() -> None:
    bus, robots = cell("r1")
    async with running_door(bus, robots) as url, wired(url) as (wire, through), follow(through, delays=at_once) as one:
        await one.subscribe(["r1/joints"], mode="all")
        publish(bus, "r1/joints", 1)
        await until(one, Sample)
        await wire.cut()
        publish(bus, "r1/joints", 2)
        lost, connected, sample = await until(one, Sample)
        assert isinstance(lost, Disconnected)
        assert (lost.attempts, lost.retry_s) == (0, 0.01)
        assert "the connection has ended" in lost.reason
        assert isinstance(connected, Connected)
        assert isinstance(sample, Sample)
        assert sample.seq == 2


async def test_a_gateway_that_starts_anew_is_waited_for_and_its_loss_of_events_is_told() -> None:
    port = free_port()
    url = f"ws://127.0.0.1:{port}/ws"
    bus, robots = cell("r1")
    async with follow(url, delays=at_once) as one:
        await one.subscribe(["*/events", "*/joints"])
        (refused,) = await until(one, Disconnected)
        assert isinstance(refused, Disconnected)
        assert refused.attempts == 1
        async with door(bus, robots, port):
            await until(one, Connected)
            raise_event(bus, "r1")
            assert await events(one, 1) == [f"{BOOT}:1"]
        lost = (await until(one, Disconnected))[-1]
        assert isinstance(lost, Disconnected)
        assert lost.reason == "the connection has ended: the gateway is stopping"
        again = Bus(EventRing(100, "n3w"))
        again.add("r1", ["joints", "events"])
        raise_event(again, "r1")
        async with door(again, robots, port):
            await until(one, Connected)
            assert await events(one, 1) == ["n3w:1"]
            missed = (await until(one, Missed))[-1]
            assert isinstance(missed, Missed)
            assert missed.events is None
            assert one.missed_events is None
        async with door(again, robots, port):  # once told, it is not told again
            await until(one, Connected)
            raise_event(again, "r1")
            assert await events(one, 1) == ["n3w:2"]
            publish(again, "r1/joints", 9)
            assert not [item for item in await until(one, Sample) if isinstance(item, Missed)]


async def test_what_the_gateway_does_not_have_any_more_is_said_and_asked_for_again_later() -> None:
    port = free_port()
    url = f"ws://127.0.0.1:{port}/ws"
    bus, robots = cell("r1", "r2")
    only, one_robot = cell("r1")
    async with follow(url, delays=at_once) as follower:
        await follower.subscribe(["r1/joints"])
        await follower.subscribe(["r2/joints"])
        async with door(only, one_robot, port):
            refused = (await until(follower, Refused))[-1]
            assert isinstance(refused, Refused)
            assert (refused.topics, refused.code) == (("r2/joints",), "UNKNOWN_TOPIC")
            assert follower.topics == ["r1/joints"]
        publish(bus, "r2/joints", 3)
        async with door(bus, robots, port):
            sample = (await until(follower, Sample))[-1]
            assert isinstance(sample, Sample)
            assert sample.topic == "r2/joints"


async def test_a_wrong_wish_is_refused_at_once_and_not_asked_again() -> None:
    bus, robots = cell("r1")
    async with running_door(bus, robots) as url, wired(url) as (wire, through), follow(through, delays=at_once) as one:
        with pytest.raises(RequestError, match="did you mean"):
            await one.subscribe(["r1/jonts"])
        await wire.cut()
        assert not [item for item in await until(one, Disconnected) if isinstance(item, Refused)]
        (connected,) = await until(one, Connected)
        assert isinstance(connected, Connected)
        assert one.n_ready == 0


async def test_a_step_may_be_cancelled_and_nothing_is_lost() -> None:
    bus, robots = cell("r1")
    async with running_door(bus, robots) as url, follow(url) as follower:
        await follower.subscribe(["r1/events"])
        await until(follower, Connected)
        for _ in range(5):
            with anyio.move_on_after(0.01):
                await anext(follower)
        for _ in range(3):
            raise_event(bus, "r1")
        assert await events(follower, 3) == [f"{BOOT}:{seq}" for seq in (1, 2, 3)]


async def test_requests_go_through_the_connection_of_the_moment() -> None:
    bus, robots = cell("r1")
    async with running_door(bus, robots) as url:
        async with follow(url) as follower:
            assert follower.client is not None
            (robot,) = await follower.client.robots()
            assert robot.link.state is LinkState.ONLINE
        assert follower.client is None


async def test_missed_samples_are_told_and_summed() -> None:
    bus, robots = cell("r1")
    async with running_door(bus, robots) as url, follow(url) as follower:
        await follower.subscribe(["r1/joints"])
        for seq in range(1, 40):
            publish(bus, "r1/joints", seq)
        missed = (await until(follower, Missed))[-1]
        assert isinstance(missed, Missed)
        assert follower.missed_samples["r1/joints"] == missed.samples["r1/joints"] > 0


async def test_impatient_it_says_that_nobody_is_there_and_an_address_that_is_none_is_never_waited_for() -> None:
    with pytest.raises(ClientError, match="no gateway answers") as refused:
        async with follow("ws://127.0.0.1:1/ws", patient=False):
            pass
    assert not refused.value.lasting
    with pytest.raises(ClientError, match="one looks like") as wrong:
        async with follow("foo"):
            pass
    assert wrong.value.lasting


@given(st.integers(1, 60))
def test_the_delays_grow_to_five_seconds_and_no_further(count: int) -> None:
    delays = list(itertools.islice(backoff(), count))
    assert 0.16 <= delays[0] <= 0.24
    assert all(0.16 <= delay <= 6.0 for delay in delays)


async def test_a_flood_of_events_with_cuts_comes_whole_and_in_order() -> None:
    bus, robots = cell("r1", ring=20_000)
    async with running_door(bus, robots) as url, wired(url) as (wire, through), follow(through, delays=at_once) as one:
        await one.subscribe(["*/events"])
        told: list[str] = []
        for _ in range(5):
            for _ in range(2000):
                raise_event(bus, "r1")
            told += await events(one, 700)
            await wire.cut()
        told += await events(one, 10_000 - len(told))
        assert told == [f"{BOOT}:{seq}" for seq in range(1, 10_001)]
        assert one.missed_events == 0


async def test_while_nobody_gets_through_each_attempt_is_told_and_then_everything_comes() -> None:
    bus, robots = cell("r1")
    async with running_door(bus, robots) as url, wired(url) as (wire, through), follow(through, delays=at_once) as one:
        await one.subscribe(["*/events"])
        await until(one, Connected)
        wire.closed = True
        await wire.cut()
        raise_event(bus, "r1")
        lost = [(await until(one, Disconnected))[-1] for _ in range(3)]
        assert [item.attempts for item in lost if isinstance(item, Disconnected)] == [0, 1, 2]
        assert one.client is None
        wire.closed = False
        assert await events(one, 1) == [f"{BOOT}:1"]
