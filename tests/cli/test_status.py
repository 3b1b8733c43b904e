"""`robot-gateway status` against a running gateway, and without one."""

from __future__ import annotations

import json
import signal

import anyio
import pytest

from tests.cli.command import PYTHON, command, environment, running_cell


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


async def test_watching_waits_for_a_gateway_and_ends_on_ctrl_c() -> None:
    arguments = ["status", "--watch", "--url", "ws://127.0.0.1:1/ws"]
    async with await anyio.open_process([*PYTHON, *arguments], env=environment(PYTHONUNBUFFERED="1")) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        await anyio.sleep(2.5)  # it starts, finds nobody, and says so
        process.send_signal(signal.SIGINT)
        with anyio.fail_after(5):
            assert await process.wait() == 0
        out = b"".join([chunk async for chunk in process.stdout]).decode()
        assert "trying again" in out
        assert b"".join([chunk async for chunk in process.stderr]) == b""
