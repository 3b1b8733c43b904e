from __future__ import annotations

import math
from typing import cast

import anyio
from structlog.testing import capture_logs

from gateway.api.decoder import Frame
from gateway.api.model import Event, Joints, Motion, Quality, Sample, Status
from gateway.api.normaliser import Normaliser
from gateway.api.signals import Signal
from gateway.core.bus import Bus, Reading, Topic
from gateway.core.clock import Timeline
from gateway.core.events import EventRing
from gateway.core.publisher import Publisher
from tests.core import toy
from tests.core.fakes import LoopClock, run_jumping


class Inbox:
    """A listener that keeps what it is told."""

    def __init__(self) -> None:
        self.samples: list[Sample] = []
        self.events: list[Event] = []

    def on_reading(self, topic: Topic, reading: Reading) -> None:
        self.samples.append(reading.sample(topic))

    def on_event(self, topic: Topic, event: Event) -> None:
        assert topic.name == f"{event.robot}/events"
        self.events.append(event)


class Bench:
    """A publisher on a bus, with a listener on some topics."""

    def __init__(self, *listened: str) -> None:
        self.bus = Bus(EventRing(boot="b"))
        self.publisher = Publisher("r1", self.bus, Normaliser(toy.SIGNALS, {}), "live")
        self.inbox = Inbox()
        for topic in self.bus.match(listened):
            topic.listeners = [self.inbox]
        self.publisher.begin("e1", Timeline(LoopClock()))

    def frame(self, **values: float) -> None:
        raw = toy.frame(**values)  # type: ignore[arg-type]
        self.publisher.frame(Frame(raw, toy.LAYOUT), anyio.current_time())

    def latest(self, name: str) -> Sample:
        topic = self.bus.topics[name]
        assert topic.latest is not None
        return topic.latest.sample(topic)


def in_loop(test: object) -> None:
    async def run() -> None:
        test()  # type: ignore[operator]

    run_jumping(run)


def test_every_frame_counts_whether_read_or_not() -> None:
    def test() -> None:
        bench = Bench()
        for _ in range(5):
            bench.frame()
        assert bench.latest("r1/joints").seq == 5
        assert bench.latest("r1/vendor").seq == 5

    in_loop(test)


def test_units_are_converted_and_the_vendor_group_keeps_the_manuals() -> None:
    def test() -> None:
        bench = Bench()
        bench.frame(angle=90.0)
        joints = cast("Joints", bench.latest("r1/joints").data)
        assert joints.position == [math.pi / 2, math.pi]
        assert cast("dict[str, object]", bench.latest("r1/vendor").data)["angle"] == [90.0, 180.0]

    in_loop(test)


def test_a_state_topic_speaks_only_when_its_canonical_values_change() -> None:
    def test() -> None:
        bench = Bench("r1/status")
        bench.frame(run_time=1.0)
        bench.frame(run_time=2.0)  # always changes
        bench.frame(word=7 << 8)  # noise in the upper bits
        bench.frame(word=1)  # moving
        bench.frame(word=3)  # another waypoint, still moving
        bench.frame(word=0)
        motions = [cast("Status", sample.data).motion for sample in bench.inbox.samples]
        assert motions == ["STANDSTILL", "MOVING", "STANDSTILL"]
        assert [sample.seq for sample in bench.inbox.samples] == [1, 4, 6]

    in_loop(test)


def test_a_new_session_says_every_state_again_in_its_own_epoch() -> None:
    def test() -> None:
        bench = Bench("r1/status")
        bench.frame()
        bench.publisher.begin("e2", Timeline(LoopClock()))
        bench.frame()
        assert [(sample.epoch, sample.seq) for sample in bench.inbox.samples] == [("e1", 1), ("e2", 1)]

    in_loop(test)


def test_edges_become_events_with_the_vendors_raw_values() -> None:
    def test() -> None:
        bench = Bench("r1/events")
        bench.frame()
        bench.frame(word=1)
        (event,) = bench.inbox.events
        assert (event.name, event.kind, event.before, event.after) == ("b:1", "motion.started", "STANDSTILL", "MOVING")
        assert event.raw == {"word.moving": 1, "word.waypoint": 0}

    in_loop(test)


def test_silence_nulls_every_leaf_once_and_says_when_the_last_frame_came() -> None:
    def test() -> None:
        bench = Bench("r1/*")
        bench.frame()
        bench.inbox.samples.clear()
        bench.publisher.silent(Quality.STALE, 20, 10)
        found = {sample.topic: sample for sample in bench.inbox.samples}
        assert set(found) == {"r1/joints", "r1/status", "r1/vendor"}
        joints = found["r1/joints"]
        assert (joints.q, joints.t, joints.t_last, joints.seq, joints.data) == ("STALE", 20, 10, 2, Joints())
        assert found["r1/vendor"].data == {"header": None, "angle": None, "word": None, "run_time": None}

    in_loop(test)


def test_values_that_are_not_finite_become_null_with_bad_quality_and_are_counted() -> None:
    def test() -> None:
        bench = Bench("r1/joints")
        bench.frame(angle=math.nan)
        (sample,) = bench.inbox.samples
        assert sample.q == "BAD"
        assert cast("Joints", sample.data).position == [None, None]
        assert bench.publisher.bad_values == 1

    in_loop(test)


def test_a_frame_longer_than_its_layout_is_uncertain() -> None:
    def test() -> None:
        bench = Bench("r1/joints")
        bench.publisher.frame(Frame(toy.frame(extra=8), toy.LAYOUT, quality=Quality.UNCERTAIN), 0.0)
        assert bench.inbox.samples[0].q == "UNCERTAIN"

    in_loop(test)


def test_a_plugins_mistake_costs_its_group_and_is_logged_once() -> None:
    def test() -> None:
        def broken(moving: int) -> Motion:
            raise ZeroDivisionError(moving)

        bench = Bench()
        signals = (toy.SIGNALS[0], Signal("status.motion", "word.moving", broken))
        bench.publisher = Publisher("r2", bench.bus, Normaliser(signals, {}), "live")
        bench.publisher.begin("e1", Timeline(LoopClock()))
        with capture_logs() as logs:
            bench.publisher.frame(Frame(toy.frame(word=0), toy.LAYOUT), 0.0)
            bench.publisher.frame(Frame(toy.frame(word=1), toy.LAYOUT), 0.0)
        status = bench.latest("r2/status")
        assert (status.q, status.data) == ("BAD", Status())
        assert bench.latest("r2/joints").q == "GOOD"
        assert [log["event"] for log in logs] == ["group.failed"]

    in_loop(test)
