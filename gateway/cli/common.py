"""What several commands share: the options that lead to a gateway, the terminal, and how failures end."""

from __future__ import annotations

import os
import sys
from collections.abc import Awaitable, Callable, Mapping
from pathlib import Path
from typing import Annotated, NoReturn

import anyio
import typer
from rich.console import Console
from rich.text import Text

from gateway.client import ClientError, TrustError, Way, trusting, way_to
from gateway.errors import GatewayError

DEFAULT_URL = "ws://127.0.0.1:8765/ws"
FAILURE = 1
USAGE = 2
_PIPED_WIDTH = 10_000  # into a pipe a line stays a line, however long

Url = Annotated[
    str,
    typer.Option("--url", envvar="ROBOT_GATEWAY_URL", help="WebSocket door of the gateway.", metavar="URL"),
]
TokenFile = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE",
        help="File with the token that the gateway asks for; without it $ROBOT_GATEWAY_TOKEN, or the file that "
        "$ROBOT_GATEWAY_TOKEN_FILE names. No option takes the token itself: all users of a machine see options.",
    ),
]
Ca = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE",
        envvar="ROBOT_GATEWAY_CA",
        help="For wss addresses: trust the certificates in this file only, such as the gateway's self-signed one.",
    ),
]
_LONGEST_FILE = 4096  # bytes; what is longer is no token


def way(
    url: str, token_file: Path | None = None, ca: Path | None = None, environ: Mapping[str, str] = os.environ
) -> Way:
    """The way to the gateway that the options and the environment name; ends the command where there is none."""
    try:
        return way_to(url, _token(token_file, environ), None if ca is None else trusting(ca))
    except ClientError as error:
        fail(error.reason, USAGE)
    except TrustError as error:
        fail(f"--ca {error}", USAGE)


def _token(file: Path | None, environ: Mapping[str, str]) -> str | None:
    """What the gateway may ask for; None: nothing was given."""
    if file is None:
        said = environ.get("ROBOT_GATEWAY_TOKEN", "").strip()
        if said:
            return said
        named = environ.get("ROBOT_GATEWAY_TOKEN_FILE")
        if not named:
            return None
        file = Path(named)
    try:
        with file.open("rb") as opened:
            words = opened.read(_LONGEST_FILE).decode().split()
    except OSError as error:
        fail(f"token file {file}: {error.strerror or error}", USAGE)
    except UnicodeDecodeError:
        words = []
    if len(words) != 1:
        fail(f"token file {file}: it should hold one token and nothing else, such as rgw_…", USAGE)
    return words[0]


def terminal() -> Console:
    """Standard output: as wide as the terminal or as `COLUMNS` says, and without limit into a pipe."""
    fixed = sys.stdout.isatty() or "COLUMNS" in os.environ
    return Console(highlight=False, width=None if fixed else _PIPED_WIDTH)


def tell(label: str, colour: str, text: str) -> None:
    """Print one line on stderr; only the label has a colour."""
    console = Console(stderr=True, highlight=False, soft_wrap=True)
    console.print(Text.assemble((label, colour), " ", text))


def fail(text: str, code: int = FAILURE) -> NoReturn:
    """Say what went wrong and end with an exit code."""
    tell("error:", "red", text)
    raise typer.Exit(code)


def call(function: Callable[[], Awaitable[None]], *, uvloop: bool = False) -> None:
    """Run an async command; errors of ours end it with their message, Ctrl-C and a closed pipe without one."""
    try:
        anyio.run(function, backend_options={"use_uvloop": uvloop})
    except GatewayError as error:
        fail(str(error))
    except BaseExceptionGroup as group:
        fail(str(_ours(group)))
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # or the last flush would complain
        raise typer.Exit from None
    except KeyboardInterrupt:
        raise typer.Exit from None


def _ours(group: BaseExceptionGroup[BaseException]) -> GatewayError:
    """The error of ours that ended the tasks of a group; where there is another one, the whole group is raised."""
    ours, others = group.split(GatewayError)
    if ours is None or others is not None:
        raise group
    first: BaseException = ours
    while isinstance(first, BaseExceptionGroup):
        first = first.exceptions[0]
    if not isinstance(first, GatewayError):
        raise group
    return first
