"""`robot-gateway tail`: live samples and events, for people and for programs."""

from __future__ import annotations

import csv
import sys
from collections.abc import Callable, Sequence
from enum import StrEnum
from functools import partial
from typing import Annotated, TypeVar

import msgspec
import typer

from gateway.api.messages import MAX_RATE_HZ, EventMessage, Missed, Mode
from gateway.api.model import Quality, Sample
from gateway.cli.common import DEFAULT_URL, USAGE, Url, call, fail, tell
from gateway.cli.view import event_line, flat, sample_lines, units_of
from gateway.client import Client, Pushed, connect

_DEFAULT_TOPICS = ["*/joints", "*/events"]
_DEFAULT_RATE_HZ = 5.0
_Item = TypeVar("_Item")
_SILENT = {Quality.STALE, Quality.DISCONNECTED}


class Format(StrEnum):
    """How samples are printed."""

    TABLE = "table"
    JSON = "json"
    CSV = "csv"


Topics = Annotated[
    list[str] | None, typer.Argument(metavar="[TOPIC]...", help="Topic globs; default: '*/joints' '*/events'.")
]
Rate = Annotated[float, typer.Option(metavar="HZ", help="At most so many samples a second of each topic.")]
All = Annotated[bool, typer.Option("--all", help="Every sample, whatever the rate.")]
Fields = Annotated[
    str | None, typer.Option(metavar="F,F…", help="Only these fields of the data, such as position,current.")
]
FormatOption = Annotated[Format, typer.Option("--format", "-f", help="table: for people; json, csv: a line a sample.")]
Count = Annotated[int | None, typer.Option("--count", "-n", min=1, help="End after so many samples or events.")]
Since = Annotated[
    list[str] | None,
    typer.Option(
        metavar="BOOT:SEQ", help="Events after this one first, as far as they are kept; once for each ring of events."
    ),
]


def tail(
    topics: Topics = None,
    *,
    rate: Rate = _DEFAULT_RATE_HZ,
    every: All = False,
    fields: Fields = None,
    format_: FormatOption = Format.TABLE,
    count: Count = None,
    since: Since = None,
    url: Url = DEFAULT_URL,
) -> None:
    """Follow live samples and events until Ctrl-C.

    Only what a robot can tell is shown, with its unit. What the gateway had to leave out is said on stderr.

    \b
    Examples:
      robot-gateway tail
      robot-gateway tail r1/tcp r1/status --rate 2
      robot-gateway tail 'r1/*' --all --format json > r1.ndjson
      robot-gateway tail r1/joints --fields position --format csv > r1.csv
    """  # noqa: D301 - the \b keeps the lines apart
    wanted = topics or _DEFAULT_TOPICS
    groups = {topic.rpartition("/")[2] for topic in wanted}
    if format_ is Format.CSV and (len(groups) > 1 or "*" in groups or groups & {"events", "commands"}):
        fail("csv has one kind of row: name topics of one group that is not events, such as '*/joints'", USAGE)
    if not every and not 0 < rate <= MAX_RATE_HZ:
        fail(f"--rate {rate:g}: a rate is above 0 and at most {MAX_RATE_HZ:g}; --all gives every sample", USAGE)
    chosen = None if fields is None else [field.strip() for field in fields.split(",")]
    follow = partial(_follow, url, wanted, Printer(format_, count), fields=chosen, since=since)
    call(partial(follow, rate_hz=None if every else rate, mode="all" if every else "latest"))


async def _follow(
    url: str,
    topics: list[str],
    printer: Printer,
    *,
    rate_hz: float | None,
    mode: Mode,
    fields: list[str] | None,
    since: list[str] | None,
) -> None:
    async with connect(url) as client:
        names = await client.subscribe(topics, rate_hz=rate_hz, mode=mode, fields=fields, since=since)
        await printer.learn_units(client, names)
        async for message in client.pushed():
            if not printer.take(message):
                return


class Printer:
    """Prints what comes.

    Args:
        format_: How.
        count: After so many samples and events it is done; None: never.
    """

    def __init__(self, format_: Format, count: int | None) -> None:
        self._left = count
        self._units: dict[str, dict[str, str]] = {}
        self._columns: list[str] | None = None
        self._csv = csv.writer(sys.stdout, lineterminator="\n")
        self._print_sample: Callable[[Sample], None] = {
            Format.TABLE: self._table,
            Format.JSON: _json,
            Format.CSV: self._row,
        }[format_]
        self._print_event = _json if format_ is Format.JSON else lambda event: _line(event_line(event))

    async def learn_units(self, client: Client, topics: list[str]) -> None:
        """Ask the gateway for the units of each topic's fields."""
        for topic in topics:
            if not topic.endswith(("/events", "/commands")):
                self._units[topic] = units_of((await client.describe(topic)).schema)

    def take(self, message: Pushed) -> bool:
        """Print a message; whether to go on."""
        if isinstance(message, Missed):
            n_samples = sum(message.samples.values())
            events = "an unknown number of" if message.events is None else message.events
            tell("missed:", "yellow", f"{n_samples} samples, {events} events")
            return True
        if isinstance(message, EventMessage):
            return self._each(message.events, self._print_event)
        return self._each(message.samples, self._print_sample)

    def _each(self, items: Sequence[_Item], show: Callable[[_Item], None]) -> bool:
        for item in items:
            if self._left == 0:
                return False
            show(item)
            if self._left is not None:
                self._left -= 1
        sys.stdout.flush()
        return self._left != 0

    def _table(self, sample: Sample) -> None:
        for line in sample_lines(sample, self._units.get(sample.topic, {})):
            _line(line)

    def _row(self, sample: Sample) -> None:
        """One row; the columns are those of the first sample that carries values."""
        values = flat(sample.data)
        if self._columns is None:
            if sample.q in _SILENT:
                return
            self._columns = list(values)
            self._csv.writerow(["topic", "t", "seq", "q", *self._columns])
        self._csv.writerow([sample.topic, sample.t, sample.seq, sample.q, *map(values.get, self._columns)])


def _json(item: object) -> None:
    _line(msgspec.json.encode(item).decode())


def _line(text: str) -> None:
    sys.stdout.write(f"{text}\n")
