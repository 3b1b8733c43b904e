"""Counting the frames that never came by the numbers of those that did."""

from __future__ import annotations

import random
from collections.abc import Iterable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.api.numbers import Numbers


def gaps(numbers: Iterable[int], modulus: int | None = 256) -> int | None:
    """The gaps that frames with these numbers have."""
    counted = Numbers(modulus)
    for number in numbers:
        counted.take(number)
    return counted.gaps


@pytest.mark.parametrize("numbers", [(), (5,), (0, 0, 0), (7, 7)])
def test_a_number_that_was_never_seen_to_move_tells_nothing(numbers: tuple[int, ...]) -> None:
    assert gaps(numbers) is None
    assert gaps(numbers, None) is None


@pytest.mark.parametrize(
    ("numbers", "missing"),
    [
        ((5, 6, 7), 0),
        ((5, 8, 9), 2),
        ((254, 255, 0, 1), 0),
        ((254, 1), 2),
        ((255, 0), 0),
        ((0, 128), 127),
        ((5, 5, 7, 7), 1),
    ],
)
def test_what_is_missing_is_counted_also_where_the_numbers_begin_again(numbers: tuple[int, ...], missing: int) -> None:
    assert gaps(numbers) == missing


@pytest.mark.parametrize("modulus", [256, None])
def test_a_frame_that_was_overtaken_is_not_missing(modulus: int | None) -> None:
    assert gaps((1, 3, 2, 4), modulus) == 0
    assert gaps((1, 5, 3, 2, 6), modulus) == 1


def test_a_frame_that_was_overtaken_over_the_end_of_the_numbers_is_not_missing() -> None:
    assert gaps((254, 0, 255, 1)) == 0


def test_a_late_frame_that_was_never_counted_makes_nothing_negative() -> None:
    assert gaps((5, 4, 3)) == 0
    assert gaps((0, 255, 1)) == 0


def test_numbers_without_an_end_only_grow() -> None:
    assert gaps((250, 260), None) == 9
    assert gaps((1, 1_000_000_000_000), None) == 999_999_999_998


@given(st.lists(st.booleans(), min_size=2, max_size=600), st.integers(0, 255), st.sampled_from([16, 256, None]))
def test_exactly_what_was_lost_between_two_frames_is_missing(came: list[bool], first: int, modulus: int | None) -> None:
    came[0] = came[-1] = True
    lost_in_a_row, longest = 0, 0
    for one in came:
        lost_in_a_row = 0 if one else lost_in_a_row + 1
        longest = max(longest, lost_in_a_row)
    if modulus is not None and longest + 1 > modulus // 2:
        return  # so long a hole cannot be told from one that was overtaken
    numbers = [first + at if modulus is None else (first + at) % modulus for at, one in enumerate(came) if one]
    assert gaps(numbers, modulus) == came.count(False)


@given(st.integers(0, 2**32), st.sampled_from([256, None]))
def test_neighbours_that_change_places_lose_nothing(seed: int, modulus: int | None) -> None:
    numbers = list(range(1, 200))
    rng = random.Random(seed)  # noqa: S311 - no secret
    for at in range(1, 197, 2):
        if rng.random() < 0.5:
            numbers[at], numbers[at + 1] = numbers[at + 1], numbers[at]
    assert gaps(numbers, modulus) == 0
