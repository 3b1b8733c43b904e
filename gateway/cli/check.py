"""`robot-gateway check`: prints a configuration back as understood, or everything that is wrong with it."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Annotated, NoReturn

import typer
from rich.console import Console
from rich.text import Text

from gateway.cli.common import tell
from gateway.config import find_config, load
from gateway.config.printing import as_toml, json_schema
from gateway.core.registry import Registry
from gateway.errors import ConfigError

EX_CONFIG = 78


def check(
    file: Annotated[
        Path | None,
        typer.Argument(
            help="The configuration; without it the one that `robot-gateway run` would use.", metavar="FILE"
        ),
    ] = None,
    *,
    schema: Annotated[
        bool, typer.Option("--schema", help="Print the JSON Schema of the file instead, for editors and other tools.")
    ] = False,
) -> None:
    """Print a configuration back as understood, with every default, or say what is wrong with it.

    Nothing is connected. Exit code 0: it can be used, perhaps with warnings; 78: it cannot, and every problem is named
    with its line.

    \b
    Examples:
      robot-gateway check /etc/robot-gateway/gateway.toml
      robot-gateway check --schema > gateway.schema.json
    """  # noqa: D301  \b tells click to leave the lines as they are
    try:
        if schema:
            registry = load(file).registry if file else Registry()
            typer.echo(json.dumps(json_schema(registry), indent=2, ensure_ascii=False))
            return
        config = load(file or find_config(None, os.environ, Path.cwd()))
    except ConfigError as error:
        fail(error)
    typer.echo(as_toml(config), nl=False)
    for warning in config.warnings:
        tell("warning:", "yellow", warning)
    n_robots = len(config.robots)
    tell("valid:", "green", f"{config.file}, {n_robots} robot{'' if n_robots == 1 else 's'}")


def fail(error: ConfigError) -> NoReturn:
    """Print every problem and end with the exit code of a wrong configuration."""
    console = Console(stderr=True, highlight=False, soft_wrap=True)
    for problem in error.problems:
        console.print(Text(problem, "red"))
    raise typer.Exit(EX_CONFIG)
