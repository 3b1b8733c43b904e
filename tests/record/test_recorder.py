"""The recorder: what triggers a recording, what stands in it, and what a fault costs."""

from __future__ import annotations

import shutil
from collections.abc import AsyncIterator
from pathlib import Path

import anyio
import pytest
from structlog.testing import capture_logs

from gateway.api.model import EventKind
from gateway.record import dump as dump_module
from gateway.record.settings import RecorderSettings
from gateway.record.spool import Lost, Message, Outcome, Raw, Said, SpoolReader
from tests.record.recorder_kit import running_recorder


async def test_a_snapshot_has_what_was_before_it_and_after_it_of_all_robots(tmp_path: Path) -> None:
    async with running_recorder(tmp_path) as kit:
        kit.robot("r1")
        kit.robot("r2")
        kit.say("r1", b"before")
        asked = kit.recorder.snapshot()
        assert asked is not None
        await kit.until(lambda: kit.recorder.info.recording is not None)
        kit.say("r2", b"after")
        await asked.done.wait()
        (written,) = kit.writers.made
        assert written.data == [b"before", b"after"]
        assert asked.path == written.path
        assert written.begin.reason["trigger"] == "snapshot"
        kit.say("r1", b"too late")
        assert kit.recorder.info.recordings == 1


async def test_two_triggers_at_once_make_one_file_that_names_both(tmp_path: Path) -> None:
    async with running_recorder(tmp_path) as kit:
        kit.robot("r1")
        kit.robot("r2")
        kit.happen("r1", EventKind.ESTOP_PRESSED)
        kit.happen("r2", EventKind.FAULT_RAISED)
        await kit.until(lambda: kit.recorder.info.recordings == 1)
        await anyio.sleep(0.15)
        (written,) = kit.writers.made
        assert written.path.name.endswith("_r1_estop.pressed.mcap")
        assert written.end.more == {"again": "fault.raised r2"}


async def test_what_triggers_nothing_is_recorded_and_no_more(tmp_path: Path) -> None:
    async with running_recorder(tmp_path) as kit:
        kit.robot("r1")
        kit.happen("r1", EventKind.MOTION_STARTED)
        await anyio.sleep(0.1)
        assert not kit.writers.made
        kit.happen("r1", EventKind.LINK_LOST)
        await kit.until(lambda: kit.recorder.info.recordings == 1)
        events = [message for message in kit.writers.made[0].got if isinstance(message, Said)]
        assert [b"motion.started" in said.data for said in events] == [True, False]


async def test_a_trigger_in_the_time_after_another_makes_the_file_longer_up_to_a_bound(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(dump_module, "LONGEST_S", 0.5)
    async with running_recorder(tmp_path, after_s=0.2) as kit:
        kit.robot("r1")
        began_s = anyio.current_time()
        for _ in range(40):
            kit.happen("r1", EventKind.FAULT_RAISED)
            await anyio.sleep(0.03)
        await kit.until(lambda: kit.recorder.info.recording is None)
        assert anyio.current_time() - began_s > 1.0
        assert 2 <= len(kit.writers.made) <= 4
        assert "fault.raised r1" in kit.writers.made[0].end.more["again"]


async def test_a_trigger_while_a_file_is_finished_makes_a_second_one_that_reaches_back_to_it(tmp_path: Path) -> None:
    async with running_recorder(tmp_path) as kit:
        kit.robot("r1")
        kit.writers.gate = anyio.Event()
        kit.happen("r1", EventKind.ESTOP_PRESSED)
        await kit.until(lambda: bool(kit.writers.made) and bool(kit.writers.made[0].got))
        gate = kit.writers.gate
        await anyio.sleep(0.2)  # its time is over, and it is not finished
        kit.say("r1", b"meanwhile")
        kit.happen("r1", EventKind.FAULT_RAISED)
        await anyio.sleep(0.1)
        assert len(kit.writers.made) == 1
        gate.set()
        await kit.until(lambda: kit.recorder.info.recordings == 2)
        first, second = kit.writers.made
        assert b"meanwhile" not in first.data
        assert b"meanwhile" in second.data
        assert second.path.name.endswith("_r1_fault.raised.mcap")


async def test_triggers_that_come_faster_than_files_wait_in_one_bounded_heap(tmp_path: Path) -> None:
    async with running_recorder(tmp_path) as kit:
        kit.robot("r1")
        kit.writers.gate = gate = anyio.Event()
        kit.happen("r1", EventKind.ESTOP_PRESSED)
        await kit.until(lambda: bool(kit.writers.made) and bool(kit.writers.made[0].got))
        await anyio.sleep(0.2)
        for _ in range(5000):
            kit.happen("r1", EventKind.FAULT_RAISED)
        assert len(kit.recorder._pending) <= 1000
        gate.set()
        await kit.until(lambda: kit.recorder.info.recordings == 2)
        await anyio.sleep(0.1)
        assert len(kit.writers.made) == 2


async def test_a_recording_that_failed_is_shown_and_the_next_one_is_tried(tmp_path: Path) -> None:
    async with running_recorder(tmp_path) as kit:
        kit.robot("r1")
        kit.writers.outcome = Outcome(error="no space left on device")
        with capture_logs() as logs:
            asked = kit.recorder.snapshot()
            assert asked is not None
            await asked.done.wait()
        assert (asked.path, asked.error) == (None, "no space left on device")
        info = kit.recorder.info
        assert (info.recordings, info.failed, info.error) == (0, 1, "no space left on device")
        assert [log["log_level"] for log in logs if log["event"] == "recording.failed"] == ["error"]
        kit.writers.outcome = Outcome(n_bytes=1)
        kit.recorder.snapshot()
        await kit.until(lambda: kit.recorder.info.recordings == 1)
        assert kit.recorder.info.error is None


async def test_a_writer_that_is_too_slow_is_given_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(dump_module, "MOST_WAITING", 1000)
    async with running_recorder(tmp_path, after_s=5.0) as kit:
        kit.robot("r1")
        kit.writers.is_stuck = True
        asked = kit.recorder.snapshot()
        assert asked is not None
        await kit.until(lambda: bool(kit.writers.made) and bool(kit.writers.made[0].got))
        for number in range(200):
            kit.say("r1", bytes([number]) * 100)
            kit.recorder.rings["r1"].close_block()
        await asked.done.wait()
        assert kit.writers.made[0].killed
        assert "too slow" in asked.error


async def test_without_a_folder_nothing_is_written_and_a_snapshot_says_so(tmp_path: Path) -> None:
    async with running_recorder(tmp_path, directory=None) as kit:
        kit.robot("r1")
        kit.happen("r1", EventKind.ESTOP_PRESSED)
        assert kit.recorder.snapshot() is None
        await anyio.sleep(0.05)
        assert not kit.writers.made
        kit.recorder.configure(RecorderSettings(directory=tmp_path, after_s=0.05))
        assert kit.recorder.snapshot() is not None
        await kit.until(lambda: kit.recorder.info.recordings == 1)


async def test_a_folder_that_cannot_be_made_is_told_at_once_and_costs_only_recordings(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    async with running_recorder(tmp_path / "file") as kit:
        await kit.until(lambda: kit.recorder.info.error is not None)
        kit.robot("r1")
        asked = kit.recorder.snapshot()
        assert asked is not None
        await asked.done.wait()
        assert str(tmp_path / "file") in asked.error
        kit.say("r1", b"still there")
        (tmp_path / "file").unlink()
        kit.recorder.snapshot()
        await kit.until(lambda: kit.recorder.info.recordings == 1)
        assert b"still there" in kit.writers.made[0].data


async def test_a_folder_that_has_vanished_is_made_again(tmp_path: Path) -> None:
    folder = tmp_path / "recordings"
    async with running_recorder(folder) as kit:
        await kit.until(folder.exists)
        assert folder.stat().st_mode & 0o777 == 0o750
        shutil.rmtree(folder)
        kit.recorder.snapshot()
        await kit.until(lambda: kit.recorder.info.recordings == 1)
        assert folder.exists()


async def test_what_a_killed_gateway_has_left_is_swept_at_the_start(tmp_path: Path) -> None:
    left = tmp_path / "2026-11-22T03-04-05Z_r1_estop.pressed.mcap.part"
    left.write_bytes(b"half")
    other = tmp_path / "mine.mcap.part"
    other.write_bytes(b"half")
    async with running_recorder(tmp_path) as kit:
        await kit.until(lambda: not left.exists())
    assert other.exists()


@pytest.mark.parametrize("jump_s", [-3600, 3600])
async def test_a_clock_that_jumps_leaves_nothing_out(tmp_path: Path, jump_s: int) -> None:
    async with running_recorder(tmp_path) as kit:
        kit.robot("r1")
        kit.say("r1", b"old time")
        kit.recorder.rings["r1"].close_block()
        kit.clock.offset_us += jump_s * 1_000_000
        kit.say("r1", b"new time")
        kit.recorder.snapshot()
        await kit.until(lambda: kit.recorder.info.recordings == 1)
        (written,) = kit.writers.made
        blocks = [message.block for message in written.got if isinstance(message, Raw)]
        assert written.data == [b"old time", b"new time"]
        assert all(written.begin.from_t <= block.last_t for block in blocks)


async def test_the_rings_of_all_robots_share_one_bound(tmp_path: Path) -> None:
    async with running_recorder(tmp_path, ring_bytes=50_000, before_s=0.0) as kit:
        for name in ("big", "small"):
            kit.robot(name)
        for number in range(200):
            kit.say("big", number.to_bytes(4, "big") * 8 + bytes(range(256)) * 8)
            kit.recorder.rings["big"].close_block()
            if number % 50 == 0:
                kit.say("small", b"little")
                kit.recorder.rings["small"].close_block()
        assert kit.recorder.info.ring_bytes <= 50_000
        assert kit.recorder.rings["big"].dropped > 0
        assert kit.recorder.rings["small"].dropped == 0


async def test_a_robot_that_is_removed_is_forgotten_and_one_that_comes_is_heard_at_once(tmp_path: Path) -> None:
    async with running_recorder(tmp_path) as kit:
        kit.robot("r1")
        gone = kit.bus.of("r1")
        kit.bus.remove(gone)
        kit.bus.announce([], gone)
        assert not kit.recorder.rings
        kit.robot("r2")
        kit.happen("r2", EventKind.ESTOP_PRESSED)
        await kit.until(lambda: kit.recorder.info.recordings == 1)


async def test_a_robot_that_becomes_another_one_during_a_recording_ends_in_it(tmp_path: Path) -> None:
    async with running_recorder(tmp_path, after_s=0.3) as kit:
        kit.robot("r1")
        kit.say("r1", b"old settings")
        kit.recorder.snapshot()
        await kit.until(lambda: bool(kit.writers.made) and bool(kit.writers.made[0].got))
        kit.robot("r1")
        kit.say("r1", b"new settings")
        await kit.until(lambda: kit.recorder.info.recordings == 1)
        (written,) = kit.writers.made
        assert written.data == [b"old settings"]
        assert written.end.more == {"left": "r1"}


async def test_a_gateway_that_ends_finishes_the_recording_that_is_under_way(tmp_path: Path) -> None:
    async with running_recorder(tmp_path, after_s=60.0) as kit:
        kit.robot("r1")
        kit.recorder.snapshot()
        await kit.until(lambda: bool(kit.writers.made) and bool(kit.writers.made[0].got))
        kit.say("r1", b"last words")
    (written,) = kit.writers.made
    assert written.data == [b"last words"]
    assert written.end.to_t > 0


async def test_a_capture_of_a_robot_has_its_bytes_and_what_was_said_of_it(tmp_path: Path) -> None:
    async with running_recorder(tmp_path) as kit:
        kit.robot("r1")
        kit.robot("r2")
        kit.say("r1", b"one")
        kit.say("r2", b"two")
        kit.happen("r1", EventKind.MOTION_STARTED)
        kit.happen("r2", EventKind.MOTION_STARTED)
        messages = list(kit.recorder.capture("r1", 10))
        assert {message.robot for message in messages if isinstance(message, Raw)} == {"r1"}
        assert {message.topic for message in messages if isinstance(message, Said)} == {"r1/events"}


async def test_a_stream_hands_out_what_comes_and_counts_what_a_slow_reader_loses(tmp_path: Path) -> None:
    async with running_recorder(tmp_path) as kit:
        kit.robot("r1")
        kit.robot("r2")
        kit.say("r1", b"before")
        kit.recorder.rings["r1"].online()
        with kit.recorder.streaming(lambda robot: robot == "r1") as feed:
            feed._most_bytes = 2000
            for number in range(100):
                kit.say("r1", number.to_bytes(4, "big") * 100)
                kit.say("r2", b"not wanted")
                kit.recorder.rings["r1"].close_block()
            pieces, lost = feed.pieces(), feed.lost
            assert lost > 0
            got = await taken(pieces, len(feed._waiting))
            kit.say("r1", b"after")
            kit.recorder.rings["r1"].close_block()
            got += await taken(pieces, 2)
        assert type(got[0]).__name__ == "Begin"
        told = [message for message in got if isinstance(message, Lost)]
        assert [message.n_messages for message in told] == [lost]
        assert {message.robot for message in got if isinstance(message, Raw)} == {"r1"}
        assert not kit.recorder._sinks


async def taken(pieces: AsyncIterator[bytes], count: int) -> list[Message]:
    """The next so many messages."""
    reader = SpoolReader()
    with anyio.fail_after(5):
        return [message for _ in range(count) for message in reader.feed(await anext(pieces))]
