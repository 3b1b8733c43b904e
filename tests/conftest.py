"""What every test has: hypothesis profiles, and the `limit` marker that raises the time-out of one test."""

from __future__ import annotations

import os

import hypothesis
import pytest
import structlog

hypothesis.settings.register_profile("dev", deadline=None, max_examples=50)
hypothesis.settings.register_profile("ci", deadline=None, max_examples=300, derandomize=True, print_blob=True)
hypothesis.settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "ci" if os.environ.get("CI") else "dev"))


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Turn `limit(seconds)` into pytest-timeout's own marker."""
    for item in items:
        limit = item.get_closest_marker("limit")
        if limit is not None:
            (seconds,) = limit.args
            item.add_marker(pytest.mark.timeout(seconds))


@pytest.fixture(autouse=True)
def _fresh_log() -> None:
    """Undo what a test, or a command that it called, has set up for the log."""
    structlog.reset_defaults()
