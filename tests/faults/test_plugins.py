from __future__ import annotations

import random
from pathlib import Path

import pytest

from tests.faults.plugins import PLUGINS
from tests.faults.report import Report


@pytest.mark.limit(90)
async def test_a_bad_plugin_harms_only_its_own_robots(tmp_path: Path) -> None:
    report = Report()
    await PLUGINS.run(tmp_path, random.Random(1), report)
    print("\n" + report.text())
    assert not report.broken
