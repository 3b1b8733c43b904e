"""The options that lead to the NATS server of a plant."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gateway.cli.common import USAGE, fail

if TYPE_CHECKING:
    from gateway.config.exports import NatsAccess

_CREDENTIALS = "ROBOT_GATEWAY_NATS_CREDENTIALS"

NatsUrl = Annotated[
    str | None,
    typer.Option(metavar="URL", help="Read a whole plant from its NATS server instead, such as nats://10.0.0.5:4222."),
]
PlantName = Annotated[
    str | None, typer.Option(metavar="NAME", help="With --nats: which plant; default: the only one of the server.")
]
Credentials = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE",
        help="With --nats: file with what the server asks for: .creds, an nkey seed, user:password, or a token; "
        f"without it ${_CREDENTIALS} names it.",
    ),
]


def access_of(url: str, credentials: Path | None, ca: Path | None) -> NatsAccess:
    """How the server is reached; ends the command where the options are wrong."""
    # The configuration is imported only here, so that `status` of one gateway starts at once.
    from gateway.config.exports import AccessError, has_nats, nats_access, server_fault  # noqa: PLC0415

    if not has_nats():
        fail("--nats needs nats-py: pip install 'robot-gateway[nats]'", USAGE)
    if fault := server_fault(url):
        fail(f"--nats: {fault}", USAGE)
    named = os.environ.get(_CREDENTIALS)
    try:
        return nats_access((url,), credentials=credentials or (Path(named) if named else None), ca=ca)
    except AccessError as error:
        fail(f"--{'ca' if error.key == 'tls_ca' else 'credentials'}: {error}", USAGE)
