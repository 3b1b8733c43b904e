"""`robot-gateway run`: the daemon."""

from __future__ import annotations

import os
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from gateway import logs
from gateway.app import run_until_signal
from gateway.cli.check import fail as fail_config
from gateway.cli.common import USAGE, call, fail, tell
from gateway.config import find_config, load
from gateway.errors import ConfigError


def run(
    config: Annotated[
        Path | None,
        typer.Option(
            "--config",
            "-c",
            metavar="FILE",
            help="The configuration. Default: $ROBOT_GATEWAY_CONFIG, ./gateway.toml, /etc/robot-gateway/gateway.toml.",
        ),
    ] = None,
    log_level: Annotated[
        str, typer.Option(metavar="LEVEL", help="debug, info, warning or error.", envvar="ROBOT_GATEWAY_LOG_LEVEL")
    ] = "info",
) -> None:
    """Run the gateway until it is told to stop (SIGINT, SIGTERM).

    Robots that do not answer are no error: they are tried again for ever. Exit code 78: the configuration is wrong.
    SIGHUP reads the configuration again, as `robot-gateway reload` does.

    \b
    Examples:
      robot-gateway run --config gateway.toml
      robot-gateway run --config config/demo.toml --log-level debug
    """  # noqa: D301 - the \b keeps the lines apart
    try:
        logs.configure(log_level)
    except ValueError as error:
        fail(str(error), USAGE)
    try:
        loaded = load(find_config(config, os.environ, Path.cwd()))
    except ConfigError as error:
        fail_config(error)
    for warning in loaded.warnings:
        tell("warning:", "yellow", warning)
    call(partial(run_until_signal, loaded), uvloop=True)
