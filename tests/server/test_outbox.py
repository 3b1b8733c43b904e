"""What one client is owed, with a clock that stands until it is set."""

from __future__ import annotations

import itertools
import math
from collections import Counter

import anyio
import anyio.lowlevel
import msgspec
import pytest

from gateway.api.messages import Data, EventMessage, Mode, Response
from gateway.api.messages import Missed as MissedMessage
from gateway.api.model import Event, Joints, Quality
from gateway.core.bus import Bus, ValueReading
from gateway.server import outbox as module
from gateway.server.inbox import Rated
from gateway.server.outbox import QUEUED_EVENTS, QUEUED_SAMPLES, Outbox, Subscription, Wish
from gateway.server.wire import JSON, Cut
from tests.server.kit import BOOT, Now, T, cell, publish, publish_status, raise_command, raise_event, reading

FLUSH_S = 0.002


class Box:
    """An outbox with subscriptions, and what it has given."""

    def __init__(self, bus: Bus, flush_s: float = FLUSH_S) -> None:
        self.bus = bus
        self.now = Now()
        self.outbox = Outbox(JSON, flush_s, self.now)

    def subscribe(self, *topics: str, rate_hz: float | None = None, mode: Mode = "latest", name: int = 1) -> None:
        """Subscribe."""
        wish = Wish(period_s=None if rate_hz is None else 1 / rate_hz, every=mode == "all", cut=Cut(JSON, None))
        self.outbox.add(name, Subscription(wish, self.bus.match(topics), self.outbox))

    def resume(self, since: str) -> None:
        """Read on after an event."""
        self.outbox.resume(*self.bus.events.since(since, 10**9))

    @property
    def due(self) -> bool:
        """Whether something is due now."""
        return self.outbox.due_s <= self.now.at_s

    def collect(self) -> list[Response]:
        """The messages that are due now."""
        messages = self.outbox.collect()
        while self.outbox.has_more:
            assert self.due
            messages += self.outbox.collect()
        return [msgspec.json.decode(message, type=Response) for message in messages]

    def raw_events(self) -> list[Event]:
        """The events that are due now, whole."""
        found = [message for message in self.collect() if isinstance(message, EventMessage)]
        return [event for message in found for event in message.events]

    def seqs(self, topic: str = "r1/joints") -> list[int]:
        """The samples of a topic that are due now."""
        messages = self.collect()
        assert sum(isinstance(message, Data) for message in messages) <= 1
        samples = [sample for message in messages if isinstance(message, Data) for sample in message.samples]
        return [sample.seq for sample in samples if sample.topic == topic]

    def events(self) -> list[int]:
        """The events that are due now."""
        return [event.seq for event in self.raw_events()]

    def missed(self) -> list[MissedMessage]:
        """What the client is told that it missed."""
        return [message for message in self.collect() if isinstance(message, MissedMessage)]


def box(*, flush_s: float = FLUSH_S) -> Box:
    bus, _ = cell("r1", "r2")
    return Box(bus, flush_s)


def test_a_new_subscriber_gets_the_latest_value_at_once() -> None:
    one = box()
    publish(one.bus, "r1/joints", 4)
    one.subscribe("*/joints")
    assert one.due
    assert one.seqs() == [4]
    assert not one.due


def test_samples_wait_for_the_flush_and_leave_in_one_message() -> None:
    one = box()
    one.subscribe("*/joints")
    publish(one.bus, "r1/joints", 1)
    one.now.at_s += 0.001
    publish(one.bus, "r2/joints", 1)
    assert one.outbox.due_s == pytest.approx(one.now.at_s + 0.001)
    one.now.at_s += 0.001
    (message,) = one.collect()
    assert isinstance(message, Data)
    assert [sample.topic for sample in message.samples] == ["r1/joints", "r2/joints"]


def test_without_a_flush_time_samples_are_due_at_once() -> None:
    one = box(flush_s=0.0)
    one.subscribe("*/joints")
    publish(one.bus, "r1/joints", 1)
    assert one.due


def test_samples_coalesce_to_the_newest_and_the_others_count_as_missed() -> None:
    one = box()
    one.subscribe("*/joints")
    for seq in range(1, 6):
        publish(one.bus, "r1/joints", seq)
    one.now.at_s += FLUSH_S
    data, missed = one.collect()
    assert isinstance(data, Data)
    assert [sample.seq for sample in data.samples] == [5]
    assert missed == MissedMessage(samples={"r1/joints": 4})


def test_a_client_is_told_what_it_missed_at_most_once_a_second_and_in_the_end_all_of_it() -> None:
    one = box()
    one.subscribe("r1/joints")
    told, n_messages, delivered = Counter[str](), 0, 0
    for seq in range(2000):
        one.now.at_s += 0.001
        publish(one.bus, "r1/joints", seq)
        if seq % 10 == 9:
            for message in one.collect():
                if isinstance(message, MissedMessage):
                    n_messages += 1
                    told.update(message.samples)
                else:
                    delivered += 1
    assert n_messages <= 3
    one.now.at_s = one.outbox.due_s
    for message in one.missed():
        told.update(message.samples)
    assert delivered + told["r1/joints"] == 2000


def test_mode_all_delivers_every_sample_in_order() -> None:
    one = box()
    one.subscribe("r1/*", mode="all")
    one.collect()
    for seq in range(1, 100):
        publish(one.bus, "r1/joints", seq)
    one.now.at_s += FLUSH_S
    assert one.seqs() == list(range(1, 100))
    assert one.missed() == []


def test_mode_all_is_bounded_and_says_what_it_lost() -> None:
    one = box()
    one.subscribe("r1/joints", mode="all")
    for seq in range(1, QUEUED_SAMPLES + 51):
        publish(one.bus, "r1/joints", seq)
    one.now.at_s += FLUSH_S
    *data, missed = one.collect()
    found = [sample.seq for message in data if isinstance(message, Data) for sample in message.samples]
    assert found == list(range(51, QUEUED_SAMPLES + 51))
    assert missed == MissedMessage(samples={"r1/joints": 50})


def test_mode_all_delivers_a_state_at_once_and_every_value_of_it() -> None:
    one = box(flush_s=1.0)
    one.subscribe("r1/status", mode="all")
    for seq in (1, 2, 3):
        publish_status(one.bus, "r1/status", seq, in_motion=seq % 2 == 0)
    assert one.due
    assert one.seqs("r1/status") == [1, 2, 3]


@pytest.mark.parametrize(("stream_hz", "rate_hz"), [(125, 10), (500, 30), (50, 50), (7, 3), (1000, 60), (49.7, 5)])
def test_a_rate_is_exact_over_a_minute_and_the_last_value_always_comes(stream_hz: float, rate_hz: float) -> None:
    one = box()
    one.subscribe("r1/joints", rate_hz=rate_hz)
    start_s, seq, taken = one.now.at_s, 0, []
    while seq < 60 * stream_hz:
        next_s = start_s + (seq + 1) / stream_hz
        if one.outbox.due_s <= next_s:  # the writer wakes up in between
            one.now.at_s = one.outbox.due_s
            taken += one.seqs()
        else:
            one.now.at_s = next_s
            seq += 1
            publish(one.bus, "r1/joints", seq)
    one.now.at_s = one.outbox.due_s
    taken += one.seqs()
    assert len(taken) == pytest.approx(60 * rate_hz, abs=1)
    assert taken[-1] == seq
    assert not one.outbox.missed


def test_ten_hertz_out_of_125_is_ten_in_every_second() -> None:
    one = box()
    one.subscribe("r1/joints", rate_hz=10)
    times = []
    for seq in range(1, 125 * 60 + 1):
        one.now.at_s = 1000 + seq * 0.008
        publish(one.bus, "r1/joints", seq)
        if one.due and one.seqs():
            times.append(one.now.at_s)
    gaps = [b - a for a, b in itertools.pairwise(times)]
    assert len(times) == 600
    assert max(gaps) < 0.1 + 0.0081  # the writer looks only every 8 ms here
    assert times[-1] - times[0] == pytest.approx(59.9, abs=0.009)


def test_a_slot_is_never_served_twice_however_the_times_are_rounded() -> None:
    missed = Counter[str]()
    bus, _ = cell("r1")
    topic = bus.topics["r1/joints"]
    for rate_hz in (3.0, 7.0, 9.99, 30.0, 1000.0):
        inbox, served = Rated(1 / rate_hz, 1000.1, missed), 0
        for slot in range(1, 2000):
            inbox.put(topic, reading("r1/joints", slot), 1000.1 + (slot - 0.5) / rate_hz)
            served += len(inbox.take(inbox.due_s))
            inbox.put(topic, reading("r1/joints", slot), 1000.1 + slot / rate_hz)  # the moment of the slot itself
            assert inbox.take(1000.1 + slot / rate_hz) == []
        assert served == 1999
    assert not missed


def test_a_state_does_not_bring_samples_before_their_slot() -> None:
    one = box()
    one.subscribe("r1/*", rate_hz=10)
    one.collect()
    one.now.at_s += 0.01
    publish(one.bus, "r1/joints", 1)
    publish_status(one.bus, "r1/status", 1, in_motion=True)
    assert one.due
    assert one.seqs() == []
    one.now.at_s = one.outbox.due_s
    assert one.seqs() == [1]


def test_states_are_due_at_once_whatever_the_rate_and_the_newest_wins_unsaid() -> None:
    one = box(flush_s=1.0)
    one.subscribe("r1/status", rate_hz=0.1)
    one.collect()
    publish_status(one.bus, "r1/status", 1, in_motion=True)
    publish_status(one.bus, "r1/status", 2, in_motion=False)
    assert one.due
    assert one.seqs("r1/status") == [2]
    assert not one.outbox.missed


def test_a_client_that_could_not_be_written_to_misses_whole_slots_only() -> None:
    one = box()
    one.subscribe("r1/joints", rate_hz=10)
    for seq in range(1, 101):  # ten seconds at 10 Hz, and nothing is taken
        one.now.at_s = 1000 + seq * 0.1 - 0.05
        publish(one.bus, "r1/joints", seq)
    one.now.at_s = 1010.0
    data, missed = one.collect()
    assert isinstance(data, Data)
    assert [sample.seq for sample in data.samples] == [100]
    assert missed == MissedMessage(samples={"r1/joints": 99})


def test_a_late_wake_up_misses_nothing() -> None:
    one = box()
    one.subscribe("r1/joints", rate_hz=1000)
    publish(one.bus, "r1/joints", 1)
    one.now.at_s += 0.5
    assert one.seqs() == [1]
    assert not one.outbox.missed


@pytest.mark.parametrize("rate_hz", [1e-310, 1e-9, 5e-324])
def test_a_very_low_rate_gives_the_first_value_and_waits(rate_hz: float) -> None:
    one = box()
    publish(one.bus, "r1/joints", 1)
    one.subscribe("r1/joints", rate_hz=rate_hz)
    assert one.seqs() == [1]
    publish(one.bus, "r1/joints", 2)
    assert not one.due
    one.now.at_s += 1e6
    assert one.seqs() == []


def lose(one: Box, seq: int, quality: Quality = Quality.STALE) -> None:
    """Say on a topic that no more values come."""
    sample = reading("r1/joints", seq).sample(one.bus.topics["r1/joints"])
    lost = ValueReading(msgspec.structs.replace(sample, q=quality, data=Joints()))
    one.bus.publish(one.bus.topics["r1/joints"], lost)


@pytest.mark.parametrize("quality", [Quality.STALE, Quality.DISCONNECTED])
def test_the_loss_of_a_link_waits_for_no_slot_and_takes_none(quality: Quality) -> None:
    one = box()
    one.subscribe("r1/joints", rate_hz=0.1)
    publish(one.bus, "r1/joints", 1)
    one.now.at_s += 1
    assert one.outbox.due_s > one.now.at_s
    lose(one, 2, quality)
    assert one.due
    assert one.seqs() == [2]
    publish(one.bus, "r1/joints", 3)
    one.now.at_s += 8.9
    assert one.outbox.due_s > one.now.at_s
    one.now.at_s += 0.2
    assert one.seqs() == [3]
    assert not one.outbox.missed


def test_a_loss_hurries_nothing_but_its_own_topic() -> None:
    one = box()
    one.subscribe("*/joints", rate_hz=0.1)
    publish(one.bus, "r2/joints", 1)
    lose(one, 2)
    assert (one.due, one.seqs("r2/joints")) == (True, [])
    one.now.at_s = one.outbox.due_s
    assert one.seqs("r2/joints") == [1]


@pytest.mark.parametrize("mode", ["latest", "all"])
def test_a_loss_waits_for_no_flush_either(mode: Mode) -> None:
    one = box(flush_s=1.0)
    one.subscribe("r1/joints", mode=mode)
    publish(one.bus, "r1/joints", 1)
    assert one.outbox.due_s > one.now.at_s
    lose(one, 2)
    assert one.due
    assert one.seqs() == ([1, 2] if mode == "all" else [2])


def test_events_do_not_wait() -> None:
    one = box(flush_s=1.0)
    one.subscribe("*/events", rate_hz=0.1)
    raise_event(one.bus, "r1")
    raise_event(one.bus, "r2")
    assert one.due
    assert one.events() == [1, 2]


def test_two_subscriptions_deliver_an_event_once() -> None:
    one = box()
    one.subscribe("*/events", name=1)
    one.subscribe("r1/events", name=2)
    raise_event(one.bus, "r1")
    assert one.events() == [1]
    raise_event(one.bus, "r2")
    assert one.events() == [2]


def test_events_are_resumed_and_the_live_ones_follow() -> None:
    one = box()
    for _ in range(5):
        raise_event(one.bus, "r1")
    one.subscribe("r1/events")
    raise_event(one.bus, "r1")
    one.resume(f"{BOOT}:2")
    raise_event(one.bus, "r1")
    assert one.events() == [3, 4, 5, 6, 7]


def test_resuming_a_second_robot_brings_its_old_events_although_newer_ones_of_another_were_delivered() -> None:
    one = box()
    raise_event(one.bus, "r2")
    one.subscribe("r1/events", name=1)
    raise_event(one.bus, "r1")
    assert one.events() == [2]
    one.subscribe("r2/events", name=2)
    one.outbox.resume(*one.bus.events.since(f"{BOOT}:0", 100, lambda event: event.robot == "r2"))
    assert one.events() == [1]
    raise_event(one.bus, "r2")
    assert one.events() == [3]


def test_what_the_ring_has_lost_is_said() -> None:
    bus, _ = cell("r1", ring=3)
    one = Box(bus)
    for _ in range(10):
        raise_event(bus, "r1")
    one.subscribe("r1/events")
    one.resume(f"{BOOT}:2")
    assert one.collect()[1:] == [MissedMessage(events=5)]


def test_a_name_from_another_boot_gives_the_whole_ring_and_an_unknown_number() -> None:
    one = box()
    raise_event(one.bus, "r1")
    one.subscribe("r1/events")
    one.resume("other:7")
    events, missed = one.collect()
    assert isinstance(events, EventMessage)
    assert missed == MissedMessage(events=None)


def test_resuming_more_than_the_queue_holds_gives_the_newest_and_says_how_many_are_left_out() -> None:
    bus, _ = cell("r1", ring=QUEUED_EVENTS + 100)
    one = Box(bus)
    for _ in range(QUEUED_EVENTS + 100):
        raise_event(bus, "r1")
    one.resume(f"{BOOT}:0")
    found = one.collect()
    events = [event.seq for message in found if isinstance(message, EventMessage) for event in message.events]
    assert events == list(range(101, QUEUED_EVENTS + 101))
    assert [message for message in found if isinstance(message, MissedMessage)] == [MissedMessage(events=100)]


def test_more_events_than_the_bound_overflow() -> None:
    one = box()
    one.subscribe("r1/events")
    for _ in range(QUEUED_EVENTS):
        raise_event(one.bus, "r1")
    flags = [one.outbox.overflowed]
    raise_event(one.bus, "r1")
    flags.append(one.outbox.overflowed)
    assert flags == [False, True]
    assert len(one.events()) == QUEUED_EVENTS


def test_the_same_name_again_replaces_and_a_closed_one_hears_nothing() -> None:
    one = box()
    one.subscribe("*/joints", name=1)
    one.subscribe("r2/joints", name=1)
    assert len(one.outbox.subscriptions) == 1
    assert one.bus.topics["r1/joints"].listeners == []
    assert one.outbox.remove(1)
    assert not one.outbox.remove(1)
    publish(one.bus, "r2/joints", 1)
    one.now.at_s += 1
    assert one.collect() == []


def test_closing_the_outbox_leaves_no_listener_behind() -> None:
    one = box()
    one.subscribe("*", name=1)
    one.subscribe("*/events", name=2)
    one.outbox.close()
    assert all(topic.listeners == [] for topic in one.bus.topics.values())


def test_an_idle_outbox_is_never_due() -> None:
    one = box()
    assert one.collect() == []
    assert one.outbox.due_s == math.inf


async def test_waiting_ends_when_something_becomes_due() -> None:
    outbox = Outbox(JSON, FLUSH_S, anyio.current_time)
    with anyio.fail_after(5):
        async with anyio.create_task_group() as tasks:
            tasks.start_soon(outbox.wait)
            await anyio.lowlevel.checkpoint()
            outbox.wake_by(anyio.current_time() + 0.003)
    assert outbox.due_s <= anyio.current_time()


def test_the_bounds_are_what_the_welcome_says() -> None:
    assert (module.QUEUED_SAMPLES, module.QUEUED_EVENTS, module.MISSED_PERIOD_S) == (10_000, 20_000, 1.0)


def two_rings() -> Box:
    """Two robots with command objects: three rings."""
    bus, _ = cell("r1", "r2", command_ring=30_000)
    return Box(bus)


def names(events: list[Event]) -> list[str]:
    return [event.name for event in events]


def test_two_subscriptions_over_two_rings_deliver_each_event_once() -> None:
    one = two_rings()
    one.subscribe("*/events", "*/commands", name=1)
    one.subscribe("r1/*", name=2)
    one.subscribe("r1/commands", name=3)
    told = []
    for number in range(5):
        raise_event(one.bus, "r1")
        told += [one.bus.events.last_name, raise_command(one.bus, "r1", number), raise_command(one.bus, "r2", number)]
    assert names(one.raw_events()) == told
    assert len(set(told)) == 15


def test_the_same_number_in_two_rings_is_not_the_same_event() -> None:
    one = two_rings()
    one.subscribe("*")
    one.collect()
    told = [raise_command(one.bus, "r1"), raise_command(one.bus, "r2")]
    raise_event(one.bus, "r1")
    told.append(one.bus.events.last_name)
    assert [name.rpartition(":")[2] for name in told] == ["1", "1", "1"]
    assert names(one.raw_events()) == told


def test_events_read_back_of_several_rings_and_live_ones_merge_with_each_ring_in_order() -> None:
    one = two_rings()
    old = [raise_command(one.bus, "r1", number, T + 10 * number) for number in range(4)]
    other = [raise_command(one.bus, "r2", number, T + 10 * number + 5) for number in range(4)]
    one.subscribe("*/commands")
    live = raise_command(one.bus, "r1", 4, T)  # a clock was set back: its ring's order counts
    rings = [one.bus.topics[f"{robot}/commands"].ring for robot in ("r1", "r2")]
    found = [event for ring in rings if ring is not None for event in ring.since(None, 100)[0]]
    one.outbox.resume(found, 0)
    assert one.outbox.has_more
    told = names(one.raw_events())
    assert [name for name in told if name in {*old, live}] == [*old, live]
    assert [name for name in told if name in other] == other
    assert told[:4] == [old[0], other[0], old[1], other[1]]
    after = raise_command(one.bus, "r1", 5, T)
    assert names(one.raw_events()) == [after]


def test_the_bound_holds_over_all_rings_together() -> None:
    one = two_rings()
    one.subscribe("*/commands", "*/events")
    for _ in range(QUEUED_EVENTS // 2):
        raise_command(one.bus, "r1")
        raise_event(one.bus, "r2")
    flags = [one.outbox.overflowed]
    last = raise_command(one.bus, "r2")
    flags.append(one.outbox.overflowed)
    assert flags == [False, True]
    told = names(one.raw_events())
    assert len(told) == QUEUED_EVENTS
    assert last not in told


def test_a_flood_of_command_objects_waits_whole_and_in_order_and_leaves_in_pieces() -> None:
    one = two_rings()
    one.subscribe("*/commands")
    told = [raise_command(one.bus, "r1", number) for number in range(5000)]
    pieces = 0
    found: list[str] = []
    while one.outbox.has_more:
        for message in one.outbox.collect():
            decoded = msgspec.json.decode(message, type=Response)
            assert isinstance(decoded, EventMessage)
            assert len(decoded.events) <= module.EVENTS_A_MESSAGE
            found += names(decoded.events)
            pieces += 1
    assert found == told
    assert pieces == 5000 // module.EVENTS_A_MESSAGE
    assert not one.due


def test_an_unknown_loss_is_not_made_known_by_a_later_one() -> None:
    one = two_rings()
    one.outbox.resume([], None)
    one.outbox.resume([], 5)
    assert one.missed() == [MissedMessage(events=None)]
    one.outbox.resume([], 5)
    assert one.missed() == [MissedMessage(events=5)]
    assert one.missed() == []
