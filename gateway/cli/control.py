"""How a command speaks to the gateway that runs on this machine: over its control socket."""

from __future__ import annotations

import os
import socket
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

import msgspec
import typer

from gateway.cli.common import fail
from gateway.server.control import NAME, SYSTEM_FOLDER

VARIABLE = "ROBOT_GATEWAY_CONTROL"
_ANSWER_S = 60.0

Control = Annotated[
    Path | None,
    typer.Option(
        "--control",
        envvar=VARIABLE,
        metavar="PATH",
        help="The gateway's control socket. Default: /run/robot-gateway/control.sock, or that of the user.",
    ),
]


class Answer(msgspec.Struct, kw_only=True):
    """What the gateway has answered.

    Attributes:
        ok: Whether the command was carried out.
        result: What came of it.
        code: Why it was not; stable.
        message: The same in words.
        problems: One line for each thing that is wrong.
    """

    ok: bool
    result: msgspec.Raw = msgspec.Raw(b"null")
    code: str = ""
    message: str = ""
    problems: list[str] = []


def find_socket(explicit: Path | None, env: Mapping[str, str], system: Path = SYSTEM_FOLDER) -> Path:
    """The control socket: the one that is named, that of the service, or that of a gateway of this user."""
    if explicit is not None:
        return explicit
    places = [system / NAME]
    if user := env.get("XDG_RUNTIME_DIR"):
        places.append(Path(user) / "robot-gateway" / NAME)
    for place in places:
        if _is_there(place):
            return place
    looked = ", ".join(map(str, places))
    return fail(f"no running gateway was found: looked for {looked}; name its socket with --control PATH")


def _is_there(place: Path) -> bool:
    """A socket that may not even be looked at is there: asking it says who may."""
    try:
        return place.exists()
    except PermissionError:
        return True


def ask(path: Path, request: msgspec.Struct) -> Answer:
    """Send one command and wait for its answer; where there is none, the program ends and says why."""
    try:
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as caller, caller.makefile("rb") as lines:
            caller.settimeout(_ANSWER_S)
            caller.connect(os.fspath(path))
            caller.sendall(msgspec.json.encode(request) + b"\n")
            line = lines.readline()
        return msgspec.json.decode(line, type=Answer)
    except FileNotFoundError:
        return fail(f"{path}: there is no such socket; is the gateway running?")
    except PermissionError:
        return fail(f"{path}: may not be used by this user: run it with sudo, or as a member of the socket's group")
    except ConnectionRefusedError:
        return fail(f"{path}: nobody answers: the gateway that made this socket has ended")
    except TimeoutError:
        return fail(f"{path}: no answer within {_ANSWER_S:g} s; look at the gateway's log")
    except (OSError, msgspec.DecodeError) as error:
        return fail(f"{path}: the gateway hung up without an answer ({error})")
