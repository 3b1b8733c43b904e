"""Says on which line of a TOML text each key stands; `tomllib` reads the values, but does not tell.

The scanner knows just enough of the grammar to walk over keys, strings, arrays and inline tables. It is meant for
text that `tomllib` has accepted; in any other it stops where it no longer understands.
"""

from __future__ import annotations

import contextlib
import re
import tomllib
from bisect import bisect_left
from dataclasses import dataclass, field

Path = tuple[str | int, ...]

_PART = r"""(?:[A-Za-z0-9_-]+|"(?:[^"\\\n]|\\.)*"|'[^'\n]*')"""
KEY = re.compile(rf"{_PART}(?:[ \t]*\.[ \t]*{_PART})*")
_BLANK = re.compile(r"(?:\s|#[^\n]*)*")
_EQUALS = re.compile(r"[ \t]*=[ \t]*")
_HEADER = re.compile(rf"(\[\[?)[ \t]*({KEY.pattern})[ \t]*\]\]?")
_SCALAR = re.compile(
    r'''"""(?:[^\\]|\\.)*?""""{0,2}'''  # up to two quotes more belong to the text
    r"""|'{3}.*?'{3}'{0,2}"""
    r"""|"(?:[^"\\\n]|\\.)*"|'[^'\n]*'"""
    r"""|[^\s,\[\]{}#"'][^,\]}#\n]*""",
    re.DOTALL,
)


class _Lost(Exception):  # noqa: N818  never leaves this module
    """The text is no TOML from here on."""


@dataclass(slots=True)
class Lines:
    """Where every key of a text stands; the first line is 1.

    Attributes:
        found: Line of each path; an element of an array has its index in the path.
        twice: Paths that are set a second time, with the line of that.
    """

    found: dict[Path, int] = field(default_factory=dict)
    twice: list[tuple[Path, int]] = field(default_factory=list)

    def of(self, path: Path) -> int | None:
        """The line of a path, or of the nearest thing around it; None for the file as a whole."""
        while path and path not in self.found:
            path = path[:-1]
        return self.found.get(path)


def lines(text: str) -> Lines:
    """Find the line of every key, table and array element."""
    scanner = _Scanner(text)
    with contextlib.suppress(_Lost, RecursionError):
        scanner.document()
    return scanner.lines


class _Scanner:
    """One walk over one text."""

    def __init__(self, text: str) -> None:
        self.text = text
        self.at = 0
        self.lines = Lines()
        self._ends = [match.start() for match in re.finditer("\n", text)]
        self._sizes: dict[Path, int] = {}  # how many tables each array of tables has so far
        self._headers: set[Path] = set()

    def document(self) -> None:
        table: Path = ()
        while self._skip() < len(self.text):
            if self.text[self.at] == "[":
                table = self._header()
            else:
                self._pair(table)

    def _header(self) -> Path:
        start, match = self.at, self._take(_HEADER)
        path: Path = ()
        *above, last = _parts(match[2])
        for part in above:
            path = self._newest((*path, part))
            self._record(path, start, again=True)
        path = (*path, last)
        if match[1] == "[[":
            self._record(path, start, again=True)
            self._sizes[path] = self._sizes.get(path, 0) + 1
            path = self._newest(path)
        self._record(path, start, again=path not in self._headers)
        self._headers.add(path)
        return path

    def _newest(self, path: Path) -> Path:
        return (*path, self._sizes[path] - 1) if path in self._sizes else path

    def _pair(self, table: Path) -> None:
        start, match = self.at, self._take(KEY)
        path = table
        *above, last = _parts(match[0])
        for part in above:
            path = (*path, part)
            self._record(path, start, again=True)
        path = (*path, last)
        self._record(path, start)
        self._take(_EQUALS)
        self._value(path)

    def _value(self, path: Path) -> None:
        opened = self.text[self.at : self.at + 1]
        if opened not in {"[", "{"}:
            self._take(_SCALAR)
            return
        self.at += 1
        index = 0
        while True:
            if self._skip() == len(self.text):
                raise _Lost
            if self.text[self.at] in "]}":
                break
            if opened == "{":
                self._pair(path)
            else:
                self._record((*path, index), self.at)
                self._value((*path, index))
                index += 1
            if self.text[self._skip() : self.at + 1] == ",":
                self.at += 1
            elif self.text[self.at : self.at + 1] not in {"]", "}"}:
                raise _Lost
        self.at += 1

    def _skip(self) -> int:
        match = _BLANK.match(self.text, self.at)
        self.at = match.end() if match else self.at
        return self.at

    def _take(self, pattern: re.Pattern[str]) -> re.Match[str]:
        match = pattern.match(self.text, self.at)
        if match is None:
            raise _Lost
        self.at = match.end()
        return match

    def _record(self, path: Path, start: int, *, again: bool = False) -> None:
        """Note a path; a second time is a mistake of the author, unless the grammar allows it `again`."""
        line = bisect_left(self._ends, start) + 1
        if path not in self.lines.found:
            self.lines.found[path] = line
        elif not again:
            self.lines.twice.append((path, line))


def _parts(key: str) -> list[str]:
    """The parts of a dotted key; `tomllib` knows about quotes and escapes."""
    try:
        table: object = tomllib.loads(f"{key} = 0")
    except tomllib.TOMLDecodeError as error:
        raise _Lost from error
    parts = []
    while isinstance(table, dict):
        ((part, table),) = table.items()
        parts.append(str(part))
    return parts
