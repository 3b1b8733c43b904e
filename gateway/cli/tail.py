"""`robot-gateway tail`: live samples and events, for people and for programs."""

from __future__ import annotations

import contextlib
import csv
import sys
from collections.abc import Callable
from enum import StrEnum
from functools import partial
from typing import Annotated

import msgspec
import typer

from gateway.api.messages import MAX_RATE_HZ, Missed, Mode
from gateway.api.model import Event, Quality, Sample
from gateway.cli.common import DEFAULT_URL, USAGE, Ca, TokenFile, Url, call, fail, tell, way
from gateway.cli.view import event_line, flat, sample_lines, units_of
from gateway.client import Client, ClientError, Connected, Disconnected, Follower, Item, Refused, Way, follow

_DEFAULT_TOPICS = ["*/joints", "*/events"]
_DEFAULT_RATE_HZ = 5.0
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
    token_file: TokenFile = None,
    ca: Ca = None,
) -> None:
    """Follow live samples and events until Ctrl-C, through every cut: events go on where they stopped.

    Only what a robot can tell is shown, with its unit. What the gateway had to leave out, and when it was gone, is said
    on stderr.

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
    gateway = way(url, token_file, ca)
    follow = partial(_follow, gateway, wanted, Printer(format_, count), fields=chosen, since=since)
    call(partial(follow, rate_hz=None if every else rate, mode="all" if every else "latest"))


async def _follow(
    gateway: Way,
    topics: list[str],
    printer: Printer,
    *,
    rate_hz: float | None,
    mode: Mode,
    fields: list[str] | None,
    since: list[str] | None,
) -> None:
    async with follow(gateway, patient=False, typed=False) as follower:
        await follower.subscribe(topics, rate_hz=rate_hz, mode=mode, fields=fields, since=since)
        async for item in follower:
            if isinstance(item, Connected):
                await printer.begin(follower)
            elif not printer.take(item):
                return
            if not follower.n_ready:
                sys.stdout.flush()


class Printer:
    """Prints what comes.

    Args:
        format_: How.
        count: After so many samples and events it is done; None: never.
    """

    def __init__(self, format_: Format, count: int | None) -> None:
        self._left = count
        self._lost = False
        self._units: dict[str, dict[str, str]] = {}
        self._columns: list[str] | None = None
        self._csv = csv.writer(sys.stdout, lineterminator="\n")
        self._print_sample: Callable[[Sample], None] = {
            Format.TABLE: self._table,
            Format.JSON: _json,
            Format.CSV: self._row,
        }[format_]
        self._print_event: Callable[[Event], None] = _json if format_ is Format.JSON else _event

    async def begin(self, follower: Follower) -> None:
        """Learn the units of each topic's fields from the gateway of a new connection."""
        if self._lost:
            self._lost = False
            tell("connected:", "green", "again")
        if follower.client is not None:
            with contextlib.suppress(ClientError):  # gone again, which the next item says
                await self._learn_units(follower.client, follower.topics)

    async def _learn_units(self, client: Client, topics: list[str]) -> None:
        for topic in topics:
            if not topic.endswith(("/events", "/commands")):
                self._units[topic] = units_of((await client.describe(topic)).schema)

    def take(self, item: Item) -> bool:
        """Print what has come; whether to go on."""
        match item:
            case Sample() | Event():
                self._count(item)
            case Missed():
                n_samples = sum(item.samples.values())
                events = "an unknown number of" if item.events is None else item.events
                tell("missed:", "yellow", f"{n_samples} samples, {events} events")
            case Refused():
                tell("refused:", "yellow", f"{' '.join(item.topics)}: {item.reason}; asked again when reconnected")
            case Disconnected() if not self._lost:
                self._lost = True
                tell("disconnected:", "red", f"{item.reason} - trying again")
        return self._left != 0

    def _count(self, item: Sample | Event) -> None:
        if isinstance(item, Event):
            self._print_event(item)
        else:
            self._print_sample(item)
        if self._left is not None:
            self._left -= 1

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


def _event(event: Event) -> None:
    """An event with its name, which --since takes."""
    _line(f"{event_line(event)}  [{event.name}]")


def _json(item: object) -> None:
    _line(msgspec.json.encode(item).decode())


def _line(text: str) -> None:
    sys.stdout.write(f"{text}\n")
