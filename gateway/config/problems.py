"""Reads the tables of a configuration and collects everything that is wrong, each with its line and a hint."""

from __future__ import annotations

import difflib
import json
import math
import re
import tomllib
from typing import TYPE_CHECKING

import msgspec
from msgspec import inspect

from gateway.config.toml_lines import KEY, Lines, lines
from gateway.errors import ConfigError

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from gateway.config.toml_lines import Path

Table = dict[str, object]

_POSITION = re.compile(r"\(at line (\d+), column (\d+)\)$")
_TOKEN = re.compile(r"rgw_[\w-]{8,}")
_SHOWN = 60  # characters of a wrong value
_BEGINNING = 2  # so many characters may be the beginning of a word
_WIDEST = 128  # bits of a number that is shown; Python refuses to print the widest


class Problems:
    """Everything that is wrong with one file, and what is only worth a warning.

    Args:
        file: Its name, as the user wrote it.
        where: The lines of its keys.
    """

    def __init__(self, file: str, where: Lines) -> None:
        self.file = file
        self.where = where
        self._problems: list[tuple[int, str]] = []
        self._warnings: list[tuple[int, str]] = []

    def add(self, path: Path, what: str) -> None:
        """Note what is wrong with a key or table."""
        self._problems.append((self.line(path), self._told(path, what)))

    def warn(self, path: Path, what: str) -> None:
        """Note what the user should know although everything else runs."""
        self._warnings.append((self.line(path), self._told(path, what)))

    def line(self, path: Path) -> int:
        """The line of a path, 0 for the file as a whole."""
        return self.where.of(path) or 0

    def __len__(self) -> int:
        return len(self._problems)

    @property
    def warnings(self) -> tuple[str, ...]:
        """The warnings, in the order of the file."""
        return tuple(text for _, text in sorted(self._warnings))

    def check(self) -> None:
        """Stop here if anything is wrong.

        Raises:
            ConfigError: With all of it, in the order of the file.
        """
        if self._problems:
            raise ConfigError(*(text for _, text in sorted(self._problems)))

    def _told(self, path: Path, what: str) -> str:
        line = self.where.of(path)
        place = self.file if line is None else f"{self.file}:{line}"
        return without_tokens(f"{place}: {key(path)}: {what}" if path else f"{place}: {what}")


def without_tokens(text: str) -> str:
    """A message without the tokens that somebody may have written where they do not belong."""
    return _TOKEN.sub("rgw_…", text)


def key(path: Path) -> str:
    """A path as its author would write it."""
    parts = (part for part in path if isinstance(part, str))
    return ".".join(part if re.fullmatch(r"[\w-]+", part) else quoted(part) for part in parts)


def quoted(value: object) -> str:
    """A wrong value as it stands in the file, shortened."""
    if isinstance(value, int) and value.bit_length() > _WIDEST:
        return "this number"
    try:
        text = json.dumps(value, ensure_ascii=False)
    except (TypeError, ValueError):
        text = str(value)
    return text if len(text) <= _SHOWN else f"{text[:_SHOWN]}…"


def nearest(word: str, words: Iterable[str]) -> str | None:
    """The word that was probably meant: best one that begins alike."""
    known = {known.lower().replace("-", "_"): known for known in words}
    plain = word.lower().replace("-", "_")
    begun = [one for one in known if one.startswith(plain) or plain.startswith(one)] if len(plain) >= _BEGINNING else []
    found = difflib.get_close_matches(plain, begun, n=1, cutoff=0) or difflib.get_close_matches(plain, known, n=1)
    return known[found[0]] if found else None


def hint(word: str, words: Iterable[str], otherwise: str) -> str:
    """The end of a sentence about an unknown word: the one that was probably meant, or all that there are."""
    words = list(words)
    meant = nearest(word, words)
    return f"did you mean {quoted(meant)}?" if meant else f"{otherwise}: {', '.join(words) or 'none'}"


def read_toml(text: str, file: str) -> tuple[Table, Problems]:
    """Parse a text.

    Raises:
        ConfigError: It is no TOML: with line and column.
    """
    where = lines(text)
    try:
        return tomllib.loads(text), Problems(file, where)
    except RecursionError:
        raise ConfigError(f"{file}: arrays or tables are nested too deeply") from None
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(_syntax(text, file, where, str(error))) from error
    except ValueError as error:  # a number of thousands of digits
        raise ConfigError(f"{file}: {error}") from error


def _syntax(text: str, file: str, where: Lines, reason: str) -> str:
    """Say where the syntax is wrong, and what probably was meant."""
    if reason.startswith("Cannot") and where.twice:
        path, line = where.twice[0]
        return f"{file}:{line}: {key(path)}: is there twice, first in line {where.of(path)}; remove one"
    rows = text.split("\n")
    position = _POSITION.search(reason)
    line, column = (int(position[1]), int(position[2])) if position else (len(rows), len(rows[-1]) + 1)
    row = rows[line - 1].strip()
    found = KEY.match(row)
    about = f"{found[0]}: " if found else ""
    reason = reason.split(" (at ", maxsplit=1)[0]
    if re.fullmatch(rf"{KEY.pattern}\s*=\s*[^\s\"'].*", row) and not row.endswith("="):
        reason = f"{reason}; text stands in quotes, numbers do not"
    return without_tokens(f"{file}:{line}: {about}no valid TOML at column {column}: {reason}")


def read_fields(
    problems: Problems,
    path: Path,
    raw: Mapping[str, object],
    struct: type[msgspec.Struct],
    *,
    also: Iterable[str] = (),
    elsewhere: Mapping[str, str] | None = None,
) -> Table:
    """Read the fields of a table that are right; note each one that is unknown, missing or of no valid value.

    Args:
        problems: Where the rest is noted.
        path: Of the table.
        raw: The table as parsed.
        struct: Names the fields, their types and limits.
        also: Further keys that the table may have; they are not read.
        elsewhere: For keys that are known but stand in the wrong place: what to say.
    """
    fields = {field.encode_name: field for field in msgspec.structs.fields(struct)}
    allowed = [*fields, *also]
    values: Table = {}
    meant: set[str | None] = set()
    for name, value in raw.items():
        if name in fields:
            fault = fault_of(value, fields[name].type)
            if fault:
                problems.add((*path, name), fault)
            else:
                values[fields[name].name] = msgspec.convert(value, fields[name].type)
        elif name not in allowed:
            moved = (elsewhere or {}).get(name)
            problems.add((*path, name), moved or f"unknown key; {hint(name, allowed, 'the keys here are')}")
            meant.add(nearest(name, allowed))
    for name, field in fields.items():
        if field.required and name not in raw and name not in meant:
            problems.add(path, f"{name} is missing")
    return values


def fault_of(value: object, wanted: object) -> str | None:
    """Say what is wrong with a value; None if nothing is."""
    try:
        msgspec.convert(value, wanted)
    except (msgspec.ValidationError, OverflowError) as error:
        kind = inspect.type_info(wanted)
        told = _described(kind)
        if told is None:
            return str(error)
        text = f"{quoted(value)} is not {told}"
        choices = [choice for choice in _choices(kind) if isinstance(choice, str)]
        if isinstance(value, str) and told.startswith(("a number", "a whole number", "true")):
            return f"{text}; it stands without quotes"
        meant = nearest(value, choices) if isinstance(value, str) else None
        return f"{text}; did you mean {quoted(meant)}?" if meant else text
    return "must be a finite number" if isinstance(value, float) and not math.isfinite(value) else None


def _plain(kind: inspect.Type) -> tuple[inspect.Type, Mapping[str, object]]:
    """A type without what is wrapped around it: metadata, and None for "not set"."""
    extra: Mapping[str, object] = {}
    while True:
        if isinstance(kind, inspect.Metadata):
            extra = {**extra, **(kind.extra or {})}
            kind = kind.type
        elif isinstance(kind, inspect.UnionType) and len(kind.types) == 2:  # noqa: PLR2004  X or None
            kind = next(part for part in kind.types if not isinstance(part, inspect.NoneType))
        else:
            return kind, extra


def _choices(kind: inspect.Type) -> tuple[object, ...]:
    plain, _ = _plain(kind)
    return tuple(plain.values) if isinstance(plain, inspect.LiteralType) else ()


def _described(kind: inspect.Type) -> str | None:
    """A type in words; None where msgspec's own words must do."""
    plain, extra = _plain(kind)
    if isinstance(says := extra.get("says"), str):
        return says
    if isinstance(plain, inspect.LiteralType):
        return " or ".join(quoted(value) for value in plain.values)
    if isinstance(plain, inspect.IntType | inspect.FloatType):
        return ("a whole number" if isinstance(plain, inspect.IntType) else "a number") + _limits(plain)
    if isinstance(plain, inspect.StrType) and (plain.pattern, plain.min_length, plain.max_length) == (None, None, None):
        return "text in quotes"
    return "true or false" if isinstance(plain, inspect.BoolType) else None


def _limits(kind: inspect.IntType | inspect.FloatType) -> str:
    if kind.ge is not None and kind.le is not None:
        return f" from {kind.ge:g} to {kind.le:g}" if isinstance(kind.le, float) else f" from {kind.ge} to {kind.le}"
    words = {"above": kind.gt, "of at least": kind.ge, "below": kind.lt, "of at most": kind.le}
    told = [f"{word} {limit:g}" for word, limit in words.items() if limit is not None]
    return f" {' and '.join(told)}" if told else ""
