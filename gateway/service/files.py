"""The files of the service: the unit as shipped, and as it must be for this installation; the first configuration."""

from __future__ import annotations

import os
import re
import stat
import sys
from collections.abc import Sequence
from pathlib import Path

NAME = "robot-gateway"
USER = "robot-gateway"
CONFIG = Path("/etc/robot-gateway/gateway.toml")
# Where the Debian package has its command: what the shipped unit starts.
COMMAND = "/usr/bin/robot-gateway"
_HERE = Path(__file__).parent
_REPOSITORY = _HERE.parents[1]
# What ProtectHome= of the unit hides.
_HIDDEN = tuple(Path(path) for path in ("/root", "/home", "/run/user"))


def shipped(name: str) -> str:
    """A file of the folders `systemd` and `config`: from the wheel, or from the checkout that this is.

    Raises:
        FileNotFoundError: Neither has it.
    """
    packed = _HERE / "data" / name
    if packed.is_file():
        return packed.read_text("utf-8")
    folder = "config" if name.endswith(".toml") else "systemd"
    return (_REPOSITORY / folder / name).read_text("utf-8")


def unit(command: Sequence[str]) -> str:
    """The unit, starting the gateway by this command."""
    return shipped(f"{NAME}.service").replace(COMMAND, " ".join(quoted(part) for part in command))


def first_config() -> str:
    """The example without a robot, so that a fresh service calls nobody: what was active begins with a bare `#`."""
    head, mark, robots = shipped("gateway.toml").partition("[[robots]]\n")
    head = head.removeprefix("#:schema gateway.schema.json\n#\n")
    inactive = re.sub(r"^(?=[^#\n])", "#", mark + robots, flags=re.MULTILINE)
    return (
        f"{head}# No robot is active yet. To read one, remove the # in front of [[robots]], name, vendor and host,\n"
        f"# correct them, and tell the service: systemctl reload {NAME}\n\n{inactive}"
    )


def quoted(part: str) -> str:
    """A word of a command line as a unit file wants it."""
    escaped = part.replace("\\", "\\\\").replace('"', '\\"').replace("%", "%%").replace("$", "$$")
    return f'"{escaped}"' if re.search(r"[\s'\"\\;]", part) else escaped


def this_command() -> list[str]:
    """How this installation is started, wherever it stands: a script would not survive that its folder was moved."""
    return [sys.executable, "-m", "gateway"]


def parts_of_this() -> list[Path]:
    """What the service's user must reach of this installation: interpreter, its home, environment, packages."""
    executable = Path(sys.executable)
    return list(dict.fromkeys([executable, executable.resolve(), Path(sys.prefix), Path(sys.base_prefix), _REPOSITORY]))


def hindrance(path: Path) -> str | None:
    """Say why a user without rights of its own, in the unit's sandbox, could not use a file or folder; None: it can."""
    hidden = next((above for above in _HIDDEN if path.is_relative_to(above)), None)
    if hidden is not None:
        return f"{path} is below {hidden}, which the service cannot see"
    for part in (*reversed(path.parents), path):
        try:
            mode = part.stat().st_mode
        except OSError as error:
            return f"{part}: {os.strerror(error.errno or 0)}"
        if not mode & stat.S_IXOTH:
            return f"{part} may not be entered or run by others than its owner"
    return None
