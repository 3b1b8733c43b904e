"""What installing and removing the service does, as a list of steps that can be shown or performed."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from gateway.errors import GatewayError
from gateway.service.files import CONFIG, NAME, USER, first_config, shipped, this_command, unit

UNIT = Path(f"/etc/systemd/system/{NAME}.service")
SYSUSERS = Path(f"/etc/sysusers.d/{NAME}.conf")
TMPFILES = Path(f"/etc/tmpfiles.d/{NAME}.conf")
STATE = Path(f"/var/lib/{NAME}")
PACKAGED = tuple(Path(folder) / f"{NAME}.service" for folder in ("/usr/lib/systemd/system", "/lib/systemd/system"))
_CREDENTIALS = f"LoadCredential={NAME}:{CONFIG.parent}/credentials"


class StepError(GatewayError):
    """A step could not be done; those before it are.

    Attributes:
        step: It, in words.
        reason: Why.
    """

    def __init__(self, step: str, reason: str) -> None:
        super().__init__(f"{step}: {reason}")
        self.step = step
        self.reason = reason


@dataclass(frozen=True, slots=True)
class Write:
    """Write a file, over what is there."""

    path: Path
    text: str

    def __str__(self) -> str:
        return f"write {self.path}"

    def perform(self) -> None:
        """Do it.

        Raises:
            OSError: It cannot be written.
            StepError: A link stands there: a masked service is one.
        """
        if self.path.is_symlink():
            raise StepError(str(self), f"{self.path} is a symbolic link (a masked service?); remove it first")
        self.path.parent.mkdir(mode=0o755, parents=True, exist_ok=True)
        self.path.write_text(self.text, "utf-8")
        self.path.chmod(0o644)


@dataclass(frozen=True, slots=True)
class Keep:
    """Leave alone what is there."""

    path: Path
    reason: str

    def __str__(self) -> str:
        return f"keep {self.path}: {self.reason}"

    def perform(self) -> None:
        """Nothing is to be done."""


@dataclass(frozen=True, slots=True)
class Remove:
    """Remove a file, or a folder with what is in it; nothing if it is not there."""

    path: Path

    def __str__(self) -> str:
        return f"remove {self.path}"

    def perform(self) -> None:
        """Do it.

        Raises:
            OSError: It cannot be removed.
        """
        if self.path.is_dir() and not self.path.is_symlink():
            shutil.rmtree(self.path)
        else:
            self.path.unlink(missing_ok=True)


@dataclass(frozen=True, slots=True)
class Run:
    """Run a command; its standard output is shown only if it fails.

    Attributes:
        argv: The command.
        remedy: What to do where it fails.
        needed: Whether the steps behind it need it.
    """

    argv: tuple[str, ...]
    remedy: str = ""
    needed: bool = True

    def __str__(self) -> str:
        return f"run {' '.join(self.argv)}"

    def perform(self) -> None:
        """Do it.

        Raises:
            OSError: There is no such command.
            StepError: It ended with another exit code than 0.
        """
        done = subprocess.run(self.argv, check=False, capture_output=True, text=True)  # noqa: S603
        if done.returncode and self.needed:
            said = "\n".join(text.strip() for text in (done.stderr, done.stdout, self.remedy) if text.strip())
            raise StepError(str(self), f"exit code {done.returncode}\n{said}")


Step = Write | Keep | Remove | Run


def install(config: str | None = None) -> Iterator[Step]:
    """The steps that install the service, enable and start it.

    Args:
        config: The text of the configuration; None: the example, without a robot.
    """
    command = this_command()
    yield Write(SYSUSERS, shipped(f"{NAME}.sysusers"))
    yield Run(("systemd-sysusers", str(SYSUSERS)))
    yield Write(TMPFILES, shipped(f"{NAME}.tmpfiles"))
    yield Run(("systemd-tmpfiles", "--create", str(TMPFILES)))
    if CONFIG.exists():
        yield Keep(CONFIG, "it is never written over")
    else:
        yield Write(CONFIG, first_config() if config is None else config)
    yield _check(command)
    yield Write(UNIT, unit(command))
    yield Run(("systemctl", "daemon-reload"))
    yield Run(("systemctl", "enable", NAME))
    yield Run(("systemctl", "restart", NAME), remedy=f"what it said: journalctl --unit {NAME} --lines 20")


def uninstall(*, purge: bool) -> Iterator[Step]:
    """The steps that stop and remove the service.

    Args:
        purge: Remove configuration, state, changes to the unit and the user too.
    """
    yield Run(("systemctl", "disable", "--now", NAME), needed=UNIT.exists())
    yield Remove(UNIT)
    yield Remove(SYSUSERS)
    yield Remove(TMPFILES)
    if purge:
        yield Remove(UNIT.with_name(f"{UNIT.name}.d"))
        yield Remove(CONFIG.parent)
        yield Remove(STATE)
        yield Run(("userdel", USER), needed=False)
    else:
        yield Keep(CONFIG.parent, "remove it with --purge")
        if STATE.exists():
            yield Keep(STATE, "remove it with --purge")
    yield Run(("systemctl", "daemon-reload"))
    yield Run(("systemctl", "reset-failed", NAME), needed=False)


def _check(command: list[str]) -> Run:
    """Check the configuration as the service would read it: its user, its view of the files, its credentials."""
    sandbox = (f"User={USER}", f"Group={USER}", "ProtectHome=yes", "ProtectSystem=strict", _CREDENTIALS)
    properties = (word for one in sandbox for word in ("--property", one))
    return Run(
        ("systemd-run", "--quiet", "--wait", "--pipe", "--collect", *properties, *command, "check", str(CONFIG)),
        remedy=f"Nothing was started. Correct {CONFIG} (exit code 203: user {USER} may not run {command[0]}) and "
        f"install again.",
    )
