"""A real systemd as PID 1 of a small Debian, booted with systemd-nspawn, and the package installed into it.

The Debian is made once for each machine, with mmdebstrap, and kept in the user's cache folder; a booted machine works
on an overlay in memory, so that nothing of it stays. It has its own network: its loopback, and nothing else.
"""

from __future__ import annotations

import contextlib
import fcntl
import functools
import hashlib
import json
import os
import shutil
import signal
import subprocess
import sys
import time
import uuid
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
SUITE = "bookworm"
SUITE_PYTHON = (3, 11)
PACKAGES = ("systemd", "systemd-sysv", "dbus", "python3", "procps")
UNIT = "robot-gateway"
CONFIG = "/etc/robot-gateway/gateway.toml"
PYTHON = "/opt/robot-gateway/bin/python"
_TOOLS = ("unshare", "nsenter", "systemd-nspawn", "mmdebstrap", "dpkg-deb")
_OWN_MOUNTS = ("unshare", "--mount", "--propagation", "private")
_CGROUPS = "umount -R /sys/fs/cgroup && mount -t cgroup2 none /sys/fs/cgroup"


@functools.cache
def missing() -> str | None:
    """Say why a systemd cannot be booted here; None: it can."""
    if os.name != "posix" or os.geteuid() != 0:
        return "booting a systemd needs root"
    lacking = [tool for tool in _TOOLS if shutil.which(tool) is None]
    if lacking:
        return f"booting a systemd needs {', '.join(lacking)}: apt-get install systemd-container mmdebstrap"
    if sys.version_info[:2] != SUITE_PYTHON:
        return f"the package of this Python does not install in Debian {SUITE}: run the tests with its {SUITE_PYTHON}"
    try:
        _cgroup2()
        subprocess.run([*_OWN_MOUNTS, "sh", "-c", _CGROUPS], check=True)  # noqa: S603
    except (LookupError, OSError, subprocess.CalledProcessError) as error:
        return f"booting a systemd needs own mounts and cgroups: {error}"
    return None


def _cgroup2() -> Path:
    """Where cgroup v2 is mounted, so that a group may be made for the machine."""
    for line in Path("/proc/self/mounts").read_text().splitlines():
        _, where, kind, options, *_ = line.split()
        if kind == "cgroup2" and "rw" in options.split(","):
            return Path(where)
    raise LookupError("no writable cgroup v2 is mounted")


def rootfs() -> Path:
    """The folder of a Debian with systemd and Python; the first call of a machine makes it."""
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "robot-gateway-tests"
    cache.mkdir(parents=True, exist_ok=True)
    key = hashlib.sha256(" ".join(PACKAGES).encode()).hexdigest()[:12]
    made = cache / f"{SUITE}-{key}"
    with (cache / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not made.is_dir():
            making = cache / f"{made.name}.making"
            subprocess.run(["rm", "-rf", making], check=True)  # noqa: S603, S607
            subprocess.run(  # noqa: S603
                ["mmdebstrap", "--quiet", "--variant=minbase", f"--include={','.join(PACKAGES)}", SUITE, making],  # noqa: S607
                check=True,
                timeout=240,
            )
            making.rename(made)
    return made


def build_package(out: Path) -> Path:
    """Build the Debian package of this checkout, with little compression."""
    done = subprocess.run(  # noqa: S603
        [sys.executable, "packaging/deb/build.py", "--out", out, "--compression", "none"],
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        check=False,
        capture_output=True,
        text=True,
        timeout=200,
    )
    assert done.returncode == 0, done.stderr
    return Path(done.stdout.strip())


def repacked(package: Path, version: str) -> Path:
    """The same package under another version, beside it."""
    new = package.with_name(f"robot-gateway_{version}_all.deb")
    folder = package.with_name(f"{version}.unpacked")
    subprocess.run(["dpkg-deb", "--raw-extract", package, folder], check=True)  # noqa: S603, S607
    control = folder / "DEBIAN" / "control"
    lines = control.read_text().splitlines()
    control.write_text(
        "\n".join(f"Version: {version}" if line.startswith("Version:") else line for line in lines) + "\n"
    )
    build = ["dpkg-deb", "-Znone", "--root-owner-group", "--build", str(folder), str(new)]
    subprocess.run(build, check=True, capture_output=True)  # noqa: S603
    shutil.rmtree(folder)
    return new


def until(happened: Callable[[], bool], within_s: float, what: str) -> float:
    """Wait until something is so, and give the time that it took, in s."""
    began = time.monotonic()
    while not happened():
        assert time.monotonic() - began < within_s, f"not within {within_s} s: {what}"
        time.sleep(0.05)
    return time.monotonic() - began


@dataclass(frozen=True)
class Done:
    """What a command in the machine has left."""

    code: int
    out: str
    err: str


@dataclass(frozen=True)
class Machine:
    """A booted Debian.

    Attributes:
        leader: Its PID 1, as this machine numbers it.
        console: What it has written to its console.
    """

    leader: int
    console: Path

    def _inside(self, argv: tuple[str, ...]) -> list[str]:
        return ["nsenter", "-t", str(self.leader), "-m", "-u", "-i", "-n", "-p", "-C", "--", *argv]

    def run(self, *argv: str, code: int | None = 0, within_s: float = 30) -> Done:
        """Run a command to its end, as root; None as code allows any."""
        done = subprocess.run(  # noqa: S603
            self._inside(argv),
            check=False,
            capture_output=True,
            text=True,
            timeout=within_s,
            stdin=subprocess.DEVNULL,
            env={"PATH": "/usr/sbin:/usr/bin:/sbin:/bin", "LANG": "C.UTF-8", "HOME": "/root"},
        )
        assert code is None or done.returncode == code, f"{argv}: {done.returncode}\n{done.stdout}\n{done.stderr}"
        return Done(done.returncode, done.stdout, done.stderr)

    @contextlib.contextmanager
    def running(self, *argv: str, out: Path) -> Iterator[subprocess.Popen[bytes]]:
        """Run a command as long as the context lasts; what it prints goes to a file."""
        with out.open("wb") as file:
            inside = self._inside(("setpriv", "--pdeathsig", "KILL", *argv))
            process = subprocess.Popen(inside, stdout=file, stderr=subprocess.STDOUT, stdin=subprocess.DEVNULL)  # noqa: S603
            try:
                yield process
            finally:
                running = [] if process.poll() is not None else _children(process.pid)
                for child in running:  # nsenter itself would leave it behind
                    with contextlib.suppress(ProcessLookupError):
                        os.kill(child, signal.SIGTERM)
                try:
                    process.wait(5)
                except subprocess.TimeoutExpired:
                    process.kill()
                    process.wait()

    def path(self, path: str) -> Path:
        """A path of the machine as this one sees it."""
        return Path(f"/proc/{self.leader}/root{path}")

    def write(self, path: str, text: str, mode: int = 0o644) -> None:
        """Write a file in the machine."""
        there = self.path(path)
        there.parent.mkdir(parents=True, exist_ok=True)
        there.write_text(text)
        there.chmod(mode)

    def show(self, name: str, unit: str = UNIT) -> str:
        """One property of a unit."""
        return self.run("systemctl", "show", "--property", name, "--value", unit).out.strip()

    def state(self) -> str:
        """The state of the service: active, activating, failed."""
        return self.show("ActiveState")

    def pid(self) -> int:
        """Its main process, as the machine numbers it."""
        return int(self.show("MainPID"))

    def journal(self, *options: str) -> list[dict[str, str]]:
        """What it and systemd have said of it."""
        said = self.run("journalctl", "--unit", UNIT, "--output", "json", "--no-pager", *options).out
        return [json.loads(line) for line in said.splitlines()]

    def said(self, text: str, *options: str) -> bool:
        """Whether some line of its journal has this text."""
        return any(text in str(entry.get("MESSAGE", "")) for entry in self.journal(*options))

    def connects(self, port: int = 8765) -> bool:
        """Whether somebody takes a connection at a port of its loopback address."""
        return self.run("bash", "-c", f"exec 3<>/dev/tcp/127.0.0.1/{port}", code=None).code == 0

    def get(self, path: str, token: str | None = None) -> tuple[int, str]:
        """Ask the service over HTTP: status and body."""
        code = (
            "import sys, urllib.error, urllib.request\n"
            f"request = urllib.request.Request('http://127.0.0.1:8765{path}', headers={_bearer(token)!r})\n"
            "try: answer = urllib.request.urlopen(request, timeout=5)\n"
            "except urllib.error.HTTPError as error: answer = error\n"
            "print(answer.status); print(answer.read().decode())"
        )
        status, _, body = self.run("python3", "-c", code).out.partition("\n")
        return int(status), body


def _bearer(token: str | None) -> dict[str, str]:
    return {} if token is None else {"Authorization": f"Bearer {token}"}


@contextlib.contextmanager
def booted(debian: Path, logs: Path, *binds: Path) -> Iterator[Machine]:
    """Boot a Debian for as long as the context lasts.

    Args:
        debian: Its root folder; nothing in it is changed.
        logs: Folder of its console's output.
        binds: Folders that it sees too, read-only, under the same path.
    """
    name = f"gateway-{uuid.uuid4().hex[:8]}"
    group = _cgroup2() / name
    group.mkdir()
    console = logs / f"{name}.log"
    options = ["--volatile=overlay", "--private-network", *(f"--bind-ro={path}" for path in binds)]
    enter = 'echo $$ >"$1/cgroup.procs" && shift && exec "$@"'
    own_cgroups = (*_OWN_MOUNTS, "sh", "-c", f'{_CGROUPS} && exec "$@"', "sh")
    nspawn = [
        "systemd-nspawn", "--quiet", f"--directory={debian}", f"--machine={name}", "--register=no", "--keep-unit",
        "--console=pipe", "--link-journal=no", *options, "--boot",
    ]  # fmt: skip
    with console.open("wb") as file:
        process = subprocess.Popen(  # noqa: S603
            ["sh", "-c", enter, "sh", str(group), *own_cgroups, *nspawn],  # noqa: S607
            stdin=subprocess.DEVNULL,
            stdout=file,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
    try:
        machine = Machine(_leader(process, console), console)
        up = ("systemctl", "is-system-running")
        until(lambda: machine.run(*up, code=None).out.strip() in {"running", "degraded"}, 30, f"boot, see {console}")
        yield machine
        os.kill(machine.leader, signal.SIGRTMIN + 4)  # power off
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(15)
    finally:
        process.kill()
        process.wait()
        _remove(group)


def _leader(process: subprocess.Popen[bytes], console: Path) -> int:
    """The process that is PID 1 of the machine, once it is there."""
    found: list[int] = []

    def there() -> bool:
        assert process.poll() is None, f"systemd-nspawn has ended:\n{console.read_text(errors='replace')}"
        for child in _children(process.pid):
            with contextlib.suppress(OSError):
                status = Path(f"/proc/{child}/status").read_text()
                if "\nNSpid:" in status and status.split("\nNSpid:")[1].split("\n")[0].split()[1:] == ["1"]:
                    found.append(child)
        return bool(found)

    until(there, 20, f"PID 1, see {console}")
    return found[0]


def _children(pid: int) -> list[int]:
    return [int(child) for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


def _remove(group: Path) -> None:
    """Remove the control group of a machine that is gone, with those below it."""
    for folder in sorted((path for path in group.rglob("*") if path.is_dir()), reverse=True):
        with contextlib.suppress(OSError):
            folder.rmdir()
    with contextlib.suppress(OSError):
        group.rmdir()
