"""How a command speaks to the gateway that runs on this machine: over its control socket."""

from __future__ import annotations

import os
import socket
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import msgspec
import typer

from gateway.cli.common import fail
from gateway.server.control import NAME, SYSTEM_FOLDER

VARIABLE = "ROBOT_GATEWAY_CONTROL"
ANSWER_S = 60.0
_READ = 1 << 18

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


class Rest:
    """What comes behind an answer, until the gateway hangs up.

    Args:
        caller: The connection.
        behind: What came together with the answer.
    """

    def __init__(self, caller: socket.socket, behind: bytes) -> None:
        self._caller = caller
        self._behind = behind

    def read(self, patience_s: float) -> bytes | None:
        """Some bytes; None: none came in this time, s; b"": no more come."""
        if self._behind:
            data, self._behind = self._behind, b""
            return data
        self._caller.settimeout(patience_s)
        try:
            return self._caller.recv(_READ)
        except TimeoutError:
            return None
        except OSError:
            return b""


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


def answers(path: Path) -> bool:
    """Whether somebody listens on a control socket."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as caller:
        try:
            caller.connect(os.fspath(path))
        except OSError:
            return False
    return True


def ask(path: Path, request: msgspec.Struct, answer_s: float = ANSWER_S) -> Answer:
    """Send one command and wait for its answer; where there is none, the program ends and says why."""
    with asked(path, request, answer_s) as (answer, _):
        return answer


@contextmanager
def asked(path: Path, request: msgspec.Struct, answer_s: float = ANSWER_S) -> Iterator[tuple[Answer, Rest]]:
    """Send one command and wait for its answer; where there is none, the program ends and says why.

    Args:
        path: Of the socket.
        request: The command.
        answer_s: How long the answer may take, in s.

    Yields:
        The answer, and what comes behind it.
    """
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as caller:
        yield _answered(caller, path, request, answer_s)


def _answered(caller: socket.socket, path: Path, request: msgspec.Struct, answer_s: float) -> tuple[Answer, Rest]:
    try:
        caller.settimeout(answer_s)
        caller.connect(os.fspath(path))
        caller.sendall(msgspec.json.encode(request) + b"\n")
        told = b""
        while b"\n" not in told and (data := caller.recv(_READ)):
            told += data
        line, _, behind = told.partition(b"\n")
        return msgspec.json.decode(line, type=Answer), Rest(caller, behind)
    except FileNotFoundError:
        return fail(f"{path}: there is no such socket; is the gateway running?")
    except PermissionError:
        return fail(f"{path}: may not be used by this user: run it with sudo, or as a member of the socket's group")
    except ConnectionRefusedError:
        return fail(f"{path}: nobody answers: the gateway that made this socket has ended")
    except TimeoutError:
        return fail(f"{path}: no answer within {answer_s:g} s; look at the gateway's log")
    except (OSError, msgspec.DecodeError) as error:
        return fail(f"{path}: the gateway hung up without an answer ({error})")
