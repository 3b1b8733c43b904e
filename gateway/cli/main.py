"""The command `robot-gateway`. Commands are imported only when they are called, so that `status` starts at once."""

from __future__ import annotations

import difflib
import importlib
import sys
from typing import Annotated, NoReturn, cast

import typer
from typer.core import TyperCommand, TyperGroup

from gateway import __version__

# command -> module that holds it, and its attribute: a function, or a Typer of subcommands
_COMMANDS = {
    "run": ("gateway.cli.run", "run"),
    "check": ("gateway.cli.check", "check"),
    "reload": ("gateway.cli.reload", "reload"),
    "status": ("gateway.cli.status", "status"),
    "health": ("gateway.cli.health", "health"),
    "snapshot": ("gateway.cli.snapshot", "snapshot"),
    "capture": ("gateway.cli.capture", "capture"),
    "record": ("gateway.cli.record", "record"),
    "tail": ("gateway.cli.tail", "tail"),
    "plant": ("gateway.cli.plant", "plant_command"),
    "probe": ("gateway.cli.probe", "probe_command"),
    "vendors": ("gateway.cli.vendors", "vendors"),
    "new-vendor": ("gateway.cli.new_vendor", "new_vendor"),
    "vendor-check": ("gateway.cli.vendor_check", "vendor_check"),
    "replay": ("gateway.cli.replay", "replay"),
    "decode": ("gateway.cli.decode", "decode"),
    "validate": ("gateway.cli.validate", "app"),
    "simulate": ("gateway.cli.simulate", "app"),
    "token": ("gateway.cli.token", "app"),
    "demo": ("gateway.cli.demo", "demo"),
    "service": ("gateway.cli.service", "app"),
}
_HELP = """Reads every robot controller in the cell and serves one honest stream.

It only observes: it never moves a robot. For information only; not for functional safety (IEC 61508).

\b
Examples:
  robot-gateway demo                      see it at work, without a robot
  robot-gateway probe 192.168.58.2        what does this controller speak?
  robot-gateway check gateway.toml        is the configuration right?
  robot-gateway run --config gateway.toml
  robot-gateway status                    which robot is on, and why not?
  robot-gateway tail r1/joints --rate 5

Exit codes: 0 success, 1 failure, 2 wrong usage, 3 reload: a robot waits for its session, 78 wrong configuration.
"""


class _LazyGroup(TyperGroup):
    """Imports a command's module when the command is asked for."""

    def list_commands(self, ctx: object) -> list[str]:  # noqa: ARG002
        return list(_COMMANDS)

    def get_command(self, ctx: object, cmd_name: str) -> TyperCommand | TyperGroup | None:
        if cmd_name not in _COMMANDS:
            if cmd_name.startswith("-"):
                return None
            near = difflib.get_close_matches(cmd_name, _COMMANDS, n=1)
            hint = f"did you mean {near[0]!r}?" if near else f"known are {', '.join(_COMMANDS)}"
            cast("typer.Context", ctx).fail(f"no such command {cmd_name!r}; {hint}")
        module, attribute = _COMMANDS[cmd_name]
        found = getattr(importlib.import_module(module), attribute)
        if isinstance(found, typer.Typer):
            command = typer.main.get_command(found)
        else:
            single = typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None)
            single.command(name=cmd_name)(found)
            command = typer.main.get_command(single)
        command.name = cmd_name
        return cast("TyperCommand | TyperGroup", command)


app = typer.Typer(
    cls=_LazyGroup,
    help=_HELP,
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _version(*, asked: bool) -> None:
    if asked:
        typer.echo(f"robot-gateway {__version__}")
        raise typer.Exit


@app.callback()
def main(
    *,
    version: Annotated[
        bool,
        typer.Option(
            "--version",
            is_eager=True,
            callback=lambda value: _version(asked=value),
            help="Print the version and end.",
        ),
    ] = False,
) -> None:
    """Hold the options that come before the command."""


def run() -> NoReturn:
    """Run the command line; a pipe that closes early (`| head`) is no error."""
    try:
        app()
    except BrokenPipeError:
        sys.stderr.close()
        sys.exit(0)
    except KeyboardInterrupt:
        sys.exit(130)
    sys.exit(0)
