"""`robot-gateway probe`: what does this controller speak, and what belongs into the configuration?"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Annotated

import anyio
import msgspec
import typer

from gateway.api.vendor import Vendor
from gateway.app import connector
from gateway.cli.common import FAILURE, call, fail, tell
from gateway.config.keys import host_fault
from gateway.config.printing import toml_value
from gateway.core.probe import Finding, Question, Verdict, probe
from gateway.core.registry import Registry
from gateway.errors import ConfigError, UnknownVendor, VendorError

_LABELS = {
    Verdict.SPEAKS: ("found:", "green"),
    Verdict.SILENT: ("silent:", "yellow"),
    Verdict.REFUSED: ("closed:", "yellow"),
    Verdict.UNREACHABLE: ("no way:", "red"),
    Verdict.HAZARD: ("left out:", "yellow"),
}


def probe_command(
    host: Annotated[str, typer.Argument(metavar="HOST", help="Address or name of the controller.")],
    *,
    vendor: Annotated[
        list[str] | None, typer.Option(metavar="VENDOR", help="Ask for this vendor only; may be repeated.")
    ] = None,
    allow_legacy: Annotated[
        bool,
        typer.Option("--allow-legacy", help="Ask also where connecting and closing again may stop a robot: see above."),
    ] = False,
    timeout: Annotated[float, typer.Option(min=0.1, max=60, help="Seconds that one answer may take.")] = 3.0,
    vendor_dir: Annotated[
        list[Path] | None, typer.Option("--vendor-dir", metavar="DIR", help="A folder of further vendors.")
    ] = None,
) -> None:
    """Ask a controller what it speaks, and print what belongs into the configuration.

    One protocol after the other is asked, with one connection at a time and only with what a session would send.
    On some ports even that may do harm: a robot may have been set up to stop when such a connection is closed. They
    are left out unless --allow-legacy is given; do so only while the robot stands still.

    What is found goes to stdout as TOML, everything else to stderr. Exit code 1: nothing was found.

    \b
    Examples:
      robot-gateway probe 192.168.58.2
      robot-gateway probe 10.0.2.7 --vendor rainbow >> gateway.toml
    """  # noqa: D301  \b tells click to leave the lines as they are
    if fault := host_fault(host):
        raise typer.BadParameter(fault, param_hint="HOST")
    try:
        registry = Registry(vendor_dir or [])
    except ConfigError as error:
        fail(str(error), 78)
    vendors = list(_vendors(registry, vendor or registry.names()))
    found: list[Finding] = []
    call(partial(_probe, vendors, host, timeout, allow_legacy, found))
    if not found:
        tell("nothing:", "red", f"no protocol was found on {host}")
        raise typer.Exit(FAILURE)


def stanza(host: str, question: Question, number: int = 1) -> str:
    """What belongs into the configuration for a controller that answers a question."""
    lines = [
        "[[robots]]",
        f'name = "r{number}"',
        f"vendor = {toml_value(question.vendor.name)}",
        f"protocol = {toml_value(question.protocol.name)}",
        f"host = {toml_value(host)}",
    ]
    usual = msgspec.to_builtins(question.protocol.options())
    own = {key: value for key, value in msgspec.to_builtins(question.options).items() if value != usual[key]}
    if own:
        lines.append(f"[robots.{question.protocol.name}]")
        lines += [f"{key} = {toml_value(value)}" for key, value in own.items()]
    return "\n".join(lines)


async def _probe(vendors: list[Vendor], host: str, timeout_s: float, allowed: bool, found: list[Finding]) -> None:  # noqa: FBT001
    findings = probe(
        vendors, host, connector, timeout_s=timeout_s, allow_hazards=allowed, about_to_ask=partial(_warn, host)
    )
    async for finding in findings:
        label, colour = _LABELS[finding.verdict]
        tell(label, colour, f"{_named(host, finding.question)} {finding.verdict.value}: {finding.reason}")
        if finding.verdict is Verdict.HAZARD:
            tell("", "", "         --allow-legacy asks it all the same: only while the robot stands still")
        elif finding.verdict is Verdict.SPEAKS:
            found.append(finding)
            typer.echo(stanza(host, finding.question, len(found)) + "\n")
        await anyio.lowlevel.checkpoint()


def _warn(host: str, question: Question) -> None:
    """Say why a connection may do harm, before it is made."""
    if question.protocol.hazard:
        tell("danger:", "red", f"{_named(host, question)} is asked now: {question.protocol.hazard}")


def _named(host: str, question: Question) -> str:
    where = f"{host} port {question.port}{'/udp' if question.transport == 'udp' else ''}"
    return f"{where} ({question.vendor.name} {question.protocol.name})"


def _vendors(registry: Registry, names: list[str]) -> Iterator[Vendor]:
    for name in names:
        try:
            yield registry.vendor(name)
        except UnknownVendor as error:
            raise typer.BadParameter(error.reason, param_hint=f"--vendor {name}") from None
        except VendorError as error:
            tell("warning:", "yellow", str(error))
