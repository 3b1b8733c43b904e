"""A recording is made of what a gateway hands over: bytes, marks, samples; a mistake of a plugin costs its samples."""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest

from gateway.record.chunks import pack
from gateway.record.making import Making
from gateway.record.mcapfile import Mark, Writer
from gateway.record.reading import Recording, open_recording
from gateway.record.spool import End, Message, Raw, Said, SpoolError
from tests.record.kit import STEP, T0, begin, is_canonical, known_chunks, known_recording, recorded_samples, robots_toml


def made(path: Path, *messages: Message) -> tuple[Recording, list[str]]:
    """A file of some messages, and its notes."""
    with Writer(path) as writer:
        making = Making(writer)
        for message in messages:
            making.take(message)
        assert making.finished
    return open_recording(path), making.notes


def marks_of(recording: Recording) -> list[Mark]:
    return [msgspec.json.decode(entry.data, type=Mark) for entry in recording.entries(["r1/session"])]


def test_samples_are_written_from_the_beginning_on_with_the_states_that_stood_then(tmp_path: Path) -> None:
    recording = known_recording(tmp_path / "known.mcap", from_t=T0 + 6 * STEP)

    times = {name: sample["t"] for name, sample in recorded_samples(recording).items()}

    assert min(times[name] for name in times if name[0] == "r1/joints") == T0 + 6 * STEP  # type: ignore[type-var]
    stood = [name[0] for name, t in times.items() if isinstance(t, int) and t < T0 + 6 * STEP]
    assert stood
    assert set(stood) <= {"r1/status", "r1/safety", "r1/io", "r1/analog"}
    assert len(stood) == len(set(stood))


def test_a_clock_that_is_set_back_after_the_beginning_leaves_no_sample_out(tmp_path: Path) -> None:
    chunks = known_chunks(10)
    back = [msgspec.structs.replace(chunk, t=chunk.t - 3_600_000_000) for chunk in chunks[8:]]
    block = pack([*chunks[:8], *back], (), ())
    recording, _ = made(
        tmp_path / "back.mcap",
        begin(robots_toml("rainbow", "reqdata"), from_t=T0),
        Raw(robot="r1", block=block),
        End(to_t=T0),
    )

    numbers = [name[2] for name in recorded_samples(recording) if name[0] == "r1/joints"]
    assert len(numbers) == sum(chunk.kind == "received" for chunk in chunks)


def test_a_recording_that_begins_in_a_session_says_so_and_goes_on_numbering(tmp_path: Path) -> None:
    chunks = known_chunks(10)
    opening = tuple(chunks[:3])
    recording, _ = made(
        tmp_path / "middle.mcap",
        begin(robots_toml("rainbow", "reqdata")),
        Raw(robot="r1", block=pack(chunks[11:], (), opening)),
        End(to_t=T0),
    )

    assert [mark.kind for mark in marks_of(recording)] == ["opening", "resume"]
    assert [name[2] for name in recorded_samples(recording) if name[0] == "r1/joints"] == [6, 7, 8, 9, 10]


def test_without_its_plugin_the_bytes_are_written_and_the_reason_is_told(tmp_path: Path) -> None:
    recording, notes = made(
        tmp_path / "kilo.mcap",
        begin(robots_toml("kilo", "push")),
        Raw(robot="r1", block=pack(known_chunks(3), (), ())),
        End(to_t=T0),
    )

    assert len(notes) == 1
    assert notes[0].startswith("r1: no samples are written: its vendor 'kilo' is not installed here")
    assert recording.topics["r1/raw/received"] == 3
    assert not any(map(is_canonical, recording.entries()))


def test_a_plugin_that_fails_costs_the_samples_that_follow(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> None:
        raise RuntimeError("not today")

    with Writer(tmp_path / "broken.mcap") as writer:
        making = Making(writer)
        making.take(begin(robots_toml("rainbow", "reqdata")))
        chunks = known_chunks(6)
        making.take(Raw(robot="r1", block=pack(chunks[:7], (), ())))
        monkeypatch.setattr("gateway.record.replayer.Replayer.play", fail)
        making.take(Raw(robot="r1", block=pack(chunks[7:], (), ())))
        making.take(End(to_t=T0))

    recording = open_recording(tmp_path / "broken.mcap")

    assert making.notes == ["r1: its samples end here, the plugin failed: RuntimeError('not today')"]
    assert recording.topics["r1/raw/received"] == 6
    assert recording.topics["r1/joints"] == 3


def test_what_was_told_is_written_as_it_was(tmp_path: Path) -> None:
    data = b'{"any":"thing"}'
    recording, _ = made(
        tmp_path / "told.mcap",
        begin(robots_toml("rainbow", "reqdata")),
        Said(topic="r1/link", t=T0, seq=4, data=data),
        End(to_t=T0 + 1, more={"again": "link.lost r1"}),
    )

    assert [(entry.t, entry.topic, entry.index, entry.data) for entry in recording.entries()] == [
        (T0, "r1/link", 4, data)
    ]
    assert recording.about["to"] == str(T0 + 1)
    assert recording.about["again"] == "link.lost r1"


def test_the_first_message_must_be_the_beginning(tmp_path: Path) -> None:
    with Writer(tmp_path / "none.mcap") as writer, pytest.raises(SpoolError, match="comes before Begin"):
        Making(writer).take(End(to_t=T0))

    assert list(tmp_path.iterdir()) == []
