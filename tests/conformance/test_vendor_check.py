"""`robot-gateway vendor-check`: results, remedies and exit codes, readable at 80 columns."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

from gateway.cli.vendor_check import vendor_check
from gateway.testing.conformance import CHECKS

KILO = Path(__file__).parent / "kilo"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    shutil.copytree(KILO, tmp_path / "kilo", ignore=shutil.ignore_patterns("__pycache__"))
    for path in (tmp_path, *tmp_path.rglob("*")):
        path.chmod(0o700)
    return tmp_path


def run(*arguments: str) -> tuple[int, str]:
    """The exit code, and what is printed on both streams."""
    app = typer.Typer()
    app.command()(vendor_check)
    result = CliRunner().invoke(app, arguments)
    return result.exit_code, result.output


def test_every_check_is_printed_with_its_result_and_all_is_well(folder: Path) -> None:
    code, text = run("kilo", "--vendor-dir", str(folder))
    assert code == 0
    assert all(check.name in text for check in CHECKS)
    assert "an invented robot has no virtual controller" in text
    n_exempt, n_not = text.count("  exempt\n"), text.count("  does not apply\n")
    assert n_not > 0
    assert "the controller pushes its frames and answers no requests" in text
    n_passed = len(CHECKS) - n_exempt - n_not
    assert text.endswith(f"{n_passed} passed, {n_not} did not apply, {n_exempt} exempt, 0 failed\n")
    assert max(map(len, text.splitlines())) <= 80


def test_a_failed_check_says_what_to_do_and_ends_with_1(folder: Path) -> None:
    (folder / "kilo" / "vectors.toml").unlink()
    code, text = run("kilo", "--vendor-dir", str(folder))
    assert code == 1
    assert "Add frames with the values they must give" in " ".join(text.split())
    assert max(map(len, text.splitlines())) <= 80 + len(str(folder))


def test_an_unknown_vendor_ends_with_2_and_names_the_nearest(folder: Path) -> None:
    code, text = run("kilos", "--vendor-dir", str(folder))
    assert code == 2
    assert "kilo" in text


def test_a_broken_vendor_ends_with_1_and_the_reason(folder: Path) -> None:
    (folder / "kilo" / "__init__.py").write_text("VENDOR = 1 / 0\n")
    code, text = run("kilo", "--vendor-dir", str(folder))
    assert code == 1
    assert "ZeroDivisionError" in text


def test_a_folder_that_is_not_there_ends_with_78() -> None:
    code, text = run("kilo", "--vendor-dir", "/does/not/exist")
    assert code == 78
    assert "/does/not/exist" in text
