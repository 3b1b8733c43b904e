"""What is the same is counted, and what has changed is named by its path."""

from __future__ import annotations

import msgspec
import pytest

from gateway.api.model import GROUPS, Joints, Quality, Sample
from gateway.core.bus import Topic, ValueReading
from gateway.record.comparing import Comparison
from gateway.record.reading import Entry

JOINTS = Topic("r1", GROUPS["joints"])


def sample(seq: int, position: list[float] | None, t: int = 100, origin: str = "live") -> Sample:
    return Sample(
        topic="r1/joints",
        seq=seq,
        epoch="b.1",
        t=t,
        q=Quality.GOOD,
        origin=origin,  # type: ignore[arg-type] # one of the three
        data=Joints(position=position),  # type: ignore[arg-type] # of any length
    )


def entry(found: Sample) -> Entry:
    return Entry(found.t, found.topic, found.seq, msgspec.json.encode(found))


def compared(recorded: list[Sample], now: list[Sample], from_t: int = 0, to_t: int | None = None) -> Comparison:
    comparison = Comparison(["r1/joints"], from_t, to_t)
    for one in recorded:
        comparison.recorded(entry(one))
    for one in now:
        comparison.on_reading(JOINTS, ValueReading(one))
    return comparison


@pytest.mark.parametrize("origin", ["live", "sim"])
def test_a_sample_that_differs_in_its_origin_alone_is_the_same(origin: str) -> None:
    found = compared([sample(1, [0.5], origin=origin)], [sample(1, [0.5], origin="replay")]).finish()

    assert (found.same, found.counts) == ({"r1/joints": 1}, {})


def test_a_change_is_named_by_its_path_with_its_first_time_and_both_values() -> None:
    recorded = [sample(1, [0.5]), sample(2, [0.5], 200), sample(3, [0.5], 300)]
    found = compared(recorded, [sample(1, [0.5]), sample(2, [0.7], 200), sample(3, None, 300)]).finish()

    assert found.same == {"r1/joints": 1}
    assert found.changed == {"r1/joints": 2}
    assert found.counts == {("r1/joints", "data.position"): 2}
    first = found.first["r1/joints", "data.position"]
    assert (first.t, first.before, first.after) == (200, [0.5], [0.7])


def test_samples_that_only_one_side_has_are_missing_or_added() -> None:
    found = compared([sample(1, [0.5])], [sample(2, [0.5], 200)]).finish()

    assert found.counts == {("r1/joints", "missing"): 1, ("r1/joints", "added"): 1}
    assert found.first["r1/joints", "added"].t == 200


def test_only_a_part_is_compared() -> None:
    recorded = [sample(seq, [0.5], seq * 100) for seq in range(1, 6)]
    found = compared(recorded, [sample(seq, [0.6], seq * 100) for seq in range(1, 6)], 200, 300).finish()

    assert found.changed == {"r1/joints": 2}


def test_topics_that_were_not_recorded_are_not_compared() -> None:
    comparison = Comparison(["r1/tcp"], 0)
    comparison.on_reading(JOINTS, ValueReading(sample(1, [0.5])))
    comparison.recorded(entry(sample(1, [0.5])))

    assert comparison.finish().counts == {}
