"""`robot-gateway check`: what it prints, where, and how it ends."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

from gateway.cli.check import check

ROBOT = '[[robots]]\nname = "r1"\nvendor = "rainbow"\nhost = "10.0.2.7"\n'


@pytest.fixture
def app() -> typer.Typer:
    app = typer.Typer()
    app.command()(check)
    return app


def write(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "gateway.toml"
    path.write_text(text)
    return path


def test_a_good_file_comes_back_with_every_default_and_nothing_else_on_stdout(app: typer.Typer, tmp_path: Path) -> None:
    path = write(tmp_path, ROBOT)
    result = CliRunner().invoke(app, [str(path)])
    assert result.exit_code == 0
    printed = tomllib.loads(result.stdout)
    assert (
        printed["server"]
        | {
            "listen": "127.0.0.1:8765",
            "insecure": False,
            "flush_ms": 2.0,
            "event_ring": 10000,
            "command_ring": 20000,
        }
        == printed["server"]
    )
    assert printed["robots"][0]["rate_hz"] == 50.0
    assert result.stderr == f"valid: {path}, 1 robot\n"


def test_every_problem_is_one_line_on_stderr_and_the_exit_code_is_78(app: typer.Typer, tmp_path: Path) -> None:
    path = write(tmp_path, f"{ROBOT}prtt = 1\nhosst = 2\n")
    result = CliRunner().invoke(app, [str(path)])
    assert result.exit_code == 78
    assert result.stdout == ""
    assert result.stderr.splitlines() == [
        f'{path}:5: robots.prtt: unknown key; did you mean "port"?',
        f'{path}:6: robots.hosst: unknown key; did you mean "host"?',
    ]


def test_without_a_name_it_takes_the_file_that_run_would_take(
    app: typer.Typer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("ROBOT_GATEWAY_CONFIG", raising=False)
    write(tmp_path, ROBOT)
    assert CliRunner().invoke(app, []).exit_code == 0
    result = CliRunner().invoke(app, [], env={"ROBOT_GATEWAY_CONFIG": "/nowhere/x.toml"})
    assert result.exit_code == 78
    assert result.stderr.startswith("/nowhere/x.toml: does not exist; $ROBOT_GATEWAY_CONFIG names it")


def test_a_broken_vendor_is_a_warning(app: typer.Typer, tmp_path: Path) -> None:
    (tmp_path / "v" / "kilo").mkdir(parents=True)
    (tmp_path / "v" / "kilo" / "__init__.py").write_text("1 / 0")
    for part in (tmp_path / "v", tmp_path / "v" / "kilo", tmp_path / "v" / "kilo" / "__init__.py"):
        part.chmod(part.stat().st_mode & ~0o022)
    path = write(tmp_path, f'vendor_dirs = ["v"]\n{ROBOT}[[robots]]\nname = "k"\nvendor = "kilo"\nhost = "h"\n')
    result = CliRunner().invoke(app, [str(path)])
    assert result.exit_code == 0
    assert result.stderr.startswith(f"warning: {path}:8: robots.vendor: this robot is off, its vendor is broken: ")
    assert result.stderr.endswith(f"valid: {path}, 2 robots\n")
    assert "# off, the vendor is broken" in result.stdout


def test_no_robot_is_a_warning(app: typer.Typer, tmp_path: Path) -> None:
    path = write(tmp_path, "")
    result = CliRunner().invoke(app, [str(path)])
    assert result.exit_code == 0
    assert result.stderr.splitlines()[0] == (
        f"warning: {path}: no robot is configured: the gateway runs, but has nothing to tell"
    )


def test_the_schema_is_printed_as_json(app: typer.Typer, tmp_path: Path) -> None:
    for arguments in (["--schema"], [str(write(tmp_path, ROBOT)), "--schema"]):
        result = CliRunner().invoke(app, arguments)
        assert result.exit_code == 0
        assert json.loads(result.stdout)["$schema"].endswith("2020-12/schema")
    assert CliRunner().invoke(app, ["/nowhere/x.toml", "--schema"]).exit_code == 78


def test_a_wrong_option_is_a_usage_error(app: typer.Typer) -> None:
    assert CliRunner().invoke(app, ["--zzz"]).exit_code == 2


def test_help_has_examples(app: typer.Typer) -> None:
    assert "robot-gateway check --schema" in CliRunner().invoke(app, ["--help"]).stdout
