"""Puts the agent, which is a distribution of its own, and the stand-in for the SDK on the path."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

AGENT = Path(__file__).parents[4] / "vendors" / "xcore" / "agent"
STANDIN = Path(__file__).parent / "standin"

for path in (AGENT, STANDIN):
    if str(path) not in sys.path:
        sys.path.insert(0, str(path))


@pytest.fixture
def sdk() -> Iterator[Any]:
    """The stand-in, well-behaved and with nothing noted."""
    module = importlib.import_module("xCoreSDK_python")
    module.BEHAVIOUR.clear()
    module.CALLS.clear()
    yield module
    module.BEHAVIOUR.clear()
