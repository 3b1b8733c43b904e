"""`robot-gateway plant`: the page of a gateway for all cells of a plant."""

from __future__ import annotations

import signal
from functools import partial
from pathlib import Path
from typing import Annotated

import anyio
import typer

from gateway import logs
from gateway.cli.common import USAGE, Ca, call, fail, tell
from gateway.cli.nats import Credentials, PlantName, access_of
from gateway.config.exports import NatsAccess
from gateway.config.keys import is_loopback, split_listen
from gateway.config.tokens import Token, read_tokens
from gateway.errors import ConfigError
from gateway.server.settings import AccessSettings, DoorSettings

DEFAULT_LISTEN = "127.0.0.1:8766"


def plant_command(
    nats: Annotated[str, typer.Option("--nats", metavar="URL", help="NATS server of the plant.")],
    *,
    listen: Annotated[str, typer.Option(metavar="HOST:PORT", help="Where the page is served.")] = DEFAULT_LISTEN,
    plant: PlantName = None,
    credentials: Credentials = None,
    ca: Ca = None,
    tokens: Annotated[
        Path | None, typer.Option(metavar="FILE", help="File of tokens, as robot-gateway token makes it.")
    ] = None,
    insecure: Annotated[bool, typer.Option("--insecure", help="Let everybody who reaches the page read it.")] = False,
    log_level: Annotated[str, typer.Option(metavar="LEVEL", help="debug, info, warning or error.")] = "info",
) -> None:
    """Serve the page of a gateway for all cells of a plant, and the native protocol, until it is told to stop.

    Robots are named cell/robot. A cell whose gateway says nothing any more is shown as disconnected.

    \b
    Examples:
      robot-gateway plant --nats nats://10.0.0.5:4222
      robot-gateway plant --nats tls://plant --listen 0.0.0.0:80 --tokens t.toml
    """  # noqa: D301 - the \b keeps the lines apart
    try:
        host, port = split_listen(listen)
    except ValueError as error:
        fail(f"--listen: {error}", USAGE)
    if not is_loopback(host) and tokens is None and not insecure:
        fail("--listen: other machines could read everything: name --tokens FILE, or take --insecure", USAGE)
    try:
        known = None if tokens is None else read_tokens(tokens)
        logs.configure(log_level)
    except (ConfigError, ValueError) as error:
        fail(str(error), USAGE)
    access = access_of(nats, credentials, ca)
    call(partial(_serve, access, plant, (host, port), known, insecure=insecure), uvloop=True)


async def _serve(
    access: NatsAccess,
    name: str | None,
    address: tuple[str, int],
    tokens: tuple[Token, ...] | None,
    *,
    insecure: bool,
) -> None:
    from gateway.plant import open_doors, reading  # noqa: PLC0415 - nats-py may not be there

    settings = DoorSettings(flush_s=0.002, access=AccessSettings(tokens=tokens, insecure=insecure))
    with anyio.open_signal_receiver(signal.SIGINT, signal.SIGTERM) as signals:
        async with reading(access, name) as plant, open_doors(plant, *address, settings) as doors:
            tell("plant:", "green", f"http://{address[0]}:{doors.port}/ - Ctrl-C ends it")
            async for _ in signals:
                return
