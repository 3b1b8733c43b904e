"""The files are MCAP as everybody reads it, and are whole or not there."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from jsonschema import Draft202012Validator
from mcap.reader import make_reader

from gateway.record.mcapfile import LAYOUT, Mark, Writer
from gateway.record.settings import PART
from tests.api.test_plain_schemas import faults
from tests.record.kit import T0, known_chunks, known_recording


def test_another_reader_finds_the_channels_the_counts_and_the_schemas(tmp_path: Path) -> None:
    path = tmp_path / "known.mcap"
    known_recording(path, count=2)

    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        header, summary = reader.get_header(), reader.get_summary()
        messages = list(reader.iter_messages())
        metadata = [one for one in reader.iter_metadata() if one.name == "robot-gateway"]
        attachments = list(reader.iter_attachments())

    assert summary is not None
    assert summary.statistics is not None
    assert header.profile == "robot-gateway"
    channels = {channel.topic: channel for channel in summary.channels.values()}
    assert {"r1/raw/received", "r1/raw/sent", "r1/session", "r1/joints", "r1/events", "r2/tcp"} <= set(channels)
    assert channels["r1/raw/received"].message_encoding == "octets"
    assert channels["r1/joints"].message_encoding == "json"
    assert channels["r1/joints"].schema_id == channels["r2/joints"].schema_id != 0
    assert summary.statistics.message_count == len(messages)
    assert sum(channel.topic == "r1/raw/received" for _, channel, _ in messages) == 12
    assert {key: value for one in metadata for key, value in one.metadata.items()}["layout"] == LAYOUT
    assert [attachment.name for attachment in attachments] == ["gateway.toml"]
    checked = set()
    for schema, channel, message in messages:
        if schema is None:
            assert "/raw/" in channel.topic
            continue
        assert schema.encoding == "jsonschema"
        rules = json.loads(schema.data)
        if schema.id not in checked:
            checked.add(schema.id)
            Draft202012Validator.check_schema(rules)
            assert list(faults(rules)) == []
        told = json.loads(message.data)
        assert told["topic"] == channel.topic if "topic" in told else True


def test_raw_bytes_are_as_they_were(tmp_path: Path) -> None:
    path = tmp_path / "known.mcap"
    known_recording(path)

    with path.open("rb") as file:
        raw = [message for _, channel, message in make_reader(file).iter_messages(["r1/raw/received"])]

    wanted = [chunk for chunk in known_chunks(12) if chunk.kind == "received"]
    assert [(message.log_time, message.data) for message in raw] == [(chunk.t * 1000, chunk.data) for chunk in wanted]
    assert [message.sequence for message in raw] == sorted(message.sequence for message in raw)


def test_a_file_has_its_name_only_when_it_is_whole(tmp_path: Path) -> None:
    path = tmp_path / "one.mcap"
    with Writer(path) as writer:
        writer.raw("r1", "received", T0, b"x", 1)
        writer.mark("r1", T0, Mark(kind="end", epoch="b.1"), 2)
        assert [one.name for one in tmp_path.iterdir()] == [f"one.mcap{PART}"]
        writer.finish()

    assert [one.name for one in tmp_path.iterdir()] == ["one.mcap"]


def test_a_file_that_was_not_finished_leaves_nothing(tmp_path: Path) -> None:
    with Writer(tmp_path / "one.mcap") as writer:
        writer.raw("r1", "received", T0, b"x", 1)

    assert list(tmp_path.iterdir()) == []


def test_a_full_disk_is_an_error_and_leaves_nothing(tmp_path: Path) -> None:
    writer = Writer(tmp_path / "one.mcap")
    full = Path("/dev/full").open("wb")  # noqa: SIM115 - closed by the writer
    writer._file.close()
    writer._file = full
    writer._writer._Writer__stream = full  # type: ignore[attr-defined] # the library's own

    def write() -> None:
        with writer:
            for number in range(40):
                writer.raw("r1", "received", T0, bytes(range(256)) * 256, number)
            writer.finish()

    with pytest.raises(OSError, match="No space left"):
        write()

    assert list(tmp_path.iterdir()) == []


def test_a_file_that_is_there_is_not_written_over(tmp_path: Path) -> None:
    (tmp_path / f"one.mcap{PART}").write_text("another one is at it")

    with pytest.raises(FileExistsError):
        Writer(tmp_path / "one.mcap")
