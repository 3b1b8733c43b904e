#!/usr/bin/env python3
"""Builds the Debian package: `make deb`. Needs dpkg-deb and the network or a cache of wheels; no root.

The gateway has a virtual environment of its own in /opt/robot-gateway. One that is made by hand needs nothing
rewritten: pyvenv.cfg, a link to Debian's Python, and the packages. It runs with the Python of the minor version that
builds it, so build with the one of the Debian release that it is for.
"""

from __future__ import annotations

import argparse
import gzip
import hashlib
import os
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from gateway import __version__
from gateway.service.files import first_config

ROOT = Path(__file__).resolve().parents[2]
HERE = Path(__file__).resolve().parent
PYTHON = f"python3.{sys.version_info.minor}"
HOME = Path("opt/robot-gateway")
SCRIPT = f"""#!/{HOME}/bin/python
import sys
from gateway.cli.main import run
sys.exit(run())
"""
CONTROL = """Package: robot-gateway
Version: {version}
Architecture: {architecture}
Maintainer: robot-gateway <root@localhost>
Installed-Size: {size_kib}
Depends: python3 (>= 3.{minor}), python3 (<< 3.{next_minor}~), {python}, libc6, libstdc++6, systemd | systemd-sysusers
Section: net
Priority: optional
Description: reads robot controllers and serves what they tell
 One service connects to the robot controllers of a cell, whatever their brand,
 and serves their state as one well-described stream over WebSocket and HTTP.
 It only observes: it never moves a robot.
"""


def main() -> None:
    """Build it and print where it is."""
    parser = argparse.ArgumentParser(description="Build the Debian package of robot-gateway.")
    parser.add_argument("--out", type=Path, default=ROOT / "dist", help="folder of the package")
    parser.add_argument("--compression", default="xz", help="of dpkg-deb: xz, zstd, gzip, none")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="robot-gateway-deb-") as folder:
        stage = Path(folder) / "stage"
        stage.mkdir()
        packages(stage, Path(folder))
        files(stage)
        architecture = said("dpkg", "--print-architecture").strip()
        control(stage, architecture)
        options.out.mkdir(parents=True, exist_ok=True)
        package = options.out / f"robot-gateway_{version()}_{architecture}.deb"
        run("dpkg-deb", "--root-owner-group", f"-Z{options.compression}", "--build", str(stage), str(package))
    sys.stdout.write(f"{package}\n")


def packages(stage: Path, scratch: Path) -> None:
    """The virtual environment: the wheel of this checkout and what it needs, in the versions that were tested."""
    pip = (sys.executable, "-m", "pip", "--disable-pip-version-check", "--quiet")
    run(*pip, "wheel", "--no-deps", "--wheel-dir", str(scratch), str(ROOT))
    (wheel,) = scratch.glob("robot_gateway-*.whl")
    site = stage / HOME / "lib" / PYTHON / "site-packages"
    constraints = ROOT / "packaging" / "constraints.txt"
    run(
        *pip, "install", "--target", str(site), "--no-compile", "--only-binary", ":all:", "--no-binary", "nkeys",
        "--constraint", str(constraints), f"{wheel}[nats]",
    )  # fmt: skip
    shutil.rmtree(site / "bin", ignore_errors=True)
    for note in site.glob("*.dist-info/direct_url.json"):  # where this machine had the wheel
        note.unlink()
        record = note.with_name("RECORD")
        listed = record.read_text("utf-8").splitlines(keepends=True)
        record.write_text("".join(line for line in listed if f"/{note.name}," not in line), "utf-8")
    programs = stage / HOME / "bin"
    programs.mkdir()
    (programs / "python").symlink_to(f"/usr/bin/{PYTHON}")
    write(stage / HOME / "pyvenv.cfg", "home = /usr/bin\ninclude-system-site-packages = false\n")
    write(programs / "robot-gateway", SCRIPT, mode=0o755)
    # The service cannot write: what Python compiles comes with the package, and is never compared with its source.
    run(
        sys.executable, "-m", "compileall", "-q", "-s", str(stage), "-p", "/", "--invalidation-mode", "unchecked-hash",
        str(site),
    )  # fmt: skip


def files(stage: Path) -> None:
    """The unit, its user and folders, the configuration, the manual page."""
    for source, target in (
        ("systemd/robot-gateway.service", "usr/lib/systemd/system/robot-gateway.service"),
        ("systemd/robot-gateway.sysusers", "usr/lib/sysusers.d/robot-gateway.conf"),
        ("systemd/robot-gateway.tmpfiles", "usr/lib/tmpfiles.d/robot-gateway.conf"),
        ("LICENSE", "usr/share/doc/robot-gateway/copyright"),
    ):
        write(stage / target, (ROOT / source).read_text("utf-8"))
    write(stage / "etc/robot-gateway/gateway.toml", first_config())
    manual = stage / "usr/share/man/man1/robot-gateway.1.gz"
    manual.parent.mkdir(parents=True)
    manual.write_bytes(gzip.compress((ROOT / "packaging" / "robot-gateway.1").read_bytes(), mtime=0))
    (stage / "usr/bin").mkdir(parents=True)
    (stage / "usr/bin/robot-gateway").symlink_to(f"/{HOME}/bin/robot-gateway")


def control(stage: Path, architecture: str) -> None:
    """What dpkg is told."""
    contents = sorted(path for path in stage.rglob("*") if path.is_file() and not path.is_symlink())
    sums = [f"{hashlib.md5(path.read_bytes()).hexdigest()}  {path.relative_to(stage)}" for path in contents]  # noqa: S324
    text = CONTROL.format(
        version=version(),
        architecture=architecture,
        size_kib=sum(path.stat().st_size for path in contents) // 1024,
        minor=sys.version_info.minor,
        next_minor=sys.version_info.minor + 1,
        python=PYTHON,
    )
    write(stage / "DEBIAN/control", text)
    write(stage / "DEBIAN/conffiles", "/etc/robot-gateway/gateway.toml\n")
    write(stage / "DEBIAN/md5sums", "\n".join(sums) + "\n")
    for script in ("postinst", "prerm", "postrm"):
        write(stage / "DEBIAN" / script, (HERE / script).read_text("utf-8"), mode=0o755)
    for path in (stage, *stage.rglob("*")):  # whatever umask this machine has
        if path.is_dir():
            path.chmod(0o755)
        elif not path.is_symlink():
            path.chmod(0o755 if path.stat().st_mode & 0o100 else 0o644)


def version() -> str:
    """The version as Debian writes it: a candidate is older than its release."""
    return re.sub(r"(a|b|rc|\.dev)(?=\d)", r"~\1", __version__)


def write(path: Path, text: str, mode: int = 0o644) -> None:
    """Write a file of the package."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, "utf-8")
    path.chmod(mode)


def run(*argv: str) -> None:
    """Run a command of the build; what it says goes to stderr."""
    subprocess.run(argv, check=True, stdout=sys.stderr, env={**os.environ, "SOURCE_DATE_EPOCH": epoch()})  # noqa: S603


def said(*argv: str) -> str:
    """What a command prints."""
    return subprocess.run(argv, check=True, capture_output=True, text=True, cwd=ROOT).stdout  # noqa: S603


def epoch() -> str:
    """The time that all files of the package get, in s since 1970: the commit's, so that a build can be repeated."""
    if "SOURCE_DATE_EPOCH" in os.environ:
        return os.environ["SOURCE_DATE_EPOCH"]
    try:
        return said("git", "log", "-1", "--format=%ct").strip()
    except (OSError, subprocess.CalledProcessError):  # no checkout
        return str(int((ROOT / "pyproject.toml").stat().st_mtime))


if __name__ == "__main__":
    main()
