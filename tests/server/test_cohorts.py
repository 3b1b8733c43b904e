"""Many clients in the same cohorts, with a clock that stands until it is set."""

from __future__ import annotations

import math
from collections import Counter

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.api.messages import Data, EventMessage, Missed, Mode, Response
from gateway.api.model import Joints, Quality, Sample
from gateway.core.bus import Bus, ValueReading
from gateway.server import outbox as module
from gateway.server.cohort import Batch, Cohorts, Owner, Shared
from gateway.server.outbox import QUEUED_SAMPLES, Outbox, Subscription, Wish
from gateway.server.wire import JSON, Cut
from tests.server.kit import CountingReading, Now, cell, publish, publish_status, raise_event, reading

FLUSH_S = 0.002


class Door:
    """A door with many clients, of which each either reads or does not."""

    def __init__(self) -> None:
        self.bus, _ = cell("r1", "r2")
        self.now = Now()
        self.wakes: list[float] = []
        self.cohorts = Cohorts(FLUSH_S, self.now, self.wakes.append)

    def client(self, *topics: str, rate_hz: float | None = None, mode: Mode = "latest") -> Reader:
        """A new client with a subscription."""
        made = Reader(self)
        made.subscribe(*topics, rate_hz=rate_hz, mode=mode)
        return made

    def turn(self, after_s: float = 0.0) -> list[Owner]:
        """Let out what is due after some time."""
        self.now.at_s += after_s
        shared = Shared()
        owners = self.cohorts.distribute()
        for owner in owners:
            owner.flush(shared)
        return owners

    def publish(self, seq: int, topic: str = "r1/joints") -> CountingReading:
        """Publish one sample."""
        return publish(self.bus, topic, seq)


class Reader:
    """One client of the door."""

    def __init__(self, door: Door) -> None:
        self.outbox = Outbox(JSON, FLUSH_S, door.now, door.cohorts, self._on_turn)
        self.reads = True
        self.raw: list[bytes] = []
        self._door = door

    def subscribe(self, *topics: str, rate_hz: float | None = None, mode: Mode = "latest", name: int = 1) -> None:
        """Subscribe."""
        wish = Wish(period_s=None if rate_hz is None else 1 / rate_hz, every=mode == "all", cut=Cut(JSON, None))
        self.outbox.add(name, Subscription(wish, self._door.bus.match(topics), self.outbox))

    def read_again(self) -> None:
        """The client takes what is written to it."""
        self.reads = True
        self.outbox.wake_by(-math.inf)

    def received(self) -> list[Response]:
        """What has been written to it since the last time."""
        raw, self.raw = self.raw, []
        return [msgspec.json.decode(message, type=Response) for message in raw]

    def seqs(self, topic: str = "r1/joints") -> list[int]:
        """The samples of a topic among it."""
        return [one.seq for one in samples(self.received()) if one.topic == topic]

    def _on_turn(self, shared: Shared) -> None:
        if self.reads:
            self.raw += self.outbox.messages(shared)
        else:
            self.outbox.fall_behind()


def samples(messages: list[Response]) -> list[Sample]:
    return [one for message in messages if isinstance(message, Data) for one in message.samples]


def missed(messages: list[Response]) -> Counter[str]:
    told = Counter[str]()
    for message in messages:
        if isinstance(message, Missed):
            told.update(message.samples)
    return told


@pytest.mark.parametrize("mode", ["latest", "all"])
def test_equal_subscriptions_share_one_listener_and_one_message(mode: Mode) -> None:
    door = Door()
    clients = [door.client("*/joints", mode=mode) for _ in range(50)]
    assert len(door.bus.topics["r1/joints"].listeners) == 1
    made = [door.publish(1), door.publish(1, "r2/joints")]
    door.turn(FLUSH_S)
    assert {id(client.raw[0]) for client in clients} == {id(clients[0].raw[0])}
    assert all(len(client.raw) == 1 for client in clients)
    assert [one.asked for one in made] == [1, 1]


def test_different_wishes_are_different_cohorts_of_which_each_gets_its_own() -> None:
    door = Door()
    full, rated, other = door.client("*/joints", mode="all"), door.client("*/joints", rate_hz=10), door.client("r2/*")
    assert len(door.cohorts) == 3
    other.received()
    for seq in range(1, 126):
        door.publish(seq)
        door.turn(0.008)
    assert full.seqs() == list(range(1, 126))
    assert len(rated.seqs()) == 10
    assert other.seqs() == []


def test_several_cohorts_of_one_client_leave_in_one_message() -> None:
    door = Door()
    both, one = door.client("r1/joints"), door.client("r1/joints")
    both.subscribe("r2/joints", mode="all", name=2)
    both.subscribe("*/joints", rate_hz=1000, name=3)
    door.turn()
    door.publish(1)
    door.now.at_s += 0.001
    door.publish(1, "r2/joints")
    door.turn(0.001)
    (message,) = both.received()
    assert isinstance(message, Data)
    assert Counter(sample.topic for sample in message.samples) == {"r1/joints": 2, "r2/joints": 2}
    assert one.seqs() == [1]
    assert door.cohorts.due_s == math.inf


def test_the_same_subscription_twice_delivers_twice() -> None:
    door = Door()
    client = door.client("r1/joints")
    client.subscribe("r1/joints", name=2)
    door.publish(1)
    door.turn(FLUSH_S)
    assert client.seqs() == [1, 1]


@pytest.mark.parametrize("mode", ["latest", "all"])
def test_who_comes_later_gets_the_latest_value_once_and_the_others_lose_nothing(mode: Mode) -> None:
    door = Door()
    early = door.client("*/joints", mode=mode)
    door.publish(1)
    late = door.client("*/joints", mode=mode)
    door.turn()
    assert late.seqs() == [1]
    assert early.seqs() == [1]
    door.publish(2)
    door.turn(FLUSH_S)
    assert (early.seqs(), late.seqs()) == ([2], [2])


def test_who_comes_into_a_rate_between_two_slots_gets_no_value_twice() -> None:
    door = Door()
    early = door.client("*/joints", rate_hz=10)
    door.publish(1)
    door.publish(1, "r2/joints")
    late = door.client("*/joints", rate_hz=10)
    door.turn()
    assert (early.seqs(), late.seqs()) == ([], [1])
    door.publish(2, "r2/joints")
    door.turn(0.1)
    assert [(one.topic, one.seq) for one in samples(early.received())] == [("r1/joints", 1), ("r2/joints", 2)]
    assert [(one.topic, one.seq) for one in samples(late.received())] == [("r2/joints", 2)]
    door.publish(3)
    door.turn(0.1)
    assert (early.seqs(), late.seqs()) == ([3], [3])


def test_what_was_missed_before_a_client_came_is_not_told_to_it() -> None:
    door = Door()
    early = door.client("r1/joints")
    for seq in (1, 2, 3):
        door.publish(seq)
    late = door.client("r1/joints")
    door.publish(4)
    door.publish(5)
    door.turn(FLUSH_S)
    assert missed(early.received()) == {"r1/joints": 3}
    assert missed(late.received()) == {"r1/joints": 1}


def test_an_event_is_encoded_once_for_all_and_waits_for_nothing() -> None:
    door = Door()
    clients = [door.client("*/events") for _ in range(20)] + [door.client("*", rate_hz=0.1)]
    door.turn()
    clients[-1].received()
    raise_event(door.bus, "r1")
    door.turn()
    assert {id(client.raw[-1]) for client in clients} == {id(clients[0].raw[-1])}
    assert all(isinstance(message, EventMessage) for client in clients for message in client.received())


def test_a_state_brings_no_sample_before_its_time() -> None:
    door = Door()
    client = door.client("r1/*")
    door.turn()
    client.received()
    door.publish(1)
    publish_status(door.bus, "r1/status", 1, in_motion=True)
    door.turn()
    assert [one.topic for one in samples(client.received())] == ["r1/status"]
    door.turn(FLUSH_S)
    assert client.seqs() == [1]


def test_a_client_that_does_not_read_gets_the_newest_and_is_told_of_the_rest_and_the_others_get_all() -> None:
    door = Door()
    good, slow = door.client("r1/*"), door.client("r1/*")
    door.turn()
    for client in (good, slow):
        client.received()
    slow.reads = False
    for seq in range(1, 101):
        door.publish(seq)
        publish_status(door.bus, "r1/status", seq, in_motion=seq % 2 == 0)
        door.turn(FLUSH_S)
    assert len(slow.outbox.subscriptions[1].backlog) == 2
    slow.read_again()
    door.turn()
    assert good.seqs() == list(range(1, 101))
    told = slow.received()
    assert {(one.topic, one.seq) for one in samples(told)} == {("r1/joints", 100), ("r1/status", 100)}
    assert len(samples(told)) == 2
    assert missed(told) == {"r1/joints": 99}
    door.publish(101)
    door.turn(FLUSH_S)
    assert (good.seqs(), slow.seqs()) == ([101], [101])


def test_a_client_at_a_rate_that_does_not_read_misses_the_slots_that_passed() -> None:
    door = Door()
    slow = door.client("r1/joints", rate_hz=10)
    slow.reads = False
    for seq in range(1, 126):
        door.publish(seq)
        door.turn(0.008)
    slow.read_again()
    door.turn(0.2)
    told = slow.received()
    assert [one.seq for one in samples(told)] == [125]
    assert missed(told)["r1/joints"] in {9, 10}


def test_a_backlog_of_every_sample_is_bounded_and_leaves_in_order_and_in_pieces() -> None:
    door = Door()
    slow = door.client("r1/*", mode="all")
    door.turn()
    slow.received()
    slow.reads = False
    publish_status(door.bus, "r1/status", 1, in_motion=True)
    door.turn()
    for seq in range(1, QUEUED_SAMPLES + 51):
        door.publish(seq)
        if seq % 100 == 0:
            door.turn(FLUSH_S)
    door.turn(FLUSH_S)
    slow.read_again()
    door.turn()
    pieces = 0
    while slow.outbox.behind:
        assert door.cohorts.due_s == -math.inf
        door.publish(QUEUED_SAMPLES + 51 + pieces)
        door.turn(FLUSH_S)
        pieces += 1
    told = slow.received()
    assert max(len(message.samples) for message in told if isinstance(message, Data)) == module.SAMPLES_A_TURN
    got = samples(told)
    assert got[0].topic == "r1/status"  # the newest value of a state gives way to no sample
    assert [one.seq for one in got[1:]] == list(range(51, QUEUED_SAMPLES + 51 + pieces))
    assert missed(told) == {"r1/joints": 50}


def test_who_leaves_takes_nothing_along_and_the_last_one_leaves_nothing_behind() -> None:
    door = Door()
    one, two = door.client("*/joints", rate_hz=5), door.client("*/joints", rate_hz=5)
    door.publish(1)
    one.outbox.close()
    door.turn(0.2)
    assert (one.raw, two.seqs()) == ([], [1])
    door.publish(2)
    two.outbox.close()
    assert len(door.cohorts) == 0
    assert door.turn(1.0) == []
    assert door.cohorts.due_s == math.inf
    assert all(topic.listeners == [] for topic in door.bus.topics.values())


def test_what_is_owed_to_a_subscription_that_ends_is_not_sent() -> None:
    door = Door()
    door.publish(1)
    client = door.client("r1/joints")
    client.outbox.remove(1)
    door.turn()
    assert client.raw == []


def test_who_unsubscribes_is_told_what_it_missed_until_then() -> None:
    door = Door()
    client, other = door.client("r1/joints"), door.client("r1/joints")
    for seq in (1, 2, 3):
        door.publish(seq)
    client.outbox.remove(1)
    door.publish(4)
    door.turn(FLUSH_S)
    assert missed(client.received()) == {"r1/joints": 2}
    told = other.received()
    assert (missed(told), [one.seq for one in samples(told)]) == ({"r1/joints": 3}, [4])


def test_nobody_is_woken_where_nothing_is_due() -> None:
    door = Door()
    door.client("*/joints")
    door.turn()
    door.wakes.clear()
    door.turn(1.0)
    assert door.wakes == []
    door.publish(1)
    door.publish(2)
    assert door.wakes == [pytest.approx(door.now.at_s + FLUSH_S)]


def test_a_batch_that_fails_fails_for_its_receivers_when_they_are_written_to() -> None:
    bus: Bus = Door().bus
    topic = bus.topics["r1/joints"]
    data = msgspec.structs.replace(Joints(), position=[object()])
    wrong = ValueReading(Sample(topic=topic.name, seq=1, epoch="e.1", t=1, q=Quality.GOOD, data=data))
    batch = Batch(Cut(JSON, None), [(topic, wrong)])
    with pytest.raises(ValueError, match="cannot be encoded"):
        Shared().data((batch,))


def test_what_would_be_a_very_long_message_becomes_several_in_order() -> None:
    door = Door()
    client = door.client("r1/vendor", mode="all")
    for seq in range(1, 101):
        publish(door.bus, "r1/vendor", seq, {"filler": "x" * 20_000})
    publish(door.bus, "r1/vendor", 101, {"filler": "x" * 2_000_000})
    publish(door.bus, "r1/vendor", 102, {})
    door.turn(FLUSH_S)
    sizes = [len(message) for message in client.raw]
    assert sorted(sizes)[-2] < 600_000
    assert max(sizes) > 2_000_000
    assert len(sizes) == 6
    assert client.seqs("r1/vendor") == list(range(1, 103))


STEPS = st.lists(
    st.sampled_from(["publish", "publish", "publish", "turn", "turn", "clog", "read", "join", "leave", "again"]),
    max_size=120,
)


class Course:
    """A door on which anything may happen."""

    def __init__(self) -> None:
        self.door = Door()
        self.seq = 0
        self.clients: list[Reader] = []
        self.first: dict[Reader, int] = {}
        self.join(0)
        self.join(1)

    def publish(self, _: int) -> None:
        """A sample comes."""
        self.seq += 1
        self.door.publish(self.seq)

    def turn(self, _: int) -> None:
        """Time passes."""
        self.door.turn(0.0013)

    def clog(self, number: int) -> None:
        """A client reads no longer."""
        self._pick(number).reads = False

    def read(self, number: int) -> None:
        """A client reads again."""
        self._pick(number).read_again()

    def join(self, number: int) -> None:
        """A client comes."""
        client = self.door.client("r1/joints", mode="all" if number % 2 else "latest")
        self.first[client] = max(self.seq, 1)
        self.clients.append(client)

    def leave(self, number: int) -> None:
        """A client goes."""
        if len(self.clients) > 2:
            self.clients.pop(number % len(self.clients)).outbox.close()

    def again(self, number: int) -> None:
        """A client subscribes to something else besides."""
        self._pick(number).subscribe("r2/joints", name=2)

    def end(self) -> None:
        """Everybody reads, and all is quiet."""
        for client in self.clients:
            client.read_again()
        self.door.turn(2.0)
        self.door.turn(2.0)

    def _pick(self, number: int) -> Reader:
        return self.clients[number % len(self.clients)]


@given(STEPS)
def test_whatever_happens_every_client_gets_its_samples_in_order_and_once_and_knows_what_it_missed(
    steps: list[str],
) -> None:
    course = Course()
    for number, step in enumerate(steps):
        getattr(course, step)(number)
    course.end()
    for client in course.clients:
        told = client.received()
        seqs = [one.seq for one in samples(told) if one.topic == "r1/joints"]
        owed = range(course.first[client], course.seq + 1)
        if client.outbox.subscriptions[1].wish.every:
            assert seqs == list(owed)
        assert seqs == sorted(set(seqs))
        assert len(seqs) + missed(told)["r1/joints"] == len(owed)
        assert seqs[-1:] == list(owed)[-1:]


def test_readings_of_a_batch_are_what_the_cut_says() -> None:
    bus, _ = cell("r1")
    topic, made = bus.topics["r1/joints"], reading("r1/joints", 3)
    batch = Batch(Cut(JSON, (("position",),)), [(topic, made)])
    assert batch.parts is batch.parts
    assert b'"data":{"position":[3.0,null]}' in batch.parts[0]


def test_a_backlog_that_never_ends_holds_up_no_other_subscription() -> None:
    bus, _ = cell("r1", "r2")
    now = Now()
    one = Outbox(JSON, FLUSH_S, now)
    for name, topic, every in ((1, "r1/joints", True), (2, "r2/joints", False)):
        one.add(name, Subscription(Wish(period_s=None, every=every, cut=Cut(JSON, None)), bus.match([topic]), one))
    one.fall_behind()
    told: list[int] = []
    for turn in range(20):
        for seq in range(250):  # more than leaves in a turn
            publish(bus, "r1/joints", 250 * turn + seq)
        if turn == 10:
            publish(bus, "r2/joints", 7)
        now.at_s += 0.1
        told += [turn for message in one.collect() if b'"r2/joints"' in message]
    assert 10 in told
