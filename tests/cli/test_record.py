"""`robot-gateway record`: files of what the running gateway reads, until it is told to stop."""

from __future__ import annotations

import signal
import subprocess
from pathlib import Path

import anyio
import pytest

from tests.cli.command import PYTHON, ROOT, command, environment
from tests.cli.recorded import recorded_cell, topics

pytestmark = pytest.mark.limit(60)


async def test_everything_is_recorded_for_some_time(tmp_path: Path) -> None:
    folder = tmp_path / "out"
    async with recorded_cell(tmp_path, count=2) as cell:
        done = await command("record", "-o", str(folder), "--for", "2s", "--control", cell.control)
        assert done.code == 0, done.err
        assert "recording: 2 robots" in done.err
        assert "0 dropped" in done.err
    (path,) = folder.iterdir()
    assert {"r1/raw/received", "r2/joints", "r1/link_stats"} <= set(topics(path))
    assert path.stat().st_mode & 0o777 == 0o640


async def test_only_the_robots_and_topics_that_are_named_are_recorded(tmp_path: Path) -> None:
    folder = tmp_path / "out"
    async with recorded_cell(tmp_path, count=2) as cell:
        arguments = ("r2/joints", "-o", str(folder), "--for", "2s", "--control", cell.control)
        assert (await command("record", *arguments)).code == 0
    (path,) = folder.iterdir()
    assert set(topics(path)) == {"r2/raw/received", "r2/raw/sent", "r2/session", "r2/joints"}


async def test_an_interrupt_finishes_the_file_and_a_gateway_that_comes_back_begins_another(tmp_path: Path) -> None:
    folder = tmp_path / "out"
    async with recorded_cell(tmp_path) as cell:
        arguments = [*PYTHON, "record", "-o", str(folder), "--raw-only", "--control", cell.control]
        process = await anyio.open_process(arguments, env=environment(), cwd=ROOT, stdout=subprocess.DEVNULL)
        await _until_there_are(folder, "*.mcap.part", 1)
        await anyio.sleep(1.5)
    await _until_there_are(folder, "*.mcap", 1)
    async with recorded_cell(tmp_path):
        await _until_there_are(folder, "*.mcap.part", 1)
        await anyio.sleep(1.5)
        process.send_signal(signal.SIGINT)
        with anyio.fail_after(20):
            assert await process.wait() == 0
        assert process.stderr is not None
        said = (await process.stderr.receive()).decode()
    await process.aclose()
    assert "waiting:" in said
    assert "recorded: 2 files" in said
    for path in folder.iterdir():
        assert path.suffix == ".mcap"
        found = topics(path)
        assert found["r1/raw/received"] > 0
        assert "r1/joints" not in found


async def test_a_gateway_that_goes_away_ends_it_where_it_shall_not_wait(tmp_path: Path) -> None:
    folder = tmp_path / "out"
    async with recorded_cell(tmp_path) as cell:
        arguments = [*PYTHON, "record", "-o", str(folder), "--no-wait", "--control", cell.control]
        process = await anyio.open_process(arguments, env=environment(), cwd=ROOT)
        await _until_there_are(folder, "*.mcap.part", 1)
    with anyio.fail_after(20):
        assert await process.wait() == 0
    await process.aclose()
    assert len(list(folder.glob("*.mcap"))) == 1


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["r1"], "r1/*"),
        (["--rotate", "soon"], "--rotate"),
        (["--rotate", "0m"], "--rotate"),
        (["--for", "500MB"], "--for"),
    ],
)
async def test_wrong_usage_is_explained(tmp_path: Path, arguments: list[str], said: str) -> None:
    done = await command("record", *arguments, "-o", str(tmp_path / "out"))
    assert done.code == 2
    assert said in done.err


async def test_a_robot_that_there_is_not_is_an_error(tmp_path: Path) -> None:
    async with recorded_cell(tmp_path) as cell:
        done = await command("record", "r11/*", "-o", str(tmp_path / "out"), "--control", cell.control)
        assert done.code == 1
        assert "did you mean 'r1'" in done.err


async def _until_there_are(folder: Path, glob: str, count: int) -> None:
    with anyio.fail_after(20):
        while len(list(folder.glob(glob))) < count:  # noqa: ASYNC110, ASYNC240
            await anyio.sleep(0.05)
