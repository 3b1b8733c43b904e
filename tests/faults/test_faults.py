"""The short form: every fault once. What mostly waits waits together, so that all of it takes less than 3 minutes."""

from __future__ import annotations

from pathlib import Path

import anyio
import pytest

from tests.faults import clocks, limits, many, names, network, trials
from tests.faults.cell import CELL
from tests.faults.kit import Turn, made, seeded
from tests.faults.plugins import PLUGINS
from tests.faults.report import Report


async def take(folder: Path, report: Report, *turns: Turn) -> None:
    """Let some series and trials happen, one after the other."""
    for number, turn in enumerate(turns):
        await turn.run(folder / f"{number}-{turn.name.replace(' ', '-')}", seeded(), report)


def judge(report: Report) -> None:
    """Print what was seen, and fail where a rule was broken."""
    print("\n" + report.text())
    assert not report.broken, "\n".join(report.broken)


@pytest.mark.limit(120)
async def test_faults_of_controllers_and_clients_stay_theirs(tmp_path: Path) -> None:
    report = Report()
    await take(tmp_path, report, CELL)
    judge(report)


@pytest.mark.limit(120)
async def test_a_bad_network_harms_only_the_robots_behind_it(tmp_path: Path) -> None:
    if reason := network.why_not():
        pytest.skip(reason)
    report = Report()
    await take(tmp_path, report, network.NETWORK)
    judge(report)


@pytest.mark.limit(120)
async def test_names_plugins_and_a_full_disk_harm_only_whom_they_must_and_a_clock_that_is_set_is_followed(
    tmp_path: Path,
) -> None:
    if reason := names.why_not() or clocks.why_not() or limits.why_no_disk():
        pytest.skip(reason)
    report = Report()
    async with anyio.create_task_group() as tasks:
        tasks.start_soon(take, made(tmp_path / "names"), report, names.NAMES)
        tasks.start_soon(take, made(tmp_path / "plugins"), report, PLUGINS)
        tasks.start_soon(take, made(tmp_path / "clock"), report, clocks.CLOCK, limits.DISK)
    judge(report)


@pytest.mark.limit(120)
async def test_the_gateway_comes_up_and_goes_down_as_it_should_and_meets_its_limits(tmp_path: Path) -> None:
    report = Report()
    async with anyio.create_task_group() as tasks:
        tasks.start_soon(take, made(tmp_path / "one"), report, limits.DESCRIPTORS, *trials.TRIALS[:2])
        tasks.start_soon(take, made(tmp_path / "other"), report, *trials.TRIALS[2:])
    judge(report)


@pytest.mark.limit(120)
async def test_sixty_four_robots_half_of_them_under_chaos(tmp_path: Path) -> None:
    report = Report()
    await take(tmp_path, report, many.series(many.SHORT_S))
    judge(report)
