"""`robot-gateway tail` against a running gateway."""

from __future__ import annotations

import csv
import json
import re
import shlex
import signal
import sys

import anyio
import pytest
from anyio.abc import ByteReceiveStream

from tests.cli.command import PYTHON, ROOT, command, environment, running_cell


async def test_the_three_formats() -> None:
    async with running_cell() as gateway:
        table = await command("tail", "r1/joints", "-n", "2", "--url", gateway.url)
        as_json = await command("tail", "r1/joints", "-n", "2", "-f", "json", "--url", gateway.url)
        as_csv = await command(
            "tail", "r1/joints", "-n", "2", "-f", "csv", "--fields", "position", "--url", gateway.url
        )
        for done in (table, as_json, as_csv):
            assert (done.code, done.err) == (0, "")
    assert "r1/joints" in table.out.splitlines()[0]
    assert table.out.splitlines()[1].split()[0] == "position"
    assert table.out.splitlines()[1].endswith("rad")
    assert max(map(len, table.out.splitlines())) <= 80
    first, second = map(json.loads, as_json.out.splitlines())
    assert first["topic"] == "r1/joints"
    assert second["seq"] > first["seq"]
    head, *rows = csv.reader(as_csv.out.splitlines())
    assert head == ["topic", "t", "seq", "q", *(f"position.{index}" for index in range(6))]
    assert len(rows) == 2
    assert all(float(cell) is not None for row in rows for cell in row[4:])


async def test_every_sample_is_there_with_all() -> None:
    async with running_cell() as gateway:
        done = await command("tail", "r1/tcp", "--all", "-n", "20", "-f", "json", "--url", gateway.url)
    seqs = [json.loads(line)["seq"] for line in done.out.splitlines()]
    assert seqs == list(range(seqs[0], seqs[0] + 20))


async def test_events_are_read_on_after_a_named_one() -> None:
    async with running_cell() as gateway:
        since = f"{gateway.bus.events.boot}:0"
        done = await command("tail", "*/events", "--since", since, "-n", "1", "--url", gateway.url)
    assert done.code == 0
    assert "r1  link.online  " in done.out


@pytest.mark.parametrize(
    ("arguments", "code", "says"),
    [
        (["r1/jonts"], 1, 'did you mean "r1/joints"?'),
        (["r1/joints", "--fields", "positio"], 1, "positio"),
        (["r1/joints", "--since", "x"], 1, "boot:seq"),
        (["--rate", "0"], 2, "above 0"),
        (["--rate", "nan"], 2, "above 0"),
        (["--rate", "1e9"], 2, "1000"),
        (["-f", "csv"], 2, "csv has one kind of row"),
        (["-f", "xml"], 2, "xml"),
    ],
)
async def test_what_cannot_be_followed_is_said(arguments: list[str], code: int, says: str) -> None:
    async with running_cell() as gateway:
        done = await command("tail", *arguments, "--url", gateway.url)
    assert done.code == code
    assert says in done.err
    assert "Traceback" not in done.err
    assert done.out == ""


@pytest.mark.parametrize(
    "arguments", ["tail --all", "tail -f json --all", "tail r1/joints -f csv --all", "status", "status --watch"]
)
async def test_a_pipe_that_closes_early_is_no_error(arguments: str) -> None:
    async with running_cell() as gateway:
        line = f"{shlex.quote(sys.executable)} -m gateway {arguments} --url {gateway.url} | head -1"
        with anyio.fail_after(10):
            done = await anyio.run_process(
                ["bash", "-o", "pipefail", "-c", line], env=environment(), cwd=ROOT, check=False
            )
    assert done.stderr == b""
    assert len(done.stdout.splitlines()) == 1
    assert done.returncode == 0


async def until_line(stream: ByteReceiveStream, part: str) -> str:
    """Everything that is said up to some words."""
    said = ""
    with anyio.fail_after(10):
        while part not in said:
            said += (await stream.receive()).decode()
    return said


async def test_it_goes_on_when_the_gateway_comes_back_and_says_both() -> None:
    arguments = ["tail", "*/events", "*/joints", "--rate", "20"]
    async with running_cell() as gateway:
        port = gateway.port
        process = await anyio.open_process(
            [*PYTHON, *arguments, "--url", gateway.url], env=environment(PYTHONUNBUFFERED="1"), cwd=ROOT
        )
        assert process.stdout is not None
        assert process.stderr is not None
        await until_line(process.stdout, "r1/joints")
    async with process:
        said = await until_line(process.stderr, "disconnected:")
        assert "the connection has ended: the gateway is stopping - trying again" in said
        async with running_cell(port=port):
            assert "again" in await until_line(process.stderr, "connected: again")
            out = await until_line(process.stdout, "link.online")
            assert re.search(r"r1  link.online  HANDSHAKING → ONLINE  \[[0-9a-f]{8}:1\]\n", out)
        process.send_signal(signal.SIGINT)
        with anyio.fail_after(5):
            assert await process.wait() == 0
        rest = b"".join([chunk async for chunk in process.stderr]).decode()
    assert "Traceback" not in rest
    assert "\x1b" not in out
