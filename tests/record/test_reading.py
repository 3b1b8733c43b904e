"""Recordings are read whatever has happened to the file: what is good is read, and what is wrong is said."""

from __future__ import annotations

import random
from pathlib import Path

import pytest
from mcap.reader import make_reader
from mcap.writer import Writer as McapWriter

from gateway.record.making import Making
from gateway.record.mcapfile import Writer
from gateway.record.reading import Entry, Recording, RecordingError, open_recording, said_of
from gateway.record.settings import PART
from gateway.record.spool import End
from tests.record.kit import STEP, T0, begin, known_chunks, known_recording, replayed, robots_toml


def read(path: Path) -> tuple[Recording, list[Entry]]:
    """Open a recording and read all of it."""
    recording = open_recording(path)
    return recording, list(recording.entries())


def read_if_any(path: Path) -> tuple[Recording, list[Entry]] | None:
    """The same; None where it says in words that nothing can be read."""
    try:
        return read(path)
    except RecordingError:
        return None


def reason_of(path: Path) -> str:
    with pytest.raises(RecordingError) as error:
        open_recording(path)
    return error.value.reason


@pytest.fixture
def known(tmp_path: Path) -> Path:
    path = tmp_path / "known.mcap"
    known_recording(path)
    return path


def test_what_was_written_is_read_in_the_order_of_time(known: Path) -> None:
    recording, entries = read(known)

    assert recording.problem == ""
    assert recording.names == ["r1"]
    assert recording.about["trigger"] == "test"
    assert [entry.t for entry in entries] == sorted(entry.t for entry in entries)
    received = [entry.data for entry in entries if entry.group == "raw/received"]
    assert received == [chunk.data for chunk in known_chunks(12) if chunk.kind == "received"]
    assert recording.begins_t == T0
    assert recording.last_t == T0 + 12 * STEP
    assert said_of(recording).endswith("0.1 s; test; gateway 0.0.0")


def test_only_some_topics_are_read(known: Path) -> None:
    recording = open_recording(known)

    assert {entry.topic for entry in recording.entries(["r1/joints", "r1/tcp"])} == {"r1/joints", "r1/tcp"}


@pytest.mark.limit(60)
def test_a_file_that_is_cut_anywhere_is_read_as_far_as_it_goes(known: Path, tmp_path: Path) -> None:
    whole = known.read_bytes()
    _, everything = read(known)
    path = tmp_path / "cut.mcap"
    most = 0
    for size in sorted({*range(1, len(whole), 41), *range(len(whole) - 150, len(whole))}):
        path.write_bytes(whole[:size])
        found = read_if_any(path)
        if found is None:
            continue
        recording, entries = found
        assert recording.problem
        assert set(entries) <= set(everything)
        most = max(most, len(entries))
    assert most == len(everything)


@pytest.mark.limit(60)
def test_a_file_with_a_damaged_byte_anywhere_is_read_as_far_as_it_is_good(known: Path, tmp_path: Path) -> None:
    whole = known.read_bytes()
    _, everything = read(known)
    path = tmp_path / "damaged.mcap"
    dice = random.Random(8)  # noqa: S311 - nothing secret
    for at in sorted({*range(64), *dice.sample(range(len(whole)), 500), *range(len(whole) - 64, len(whole))}):
        damaged = bytearray(whole)
        damaged[at] ^= dice.randrange(1, 256)
        path.write_bytes(damaged)
        found = read_if_any(path)
        if found is None:
            continue
        recording, entries = found
        assert recording.problem, at
        data = {(entry.t, entry.data) for entry in everything}
        assert {(entry.t, entry.data) for entry in entries} <= data, at


def test_a_damaged_part_costs_itself_alone(tmp_path: Path) -> None:
    path = tmp_path / "long.mcap"
    recording = known_recording(path, n_frames=1500)
    n_all = len(list(recording.entries()))
    whole = bytearray(path.read_bytes())
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    chunks = summary.chunk_indexes
    assert len(chunks) > 2
    whole[chunks[1].chunk_start_offset + 200] ^= 0xFF
    path.write_bytes(whole)

    recording, entries = read(path)

    assert "1 of its parts are damaged and left out" in recording.problem
    assert 0 < len(entries) < n_all
    _, replay = replayed(recording)
    assert replay.tallies["r1"].problem == ""
    assert replay.tallies["r1"].frames > 100


def test_a_file_that_was_being_written_when_the_gateway_was_killed_is_read(tmp_path: Path) -> None:
    path = tmp_path / "killed.mcap"
    recording = known_recording(tmp_path / "whole.mcap", n_frames=1500)
    part = path.with_name(path.name + PART)
    part.write_bytes((tmp_path / "whole.mcap").read_bytes()[: (tmp_path / "whole.mcap").stat().st_size // 2])

    found, entries = read(part)

    assert "cut off or damaged" in found.problem
    assert 0 < len(entries) < sum(recording.topics.values())


def test_a_foreign_mcap_is_named_as_such(tmp_path: Path) -> None:
    path = tmp_path / "ros.mcap"
    with path.open("wb") as file:
        writer = McapWriter(file)
        writer.start(profile="ros2", library="other")
        channel = writer.register_channel("/tf", "cdr", 0)
        writer.add_message(channel, 1, b"x", 1)
        writer.finish()  # type: ignore[no-untyped-call]

    assert reason_of(path) == (
        "is an MCAP file, but no recording of robot-gateway: it has no topic ROBOT/raw/received; its topics are /tf"
    )


@pytest.mark.parametrize("layout", ["0", "2"])
def test_another_layout_is_not_guessed_at(layout: str, tmp_path: Path) -> None:
    path = tmp_path / "other.mcap"
    with path.open("wb") as file:
        writer = McapWriter(file)
        writer.start()
        writer.add_metadata("robot-gateway", {"layout": layout, "gateway": "9.0.0"})
        writer.finish()  # type: ignore[no-untyped-call]

    assert reason_of(path) == (
        f"has layout '{layout}', and this gateway reads layout '1': use the version that made it, 9.0.0"
    )


def test_a_recording_in_which_no_robot_said_anything_is_one(tmp_path: Path) -> None:
    path = tmp_path / "quiet.mcap"
    with Writer(path) as writer:
        making = Making(writer)
        making.take(begin(robots_toml("rainbow", "reqdata"), T0))
        making.take(End(to_t=T0))

    recording, entries = read(path)

    assert (recording.names, entries, recording.problem) == ([], [], "")
    assert recording.begins_t == T0


def test_what_is_no_recording_is_said_in_words(tmp_path: Path) -> None:
    empty, text = tmp_path / "empty.mcap", tmp_path / "text.mcap"
    empty.touch()
    text.write_text("hello, this is no recording")

    assert reason_of(tmp_path / "nothing.mcap") == "does not exist"
    assert reason_of(tmp_path) == "is a folder; name the file in it"
    assert reason_of(empty) == "is empty, it has 0 bytes"
    assert reason_of(text) == "is no MCAP file, or its first bytes are damaged"
    text.write_bytes(b"\x89MCAP0\r\n")
    assert reason_of(text) == "holds nothing that can be read: it ends after 8 bytes, before its index"


@pytest.mark.parametrize(
    ("error", "told"),
    [
        (PermissionError(13, "Permission denied"), "may not be read by this user; look at: ls -l"),
        (OSError(5, "Input/output error"), "cannot be read: Input/output error"),
    ],
)
def test_a_file_that_may_not_be_read_is_said_in_words(
    error: OSError, told: str, known: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise error

    monkeypatch.setattr(Path, "open", refuse)

    assert reason_of(known).startswith(told)
