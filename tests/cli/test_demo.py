"""`robot-gateway demo`: on a terminal, without one, and beside other programs."""

from __future__ import annotations

import fcntl
import os
import pty
import re
import select
import signal
import socket
import struct
import subprocess
import sys
import termios
import time
from collections.abc import Sequence

import anyio
import pyte
import pytest

from gateway.cli.demo import demo_toml
from gateway.config import parse
from gateway.core.registry import Registry
from gateway.core.settings import RobotSettings
from tests.cli.command import PYTHON, ROOT, command, environment


async def test_without_a_terminal_it_prints_plain_lines_and_ends_by_itself() -> None:
    done = await command("demo", "--seconds", "2.5", "--listen", "127.0.0.1:0")
    assert done.code == 0
    lines = done.out.splitlines()
    assert lines
    row = r"r\d+  [a-z_]+:[a-z]+  [A-Z]+  \S+( Hz)?  joints(( +-?\d+\.\d{3})+ rad| \u2013)"
    assert all(re.fullmatch(row, line) for line in lines)
    assert any("rainbow:reqdata  ONLINE" in line for line in lines)
    assert "demo: doors at ws://127.0.0.1:" in done.err
    assert "Traceback" not in done.err


async def test_it_takes_another_port_where_the_robots_port_is_taken() -> None:
    robot = next(one for one in parse(demo_toml(Registry()), "demo").robots if isinstance(one, RobotSettings))
    try:
        taken = socket.create_server((robot.host, robot.port))
    except OSError:
        taken = None  # somebody else listens there, which is as good
    try:
        done = await command("demo", "--seconds", "4", "--listen", "127.0.0.1:0")
    finally:
        if taken is not None:
            taken.close()
    assert done.code == 0
    (served,) = re.findall(rf"{robot.name} is a virtual {robot.vendor.name} controller at (\S+)", done.err)
    assert served.startswith(f"{robot.host}:")
    assert served != f"{robot.host}:{robot.port}"
    assert "ONLINE" in done.out


async def test_a_named_port_that_is_taken_is_an_error_with_advice() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        listen = f"127.0.0.1:{taken.getsockname()[1]}"
        done = await command("demo", "--listen", listen)
    assert done.code == 1
    assert listen in done.err
    assert "Traceback" not in done.err


@pytest.mark.parametrize("listen", ["x", "0.0.0.0:1", "127.0.0.1:99999"])
async def test_a_wrong_address_is_wrong_usage(listen: str) -> None:
    done = await command("demo", "--listen", listen)
    assert done.code == 2
    assert "--listen" in done.err


def read_screen(master: int, screen: pyte.Screen, seconds: float, *enough: str) -> None:
    """Feed what a terminal gets to a screen until every one of some patterns is on it."""
    stream = pyte.ByteStream(screen)
    end_s = time.monotonic() + seconds
    while (left_s := end_s - time.monotonic()) > 0 and not shows(screen, enough):
        if select.select([master], [], [], left_s)[0]:
            stream.feed(os.read(master, 65536))


def shows(screen: pyte.Screen, patterns: Sequence[str]) -> bool:
    """Whether every pattern is on the screen."""
    text = "\n".join(screen.display)
    return all(re.search(pattern, text) for pattern in patterns)


def open_on_terminal(arguments: list[str], columns: int, lines: int) -> tuple[subprocess.Popen[bytes], int]:
    """Start a command on a terminal of its own; also gives the terminal's other end."""
    master, slave = pty.openpty()
    fcntl.ioctl(slave, termios.TIOCSWINSZ, struct.pack("HHHH", lines, columns, 0, 0))
    process = subprocess.Popen(  # noqa: S603
        arguments,
        stdin=slave,
        stdout=slave,
        stderr=slave,
        env=environment(TERM="xterm-256color"),
        cwd=ROOT,
        start_new_session=True,
        preexec_fn=lambda: fcntl.ioctl(0, termios.TIOCSCTTY, 0),  # noqa: PLW1509 - so that Ctrl-C is a signal
    )
    os.close(slave)
    return process, master


@pytest.mark.parametrize(("columns", "lines"), [(80, 24), (120, 40)])
async def test_on_a_terminal_it_shows_live_data_and_ctrl_c_ends_it_cleanly(columns: int, lines: int) -> None:
    process, master = open_on_terminal([*PYTHON, "demo", "--listen", "127.0.0.1:0"], columns, lines)
    screen = pyte.Screen(columns, lines)
    try:
        await anyio.to_thread.run_sync(read_screen, master, screen, 10, "rainbow:reqdata.*RUNNING", "Ctrl-C ends it")
        shown = [line.rstrip() for line in screen.display]
        os.write(master, b"\x03")
        with anyio.fail_after(5):
            code = await anyio.to_thread.run_sync(process.wait)
        await anyio.to_thread.run_sync(read_screen, master, screen, 0.2, "Traceback")
    except OSError:
        code = process.wait(5)
    finally:
        if process.poll() is None:
            process.send_signal(signal.SIGKILL)
        os.close(master)
    assert code == 0
    text = "\n".join(shown)
    assert "…" not in text
    head = next(line for line in shown if line.startswith("robot"))
    assert head.split()[:3] == ["robot", "speaks", "link"]
    assert head.split()[-2:] == ["program", "safety"]
    row = next(line for line in shown if "rainbow:reqdata" in line)
    assert row.split()[2] == "ONLINE"
    assert row.split()[-2:] == ["RUNNING", "NORMAL"]
    assert re.search(r"^r1  joints( +-?\d+\.\d{3}){6} rad$", text, re.MULTILINE)
    if lines > 30:  # on a small terminal eight robots leave room for one line each
        assert re.search(r"^    tcp   ( +-?\d+\.\d{3}){3} m$", text, re.MULTILINE)
    assert re.search(r"^ws://127\.0\.0\.1:\d+/ws   \d+ events so far   Ctrl-C ends it$", text, re.MULTILINE)
    assert "Traceback" not in "\n".join(screen.display)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
async def test_a_signal_ends_it_with_0_and_its_ports_are_free(number: signal.Signals) -> None:
    arguments = [sys.executable, "-m", "gateway", "demo", "--listen", "127.0.0.1:0"]
    async with await anyio.open_process(arguments, env=environment(), cwd=ROOT) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        err = (await process.stderr.receive()).decode()
        with anyio.fail_after(5):
            await process.stdout.receive()
            process.send_signal(number)
            assert await process.wait() == 0
        err += b"".join([chunk async for chunk in process.stderr]).decode()
    assert "Traceback" not in err
    port = re.search(r"doors at ws://127\.0\.0\.1:(\d+)", err)
    assert port is not None
    with pytest.raises(OSError):  # noqa: PT011 - nobody listens any more
        await anyio.connect_tcp("127.0.0.1", int(port[1]))
