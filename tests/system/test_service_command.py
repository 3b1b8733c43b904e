"""`robot-gateway service`: what it shows, what it refuses, and what it does under a real systemd."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from gateway.cli import service
from gateway.cli.main import app
from gateway.service import steps
from gateway.service.files import hindrance
from tests.system import kit
from tests.system.kit import CONFIG, UNIT, Machine, until

booted = pytest.mark.skipif(kit.missing() is not None, reason=str(kit.missing()))
HOME = "/srv/cell/opt/robot-gateway"
UNIT_FILE = "/etc/systemd/system/robot-gateway.service"


def called(*arguments: str) -> Result:
    return CliRunner().invoke(app, ["service", *arguments])


def test_a_dry_run_of_install_shows_every_file_and_command_and_changes_nothing(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(steps, "CONFIG", tmp_path / "gateway.toml")
    done = called("install", "--dry-run")
    assert done.exit_code == 0
    told = [line for line in done.stdout.splitlines() if line.startswith(("# write", "# run"))]
    assert [line.split()[2].rsplit("/", 1)[-1] for line in told] == [
        "robot-gateway.conf", "systemd-sysusers", "robot-gateway.conf", "systemd-tmpfiles", "gateway.toml",
        "systemd-run", "robot-gateway.service", "systemctl", "systemctl", "systemctl",
    ]  # fmt: skip
    assert "ExecStart=" in done.stdout
    assert list(tmp_path.iterdir()) == []


def test_a_dry_run_of_uninstall_keeps_the_configuration_unless_it_is_purged() -> None:
    assert "# keep /etc/robot-gateway" in called("uninstall", "--dry-run").stdout
    assert "# remove /etc/robot-gateway\n" in called("uninstall", "--dry-run", "--purge").stdout


@pytest.mark.parametrize("what", ["install", "uninstall"])
def test_without_systemd_it_says_what_to_do_instead(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, what: str) -> None:
    monkeypatch.setattr(service, "_BOOTED", tmp_path / "none")
    done = called(what)
    assert done.exit_code == 1
    assert "systemd does not run here" in done.stderr
    assert "robot-gateway run" in done.stderr


@pytest.mark.parametrize("what", ["install", "uninstall"])
def test_who_is_not_root_is_told_so(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, what: str) -> None:
    monkeypatch.setattr(service, "_BOOTED", tmp_path)
    monkeypatch.setattr(os, "geteuid", lambda: 1000)
    done = called(what)
    assert done.exit_code == 1
    assert "only root may install services" in done.stderr


def test_a_configuration_that_is_not_there_is_wrong_usage(tmp_path: Path) -> None:
    done = called("install", "--dry-run", "--config", str(tmp_path / "none.toml"))
    assert done.exit_code == 2
    assert "none.toml" in done.stderr


def test_a_service_of_the_debian_package_is_left_to_it(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    unit = tmp_path / "robot-gateway.service"
    unit.touch()
    monkeypatch.setattr(service, "_BOOTED", tmp_path)
    monkeypatch.setattr(service, "PACKAGED", (unit,))
    monkeypatch.setattr(os, "geteuid", lambda: 0)
    assert "systemctl enable --now robot-gateway" in called("install").stderr
    assert "apt-get purge robot-gateway" in called("uninstall", "--purge").stderr


def test_what_the_user_of_the_service_could_not_reach_is_noticed(tmp_path: Path) -> None:
    tmp_path.chmod(0o700)
    (tmp_path / "python").touch(0o755)
    assert "may not be entered" in str(hindrance(tmp_path / "python"))
    assert "/root, which the service cannot see" in str(hindrance(Path("/root/venv/bin/python")))
    assert hindrance(Path("/usr/bin/env")) is None
    assert "No such file" in str(hindrance(Path("/usr/none")))


def test_a_masked_service_is_not_written_through_its_link(tmp_path: Path) -> None:
    (tmp_path / "unit").symlink_to("/dev/null")
    with pytest.raises(steps.StepError, match="symbolic link"):
        steps.Write(tmp_path / "unit", "text").perform()


@pytest.fixture(scope="module")
def unpacked(machine: Machine, package: Path) -> Machine:
    """A machine with the gateway's files in a folder of their own: a virtual environment that nobody has installed."""
    machine.run("dpkg-deb", "--extract", str(package), "/srv/cell")
    return machine


@pytest.fixture
def clean(unpacked: Machine) -> Iterator[Machine]:
    """The machine without the service, before and after."""
    yield unpacked
    do(unpacked, "uninstall", "--purge")


def do(machine: Machine, *arguments: str, code: int | None = 0, home: str = HOME) -> str:
    done = machine.run(f"{home}/bin/python", "-m", "gateway", "service", *arguments, code=code, within_s=60)
    return done.out + done.err


@booted
@pytest.mark.limit(300)
def test_installed_it_runs_now_and_at_every_boot_and_installed_again_it_keeps_the_configuration(clean: Machine) -> None:
    said = do(clean, "install")
    assert f"write: {UNIT_FILE}" in said
    assert clean.state() == "active"
    assert clean.run("systemctl", "is-enabled", UNIT).out == "enabled\n"
    assert clean.run("id", "--user", "--name", UNIT).out == "robot-gateway\n"
    assert clean.said("no robot is configured")
    assert f"{HOME}/bin/" in clean.path(UNIT_FILE).read_text()
    before = clean.pid()
    clean.write(CONFIG, '[server]\nlisten = "127.0.0.1:9000"\n')
    assert "keep: /etc/robot-gateway/gateway.toml" in do(clean, "install")
    assert clean.pid() != before
    assert clean.connects(9000)


@booted
@pytest.mark.limit(300)
def test_uninstalled_it_leaves_the_configuration_and_purged_nothing(clean: Machine) -> None:
    do(clean, "install")
    do(clean, "uninstall")
    until(lambda: not clean.connects(), 5, "the service has stopped")
    assert not clean.path(UNIT_FILE).exists()
    assert clean.path(CONFIG).exists()
    do(clean, "uninstall")  # twice is no error
    do(clean, "uninstall", "--purge")
    left = clean.run("find", "/etc", "/var/lib", "-xdev", "-name", "*robot-gateway*")
    assert left.out == ""
    assert clean.run("id", UNIT, code=None).code != 0


@booted
@pytest.mark.limit(300)
def test_a_given_configuration_is_installed_and_a_wrong_one_is_not_started(clean: Machine) -> None:
    clean.write("/srv/wrong.toml", "[server]\nlisten = 5\n")
    said = do(clean, "install", "--config", "/srv/wrong.toml", code=1)
    assert "listen" in said
    assert "Nothing was started" in said
    assert not clean.path(UNIT_FILE).exists()
    clean.path(CONFIG).unlink()
    clean.write("/srv/right.toml", '[server]\nlisten = "127.0.0.1:9001"\n')
    do(clean, "install", "--config", "/srv/right.toml")
    assert clean.connects(9001)


@booted
@pytest.mark.limit(300)
def test_an_installation_that_its_user_cannot_reach_is_refused_before_anything_is_changed(
    clean: Machine, package: Path
) -> None:
    clean.run("dpkg-deb", "--extract", str(package), "/root/cell")
    said = do(clean, "install", code=1, home="/root/cell/opt/robot-gateway")
    assert "below /root, which the service cannot see" in said
    assert not clean.path(CONFIG).exists()
    assert not clean.path("/etc/sysusers.d/robot-gateway.conf").exists()
