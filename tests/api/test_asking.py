"""Who is asked next: shares of a budget, turn by turn."""

from __future__ import annotations

import itertools
from collections import Counter

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.api.asking import Rota, turns_hz


def asked(rota: Rota, turns: int) -> list[str | None]:
    return [rota.next() for _ in range(turns)]


def counts(rota: Rota, turns: int) -> Counter[str | None]:
    return Counter(asked(rota, turns))


def test_everybody_is_asked_at_the_wished_rate_and_the_rest_of_the_turns_asks_nothing() -> None:
    assert counts(Rota({"a": 5.0, "b": 2.0}, 10.0), 1000) == {
        "a": pytest.approx(500, abs=2),
        "b": pytest.approx(200, abs=2),
        None: pytest.approx(300, abs=4),
    }


def test_a_budget_that_is_wished_for_whole_is_used_whole() -> None:
    assert counts(Rota({"a": 6.0, "b": 3.0, "c": 1.0}, 10.0), 1000) == {"a": 600, "b": 300, "c": 100}


def test_wishes_beyond_the_budget_get_their_share_of_it() -> None:
    found = counts(Rota({"a": 60.0, "b": 30.0, "c": 10.0}, 10.0), 1000)
    assert found == {"a": 600, "b": 300, "c": 100}


def test_at_first_everybody_is_asked_soon_the_most_wished_first() -> None:
    found = asked(Rota({"rare": 0.1, "often": 5.0, "now_and_then": 1.0}, 10.0), 5)
    assert list(dict.fromkeys(found)) == ["often", "now_and_then", "rare"]


def test_the_most_overdue_comes_first() -> None:
    rota = Rota({"a": 1.0, "b": 1.0}, 2.0)
    found = asked(rota, 100)
    assert all(one != after for one, after in itertools.pairwise(found))


def test_turns_are_spread_and_not_given_in_bursts() -> None:
    found = asked(Rota({"a": 9.0, "b": 1.0}, 10.0), 1000)
    places = [at for at, name in enumerate(found) if name == "b"]
    gaps = [after - before for before, after in itertools.pairwise(places)]
    assert set(gaps) <= {9, 10, 11}


def test_where_nothing_is_wished_nothing_is_asked() -> None:
    assert asked(Rota({}, 10.0), 5) == [None] * 5
    zero = Rota({"a": 0.0, "b": 0.0}, 10.0)
    assert (zero.names, asked(zero, 5)) == ((), [None] * 5)


def test_a_wish_of_nothing_is_never_asked() -> None:
    rota = Rota({"a": 0.0, "b": 1.0}, 1.0)
    assert rota.names == ("b",)
    assert counts(rota, 10) == {"b": 10}


def test_nothing_is_due_before_its_time_comes() -> None:
    found = asked(Rota({"a": 1.0}, 10.0), 100)
    places = [at for at, name in enumerate(found) if name]
    assert places[0] == 0
    assert {after - before for before, after in itertools.pairwise(places[1:])} == {10}


def test_one_that_is_dropped_is_asked_no_more_and_the_others_go_on() -> None:
    rota = Rota({"a": 5.0, "b": 5.0}, 10.0)
    asked(rota, 3)
    rota.drop("a")
    rota.drop("unknown")
    assert rota.names == ("b",)
    assert counts(rota, 100) == {"b": pytest.approx(50, abs=2), None: pytest.approx(50, abs=2)}
    rota.drop("b")
    assert asked(rota, 3) == [None] * 3


def test_what_a_dropped_one_leaves_is_shared_where_the_budget_is_short() -> None:
    rota = Rota({"a": 20.0, "b": 15.0, "c": 5.0}, 10.0)
    asked(rota, 40)
    rota.drop("a")
    assert counts(rota, 400) == {"b": pytest.approx(300, abs=3), "c": pytest.approx(100, abs=3)}


wishes = st.dictionaries(st.sampled_from("abcdefgh"), st.floats(0.05, 50.0), min_size=1)


@given(wishes, st.floats(1.0, 100.0))
def test_whatever_is_wished_the_shares_are_kept_and_nobody_waits_for_ever(
    wanted: dict[str, float], budget_hz: float
) -> None:
    rota = Rota(wanted, budget_hz)
    turns = 2000
    found = asked(rota, turns)
    shared_hz = max(budget_hz, sum(wanted.values()))
    for name, wish in wanted.items():
        step = wish / shared_hz
        places = [-1, *(at for at, one in enumerate(found) if one == name), turns]
        n_asked = len(places) - 2
        assert n_asked == pytest.approx(turns * step, abs=len(wanted) + 1)
        longest = max(after - before for before, after in itertools.pairwise(places))
        assert longest <= 2 / step + len(wanted)


def test_two_of_a_kind_never_follow_each_other() -> None:
    kinds = {"a": "flag", "b": "flag", "c": "text", "d": "text"}
    found = asked(Rota({"a": 4.0, "b": 1.0, "c": 2.0, "d": 1.0}, 10.0, kinds), 1000)
    assert not [pair for pair in itertools.pairwise(found) if pair in {("a", "b"), ("b", "a"), ("c", "d"), ("d", "c")}]
    assert Counter(found) == {
        name: pytest.approx(100 * wish, abs=3) for name, wish in {"a": 4, "b": 1, "c": 2, "d": 1, None: 2}.items()
    }


def test_a_turn_stays_empty_between_two_of_a_kind_where_nothing_else_is_wished() -> None:
    found = asked(Rota({"a": 5.0, "b": 5.0}, 10.0, {"a": "flag", "b": "flag"}), 1000)
    assert all(one is None or after is None or one == after for one, after in itertools.pairwise(found))
    assert Counter(found) == {name: pytest.approx(n, abs=3) for name, n in {"a": 250, "b": 250, None: 500}.items()}
    assert turns_hz({"a": 5.0, "b": 5.0, "c": 1.0}, {"a": "flag", "b": "flag", "c": "text"}) == 20.0
    assert turns_hz({"a": 5.0, "b": 0.0, "c": 1.0}, {"a": "flag", "b": "flag", "c": "text"}) == 6.0


def test_only_some_may_be_asked_now_due_or_not() -> None:
    rota = Rota({"a": 1.0, "b": 0.1, "c": 0.2}, 10.0)
    assert [rota.next({"b", "c"}) for _ in range(3)] == ["c", "b", "c"]
    assert rota.next({"x"}) is None


@given(wishes, st.floats(1.0, 100.0), st.lists(st.sampled_from("xyz"), min_size=8, max_size=8))
def test_kinds_keep_the_shares_and_nobody_waits_for_ever(
    wanted: dict[str, float], budget_hz: float, told: list[str]
) -> None:
    kinds = dict(zip("abcdefgh", told, strict=True))
    turns = 2000
    found = asked(Rota(wanted, budget_hz, kinds), turns)
    shared_hz = max(budget_hz, turns_hz(wanted, kinds))
    for one, after in itertools.pairwise(found):
        assert one is None or after is None or one == after or kinds[one] != kinds[after]
    for name, wish in wanted.items():
        assert found.count(name) == pytest.approx(turns * wish / shared_hz, abs=2 * len(wanted) + 2)
