"""`robot-gateway validate VENDOR FILE`: checks a file of a vendor's own objects, row by row, without a robot.

The subcommands are the vendors that have document types; a type's own options are the fields of its struct.
"""

from __future__ import annotations

import inspect
import json
import sys
from collections.abc import Sequence
from itertools import islice
from pathlib import Path
from typing import Annotated, TypedDict, cast

import typer
from rich import box
from rich.table import Table
from rich.text import Text
from typer.core import TyperCommand, TyperGroup

from gateway.api.documents import Checked, DocumentType, Problem, Row
from gateway.cli.common import FAILURE, USAGE, fail, terminal
from gateway.cli.struct_options import VendorDirs, command, parameters, read, registry_of
from gateway.core.registry import Registry
from gateway.errors import UnknownVendor, VendorError

_GROUP_HELP = """Check a file of a vendor's own objects, such as motion commands; no robot is needed.

Each vendor is a command with options of its own: see robot-gateway validate VENDOR --help.

\b
Example:
  robot-gateway validate xcore moves.json --axes 6

Exit codes: 0 the file is good, 1 it is not, 2 wrong usage.
"""

_VENDOR_HELP = """Check a file of {vendor} objects and say all that is wrong with each.

\b
Types:
{types}

\b
Examples:
  robot-gateway validate {vendor} FILE
  robot-gateway validate {vendor} - --json < FILE
  robot-gateway validate {vendor} --schema

Exit codes: 0 the file is good, 1 it is not, 2 wrong usage.
"""

_TYPE = "document_type"
_WRONG = "what is wrong"
_MOST = 1000  # rows of a table; nobody reads more
_NARROW = 12  # a column of at most so many characters is never broken
_ALONE = "-"  # standard input


class VendorGroup(TyperGroup):
    """A group whose subcommands are the vendors with document types, each made when it is asked for."""

    def list_commands(self, ctx: object) -> list[str]:
        """Return the names of the vendors that have document types, and of those that are broken."""
        registry = registry_of(ctx)
        return [name for name in registry.names() if _documents(registry, name) != ()]

    def parse_args(self, ctx: object, args: list[str]) -> list[str]:
        """Note the type that is asked for: the options of the vendor's command depend on it."""
        context = cast("typer.Context", ctx)
        context.meta[_TYPE] = _asked(args)
        return super().parse_args(context, args)

    def get_command(self, ctx: object, cmd_name: str) -> TyperCommand | None:
        """Make the command of a vendor; that of a broken vendor says what is wrong with it."""
        registry = registry_of(ctx)
        try:
            types = registry.vendor(cmd_name).documents
        except UnknownVendor as error:
            raise typer.BadParameter(error.reason, param_hint=f"VENDOR {cmd_name}") from None
        except VendorError as error:
            return _broken(cmd_name, str(error), error.reason)
        if not types:
            others = ", ".join(name for name in registry.names() if _documents(registry, name)) or "none"
            raise typer.BadParameter(
                f"has no types of files that can be checked; vendors that have: {others}",
                param_hint=f"VENDOR {cmd_name}",
            )
        return _checker(cmd_name, types, cast("typer.Context", ctx).meta.get(_TYPE))


app = typer.Typer(
    cls=VendorGroup,
    help=_GROUP_HELP,
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)


@app.callback()
def choose(vendor_dir: VendorDirs = None) -> None:
    """Take the options of the group: it has read them to find the vendors."""


class _ProblemLine(TypedDict):
    path: str
    message: str
    found: str
    allowed: str


def _common(
    *,
    file: Annotated[
        str | None, typer.Argument(metavar="FILE", help="The file; - is standard input.", show_default=False)
    ] = None,
    type: Annotated[  # noqa: A002 - the name of the option
        str | None,
        typer.Option("--type", metavar="NAME", help="What the file holds: one of the types above; the first if none."),
    ] = None,
    wrong: Annotated[bool, typer.Option("--wrong", help="Show only the rows that are wrong.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object instead of a table.")] = False,
    schema: Annotated[bool, typer.Option("--schema", help="Print the JSON Schema of such a file instead.")] = False,
) -> None:
    """Hold the options that every document type has, for their parameters."""


def _checker(vendor: str, types: Sequence[DocumentType], asked: str | None) -> TyperCommand:
    """Make the command that checks the files of a vendor."""
    chosen = next((found for found in types if found.name == asked), types[0])
    common = list(inspect.signature(_common, eval_str=True).parameters.values())
    own = list(parameters(chosen.options))
    clash = sorted({parameter.name for parameter in own} & {parameter.name for parameter in common})
    if clash:
        reason = f"the options {', '.join(clash)} of its documents have names that are taken"
        return _broken(vendor, f"vendor {vendor}: {reason}", reason)

    def run(
        *,
        file: str | None,
        type: str | None,  # noqa: A002 - the name of the option
        wrong: bool,
        as_json: bool,
        schema: bool,
        **mine: object,
    ) -> None:
        if type not in {None, chosen.name}:
            raise typer.BadParameter(
                f'"{type}" is none of {", ".join(found.name for found in types)}', param_hint="--type"
            )
        options = read(chosen.options, mine)
        if schema:
            typer.echo(json.dumps(chosen.schema(), indent=2, ensure_ascii=False))
            return
        if file is None:
            raise typer.BadParameter("is missing", param_hint="FILE")
        checked = chosen.check(_content(file, chosen), options)
        if as_json:
            typer.echo(_as_json(vendor, chosen, file, checked, wrong=wrong))
        else:
            _print(chosen, checked, wrong=wrong)
        raise typer.Exit(0 if checked.good else FAILURE)

    width = max(len(found.name) for found in types)
    lines = "\n".join(f"  {found.name:{width}}  {found.title}" for found in types)
    return command(vendor, _VENDOR_HELP.format(vendor=vendor, types=lines), [*common, *own], run)


def _broken(vendor: str, text: str, reason: str) -> TyperCommand:
    """Make the command of a vendor that cannot be used."""

    def run() -> None:
        fail(text)

    return command(vendor, f"Cannot be used: {' '.join(reason.split())}", [], run)


def _documents(registry: Registry, name: str) -> tuple[DocumentType, ...] | None:
    """The document types of a vendor; None if it is broken."""
    try:
        return registry.vendor(name).documents
    except VendorError:
        return None


def _asked(arguments: Sequence[str]) -> str | None:
    """The type that a command line asks for."""
    for at, argument in enumerate(arguments):
        if argument == "--type":
            return next(iter(arguments[at + 1 : at + 2]), None)
        if argument.startswith("--type="):
            return argument.removeprefix("--type=")
    return None


def _content(file: str, wanted: DocumentType) -> bytes:
    """Read a file, or a byte more than it may have."""
    try:
        if file == _ALONE:
            return sys.stdin.buffer.read(wanted.largest + 1)
        with Path(file).open("rb") as opened:
            return opened.read(wanted.largest + 1)
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        fail(f"{file}: cannot be read: {reason}", USAGE)


def _print(wanted: DocumentType, checked: Checked, *, wrong: bool) -> None:
    """Print the rows as a table, then what is wrong with the document, then one line in all."""
    rows = [row for row in checked.rows if row.problems] if wrong else checked.rows
    console = terminal()
    if rows:
        console.print(_table(wanted.columns, rows[:_MOST]))
    if len(rows) > _MOST:
        hint = "" if wrong else "; --wrong shows only those that are wrong"
        console.print(Text(f"{len(rows) - _MOST} more rows are not shown{hint}; --json has all", style="dim"))
    for problem in checked.problems[:_MOST]:
        console.print(Text(_clean(str(problem)), style="red"))
    others = len(checked.problems)
    if others > _MOST:
        console.print(Text(f"{others - _MOST} more problems are not shown; --json has all", style="dim"))
    more = f", {others} other problem{'' if others == 1 else 's'}" if others else ""
    says = f"{wanted.counted(len(checked.rows))}, {checked.n_wrong} wrong{more}"
    console.print(Text(says, style="green" if checked.good else "red"))


def _table(columns: Sequence[str], rows: Sequence[Row]) -> Table:
    headings = [*columns, *([_WRONG] if any(row.problems for row in rows) else [])]
    cells = [[_clean(cell) for cell in row.cells] for row in rows]
    table = Table(box=box.SIMPLE_HEAD, show_edge=False, pad_edge=False, padding=(0, 1, 0, 0))
    for index, heading in enumerate(headings):
        shown = [row[index] for row in cells] if index < len(columns) else None
        narrow = shown is not None and max(map(len, shown)) <= _NARROW
        table.add_column(heading, no_wrap=narrow, overflow="fold")
    for row, texts in zip(rows, cells, strict=True):
        style = "red" if row.problems else ""
        found = [Text("\n".join(_clean(str(problem)) for problem in row.problems), style)]
        table.add_row(*map(Text, texts), *islice(found, len(headings) - len(columns)))
    return table


def _as_json(vendor: str, wanted: DocumentType, file: str, checked: Checked, *, wrong: bool) -> str:
    rows = [
        {**dict(zip(wanted.columns, row.cells, strict=True)), "problems": [_line(one) for one in row.problems]}
        for row in checked.rows
        if row.problems or not wrong
    ]
    report = {
        "vendor": vendor,
        "type": wanted.name,
        "file": file,
        "good": checked.good,
        "count": len(checked.rows),
        "wrong": checked.n_wrong,
        "problems": [_line(problem) for problem in checked.problems],
        "rows": rows,
    }
    return json.dumps(report, indent=2)


def _line(problem: Problem) -> _ProblemLine:
    return {
        "path": problem.path,
        "message": problem.message,
        "found": problem.found,
        "allowed": problem.allowed,
    }


def _clean(text: str) -> str:
    """A text of the file as a terminal may have it: nothing that would move the cursor or cannot be printed."""
    return "".join(letter if letter.isprintable() else f"\\u{ord(letter):04x}" for letter in text)
