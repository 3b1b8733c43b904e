"""`robot-gateway service`: installs this gateway as a service of systemd, and removes it."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated

import typer

from gateway.cli.common import USAGE, fail, tell
from gateway.service.files import CONFIG, NAME, hindrance, parts_of_this
from gateway.service.steps import PACKAGED, Step, StepError, Write, install, uninstall

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None, no_args_is_help=True)
_BOOTED = Path("/run/systemd/system")
_DryRun = Annotated[bool, typer.Option("--dry-run", help="Print the files and commands; change nothing.")]


@app.callback()
def service() -> None:
    """Install the gateway as a service of systemd, which starts it with the machine and keeps it running.

    The Debian package does this by itself.

    \b
    Examples:
      robot-gateway service install --dry-run
      sudo /opt/gateway/bin/robot-gateway service install
      sudo /opt/gateway/bin/robot-gateway service uninstall
    """  # noqa: D301 - the \b keeps the lines apart


@app.command("install")
def install_command(
    *,
    dry_run: _DryRun = False,
    config: Annotated[
        Path | None,
        typer.Option(
            "--config",
            "-c",
            metavar="FILE",
            help=f"What is copied to {CONFIG} if there is none. Default: the example, with no robot active.",
        ),
    ] = None,
) -> None:
    """Write unit, user and configuration, check them, and start the service now and at every boot.

    It runs this installation, wherever it stands. Installing again, after an upgrade, is right; a configuration that
    is there is never written over.

    \b
    Examples:
      robot-gateway service install --dry-run
      sudo /opt/gateway/bin/robot-gateway service install --config gateway.toml
    """  # noqa: D301
    try:
        text = None if config is None else config.read_text("utf-8")
    except (OSError, UnicodeDecodeError) as error:
        fail(f"--config {config}: {error}", USAGE)
    reasons = dict.fromkeys(reason for part in parts_of_this() if (reason := hindrance(part)))
    if dry_run:
        for reason in reasons:
            tell("warning:", "yellow", f"the service could not run from here: {reason}")
        _show(install(text))
        return
    _must_be_possible()
    _must_not_be_packaged(f"systemctl enable --now {NAME}")
    if reasons:
        fail(
            f"the service's user could not run this installation: {'; '.join(reasons)}. Install it where every user "
            f"may read, with a Python of the system: python3 -m venv /opt/gateway"
        )
    _perform(install(text))
    tell("running:", "green", f"robot-gateway status; journalctl --unit {NAME} --follow")
    tell("next:", "green", f"name your robots in {CONFIG}, then: systemctl reload {NAME}")


@app.command("uninstall")
def uninstall_command(
    *,
    dry_run: _DryRun = False,
    purge: Annotated[
        bool, typer.Option("--purge", help="Remove configuration, credentials, state and user too.")
    ] = False,
) -> None:
    """Stop the service and remove its files; the configuration stays.

    \b
    Examples:
      robot-gateway service uninstall --dry-run
      sudo /opt/gateway/bin/robot-gateway service uninstall --purge
    """  # noqa: D301
    if dry_run:
        _show(uninstall(purge=purge))
        return
    _must_be_possible()
    _must_not_be_packaged(f"apt-get {'purge' if purge else 'remove'} {NAME}")
    _perform(uninstall(purge=purge))


def _must_be_possible() -> None:
    """End with an error where services cannot be installed at all."""
    if not _BOOTED.is_dir():
        fail(
            "systemd does not run here: let what starts the services of this machine call `robot-gateway run`, "
            "or start a container of its image"
        )
    if os.geteuid() != 0:
        fail("only root may install services: call it with sudo; --dry-run shows what it would do")


def _must_not_be_packaged(instead: str) -> None:
    """End with an error where the service is another's: it says what to call instead."""
    packaged = next((path for path in PACKAGED if path.exists()), None)
    if packaged is not None:
        fail(f"the service is here already, from the Debian package ({packaged}): {instead}")


def _show(steps: Iterable[Step]) -> None:
    for step in steps:
        typer.echo(f"# {step}")
        if isinstance(step, Write):
            typer.echo(step.text)


def _perform(steps: Iterable[Step]) -> None:
    for step in steps:
        word, _, rest = str(step).partition(" ")
        tell(f"{word}:", "green", rest)
        try:
            step.perform()
        except StepError as error:
            fail(error.reason)
        except OSError as error:
            fail(f"{step}: {error.strerror or error}")
