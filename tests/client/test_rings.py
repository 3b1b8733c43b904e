"""How far a client has read: nothing lost, nothing doubled, whatever is cut and however subscriptions overlap."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from gateway.api.model import Event, EventKind
from gateway.client.rings import Rings, boots_of


def event(seq: int, boot: str = "b") -> Event:
    return Event(name=f"{boot}:{seq}", seq=seq, robot="r1", t=seq, kind=EventKind.MOTION_STARTED)


def test_a_fresh_subscription_reads_on_after_the_newest_event() -> None:
    rings = Rings()
    rings.subscribed(["b:7", "c:0"], None)
    assert rings.names == ["b:7", "c:0"]
    assert [rings.take(event(seq)) for seq in (8, 8, 9)] == [True, False, True]
    assert rings.names == ["b:9", "c:0"]


def test_a_ring_that_nobody_named_is_read_from_its_beginning() -> None:
    rings = Rings()
    rings.subscribed(["b:7", "c:5"], ["b:3"])
    assert rings.names == ["b:3", "c:0"]


def test_a_cut_in_the_middle_of_what_is_read_back_forgets_nothing() -> None:
    rings = Rings()
    rings.subscribed(["b:5"], ["b:1"])
    assert [rings.take(event(seq)) for seq in (2, 4)] == [True, True]
    assert rings.names == ["b:1"]  # 3 may still come, of another subscription
    rings.subscribed(["b:6"], ["b:1"])
    assert [rings.take(event(seq)) for seq in (2, 3, 4, 5, 6, 7)] == [False, True, False, True, True, True]
    assert rings.names == ["b:7"]


def test_an_older_since_of_a_further_subscription_is_granted() -> None:
    rings = Rings()
    rings.subscribed(["b:5"], None)
    rings.subscribed(["b:5"], ["b:2"])
    assert [rings.take(event(seq)) for seq in (3, 4, 5, 3, 6)] == [True, True, True, False, True]


def test_the_rings_of_a_gateway_that_is_no_more_are_forgotten() -> None:
    rings = Rings()
    rings.subscribed(["b:5"], None)
    rings.subscribed(["n:9"], ["b:5"])
    assert rings.names == ["b:5", "n:0"]
    rings.keep(boots_of(["n:9"]))
    assert rings.names == ["n:0"]


@given(st.data())
def test_two_subscriptions_and_any_cuts_give_every_event_once(data: st.DataObject) -> None:
    """A model of the gateway: even events match one subscription, those of three the other; each reads on by itself."""
    rings, seen, newest = Rings(), [], 0
    rings.subscribed(["b:0"], None)
    for _ in range(data.draw(st.integers(1, 4))):
        away = data.draw(st.integers(0, 6))
        newest += away  # while nobody was connected
        since = next(int(name.partition(":")[2]) for name in rings.names)
        names = rings.names
        rings.subscribed([f"b:{newest}"], names)
        first = [seq for seq in range(since + 1, newest + 1) if seq % 2 == 0]
        more = data.draw(st.integers(0, 2))
        live = [seq for seq in range(newest + 1, newest + more + 1) if seq % 2 == 0]
        newest += more  # between the two subscriptions
        rings.subscribed([f"b:{newest}"], names)
        second = [seq for seq in range(since + 1, newest + 1) if seq % 2 == 0 or seq % 3 == 0]
        later = data.draw(st.integers(0, 3))
        after = [seq for seq in range(newest + 1, newest + later + 1) if seq % 2 == 0 or seq % 3 == 0]
        newest += later
        coming = [*first, *live, *second, *after]
        cut = data.draw(st.integers(0, len(coming)))
        seen += [seq for seq in coming[:cut] if rings.take(event(seq))]
    since = next(int(name.partition(":")[2]) for name in rings.names)
    rings.subscribed([f"b:{newest}"], rings.names)
    rest = [seq for seq in range(since + 1, newest + 1) if seq % 2 == 0 or seq % 3 == 0]
    seen += [seq for seq in rest if rings.take(event(seq))]
    assert sorted(seen) == [seq for seq in range(1, newest + 1) if seq % 2 == 0 or seq % 3 == 0]
