from __future__ import annotations

import dataclasses
import math
from collections.abc import Awaitable, Callable
from typing import cast

import anyio
import msgspec
import pytest
from structlog.testing import capture_logs

from gateway.api.decoder import Decoder, Refused
from gateway.api.decoder import Event as Decoded
from gateway.api.framing import FramedDecoder
from gateway.api.model import Command, Event, Joints, LinkStats, Sample, Status
from gateway.api.model import Link as LinkData
from gateway.api.vendor import DecoderFactory
from gateway.core.backoff import no_waiting
from gateway.core.bus import Bus, Reading, Topic
from gateway.core.events import EventRing
from gateway.core.link import Link, announce_broken
from gateway.core.settings import BrokenRobot, RobotSettings
from gateway.core.transport import Connection
from gateway.errors import LinkClosed, VendorError
from tests.core import toy, toy_text
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
        if topic.group.name == "events":
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


def _cannot_begin(_: msgspec.Struct, __: float) -> DecoderFactory:
    raise ZeroDivisionError("a plugin's mistake")


def _cannot_begin_a_session(_: msgspec.Struct, __: float) -> DecoderFactory:
    def fail() -> Decoder:
        raise ZeroDivisionError("a plugin's mistake")

    return fail


@pytest.mark.parametrize("make", [_cannot_begin, _cannot_begin_a_session])
def test_a_plugin_that_cannot_make_its_decoders_faults_its_link_and_opens_no_connection(
    make: Callable[[msgspec.Struct, float], DecoderFactory],
) -> None:
    connector = FakeConnector(FakeConnection())
    settings = toy.settings()
    broken = dataclasses.replace(settings, protocol=dataclasses.replace(settings.protocol, make_decoders=make))

    async def look(bus: Bus, _: Inbox, __: LoopClock) -> None:
        with capture_logs() as logs:
            await anyio.sleep(5)
        assert link_of(bus).state == "FAULTED"
        assert "a plugin's mistake" in (link_of(bus).reason or "")
        assert [log["event"] for log in logs].count("link.faulted") == 1
        assert not connector.attempts_s

    while_running(connector, look, broken)


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


VALUES: dict[str, object] = {"pos": [90.0], "vel": [1.0], "mode": "MANUAL", "stop": False}


def text_connection(**values: object) -> FakeConnection:
    return FakeConnection(toy_text.answering({**VALUES, **values}))


def test_values_are_asked_in_turn_and_the_link_says_how_often_each_comes() -> None:
    connection = text_connection()

    async def look(bus: Bus, _: Inbox, __: LoopClock) -> None:
        await anyio.sleep(20.5)
        link = link_of(bus)
        assert (link.state, link.layout, link.requested_hz) == ("ONLINE", "toy_text", 10.0)
        assert link.parts_hz == pytest.approx({"pos": 5.0, "vel": 2.0, "mode": 1.0, "stop": 1.0}, rel=0.35)
        assert latest(bus, "r1/joints").data == Joints(position=[math.pi / 2], velocity=[math.pi / 180])
        assert cast("Status", latest(bus, "r1/status").data).operating_mode == "MANUAL"

    while_running(FakeConnector(connection), look, toy_text.settings())
    assert connection.sent[-1] == b"bye\n"
    assert connection.sent.count(b"pos\n") == pytest.approx(103, abs=3)


def test_a_link_that_is_off_has_no_rates_of_parts() -> None:
    connection = text_connection()

    async def look(bus: Bus, _: Inbox, __: LoopClock) -> None:
        await anyio.sleep(5.5)
        assert link_of(bus).parts_hz
        connection.end()
        await anyio.sleep(1.5)
        assert link_of(bus).parts_hz == {}

    while_running(FakeConnector(connection), look, toy_text.settings())


def test_a_value_that_is_no_longer_answered_is_null_within_its_age_and_a_second_and_the_link_stays() -> None:
    values = dict(VALUES)
    connection = FakeConnection(toy_text.answering(values))

    async def look(bus: Bus, inbox: Inbox, _: LoopClock) -> None:
        await anyio.sleep(5.05)
        del values["mode"], values["stop"]
        await anyio.sleep(4.1)
        status = cast("Status", latest(bus, "r1/status").data)
        assert (status.operating_mode, status.e_stopped) == (None, None)
        assert link_of(bus).state == "ONLINE"
        assert inbox.kinds == ["link.online", "mode.changed"]

    while_running(FakeConnector(connection), look, toy_text.settings(stale_s=2.0))


def test_a_reconnect_of_a_link_in_parts_raises_no_edges_but_its_own_and_shows_no_old_value() -> None:
    first, second = text_connection(), text_connection(vel=[2.0])

    async def look(_: Bus, inbox: Inbox, __: LoopClock) -> None:
        await anyio.sleep(5)
        first.end()
        await anyio.sleep(5)
        assert inbox.kinds == ["link.online", "link.lost", "link.online"]
        joints = inbox.of("joints")
        lost = next(index for index, sample in enumerate(joints) if sample.q == "DISCONNECTED")
        velocities = [cast("Joints", sample.data).velocity for sample in joints[lost:]]
        assert [math.pi / 180] not in velocities
        assert [math.pi / 90] in velocities
        for epoch in {sample.epoch for sample in joints}:
            inside = [sample for sample in joints if sample.epoch == epoch]
            assert [sample.t for sample in inside] == sorted(sample.t for sample in inside)
            assert [sample.seq for sample in inside] == list(range(1, len(inside) + 1))

    while_running(FakeConnector(first, second), look, toy_text.settings())


def test_a_clock_set_back_leaves_the_values_of_a_link_in_parts() -> None:
    async def look(_: Bus, inbox: Inbox, clock: LoopClock) -> None:
        await anyio.sleep(5.05)
        clock.set_by_us = -7_200_000_000
        await anyio.sleep(3)
        joints = inbox.of("joints")
        assert len({sample.epoch for sample in joints}) == 2
        for told in (cast("Joints", sample.data) for sample in joints[5:]):
            assert told.position is not None
            assert told.velocity is not None
        assert inbox.kinds == ["link.online"]

    while_running(FakeConnector(text_connection()), look, toy_text.settings())


def test_command_objects_go_to_their_own_topic_and_make_nothing_fresh() -> None:
    connection = FakeConnection()

    async def look(bus: Bus, inbox: Inbox, _: LoopClock) -> None:
        commands = bus.topics["r1/commands"]
        await anyio.sleep(0.1)
        connection.push(b"#one\n#two\n")
        await anyio.sleep(0.1)
        assert link_of(bus).state == "HANDSHAKING"
        assert commands.ring is not None
        events, _gone = commands.ring.since(None, 10)
        assert [cast("Command", event.after).object for event in events] == [{"to": "one"}, {"to": "two"}]
        assert bus.events.last_seq == 0
        connection.push(b"pos=[1]\n")
        while link_of(bus).state == "ONLINE" or not inbox.kinds:
            connection.push(b"#on and on\n")
            await anyio.sleep(0.1)
        assert inbox.events[1].raw == {"reason": "no good frame for 2 s"}

    while_running(FakeConnector(connection), look, toy_text.settings())


def test_gaps_are_counted_over_the_sessions() -> None:
    first, second = FakeConnection(), FakeConnection()

    async def look(bus: Bus, _: Inbox, __: LoopClock) -> None:
        assert "gaps" not in repr(bus.topics["r1/link_stats"].latest)
        await anyio.sleep(0.1)
        first.push(b"pos=[1]\nn=1\nn=4\n")
        await anyio.sleep(1)
        assert stats_of(bus).gaps == 2
        first.end()
        await anyio.sleep(0.5)
        second.push(b"pos=[1]\n")
        await anyio.sleep(1)
        assert stats_of(bus).gaps == 2
        second.push(b"n=9\nn=11\n")
        await anyio.sleep(1)
        assert (stats_of(bus).gaps, stats_of(bus).sessions) == (3, 2)

    while_running(FakeConnector(first, second), look, toy_text.settings())


def stats_of(bus: Bus) -> LinkStats:
    return cast("LinkStats", latest(bus, "r1/link_stats").data)


def test_what_the_transport_notes_and_refuses_is_shown_and_counted() -> None:
    connector = FakeConnector(FakeConnection(good))

    async def look(bus: Bus, _: Inbox, __: LoopClock) -> None:
        await anyio.sleep(1.5)
        assert (link_of(bus).notes, stats_of(bus).rejects) == ([], {})
        connector.notes.append("a stranger called")
        connector.rejects["foreign_peer"] = 2
        await anyio.sleep(1)
        assert (link_of(bus).notes, stats_of(bus).rejects) == (["a stranger called"], {"foreign_peer": 2})

    while_running(connector, look)


def test_what_the_transport_notes_is_shown_while_nobody_is_connected() -> None:
    connector = FakeConnector()
    connector.notes.append("a stranger called")

    async def look(bus: Bus, _: Inbox, __: LoopClock) -> None:
        await anyio.sleep(1.5)
        assert link_of(bus).state != "ONLINE"
        assert link_of(bus).notes == ["a stranger called"]
        assert stats_of(bus).frames == 0

    while_running(connector, look)


def test_notes_of_transport_and_decoder_stand_side_by_side_and_are_logged_once() -> None:
    class Noting(toy_text.Answers):
        notes = ("a word is missing",)

    robot = toy_text.settings()
    protocol = dataclasses.replace(robot.protocol, make_decoders=lambda *_: Noting)
    first, second = FakeConnection(), FakeConnection()
    connector = FakeConnector(first, second)
    connector.notes.append("a stranger called")

    async def look(bus: Bus, _: Inbox, __: LoopClock) -> None:
        with capture_logs() as logs:
            for connection in (first, second):
                await anyio.sleep(0.1)
                connection.push(b"pos=[1]\n")
                await anyio.sleep(0.1)
                assert link_of(bus).notes == ["a stranger called", "a word is missing"]
                connection.end()
        assert [log["reason"] for log in logs if log["event"] == "link.noted"] == link_of(bus).notes

    while_running(connector, look, dataclasses.replace(robot, protocol=protocol))


@pytest.mark.parametrize("after_s", [0.005, 0.5, 30.0])
def test_the_connector_is_closed_when_the_link_ends_whatever_it_was_doing(after_s: float) -> None:
    connection = FakeConnection(good)
    connector = FakeConnector(connection)

    async def look(_: Bus, __: Inbox, ___: LoopClock) -> None:
        await anyio.sleep(after_s)
        assert not connector.closed

    while_running(connector, look)
    assert connector.closed
    assert connection.closed == (after_s > 0.01)


def test_the_connector_is_closed_even_where_closing_takes_a_while() -> None:
    class Slow(FakeConnector):
        async def connect(self) -> Connection:
            await anyio.sleep_forever()
            raise AssertionError

        async def aclose(self) -> None:
            await anyio.sleep(1)
            await super().aclose()

    connector = Slow()

    async def look(_: Bus, __: Inbox, ___: LoopClock) -> None:
        await anyio.sleep(5)

    while_running(connector, look)
    assert connector.closed
