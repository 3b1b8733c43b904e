"""`robot-gateway token`: makes the tokens that clients say, and the entries of the gateway's file of tokens."""

from __future__ import annotations

import contextlib
import fcntl
import getpass
import grp
import hashlib
import json
import os
import re
import secrets
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from gateway.cli.check import fail as fail_config
from gateway.cli.common import USAGE, fail, tell, terminal
from gateway.config.tokens import read_tokens
from gateway.errors import ConfigError, GatewayError

PREFIX = "rgw_"
_RANDOM_BYTES = 32
_SHORTEST = 32  # characters; a shorter one might be guessed from its hash
_LONGEST_INPUT = 4096
_NAME = re.compile(r"[a-z0-9_-]{1,32}")
_GROUP = "robot-gateway"
_OF_OWNER = 0o600
_OF_GROUP = 0o640
_HELP = """Make tokens for a gateway's clients, and look after its file of tokens.

The file holds names, hashes and topics, never a token.

\b
Examples:
  robot-gateway token new hmi --file /etc/robot-gateway/tokens.toml
  robot-gateway token hash < hmi.token
  robot-gateway token list /etc/robot-gateway/tokens.toml
"""

app = typer.Typer(
    help=_HELP, no_args_is_help=True, add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None
)


class TokensFileError(GatewayError):
    """Nothing can be added to the file of tokens."""


@app.command()
def new(
    name: Annotated[str, typer.Argument(metavar="NAME", help="Who gets it: a-z, 0-9, _ and -, 32 at most.")],
    *,
    topics: Annotated[
        list[str] | None,
        typer.Option("--topics", metavar="GLOB", help="What it may read, such as 'r1/*'; once for each, or by commas."),
    ] = None,
    file: Annotated[
        Path | None,
        typer.Option("--file", metavar="TOKENS", help="Add the entry to this file; made if it is not there."),
    ] = None,
) -> None:
    """Make a token: it is printed this once, and nobody can find it out again.

    On stdout stands the token alone. Its entry for the file of tokens goes into that file with --file, and to stderr
    without it.

    \b
    Examples:
      robot-gateway token new hmi --file tokens.toml > hmi.token
      robot-gateway token new paint --topics 'r1/*' --topics '*/safety'
    """  # noqa: D301 - the \b keeps the lines apart
    if not _NAME.fullmatch(name):
        fail(f'NAME "{name}": 1 to 32 of the characters a-z, 0-9, _ and -', USAGE)
    globs = _globs(topics)
    token = PREFIX + secrets.token_urlsafe(_RANDOM_BYTES)
    entry = entry_of(name, token, globs)
    if file is None:
        tell("entry:", "green", f"for the file that `tokens` in [server] names\n\n{entry}")
    else:
        try:
            append(file, name, entry)
        except TokensFileError as error:
            fail(str(error))
        except ConfigError as error:
            fail_config(error)
        tell("added:", "green", f"{name}, to {file}; a running gateway takes it with `robot-gateway reload`")
    sys.stdout.write(f"{token}\n")


@app.command("hash")
def hash_command() -> None:
    """Print the sha256 of a token on stdin: what stands in the file of tokens.

    \b
    Examples:
      robot-gateway token hash < hmi.token
    """  # noqa: D301 - the \b keeps the lines apart
    said = getpass.getpass("Token: ") if sys.stdin.isatty() else _read_stdin()
    words = said.split()
    if len(words) != 1:
        fail("stdin should hold one token and nothing else", USAGE)
    if len(words[0]) < _SHORTEST:
        tell(
            "warning:", "yellow", "this token is short enough to be guessed: `robot-gateway token new` makes long ones"
        )
    sys.stdout.write(f"{hash_of(words[0])}\n")


@app.command("list")
def list_command(
    file: Annotated[Path, typer.Argument(metavar="TOKENS", help="The file of tokens.")],
) -> None:
    """Show the names in a file of tokens, and what each may read.

    \b
    Examples:
      robot-gateway token list /etc/robot-gateway/tokens.toml
    """  # noqa: D301 - the \b keeps the lines apart
    try:
        tokens = read_tokens(file)
    except ConfigError as error:
        fail_config(error)
    table = Table("name", "topics", box=None, pad_edge=False, show_edge=False)
    for token in tokens:
        table.add_row(token.name, " ".join(token.topics))
    terminal().print(table if tokens else "no tokens")


def hash_of(token: str) -> str:
    """What the gateway knows of a token, in hex."""
    return hashlib.sha256(token.encode()).hexdigest()


def entry_of(name: str, token: str, topics: list[str]) -> str:
    """The entry of a token in the file of tokens."""
    globs = ", ".join(json.dumps(glob, ensure_ascii=False) for glob in topics)
    return f'[[tokens]]\nname = "{name}"\nsha256 = "{hash_of(token)}"\ntopics = [{globs}]\n'


def append(file: Path, name: str, entry: str) -> None:
    """Add an entry to the file of tokens, which is made when it is not there: for its owner and the gateway only.

    Raises:
        TokensFileError: It has that name already, or cannot be written.
        ConfigError: It is no file of tokens.
    """
    try:
        with _locked(file) as descriptor:
            if name in {one.name for one in read_tokens(file)}:
                raise TokensFileError(
                    f"{file}: there is a token for {name} already; take its entry out, or another name"
                )
            text = file.read_bytes()
            gap = "" if not text else "\n" if text.endswith(b"\n") else "\n\n"
            os.write(descriptor, f"{gap}{entry}".encode())
            os.fsync(descriptor)
    except OSError as error:
        raise TokensFileError(f"{file}: {error.strerror or error}") from None


@contextlib.contextmanager
def _locked(file: Path) -> Iterator[int]:
    """A file to read and to append to, made if need be; no other of these commands has it meanwhile."""
    flags = os.O_RDWR | os.O_APPEND | os.O_CLOEXEC
    try:
        descriptor = os.open(file, flags | os.O_CREAT | os.O_EXCL, _OF_OWNER)
    except FileExistsError:
        descriptor = os.open(file, flags)
    else:
        with contextlib.suppress(KeyError, PermissionError):  # no such group, or not ours to give
            os.fchown(descriptor, -1, grp.getgrnam(_GROUP).gr_gid)
            os.fchmod(descriptor, _OF_GROUP)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield descriptor
    finally:
        os.close(descriptor)


def _globs(topics: list[str] | None) -> list[str]:
    """The globs of the option, each such that it can match a topic."""
    found = ["*"] if topics is None else [glob.strip() for one in topics for glob in one.split(",")]
    for glob in found:
        if not glob.isprintable() or ("/" not in glob and "*" not in glob):
            fail(f'--topics "{glob}": it matches no topic; one looks like r1/joints, all of a robot like r1/*', USAGE)
    return list(dict.fromkeys(found))


def _read_stdin() -> str:
    try:
        return sys.stdin.buffer.read(_LONGEST_INPUT).decode()
    except UnicodeDecodeError:
        return ""
