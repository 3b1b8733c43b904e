"""How robots and samples look, for every state of a link, in narrow and wide terminals."""

from __future__ import annotations

import io
from itertools import product

import msgspec
import pytest
from rich.console import Console

from gateway.api.messages import RobotInfo
from gateway.api.model import Event, EventKind, Link, LinkState, Motion, Quality, SafetyState, Sample
from gateway.cli.view import duration, event_line, flat, robots_table, sample_lines, units_of

NOW = 1_700_000_000_000_000
LONG = "abcdefghijklmnopqrstuvwxyz012345"  # 32 characters


def robot(name: str, state: LinkState, *, reason: str | None = None) -> RobotInfo:
    link = Link(
        state=state,
        reason=reason,
        since=NOW - 59 * 60_000_000,
        attempts=12 if reason else 0,
        next_attempt=NOW + 4_000_000 if reason else None,
        protocol="reqdata",
        peer="10.0.0.1:5001",
        reached_hz=500.0 if state is LinkState.ONLINE else None,
    )
    return RobotInfo(name=name, vendor="rainbow", protocol="reqdata", groups=["link"], link=link)


def sample(topic: str, data: object, q: Quality = Quality.GOOD, t_last: int | None = None) -> Sample:
    return Sample(topic=topic, seq=1, epoch="e", t=NOW, t_last=t_last, q=q, data=data)


def latest(name: str, motion: str = "HAND_GUIDING", safety: str = "EMERGENCY_STOP") -> dict[str, Sample]:
    status = {"power": "POWERED", "motion": motion, "program": {"state": "RUNNING"}}
    return {
        f"{name}/status": sample(f"{name}/status", status),
        f"{name}/safety": sample(f"{name}/safety", {"state": safety}),
    }


def shown(robots: list[RobotInfo], samples: dict[str, Sample], width: int) -> list[str]:
    console = Console(file=io.StringIO(), width=width, highlight=False)
    console.print(robots_table(robots, samples, NOW, width))
    assert isinstance(console.file, io.StringIO)
    return console.file.getvalue().splitlines()


@pytest.mark.parametrize("width", [80, 120, 200])
@pytest.mark.parametrize("name", ["r1", LONG])
def test_no_state_of_a_link_is_cut_at_any_width(width: int, name: str) -> None:
    for state, motion, safety in product(LinkState, Motion, SafetyState):
        lines = shown([robot(name, state)], latest(name, motion, safety), width)
        assert max(map(len, lines)) <= width
        assert "…" not in "".join(lines)
        cells = lines[2].split()
        assert cells[0] == name
        assert state.value in cells
        assert cells[-1] == safety.value


def test_where_it_is_too_wide_the_longest_of_what_is_spoken_is_cut_to_its_vendor() -> None:
    short, long = robot("r1", LinkState.ONLINE), robot("r2", LinkState.ONLINE)
    long = msgspec.structs.replace(long, vendor="universal_robots", protocol="realtime")
    wide = shown([short, long], latest("r1"), 120)
    assert [line.split()[1] for line in wide[2:]] == ["rainbow:reqdata", "universal_robots:realtime"]
    needed = max(map(len, (line.rstrip() for line in wide)))
    narrow = shown([short, long], latest("r1"), needed - 1)
    assert [line.split()[1] for line in narrow[2:]] == ["rainbow:reqdata", "universal_robots"]


def test_a_narrow_terminal_leaves_out_the_least_important_columns_and_says_which() -> None:
    narrow = shown([robot(LONG, LinkState.INCOMPATIBLE)], latest(LONG), 80)
    assert narrow[0].split() == ["robot", "link", "for", "power", "safety"]
    assert narrow[2].split() == [LONG, "INCOMPATIBLE", "59", "min", "POWERED", "EMERGENCY_STOP"]
    assert narrow[3] == "too narrow for: speaks, Hz, motion, program"
    wide = shown([robot(LONG, LinkState.INCOMPATIBLE)], latest(LONG), 120)
    assert wide[0].split() == ["robot", "speaks", "link", "for", "Hz", "power", "motion", "program", "safety"]


def test_the_usual_cell_has_every_column_at_80() -> None:
    lines = shown([robot("welder-1", LinkState.ONLINE)], latest("welder-1", "STANDSTILL", "NORMAL"), 80)
    assert lines[0].split()[-1] == "safety"
    assert len(lines) == 3


def test_a_link_that_is_not_online_says_why_and_what_comes_next() -> None:
    lines = shown([robot("r1", LinkState.DISCONNECTED, reason="connection refused")], {}, 80)
    assert lines[3] == "r1: connection refused; attempt 12; next one in 4.0 s"


def test_what_is_not_known_is_a_dash() -> None:
    assert shown([robot("r1", LinkState.STALE)], {}, 80)[2].split()[5:] == ["–"] * 5  # noqa: RUF001


def test_a_cell_without_robots_says_so() -> None:
    assert shown([], {}, 80) == ["no robots are configured"]


@pytest.mark.parametrize(
    ("seconds", "text"),
    [(-1, "0 s"), (0.4, "0 s"), (59.9, "59 s"), (60, "1 min"), (3599, "59 min"), (86_399, "23 h"), (9e6, "104 d")],
)
def test_a_duration_is_told_in_its_largest_unit(seconds: float, text: str) -> None:
    assert duration(seconds) == text


@pytest.mark.parametrize("axes", [6, 7])
def test_the_longest_line_of_joints_has_80_columns(axes: int) -> None:
    data = {"position": [-3.14159] * axes, "target_acceleration": [-1.23456] * axes, "velocity": None}
    units = {"position": "rad", "target_acceleration": "rad/s²"}
    lines = list(sample_lines(sample("r1/joints", data), units))
    assert len(lines) == 3
    assert max(map(len, lines[:2])) <= 80
    assert lines[1].endswith("rad")


def test_a_line_of_an_array_has_80_columns_whatever_its_key_and_unit() -> None:
    data = {"target_pose.orientation": [0.1, 0.2, 0.3, 0.9], "target_twist": [-1.25, 0.0, 12.5, 0.0, 0.0, -3.0]}
    _, _, twist = sample_lines(sample("r1/tcp", data), {"target_twist": "m/s, rad/s"})
    assert len(twist) <= 80
    assert twist.split()[1:7] == ["-1.250", "0.000", "12.500", "0.000", "0.000", "-3.000"]


def test_numbers_above_a_hundred_stand_in_columns_with_two_digits() -> None:
    _, warm, cool = sample_lines(sample("r1/x", {"a": [306.381, 99.5, None], "b": [6.0, 99.5, 1.0]}), {"a": "K"})
    assert warm == "  a  306.38  99.50      –  K"  # noqa: RUF001
    assert cool == "  b   6.0000 99.5000  1.0000"


def test_a_silent_robot_says_since_when() -> None:
    (line,) = sample_lines(sample("r1/joints", {"position": None}, Quality.DISCONNECTED, NOW), {})
    assert "DISCONNECTED  no values, last frame at " in line
    (line,) = sample_lines(sample("r1/joints", {"position": None}), {})
    assert line.endswith("nothing known")


def test_values_have_their_form() -> None:
    data = {"a": True, "b": [True, None, False], "c": 0.000012345, "d": [1e20, float(2)], "e": "x", "t": NOW, "n": {}}
    lines = list(sample_lines(sample("r1/x", data), {"t": "µs", "c": "s"}))
    assert [" ".join(line.split()) for line in lines[1:6]] == [
        "a 1",
        "b 1 – 0",  # noqa: RUF001
        "c 1.2345e-05 s",
        "d 1e+20 2.0000",
        "e x",
    ]
    assert "NOW" not in lines[6]
    assert lines[6].count(":") == 2


def test_an_event_is_one_line() -> None:
    fault = {"code": "joint_error", "main": 17, "joint": 2, "text": "encoder"}
    event = Event(name="b:1", seq=1, robot="r1", t=NOW, kind=EventKind.FAULT_RAISED, after=fault)
    assert event_line(event).endswith("r1  fault.raised  – → joint_error 17 at joint 2 (encoder)")  # noqa: RUF001


def test_leaves_are_flattened_for_tables_of_numbers() -> None:
    assert flat({"a": {"b": 1}, "c": [1, 2], "d": [{"e": 3}]}) == {"a.b": 1, "c.0": 1, "c.1": 2, "d.0.e": 3}


def test_units_are_found_behind_references_and_choices() -> None:
    schema = {
        "$ref": "#/$defs/Tcp",
        "$defs": {
            "Tcp": {
                "properties": {"speed": {"unit": "m/s"}, "pose": {"anyOf": [{"type": "null"}, {"$ref": "x/Pose"}]}}
            },
            "Pose": {"properties": {"position": {"unit": "m"}}},
        },
    }
    assert units_of(schema) == {"speed": "m/s", "pose.position": "m"}
