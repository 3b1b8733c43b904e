"""The process that writes a recording: what it leaves when all goes well, and when it does not."""

from __future__ import annotations

import os
import signal
import subprocess
from pathlib import Path

import anyio
import pytest
from mcap.reader import make_reader

from gateway.record.chunks import Chunk, pack
from gateway.record.filing import Filing
from gateway.record.spool import Begin, End, Message, Raw, Said

BEGIN = Begin(robots="", vendor_dirs=[], from_t=1, reason={"trigger": "test"}, gateway="1")
SAID = Said(topic="r1/link", t=2, seq=3, data=b"{}")
END = End(to_t=9)


def raw(n_bytes: int = 10) -> Raw:
    return Raw(robot="r1", block=pack([Chunk(2, "received", os.urandom(n_bytes), "e.1", 1)], (), ()))


def names(folder: Path) -> list[str]:
    return [path.name for path in folder.iterdir()]


async def write(path: Path, *messages: Message) -> str:
    """Write a file; why it is not there."""
    async with Filing.opened(path) as filing:
        for message in messages:
            await filing.send(message)
        return (await filing.finished()).error


async def test_a_whole_recording_is_a_file_for_its_owner_and_group_only(tmp_path: Path) -> None:
    path = tmp_path / "one.mcap"
    async with Filing.opened(path) as filing:
        for message in (BEGIN, raw(), SAID, END):
            await filing.send(message)
        outcome = await filing.finished()
    assert (outcome.error, outcome.n_bytes) == ("", path.stat().st_size)
    assert path.stat().st_mode & 0o777 == 0o640
    assert names(tmp_path) == ["one.mcap"]
    with path.open("rb") as file:
        topics = {channel.topic for _, channel, _ in make_reader(file, validate_crcs=True).iter_messages()}
    assert topics >= {"r1/raw/received", "r1/link"}


async def test_a_recording_that_is_cut_off_leaves_no_file(tmp_path: Path) -> None:
    assert "ended before" in await write(tmp_path / "one.mcap", BEGIN, raw())
    assert names(tmp_path) == []


async def test_one_that_is_left_in_the_middle_leaves_no_file(tmp_path: Path) -> None:
    async with Filing.opened(tmp_path / "one.mcap") as filing:
        await filing.send(BEGIN)
    assert names(tmp_path) == []


async def test_messages_in_the_wrong_order_are_refused(tmp_path: Path) -> None:
    assert "before Begin" in await write(tmp_path / "one.mcap", raw(), END)
    assert names(tmp_path) == []


async def test_a_folder_that_is_not_there_is_named(tmp_path: Path) -> None:
    error = await write(tmp_path / "no" / "one.mcap", BEGIN, END)
    assert str(tmp_path / "no") in error
    assert "No such file" in error


async def test_a_folder_that_vanishes_meanwhile_costs_the_recording(tmp_path: Path) -> None:
    folder = tmp_path / "gone"
    folder.mkdir()
    async with Filing.opened(folder / "one.mcap") as filing:
        await filing.send(BEGIN)
        with anyio.fail_after(10):
            while not names(folder):  # noqa: ASYNC110
                await anyio.sleep(0.01)
        (folder / "one.mcap.part").unlink()
        folder.rmdir()
        await filing.send(END)
        outcome = await filing.finished()
    assert "No such file" in outcome.error


async def test_a_writer_that_is_killed_says_so_and_its_rest_is_swept_later(tmp_path: Path) -> None:
    async with Filing.opened(tmp_path / "one.mcap") as filing:
        await filing.send(BEGIN)
        with anyio.fail_after(10):
            while not names(tmp_path):  # noqa: ASYNC110
                await anyio.sleep(0.01)
        filing._process.send_signal(signal.SIGKILL)
        await filing._process.wait()
        for _ in range(5):
            await filing.send(raw(100_000))
        assert filing.broken
        assert "exit code -9" in (await filing.finished()).error
    assert names(tmp_path) == ["one.mcap.part"]


@pytest.mark.skipif(os.geteuid() != 0, reason="only root mounts a small disk")
async def test_a_disk_that_fills_mid_file_costs_the_recording_and_is_named(tmp_path: Path) -> None:
    mount = ["mount", "-t", "tmpfs", "-o", "size=64k", "tmpfs", str(tmp_path)]
    if subprocess.run(mount, check=False, capture_output=True).returncode != 0:  # noqa: S603, ASYNC221
        pytest.skip("nothing can be mounted here")
    try:
        error = await write(tmp_path / "one.mcap", BEGIN, *[raw(100_000) for _ in range(40)], END)
        assert "No space left" in error
        assert names(tmp_path) == []
    finally:
        subprocess.run(["umount", str(tmp_path)], check=False)  # noqa: S603, S607, ASYNC221


async def test_a_folder_of_the_same_name_in_the_current_one_is_not_taken_for_the_code(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "gateway").mkdir()
    (tmp_path / "gateway" / "__init__.py").write_text("raise SystemExit('wrong code')")
    monkeypatch.chdir(tmp_path)
    assert await write(tmp_path / "one.mcap", BEGIN, SAID, END) == ""
