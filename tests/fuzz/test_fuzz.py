"""The targets of `make fuzz`, run by hypothesis on seeds that it damages and joins."""

from __future__ import annotations

import random
import sys
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.fuzz import __main__, campaign
from tests.fuzz.target import Target
from tests.fuzz.targets import all_targets

TARGETS = all_targets()
_EXAMPLES = 300


def _damaged(data: bytes, chance: random.Random) -> bytes:
    """Some bytes changed, taken out, doubled or cut."""
    found = bytearray(data)
    for _ in range(chance.randint(0, 6)):
        at, size = chance.randrange(len(found) + 1), chance.choice((1, 1, 2, 8, 100))
        match chance.randrange(4):
            case 0:
                found[at : at + size] = chance.randbytes(size)
            case 1:
                del found[at : at + size]
            case 2:
                found[at:at] = found[at : at + size]
            case _:
                found[at : at + 1] = chance.choice((b"\x00", b"\xff", b"\n", b'"', b"{", b"-1", b"1e999", b"\xf0\x9f"))
    return bytes(found)


@st.composite
def inputs(draw: st.DrawFn, target: Target) -> bytes:
    """Any bytes, a seed, or seeds that were damaged and joined."""
    if draw(st.integers(0, 4)) == 0:
        return draw(st.binary(max_size=400))
    chance = random.Random(draw(st.integers(0, 2**32)))  # noqa: S311 - test data, no secrets
    seeds = [chance.choice(target.seeds) for _ in range(chance.randint(1, 2))]
    return b"".join(_damaged(seed, chance) for seed in seeds)


@pytest.mark.parametrize("target", TARGETS.values(), ids=TARGETS)
@pytest.mark.limit(60)
def test_whatever_bytes_come_the_target_holds(target: Target) -> None:
    @settings(max_examples=_EXAMPLES, suppress_health_check=list(HealthCheck))
    @given(data=inputs(target))
    def holds(data: bytes) -> None:
        target.run(data)

    holds()


@pytest.mark.parametrize("target", TARGETS.values(), ids=TARGETS)
def test_every_seed_and_nothing_at_all_are_taken(target: Target) -> None:
    assert target.seeds
    for data in (*target.seeds, b"", b"\x00", b"\x01\x00\x00"):
        target.run(data)


def test_a_crash_file_is_run_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "crash-1"
    file.write_bytes(b"x = 1")
    monkeypatch.setattr(sys, "argv", ["fuzz", "config", str(file)])
    assert __main__.main() == 0
    assert capsys.readouterr().out == "no crash\n"


def test_a_crash_is_shown_with_how_to_have_it_again(capsys: pytest.CaptureFixture[str]) -> None:
    crash = Path("build/fuzz/crashes/config/crash-1")
    campaign._tell(campaign.Outcome("config", 1, 1, 1, (crash,), "ValueError: no"))
    said = capsys.readouterr().err
    assert "ValueError: no" in said
    assert f"again: python -m tests.fuzz config {crash}" in said
