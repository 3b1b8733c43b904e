from __future__ import annotations

import math
from datetime import UTC, tzinfo
from typing import cast

import anyio
import msgspec
from hypothesis import example, given
from hypothesis import strategies as st
from structlog.testing import capture_logs

from gateway.api.decoder import Entry, Frame
from gateway.api.model import Command, Event, EventKind, Joints, Motion, Quality, Sample, Status
from gateway.api.normaliser import Normaliser
from gateway.api.signals import Signal
from gateway.core.bus import Bus, Reading, Topic
from gateway.core.clock import Timeline
from gateway.core.controller_clock import ControllerClock
from gateway.core.events import EventRing
from gateway.core.publisher import Publisher
from tests.core import toy, toy_text
from tests.core.fakes import EPOCH_US, LoopClock, run_jumping


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


class PartsBench:
    """A publisher of a robot that is told in parts, and time that is set by hand."""

    def __init__(self, *listened: str, stale_s: float = 2.0, zone: tzinfo | None = None) -> None:
        self.clock = SetClock()
        self.bus = Bus(EventRing(boot="b"))
        clock = ControllerClock(toy_text.CLOCK, zone)
        normaliser = Normaliser(toy_text.SIGNALS, {})
        self.publisher = Publisher("r1", self.bus, normaliser, "live", clock, stale_s=stale_s, commands=True)
        self.inbox = Inbox()
        for topic in self.bus.match(listened or ("*",)):
            topic.listeners = [self.inbox]
        self.timeline = Timeline(self.clock)
        self.begin("e1")

    def begin(self, epoch: str) -> None:
        self.publisher.begin(epoch, self.timeline)

    def at(self, at_s: float) -> PartsBench:
        """Set the time, in s since the bench began."""
        self.clock.at_s = at_s
        return self

    def tell(self, at_s: float, **values: object) -> None:
        self.at(at_s).publisher.frame(toy_text.frame(**values), at_s)

    def expire(self, at_s: float) -> None:
        self.at(at_s).publisher.expire(at_s)

    def silent(self, at_s: float, quality: Quality = Quality.STALE) -> None:
        self.at(at_s).publisher.silent(quality, self.timeline.stamp(at_s), None)  # as a link does

    def latest(self, group: str) -> Sample:
        topic = self.bus.topics[f"r1/{group}"]
        assert topic.latest is not None
        return topic.latest.sample(topic)

    def of(self, group: str) -> list[Sample]:
        return [sample for sample in self.inbox.samples if sample.topic == f"r1/{group}"]

    def times(self, group: str) -> list[float]:
        return [(sample.t - EPOCH_US) / 1e6 for sample in self.of(group)]

    @property
    def kinds(self) -> list[str]:
        return [event.kind.value for event in self.inbox.events]


class SetClock:
    """A clock that stands until it is set; its wall clock can be set apart."""

    def __init__(self) -> None:
        self.at_s = 0.0
        self.set_by_us = 0

    def monotonic(self) -> float:
        return self.at_s

    def utc_us(self) -> int:
        return EPOCH_US + int(self.at_s * 1e6) + self.set_by_us


def joints(*, position: float | None = None, velocity: float | None = None) -> Joints:
    """Joints of one axis, in degrees."""
    return Joints(
        position=None if position is None else [position * math.pi / 180],
        velocity=None if velocity is None else [velocity * math.pi / 180],
    )


def test_a_group_told_in_parts_has_all_parts_and_the_time_of_the_oldest() -> None:
    bench = PartsBench("r1/joints")
    bench.tell(1.0, pos=[90.0])
    bench.tell(2.0, vel=[10.0])
    bench.tell(2.5, pos=[91.0])
    found = bench.of("joints")
    assert [sample.data for sample in found] == [
        joints(position=90.0),
        joints(position=90.0, velocity=10.0),
        joints(position=91.0, velocity=10.0),
    ]
    assert bench.times("joints") == [1.0, 1.0, 2.0]


def test_seq_counts_the_frames_that_carried_the_group() -> None:
    bench = PartsBench("r1/*")
    bench.tell(1.0, pos=[1.0])
    bench.tell(1.1, mode="MANUAL")
    bench.tell(1.2, vel=[1.0], stop=False)
    bench.tell(1.3, mode="MANUAL")
    assert [sample.seq for sample in bench.of("joints")] == [1, 2]
    assert bench.latest("status").seq == 3
    assert [sample.seq for sample in bench.of("safety")] == [1]
    assert [sample.seq for sample in bench.of("vendor")] == [1, 2, 3, 4]
    assert {sample.epoch for sample in bench.inbox.samples} == {"e1"}


def test_the_vendor_group_merges_everything() -> None:
    bench = PartsBench("r1/vendor")
    bench.tell(1.0, pos=[1.0])
    bench.tell(1.5, mode="MANUAL", sec=3)
    data = cast("dict[str, object]", bench.latest("vendor").data)
    assert {name: value for name, value in data.items() if value is not None} == {
        "pos": [1.0],
        "mode": "MANUAL",
        "sec": 3,
    }
    assert bench.times("vendor") == [1.0, 1.0]


def test_a_part_that_is_too_old_is_null_with_the_next_frame_of_whatever_group() -> None:
    bench = PartsBench("r1/joints", stale_s=2.0)
    bench.tell(1.0, pos=[1.0])
    bench.tell(2.0, vel=[2.0])
    bench.tell(3.5, mode="MANUAL")
    assert [sample.data for sample in bench.of("joints")][-1] == joints(velocity=2.0)
    assert bench.times("joints") == [1.0, 1.0, 2.0]
    bench.tell(4.5, mode="MANUAL")
    assert bench.latest("joints").data == Joints()
    assert bench.times("joints")[-1] == 4.5


def test_a_part_that_is_too_old_is_null_at_the_latest_when_the_second_is_over() -> None:
    bench = PartsBench("r1/*", stale_s=2.0)
    bench.tell(1.0, pos=[1.0], mode="MANUAL")
    bench.expire(2.0)
    bench.expire(3.0)
    assert len(bench.of("joints")) == 1
    bench.expire(3.1)
    bench.expire(4.1)
    assert [sample.data for sample in bench.of("joints")] == [joints(position=1.0), Joints()]
    assert [cast("Status", sample.data).operating_mode for sample in bench.of("status")] == ["MANUAL", None]
    assert set(cast("dict[str, object]", bench.latest("vendor").data).values()) == {None}
    assert bench.times("joints") == [1.0, 3.1]
    assert [sample.seq for sample in bench.of("joints")] == [1, 2]


def test_a_value_that_could_not_be_read_is_null_at_once_and_brings_no_old_one_back() -> None:
    bench = PartsBench("r1/joints")
    bench.tell(1.0, pos=[1.0])
    bench.tell(1.5, pos=None)
    bench.tell(1.6, vel=[2.0])
    assert [sample.data for sample in bench.of("joints")] == [joints(position=1.0), Joints(), joints(velocity=2.0)]
    assert bench.times("joints") == [1.0, 1.5, 1.6]


def test_a_state_topic_in_parts_speaks_only_of_changes_and_whoever_asks_gets_the_newest() -> None:
    bench = PartsBench("r1/status")
    for at in range(5):
        bench.tell(1.0 + at / 10, mode="MANUAL", pos=[float(at)])
    bench.tell(1.6, power="ENABLED")
    bench.tell(1.7, mode="MANUAL")
    assert len(bench.of("status")) == 2
    assert bench.latest("status").seq == 7
    assert bench.latest("status").t == EPOCH_US + 1_600_000


def test_silence_and_a_new_session_leave_no_value_of_the_old_one() -> None:
    bench = PartsBench("r1/*")
    bench.tell(1.0, pos=[1.0], mode="MANUAL", stop=True)
    bench.silent(1.5, Quality.DISCONNECTED)
    assert bench.latest("joints").data == Joints()
    assert bench.latest("status").data == Status()
    seqs = [sample.seq for sample in bench.of("joints")]
    bench.begin("e2")
    bench.expire(1.6)
    bench.tell(1.7, vel=[2.0])
    bench.tell(1.8, power="OFF")
    assert bench.latest("joints").data == joints(velocity=2.0)
    assert (bench.latest("joints").epoch, bench.latest("joints").seq) == ("e2", 1)
    assert cast("Status", bench.latest("status").data).operating_mode is None
    assert cast("dict[str, object]", bench.latest("vendor").data)["pos"] is None
    assert seqs == [1, 2]


def test_a_session_that_is_kept_through_a_silence_brings_no_value_back_either() -> None:
    bench = PartsBench("r1/joints")
    bench.tell(1.0, pos=[1.0])
    bench.silent(1.5)
    bench.expire(1.6)
    bench.tell(1.7, vel=[2.0])
    assert [sample.data for sample in bench.of("joints")] == [joints(position=1.0), Joints(), joints(velocity=2.0)]
    assert [(sample.epoch, sample.seq) for sample in bench.of("joints")] == [("e1", 1), ("e1", 2), ("e1", 3)]
    assert bench.times("joints") == [1.0, 1.5, 1.7]


def test_a_clock_that_is_set_back_leaves_what_is_known_and_none_of_it_for_longer_than_before() -> None:
    bench = PartsBench("r1/joints", stale_s=2.0)
    bench.tell(100.0, pos=[1.0])
    bench.clock.set_by_us = -50_000_000
    assert bench.at(100.5).timeline.follow() == -50_000_000
    bench.publisher.set_back("e2", 100.5)
    bench.tell(101.0, vel=[2.0])
    assert bench.latest("joints").data == joints(position=1.0, velocity=2.0)
    assert [(sample.epoch, sample.seq) for sample in bench.of("joints")] == [("e1", 1), ("e2", 1), ("e2", 2)]
    bench.expire(102.5)
    assert bench.latest("joints").data == joints(velocity=2.0)
    assert bench.times("joints") == [100.0, 50.0, 50.0, 51.0]


def test_the_controllers_time_is_that_of_the_oldest_part() -> None:
    bench = PartsBench("r1/joints", zone=UTC)
    bench.tell(1.0, pos=[1.0], sec=20)
    bench.tell(1.5, vel=[1.0], sec=21)
    bench.tell(1.6, vel=[1.0])
    seconds = [None if one.t_src is None else one.t_src // 1_000_000 % 60 for one in bench.of("joints")]
    assert seconds == [20, 20, 20]
    bench.tell(1.7, pos=[1.0], sec=22)
    assert bench.latest("joints").t_src is None  # the oldest is the velocity of 1.6, which came without a clock


def test_an_event_has_the_time_of_the_frame_that_showed_it_although_the_sample_is_older() -> None:
    bench = PartsBench("r1/status", "r1/events")
    bench.tell(1.0, mode="MANUAL", motion="STANDSTILL")
    bench.tell(2.0, motion="MOVING")
    assert bench.times("status") == [1.0, 1.0]
    (event,) = bench.inbox.events
    assert (event.kind, event.t) == ("motion.started", EPOCH_US + 2_000_000)
    assert event.raw == {"motion": "MOVING"}
    bench.tell(2.9, motion="MOVING")
    bench.expire(3.5)
    assert [(one.kind, one.after, one.t) for one in bench.inbox.events[1:]] == [
        ("mode.changed", None, EPOCH_US + 3_500_000)
    ]


def test_parts_that_have_not_come_yet_in_a_new_session_are_no_changes() -> None:
    bench = PartsBench("r1/events")
    everything = {"mode": "MANUAL", "power": "ENABLED", "stop": True, "hit": False, "motion": "MOVING"}
    for name, value in everything.items():
        bench.tell(1.0, **{name: value})
    assert bench.kinds == ["estop.pressed"]
    bench.inbox.events.clear()
    bench.silent(1.5)
    bench.begin("e2")
    for name, value in reversed(everything.items()):
        bench.tell(2.0, **{name: value})
    assert bench.kinds == []


def test_what_changed_between_two_sessions_is_told_once_its_part_comes() -> None:
    bench = PartsBench("r1/events")
    bench.tell(1.0, mode="MANUAL", power="ENABLED", stop=True, hit=False)
    bench.inbox.events.clear()
    bench.silent(1.5)
    bench.begin("e2")
    bench.tell(2.0, power="ENABLED")
    assert bench.kinds == []
    bench.tell(2.1, mode="AUTOMATIC")
    bench.tell(2.2, stop=False)
    assert bench.kinds == ["mode.changed", "estop.released"]
    bench.tell(2.3, hit=False)  # now both are known, and neither says a state
    assert bench.kinds == ["mode.changed", "estop.released", "safety.changed"]
    assert [(event.before, event.after) for event in bench.inbox.events][2] == ("EMERGENCY_STOP", None)


def test_a_part_that_the_new_session_says_it_cannot_tell_is_news() -> None:
    bench = PartsBench("r1/events")
    bench.tell(1.0, mode="MANUAL")
    bench.silent(1.5)
    bench.begin("e2")
    bench.tell(2.0, power="OFF")
    bench.tell(2.1, mode=None)
    assert bench.kinds == ["mode.changed"]


def test_a_pressed_stop_that_went_stale_is_told_again() -> None:
    bench = PartsBench("r1/events", stale_s=1.0)
    bench.tell(1.0, stop=True)
    bench.expire(2.5)
    bench.tell(3.0, stop=True)
    assert [kind for kind in bench.kinds if kind.startswith("estop")] == ["estop.pressed", "estop.pressed"]
    assert "estop.released" not in bench.kinds


def test_occurrences_go_to_a_topic_with_a_ring_of_its_own() -> None:
    bench = PartsBench("r1/events")
    commands = bench.bus.topics["r1/commands"]
    entry = Entry(EventKind.COMMAND_ISSUED, Command(id="a", type="MoveJ", index=0, total=1, object={}), {"raw": 1})
    bench.at(3.0).publisher.occurred((entry, entry), 3.0)
    assert commands.ring is not None
    assert commands.ring is not bench.bus.events
    events, _ = commands.ring.since(None, 10)
    assert [event.t for event in events] == [EPOCH_US + 3_000_000] * 2
    assert [(event.kind, event.before, event.after, event.raw) for event in events] == [
        ("command.issued", None, entry.data, {"raw": 1})
    ] * 2
    assert bench.inbox.events == []
    assert bench.bus.events.last_seq == 0
    assert commands.latest is None


def test_names_of_events_are_unique_across_the_rings_and_each_ring_counts_from_one() -> None:
    bus = Bus(EventRing())
    names: list[str] = []
    for robot in ("r1", "r2", "r3"):
        topics = bus.add(robot, ["events", "commands"])
        for topic in topics.values():
            assert topic.ring is not None
            for _ in range(3):
                bus.raise_event(topic, 1, EventKind.COMMAND_ISSUED, None, None, {})
                names.append(topic.ring.last_name)
    assert len(set(names)) == len(names) == 18
    assert sorted(name.rpartition(":")[2] for name in names)[:4] == ["1"] * 4


def test_a_robot_without_command_objects_has_no_such_topic_and_occurrences_are_nothing() -> None:
    def test() -> None:
        bench = Bench()
        assert "r1/commands" not in bench.bus.topics
        bench.publisher.occurred((Entry(EventKind.COMMAND_ISSUED, None),), 0.0)
        assert bench.bus.events.last_seq == 0

    in_loop(test)


def test_a_frame_that_tells_nothing_changes_no_group() -> None:
    bench = PartsBench("r1/joints", "r1/status")
    bench.tell(1.0, pos=[1.0])
    bench.tell(1.1)
    assert len(bench.inbox.samples) == 1


def test_expiring_before_a_session_or_a_frame_says_nothing() -> None:
    bench = PartsBench("*")
    bench.expire(5.0)
    bench.begin("e2")
    bench.expire(6.0)
    assert bench.inbox.samples == []


Told = dict[str, object]
TELLING: st.SearchStrategy[Told] = st.fixed_dictionaries(
    {},
    optional={
        "pos": st.none() | st.just([1.0]),
        "vel": st.none() | st.just([2.0]),
        "mode": st.sampled_from([None, "MANUAL", "AUTOMATIC"]),
        "motion": st.sampled_from([None, "MOVING", "STANDSTILL"]),
        "stop": st.none() | st.booleans(),
        "hit": st.none() | st.booleans(),
    },
)
STEPS = st.lists(
    st.tuples(
        st.integers(0, 1500),  # ms that pass
        st.one_of(TELLING, TELLING, st.sampled_from(["expire", "silent", "session", "slew", "jump", "back"])),
    ),
    max_size=60,
)


class Story:
    """A publisher to which things happen, and what must be true of it."""

    def __init__(self, stale_s: float) -> None:
        self.bench = PartsBench("r1/*", stale_s=stale_s)
        self.stale_s = stale_s
        self.told_s: dict[str, float] = {}
        self.epochs = 1
        self.set_back = False

    def tell(self, now_s: float, values: Told) -> None:
        """Some values come; what is told is what came, and is fresh."""
        self.bench.tell(now_s, **values)
        for name, value in values.items():
            self.told_s.pop(name, None)
            if value is not None:
                self.told_s[name] = now_s
        self.look(now_s)

    def happen(self, now_s: float, what: str) -> None:
        """Something else happens."""
        bench = self.bench.at(now_s)
        if what == "expire":
            bench.expire(now_s)
            self.look(now_s)
        elif what in {"slew", "jump", "back"}:
            bench.clock.set_by_us += {"slew": -300_000, "jump": 5_000_000, "back": -10_000_000}[what]
            if bench.timeline.follow() < 0:
                self.set_back = True
                self.epochs += 1
                bench.publisher.set_back(f"e{self.epochs}", now_s)
        else:
            self.told_s.clear()
            bench.silent(now_s)
            if what == "session":
                self.epochs += 1
                bench.begin(f"e{self.epochs}")

    def look(self, now_s: float) -> None:
        """Exactly the fresh values are shown."""
        fresh = {name for name, at_s in self.told_s.items() if now_s - at_s <= self.stale_s}
        for group, names in (("joints", {"pos", "vel"}), ("status", {"mode", "motion", "stop"})):
            if self.bench.bus.topics[f"r1/{group}"].latest is not None:
                data = cast("dict[str, object]", msgspec.to_builtins(self.bench.latest(group).data))
                assert {name for name in names if data[KEYS[name]] is not None} == fresh & names


@given(STEPS, st.sampled_from([0.5, 1.0, 2.0]))
@example([(0, {}), (0, "back"), (0, "slew"), (0, {})], 0.5)
@example([(0, "silent"), (0, "slew"), (0, {})], 0.5)
def test_whatever_happens_time_and_seq_never_go_back_inside_an_epoch_and_no_value_is_too_old(
    steps: list[tuple[int, Told | str]], stale_s: float
) -> None:
    story = Story(stale_s)
    now_ms = 0
    for after_ms, step in steps:
        now_ms += after_ms
        if isinstance(step, dict):
            story.tell(now_ms / 1000, step)
        else:
            story.happen(now_ms / 1000, step)
    inbox = story.bench.inbox
    for stream in {(sample.topic, sample.epoch) for sample in inbox.samples}:
        inside = [sample for sample in inbox.samples if (sample.topic, sample.epoch) == stream]
        assert [sample.t for sample in inside] == sorted(sample.t for sample in inside)
        seqs = [sample.seq for sample in inside]
        assert seqs == sorted(set(seqs))
        assert seqs[0] >= 1
    times = [event.t for event in inbox.events]
    assert story.set_back or times == sorted(times)


KEYS = {"pos": "position", "vel": "velocity", "mode": "operating_mode", "motion": "motion", "stop": "e_stopped"}
