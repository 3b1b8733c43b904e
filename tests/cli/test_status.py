"""`robot-gateway status` against a running gateway, and without one."""

from __future__ import annotations

import fcntl
import io
import json
import os
import re
import signal
import struct
import termios

import anyio
import pyte
import pytest
from rich.console import Console
from rich.text import Text

from gateway.cli.watch import _fitting
from gateway.testing.cell import free_port
from tests.cli.command import PYTHON, command, environment, running_cell
from tests.cli.test_demo import open_on_terminal, read_screen
from tests.cli.test_tail import until_line


async def test_status_shows_the_robot_in_a_table_and_as_json() -> None:
    async with running_cell() as gateway:
        shown = await command("status", "--url", gateway.url, env={"COLUMNS": "80"})
        told = await command("status", "--json", env={"ROBOT_GATEWAY_URL": gateway.url})
    assert (shown.code, shown.err) == (0, "")
    head, _, row = shown.out.splitlines()[:3]
    assert head.split() == ["robot", "speaks", "link", "for", "Hz", "power", "motion", "program", "safety"]
    assert row.split()[:3] == ["r1", "rainbow:reqdata", "ONLINE"]
    assert told.code == 0
    (robot,) = json.loads(told.out)
    assert robot["link"]["state"] == "ONLINE"
    assert robot["status"]["power"] == "ENABLED"
    assert robot["safety"]["collision"] is False


async def test_into_a_pipe_nothing_is_left_out_whatever_the_width() -> None:
    async with running_cell("a" * 32) as gateway:
        narrow = await command("status", "--url", gateway.url, env={"COLUMNS": "80"})
        piped = await command("status", "--url", gateway.url)
    assert "too narrow for: speaks, program" in narrow.out
    assert max(map(len, narrow.out.splitlines())) <= 80
    assert "program" in piped.out.splitlines()[0]


@pytest.mark.parametrize("arguments", [["status"], ["status", "--json"], ["tail"]])
async def test_without_a_gateway_it_says_what_to_do(arguments: list[str]) -> None:
    done = await command(*arguments, "--url", "ws://127.0.0.1:1/ws")
    assert (done.code, done.out) == (1, "")
    assert "no gateway answers: start one with `robot-gateway run`" in done.err
    assert "Traceback" not in done.err


async def test_watching_is_for_people() -> None:
    done = await command("status", "--watch", "--json")
    assert done.code == 2


async def test_into_a_pipe_watching_prints_a_plain_block_a_second_and_waits_for_a_gateway() -> None:
    port = free_port()
    arguments = ["status", "--watch", "--url", f"ws://127.0.0.1:{port}/ws"]
    async with await anyio.open_process([*PYTHON, *arguments], env=environment()) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        first = await until_line(process.stdout, "trying again")
        async with running_cell(port=port):
            blocks = await until_line(process.stdout, "RUNNING")
            await until_line(process.stdout, "RUNNING")
        old = await until_line(process.stdout, "What follows is old.")
        process.send_signal(signal.SIGINT)
        with anyio.fail_after(5):
            assert await process.wait() == 0
        assert b"".join([chunk async for chunk in process.stderr]) == b""
    assert "no connection: no gateway answers" in first
    assert re.search(r"^\d\d:\d\d:\d\d\nrobot +speaks +link", blocks, re.MULTILINE)
    assert re.search(r"no connection: .* - trying again\nWhat follows is old\.", old)
    assert "\x1b" not in first + blocks + old


@pytest.mark.parametrize(("columns", "lines"), [(80, 24), (120, 40)])
@pytest.mark.parametrize("no_color", [False, True])
async def test_on_a_terminal_watching_is_a_live_table_that_is_resized_and_ends_on_ctrl_c(
    columns: int, lines: int, *, no_color: bool
) -> None:
    async with running_cell() as gateway:
        arguments = [*PYTHON, "status", "--watch", "--url", gateway.url]
        told = ["env", "NO_COLOR=1", *arguments] if no_color else arguments
        process, master = open_on_terminal(told, columns, lines)
        screen = pyte.Screen(columns, lines)
        try:
            await anyio.to_thread.run_sync(read_screen, master, screen, 10, "r1 .*RUNNING", "Ctrl-C ends it")
            shown = [line.rstrip() for line in screen.display]
            colours = {cell.fg for row in screen.buffer.values() for cell in row.values()}
            screen.resize(lines, 60)
            screen.reset()
            fcntl.ioctl(master, termios.TIOCSWINSZ, struct.pack("HHHH", lines, 60, 0, 0))
            await anyio.to_thread.run_sync(read_screen, master, screen, 5, "too narrow for: ", "r1 .*ONLINE")
            narrow = [line.rstrip() for line in screen.display]
            os.write(master, b"\x03")
            with anyio.fail_after(5):
                code = await anyio.to_thread.run_sync(process.wait)
        finally:
            if process.poll() is None:
                process.kill()
            os.close(master)
    assert code == 0
    assert shown[0].split()[:3] == ["robot", "speaks", "link"]
    assert shown[2].split()[:3] == ["r1", "rainbow:reqdata", "ONLINE"]
    assert "Traceback" not in "".join(shown)
    assert (colours == {"default"}) == no_color
    assert narrow[0].split()[:2] == ["robot", "link"]
    assert sum("ONLINE" in line for line in narrow) == 1  # nothing of the wider picture is left


def test_a_terminal_that_is_too_low_says_how_much_is_missing() -> None:
    console = Console(file=io.StringIO(), width=80, height=6, force_terminal=True, color_system=None)
    console.print(_fitting(console, Text("\n".join(f"line {number}" for number in range(20)))))
    assert isinstance(console.file, io.StringIO)
    rows = console.file.getvalue().splitlines()
    assert [row.strip() for row in rows] == [
        *(f"line {number}" for number in range(5)),
        "15 more lines: enlarge the terminal - Ctrl-C ends it",
    ]
