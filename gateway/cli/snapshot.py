"""`robot-gateway snapshot`: a recording of what the whole cell has just done."""

from __future__ import annotations

import os
from typing import Annotated

import msgspec
import typer

from gateway.cli.common import fail, tell
from gateway.cli.control import ANSWER_S, Control, ask, find_socket
from gateway.record.dump import LONGEST_S
from gateway.recording import Snapshot, Taken


def snapshot(
    *,
    wait: Annotated[bool, typer.Option("--wait", help="Wait until the file is written, and print its name.")] = False,
    control: Control = None,
) -> None:
    """Let the running gateway record what the cell does now: some seconds before and after, all robots in one file.

    How long before and after, and into which folder, stands in [recorder] of the configuration. If a recording is
    under way already, it is made longer. Exit code 1: nothing is recorded, or the file could not be written.

    \b
    Examples:
      robot-gateway snapshot
      robot-gateway snapshot --wait
    """  # noqa: D301 - the \b keeps the lines apart
    patience_s = LONGEST_S + ANSWER_S if wait else ANSWER_S
    answer = ask(find_socket(control, os.environ), Snapshot(wait=wait), patience_s)
    if not answer.ok:
        fail(answer.message)
    taken = msgspec.json.decode(answer.result, type=Taken)
    if taken.path is None:
        tell("recording:", "green", f"the file will be in {taken.directory}")
    else:
        typer.echo(taken.path)
