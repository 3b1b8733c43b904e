"""Every fault does to the bytes what it says, as often as it says, and no more."""

from __future__ import annotations

from collections import Counter
from random import Random

import pytest

from gateway.sim.chaos import CALM, Chaos, ChaosPlan, Delivery, explain, parse_chaos

FRAME = b"$HDR" + bytes(range(60))
FILLER = b"filler"


def chaos(text: str, *, fillers: tuple[bytes, ...] = (FILLER,), seed: int = 1) -> Chaos:
    return Chaos(parse_chaos(text), Random(seed), header=4, fillers=fillers, counts=Counter())  # noqa: S311 - faults


def joined(deliveries: list[Delivery]) -> bytes:
    return b"".join(delivery.data for delivery in deliveries)


def test_a_plan_is_read_from_its_text() -> None:
    assert parse_chaos("split=0.2, junk=0.05,stall=2/10,delay=0.1/1.5,cut=5") == ChaosPlan(
        split=0.2, junk=0.05, stall_s=2, stall_every_s=10, delay=0.1, delay_s=1.5, cut_every_s=5
    )


def test_no_text_is_no_chaos() -> None:
    assert parse_chaos("") == CALM
    assert CALM.is_calm


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("splt=1", "chaos 'splt' is unknown; known are split, coalesce"),
        ("split", "chaos split takes split=RATE, not ''"),
        ("split=x", "chaos split takes split=RATE, not 'x'"),
        ("split=2", "a rate from 0 to 1, not 2"),
        ("split=nan", "a rate from 0 to 1, not nan"),
        ("split=0.1/3", "chaos split takes split=RATE, not '0.1/3'"),
        ("delay=0.1", "chaos delay takes delay=RATE/SECONDS, not '0.1'"),
        ("delay=0.1/-1", "times in s that are not negative"),
        ("stall=10/2", "0 < SECONDS < EVERY, not '10/2'"),
        ("cut=0", "more than 0 s"),
        ("cut=inf", "times in s"),
        ("cut=1,cut=2", "chaos cut stands twice"),
    ],
)
def test_a_wrong_text_is_refused_with_what_is_allowed(text: str, message: str) -> None:
    with pytest.raises(ValueError, match=r"^chaos") as caught:
        parse_chaos(text)
    assert message in str(caught.value)


def test_every_fault_is_explained() -> None:
    assert [line.partition("=")[0] for line in explain().splitlines()] == [
        "split", "coalesce", "skip", "double", "junk", "header", "corrupt", "checksum", "tail", "delay", "stall", "cut",
    ]  # fmt: skip


def test_without_chaos_a_segment_is_one_send() -> None:
    assert chaos("").deliver([FRAME, FRAME]) == [Delivery(0.0, FRAME), Delivery(0.0, FRAME)]


def test_the_same_seed_gives_the_same_faults() -> None:
    text = "split=0.5,junk=0.5,header=0.5,coalesce=0.5"
    assert chaos(text, seed=7).deliver([FRAME] * 50) == chaos(text, seed=7).deliver([FRAME] * 50)
    assert chaos(text, seed=7).deliver([FRAME] * 50) != chaos(text, seed=8).deliver([FRAME] * 50)


def test_a_split_loses_no_byte_and_cuts_anywhere() -> None:
    faults = chaos("split=1")
    firsts = set()
    for _ in range(2000):
        deliveries = faults.deliver([FRAME])
        assert len(deliveries) > 1
        assert joined(deliveries) == FRAME
        firsts.add(len(deliveries[0].data))
    assert firsts >= set(range(1, len(FRAME) - 3))


def test_a_damaged_header_differs_in_one_of_its_bytes_only() -> None:
    faults = chaos("header=1")
    places = set()
    for _ in range(100):
        sent = joined(faults.deliver([FRAME]))
        wrong = [at for at, (a, b) in enumerate(zip(sent, FRAME, strict=True)) if a != b]
        assert len(wrong) == 1
        places.add(wrong[0])
    assert places == {0, 1, 2, 3}


def test_a_corrupt_frame_differs_in_one_byte_anywhere() -> None:
    faults = chaos("corrupt=1")
    sent = [joined(faults.deliver([FRAME])) for _ in range(2000)]
    wrong = [[at for at, (a, b) in enumerate(zip(frame, FRAME, strict=True)) if a != b] for frame in sent]
    assert {len(places) for places in wrong} == {1}
    assert {places[0] for places in wrong} == set(range(len(FRAME)))


def test_junk_comes_before_the_frame_in_a_send_of_its_own_or_in_the_same() -> None:
    faults = chaos("junk=1")
    sent = [faults.deliver([FRAME]) for _ in range(50)]
    assert {len(deliveries) for deliveries in sent} == {1, 2}
    assert all(joined(deliveries).endswith(FRAME) and len(joined(deliveries)) > len(FRAME) for deliveries in sent)


def test_coalescing_shares_a_send_with_a_frame_without_state() -> None:
    faults = chaos("coalesce=1")
    assert {joined(faults.deliver([FRAME])) for _ in range(20)} == {FILLER + FRAME, FRAME + FILLER}


def test_coalescing_without_such_frames_holds_a_frame_for_the_next_send() -> None:
    faults = chaos("coalesce=0.5", fillers=())
    deliveries = faults.deliver([FRAME] * 40)
    assert {len(delivery.data) // len(FRAME) for delivery in deliveries} >= {1, 2}
    assert joined(deliveries) + faults._held == FRAME * 40


def test_skipping_sends_a_frame_without_state_first() -> None:
    assert chaos("skip=1").deliver([FRAME]) == [Delivery(0.0, FILLER), Delivery(0.0, FRAME)]


def test_a_double_frame_is_one_send() -> None:
    assert chaos("double=1").deliver([FRAME]) == [Delivery(0.0, FRAME + FRAME)]


def test_a_delayed_frame_waits() -> None:
    assert chaos("delay=1/1.5").deliver([FRAME]) == [Delivery(1.5, FRAME)]


def test_a_stall_ends_each_period() -> None:
    plan = parse_chaos("stall=2/10")
    assert [plan.silent(at_s) for at_s in (0.0, 7.9, 8.1, 9.9, 10.1, 18.5)] == [False, False, True, True, False, True]


def test_what_happened_is_counted() -> None:
    counts: Counter[str] = Counter()
    faults = Chaos(parse_chaos("double=1"), Random(0), header=4, fillers=(), counts=counts)  # noqa: S311 - faults
    faults.deliver([FRAME] * 3)
    assert counts == {"double": 3}
