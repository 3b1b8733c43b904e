"""What the agent's tests share: a gateway's side of the stream, and the agent as a process."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import TracebackType
from typing import Any, Self

AGENT = Path(__file__).parents[4] / "vendors" / "xcore" / "agent"
STANDIN = Path(__file__).parent / "standin"

Message = dict[str, Any]


class Client:
    """A gateway: reads lines, sends commands."""

    def __init__(self, address: tuple[str, int] | None, *, receive_buffer: int | None = None) -> None:
        assert address is not None
        self._socket = socket.socket()
        if receive_buffer is not None:
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, receive_buffer)
        self._socket.settimeout(8)
        self._socket.connect(address)
        self._file = self._socket.makefile("rb")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, _t: type[BaseException] | None, _e: BaseException | None, _b: TracebackType | None) -> None:
        self.close()

    def close(self) -> None:
        self._file.close()
        self._socket.close()

    def send(self, data: bytes) -> None:
        self._socket.sendall(data)

    def command(self, name: object, identifier: object = "c1", /, **args: object) -> None:
        self.send(json.dumps({"type": "command", "id": identifier, "name": name, "args": args}).encode() + b"\n")

    def next(self) -> Message | None:
        """The next message; None if the agent has closed."""
        with suppress(ConnectionError):
            line = self._file.readline()
            if line:
                assert line.endswith(b"\n")
                assert len(line) <= 65_536
                found = json.loads(line, parse_constant=no_json)
                assert isinstance(found, dict)
                return found
        return None

    def until(self, wanted: str, accept: Callable[[Message], object] = bool) -> Message:
        """The next message of that type that is accepted; others are skipped."""
        while True:
            message = self.next()
            assert message is not None, f"closed before {wanted}"
            if message["type"] == wanted and accept(message):
                return message

    def ask(self, name: object, identifier: str = "c1", /, **args: object) -> Message:
        self.command(name, identifier, **args)
        return self.until("result", lambda message: message["id"] == identifier)


def no_json(word: str) -> None:
    raise AssertionError(f"{word} is not JSON")


def wait_for(condition: Callable[[], object], seconds: float = 8.0) -> None:
    """Wait until something holds."""
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "it did not come to hold"
        time.sleep(0.005)


class Agent:
    """The command in a process of its own; its log is read all the time, and its end is waited for."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self._process = process
        self.log: deque[str] = deque(maxlen=1000)
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()

    def _read(self) -> None:
        assert self._process.stderr is not None
        for line in self._process.stderr:
            self.log.append(line.rstrip())

    @property
    def address(self) -> tuple[str, int]:
        """Where it listens, as its log says."""
        wait_for(lambda: any("listener.opened" in line for line in self.log) or self._process.poll() is not None)
        line = next(line for line in self.log if "listener.opened" in line)
        host, port = line.partition("('")[2].rstrip(")").split("', ")
        return host, int(port)

    def terminate(self) -> None:
        self._process.send_signal(signal.SIGTERM)

    def wait(self) -> int:
        code = self._process.wait(8)
        self._thread.join(8)
        return code

    def end(self) -> None:
        if self._process.poll() is None:
            self._process.kill()
        self.wait()
        assert self._process.stderr is not None
        self._process.stderr.close()


@contextmanager
def running_agent(
    *options: str,
    python: str = sys.executable,
    behaviour: Message | None = None,
    calls: Path | None = None,
    sdk: bool = True,
) -> Iterator[Agent]:
    """The command, with a free port and the flag unless `options` are given in full."""
    path = [str(AGENT)] + ([str(STANDIN)] if sdk else [])
    environment = {
        "PATH": os.environ["PATH"],
        "PYTHONPATH": os.pathsep.join(path),
        "PYTHONDONTWRITEBYTECODE": "1",
        "XCORE_STANDIN": json.dumps(behaviour or {}),
        "XCORE_STANDIN_CALLS": str(calls or ""),
    }
    command = [python, "-W", "error", "-m", "robot_gateway_xcore_agent", "--robot", "192.0.2.1", *options]
    process = subprocess.Popen(command, env=environment, stderr=subprocess.PIPE, text=True)  # noqa: S603 - our own
    agent = Agent(process)
    try:
        yield agent
    finally:
        agent.end()


OWNING = ("--class", "xMateRobot", "--connecting-may-stop-the-robot", "--port", "0", "--rate", "20")
