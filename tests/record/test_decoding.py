"""Decoding: every byte stands in one row, questions are shown to decoders that need them, and plugins may fail."""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest

from gateway.core.registry import Registry
from gateway.record.captures import Capture
from gateway.record.decoding import Decoding, Row, Values, recorded_pieces
from gateway.record.pieces import Conversation, FileError, Piece, kind_of, raw_pieces
from gateway.testing.conformance import subjects
from gateway.testing.playing import turns_of
from gateway.testing.subject import Subject
from tests.record.kit import QUESTION, known_frames, known_recording
from tests.record.wire import CONTROLLER, GATEWAY, pcap, segment, session

SUBJECTS = [subject for name in Registry().names() for subject in subjects(Registry(), name)]
RAINBOW = Registry().vendor("rainbow").protocol()
FRAMES = known_frames()


def rows_of(conversation: Conversation) -> tuple[list[Row], Decoding]:
    decoding = Decoding(conversation, lambda: RAINBOW.observer(RAINBOW.options()))
    return list(decoding.rows()), decoding


@pytest.mark.parametrize("subject", SUBJECTS, ids=lambda subject: f"{subject.vendor.name}:{subject.protocol.name}")
def test_every_byte_stands_in_one_row(subject: Subject) -> None:
    junk = b"\x00junk\xff"
    pieces = [Piece("begin")]
    for turn in turns_of(subject.vectors):
        pieces += [Piece("sent", turn.asked)] if turn.asked is not None else []
        pieces += [Piece("received", turn.raw[:7]), Piece("received", turn.raw[7:])]
    pieces += [Piece("received", junk), Piece("end")]
    decoding = Decoding(Conversation("c", pieces), lambda: subject.protocol.observer(subject.protocol.options()))

    rows = list(decoding.rows())

    assert decoding.found.counts["failed"] == 0
    assert decoding.found.n_explained == decoding.found.n_received == sum(row.size for row in rows)
    at = 0
    for row in rows:
        assert row.offset == at
        at += row.size


def test_a_polled_protocol_is_shown_what_was_asked() -> None:
    asked = [piece for frame in FRAMES for piece in (Piece("sent", QUESTION), Piece("received", frame))]
    rows, _ = rows_of(Conversation("c", [Piece("begin"), *asked, Piece("end")]))
    assert [row.kind for row in rows] == ["frame"] * 4

    rows, _ = rows_of(Conversation("c", [Piece("begin"), Piece("received", FRAMES[0]), Piece("end")]))
    assert [(row.kind, row.name) for row in rows] == [("reject", "unrequested"), ("refused", "out_of_step")]


def test_where_bytes_are_missing_no_frame_reaches_over_the_gap(tmp_path: Path) -> None:
    packets = session(FRAMES, QUESTION)
    del packets[8]  # the second half of the second frame
    capture = Capture(pcap(tmp_path / "net.pcap", packets), frozenset({5000}), frozenset())

    rows, decoding = rows_of(capture.conversations[0])

    assert [(row.kind, row.size) for row in rows] == [("frame", 580), ("reject", 290), ("frame", 580), ("frame", 580)]
    assert [row.offset for row in rows] == [0, 580, 870, 1450]
    assert decoding.found.n_explained == decoding.found.n_received == 4 * 580 - 290


def test_a_recording_gives_its_bytes_with_their_sessions(tmp_path: Path) -> None:
    recording = known_recording(tmp_path / "known.mcap")
    rows, decoding = rows_of(Conversation("r1", recorded_pieces(recording, "r1")))

    assert [row.kind for row in rows] == ["frame"] * 12
    assert decoding.found.n_received == 12 * 580


def test_a_question_that_is_none_is_a_row_and_no_more(tmp_path: Path) -> None:
    external = Registry().vendor("xcore").protocol("external")
    packets = [
        segment(GATEWAY, CONTROLLER, 1, b"move_home\r"),
        segment(GATEWAY, CONTROLLER, 11, b"motor_on_state\r"),
        segment(CONTROLLER, GATEWAY, 1, b"true"),
    ]
    capture = Capture(pcap(tmp_path / "net.pcap", packets), frozenset({5000}), frozenset())
    decoding = Decoding(capture.conversations[0], lambda: external.observer(external.options()))

    rows = list(decoding.rows())

    assert [(row.kind, row.size) for row in rows] == [("sent", 0), ("frame", 4)]
    assert "move_home" in rows[0].detail


def test_a_plugin_that_fails_is_a_row_and_ends_the_session() -> None:
    class Failing:
        def feed(self, _: bytes) -> None:
            raise RuntimeError("not today")

    pieces = [Piece("begin"), Piece("received", b"x"), Piece("received", b"y"), Piece("end")]
    decoding = Decoding(Conversation("c", pieces), Failing)  # type: ignore[arg-type] # it is broken on purpose

    assert [(row.kind, row.detail) for row in decoding.rows()] == [("failed", "RuntimeError('not today')")]
    assert (decoding.found.n_received, decoding.found.n_explained) == (2, 0)


def test_values_are_read_by_group() -> None:
    rows, _ = rows_of(Conversation("c", [Piece("begin"), Piece("sent", QUESTION), Piece("received", FRAMES[0])]))
    frame = rows[0].frame
    assert frame is not None
    options = {"estop_polarity": None, **msgspec.structs.asdict(RAINBOW.options())}

    values = Values(RAINBOW, options, ["joints", "vendor"])

    assert set(values.read(frame)) == {"joints", "vendor"}
    assert "vendor" not in Values(RAINBOW, options).read(frame)


def test_what_a_file_is_follows_from_its_first_bytes(tmp_path: Path) -> None:
    raw = tmp_path / "dump.bin"
    raw.write_bytes(FRAMES[0])
    known_recording(tmp_path / "known.dat")
    damaged = tmp_path / "damaged.mcap"
    damaged.write_bytes(b"\x00MCAP")
    (tmp_path / "empty").touch()

    assert kind_of(raw) == "raw"
    assert kind_of(tmp_path / "known.dat") == "mcap"
    assert kind_of(damaged) == "mcap"
    assert kind_of(pcap(tmp_path / "net", [])) == "capture"
    for path, told in (
        (tmp_path / "none", "does not exist"),
        (tmp_path, "is a folder"),
        (tmp_path / "empty", "0 bytes"),
    ):
        with pytest.raises(FileError, match=told):
            kind_of(path)


def test_a_raw_file_is_a_stream_or_datagrams(tmp_path: Path) -> None:
    raw = tmp_path / "dump.bin"
    raw.write_bytes(b"abcdefgh")

    assert [piece.data for piece in raw_pieces(raw)] == [b"", b"abcdefgh", b""]
    assert [piece.data for piece in raw_pieces(raw, 3)] == [b"", b"abc", b"def", b"gh", b""]
