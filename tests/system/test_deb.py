"""The Debian package: installed, upgraded, removed and purged with dpkg, under a real systemd."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from gateway import __version__
from tests.system import kit
from tests.system.kit import CONFIG, UNIT, Machine, until

pytestmark = [
    pytest.mark.skipif(kit.missing() is not None, reason=str(kit.missing())),
    pytest.mark.limit(300),  # the first one makes the Debian and the package
]
OTHER_PORT = '[server]\nlisten = "127.0.0.1:9000"\n'


@pytest.fixture(scope="module")
def newer(package: Path) -> Path:
    return kit.repacked(package, "99.0")


@pytest.fixture
def installed(machine: Machine, package: Path) -> Iterator[Machine]:
    """A machine that had nothing of the package, and has it now."""
    dpkg(machine, "--install", str(package))
    yield machine
    machine.run("dpkg", "--purge", UNIT, code=None)


def dpkg(machine: Machine, *arguments: str) -> str:
    done = machine.run("dpkg", *arguments, within_s=60)
    return done.out + done.err


def test_once_installed_it_runs_now_and_at_every_boot(installed: Machine) -> None:
    assert installed.state() == "active"
    assert installed.run("systemctl", "is-enabled", UNIT).out == "enabled\n"
    assert installed.get("/healthz")[0] == 200
    assert installed.said("no robot is configured")
    assert installed.run("robot-gateway", "--version").out == f"robot-gateway {__version__}\n"
    assert installed.run("robot-gateway", "check").code == 0


def test_every_file_is_roots_and_as_it_was_packed(installed: Machine) -> None:
    assert dpkg(installed, "--verify", UNIT) == ""
    foreign = installed.run(
        "find", "/opt/robot-gateway", "!", "-user", "root", "-o", "-perm", "/022", "!", "-type", "l"
    )
    assert foreign.out == ""
    stray = installed.run("find", "/opt/robot-gateway", "-name", "direct_url.json")
    assert stray.out == ""


def test_the_manual_page_names_every_command(installed: Machine) -> None:
    listed = installed.run("robot-gateway", "--help").out.split("Commands:")[1]
    names = [line.split()[0] for line in listed.splitlines() if line.startswith("  ") and line[2] != " "]
    page = installed.run("zcat", "/usr/share/man/man1/robot-gateway.1.gz").out.replace("\\-", "-")
    assert names
    assert [name for name in names if f".B {name}\n" not in page] == []


def test_an_upgrade_keeps_the_changed_configuration_and_restarts_the_service(installed: Machine, newer: Path) -> None:
    installed.write(CONFIG, OTHER_PORT)
    before = installed.pid()
    dpkg(installed, "--install", str(newer))
    assert installed.path(CONFIG).read_text() == OTHER_PORT
    assert installed.state() == "active"
    assert installed.pid() != before
    assert installed.connects(9000)


def test_an_upgrade_of_a_service_that_was_disabled_does_not_start_it(installed: Machine, newer: Path) -> None:
    installed.run("systemctl", "disable", "--now", UNIT)
    dpkg(installed, "--install", str(newer))
    assert installed.state() == "inactive"
    assert installed.run("systemctl", "is-enabled", UNIT, code=None).out == "disabled\n"


def test_an_upgrade_over_a_broken_configuration_ends_well_and_says_where_to_look(
    installed: Machine, newer: Path
) -> None:
    installed.write(CONFIG, "[server]\nlisten = 5\n")
    said = dpkg(installed, "--install", str(newer))
    assert "journalctl --unit robot-gateway" in said
    assert installed.state() == "failed"
    installed.write(CONFIG, OTHER_PORT)
    installed.run("systemctl", "start", UNIT)


def test_removed_it_leaves_the_configuration_and_purged_nothing(installed: Machine) -> None:
    installed.write(CONFIG, OTHER_PORT)
    installed.write("/var/lib/robot-gateway/kept", "")
    dpkg(installed, "--remove", UNIT)
    until(lambda: not installed.connects(), 5, "the service has stopped")
    assert not installed.path("/opt/robot-gateway").exists()
    assert not installed.path("/usr/bin/robot-gateway").is_symlink()
    assert installed.path(CONFIG).read_text() == OTHER_PORT
    assert installed.path("/var/lib/robot-gateway/kept").exists()
    dpkg(installed, "--purge", UNIT)
    found = installed.run("find", "/etc", "/usr", "/var/lib", "-xdev", "-name", "*robot-gateway*").out.splitlines()
    assert [path for path in found if not path.startswith("/var/lib/dpkg/")] == []
    assert not installed.path("/opt/robot-gateway").exists()
    assert installed.run("systemctl", "--failed", "--quiet").out == ""
