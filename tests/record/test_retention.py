"""Which recordings are kept: by number, size and age, and never a file that the recorder did not name."""

from __future__ import annotations

import os
from pathlib import Path

from gateway.record import retention
from gateway.record.settings import RecorderSettings

NOW_S = 1_800_000_000.0


def name(number: int) -> str:
    return f"2026-11-22T03-04-{number:02}Z_r1_estop.pressed.mcap"


def make(folder: Path, count: int, n_bytes: int = 10) -> None:
    """Recordings, the highest number the newest, an hour apart."""
    for number in range(count):
        path = folder / name(number)
        path.write_bytes(bytes(n_bytes))
        at_s = NOW_S - 3600 * (count - 1 - number)
        os.utime(path, (at_s, at_s))


def left(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_the_newest_files_are_kept_up_to_their_number(tmp_path: Path) -> None:
    make(tmp_path, 10)
    gone = retention.tidy(tmp_path, RecorderSettings(keep_files=3), NOW_S)
    assert len(gone) == 7
    assert left(tmp_path) == [name(7), name(8), name(9)]


def test_the_newest_files_are_kept_up_to_their_size(tmp_path: Path) -> None:
    make(tmp_path, 5, 100)
    retention.tidy(tmp_path, RecorderSettings(keep_bytes=250), NOW_S)
    assert left(tmp_path) == [name(3), name(4)]


def test_files_that_are_too_old_go(tmp_path: Path) -> None:
    make(tmp_path, 5)
    retention.tidy(tmp_path, RecorderSettings(keep_s=2.5 * 3600), NOW_S)
    assert left(tmp_path) == [name(2), name(3), name(4)]


def test_the_newest_file_stays_however_large_and_old_it_is(tmp_path: Path) -> None:
    make(tmp_path, 1, 1000)
    assert retention.tidy(tmp_path, RecorderSettings(keep_bytes=1, keep_s=1.0), NOW_S + 1e6) == []


def test_files_of_others_are_never_touched_nor_counted(tmp_path: Path) -> None:
    others = ["mine.mcap", "record_2026-11-22T03-04-05Z.mcap", "notes.txt", f"copy of {name(1)}", f"{name(1)}.bak"]
    for other in others:
        (tmp_path / other).write_bytes(bytes(1000))
        os.utime(tmp_path / other, (0, 0))
    make(tmp_path, 2)
    retention.tidy(tmp_path, RecorderSettings(keep_files=1, keep_bytes=1), NOW_S)
    assert left(tmp_path) == sorted([*others, name(1)])


def test_a_second_recording_of_one_second_is_a_recording_too(tmp_path: Path) -> None:
    (tmp_path / "2026-11-22T03-04-05Z-2_cell_snapshot.mcap").write_bytes(b"")
    assert len(retention.recordings(tmp_path)) == 1


def test_unfinished_files_are_swept_unless_somebody_writes_them(tmp_path: Path) -> None:
    dead, written, other = (tmp_path / f"{name(1)}.part", tmp_path / f"{name(2)}.part", tmp_path / "mine.part")
    for path in (dead, written, other):
        path.write_bytes(b"half")
    descriptor = retention.hold(written)
    try:
        assert retention.sweep(tmp_path) == [dead]
    finally:
        os.close(descriptor)
    assert left(tmp_path) == sorted([written.name, other.name])
    assert retention.sweep(tmp_path) == [written]
