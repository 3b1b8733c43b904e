"""`robot-gateway reload`: lets the running gateway read its configuration again, or says what that would change."""

from __future__ import annotations

import os
from collections.abc import Iterator
from typing import Annotated, NoReturn

import msgspec
import typer
from rich.console import Console
from rich.table import Table
from rich.text import Text

from gateway.cli.check import EX_CONFIG
from gateway.cli.common import FAILURE, tell, terminal
from gateway.cli.control import Answer, Control, ask, find_socket
from gateway.config.diff import KeyChange, Plan, RobotChange
from gateway.reloading import UNKNOWN_ROBOT, WRONG_CONFIGURATION, Reload

HELD = 3
_EXIT_CODES = {WRONG_CONFIGURATION: EX_CONFIG, UNKNOWN_ROBOT: 2}
_COLOURS = {"added": "green", "removed": "red", "changed": "yellow", "held back": "bold red", "at restart": "yellow"}
_Row = tuple[str, str, str]


def reload(
    *,
    check: Annotated[bool, typer.Option("--check", help="Only say what would change.")] = False,
    drop: Annotated[
        list[str] | None,
        typer.Option(metavar="ROBOT", help="Change this robot although its session must not be dropped."),
    ] = None,
    control: Control = None,
) -> None:
    """Let the running gateway read its configuration again; only what has changed is touched.

    A robot whose controller may stop it when the connection ends keeps its old settings until then, and is named.

    Exit codes: 0 everything was applied (with --check: could be); 3 some robots are held back; 1 nothing was applied,
    or no gateway answers; 2 wrong usage; 78 the new configuration is wrong, and nothing was applied.

    \b
    Examples:
      robot-gateway reload --check
      robot-gateway reload
      robot-gateway reload --drop r2
    """  # noqa: D301 - the \b keeps the lines apart
    answer = ask(find_socket(control, os.environ), Reload(check=check, drop=drop or []))
    if not answer.ok:
        _refuse(answer)
    plan = msgspec.json.decode(answer.result, type=Plan)
    _show(plan)
    for warning in plan.warnings:
        tell("warning:", "yellow", warning)
    if plan.held:
        tell("held back:", "yellow", f"{len(plan.held)} of the robots; the rest {_done(check=check)}")
        raise typer.Exit(HELD)
    tell("checked:" if check else "reloaded:", "green", f"everything {_done(check=check)}")


def rows(plan: Plan) -> Iterator[_Row]:
    """What changes, line by line: what happens, to what, and how."""
    for what, robots in (("added", plan.added), ("removed", plan.removed), ("changed", plan.changed)):
        for robot in robots:
            yield from _of_robot(what, robot)
    for held in plan.held:
        yield from _of_robot("held back", held)
        yield "", "", held.reason
    for number, change in enumerate(plan.doors):
        yield "" if number else "doors", change.key, _change(change)
    for number, change in enumerate(plan.exports):
        yield "" if number else "exports", change.key, _change(change)
    for number, change in enumerate(plan.recorder):
        yield "" if number else "recorder", change.key, _change(change)
    for told in plan.restart:
        name, _, why = told.partition(": ")
        yield "at restart", name, why
    yield "unchanged", f"{plan.unchanged} robot{'' if plan.unchanged == 1 else 's'}", ""


def _of_robot(what: str, robot: RobotChange) -> Iterator[_Row]:
    yield what, robot.name, robot.title
    for change in robot.keys:
        yield "", "", f"{change.key}: {_change(change)}"


def _change(change: KeyChange) -> str:
    if change.before is None and change.after is None:
        return "changed"  # a secret
    return f"{change.before or 'not set'} → {change.after or 'not set'}"


def _show(plan: Plan) -> None:
    table = Table(box=None, show_header=False, pad_edge=False, padding=(0, 2, 0, 0))
    table.add_column(no_wrap=True)
    table.add_column(no_wrap=True)
    table.add_column(overflow="fold")
    for what, name, text in rows(plan):
        table.add_row(Text(what, _COLOURS.get(what, "")), Text(name), Text(text))
    terminal().print(table)


def _refuse(answer: Answer) -> NoReturn:
    """Say in red why nothing has changed, and end."""
    tell("error:", "red", answer.message)
    console = Console(stderr=True, highlight=False, soft_wrap=True)
    for problem in answer.problems:
        if problem not in answer.message:
            console.print(Text(problem, "red"))
    raise typer.Exit(_EXIT_CODES.get(answer.code, FAILURE))


def _done(*, check: bool) -> str:
    return "can be applied" if check else "is applied"
