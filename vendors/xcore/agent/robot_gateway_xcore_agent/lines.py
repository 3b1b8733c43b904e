"""The lines of `xcore-objects/1`: one JSON object each, ended by LF, at most 65,536 bytes with it. No sockets here."""

from __future__ import annotations

import datetime as dt
import json
import math
from typing import Any, Dict, List, NamedTuple, Optional, Tuple

AGENT_VERSION = "0.1.0"
SCHEMA = "xcore-objects/1"
MAX_LINE = 65_536
"""Bytes of the longest line, its LF counted."""
MAX_DEPTH = 8
"""Levels of nesting that a value of the SDK may have; none that we know has more than four."""
UNITS = {
    "length": "m",
    "angle": "rad",
    "speed": "mm/s",
    "zone": "mm",
    "rotSpeed": "rad/s",
    "torque": "Nm",
    "mass": "kg",
    "time": "s",
}

Members = Dict[str, Any]


class TooLongError(ValueError):
    """A message does not fit into one line."""


def dumps(value: object) -> bytes:
    """Write one value as compact JSON; a lone surrogate becomes a question mark.

    Raises:
        ValueError: It holds NaN, an infinity or itself.
        TypeError: It holds something that JSON cannot say.
    """
    text = json.dumps(value, ensure_ascii=False, allow_nan=False, separators=(",", ":"))
    return text.encode("utf-8", "replace")


def line(message: Members, rest: bytes = b"") -> bytes:
    """Write one message with its LF.

    Args:
        message: Its members; at least one.
        rest: Further members that are JSON already, without braces.

    Raises:
        TooLongError: It is longer than a line may be.
        ValueError: It cannot be said in JSON.
        TypeError: The same.
    """
    data = dumps(message)
    data = (data[:-1] + b"," + rest + b"}\n") if rest else data + b"\n"
    if len(data) > MAX_LINE:
        raise TooLongError(f"{len(data)} bytes; a line has {MAX_LINE} at most")
    return data


def number(value: object) -> Optional[float]:
    """Give a finite number as it is, anything else as null."""
    if isinstance(value, bool):
        return None
    if isinstance(value, int):
        return value
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    try:
        converted = float(value)  # type: ignore[arg-type]  # numpy's scalars
    except (TypeError, ValueError, OverflowError):
        return None
    return converted if not isinstance(value, (str, bytes)) and math.isfinite(converted) else None


def numbers(value: object) -> Optional[List[Optional[float]]]:
    """Give a sequence of numbers as a list, null where an element is none; null if it is no sequence."""
    if isinstance(value, (str, bytes, dict)):
        return None
    try:
        return [number(element) for element in value]  # type: ignore[attr-defined]
    except TypeError:
        return None


def plain(value: object, depth: int = MAX_DEPTH) -> Any:
    """Turn a value that an event may hold into JSON: enumerations become names, durations seconds, the unknown null."""
    if value is None or isinstance(value, (bool, str)):
        return value
    if isinstance(value, (int, float)):
        return number(value)
    if isinstance(value, dt.timedelta):
        return value.total_seconds()
    if depth <= 0:
        return None
    if isinstance(value, dict):
        return {str(key): plain(member, depth - 1) for key, member in value.items()}
    if isinstance(value, (list, tuple, set, frozenset)):
        return [plain(element, depth - 1) for element in value]
    name = getattr(value, "name", None)
    if isinstance(name, str):
        return name
    return _error_code(value)


def _error_code(value: object) -> object:
    """An error code of the SDK has a number and a text, as attributes or as methods: which of the two is not known."""
    found = {}
    for key, attribute in (("ec", "value"), ("message", "message")):
        member = getattr(value, attribute, None)
        member = member() if callable(member) else member
        if isinstance(member, (int, str)):
            found[key] = member
    return found or number(value)


class Lines(NamedTuple):
    """What some bytes held."""

    objects: Tuple[Members, ...]
    n_rejected: int
    """Lines that were too long, not JSON or not an object."""


class LineReader:
    """Cuts a stream of bytes into JSON objects; what is too long is skipped to its LF and counted."""

    def __init__(self, max_line: int = MAX_LINE) -> None:
        self._max_line = max_line
        self._buffer = b""
        self._skipping = False

    def feed(self, data: bytes) -> Lines:
        """Take bytes, give the objects that are complete. Empty lines are ignored, a CR before the LF is tolerated."""
        *complete, self._buffer = (self._buffer + data).split(b"\n")
        objects: List[Members] = []
        n_rejected = 0
        for raw in complete:
            if self._skipping:
                self._skipping = False
                continue
            found = None if len(raw) >= self._max_line else parse(raw)
            if found is not None:
                objects.append(found)
            elif raw.strip():
                n_rejected += 1
        if len(self._buffer) >= self._max_line:
            n_rejected += not self._skipping
            self._skipping = True
        if self._skipping:
            self._buffer = b""
        return Lines(tuple(objects), n_rejected)


def parse(raw: bytes) -> Optional[Members]:
    """Read one line; None if it is not a JSON object in UTF-8 without NaN and infinities."""
    try:
        found = json.loads(raw.decode("utf-8"), parse_constant=_refuse)
    except (ValueError, RecursionError):
        return None
    return found if isinstance(found, dict) else None


def _refuse(constant: str) -> None:
    raise ValueError(constant)
