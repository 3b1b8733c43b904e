from __future__ import annotations

import random
from pathlib import Path

import pytest

from tests.faults.clocks import CLOCK, why_not
from tests.faults.report import Report


@pytest.mark.limit(60)
async def test_samples_follow_a_clock_that_is_set_and_nothing_else_changes(tmp_path: Path) -> None:
    if reason := why_not():
        pytest.skip(reason)
    report = Report()
    await CLOCK.run(tmp_path, random.Random(1), report)
    print("\n" + report.text())
    assert not report.broken
