"""The service under a real systemd: start, watchdog, reload, stop, and what it may not do."""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.system import kit
from tests.system.kit import CONFIG, UNIT, Machine, until

pytestmark = [
    pytest.mark.skipif(kit.missing() is not None, reason=str(kit.missing())),
    pytest.mark.limit(300),  # the first one makes the Debian and the package
]
DROP_IN = f"/run/systemd/system/{UNIT}.service.d/test.conf"
VENDORS = "/etc/robot-gateway/vendors"
STATE = "/var/lib/robot-gateway"
ONE_ROBOT = """
[[robots]]
name = "r1"
vendor = "rainbow"
host = "127.0.0.2"
"""
CONFIG_TEXT = f"""
vendor_dirs = ["{VENDORS}"]
{ONE_ROBOT}
[[robots]]
name = "r2"
vendor = "hanging"
host = "127.0.0.3"
"""
THIRD_ROBOT = """
[[robots]]
name = "r3"
vendor = "rainbow"
host = "127.0.0.4"
"""
TOKEN = "rgw_" + "t" * 43
# A plugin that hangs the loop, or takes long to import, once each time that it is told to.
PLUGIN = f"""
import dataclasses, functools, pathlib, time
from vendors.rainbow import VENDOR as RAINBOW

def told(what):
    try:
        (pathlib.Path("{STATE}") / what).unlink()
    except OSError:
        return False
    return True

class Hanging:
    def __init__(self, decoder):
        self._decoder = decoder
    def __getattr__(self, name):
        return getattr(self._decoder, name)
    def feed(self, data):
        if told("hang"):
            time.sleep(600)
        return self._decoder.feed(data)

def make_decoders(options, rate_hz):
    return lambda: Hanging(RAINBOW.protocol().decoder(options))

if told("slow"):
    time.sleep(2)
PROTOCOL = dataclasses.replace(RAINBOW.protocol(), make_decoders=make_decoders)
VENDOR = dataclasses.replace(RAINBOW, name="hanging", protocols=(PROTOCOL,))
"""


@pytest.fixture(scope="module")
def installed(machine: Machine, package: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Machine]:
    """The machine with the package, and three virtual controllers on its loopback addresses."""
    machine.run("dpkg", "--install", str(package), within_s=60)
    machine.write(f"{VENDORS}/hanging/__init__.py", PLUGIN)
    simulate = ("robot-gateway", "simulate", "rainbow", "--host", "127.0.0.2", "--count", "3", "--scenario", "steady")
    with machine.running(*simulate, out=tmp_path_factory.mktemp("controllers") / "log"):
        yield machine


@pytest.fixture
def service(installed: Machine) -> Machine:
    """The service, active and reading its two robots, as if nothing had happened before."""
    installed.path(DROP_IN).unlink(missing_ok=True)
    for name in ("hang", "slow"):
        installed.path(f"{STATE}/{name}").unlink(missing_ok=True)
    installed.write(CONFIG, CONFIG_TEXT)
    installed.run("systemctl", "daemon-reload")
    installed.run("systemctl", "reset-failed", UNIT, code=None)
    installed.run("systemctl", "restart", UNIT)
    until(lambda: link_states(installed) == {"r1": "ONLINE", "r2": "ONLINE"}, 10, "both robots online")
    return installed


def link_states(machine: Machine) -> dict[str, str]:
    return {robot["name"]: robot["link"]["state"] for robot in json.loads(machine.get("/api/v1/robots")[1])["robots"]}


def drop_in(machine: Machine, *lines: str) -> None:
    machine.write(DROP_IN, "\n".join(["[Service]", *lines, ""]))
    machine.run("systemctl", "daemon-reload")


def mark(machine: Machine) -> str:
    """A cursor: what the journal says from now on."""
    said = machine.run("journalctl", "--lines=0", "--show-cursor", "--quiet").out
    return f"--after-cursor={said.split('cursor: ')[1].strip()}"


def test_it_becomes_active_only_when_its_doors_are_open(service: Machine) -> None:
    service.run("systemctl", "stop", UNIT)
    service.write(f"{STATE}/slow", "")
    service.run("systemctl", "start", "--no-block", UNIT)
    seen: list[tuple[str, bool]] = []

    def active() -> bool:
        seen.append((service.state(), service.connects()))
        return seen[-1][0] == "active"

    until(active, 15, "active")
    assert ("activating", False) in seen
    assert ("active", False) not in seen
    assert service.get("/healthz")[0] == 200


def test_a_port_that_is_taken_is_said_and_tried_until_it_is_free(service: Machine, tmp_path: Path) -> None:
    service.run("systemctl", "stop", UNIT)
    cursor = mark(service)
    taken = "import socket, time; s = socket.create_server(('127.0.0.1', 8765)); time.sleep(60)"
    with service.running("python3", "-c", taken, out=tmp_path / "log"):
        until(service.connects, 5, "the port is taken")
        assert service.run("systemctl", "start", UNIT, code=None).code != 0
        until(lambda: int(service.show("NRestarts")) >= 2, 10, "it is tried again")
        assert service.state() == "activating"
        assert service.said("127.0.0.1:8765", cursor)
    until(lambda: service.state() == "active", 10, "active once the port is free")


def test_it_is_back_after_kill_9(service: Machine) -> None:
    before = service.pid()
    service.run("kill", "-KILL", str(before))
    took_s = until(lambda: service.state() == "active" and service.pid() not in {0, before}, 10, "active again")
    assert service.connects()
    assert service.show("NRestarts") == "1"
    print(f"back {took_s:.1f} s after SIGKILL")


def test_a_hung_loop_is_killed_and_started_again_and_the_journal_says_where_it_hung(service: Machine) -> None:
    drop_in(service, "WatchdogSec=2")
    service.run("systemctl", "restart", UNIT)
    cursor, before = mark(service), service.pid()
    time.sleep(2.5)  # longer than the watchdog's period: a loop that lives is let live
    assert service.pid() == before
    service.write(f"{STATE}/hang", "")
    until(lambda: service.pid() != before and service.state() == "active", 15, "active again")
    assert service.said("Watchdog timeout", cursor)
    assert service.said("in feed", cursor)
    until(lambda: link_states(service) == {"r1": "ONLINE", "r2": "ONLINE"}, 10, "both robots online")


def test_a_reload_takes_a_new_robot_in_and_the_readers_of_the_others_miss_nothing(
    service: Machine, tmp_path: Path
) -> None:
    heard = tmp_path / "heard"
    before = service.pid()
    with service.running("robot-gateway", "tail", "r1/joints", "--all", "--format", "json", out=heard):
        until(lambda: len(samples(heard)) > 10, 10, "samples")
        service.write(CONFIG, CONFIG_TEXT + THIRD_ROBOT)
        service.run("systemctl", "reload", UNIT)
        until(lambda: link_states(service).get("r3") == "ONLINE", 10, "the new robot online")
        at_reload = len(samples(heard))
        until(lambda: len(samples(heard)) > at_reload + 10, 10, "more samples")
    told = samples(heard)
    assert service.pid() == before
    assert service.state() == "active"
    assert len({epoch for epoch, _ in told}) == 1
    first = told[0][1]
    assert [seq for _, seq in told] == list(range(first, first + len(told)))


def samples(file: Path) -> list[tuple[str, int]]:
    """Epoch and number of each sample so far; a line that is not whole yet is left out."""
    lines = [line for line in file.read_text().splitlines(keepends=True) if line.endswith("\n")]
    parsed = [json.loads(line) for line in lines if line.startswith("{")]
    return [(sample["epoch"], sample["seq"]) for sample in parsed]


def test_sighup_reloads_too(service: Machine) -> None:
    before = service.pid()
    service.write(CONFIG, CONFIG_TEXT + THIRD_ROBOT)
    service.run("kill", "-HUP", str(before))
    until(lambda: link_states(service).get("r3") == "ONLINE", 10, "the new robot online")
    assert service.pid() == before
    until(lambda: service.state() == "active", 5, "active")


def test_a_broken_configuration_makes_the_reload_fail_and_changes_nothing(service: Machine) -> None:
    cursor, before = mark(service), service.pid()
    service.write(CONFIG, CONFIG_TEXT + "\n[[robots]]\nname = 5\n")
    assert service.run("systemctl", "reload", UNIT, code=None).code != 0
    assert service.said("name", cursor)
    assert (service.state(), service.pid()) == ("active", before)
    assert link_states(service) == {"r1": "ONLINE", "r2": "ONLINE"}
    service.write(CONFIG, CONFIG_TEXT)
    service.run("systemctl", "reload", UNIT)


def test_it_stops_within_2_s_and_that_is_no_failure(service: Machine, tmp_path: Path) -> None:
    with service.running("robot-gateway", "tail", "*/joints", "--all", "--format", "json", out=tmp_path / "heard"):
        until(lambda: len(samples(tmp_path / "heard")) > 10, 10, "samples")
        began = time.monotonic()
        service.run("systemctl", "stop", UNIT)
        took_s = time.monotonic() - began
    assert took_s < 2
    assert (service.state(), service.show("Result"), service.show("ExecMainStatus")) == ("inactive", "success", "0")
    assert not service.connects()


def test_a_wrong_configuration_is_not_started_again_and_again(service: Machine) -> None:
    service.write(CONFIG, "[server]\nlisten = 5\n")
    cursor = mark(service)
    assert service.run("systemctl", "restart", UNIT, code=None).code != 0
    time.sleep(2)  # twice RestartSec
    assert (service.state(), service.show("ExecMainStatus"), service.show("NRestarts")) == ("failed", "78", "0")
    assert service.said("listen", cursor)


def test_tokens_come_from_the_folder_that_only_root_can_read(service: Machine) -> None:
    folder = "/etc/robot-gateway/credentials"
    assert service.run("stat", "--format=%a %U", folder).out == "700 root\n"
    sha256 = hashlib.sha256(TOKEN.encode()).hexdigest()
    service.write(f"{folder}/tokens.toml", f'[[tokens]]\nname = "hmi"\nsha256 = "{sha256}"\n', mode=0o600)
    server = f'[server]\nlisten = "0.0.0.0:8765"\ntokens = "{folder}/tokens.toml"\n'
    service.write(CONFIG, server + ONE_ROBOT)
    service.run("systemctl", "restart", UNIT)
    assert service.get("/api/v1/robots")[0] == 401
    assert service.get("/api/v1/robots", TOKEN)[0] == 200
    assert service.get("/healthz")[0] == 200
    service.path(f"{folder}/tokens.toml").unlink()


def test_status_says_in_one_line_which_robots_are_on(service: Machine) -> None:
    until(lambda: "2 of 2 robots on" in service.show("StatusText"), 5, "status")


def test_the_control_socket_is_for_root_and_the_group_alone(service: Machine) -> None:
    stat = ("stat", "--format=%a %U %G")
    assert service.run(*stat, "/run/robot-gateway").out == "750 robot-gateway robot-gateway\n"
    assert service.run(*stat, "/run/robot-gateway/control.sock").out == "660 robot-gateway robot-gateway\n"
    service.run("robot-gateway", "reload", "--check")
    others = service.run("setpriv", "--reuid=65534", "--clear-groups", "robot-gateway", "reload", "--check", code=None)
    assert others.code != 0
    assert "Traceback" not in others.err


def test_it_logs_lines_of_json(service: Machine) -> None:
    own = [entry["MESSAGE"] for entry in service.journal("--boot", f"_PID={service.pid()}")]
    assert {"gateway.started", "link.connected"} <= {json.loads(line)["event"] for line in own}


def test_it_runs_without_any_right_of_root(service: Machine) -> None:
    status = dict(
        line.split(":\t", 1)
        for line in service.run("cat", f"/proc/{service.pid()}/status").out.splitlines()
        if ":\t" in line
    )
    assert int(status["Uid"].split()[0]) != 0
    assert {int(status[name], 16) for name in ("CapEff", "CapPrm", "CapBnd", "CapAmb")} == {0}
    assert (status["NoNewPrivs"], status["Seccomp"]) == ("1", "2")
    mounts = service.run("cat", f"/proc/{service.pid()}/mounts").out
    assert any(line.split()[1] == "/" and line.split()[3].startswith("ro") for line in mounts.splitlines())


def test_nothing_is_left_of_a_process_that_is_stopped(service: Machine) -> None:
    service.run("systemctl", "stop", UNIT)
    assert not service.path("/run/robot-gateway").exists()
    assert service.path(STATE).is_dir()
