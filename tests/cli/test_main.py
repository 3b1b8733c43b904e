"""The command itself: its help, its exit codes, and how fast it starts."""

from __future__ import annotations

import subprocess
import sys

import pytest

from gateway import __version__
from gateway.cli.main import _COMMANDS
from gateway.core.registry import Registry
from tests.cli.command import ROOT, command_here, environment

SIMULATORS = [["simulate", name] for name in Registry().names()]


def test_the_version_is_told() -> None:
    done = command_here("--version")
    assert (done.code, done.out) == (0, f"robot-gateway {__version__}\n")


def test_help_lists_every_command_and_the_exit_codes() -> None:
    done = command_here("--help", env={"COLUMNS": "80"})
    assert done.code == 0
    assert all(f"  {name}" in done.out for name in _COMMANDS)
    assert "78 wrong configuration" in done.out


@pytest.mark.parametrize("name", [[], *([name] for name in _COMMANDS), *SIMULATORS], ids=" ".join)
def test_help_has_an_example_and_fits_80_columns(name: list[str]) -> None:
    done = command_here(*name, "--help", env={"COLUMNS": "80"})
    assert (done.code, done.err) == (0, "")
    assert "robot-gateway " in done.out
    assert "Example" in done.out
    assert [line for line in done.out.splitlines() if len(line) > 80] == []


@pytest.mark.parametrize(
    "arguments", [["zzz"], ["tail", "--zzz"], ["run", "--zzz"], ["status", "x"], ["tail", "-n", "0"]]
)
def test_wrong_usage_ends_with_2_and_no_traceback(arguments: list[str]) -> None:
    done = command_here(*arguments)
    assert done.code == 2
    assert "Traceback" not in done.err
    assert "Usage:" in done.err


def test_a_misspelt_command_is_told_the_nearest_one() -> None:
    done = command_here("statsu")
    assert (done.code, done.out) == (2, "")
    assert "no such command 'statsu'; did you mean 'status'?" in done.err
    assert "known are run, check, " in command_here("zzz").err


def test_no_command_at_all_shows_the_help() -> None:
    done = command_here()
    assert done.code == 2
    assert "Commands:" in done.out + done.err


@pytest.mark.parametrize("module", ["status", "tail"])
def test_what_people_call_often_imports_nothing_heavy(module: str) -> None:
    code = f"import sys, gateway.cli.main, gateway.cli.{module}; print(*sys.modules)"
    done = subprocess.run(  # noqa: S603
        [sys.executable, "-c", code],
        env=environment(),
        cwd=ROOT,
        check=True,
        capture_output=True,
        text=True,
        timeout=15,
    )
    loaded = set(done.stdout.split())
    heavy = {"numpy", "uvloop", "structlog", "gateway.core", "gateway.server", "gateway.sim", "gateway.config"}
    assert heavy & loaded == set()
