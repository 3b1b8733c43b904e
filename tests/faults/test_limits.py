from __future__ import annotations

import random
from pathlib import Path

import pytest

from tests.faults.limits import DESCRIPTORS, DISK, why_no_disk
from tests.faults.report import Report


@pytest.mark.limit(60)
async def test_a_robot_reconnects_although_clients_have_used_up_the_file_descriptors(tmp_path: Path) -> None:
    report = Report()
    await DESCRIPTORS.run(tmp_path, random.Random(1), report)
    print("\n" + report.text())
    assert not report.broken


@pytest.mark.limit(60)
async def test_a_full_disk_costs_the_log_and_nothing_else(tmp_path: Path) -> None:
    if reason := why_no_disk():
        pytest.skip(reason)
    report = Report()
    await DISK.run(tmp_path, random.Random(1), report)
    print("\n" + report.text())
    assert not report.broken
