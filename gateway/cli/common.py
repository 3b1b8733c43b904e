"""What several commands share: the option that names a gateway, the terminal, and how failures end."""

from __future__ import annotations

import os
import sys
from collections.abc import Awaitable, Callable
from typing import Annotated, NoReturn

import anyio
import typer
from rich.console import Console
from rich.text import Text

from gateway.errors import GatewayError

DEFAULT_URL = "ws://127.0.0.1:8765/ws"
FAILURE = 1
USAGE = 2
_PIPED_WIDTH = 10_000  # into a pipe a line stays a line, however long

Url = Annotated[
    str,
    typer.Option("--url", envvar="ROBOT_GATEWAY_URL", help="WebSocket door of the gateway.", metavar="URL"),
]


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
