from __future__ import annotations

import random
from pathlib import Path

import pytest

from tests.faults.cell import CELL
from tests.faults.report import Report


@pytest.mark.limit(120)
async def test_faults_of_controllers_and_clients_stay_theirs(tmp_path: Path) -> None:
    report = Report()
    await CELL.run(tmp_path, random.Random(1), report)
    print("\n" + report.text())
    assert not report.broken
