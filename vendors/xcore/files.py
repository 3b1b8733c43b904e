"""Takes a file of motion commands apart: bytes to JSON values to commands, each with its place in the file."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import cast

from gateway.api.documents import LARGEST, Problem
from vendors.xcore.checking import CLASS, list_size_problems
from vendors.xcore.reading import MOST_PROBLEMS, hint, shortened

LIST_MEMBER = "commands"  # the member of a moveAppend that holds its commands
_LIST = (CLASS, LIST_MEMBER)


@dataclass(frozen=True, slots=True)
class Part:
    """One command as the file has it.

    Args:
        number: Where it stands, from 1: "3", "2.3" for the third of the second list, "line 4", "line 4.3".
        class_name: What the list that it stands in calls its class; None: the command says so itself.
        value: What is to be the command.
    """

    number: str
    class_name: str | None
    value: object


class _Repeating(dict[str, object]):
    """An object of the file in which members stand twice: those of `twice`."""

    twice: tuple[str, ...] = ()


class CommandFile:
    """The commands of a file, and what is wrong with the file itself.

    Args:
        data: The file.
    """

    def __init__(self, data: bytes) -> None:
        self.parts: list[Part] = []
        self.problems: list[Problem] = []
        text = self._text(data)
        if text is not None:
            self._read(text)

    def _text(self, data: bytes) -> str | None:
        if len(data) > LARGEST:
            self._wrong("", f"has {len(data)} bytes; {LARGEST} are read at most")
            return None
        try:
            text = data.decode("utf-8-sig")
        except UnicodeDecodeError as error:
            line = data.count(b"\n", 0, error.start) + 1
            byte = error.start - data.rfind(b"\n", 0, error.start)
            self._wrong(f"line {line}", f"no UTF-8 at byte {byte} of the line")
            return None
        if not text.strip():
            self._wrong("", "is empty")
            return None
        return text

    def _read(self, text: str) -> None:
        try:
            self._split("", _parsed(text))
        except ValueError as error:
            lines = [(f"line {number}", line) for number, line in enumerate(text.split("\n"), 1) if line.strip()]
            if not _in_lines([line for _, line in lines]):
                self._wrong("", _told(error))
                return
            for place, line in lines:
                try:
                    self._split(place, _parsed(line))
                except ValueError as wrong:
                    self._wrong(place, _told(wrong, in_line=True))

    def _split(self, line: str, value: object) -> None:
        """Take the commands out of one JSON value: that of the file, or of a line."""
        if not isinstance(value, list):
            self._take(line, value)
        elif not value:
            self._wrong(line, "is an empty array; at least one command is needed")
        else:
            for number, one in enumerate(value, 1):
                self._take(f"{line}.{number}" if line else f"{number}", one)

    def _take(self, number: str, value: object) -> None:
        """Take one command, or those of one moveAppend."""
        if not isinstance(value, Mapping) or LIST_MEMBER not in value:
            self.parts.append(Part(number or "1", None, value))
            return
        at = f"{number}." if number else ""
        class_name, commands = value.get(CLASS), value[LIST_MEMBER]
        if CLASS not in value:
            self._wrong(f"{at}{CLASS}", "is missing; it names the class of all commands of the list")
        for found in list_size_problems(class_name, commands):
            if found.path != CLASS or CLASS in value:
                self.problems.append(Problem(f"{at}{found.path}", found.message, found.found, found.allowed))
        for name in islice((name for name in value if name not in _LIST), MOST_PROBLEMS):
            self._wrong(f"{at}{shortened(name)}", f"is no known member; {hint(name, _LIST, 'the members are')}")
        for name in islice(repeated(value), MOST_PROBLEMS):
            self._wrong(f"{at}{shortened(name)}", "is there twice")
        if isinstance(class_name, str) and isinstance(commands, list):
            self.parts += [Part(f"{at}{index}", class_name, one) for index, one in enumerate(commands, 1)]

    def _wrong(self, path: str, message: str) -> None:
        self.problems.append(Problem(path, message))


def repeated(value: object) -> tuple[str, ...]:
    """The members that an object of the file has twice."""
    return value.twice if isinstance(value, _Repeating) else ()


def _in_lines(lines: Sequence[str]) -> bool:
    """Tell whether a text that is not JSON has a JSON value in each line, perhaps broken ones among them."""
    if len(lines) == 1 or not all(line.lstrip().startswith(("{", "[")) for line in lines):
        return False
    return any(map(_is_json, lines))


def _is_json(line: str) -> bool:
    try:
        _parsed(line)
    except ValueError:
        return False
    return True


def _parsed(text: str) -> object:
    """Read JSON.

    Raises:
        ValueError: It is none, or nested too deeply.
    """
    try:
        return cast("object", json.loads(text, object_pairs_hook=_members))
    except RecursionError:
        raise ValueError("arrays or objects are nested too deeply") from None
    except json.JSONDecodeError:
        raise
    except ValueError:
        raise ValueError("a number has thousands of digits") from None


def _members(pairs: list[tuple[str, object]]) -> dict[str, object]:
    members = dict(pairs)
    if len(members) == len(pairs):
        return members
    found = _Repeating(members)
    found.twice = tuple(name for name, count in Counter(name for name, _ in pairs).items() if count > 1)
    return found


def _told(error: ValueError, *, in_line: bool = False) -> str:
    """Say where the syntax is wrong."""
    if isinstance(error, json.JSONDecodeError):
        place = f"column {error.colno}" if in_line else f"line {error.lineno}, column {error.colno}"
        return f"no valid JSON at {place}: {error.msg}"
    return f"no valid JSON: {error}"
