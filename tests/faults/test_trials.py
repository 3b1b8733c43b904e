from __future__ import annotations

import random
from pathlib import Path

import pytest

from tests.faults.report import Report
from tests.faults.trials import TRIALS, Trial


@pytest.mark.limit(60)
@pytest.mark.parametrize("trial", TRIALS, ids=lambda trial: trial.name.replace(" ", "_"))
async def test_the_gateway_comes_up_and_goes_down_as_it_should(trial: Trial, tmp_path: Path) -> None:
    report = Report()
    await trial.prove(tmp_path, random.Random(1), report)
    print("\n" + report.text())
    assert not report.broken
