"""`replay` as a user runs it: what happened, the doors on a recording, and what a plugin now says differently."""

from __future__ import annotations

import re
import signal
import subprocess
import urllib.request
from datetime import datetime
from pathlib import Path

import anyio
import msgspec
import pytest

from gateway.cli.moments import moment
from gateway.client import connect
from tests.cli.command import PYTHON, ROOT, command_here, environment
from tests.record.kit import STEP, T0, known_recording, robots_toml


@pytest.fixture
def known(tmp_path: Path) -> Path:
    path = tmp_path / "known.mcap"
    known_recording(path, count=2)
    return path


def test_the_events_and_a_summary_of_each_robot_are_printed(known: Path) -> None:
    done = command_here("replay", str(known))

    assert done.code == 0, done.err
    lines = done.out.splitlines()
    assert "r1  estop.pressed" in lines[0]
    assert lines[1].startswith("r1  rainbow:reqdata  1 session, 12 frames, 0 rejected, 1 events, 6960 bytes received")
    assert lines[2].startswith("r2  rainbow:reqdata  1 session, 12 frames")


def test_a_part_of_it_is_printed_with_the_samples_that_are_asked_for(known: Path) -> None:
    done = command_here("replay", str(known), "--from", "0.05", "--to", "-0.03", "--topic", "r2/joints", "--json")

    assert done.code == 0, done.err
    lines = [msgspec.json.decode(line) for line in done.out.splitlines()]
    samples = [line for line in lines if "topic" in line]
    assert [line["t"] for line in samples] == [T0 + number * STEP for number in range(5, 10)]
    assert {line["origin"] for line in samples} == {"replay"}
    assert [line["robot"] for line in lines if "sessions" in line] == ["r1", "r2"]


def test_only_one_robot_is_replayed(known: Path) -> None:
    done = command_here("replay", str(known), "--robot", "r2")

    assert [line[:2] for line in done.out.splitlines()] == ["r2"]


def test_a_replay_in_real_time_takes_its_time(known: Path) -> None:
    done = command_here("replay", str(known), "--speed", "0.5", "--topic", "r1/tcp", "--json")

    assert done.code == 0, done.err
    assert done.out.count('"topic":"r1/tcp"') == 12


def test_the_same_decoders_tell_the_same(known: Path) -> None:
    done = command_here("replay", str(known), "--diff")

    assert done.code == 0, done.err
    assert "r1/joints  12 the same" in done.out
    assert done.out.splitlines()[-1].endswith("samples are the same, 0 are not")


def test_other_options_give_other_samples_which_are_named(known: Path, tmp_path: Path) -> None:
    other = tmp_path / "gateway.toml"
    other.write_text(
        '[[robots]]\nname = "r1"\nvendor = "rainbow"\nhost = "127.0.0.1"\nport = 9\nestop_polarity = "active_high"\n'
    )

    done = command_here("replay", str(known), "--diff", "--config", str(other))
    told = msgspec.json.decode(command_here("replay", str(known), "--diff", "--config", str(other), "--json").out)

    assert done.code == 1, done.err
    assert re.search(r"data\.e_stopped  \d+ times, first at \d\d:\d\d:\d\d\.\d{3}: null → (true|false)", done.out)
    assert "r2/joints  12 the same" in done.out
    assert {change["topic"].split("/")[0] for change in told["changes"]} == {"r1"}
    assert any(change["what"] == "data.e_stopped" and change["from"] is None for change in told["changes"])


def test_a_vendor_that_is_not_installed_is_said_and_the_others_go_on(tmp_path: Path) -> None:
    robots = robots_toml("rainbow", "reqdata") + robots_toml("kilo", "push").replace('"r1"', '"r2"')
    path = tmp_path / "known.mcap"
    known_recording(path, count=2, robots=robots)

    done = command_here("replay", str(path))

    assert done.code == 0
    assert done.out.splitlines()[-1].startswith("r1  rainbow:reqdata  1 session, 12 frames")
    assert "left out: r2: its vendor 'kilo' is not installed here" in done.err
    assert command_here("replay", str(path), "--diff").code == 1  # nobody may think that r2 is the same
    assert command_here("replay", str(path), "--diff", "--robot", "r1").code == 0
    alone = command_here("replay", str(path), "--robot", "r2")
    assert (alone.code, alone.out) == (1, "")
    assert "none of its robots can be replayed" in alone.err


@pytest.mark.parametrize(
    ("arguments", "code", "told"),
    [
        (["--robot", "r7"], 2, "holds nothing of a robot 'r7': it has r1, r2"),
        (["--from", "yesterday"], 2, "no moment of a recording"),
        (["--from", "99"], 2, "nothing was recorded then"),
        (["--to", "2020-01-01T00:00:00"], 2, "nothing was recorded then"),
        (["--serve", "--diff"], 2, "exclude each other"),
        (["--serve", "--listen", "0.0.0.0:1"], 78, "--listen:2: server.listen"),
        (["--config", "/nowhere.toml"], 78, "does not exist"),
        (["--vendor-dir", "/nowhere"], 78, "/nowhere"),
        (["--topic", "r1/jonts"], 2, 'did you mean "r1/joints"?'),
    ],
)
def test_wrong_usage_is_said_in_words(arguments: list[str], code: int, told: str, known: Path) -> None:
    done = command_here("replay", str(known), *arguments)

    assert done.code == code, done.err
    assert told in done.err
    assert "Traceback" not in done.err


def test_files_that_are_none_are_said_in_words(tmp_path: Path, known: Path) -> None:
    empty, cut = tmp_path / "empty.mcap", tmp_path / "cut.mcap"
    empty.touch()
    cut.write_bytes(known.read_bytes()[:-5000])

    assert "is empty, it has 0 bytes" in command_here("replay", str(empty)).err
    assert "is a folder" in command_here("replay", str(tmp_path)).err
    done = command_here("replay", str(cut))
    assert done.code == 0
    assert "damaged: " in done.err
    assert "12 frames" in done.out


async def test_the_doors_open_on_a_recording_and_stay_open_when_it_is_over(known: Path) -> None:
    arguments = [*PYTHON, "replay", str(known), "--serve", "--listen", "127.0.0.1:0", "--speed", "1"]
    process = await anyio.open_process(
        arguments, env=environment(), cwd=ROOT, stderr=subprocess.PIPE, stdin=subprocess.DEVNULL
    )
    async with process:
        try:
            said = ""
            assert process.stderr is not None
            with anyio.fail_after(12):
                async for data in process.stderr:
                    said += data.decode()
                    if "over:" in said:
                        break
                port = int(re.findall(r"http://127\.0\.0\.1:(\d+)/", said)[0])
                async with connect(f"ws://127.0.0.1:{port}/ws") as client:
                    robots = await client.robots()
                    assert [robot.name for robot in robots] == ["r1", "r2"]
                    assert {robot.link.reason for robot in robots} == {"the recording ends here"}
                    (joints,) = await client.get(["r1/joints"])
                    assert (joints.origin, joints.q) == ("replay", "DISCONNECTED")
                    assert [event.kind for event in await client.events()] == ["estop.pressed"]
                page = await anyio.to_thread.run_sync(
                    lambda: urllib.request.urlopen(f"http://127.0.0.1:{port}/").read()
                )
                assert b"<html" in page
            process.send_signal(signal.SIGINT)
            with anyio.fail_after(5):
                code = await process.wait()
        finally:
            if process.returncode is None:
                process.kill()
    assert code == 0
    assert "the doors stay open until Ctrl-C" in said


BEGINS, ENDS = T0, T0 + 60_000_000


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("10", BEGINS + 10_000_000),
        ("2.5", BEGINS + 2_500_000),
        ("-10", ENDS - 10_000_000),
        ("-0", ENDS),
        ("2026-04-24T03:06:50Z", 1_777_000_010_000_000),
        ("2026-04-24T05:06:50+02:00", 1_777_000_010_000_000),
    ],
)
def test_moments_are_seconds_or_times(text: str, expected: int) -> None:
    assert moment(text, BEGINS, ENDS) == expected


def test_a_time_of_day_is_the_local_one_of_the_recording() -> None:
    begins = datetime(2026, 5, 4, 23, 59, 50).astimezone()
    begins_t = round(begins.timestamp() * 1e6)

    assert moment("23:59:55", begins_t, begins_t) == begins_t + 5_000_000
    assert moment("00:00:05.5", begins_t, begins_t) == begins_t + 15_500_000
    assert moment(f"{begins:%Y-%m-%d}T23:59:52", begins_t, begins_t) == begins_t + 2_000_000


@pytest.mark.parametrize("text", ["", "soon", "nan", "inf", "25:00:00", "2026-13-01"])
def test_what_is_no_moment_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match=r"moment|seconds"):
        moment(text, BEGINS, ENDS)
