"""`decode` as a user runs it: recordings, captures and raw streams as tables, JSON and CSV."""

from __future__ import annotations

import csv
from pathlib import Path

import msgspec
import pytest

from tests.cli.command import Finished, command_here
from tests.record.kit import QUESTION, known_frames, known_recording, robots_toml
from tests.record.wire import CONTROLLER, GATEWAY, pcap, segment, session

FRAMES = known_frames()
JUNK = b"\x01\x02junk"


@pytest.fixture
def dump(tmp_path: Path) -> Path:
    path = tmp_path / "dump.bin"
    path.write_bytes(FRAMES[0] + JUNK + FRAMES[1] + FRAMES[2][:100])
    return path


@pytest.fixture
def known(tmp_path: Path) -> Path:
    path = tmp_path / "known.mcap"
    known_recording(path, count=2)
    return path


def rows(done: Finished) -> list[dict[str, object]]:
    return [msgspec.json.decode(line) for line in done.out.splitlines()]


def test_a_raw_stream_is_a_table_in_which_every_byte_stands(dump: Path) -> None:
    done = command_here("decode", "rainbow", str(dump))

    assert done.code == 0, done.err
    lines = [line.split() for line in done.out.splitlines()]
    assert [(line[0], line[2], line[3]) for line in lines[:4]] == [
        ("0", "frame", "580"),
        ("580", "reject", "6"),
        ("586", "frame", "580"),
        ("1166", "reject", "100"),
    ]
    assert done.out.splitlines()[-1] == "2 frame, rejected: 1 junk, 1 truncated, 1266 bytes, all explained"


def test_the_same_as_json_whose_sizes_make_up_the_file(dump: Path) -> None:
    found = rows(command_here("decode", "rainbow:reqdata", str(dump), "--json", "--values"))

    *events, summary = found
    assert sum(int(str(one["size"])) for one in events) == dump.stat().st_size == summary["received"]
    assert summary["rejects"] == {"junk": 1, "truncated": 1}
    assert [one["name"] for one in events if one["kind"] == "reject"] == ["junk", "truncated"]
    values = events[0]["values"]
    assert isinstance(values, dict)
    assert "vendor" not in values
    assert len(values["joints"]["position"]) == 6


def test_only_what_is_no_frame_is_shown(dump: Path) -> None:
    lines = command_here("decode", "rainbow", str(dump), "--rejects").out.splitlines()

    assert [line.split()[2] for line in lines[:-1]] == ["reject", "reject"]
    assert "the header promises 580 bytes, 100 came" in lines[1]


def test_values_stand_below_their_frame_with_units(dump: Path) -> None:
    out = command_here("decode", "rainbow", str(dump), "--group", "joints").out.splitlines()

    assert any(line.startswith("    joints.position ") and line.endswith(" rad") for line in out)
    assert not any("tcp." in line for line in out)


def test_chosen_values_are_csv(known: Path) -> None:
    done = command_here("decode", str(known), "--csv", "joints.position,vendor.op_stat_self_collision")

    table = list(csv.reader(done.out.splitlines()))
    assert table[0][:4] == ["conversation", "offset", "t", "joints.position.0"]
    assert len(table) == 1 + 2 * 12
    assert {row[0] for row in table[1:]} == {"r1", "r2"}
    assert "r1  12 frame" in done.err


def test_csv_of_values_that_no_frame_has_says_what_there_is(known: Path) -> None:
    done = command_here("decode", str(known), "--csv", "joints.colour")

    assert done.code == 2
    assert "no frame has joints.colour; the first has, for example, joints.position.0" in done.err


def test_a_recording_needs_no_vendor_and_may_have_another(known: Path) -> None:
    own = command_here("decode", str(known), "--robot", "r2")
    other = command_here("decode", "fairino:legacy", str(known))

    assert own.code == 0, own.err
    assert own.out.splitlines()[0] == "r2  rainbow:reqdata"
    assert own.out.splitlines()[-1] == "12 frame, 0 rejected, 6960 bytes, all explained"
    assert other.code == 1
    assert "no frame is in it" in other.err


def test_a_capture_is_read_by_its_connections(tmp_path: Path) -> None:
    path = pcap(tmp_path / "net.pcap", session(FRAMES, QUESTION))

    done = command_here("decode", "rainbow", str(path), "--port", "5000")
    missed = command_here("decode", "rainbow", str(path), "--port", "7")

    assert done.code == 0, done.err
    assert done.out.splitlines()[0] == "192.168.58.10:40000 - 192.168.58.2:5000"
    assert done.out.splitlines()[-1] == "4 frame, 0 rejected, 2320 bytes, all explained"
    assert missed.code == 1
    assert "no connection with a controller at port 7; it has TCP 192.168.58.10:40000 - 192.168.58.2:5000" in missed.err


def test_a_protocol_without_a_port_needs_one_and_is_shown_its_questions(tmp_path: Path) -> None:
    packets = [segment(GATEWAY, CONTROLLER, 1, b"jnt_pos\r"), segment(CONTROLLER, GATEWAY, 1, b"1,2,3,4,5,6,7\r")]
    path = pcap(tmp_path / "net.pcap", packets)

    unknown = command_here("decode", "xcore:external", str(path))
    done = command_here(
        "decode", "xcore:external", str(path), "--host", "192.168.58.2", "--option", "axes=7", "--group", "joints"
    )

    assert unknown.code == 2
    assert "external has no port of its own" in unknown.err
    assert done.code == 0, done.err
    assert "1 frame, 0 rejected, 14 bytes, all explained" in done.out
    assert "joints.position" in done.out


def test_datagrams_of_a_raw_file_are_read_one_by_one(tmp_path: Path) -> None:
    path = tmp_path / "dump.bin"
    path.write_bytes(FRAMES[0] + FRAMES[1])

    done = command_here("decode", "rainbow", str(path), "--datagrams", "500")

    assert "truncated" in done.out
    assert "1160 bytes, all explained" in done.out


def test_a_vendor_that_is_not_installed_leaves_its_robot_out(tmp_path: Path) -> None:
    path = tmp_path / "known.mcap"
    robots = robots_toml("rainbow", "reqdata") + robots_toml("kilo", "push").replace('"r1"', '"r2"')
    known_recording(path, count=2, robots=robots)

    done = command_here("decode", str(path))

    assert done.code == 0
    assert "left out: r2: its vendor 'kilo' is not installed here" in done.err
    assert done.out.splitlines()[0] == "r1  rainbow:reqdata"


@pytest.mark.parametrize(
    ("arguments", "code", "told"),
    [
        (["DUMP"], 2, "does not say what it holds: name it, decode VENDOR[:PROTOCOL] FILE; vendors are fairino"),
        (["rainbw", "DUMP"], 1, "rainbow"),
        (["rainbow:gossip", "DUMP"], 2, "rainbow has no protocol 'gossip'; it has reqdata"),
        (["rainbow", "DUMP", "--group", "jonts"], 2, "there is no such group; there are joints"),
        (["rainbow", "DUMP", "--csv", "joints.position", "--json"], 2, "leave out --json"),
        (["rainbow", "DUMP", "--option", "colour=red"], 2, "the options of reqdata are"),
        (["rainbow", "DUMP", "--option", "terminator"], 2, "write KEY=VALUE"),
        (["fairino:cnde", "DUMP", "--option", "period_ms=soon"], 2, "--option period_ms"),
        (["fairino:cnde", "DUMP", "--option", "states=program_state,program_state"], 2, "stands twice"),
        (["rainbow", "/nowhere.bin"], 1, "/nowhere.bin: does not exist"),
        (["rainbow", "/"], 1, "is a folder; name the file in it"),
        (["rainbow", "EMPTY"], 1, "is empty, it has 0 bytes"),
        (["rainbow", "TEXT"], 1, "no frame is in it: is it really what"),
        (["xcore:external", "TEXT"], 1, "do not say what they answer"),
        (["KNOWN", "--option", "terminator=x"], 2, "--option belongs to a protocol"),
        (["KNOWN", "--robot", "r7"], 2, "holds nothing of a robot 'r7'"),
        (["rainbow", "DUMP", "--vendor-dir", "/nowhere"], 78, "/nowhere"),
        (["BROKEN"], 1, "is no MCAP file"),
    ],
)
def test_wrong_usage_and_other_files_are_said_in_words(
    arguments: list[str], code: int, told: str, dump: Path, known: Path, tmp_path: Path
) -> None:
    files = {"DUMP": dump, "KNOWN": known, "EMPTY": tmp_path / "empty", "TEXT": tmp_path / "text.txt"}
    files["BROKEN"] = tmp_path / "broken.mcap"
    files["EMPTY"].touch()
    files["TEXT"].write_text("this is text")
    files["BROKEN"].write_text("this is text")

    done = command_here("decode", *(str(files.get(argument, argument)) for argument in arguments))

    assert told in done.err
    assert done.code == code
    assert "Traceback" not in done.err
