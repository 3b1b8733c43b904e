"""The short form: every fault once. What mostly waits waits together, so that all of it takes little over a minute."""

from __future__ import annotations

from pathlib import Path

import anyio
import pytest

from tests.faults import clocks, limits, many, names, network, trials
from tests.faults.cell import CELL
from tests.faults.kit import Turn, made, seeded
from tests.faults.plugins import PLUGINS
from tests.faults.report import Report

pytestmark = pytest.mark.alone


async def take(folder: Path, report: Report, *turns: Turn) -> None:
    """Let some series and trials happen, one after the other."""
    for number, turn in enumerate(turns):
        await turn.run(folder / f"{number}-{turn.name.replace(' ', '-')}", seeded(), report)


def judge(report: Report) -> None:
    """Print what was seen, and fail where a rule was broken."""
    print("\n" + report.text())
    assert not report.broken, "\n".join(report.broken)


@pytest.mark.limit(120)
async def test_faults_of_controllers_clients_and_networks_stay_with_the_robots_behind_them(tmp_path: Path) -> None:
    report = Report()
    no_network = network.why_not()
    async with anyio.create_task_group() as tasks:
        tasks.start_soon(take, made(tmp_path / "cell"), report, CELL)
        if not no_network:
            tasks.start_soon(take, made(tmp_path / "network"), report, network.NETWORK)
    judge(report)
    if no_network:
        pytest.skip(f"without a bad network: {no_network}")


@pytest.mark.limit(120)
async def test_names_plugins_clocks_limits_and_ends_harm_only_whom_they_must(tmp_path: Path) -> None:
    report = Report()
    missing = names.why_not() or clocks.why_not() or limits.why_no_disk()
    async with anyio.create_task_group() as tasks:
        tasks.start_soon(take, made(tmp_path / "one"), report, limits.DESCRIPTORS, *trials.TRIALS[:2])
        tasks.start_soon(take, made(tmp_path / "other"), report, *trials.TRIALS[2:])
        if not missing:
            tasks.start_soon(take, made(tmp_path / "names"), report, names.NAMES)
            tasks.start_soon(take, made(tmp_path / "plugins"), report, PLUGINS)
            tasks.start_soon(take, made(tmp_path / "clock"), report, clocks.CLOCK, limits.DISK)
    judge(report)
    if missing:
        pytest.skip(f"without names, plugins, clocks and a full disk: {missing}")


@pytest.mark.limit(120)
async def test_sixty_four_robots_half_of_them_under_chaos(tmp_path: Path) -> None:
    report = Report()
    await take(tmp_path, report, many.series(many.SHORT_S))
    judge(report)
