"""The file of tokens: who may read what. The tokens themselves do not stand in it, and no word of it is repeated.

A value that is wrong may be a token that was put in the wrong place: messages name keys and lines, never such a value.
"""

from __future__ import annotations

import os
import re
import stat
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from gateway.config.problems import Problems, hint
from gateway.config.reading import read_file
from gateway.config.toml_lines import lines
from gateway.errors import ConfigError

CREDENTIALS = "CREDENTIALS_DIRECTORY"
LARGEST = 1024 * 1024  # bytes; ten thousand tokens take it
_PREFIX = "robot-gateway_"
_KEYS = ("name", "sha256", "topics")
_NAME = re.compile(r"[a-z0-9_-]{1,32}")
_HASH = re.compile(r"[0-9a-fA-F]{64}")
_LONGEST_GLOB = 256
_POSITION = re.compile(r"at line (\d+), column (\d+)\)$")
_SECRET = re.compile(r"rgw_[\w-]*|[\w-]{20,}")
_SAYS = {
    "name": "must be a name of 1 to 32 characters a-z, 0-9, _ and -, in quotes",
    "sha256": "must be the hash of the token, 64 hexadecimal digits in quotes, and never the token itself: "
    "robot-gateway token makes both",
    "topics": 'must be a list of globs of topics such as ["r1/*", "*/joints"]; everything is ["*"]',
}


@dataclass(frozen=True, slots=True)
class Token:
    """What is known of a token; the token itself is not.

    Attributes:
        name: Who has it.
        sha256: The hash of its UTF-8, 32 bytes.
        topics: Globs of the topics that it may read.
    """

    name: str
    sha256: bytes
    topics: tuple[str, ...] = ("*",)


def secret_file(path: Path, env: Mapping[str, str]) -> Path:
    """Where a secret is read: at its path, or among the credentials that systemd hands over.

    Args:
        path: As configured, absolute.
        env: Its `$CREDENTIALS_DIRECTORY` is looked at where the path cannot be read.
    """
    folder = env.get(CREDENTIALS)
    if not folder or os.access(path, os.R_OK):
        return path
    handed = (Path(folder) / path.name, Path(folder) / f"{_PREFIX}{path.name}")
    return next((one for one in handed if os.access(one, os.R_OK)), path)


def read_tokens(path: Path) -> tuple[Token, ...]:
    """Read a file of tokens.

    Raises:
        ConfigError: It cannot be read or trusted, or with everything that is wrong with it.
    """
    text = _text(path)
    try:
        raw = tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        position = _POSITION.search(str(error))
        place = f"{path}:{position[1]}" if position else str(path)
        column = f" at column {position[2]}" if position else ""
        raise ConfigError(f"{place}: no valid TOML{column}; text stands in quotes") from None
    problems = Problems(path.name, lines(text))
    tokens = _tokens(problems, raw)
    try:
        problems.check()
    except ConfigError as error:
        folder = path.parent
        raise ConfigError(*(f"{folder}/{_SECRET.sub('…', text)}" for text in error.problems)) from None
    return tuple(tokens)


def _text(path: Path) -> str:
    absent = "robot-gateway token makes tokens and such a file"
    data, mode = read_file(path, LARGEST, absent=absent, kind="file of tokens")
    if mode & (stat.S_IWGRP | stat.S_IWOTH):
        raise ConfigError(f"{path}: others may write to it, and so make themselves a token; run: chmod go-w {path}")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise ConfigError(f"{path}:{line}: is not UTF-8; save it as UTF-8") from None


def _tokens(problems: Problems, raw: Mapping[str, object]) -> list[Token]:
    for key in raw:
        if key != "tokens":
            problems.add((key,), "unknown key; each token stands in a block that begins with [[tokens]]")
    tables = raw.get("tokens", [])
    if not isinstance(tables, list) or not all(isinstance(table, dict) for table in tables):
        problems.add(("tokens",), "must be tables: write [[tokens]], with two pairs of brackets")
        return []
    found: list[Token] = []
    seen: dict[object, int] = {}
    for index, table in enumerate(tables):
        path = ("tokens", index)
        token = _token(problems, path, table)
        if token is None:
            continue
        for key, value, what in (("name", token.name, "name"), ("sha256", token.sha256, "hash")):
            first = seen.setdefault(value, index)
            if first != index:
                line = problems.line(("tokens", first, key))
                problems.add((*path, key), f"is already the {what} of the token in line {line}; each has its own")
        found.append(token)
    return found


def _token(problems: Problems, path: tuple[str, int], table: Mapping[str, object]) -> Token | None:
    """One block; None: something is wrong with it."""
    n_before = len(problems)
    for key in table:
        if key not in _KEYS:
            what = "the token itself must not stand here; its sha256 does" if key == "token" else "unknown key"
            problems.add((*path, key), f"{what}; {hint(key, _KEYS, 'the keys here are')}")
    name, digest, topics = table.get("name"), table.get("sha256"), table.get("topics", ["*"])
    right = {
        "name": isinstance(name, str) and _NAME.fullmatch(name) is not None,
        "sha256": isinstance(digest, str) and _HASH.fullmatch(digest) is not None,
        "topics": isinstance(topics, list) and bool(topics) and all(_is_glob(glob) for glob in topics),
    }
    for key, is_right in right.items():
        if key in table and not is_right:
            problems.add((*path, key), _SAYS[key])
        elif not is_right:
            problems.add(path, f"{key} is missing: it {_SAYS[key]}")
    if len(problems) > n_before or not isinstance(topics, list):
        return None
    return Token(str(name), bytes.fromhex(str(digest)), tuple(topics))


def _is_glob(glob: object) -> bool:
    """Whether a text may match a topic: `r1` alone never does."""
    return isinstance(glob, str) and 0 < len(glob) <= _LONGEST_GLOB and ("/" in glob or "*" in glob)
