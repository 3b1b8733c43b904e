"""What several commands share: the option that names a gateway, and how failures end."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from typing import Annotated, NoReturn

import anyio
import typer
from rich.console import Console
from rich.text import Text

from gateway.errors import GatewayError

DEFAULT_URL = "ws://127.0.0.1:8765/ws"
FAILURE = 1

Url = Annotated[
    str,
    typer.Option("--url", envvar="ROBOT_GATEWAY_URL", help="WebSocket door of the gateway.", metavar="URL"),
]


def tell(label: str, colour: str, text: str) -> None:
    """Print one line on stderr; only the label has a colour."""
    console = Console(stderr=True, highlight=False, soft_wrap=True)
    console.print(Text.assemble((label, colour), " ", text))


def fail(text: str, code: int = FAILURE) -> NoReturn:
    """Say what went wrong and end with an exit code."""
    tell("error:", "red", text)
    raise typer.Exit(code)


def call(function: Callable[[], Awaitable[None]], *, uvloop: bool = False) -> None:
    """Run an async command; errors of ours end it with their message, Ctrl-C without one."""
    try:
        anyio.run(function, backend_options={"use_uvloop": uvloop})
    except GatewayError as error:
        fail(str(error))
    except KeyboardInterrupt:
        raise typer.Exit from None
