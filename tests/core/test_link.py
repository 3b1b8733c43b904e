from __future__ import annotations

import dataclasses
from collections.abc import Awaitable, Callable
from typing import cast

import anyio
import pytest
from structlog.testing import capture_logs

from gateway.api.decoder import Event as Decoded
from gateway.api.decoder import Refused
from gateway.api.framing import FramedDecoder
from gateway.api.model import Event, LinkStats, Sample, Status
from gateway.api.model import Link as LinkData
from gateway.core.backoff import no_waiting
from gateway.core.bus import Bus, Reading, Topic
from gateway.core.events import EventRing
from gateway.core.link import Link, announce_broken
from gateway.core.settings import BrokenRobot, RobotSettings
from gateway.errors import LinkClosed, VendorError
from tests.core import toy
from tests.core.fakes import FakeConnection, FakeConnector, LoopClock, run_jumping


class Inbox:
    """Keeps every sample and event of a robot."""

    def __init__(self, bus: Bus) -> None:
        self.samples: list[Sample] = []
        self.events: list[Event] = []
        for topic in bus.topics.values():
            topic.listeners = [self]

    def on_reading(self, topic: Topic, reading: Reading) -> None:
        self.samples.append(reading.sample(topic))

    def on_event(self, topic: Topic, event: Event) -> None:
        assert topic.group.name == "events"
        self.events.append(event)

    def of(self, group: str) -> list[Sample]:
        return [sample for sample in self.samples if sample.topic == f"r1/{group}"]

    @property
    def kinds(self) -> list[str]:
        return [event.kind.value for event in self.events]


def latest(bus: Bus, name: str) -> Sample:
    reading = bus.topics[name].latest
    assert reading is not None
    return reading.sample(bus.topics[name])


def link_of(bus: Bus) -> LinkData:
    return cast("LinkData", latest(bus, "r1/link").data)


def while_running(
    connector: FakeConnector,
    look: Callable[[Bus, Inbox, LoopClock], Awaitable[None]],
    robot: RobotSettings | None = None,
) -> None:
    """Run a link in virtual time while a test looks at its bus."""

    async def main() -> None:
        bus = Bus(EventRing(boot="b"))
        clock = LoopClock()
        link = Link(robot or toy.settings(), connector, bus, clock, no_waiting)
        inbox = Inbox(bus)
        async with anyio.create_task_group() as tasks:
            tasks.start_soon(link.run)
            await look(bus, inbox, clock)
            tasks.cancel_scope.cancel()

    run_jumping(main)


def good(_: bytes) -> tuple[bytes, ...]:
    return (toy.frame(),)


def stopping_after(count: int) -> FakeConnection:
    left = iter(range(count))
    return FakeConnection(lambda _: (toy.frame(),) if next(left, None) is not None else ())


def test_a_link_goes_from_connecting_over_handshaking_to_online() -> None:
    async def look(bus: Bus, inbox: Inbox, _: LoopClock) -> None:
        assert link_of(bus).state == "DISCONNECTED"
        await anyio.sleep(0.5)
        states = [cast("LinkData", sample.data).state.value for sample in inbox.of("link")]
        assert states == ["CONNECTING", "HANDSHAKING", "ONLINE"]
        assert link_of(bus).attempts == 0
        assert link_of(bus).layout == "toy"
        assert inbox.kinds[0] == "link.online"

    while_running(FakeConnector(FakeConnection(good)), look)


def test_before_the_first_frame_every_topic_says_that_nothing_is_known() -> None:
    async def look(bus: Bus, _: Inbox, __: LoopClock) -> None:
        sample = latest(bus, "r1/joints")
        assert (sample.q, sample.t_last) == ("DISCONNECTED", None)

    while_running(FakeConnector(), look)


def test_a_refused_connection_is_tried_again_with_its_reason_and_time_shown() -> None:
    async def main() -> None:
        bus = Bus(EventRing())
        connector = FakeConnector()
        async with anyio.create_task_group() as tasks:
            tasks.start_soon(Link(toy.settings(), connector, bus, LoopClock()).run)
            await anyio.sleep(0.1)
            link = link_of(bus)
            assert link.state == "DISCONNECTED"
            assert link.next_attempt is not None
            await anyio.sleep(60)
            tasks.cancel_scope.cancel()
        gaps = [after - before for before, after in zip(connector.attempts_s, connector.attempts_s[1:], strict=False)]
        assert 0.15 < gaps[0] < 0.25
        assert 3.9 < gaps[-1] < 6.1

    run_jumping(main)


def test_a_lost_session_gives_one_last_sample_an_event_and_a_new_epoch() -> None:
    async def look(bus: Bus, inbox: Inbox, _: LoopClock) -> None:
        await anyio.sleep(3.5)
        joints = inbox.of("joints")
        silent = [index for index, sample in enumerate(joints) if sample.q != "GOOD"]
        assert len(silent) == 1
        last, back = joints[silent[0]], joints[silent[0] + 1]
        assert (last.q, last.t_last) == ("STALE", joints[silent[0] - 1].t)
        assert back.epoch != last.epoch
        assert back.seq == 1
        assert inbox.kinds[:3] == ["link.online", "link.lost", "link.online"]
        assert link_of(bus).state == "ONLINE"
        assert link_of(bus).last_error == "no good frame for 1 s"

    while_running(FakeConnector(stopping_after(3), FakeConnection(good)), look)


def test_a_controller_that_closes_is_disconnected_not_stale() -> None:
    async def look(_: Bus, inbox: Inbox, __: LoopClock) -> None:
        await anyio.sleep(0.55)
        first.end()
        await anyio.sleep(0.1)
        assert [sample.q.value for sample in inbox.of("joints") if sample.q != "GOOD"] == ["DISCONNECTED"]
        errors = [cast("LinkData", sample.data).last_error for sample in inbox.of("link")]
        assert "the controller closed the connection" in errors

    first = FakeConnection(good)
    while_running(FakeConnector(first), look)
    assert first.closed


def test_a_faulty_plugin_faults_its_link_and_is_tried_again_slowly() -> None:
    class Broken(FakeConnection):
        async def receive(self) -> bytes:
            raise ZeroDivisionError("a plugin's mistake")

    async def look(bus: Bus, _: Inbox, __: LoopClock) -> None:
        with capture_logs() as logs:
            await anyio.sleep(5)
        assert link_of(bus).state == "FAULTED"
        assert "a plugin's mistake" in (link_of(bus).reason or "")
        assert [log["event"] for log in logs].count("link.faulted") == 1
        await anyio.sleep(10)
        assert link_of(bus).state == "ONLINE"

    while_running(FakeConnector(Broken(), FakeConnection(good)), look)


def test_a_failure_that_repeats_is_logged_once_and_so_is_the_recovery() -> None:
    async def look(_: Bus, __: Inbox, ___: LoopClock) -> None:
        with capture_logs() as logs:
            await anyio.sleep(1)
        assert [log["event"] for log in logs] == ["link.lost", "link.connected"]
        assert logs[1]["attempts"] == 6

    refused = [LinkClosed("connection refused") for _ in range(5)]
    while_running(FakeConnector(*refused, FakeConnection(good)), look)


def test_a_kept_session_goes_stale_and_online_again_in_the_same_connection() -> None:
    connection = FakeConnection()

    async def look(bus: Bus, inbox: Inbox, _: LoopClock) -> None:
        await anyio.sleep(0.1)
        connection.push(toy.frame())
        await anyio.sleep(2)
        assert link_of(bus).state == "STALE"
        connection.push(toy.frame())
        await anyio.sleep(0.1)
        assert link_of(bus).state == "ONLINE"
        assert inbox.kinds == ["link.online", "link.lost", "link.online"]
        assert len({sample.epoch for sample in inbox.of("joints") if sample.q == "GOOD"}) == 1

    while_running(FakeConnector(connection), look, toy.settings(pushed=True, on_stale="keep"))


def test_the_layout_says_how_much_of_a_longer_frame_is_not_explained() -> None:
    async def look(bus: Bus, _: Inbox, __: LoopClock) -> None:
        await anyio.sleep(0.5)
        assert link_of(bus).layout == "toy + 8 bytes that the layout does not explain"
        assert latest(bus, "r1/joints").q == "UNCERTAIN"

    while_running(FakeConnector(FakeConnection(lambda _: (toy.frame(extra=8),))), look)


def test_counters_and_the_reached_rate_are_said_once_a_second() -> None:
    async def look(bus: Bus, inbox: Inbox, _: LoopClock) -> None:
        await anyio.sleep(5.5)
        stats = [cast("LinkStats", sample.data) for sample in inbox.of("link_stats")]
        assert len(stats) == 5
        last = stats[-1]
        assert last.frames == 50
        assert last.rejects == {"junk": 50}
        assert last.skipped == 50
        assert last.gaps is None
        assert last.interval_p50 == pytest.approx(0.1, abs=0.001)
        assert link_of(bus).reached_hz == 10.0
        assert link_of(bus).requested_hz == 10.0

    while_running(FakeConnector(FakeConnection(lambda _: (toy.OTHER, b"??", toy.frame()))), look)


def test_a_clock_set_back_by_hours_begins_a_new_epoch_without_a_new_connection() -> None:
    async def look(_: Bus, inbox: Inbox, clock: LoopClock) -> None:
        await anyio.sleep(0.55)
        clock.set_by_us = -7_200_000_000
        await anyio.sleep(1)
        joints = inbox.of("joints")
        epochs = list(dict.fromkeys(sample.epoch for sample in joints))
        assert len(epochs) == 2
        for epoch in epochs:
            times = [sample.t for sample in joints if sample.epoch == epoch]
            assert times == sorted(times)
        assert joints[-1].t < joints[0].t
        assert all(sample.q == "GOOD" for sample in joints)

    while_running(FakeConnector(FakeConnection(good)), look)


def test_a_robot_whose_plugin_is_broken_is_shown_faulted_with_the_reason() -> None:
    async def main() -> None:
        bus = Bus(EventRing())
        robot = BrokenRobot(name="r1", host="h", vendor="v", protocol="", error=VendorError("v", "cannot be imported"))
        announce_broken(robot, bus, LoopClock())
        assert link_of(bus).state == "FAULTED"
        assert link_of(bus).reason == "vendor v: cannot be imported"

    run_jumping(main)


def test_a_link_that_is_off_says_since_when_and_why_through_all_its_retries() -> None:
    async def main() -> None:
        bus = Bus(EventRing())
        clock = LoopClock()
        async with anyio.create_task_group() as tasks:
            tasks.start_soon(Link(toy.settings(), FakeConnector(), bus, clock).run)
            await anyio.sleep(0.1)
            since = link_of(bus).since
            await anyio.sleep(60)
            assert link_of(bus).since == since
            assert link_of(bus).reason == "connection refused"
            tasks.cancel_scope.cancel()

    run_jumping(main)


def test_a_clock_set_back_renews_the_epochs_of_the_links_own_topics_and_moves_since() -> None:
    async def look(bus: Bus, inbox: Inbox, clock: LoopClock) -> None:
        await anyio.sleep(2.5)
        since = link_of(bus).since
        clock.set_by_us = -3_600_000_000
        await anyio.sleep(2)
        for group in ("link", "link_stats"):
            for epoch in {sample.epoch for sample in inbox.of(group)}:
                times = [sample.t for sample in inbox.of(group) if sample.epoch == epoch]
                assert times == sorted(times)
        assert link_of(bus).since == since - 3_600_000_000

    while_running(FakeConnector(FakeConnection(good)), look)


def test_whoever_asks_for_state_gets_the_newest_frame_although_nothing_was_published() -> None:
    count = iter(range(1000))

    async def look(bus: Bus, inbox: Inbox, _: LoopClock) -> None:
        await anyio.sleep(5.05)
        program = cast("Status", latest(bus, "r1/status").data).program
        assert program is not None
        assert program.run_time == 50
        assert len(inbox.of("status")) == 1

    while_running(FakeConnector(FakeConnection(lambda _: (toy.frame(run_time=next(count)),))), look)


def test_a_link_that_flaps_backs_off_and_one_that_was_steady_does_not() -> None:
    async def main() -> None:
        connector = FakeConnector(*(FakeConnection(lambda _: (toy.frame() + toy.frame(),)) for _ in range(100)))
        async with anyio.create_task_group() as tasks:
            tasks.start_soon(Link(toy.settings(), connector, Bus(EventRing()), LoopClock()).run)
            await anyio.sleep(60)
            tasks.cancel_scope.cancel()
        assert len(connector.attempts_s) < 25

    run_jumping(main)


def test_a_kept_session_that_is_refused_stays_open_and_says_so() -> None:
    class Picky(FramedDecoder):
        def feed(self, data: bytes) -> list[Decoded]:
            return [Refused("900 bytes, known is 20", "incompatible")] if data == b"strange" else super().feed(data)

    robot = toy.settings(pushed=True, on_stale="keep")
    protocol = dataclasses.replace(robot.protocol, make_decoders=lambda *_: lambda: Picky(toy.FRAMING))
    connection = FakeConnection()

    async def look(bus: Bus, inbox: Inbox, _: LoopClock) -> None:
        await anyio.sleep(0.1)
        connection.push(toy.frame())
        connection.push(b"strange")
        await anyio.sleep(0.1)
        assert (link_of(bus).state, link_of(bus).reason) == ("INCOMPATIBLE", "900 bytes, known is 20")
        assert "link.incompatible" in inbox.kinds
        connection.push(toy.frame())
        await anyio.sleep(0.1)
        assert link_of(bus).state == "ONLINE"
        assert not connection.closed

    while_running(FakeConnector(connection), look, dataclasses.replace(robot, protocol=protocol))
