"""The commands before a gateway that asks for a token or lets anyone in: what they say, and what they never say."""

from __future__ import annotations

import dataclasses
import json
import signal
from pathlib import Path

import anyio
import pytest

from gateway.config import Config
from gateway.testing.cell import virtual_cell
from tests.cli.command import PYTHON, Finished, command, command_here, environment
from tests.cli.test_tail import until_line
from tests.client.secured import WRONG, certificate, needs_openssl

COMMANDS = {
    "status": ["status"],
    "json": ["status", "--json"],
    "why": ["status", "--why", "r1"],
    "tail": ["tail", "r1/joints", "-n", "1"],
}


def made(folder: Path, *topics: str) -> tuple[str, Path]:
    """A file of tokens with one in it, and that token in a file of its own."""
    file = folder / "tokens.toml"
    globs = [part for topic in topics for part in ("--topics", topic)]
    token = command_here("token", "new", "hmi", "--file", str(file), *globs).out
    said = folder / "hmi.token"
    said.write_text(token)
    return str(file), said


def silent_about(done: Finished, token: Path) -> None:
    """A token is in no output."""
    assert token.read_text().strip() not in done.out + done.err
    assert "Traceback" not in done.err


@pytest.mark.parametrize("name", COMMANDS)
async def test_a_token_comes_from_a_file_or_the_environment_and_is_in_no_output(name: str, tmp_path: Path) -> None:
    tokens, said = made(tmp_path)
    async with virtual_cell("rainbow", server={"tokens": tokens}) as cell:
        asked = [*COMMANDS[name], "--url", cell.url]
        by_file = await command(*asked, "--token-file", str(said))
        by_value = await command(*asked, env={"ROBOT_GATEWAY_TOKEN": said.read_text()})
        by_name = await command(*asked, env={"ROBOT_GATEWAY_TOKEN_FILE": str(said)})
        without = await command(*asked)
        wrong = await command(*asked, env={"ROBOT_GATEWAY_TOKEN": WRONG})
        in_url = await command(*asked[:-1], f"{cell.url}?token={WRONG}")
    for done in (by_file, by_value, by_name):
        assert (done.code, done.err) == (0, "")
        assert "r1" in done.out
        silent_about(done, said)
    for done, says in ((without, "asks for a token"), (wrong, "does not know this token"), (in_url, "does not know")):
        assert (done.code, done.out) == (1, "")
        assert says in done.err
        assert WRONG not in done.err


async def test_a_token_shows_its_robots_only_also_where_some_topics_are_hidden(tmp_path: Path) -> None:
    tokens, said = made(tmp_path, "r2/joints", "r2/status")
    async with virtual_cell("rainbow", count=2, server={"tokens": tokens}) as cell:
        shown = await command("status", "--json", "--url", cell.url, "--token-file", str(said))
        refused = await command("status", "--why", "r1", "--url", cell.url, "--token-file", str(said))
        arguments = ["status", "--watch", "--url", cell.url, "--token-file", str(said)]
        async with await anyio.open_process([*PYTHON, *arguments], env=environment()) as process:
            assert process.stdout is not None
            watched = await until_line(process.stdout, "RUNNING")
            process.send_signal(signal.SIGINT)
    assert [robot["name"] for robot in json.loads(shown.out)] == ["r2"]
    assert (refused.code, 'there is no robot "r1"' in refused.err) == (1, True)
    assert "r1" not in watched
    silent_about(shown, said)


@needs_openssl
async def test_a_self_signed_certificate_is_named_by_ca(tmp_path: Path) -> None:
    files = certificate(tmp_path)
    tls = {"certificate": str(files.certificate), "key": str(files.key)}
    async with virtual_cell("rainbow", server={"tls": tls}) as cell:
        assert cell.url.startswith("wss://")
        good = await command("status", "--url", cell.url, "--ca", str(files.certificate))
        unknown = await command("tail", "--url", cell.url)
        plain = await command("status", "--url", cell.url.replace("wss://", "ws://"))
    assert (good.code, good.err) == (0, "")
    assert "nobody whom this machine trusts has signed its certificate" in unknown.err
    assert "write wss:// instead of ws://" in plain.err
    assert (unknown.code, plain.code) == (1, 1)


@pytest.mark.parametrize("name", COMMANDS)
async def test_a_gateway_that_lets_anyone_in_is_told_by_status_and_not_in_a_programs_way(name: str) -> None:
    async with virtual_cell("rainbow", server={"listen": "0.0.0.0:0", "insecure": True}) as cell:
        done = await command(*COMMANDS[name], "--url", f"ws://127.0.0.1:{cell.gateway.port}/ws")
    assert done.code == 0
    assert ("insecure: whoever reaches the address" in done.err) == (name != "tail")
    assert "insecure" not in done.out


@pytest.mark.parametrize(
    ("text", "says"),
    [("", "one token and nothing else"), ("a b", "one token"), (None, "No such file"), ("\0é", "one word")],
)
async def test_a_token_file_that_holds_no_token_says_so(text: str | None, says: str, tmp_path: Path) -> None:
    file = tmp_path / "hmi.token"
    if text is not None:
        file.write_text(text)
    done = await command("status", "--token-file", str(file))
    assert (done.code, done.out) == (2, "")
    assert says in done.err
    assert "Traceback" not in done.err


@pytest.mark.parametrize(("text", "says"), [("", "no certificate in PEM"), (None, "No such file")])
async def test_a_ca_file_that_holds_no_certificate_says_so(text: str | None, says: str, tmp_path: Path) -> None:
    file = tmp_path / "ca.pem"
    if text is not None:
        file.write_text(text)
    done = await command("tail", "--ca", str(file))
    assert (done.code, done.out) == (2, "")
    assert says in done.err


def test_no_command_takes_a_token_as_an_option() -> None:
    for name in ("status", "tail"):
        done = command_here(name, "--token", WRONG)
        assert done.code == 2
        assert WRONG not in done.out + done.err


async def test_watching_shows_robots_that_a_reload_adds_and_removes() -> None:
    async with virtual_cell("rainbow", count=2) as cell:
        whole = cell.gateway.config
        arguments = ["status", "--watch", "--url", cell.url]
        async with await anyio.open_process([*PYTHON, *arguments], env=environment()) as process:
            assert process.stdout is not None
            await until_line(process.stdout, "r2 ")
            await cell.gateway.reload(_first(whole))
            with anyio.fail_after(10):
                while "r2 " in (block := await until_line(process.stdout, "\n\n")):
                    assert "r1 " in block
            await cell.gateway.reload(whole)
            await until_line(process.stdout, "r2 ")
            process.send_signal(signal.SIGINT)


def _first(config: Config) -> Config:
    return dataclasses.replace(config, robots=config.robots[:1])
