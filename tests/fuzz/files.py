"""Files that people write: the configuration, the tokens, and documents of the vendors."""

from __future__ import annotations

import re
import tempfile
from functools import partial
from pathlib import Path

from gateway.api.documents import Checked, DocumentType
from gateway.config.file import parse
from gateway.config.printing import as_toml
from gateway.config.tokens import read_tokens
from gateway.core.registry import Registry
from gateway.errors import ConfigError
from tests.fuzz.target import Target

_CONFIG = Path(__file__).parents[2] / "config"
_LONG_WORD = re.compile(rb"rgw_[0-9A-Za-z_-]+|[0-9A-Za-z_-]{40,}")
_DOCUMENTS = (
    b'{"type":"MoveAbsJ","target":{"joints":[0,0.1,0.2,0,0,0]},"speed":100,"zone":10}',
    b'[{"type":"MoveL","target":{"trans":[0.5,0,0.3],"rpy":[3.14,0,0]}},{"type":"MoveJ"}]',
    b'{"id":"a","commands":[{"type":"MoveC"}]}\n{"id":"b","commands":[]}\n',
)


def config(registry: Registry) -> Target:
    """`gateway.toml`: it is refused with words, or printed back so that it means the same."""
    seeds = tuple(path.read_bytes() for path in sorted(_CONFIG.glob("*.toml")))
    return Target("config", partial(_config, registry), (*seeds, *_uncommented(seeds)))


def tokens() -> Target:
    """The file of tokens."""
    hashed = b"ab" * 32
    seed = b'[[tokens]]\nname = "line-1"\nsha256 = "%b"\ntopics = ["r1/*", "*/joints"]\n' % hashed
    return Target("tokens", _tokens, (seed, seed * 2))


def document(vendor: str, kind: DocumentType) -> Target:
    """A document that `robot-gateway validate` checks."""
    return Target(f"{vendor}-document-{kind.name}", partial(_document, kind), _DOCUMENTS)


def _config(registry: Registry, data: bytes) -> None:
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return  # `load` says so, and reads no further
    try:
        found = parse(text, "fuzz.toml", registry)
    except ConfigError as error:
        if not str(error):
            raise AssertionError("an error without words") from error
        return
    printed = as_toml(found)
    again = as_toml(parse(printed, "printed.toml", registry))
    if again != printed:
        raise AssertionError(f"printed back it means something else:\n{printed}\n---\n{again}")


def _tokens(data: bytes) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "tokens.toml"
        path.write_bytes(data)
        path.chmod(0o600)
        try:
            read_tokens(path)
        except ConfigError as error:
            said = str(error).replace(folder, "").encode()
            leaked = [word for word in _LONG_WORD.findall(data) if word in said]
            if leaked:
                raise AssertionError(f"{leaked[0]!r}, which may be a token, is repeated: {error}") from error


def _document(kind: DocumentType, data: bytes) -> None:
    checked = kind.check(data, kind.options())
    if not isinstance(checked, Checked) or any(len(row.cells) != len(kind.columns) for row in checked.rows):
        raise AssertionError(f"{kind.name}: a row without all its cells")
    for problem in (*checked.problems, *(problem for row in checked.rows for problem in row.problems)):
        str(problem).encode()  # what a terminal and JSON must take


def _uncommented(seeds: tuple[bytes, ...]) -> tuple[bytes, ...]:
    """The same files with the keys that stand there as comments."""
    return tuple(
        b"\n".join(line.removeprefix(b"# ") if b" = " in line else line for line in seed.split(b"\n")) for seed in seeds
    )
