"""`robot-gateway vendor-check`: runs the conformance suite over one plugin, for its author."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import anyio
import typer
from rich.console import Console
from rich.text import Text

from gateway import logs
from gateway.cli.common import fail
from gateway.core.registry import Registry
from gateway.errors import ConfigError, UnknownVendor, VendorError
from gateway.testing.conformance import CHECKS, Outcome, run, subjects
from gateway.testing.subject import Subject

EX_CONFIG = 78
USAGE = 2
FAILURE = 1

_COLOURS = {"passed": "green", "does not apply": "blue", "exempt": "yellow", "failed": "red"}
_COUNTED = {"does not apply": "did not apply"}
_WIDTH = max(len(check.name) for check in CHECKS)
_LINE = 78


def vendor_check(
    name: Annotated[str, typer.Argument(help="Name of the plugin, which is its folder's.", metavar="NAME")],
    *,
    vendor_dir: Annotated[
        list[Path] | None,
        typer.Option("--vendor-dir", help="A folder of further plugins; may be given several times.", metavar="DIR"),
    ] = None,
) -> None:
    """Check a vendor's plugin: tables, vectors, framing, damage, polling, units, speed and its virtual controller.

    Each check says what is wrong and what to do, or why it does not apply to a protocol of this kind. A check is left
    out only by the plugin itself, with the reason, in Vendor(exempt={"check": "reason"}).

    Exit codes: 0 no check failed; 1 a check failed, or the plugin cannot be loaded; 2 no such plugin; 78 a folder
    of plugins may not be used.

    The folder that `robot-gateway new-vendor` writes says line by line what to fill in.

    Example: robot-gateway vendor-check rainbow

    Example: robot-gateway vendor-check kilo --vendor-dir ./my-vendors
    """
    try:
        found = subjects(Registry(vendor_dir or ()), name)
    except ConfigError as error:
        fail(str(error), EX_CONFIG)
    except UnknownVendor as error:
        fail(str(error), USAGE)
    except VendorError as error:
        fail(str(error), FAILURE)
    logs.configure("error")  # the end-to-end check runs a gateway, whose log is not the question here
    outcomes = anyio.run(_report, found)
    counts = {result: sum(outcome.result == result for outcome in outcomes) for result in _COLOURS}
    typer.echo(", ".join(f"{count} {_COUNTED.get(result, result)}" for result, count in counts.items()))
    if counts["failed"]:
        raise typer.Exit(FAILURE)


async def _report(found: Sequence[Subject]) -> list[Outcome]:
    """Run the suite and print each result as it comes."""
    console = Console(highlight=False, soft_wrap=True)
    outcomes: list[Outcome] = []
    told: dict[str, str] = {}  # what is wrong -> the check that said it first
    async for outcome in run(found):
        if not outcomes or outcomes[-1].subject is not outcome.subject:
            console.print(Text(f"{outcome.subject.vendor.title}, protocol {outcome.subject.protocol.name}", "bold"))
        console.print(Text.assemble(f"  {outcome.check.name:{_WIDTH}}  ", (outcome.result, _COLOURS[outcome.result])))
        first = told.setdefault(outcome.message, outcome.check.name) if outcome.result == "failed" else ""
        message = outcome.message if first in {"", outcome.check.name} else f"the same as {first}, above"
        for paragraph in message.splitlines():
            for line in textwrap.wrap(paragraph, _LINE - 6, subsequent_indent="  ", break_on_hyphens=False):
                console.print(Text(f"      {line}"))
        outcomes.append(outcome)
    return outcomes
