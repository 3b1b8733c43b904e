"""The control socket: commands to the running gateway from this machine, and from nowhere else.

A Unix socket, one JSON object a line each way. Who may use it is a matter of the file's mode: the gateway's own user,
root, and the file's group. Bad input costs the connection that it came on.
"""

from __future__ import annotations

import contextlib
import errno
import os
import socket
import stat
import struct
from collections.abc import AsyncGenerator, AsyncIterator, Awaitable, Callable, Iterator, Mapping, Sequence
from contextlib import aclosing, asynccontextmanager, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import cast

import anyio
import msgspec
import structlog
from anyio.abc import SocketStream, TaskGroup

from gateway.errors import GatewayError

_LOG = structlog.get_logger()
NAME = "control.sock"
SYSTEM_FOLDER = Path("/run/robot-gateway")
MODE = 0o660
LONGEST_LINE = 65_536
MOST_CONNECTIONS = 16
# A client has so long for a whole line, and for taking an answer, in s.
PATIENCE_S = 10.0
# Who takes a stream may be busy with a disk.
STREAM_PATIENCE_S = 60.0
_NO_ROOM_S = 0.5
_CREDENTIALS = struct.Struct("iii")  # pid, uid, gid


class ControlError(GatewayError):
    """A command that is refused.

    Attributes:
        code: Stable, upper case.
        problems: One line for each thing that is wrong.
    """

    def __init__(self, code: str, message: str, problems: Sequence[str] = ()) -> None:
        super().__init__(message)
        self.code = code
        self.problems = list(problems)


class Done(msgspec.Struct, frozen=True, kw_only=True):
    """The answer to a command that was carried out."""

    ok: bool = True
    result: object = None


class Refused(msgspec.Struct, frozen=True, kw_only=True):
    """The answer to one that was not."""

    ok: bool = False
    code: str
    message: str
    problems: list[str] = []


class _Named(msgspec.Struct):
    command: str


@dataclass(frozen=True, slots=True)
class Streamed:
    """The result of a command whose answer goes on: behind the line come bytes until the connection ends.

    Args:
        result: What stands in the line.
        body: The bytes; closed when the client leaves or does not read.
    """

    result: object
    body: AsyncIterator[bytes]


@dataclass(frozen=True, slots=True)
class Command:
    """One command.

    Args:
        request: What its line holds, tagged with `command`.
        run: Carries it out; called with the request, gives the result or a `Streamed`; raises ControlError.
    """

    request: type[msgspec.Struct]
    run: Callable[..., Awaitable[object]]


def control_path(configured: str | None, env: Mapping[str, str], system: Path = SYSTEM_FOLDER) -> Path | None:
    """Where the socket belongs; None: nowhere.

    Args:
        configured: `server.control`.
        env: The environment: the service manager's runtime directory, or that of the user.
        system: The folder of the service.
    """
    if configured:
        return Path(configured)
    if runtime := env.get("RUNTIME_DIRECTORY"):
        return Path(runtime.split(":", maxsplit=1)[0]) / NAME
    if system.is_dir() and os.access(system, os.W_OK):
        return system / NAME
    if user := env.get("XDG_RUNTIME_DIR"):
        return Path(user) / "robot-gateway" / NAME
    return None


@asynccontextmanager
async def controlled(path: Path | None, commands: Mapping[str, Command]) -> AsyncIterator[None]:
    """Take commands for as long as the context lasts; where that cannot be, the gateway runs without.

    Args:
        path: Of the socket; None: there is no place for one.
        commands: What can be asked for, by name.
    """
    if path is None:
        _LOG.info("control.skipped", reason="no folder for it: set server.control, or let the service manager make one")
        yield
        return
    try:
        listener = _bound(path)
    except OSError as error:
        _LOG.warning("control.refused", peer=str(path), reason=_words(error))
        yield
        return
    with _unlinked(path), listener:
        async with anyio.create_task_group() as tasks:
            tasks.start_soon(_accept, listener, commands, tasks)
            _LOG.info("control.opened", peer=str(path))
            try:
                yield
            finally:
                tasks.cancel_scope.cancel()


def _bound(path: Path) -> socket.socket:
    """The listening socket. The file has its mode before anybody can connect.

    Raises:
        OSError: It cannot be there; `strerror` says why.
    """
    _check_folder(path)
    _remove_stale(path)
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        listener.setblocking(False)  # noqa: FBT003 - its signature
        listener.bind(str(path))
        path.chmod(MODE)
        listener.listen(MOST_CONNECTIONS)
    except OSError:
        listener.close()
        raise
    return listener


def _check_folder(path: Path) -> None:
    """Refuse a folder in which others could put a socket of their own."""
    folder = path.parent
    if not folder.exists() and folder.name == "robot-gateway":
        with contextlib.suppress(OSError):
            folder.mkdir(mode=0o700)
    status = folder.stat()
    if status.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
        raise PermissionError(errno.EPERM, f"others may write to {folder}; run: chmod go-w {folder}")
    if status.st_uid not in {0, os.geteuid()}:
        raise PermissionError(errno.EPERM, f"{folder} belongs to user {status.st_uid}, who could exchange the socket")


def _remove_stale(path: Path) -> None:
    """Remove the socket of a gateway that is dead; what is anything else stays."""
    try:
        mode = path.lstat().st_mode
    except FileNotFoundError:
        return
    if not stat.S_ISSOCK(mode):
        raise FileExistsError(errno.EEXIST, "something else than a socket stands there; remove it")
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as caller:
        caller.setblocking(False)  # noqa: FBT003 - its signature
        try:
            caller.connect(str(path))
        except ConnectionRefusedError:
            path.unlink()
            return
        except BlockingIOError:
            pass  # its queue is full: somebody lives
    raise FileExistsError(errno.EADDRINUSE, "another gateway that runs has it: set server.control to another path")


@contextmanager
def _unlinked(path: Path) -> Iterator[None]:
    """Remove the socket at the end, unless another stands in its place by then."""
    ours = path.stat().st_ino
    try:
        yield
    finally:
        with contextlib.suppress(OSError):
            if path.lstat().st_ino == ours:
                path.unlink()


async def _accept(listener: socket.socket, commands: Mapping[str, Command], tasks: TaskGroup) -> None:
    free = anyio.Semaphore(MOST_CONNECTIONS)
    while True:
        await anyio.wait_readable(listener)
        try:
            connection, _ = listener.accept()
        except BlockingIOError:
            continue
        except OSError as error:
            _LOG.warning("control.failed", reason=error.strerror)
            await anyio.sleep(_NO_ROOM_S)
            continue
        try:
            free.acquire_nowait()
        except anyio.WouldBlock:
            connection.close()
        else:
            tasks.start_soon(_serve, connection, commands, free)


async def _serve(connection: socket.socket, commands: Mapping[str, Command], free: anyio.Semaphore) -> None:
    """Answer the lines of one connection; whatever goes wrong ends this connection only."""
    log = _LOG.bind(peer=_peer(connection))
    try:
        stream = await SocketStream.from_socket(connection)
        async with stream:
            lines = _Lines(stream)
            while (line := await lines.next()) is not None:
                answer = await _answer(line, commands, log)
                streamed = answer.result if isinstance(answer, Done) else None
                if isinstance(streamed, Streamed):
                    await _stream(stream, streamed)
                    break
                with anyio.fail_after(PATIENCE_S):
                    await stream.send(msgspec.json.encode(answer) + b"\n")
            if lines.fault:
                log.info("control.closed", reason=lines.fault)
    except (OSError, anyio.BrokenResourceError, anyio.ClosedResourceError) as error:
        log.info("control.closed", reason=str(error) or "the client left")
    except Exception:
        log.exception("control.failed")
    finally:
        free.release()


async def _stream(stream: SocketStream, streamed: Streamed) -> None:
    """Send an answer that goes on; a client that takes nothing for long is left."""
    async with aclosing(cast("AsyncGenerator[bytes]", streamed.body)) as body:
        with anyio.fail_after(PATIENCE_S):
            await stream.send(msgspec.json.encode(Done(result=streamed.result)) + b"\n")
        async for piece in body:
            with anyio.fail_after(STREAM_PATIENCE_S):
                await stream.send(piece)


class _Lines:
    """The lines that a client sends, each of which must come whole and in time.

    Attributes:
        fault: Why there are no more, where it is the client's fault.
    """

    def __init__(self, stream: SocketStream) -> None:
        self._stream = stream
        self._left = b""
        self.fault: str | None = None

    async def next(self) -> bytes | None:
        """The next line; None: there is none."""
        with anyio.move_on_after(PATIENCE_S):
            while b"\n" not in self._left and len(self._left) <= LONGEST_LINE:
                try:
                    self._left += await self._stream.receive()
                except anyio.EndOfStream:
                    self.fault = "half a line came" if self._left else None
                    return None
            line, _, self._left = self._left.partition(b"\n")
            if len(line) <= LONGEST_LINE:
                return line
            self.fault = f"a line has at most {LONGEST_LINE} bytes"
            return None
        self.fault = f"no whole line came within {PATIENCE_S:g} s"
        return None


async def _answer(
    line: bytes, commands: Mapping[str, Command], log: structlog.typing.FilteringBoundLogger
) -> Done | Refused:
    try:
        name = msgspec.json.decode(line, type=_Named).command
        command = commands.get(name)
        if command is None:
            known = ", ".join(commands)
            return Refused(code="UNKNOWN_COMMAND", message=f"there is no command {name[:40]!r}; known are: {known}")
        request = msgspec.json.decode(line, type=command.request)
    except (msgspec.DecodeError, UnicodeError, RecursionError) as error:
        return Refused(code="BAD_REQUEST", message=f"not understood: {error}")
    log.info("command.received", reason=name)
    try:
        return Done(result=await command.run(request))
    except ControlError as error:
        return Refused(code=error.code, message=str(error), problems=error.problems)


def _peer(connection: socket.socket) -> str:
    """Who is at the other end, as the kernel says it."""
    option = getattr(socket, "SO_PEERCRED", None)
    if option is None:
        return "unknown"
    pid, uid, _ = _CREDENTIALS.unpack(connection.getsockopt(socket.SOL_SOCKET, option, _CREDENTIALS.size))
    return f"uid {uid} pid {pid}"


def _words(error: OSError) -> str:
    if error.errno == errno.ENOENT:
        return "its folder does not exist; make it, or set server.control to another path"
    return error.strerror or str(error)
