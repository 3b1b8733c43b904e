"""`robot-gateway vendors`: lists the plugins that are found, what they speak, and what is wrong with broken ones."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import msgspec
import typer
from rich.console import Console
from rich.table import Table
from rich.text import Text

from gateway.cli.check import fail
from gateway.core.registry import Registry
from gateway.errors import ConfigError, VendorError

if TYPE_CHECKING:
    from gateway.api.vendor import Protocol

_PIPED_WIDTH = 10_000  # a line stays a line, however long


class ProtocolRow(msgspec.Struct, frozen=True):
    """One protocol; the rates are null where the controller pushes."""

    name: str
    title: str
    port: int | None
    reads: str
    rate_hz: float | None
    max_rate_hz: float | None


class VendorRow(msgspec.Struct, frozen=True):
    """One plugin; a broken one has an error and no protocols. The first protocol is the default."""

    name: str
    source: str
    folder: str | None = None
    title: str | None = None
    protocols: tuple[ProtocolRow, ...] = ()
    error: str | None = None


def vendors(
    *,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print JSON, one array with an object for each vendor.")
    ] = False,
    vendor_dir: Annotated[
        list[Path] | None,
        typer.Option("--vendor-dir", help="A folder of further plugins; may be given several times.", metavar="DIR"),
    ] = None,
) -> None:
    """List the vendors that can be configured, their protocols, and where each was found.

    The first protocol of a vendor is the one a robot gets without a `protocol` key. A broken vendor is listed with the
    reason. Exit code 78: a folder may not be used, because it is missing or others may write to it.

    \b
    Examples:
      robot-gateway vendors
      robot-gateway vendors --vendor-dir /etc/robot-gateway/vendors
      robot-gateway vendors --json
    """  # noqa: D301  \b tells click to leave the lines as they are
    try:
        registry = Registry(vendor_dir or ())
    except ConfigError as error:
        fail(error)
    rows = [_row(registry, name) for name in registry.names()]
    if as_json:
        typer.echo(msgspec.json.format(msgspec.json.encode(rows)).decode())
        return
    console = Console(highlight=False, width=None if sys.stdout.isatty() else _PIPED_WIDTH)
    console.print(_table([row for row in rows if row.error is None]))
    for row in rows:
        if row.error is not None:
            text = Text.assemble((f"{row.name}: broken: {row.error}", "red"), f" ({row.source})")
            console.print(text, soft_wrap=True)


def _row(registry: Registry, name: str) -> VendorRow:
    source = registry.source(name)
    try:
        vendor, folder = registry.vendor(name), str(registry.folder(name))
    except VendorError as error:
        return VendorRow(name, source, error=" ".join(error.reason.split()))
    return VendorRow(name, source, folder, vendor.title, tuple(map(_protocol, vendor.protocols)))


def _protocol(protocol: Protocol) -> ProtocolRow:
    reads = "pushed" if protocol.rate_hz is None else "polled"
    return ProtocolRow(protocol.name, protocol.title, protocol.port, reads, protocol.rate_hz, protocol.max_rate_hz)


def _table(rows: list[VendorRow]) -> Table:
    table = Table(box=None, pad_edge=False, header_style="bold")
    for column in ("VENDOR", "TITLE", "PROTOCOL", "PORT", "READ"):
        table.add_column(column, no_wrap=True, justify="right" if column == "PORT" else "left")
    table.add_column("FOUND", overflow="fold")
    for row in rows:
        first = (row.name, row.title, row.source)
        for protocol in row.protocols:
            name, title, source = map(Text, map(str, first))
            table.add_row(name, title, Text(protocol.name), _port(protocol), _reads(protocol), source)
            first = ("", "", "")
    return table


def _port(protocol: ProtocolRow) -> str:
    return "as set" if protocol.port is None else str(protocol.port)


def _reads(protocol: ProtocolRow) -> str:
    if protocol.rate_hz is None:
        return "pushed"
    most = "" if protocol.max_rate_hz is None else f", at most {protocol.max_rate_hz:g}"
    return f"polled {protocol.rate_hz:g} Hz{most}"
