"""The configuration of a gateway that runs is read once more."""

from __future__ import annotations

from pathlib import Path

import pytest

from gateway.config import load
from gateway.config.again import load_again
from gateway.errors import ConfigError

ENTRY = f'[[tokens]]\nname = "hmi"\nsha256 = "{"0" * 64}"\n'


def test_of_a_copied_secret_it_is_said_that_a_reload_reads_the_copy(tmp_path: Path) -> None:
    handed = tmp_path / "handed"
    handed.mkdir()
    (handed / "tokens.toml").write_text(ENTRY)
    file = tmp_path / "gateway.toml"
    file.write_text('[server]\ntokens = "locked/tokens.toml"\n')
    env = {"CREDENTIALS_DIRECTORY": str(handed)}
    running = load(file, env=env)
    (told,) = set(load_again(running, env).warnings) - set(running.warnings)
    assert f"{tmp_path}/locked/tokens.toml" in told
    assert "systemctl restart robot-gateway" in told


def test_of_a_secret_that_is_read_where_it_is_nothing_is_said(tmp_path: Path) -> None:
    (tmp_path / "tokens.toml").write_text(ENTRY)
    file = tmp_path / "gateway.toml"
    file.write_text('[server]\ntokens = "tokens.toml"\n')
    running = load(file)
    assert load_again(running, {"CREDENTIALS_DIRECTORY": str(tmp_path)}).warnings == running.warnings


@pytest.mark.parametrize("blank", ["", "\n \t\n"])
def test_a_file_that_is_being_written_takes_no_robot_away(tmp_path: Path, blank: str) -> None:
    file = tmp_path / "gateway.toml"
    file.write_text("[server]\n")
    running = load(file)
    file.write_text(blank)
    with pytest.raises(ConfigError, match="is empty: perhaps it was being written"):
        load_again(running)
