"""One row of the benchmarks, how it is made of its rounds, and the table that people read."""

from __future__ import annotations

import statistics
from collections.abc import Sequence
from typing import Literal

import msgspec


class Goal(msgspec.Struct, frozen=True):
    """What a figure should be.

    Args:
        at_most: The largest value that is good.
        of: What is judged: the median ratio to the baseline, or the median figure itself.
        words: The goal as it is shown; empty: the number.
    """

    at_most: float
    of: Literal["ratio", "value"] = "ratio"
    words: str = ""

    def __str__(self) -> str:
        sign = "×" if self.of == "ratio" else ""
        return self.words or f"≤ {self.at_most:g}{sign}"


class Row(msgspec.Struct, frozen=True, kw_only=True):
    """One figure and its ratio to a baseline that was measured in turns with it.

    Args:
        name: What was measured.
        unit: Of the figures.
        value: Median of the rounds.
        low: Smallest figure of a round.
        high: Largest figure of a round.
        rounds: How many there were.
        baseline: What it is compared with; empty: nothing.
        base: Median of the baseline's rounds.
        ratio: Median of the rounds' ratios.
        least: Smallest ratio of a round.
        most: Largest ratio of a round.
        goal: What was to be reached; empty: nothing was set.
        met: Whether it was.
        note: What a reader must know to judge the figure.
    """

    name: str
    unit: str
    value: float
    low: float
    high: float
    rounds: int
    baseline: str = ""
    base: float | None = None
    ratio: float | None = None
    least: float | None = None
    most: float | None = None
    goal: str = ""
    met: bool | None = None
    note: str = ""


def row_of(
    name: str,
    unit: str,
    values: Sequence[float],
    baseline: str = "",
    bases: Sequence[float] = (),
    *,
    goal: Goal | None = None,
    note: str = "",
) -> Row:
    """Make a row of the figures of some rounds.

    Args:
        name: What was measured.
        unit: Of the figures.
        values: One a round.
        baseline: What it is compared with.
        bases: The baseline's figure of each round; none where there is no baseline.
        goal: What was to be reached.
        note: What a reader must know.
    """
    ratios = [value / base for value, base in zip(values, bases, strict=True) if base] if bases else []
    value = statistics.median(values)
    ratio = statistics.median(ratios) if ratios else None
    judged = None if goal is None else ratio if goal.of == "ratio" else value
    return Row(
        name=name,
        unit=unit,
        value=value,
        low=min(values),
        high=max(values),
        rounds=len(values),
        baseline=baseline,
        base=statistics.median(bases) if bases else None,
        ratio=ratio,
        least=min(ratios, default=None),
        most=max(ratios, default=None),
        goal="" if goal is None else str(goal),
        met=None if goal is None or judged is None else judged <= goal.at_most,
        note=note,
    )


HEAD = f"{'':66} {'figure':>16} {'ratio':>7} {'least':>7} {'most':>7}  {'goal':24}"


def line_of(row: Row) -> str:
    """One line of the table, with the note below it."""
    ratios = " ".join(f"{'' if one is None else format(one, '.2f'):>7}" for one in (row.ratio, row.least, row.most))
    verdict = {True: " met", False: " MISSED", None: ""}[row.met]
    line = f"{row.name:66} {row.value:10.4g} {row.unit:5} {ratios}  {row.goal}{verdict}".rstrip()
    return f"{line}\n{'':4}{row.note}" if row.note else line


def block_of(rows: Sequence[Row]) -> str:
    """The lines of some rows, with a heading wherever the baseline changes."""
    lines, baseline = [], None
    for row in rows:
        if row.baseline != baseline:
            baseline = row.baseline
            lines.append(f"  beside {baseline}:" if baseline else "  by itself:")
        lines.append(line_of(row))
    return "\n".join(lines)


def markdown_of(rows: Sequence[Row]) -> str:
    """The same for a page: one table for each baseline."""
    lines: list[str] = []
    baseline = None
    for row in rows:
        if row.baseline != baseline:
            baseline = row.baseline
            lines += ["", f"Beside {baseline}:" if baseline else "By itself:", ""]
            lines += ["| | figure | ratio | least to most | goal |", "|---|---|---|---|---|"]
        ratio = "" if row.ratio is None else f"{row.ratio:.2f}"
        spread = "" if row.ratio is None else f"{row.least:.2f} to {row.most:.2f}"
        goal = f"{row.goal}: {'met' if row.met else '**missed**'}" if row.met is not None else row.goal
        name = " ".join(row.name.split()) + (f" ({row.note})" if row.note else "")
        lines.append(f"| {name} | {row.value:.4g} {row.unit} | {ratio} | {spread} | {goal} |")
    return "\n".join(lines[1:]) + "\n"


def put_in(page: str, name: str, text: str) -> str:
    """A page with what stands between the marks of a benchmark exchanged; as it was where it has none."""
    begin, end = f"<!-- {name} -->\n", f"<!-- end of {name} -->\n"
    before, found, rest = page.partition(begin)
    return f"{before}{begin}\n{text}\n{end}{rest.partition(end)[2]}" if found else page
