"""The control socket: whoever misuses it loses a connection, and nobody else anything."""

from __future__ import annotations

import os
import socket
import stat
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import anyio
import msgspec
import pytest
from structlog.testing import capture_logs

from gateway.server import control
from gateway.server.control import Command, ControlError, control_path, controlled


class Echo(msgspec.Struct, forbid_unknown_fields=True, tag_field="command", tag="echo"):
    """A command for tests."""

    word: str


async def echo(request: Echo) -> str:
    """Give the word back, or refuse it."""
    if request.word == "bad":
        raise ControlError("BAD_WORD", "no such word", ["line 1: bad"])
    if request.word == "bug":
        raise ValueError
    return request.word


COMMANDS = {"echo": Command(Echo, echo)}


class Caller:
    """A client of the socket."""

    def __init__(self, stream: anyio.abc.SocketStream) -> None:
        self._stream = stream

    async def say(self, data: bytes) -> dict[str, object] | None:
        """Send bytes and take one answer; None: it was hung up."""
        with anyio.fail_after(5):
            try:
                await self._stream.send(data)
                answer = b""
                while not answer.endswith(b"\n"):
                    answer += await self._stream.receive()
            except (anyio.EndOfStream, anyio.BrokenResourceError):
                return None
            found = msgspec.json.decode(answer)
            assert isinstance(found, dict)
            return found


@asynccontextmanager
async def calling(path: Path) -> AsyncIterator[Caller]:
    """Connect."""
    async with await anyio.connect_unix(path) as stream:
        yield Caller(stream)


def folder(tmp_path: Path) -> Path:
    """A folder of our own, and the socket's place in it."""
    own = tmp_path / "run"
    own.mkdir(mode=0o755)
    return own / "control.sock"


async def test_a_command_a_line_is_answered_a_line(tmp_path: Path) -> None:
    path = folder(tmp_path)
    async with controlled(path, COMMANDS), calling(path) as caller:
        assert await caller.say(b'{"command":"echo","word":"a"}\n') == {"ok": True, "result": "a"}
        refused = await caller.say(b'{"command":"echo","word":"bad"}\n')
        assert refused == {"ok": False, "code": "BAD_WORD", "message": "no such word", "problems": ["line 1: bad"]}


async def test_the_socket_is_for_its_user_and_group_and_goes_with_the_gateway(tmp_path: Path) -> None:
    path = folder(tmp_path)
    async with controlled(path, COMMANDS):
        assert stat.S_IMODE(path.stat().st_mode) == 0o660
    assert not path.exists()


async def test_the_log_says_who_called(tmp_path: Path) -> None:
    path = folder(tmp_path)
    with capture_logs() as logs:
        async with controlled(path, COMMANDS), calling(path) as caller:
            await caller.say(b'{"command":"echo","word":"a"}\n')
    (received,) = [log for log in logs if log["event"] == "command.received"]
    assert received["peer"] == f"uid {os.getuid()} pid {os.getpid()}"


@pytest.mark.parametrize(
    ("line", "code"),
    [
        (b"garbage\n", "BAD_REQUEST"),
        (b"\xff\xfe\n", "BAD_REQUEST"),
        (b"[" * 50_000 + b"\n", "BAD_REQUEST"),
        (b'{"command":"echo"}\n', "BAD_REQUEST"),
        (b'{"command":"echo","word":"a","more":1}\n', "BAD_REQUEST"),
        (b'{"command":"shutdown"}\n', "UNKNOWN_COMMAND"),
    ],
)
async def test_what_is_not_understood_is_refused_and_the_next_line_answered(
    tmp_path: Path, line: bytes, code: str
) -> None:
    path = folder(tmp_path)
    async with controlled(path, COMMANDS), calling(path) as caller:
        refused = await caller.say(line)
        assert refused is not None
        assert refused["code"] == code
        assert await caller.say(b'{"command":"echo","word":"a"}\n') == {"ok": True, "result": "a"}


@pytest.mark.parametrize("data", [b"x" * 70_000 + b"\n", b'{"command":"echo","word":"bug"}\n'])
async def test_an_over_long_line_or_a_mistake_of_ours_costs_the_connection_alone(tmp_path: Path, data: bytes) -> None:
    path = folder(tmp_path)
    async with controlled(path, COMMANDS), calling(path) as good, calling(path) as bad:
        assert await bad.say(data) is None
        assert await good.say(b'{"command":"echo","word":"a"}\n') == {"ok": True, "result": "a"}


async def test_half_a_line_is_waited_for_and_then_hung_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(control, "PATIENCE_S", 0.1)
    path = folder(tmp_path)
    async with controlled(path, COMMANDS), calling(path) as slow, calling(path) as good:
        assert await good.say(b'{"command":"echo","word":"a"}\n') == {"ok": True, "result": "a"}
        assert await slow.say(b'{"command"') is None


async def test_many_connections_are_bounded_and_free_again_afterwards(tmp_path: Path) -> None:
    path = folder(tmp_path)
    async with controlled(path, COMMANDS):
        streams = [await anyio.connect_unix(path) for _ in range(control.MOST_CONNECTIONS)]
        async with calling(path) as late:
            assert await late.say(b'{"command":"echo","word":"a"}\n') is None
        for stream in streams:
            await stream.aclose()
        with anyio.fail_after(5):
            while True:
                async with calling(path) as again:
                    if await again.say(b'{"command":"echo","word":"a"}\n') is not None:
                        break
                await anyio.sleep(0.01)


async def refusal(path: Path) -> str:
    """Why there is no socket, by the log."""
    with capture_logs() as logs:
        async with controlled(path, COMMANDS):
            pass
    (refused,) = [log for log in logs if log["event"] == "control.refused"]
    assert refused["log_level"] == "warning"
    return str(refused["reason"])


@pytest.mark.parametrize("mode", [0o777, 0o1777, 0o775])
async def test_a_folder_that_others_may_write_to_is_refused(tmp_path: Path, mode: int) -> None:
    path = folder(tmp_path)
    path.parent.chmod(mode)
    assert "chmod go-w" in await refusal(path)
    assert not path.exists()


async def test_a_folder_that_is_not_there_is_said(tmp_path: Path) -> None:
    assert "does not exist" in await refusal(tmp_path / "nowhere" / "control.sock")


async def test_the_socket_of_a_dead_gateway_is_replaced(tmp_path: Path) -> None:
    path = folder(tmp_path)
    with socket.socket(socket.AF_UNIX) as dead:
        dead.bind(str(path))
    async with controlled(path, COMMANDS), calling(path) as caller:
        assert await caller.say(b'{"command":"echo","word":"a"}\n') == {"ok": True, "result": "a"}


async def test_that_of_a_living_one_and_what_is_no_socket_are_left(tmp_path: Path) -> None:
    path = folder(tmp_path)
    async with controlled(path, COMMANDS):
        assert "another gateway" in await refusal(path)
        async with calling(path) as caller:
            assert await caller.say(b'{"command":"echo","word":"a"}\n') == {"ok": True, "result": "a"}
    path.write_text("mine", "utf-8")
    assert "something else" in await refusal(path)
    assert path.read_text("utf-8") == "mine"


def test_the_place_is_the_configured_one_the_services_or_the_users(tmp_path: Path) -> None:
    none, there = tmp_path / "none", tmp_path
    assert control_path("/a/b.sock", {"RUNTIME_DIRECTORY": "/run/x"}) == Path("/a/b.sock")
    assert control_path(None, {"RUNTIME_DIRECTORY": "/run/x:/run/y"}, none) == Path("/run/x/control.sock")
    assert control_path(None, {}, there) == there / "control.sock"
    assert control_path(None, {"XDG_RUNTIME_DIR": "/run/user/1"}, none) == Path(
        "/run/user/1/robot-gateway/control.sock"
    )
    assert control_path(None, {}, none) is None
