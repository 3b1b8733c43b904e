"""The benchmarks run, in their smallest size; nothing is said of times here."""

from __future__ import annotations

import importlib.util
import math

import pytest

from tests.bench import schedule
from tests.bench.plan import TINY
from tests.bench.rows import BENCHMARKS
from tests.bench.table import Goal, line_of, markdown_of, put_in, row_of

EXTRA = {"delivery": "foxglove"}


@pytest.mark.limit(90)
@pytest.mark.parametrize("name", BENCHMARKS)
def test_a_benchmark_makes_rows_whose_figures_and_ratios_are_finite(name: str) -> None:
    if name in EXTRA and importlib.util.find_spec(EXTRA[name]) is None:
        pytest.skip("the extra `bench` is not installed")
    rows = list(BENCHMARKS[name].rows(TINY))
    assert len({(row.name, row.baseline) for row in rows}) == len(rows) > 0
    for row in rows:
        assert row.name
        assert math.isfinite(row.value)
        assert row.low <= row.value <= row.high
        assert (row.base is None) == (row.baseline == "")
        assert row.ratio is None or math.isfinite(row.ratio)
        assert (row.met is None) <= (row.goal == "" or row.ratio is None)
        assert row.name in line_of(row)
        assert " ".join(row.name.split()) in markdown_of([row])


def test_a_ratio_is_the_median_of_the_rounds_ratios_and_not_the_ratio_of_the_medians() -> None:
    row = row_of("a", "µs", [1.0, 10.0, 3.0], "b", [1.0, 2.0, 1.0], goal=Goal(3))
    assert (row.ratio, row.least, row.most, row.value, row.base, row.met) == (3.0, 1.0, 5.0, 3.0, 1.0, True)


def test_a_goal_judges_the_ratio_or_the_figure() -> None:
    assert row_of("a", "µs", [3.0], "b", [1.0], goal=Goal(2)).met is False
    assert row_of("a", "µs", [3.0], "b", [1.0], goal=Goal(3, "value")).met is True
    assert row_of("a", "µs", [3.0], goal=Goal(2, "value")).met is False


def test_every_robot_has_one_turn_in_a_period_whether_aligned_or_spread() -> None:
    for count in (1, 3, 16, 64):
        for phases in ("aligned", "spread"):
            robots = [robot for group in schedule.groups(count, 125.0, phases) for robot in group]
            assert sorted(robots) == list(range(count))
    assert len(schedule.groups(16, 125.0, "aligned")) == 1
    assert len(schedule.groups(16, 125.0, "spread")) == 16
    assert len(schedule.groups(64, 125.0, "spread")) == 16


def test_a_page_is_refreshed_between_its_marks_only() -> None:
    page = "one\n<!-- a -->\nold\n<!-- end of a -->\ntwo\n"
    once = put_in(page, "a", "new\n")
    assert once == "one\n<!-- a -->\n\nnew\n\n<!-- end of a -->\ntwo\n"
    assert put_in(once, "a", "new\n") == once
    assert put_in(page, "b", "new\n") == page
