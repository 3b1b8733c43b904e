"""The state in parts: what is known, since when, and until when."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from gateway.core.parts import Parts
from tests.core.toy_text import frame

EMPTY = frame()


def values(parts: Parts, *names: str) -> dict[str, object]:
    return dict(parts.view(EMPTY, names or None).frame.values)


def test_a_part_stays_until_it_is_told_again() -> None:
    parts = Parts(10.0)
    parts.take(frame(pos=[1.0], mode="a"), 1, 1.0)
    parts.take(frame(mode="b"), 2, 2.0)
    assert values(parts) == {"pos": [1.0], "mode": "b"}
    assert values(parts, "mode", "vel") == {"mode": "b"}


def test_the_oldest_part_that_says_something_gives_the_time_and_its_frame() -> None:
    parts = Parts(10.0)
    first, second = frame(pos=[1.0]), frame(mode="a")
    parts.take(first, 1, 1.0)
    parts.take(second, 2, 2.0)
    oldest = parts.view(EMPTY, None).oldest
    assert oldest is not None
    assert (oldest.t, oldest.frame is first) == (1, True)
    only = parts.view(EMPTY, ("mode", "vel")).oldest
    assert only is not None
    assert only.t == 2
    assert parts.view(EMPTY, ("vel",)).oldest is None


def test_a_part_that_could_not_be_told_is_null_at_once_and_gives_no_time() -> None:
    parts = Parts(10.0)
    parts.take(frame(pos=[1.0]), 1, 1.0)
    parts.take(frame(pos=None), 2, 2.0)
    assert values(parts) == {"pos": None}
    assert parts.view(EMPTY, None).oldest is None


def test_a_part_is_told_up_to_its_age_and_not_longer() -> None:
    parts = Parts(1.0)
    parts.take(frame(pos=[1.0]), 1, 1.0)
    assert parts.drop_stale(2.0) == set()
    assert values(parts) == {"pos": [1.0]}
    assert parts.drop_stale(2.1) == {"pos"}
    assert values(parts) == {}
    assert parts.drop_stale(9.0) == set()


def test_a_null_that_is_too_old_is_no_news() -> None:
    parts = Parts(1.0)
    parts.take(frame(pos=None, mode="a"), 1, 1.0)
    assert parts.drop_stale(9.0) == {"mode"}


def test_a_view_is_a_picture_that_no_later_frame_changes() -> None:
    parts = Parts(1.0)
    parts.take(frame(pos=[1.0]), 1, 1.0)
    view = parts.view(EMPTY, None)
    parts.take(frame(pos=[2.0]), 2, 2.0)
    parts.clear()
    assert view.frame.values == {"pos": [1.0]}


def test_after_a_clear_nothing_is_known_and_nothing_has_come() -> None:
    parts = Parts(1.0)
    parts.take(frame(pos=[1.0]), 1, 1.0)
    assert parts.told == {"pos"}
    parts.clear()
    assert values(parts) == {}
    assert not parts.told


def test_what_came_has_come_even_as_null_or_long_ago() -> None:
    parts = Parts(1.0)
    parts.take(frame(pos=None), 1, 1.0)
    parts.take(frame(mode="a"), 1, 1.0)
    parts.drop_stale(100.0)
    assert parts.told == {"pos", "mode"}


def test_other_times_go_to_the_oldest_part_first() -> None:
    parts = Parts(10.0)
    parts.take(frame(pos=[1.0], mode="a"), 11, 1.0)
    parts.take(frame(mode="b"), 12, 2.0)
    stamped: list[float] = []

    def stamp(at_s: float) -> int:
        stamped.append(at_s)
        return int(at_s) + 100

    parts.restamp(stamp)
    assert stamped == [1.0, 2.0]
    oldest = parts.view(EMPTY, None).oldest
    assert oldest is not None
    assert (oldest.t, oldest.at_s) == (101, 1.0)
    assert values(parts) == {"pos": [1.0], "mode": "b"}


told = st.dictionaries(st.sampled_from("abcd"), st.none() | st.integers(), max_size=3)


@given(st.lists(st.tuples(st.integers(0, 700), told), max_size=40))
def test_whatever_is_told_no_value_is_older_than_allowed_and_none_is_another(
    steps: list[tuple[int, dict[str, object]]],
) -> None:
    parts = Parts(1.0)
    newest: dict[str, tuple[object, int]] = {}
    now_ms = 0
    for after_ms, values_told in steps:
        now_ms += after_ms
        parts.drop_stale(now_ms / 1000)
        parts.take(frame(**values_told), now_ms, now_ms / 1000)
        newest.update({name: (value, now_ms) for name, value in values_told.items()})
        fresh = {name: (value, at) for name, (value, at) in newest.items() if now_ms / 1000 - at / 1000 <= 1.0}
        view = parts.view(EMPTY, None)
        assert view.frame.values == {name: value for name, (value, _) in fresh.items()}
        times = [at for value, at in fresh.values() if value is not None]
        assert (view.oldest.t if view.oldest else None) == min(times, default=None)
