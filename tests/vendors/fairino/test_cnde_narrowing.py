from __future__ import annotations

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from vendors.fairino.cnde_narrowing import Narrowing
from vendors.fairino.cnde_states import ALL_STATES

ALL = tuple(ALL_STATES)
FOUR = ("robot_state", "main_code", "cur_lua_file_name", "sub_code")


def search(wanted: tuple[str, ...], bad: set[str]) -> tuple[Narrowing, int]:
    """Let a controller that refuses some names answer, and check what the controller holds in the end."""
    found = Narrowing(wanted)
    tries = 0
    held: tuple[str, ...] = ()
    while not found.done and not found.failed:
        asked = found.proposal
        tries += 1
        assert asked
        assert len(set(asked)) == len(asked)
        if bad.intersection(asked):
            found.refuse()
        else:
            held = asked
            found.accept()
    if found.done:
        assert held == found.proposal
        assert not bad.intersection(held)
    return found, tries


def test_what_is_granted_at_once_takes_one_configuration() -> None:
    found, tries = search(ALL, set())
    assert (found.proposal, tries) == (ALL, 1)


@pytest.mark.parametrize("name", ALL)
def test_any_one_refused_name_is_found_and_nothing_else_is_lost(name: str) -> None:
    found, tries = search(ALL, {name})
    assert tries <= Narrowing.MOST_TRIES
    assert found.refused == [name]
    assert found.proposal == tuple(one for one in ALL if one != name)
    assert found.untried == ()


@pytest.mark.parametrize(
    "names", [("alarm", "tool_id"), ("line_number", "payload"), ("timestamp_us", "emergency_stop")]
)
def test_with_two_refused_names_most_of_the_rest_is_kept(names: tuple[str, str]) -> None:
    found, tries = search(ALL, set(names))
    assert tries <= Narrowing.MOST_TRIES
    assert len(found.proposal) > len(ALL) // 2


def test_a_controller_that_knows_the_page_and_no_more_keeps_the_page() -> None:
    later = {name for name, state in ALL_STATES.items() if state.id is None or state.id > 131}
    found, _ = search(ALL, later)
    assert set(found.proposal) == set(ALL) - later
    assert {*found.refused, *found.untried} == later


@pytest.mark.parametrize("last_id", [20, 47, 53, 58, 66, 74, 76, 131, 132, 133])
def test_older_firmware_keeps_most_of_what_it_knows(last_id: int) -> None:
    later = {name for name, state in ALL_STATES.items() if state.id is None or state.id > last_id}
    pair = {"actual_joint_pos", "actual_TCP_pos"}
    found, _ = search(ALL, later)
    assert set(found.proposal) >= pair
    assert len(found.proposal) >= 0.85 * (len(ALL) - len(later))


@example(bad={*FOUR}, wanted=["program_state", *FOUR, "servoJ_cmd_num", "target_joint_pos", "target_joint_vel"])
@given(bad=st.sets(st.sampled_from(ALL)), wanted=st.lists(st.sampled_from(ALL), min_size=1, unique=True))
def test_a_search_ends_in_time_with_every_name_accounted_for(bad: set[str], wanted: list[str]) -> None:
    found, tries = search(tuple(wanted), bad)
    assert tries <= Narrowing.MOST_TRIES
    assert set(found.refused) <= bad
    if found.done:
        told = [*found.proposal, *found.refused, *found.untried]
        assert sorted(told) == sorted(wanted)
    else:
        assert not found.proposal


def test_names_of_unknown_types_are_left_out() -> None:
    found = Narrowing(("a", "b", "c"))
    found.drop(["b"])
    assert (found.proposal, found.done) == (("a", "c"), False)
    found.accept()
    assert (found.done, found.refused) == (True, ["b"])


def test_what_was_granted_and_is_refused_later_is_a_failure() -> None:
    found, _ = search(("a", "b"), set())
    found.refuse()
    assert found.failed
