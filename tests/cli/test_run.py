"""`robot-gateway run`: starting, stopping, and what it says when it cannot."""

from __future__ import annotations

import signal
import socket
import sys
from pathlib import Path

import anyio
import anyio.abc
import pytest

from gateway.client import connect
from tests.cli.command import ROOT, command, command_here, environment

UNREACHABLE = """
[server]
listen = "127.0.0.1:{port}"
[[robots]]
name = "r1"
vendor = "rainbow"
host = "127.0.0.1"
port = 1
"""


def config(folder: Path, port: int = 0) -> Path:
    """A configuration whose robot is not there."""
    path = folder / "gateway.toml"
    path.write_text(UNREACHABLE.format(port=port), "utf-8")
    return path


def free_port() -> int:
    """A port that is free now."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        return int(server.getsockname()[1])


def test_a_wrong_configuration_ends_with_78_and_names_the_line(tmp_path: Path) -> None:
    path = tmp_path / "wrong.toml"
    path.write_text('[[robots]]\nname = "r1"\nvendor = "rainbw"\nhost = "10.0.0.1"\n', "utf-8")
    done = command_here("run", "--config", str(path))
    assert done.code == 78
    assert f"{path}:3" in done.err
    assert "rainbow" in done.err
    assert "Traceback" not in done.err


def test_no_configuration_at_all_ends_with_78(tmp_path: Path) -> None:
    done = command_here("run", cwd=tmp_path)
    assert done.code == 78
    assert "--config" in done.err


def test_an_unknown_log_level_is_wrong_usage(tmp_path: Path) -> None:
    done = command_here("run", "--config", str(config(tmp_path)), "--log-level", "loud")
    assert done.code == 2
    assert "debug, info, warning, error" in done.err


async def test_a_port_in_use_ends_with_1_and_says_which_and_what_to_do(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        done = await command("run", "--config", str(config(tmp_path, port)))
    assert done.code == 1
    assert f"127.0.0.1:{port}" in done.err
    assert "set server.listen to another port" in done.err
    assert "Traceback" not in done.err


async def until_it_answers(url: str) -> None:
    """Wait until a gateway answers."""
    while True:
        try:
            async with connect(url) as client:
                (robot,) = await client.robots()
                assert robot.link.attempts >= 0
                return
        except OSError:
            raise
        except Exception:  # noqa: BLE001 - not yet
            await anyio.sleep(0.05)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
async def test_it_runs_without_its_robot_and_ends_on_a_signal_with_0(tmp_path: Path, number: signal.Signals) -> None:
    port = free_port()
    arguments = [sys.executable, "-m", "gateway", "run", "--config", str(config(tmp_path, port))]
    async with await anyio.open_process(arguments, env=environment(), cwd=ROOT) as process:
        with anyio.fail_after(10):
            await until_it_answers(f"ws://127.0.0.1:{port}/ws")
        async with connect(f"ws://127.0.0.1:{port}/ws") as client:
            process.send_signal(number)
            with anyio.fail_after(5):
                assert await process.wait() == 0
            assert client.welcome.robots == ["r1"]
        assert process.stderr is not None
        log = b"".join([chunk async for chunk in process.stderr]).decode()
    assert "Traceback" not in log
    assert '"event": "gateway.stopped"' in log
    assert number.name in log
