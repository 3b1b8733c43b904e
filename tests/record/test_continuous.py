"""Continuous recording: one file after the other, nothing twice and nothing left out."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import anyio
import pytest
from mcap.reader import make_reader

from gateway.record.chunks import pack
from gateway.record.continuous import OVERLAP_S, Continuous, Limits
from gateway.record.mcapfile import Writer
from gateway.record.reading import open_recording
from gateway.record.recorder import Recorder
from gateway.record.settings import PART
from gateway.record.spool import Lost, Raw, SpoolReader
from gateway.testing.cell import virtual_cell
from tests.record.kit import T0, begin, known_chunks, robots_toml


class Time:
    """A clock that is moved by hand."""

    def __init__(self) -> None:
        self.s = 0.0

    def now_s(self) -> float:
        return self.s


async def listen(recorder: Recorder, seconds: float, writing: Continuous, time: Time) -> None:
    """Write what a recorder streams."""
    reader, began_s = SpoolReader(), anyio.current_time()
    with anyio.move_on_after(seconds), recorder.streaming(lambda _: True) as feed:
        async for piece in feed.pieces():
            for message in reader.feed(piece):
                writing.take(message)
            time.s = anyio.current_time() - began_s
            writing.look()
    writing.finish()


def samples(path: Path, topic: str) -> list[tuple[str, int]]:
    """The samples of a topic in a file, by epoch and number."""
    with path.open("rb") as file:
        found = make_reader(file, validate_crcs=True).iter_messages([topic])
        return [(str(channel.topic), message.sequence) for _, channel, message in found]


@pytest.mark.limit(40)
async def test_the_samples_of_all_files_together_are_each_there_once(tmp_path: Path) -> None:
    async with virtual_cell("fairino", protocol="cnde", count=2, scenario="steady") as cell:
        await anyio.sleep(1.5)
        recorder, time = cell.gateway.recorder, Time()
        assert recorder is not None
        writing = Continuous(
            tmp_path, ("*",), Limits(seconds=2.0), samples=True, now_s=time.now_s, utc_us=recorder._clock.utc_us
        )
        await listen(recorder, 2.0 + OVERLAP_S + 3.0, writing, time)
    files = sorted(tmp_path.iterdir())  # noqa: ASYNC240
    assert writing.tally.n_files == len(files) >= 2
    for robot in ("r1", "r2"):
        numbers = [number for path in files for _, number in samples(path, f"{robot}/joints")]
        assert numbers == list(range(numbers[0], numbers[0] + len(numbers)))
        assert len(numbers) > 100


@pytest.mark.limit(30)
async def test_only_the_topics_that_are_asked_for_are_written_beside_the_bytes(tmp_path: Path) -> None:
    async with virtual_cell("fairino", protocol="cnde", scenario="steady") as cell:
        await anyio.sleep(1.0)
        recorder, time = cell.gateway.recorder, Time()
        assert recorder is not None
        writing = Continuous(
            tmp_path, ("r1/joints",), Limits(), samples=True, now_s=time.now_s, utc_us=recorder._clock.utc_us
        )
        await listen(recorder, 2.5, writing, time)
        raw = Continuous(tmp_path, ("*",), Limits(), samples=False, now_s=time.now_s, utc_us=recorder._clock.utc_us)
        await listen(recorder, 2.5, raw, time)
    topics = [counted(path) for path in sorted(tmp_path.iterdir())]  # noqa: ASYNC240
    assert set(topics[0]) == {"r1/raw/received", "r1/raw/sent", "r1/session", "r1/joints"}
    assert "r1/joints" not in topics[1]
    assert "r1/link_stats" in topics[1]


def counted(path: Path) -> Counter[str]:
    with path.open("rb") as file:
        return Counter(channel.topic for _, channel, _ in make_reader(file).iter_messages())


@pytest.mark.limit(30)
async def test_a_file_is_full_at_its_size_and_says_what_was_dropped(tmp_path: Path) -> None:
    async with virtual_cell("fairino", protocol="cnde", scenario="steady") as cell:
        await anyio.sleep(1.0)
        recorder, time = cell.gateway.recorder, Time()
        assert recorder is not None
        limits = Limits(n_bytes=1)
        writing = Continuous(tmp_path, ("*",), limits, samples=False, now_s=time.now_s, utc_us=recorder._clock.utc_us)
        with recorder.streaming(lambda _: True) as feed:
            (begin,) = SpoolReader().feed(feed._waiting[0])
        writing.take(begin)
        writing.take(Lost(n_messages=3, n_bytes=100))
        writing.look()
        writing.finish()
    assert writing.tally.lost == 3
    first = min(tmp_path.iterdir())  # noqa: ASYNC240
    with first.open("rb") as file:
        metadata = {key: value for one in make_reader(file).iter_metadata() for key, value in one.metadata.items()}
    assert metadata["dropped"] == "3"


def test_what_was_written_before_the_disk_was_full_stays_and_can_be_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object) -> None:
        raise OSError(28, "No space left on device")

    writing = Continuous(tmp_path, ("*",), Limits(), samples=False, now_s=lambda: 0.0, utc_us=lambda: T0)
    writing.take(begin(robots_toml("rainbow", "reqdata")))
    block = pack(known_chunks(3000), (), ())
    writing.take(Raw(robot="r1", block=block))
    monkeypatch.setattr(Writer, "raw", fail)
    with pytest.raises(OSError, match="No space left"):
        writing.take(Raw(robot="r1", block=block))

    (left,) = writing.leave()

    assert list(tmp_path.iterdir()) == [left]
    assert left.name.endswith(PART)
    assert open_recording(left).topics["r1/raw/received"] > 100
