"""`robot-gateway snapshot`: a file of the whole cell, or the reason why there is none."""

from __future__ import annotations

from pathlib import Path

import anyio
import pytest

from tests.cli.command import command
from tests.cli.recorded import recorded_cell, topics

pytestmark = pytest.mark.limit(40)


async def test_with_wait_it_prints_the_name_of_the_file(tmp_path: Path) -> None:
    folder = tmp_path / "recordings"
    async with recorded_cell(tmp_path, count=2, directory=str(folder)) as cell:
        done = await command("snapshot", "--wait", "--control", cell.control)
        assert done.code == 0, done.err
        path = Path(done.out.strip())
        assert path.parent == folder
        assert path.stat().st_mode & 0o777 == 0o640  # noqa: ASYNC240
        assert {"r1/raw/received", "r2/joints", "r1/link"} <= set(topics(path))
        status = await command("status", "--url", cell.cell.url)
        assert "recording" not in status.out


async def test_without_it_it_says_where_the_file_will_be(tmp_path: Path) -> None:
    async with recorded_cell(tmp_path, directory=str(tmp_path / "recordings")) as cell:
        done = await command("snapshot", "--control", cell.control)
        assert (done.code, done.out) == (0, "")
        assert str(tmp_path / "recordings") in done.err
        with anyio.fail_after(10):
            while not list((tmp_path / "recordings").glob("*.mcap")):  # noqa: ASYNC110
                await anyio.sleep(0.05)


async def test_where_no_folder_is_set_it_says_which_key_is_missing(tmp_path: Path) -> None:
    async with recorded_cell(tmp_path) as cell:
        done = await command("snapshot", "--control", cell.control)
        assert done.code == 1
        assert "recorder.directory" in done.err


async def test_where_the_recorder_is_off_it_says_so(tmp_path: Path) -> None:
    async with recorded_cell(tmp_path, enabled=False) as cell:
        done = await command("snapshot", "--control", cell.control)
        assert done.code == 1
        assert "enabled = true" in done.err


async def test_a_file_that_could_not_be_written_is_an_error_here_and_in_status(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    async with recorded_cell(tmp_path, directory=str(tmp_path / "file")) as cell:
        done = await command("snapshot", "--wait", "--control", cell.control)
        assert done.code == 1
        assert str(tmp_path / "file") in done.err
        status = await command("status", "--url", cell.cell.url)
        assert "recording failed:" in status.out
        assert (await command("snapshot", "--control", str(tmp_path / "none.sock"))).code == 1
