"""`robot-gateway simulate`: its options, its errors, and how it ends."""

from __future__ import annotations

import signal
import socket
import subprocess
import sys

import pytest
from typer.testing import CliRunner

from gateway.cli import simulate


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("rainbo", 'did you mean "rainbow"'),
        ("rainbow --layout 500", "layout is 500: it is one of 464"),
        ("rainbow --chaos splt=1", "chaos 'splt' is unknown"),
        ("rainbow --scenario cel", "no scenario 'cel'"),
        ("rainbow --host robot", "no IP address"),
        ("rainbow --port 1", "would need the ports 1, 0"),
        ("rainbow --count 0", "--count"),
        ("--vendor-dir /does/not/exist rainbow", "/does/not/exist"),
    ],
)
def test_wrong_usage_ends_with_2_and_says_what_is_wrong(arguments: str, message: str) -> None:
    result = CliRunner().invoke(simulate.app, arguments.split())
    assert result.exit_code == 2
    assert message in " ".join(result.output.split())


def test_the_help_shows_examples_scenarios_chaos_and_the_vendors_own_options() -> None:
    result = CliRunner().invoke(simulate.app, ["rainbow", "--help"])
    assert result.exit_code == 0
    for text in ("robot-gateway simulate rainbow --host", "estop", "split=RATE", "--layout"):
        assert text in result.output


def test_it_ends_by_itself_and_says_what_was_sent() -> None:
    result = CliRunner().invoke(simulate.app, ["rainbow", "--host", "127.0.0.1", "--port", "0", "--seconds", "0.01"])
    assert result.exit_code == 0
    assert result.output.startswith("rainbow 127.0.0.1:")
    assert result.output.endswith("sent 0 frames on 0 connections\n")


def test_a_taken_port_ends_with_1_and_says_which() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        result = CliRunner().invoke(simulate.app, f"rainbow --host 127.0.0.1 --port {port} --seconds 0.01".split())
    assert result.exit_code == 1
    assert f"127.0.0.1:{port}: the port is taken" in " ".join(result.output.split())


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_it_cleanly(number: signal.Signals) -> None:
    script = "from gateway.cli.simulate import app; app()"
    arguments = ["rainbow", "--host", "127.0.0.1", "--port", "0"]
    with subprocess.Popen(  # noqa: S603 - our own command
        [sys.executable, "-u", "-c", script, *arguments], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        process.stdout.readline()
        process.send_signal(number)
        out, err = process.communicate(timeout=10)
    assert (process.returncode, out, err) == (0, "sent 0 frames on 0 connections\n", "")
