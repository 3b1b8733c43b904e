"""`robot-gateway vendors`: a table for people, JSON for programs, and every broken plugin with its reason."""

from __future__ import annotations

import json
import os
import pty
import re
import subprocess
import sys
from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

from gateway.cli.vendors import vendors

KILO = """
from gateway.api.vendor import Protocol, Vendor
from vendors.rainbow import VENDOR as _rainbow

_framing = _rainbow.protocols[0].framing
VENDOR = Vendor(name="kilo", title="Kilo [Arms]", protocols=(
    Protocol(name="cnde", title="Pushed", port=20005, framing=_framing, signals=()),
    Protocol(name="legacy", title="Old", port=8083, framing=_framing, signals=(), rate_hz=10.0),
))
"""
SCRIPT = "import typer; from gateway.cli.vendors import vendors; app = typer.Typer(); app.command()(vendors); app()"
ROOT = Path(__file__).parents[2]


@pytest.fixture
def app() -> typer.Typer:
    app = typer.Typer()
    app.command()(vendors)
    return app


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A good plugin `kilo` and a broken one `lima`."""
    folder = tmp_path / "dir"
    for name, text in (("kilo", KILO), ("lima", "x = 1\nx / 0")):
        (folder / name).mkdir(parents=True)
        (folder / name / "__init__.py").write_text(text)
        (folder / name / "__init__.py").chmod(0o644)
        (folder / name).chmod(0o755)
    folder.chmod(0o755)
    return folder


def test_the_table_has_one_line_for_each_protocol_the_default_first(app: typer.Typer, folder: Path) -> None:
    result = CliRunner().invoke(app, ["--vendor-dir", str(folder)])
    assert result.exit_code == 0
    rows = [re.split(r"\s{2,}", line.strip()) for line in result.stdout.splitlines()]
    assert rows[0] == ["VENDOR", "TITLE", "PROTOCOL", "PORT", "READ", "FOUND"]
    kilo = rows.index(["kilo", "Kilo [Arms]", "cnde", "20005", "pushed", str(folder)])
    assert rows[kilo + 1] == ["legacy", "8083", "polled 10 Hz"]
    assert ["rainbow", "Rainbow Robotics RB", "reqdata", "5001", "polled 50 Hz, at most 500", "built in"] in rows


def test_a_broken_vendor_is_listed_with_the_reason_on_one_line(app: typer.Typer, folder: Path) -> None:
    result = CliRunner().invoke(app, ["--vendor-dir", str(folder)])
    assert result.stdout.splitlines()[-1] == (
        "lima: broken: cannot be imported: ZeroDivisionError: division by zero "
        f"({folder}/lima/__init__.py:2) ({folder})"
    )


def test_json_has_every_fact(app: typer.Typer, folder: Path) -> None:
    result = CliRunner().invoke(app, ["--json", "--vendor-dir", str(folder)])
    assert result.exit_code == 0
    kilo, lima = (row for row in json.loads(result.stdout) if row["name"] in {"kilo", "lima"})
    assert kilo["title"] == "Kilo [Arms]"
    assert kilo["source"] == str(folder)
    assert kilo["folder"] == str(folder / "kilo")
    assert kilo["error"] is None
    assert [protocol["name"] for protocol in kilo["protocols"]] == ["cnde", "legacy"]
    assert kilo["protocols"][0]["reads"] == "pushed"
    assert kilo["protocols"][1]["rate_hz"] == 10.0
    assert lima["protocols"] == []
    assert "ZeroDivisionError" in lima["error"]


def test_a_folder_that_may_not_be_used_ends_with_78(app: typer.Typer, folder: Path) -> None:
    result = CliRunner().invoke(app, ["--vendor-dir", "/nowhere/at/all"])
    assert result.exit_code == 78
    assert result.stderr == "/nowhere/at/all: does not exist\n"
    folder.chmod(0o777)
    result = CliRunner().invoke(app, ["--vendor-dir", str(folder)])
    assert result.exit_code == 78
    assert "others may write to it" in result.stderr


@pytest.mark.parametrize("no_color", [False, True])
def test_on_a_terminal_of_80_columns_it_is_readable_and_red_only_where_colour_is_wanted(
    folder: Path, *, no_color: bool
) -> None:
    mine, theirs = pty.openpty()
    env = {"PATH": os.environ["PATH"], "TERM": "xterm", "COLUMNS": "80", "PYTHONPATH": str(ROOT)}
    env |= {"NO_COLOR": "1"} if no_color else {}
    arguments = [sys.executable, "-c", SCRIPT, "--vendor-dir", str(folder)]
    subprocess.run(arguments, env=env, stdin=theirs, stdout=theirs, stderr=theirs, check=True, timeout=15)  # noqa: S603
    os.close(theirs)
    text = os.read(mine, 65536).decode()
    os.close(mine)
    assert ("\x1b[31m" in text) is not no_color
    plain = re.sub(r"\x1b\[[0-9;]*m", "", text).replace("\r\n", "\n")
    table = [line for line in plain.split("lima: broken")[0].splitlines() if line]
    assert max(map(len, table)) <= 80
    assert "Rainbow Robotics RB" in plain
    assert "polled 50 Hz" in plain


def test_help_has_examples(app: typer.Typer) -> None:
    assert "robot-gateway vendors --json" in CliRunner().invoke(app, ["--help"]).stdout
