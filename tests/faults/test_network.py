from __future__ import annotations

import random
from pathlib import Path

import pytest

from tests.faults.network import NETWORK, why_not
from tests.faults.report import Report


@pytest.mark.limit(150)
async def test_a_bad_network_harms_only_the_robots_behind_it(tmp_path: Path) -> None:
    if reason := why_not():
        pytest.skip(reason)
    report = Report()
    await NETWORK.run(tmp_path, random.Random(1), report)
    print("\n" + report.text())
    assert not report.broken
