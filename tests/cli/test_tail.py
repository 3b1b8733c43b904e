"""`robot-gateway tail` against a running gateway."""

from __future__ import annotations

import csv
import json
import shlex
import sys

import anyio
import pytest

from tests.cli.command import ROOT, command, environment, running_cell


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


@pytest.mark.parametrize("arguments", ["tail --all", "tail -f json --all", "tail r1/joints -f csv --all", "status"])
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


async def test_it_ends_with_the_reason_when_the_gateway_goes() -> None:
    async with running_cell() as gateway:
        process = await anyio.open_process(
            [sys.executable, "-m", "gateway", "tail", "--url", gateway.url], env=environment(), cwd=ROOT
        )
        assert process.stdout is not None
        await process.stdout.receive()
    async with process:
        assert process.stderr is not None
        with anyio.fail_after(5):
            assert await process.wait() == 1
        err = b"".join([chunk async for chunk in process.stderr]).decode()
    assert "the connection has ended: the gateway is stopping" in err
    assert "Traceback" not in err
