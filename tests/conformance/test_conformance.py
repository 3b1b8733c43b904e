"""The conformance suite over every vendor and protocol that the registry finds."""

from __future__ import annotations

import pytest

from gateway.core.registry import Registry
from gateway.testing.conformance import CHECKS, Check, perform, subjects
from gateway.testing.subject import Subject

REGISTRY = Registry()
CASES = [
    pytest.param(
        subject,
        check,
        id=f"{subject.vendor.name}-{subject.protocol.name}-{check.name}",
        marks=pytest.mark.limit(check.limit_s),
    )
    for name in REGISTRY.names()
    for subject in subjects(REGISTRY, name)
    for check in CHECKS
]


@pytest.mark.parametrize(("subject", "check"), CASES)
async def test_the_vendor_passes(subject: Subject, check: Check) -> None:
    outcome = await perform(check, subject)
    if outcome.result in {"does not apply", "exempt"}:
        pytest.skip(f"{subject.protocol.name}, {check.name}: {outcome.message}")
    assert outcome.result == "passed", outcome.message
