"""How robots and samples look in a terminal: plain words, units, and a dash for what is not known."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from datetime import UTC, datetime
from typing import cast

from rich import box
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from gateway.api.messages import ExportInfo, RecorderInfo, RobotInfo
from gateway.api.model import Event, EventKind, LinkState, Sample

UNKNOWN = "–"  # noqa: RUF001 - a dash, as in print
INSECURE = "whoever reaches the address of this gateway may read it: it asks for no token"
_GOOD = "green"
_COLOURS = {
    "ONLINE": _GOOD,
    "NORMAL": _GOOD,
    "ENABLED": _GOOD,
    "CONNECTING": "yellow",
    "HANDSHAKING": "yellow",
    "STALE": "yellow",
    "DISCONNECTED": "red",
    "INCOMPATIBLE": "red",
    "REFUSED": "red",
    "FAULTED": "red",
    "PROTECTIVE_STOP": "yellow",
    "EMERGENCY_STOP": "bold red",
    "FAULT": "red",
}
_SECONDS = ((86_400, "d"), (3_600, "h"), (60, "min"))
_HEADINGS = ("robot", "speaks", "link", "for", "Hz", "power", "motion", "program", "safety")
_LEAST_IMPORTANT = ("speaks", "program", "Hz", "motion", "power", "for")
_GAP = 2
_LARGE = 1e4
_HUNDRED = 100.0  # numbers from here on are shown with fewer digits
_COLUMNS = 80  # a line of an array has fewer digits where it would be longer
_OF_COMMANDS = {EventKind.COMMAND_ISSUED, EventKind.COMMAND_EXECUTED, EventKind.COMMAND_MISSED}
_LIVE = {"GOOD", "SUBSTITUTED", "UNCERTAIN", "BAD"}


def duration(seconds: float) -> str:
    """A duration in the largest unit that fits: `42 s`, `3 min`, `2 d`."""
    for size, unit in _SECONDS:
        if seconds >= size:
            return f"{seconds // size:.0f} {unit}"
    return f"{max(0.0, seconds) // 1:.0f} s"


def clock_time(t: int) -> str:
    """A time of day, local, of µs UTC since 1970."""
    return datetime.fromtimestamp(t / 1e6, tz=UTC).astimezone().strftime("%H:%M:%S.%f")[:-3]


def coloured(word: str | None) -> Text:
    """A state with its colour; a dash where it is not known."""
    return Text(UNKNOWN, style="dim") if word is None else Text(word, style=_COLOURS.get(word, ""))


def robots_table(
    robots: Iterable[RobotInfo],
    latest: Mapping[str, Sample],
    now_us: int,
    width: int,
) -> RenderableType:
    """The cell at a glance: a row a robot, and below it a line for each link that is not online.

    Args:
        robots: As the gateway tells them.
        latest: The status and safety samples by topic.
        now_us: Now, µs UTC.
        width: Of the terminal; where it is too narrow, the least important columns are left out.
    """
    shown = list(robots)
    if not shown:
        return Text("no robots are configured")
    rows = _rows(shown, latest, now_us, width)
    kept = set(_HEADINGS)
    for heading in _LEAST_IMPORTANT:
        if _needed(rows, kept) <= width:
            break
        kept.remove(heading)
    table = Table(box=box.SIMPLE_HEAD, show_edge=False, pad_edge=False, padding=(0, 1, 0, 0))
    for heading in _HEADINGS:
        if heading in kept:
            table.add_column(heading, no_wrap=True, justify="right" if heading in {"for", "Hz"} else "left")
    for row in rows:
        table.add_row(*(cell for heading, cell in zip(_HEADINGS, row, strict=True) if heading in kept))
    below: list[RenderableType] = []
    if len(kept) < len(_HEADINGS):
        left_out = ", ".join(heading for heading in _HEADINGS if heading not in kept)
        below.append(Text(f"too narrow for: {left_out}", style="dim"))
    off = [robot for robot in shown if robot.link.state is not LinkState.ONLINE]
    below += [Text.assemble((f"{robot.name}: ", "bold"), link_reason(robot, now_us)) for robot in off]
    on = [robot for robot in shown if robot.link.state is LinkState.ONLINE]
    below += [Text.assemble((f"{robot.name}: ", "bold"), note) for robot in on for note in robot.link.notes]
    return Group(table, *below)


def export_lines(exports: Iterable[ExportInfo], now_us: int) -> Iterator[Text]:
    """Where the cell is sent besides, a line each, and below it what the operator should know."""
    for one in exports:
        state = ("connected", _GOOD) if one.connected else ("not connected", "red")
        words = f" for {duration((now_us - one.since) / 1e6)}, {one.waiting_events} events waiting"
        if one.oldest is not None:
            words += f" (the oldest for {duration(one.oldest)})"
        if one.dropped_events:
            words += f", {one.dropped_events} dropped"
        yield Text.assemble((f"{one.name}: ", "bold"), f"{one.target}, ", state, words)
        for told in (*([one.reason] if one.reason else []), *one.notes):
            yield Text.assemble((f"{one.name}: ", "bold"), told)


def recorder_line(recorder: RecorderInfo | None) -> Text | None:
    """What the recorder does that one should know; None: nothing."""
    if recorder is None:
        return None
    if recorder.error is not None:
        return Text.assemble(("recording failed: ", "bold red"), recorder.error)
    if recorder.recording is not None:
        return Text.assemble(("recording: ", "bold"), recorder.recording)
    return None


def _rows(shown: Sequence[RobotInfo], latest: Mapping[str, Sample], now_us: int, width: int) -> list[tuple[Text, ...]]:
    """A row for each robot; where they are too wide, the longest of what they speak is cut to the vendor first."""
    speaks = [spoken(robot) for robot in shown]
    while True:
        rows = [_row(robot, text, latest, now_us) for robot, text in zip(shown, speaks, strict=True)]
        whole = [len(text) for robot, text in zip(shown, speaks, strict=True) if text != robot.vendor]
        if not whole or _needed(rows, _HEADINGS) <= width:
            return rows
        speaks = [robot.vendor if len(text) >= max(whole) else text for robot, text in zip(shown, speaks, strict=True)]


def _needed(rows: Iterable[Sequence[Text]], kept: Collection[str]) -> int:
    """How wide a table of some of the columns is."""
    columns = zip(_HEADINGS, *rows, strict=True)
    return sum(max(map(len, column)) + _GAP for column in columns if column[0] in kept) - _GAP


def _row(robot: RobotInfo, speaks: str, latest: Mapping[str, Sample], now_us: int) -> tuple[Text, ...]:
    """The cells of one robot, in the order of the headings."""
    link = robot.link
    status = _data(latest.get(f"{robot.name}/status"))
    return (
        Text(robot.name),
        Text(speaks),
        coloured(link.state.value),
        Text(duration((now_us - link.since) / 1e6)),
        Text(f"{link.reached_hz:.0f}" if link.reached_hz is not None else UNKNOWN),
        coloured(_word(status, "power")),
        coloured(_word(status, "motion")),
        coloured(_word(status, "program", "state")),
        coloured(_word(_data(latest.get(f"{robot.name}/safety")), "state")),
    )


def spoken(robot: RobotInfo) -> str:
    """What is spoken with a robot: `fairino:cnde`; the vendor alone where its plugin could not be loaded."""
    return f"{robot.vendor}:{robot.protocol}" if robot.protocol else robot.vendor


def link_reason(robot: RobotInfo, now_us: int) -> str:
    """Why a link is not online, and what comes next."""
    link = robot.link
    parts = [link.reason or link.state.value.lower()]
    if link.last_error and link.last_error != link.reason:
        parts.append(f"before that: {link.last_error}")
    if link.attempts:
        parts.append(f"attempt {link.attempts}")
    if link.next_attempt is not None:
        parts.append(f"next one in {max(0.0, (link.next_attempt - now_us) / 1e6):.1f} s")
    parts += link.notes
    if robot.reject_counts:
        parts.append("rejected: " + ", ".join(f"{count} {reason}" for reason, count in robot.reject_counts.items()))
    return "; ".join(parts)


def sample_lines(sample: Sample, units: Mapping[str, str]) -> Iterator[str]:
    """A sample as lines of at most about 80 characters: only what is known, with its unit.

    Args:
        sample: Of any topic.
        units: Unit by dotted path.
    """
    head = f"{clock_time(sample.t)}  {sample.topic}"
    if sample.q != "GOOD":
        head += f"  {sample.q}"
    leaves = [(key, value) for key, value in _leaves(sample.data) if value is not None and value != []]
    if not leaves:
        since = f", last frame at {clock_time(sample.t_last)}" if sample.t_last else ""
        yield f"{head}  no values{since}" if sample.q not in _LIVE else f"{head}  nothing known"
        return
    if len(leaves) == 1:
        yield f"{head}  {_leaf_text(*leaves[0], units, width=0)}"
        return
    yield head
    width = max(len(key) for key, _ in leaves)
    for key, value in leaves:
        yield f"  {_leaf_text(key, value, units, width)}"


def value_lines(path: str, data: object, units: Mapping[str, str]) -> Iterator[str]:
    """Values as lines, each with its unit: only what is known.

    Args:
        path: What stands before the path of each.
        data: Plain values.
        units: Unit by dotted path below it.
    """
    known = [(key, value) for key, value in _leaves(data) if value is not None and value != []]
    width = max((len(key) for key, _ in known), default=0)
    for key, value in known:
        yield f"{path}.{_leaf_text(key, value, units, width)}"


def event_line(event: Event) -> str:
    """An event in one line."""
    if event.kind in _OF_COMMANDS:
        return f"{clock_time(event.t)}  {event.robot}  {event.kind}  {_of_command(event.after)}"
    change = "" if event.before is None and event.after is None else f"  {_short(event.before)} → {_short(event.after)}"
    return f"{clock_time(event.t)}  {event.robot}  {event.kind}{change}"


def flat(data: object) -> dict[str, object]:
    """All leaves by dotted path, arrays by index: for tables of numbers."""
    found: dict[str, object] = {}
    for key, value in _leaves(data):
        if isinstance(value, list):
            found.update({f"{key}.{index}": item for index, item in enumerate(value)})
        else:
            found[key] = value
    return found


def _leaves(data: object, path: str = "") -> Iterator[tuple[str, object]]:
    if isinstance(data, dict):
        for key, value in data.items():
            yield from _leaves(value, f"{path}.{key}" if path else key)
    elif isinstance(data, list) and any(isinstance(item, dict) for item in data):
        for index, item in enumerate(data):
            yield from _leaves(item, f"{path}.{index}")
    else:
        yield path, data


def _leaf_text(key: str, value: object, units: Mapping[str, str], width: int) -> str:
    unit = units.get(key, "1")
    if unit == "µs" and isinstance(value, int):
        return f"{key:<{width}}  {clock_time(value)}"
    behind = "" if unit == "1" else f"  {unit}"
    before = f"{key:<{width}}  "
    shown = _array(value, _COLUMNS - 2 - len(before) - len(behind)) if isinstance(value, list) else _scalar(value)
    return f"{before}{shown}{behind}"


def _array(values: Sequence[object], columns: int) -> str:
    """Several values, numbers in columns of one width, with as many digits as there is room for."""
    numbers = [abs(value) for value in values if isinstance(value, float) and abs(value) < _LARGE]
    most = 2 if max(numbers, default=0.0) >= _HUNDRED else 4
    shown = ""
    for digits in range(most, 0, -1):
        cells = [_number(value, digits) for value in values]
        width = max((digits + 3 if numbers else 0), *map(len, cells)) if cells else 0
        shown = " ".join(f"{cell:>{width}}" for cell in cells)
        if len(shown) <= columns or not numbers:
            break
    return shown


def _number(value: object, digits: int) -> str:
    """One of several numbers."""
    if isinstance(value, float):
        return f"{value:.{digits}f}" if abs(value) < _LARGE else f"{value:.2g}"
    return _scalar(value)


def _scalar(value: object) -> str:
    if value is None:
        return UNKNOWN
    if isinstance(value, bool):
        return "1" if value else "0"
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def _of_command(told: object) -> str:
    """What an event of the topic `commands` tells."""
    if not isinstance(told, dict):
        return UNKNOWN
    if "count" in told:
        count = "an unknown number of" if told["count"] is None else told["count"]
        return f"{count} messages were lost before they reached the gateway"
    if "object" in told:
        values = " ".join(f"{key}={_plain(value)}" for key, value in _leaves(told["object"]) if value not in ("", None))
        return f"{told['id']}  {told['index'] + 1} of {told['total']}  {told['type']}  {values}"
    place = "" if told.get("index") is None else f"  {told['index'] + 1}"
    reached = {True: "  reached", False: "  not reached"}.get(cast("bool", told.get("reached")), "")
    rest = "".join(f"  {told[key]}" for key in ("error", "text", "custom") if told.get(key))
    return f"{told['id']}{place}{reached}{rest}"


def _plain(value: object) -> str:
    """A value without spaces, its numbers as short as they are still exact enough to read."""
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, (list, tuple)):
        return f"[{','.join(map(_plain, value))}]"
    return str(value)


def _short(value: object) -> str:
    """A value of an event; a fault by its code and words."""
    if value is None:
        return UNKNOWN
    if isinstance(value, dict) and "code" in value:
        joint = "" if value.get("joint") is None else f" at joint {value['joint']}"
        number = "" if value.get("main") is None else f" {value['main']}"
        text = f" ({value['text']})" if value.get("text") else ""
        return f"{value['code']}{number}{joint}{text}"
    return str(value)


def _data(sample: Sample | None) -> Mapping[str, object]:
    return sample.data if sample is not None and isinstance(sample.data, dict) else {}


def _word(data: Mapping[str, object], *path: str) -> str | None:
    at: object = data
    for name in path:
        at = at.get(name) if isinstance(at, Mapping) else None
    return at if isinstance(at, str) else None


def units_of(schema: Mapping[str, object]) -> dict[str, str]:
    """Units by dotted path, out of the JSON Schema that `describe` gives."""
    definitions = schema.get("$defs", {})
    return dict(_units(schema, definitions if isinstance(definitions, dict) else {}, ""))


def _units(schema: object, definitions: Mapping[str, object], path: str) -> Iterator[tuple[str, str]]:
    if not isinstance(schema, dict):
        return
    reference = schema.get("$ref")
    if isinstance(reference, str):
        yield from _units(definitions.get(reference.rpartition("/")[2]), definitions, path)
    unit = schema.get("unit")
    if path and isinstance(unit, str):
        yield path, unit
    for name, below in (schema.get("properties") or {}).items():
        yield from _units(below, definitions, f"{path}.{name}" if path else name)
    choices: Sequence[object] = schema.get("anyOf") or []
    for choice in choices:
        yield from _units(choice, definitions, path)
