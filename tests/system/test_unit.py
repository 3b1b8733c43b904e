"""The unit file, as systemd's own tools read it; nothing is started."""

from __future__ import annotations

import shutil
import subprocess
import tomllib
from pathlib import Path

import pytest

from gateway.service.files import COMMAND, first_config, quoted, shipped, unit

pytestmark = pytest.mark.skipif(
    shutil.which("systemd-analyze") is None, reason="needs systemd-analyze: apt install systemd"
)


def analyze(tmp_path: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    file = tmp_path / "robot-gateway.service"
    file.write_text(unit(["/bin/true"]))  # what ExecStart names must exist
    return subprocess.run(  # noqa: S603
        ["systemd-analyze", *arguments, str(file)],  # noqa: S607
        check=False,
        capture_output=True,
        text=True,
        env={"PATH": "/usr/bin:/bin"},
    )


def test_systemd_knows_every_line_of_the_unit(tmp_path: Path) -> None:
    done = analyze(tmp_path, "verify", "--man=no", "--recursive-errors=no")
    assert (done.returncode, done.stderr) == (0, "")


def test_a_line_that_systemd_does_not_know_would_be_noticed(tmp_path: Path) -> None:
    (tmp_path / "broken.service").write_text(unit(["/bin/true"]).replace("UMask=", "Umasque="))
    done = analyze(tmp_path, "verify", "--man=no", "--recursive-errors=no", str(tmp_path / "broken.service"))
    assert done.returncode != 0


def test_the_exposure_is_at_most_2_0(tmp_path: Path) -> None:
    done = analyze(tmp_path, "security", "--offline=true", "--threshold=20", "--no-pager")
    assert done.returncode == 0, done.stdout


def test_the_unit_starts_the_installation_that_it_is_made_for() -> None:
    text = unit(["/srv/my robots/bin/python", "-m", "gateway"])
    assert 'ExecStart="/srv/my robots/bin/python" -m gateway run --config ' in text
    assert 'ExecReload="/srv/my robots/bin/python" -m gateway reload\n' in text
    assert COMMAND not in text


@pytest.mark.parametrize(
    ("word", "written"),
    [("/a/b", "/a/b"), ("/a b", '"/a b"'), ("/100%", "/100%%"), ("/$x", "/$$x"), ('/"', '"/\\""'), ("/\\", '"/\\\\"')],
)
def test_a_word_of_a_command_line_is_written_as_systemd_reads_it(word: str, written: str) -> None:
    assert quoted(word) == written


def test_a_fresh_service_calls_no_robot_and_its_configuration_shows_how_to_name_one() -> None:
    text = first_config()
    assert set(tomllib.loads(text)) == {"server"}
    lines = [
        line[1:] if line.startswith("#") and line[1:2] not in {" ", "", "-"} else line for line in text.splitlines()
    ]
    example = tomllib.loads(shipped("gateway.toml"))
    assert tomllib.loads("\n".join(lines))["robots"] == example["robots"]
