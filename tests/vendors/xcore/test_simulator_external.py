"""The virtual controller's External Communication: each word's answer as the manual has it, however it is asked."""

from __future__ import annotations

import itertools
import re

import msgspec
import pytest

from gateway.sim.scenario import find_scenario
from gateway.sim.simulator import VirtualRobot
from vendors.xcore.simulator.external import ExternalSession
from vendors.xcore.simulator.options import XcoreOptions

BOOLEANS = (
    "motor_on_state", "robot_running_state", "estop_state", "fault_state", "operating_mode", "home_state",
    "collision_state",
)  # fmt: skip
NUMBERS = {
    "jnt_pos": ("", 6),
    "jnt_pos_name": ("jnt_pos : ", 6),
    "jnt_vel": ("", 6),
    "jnt_vel_name": ("Jnt_vel : ", 6),
    "jnt_trq": ("", 6),
    "jnt_trq_name": ("Jnt_trq : ", 6),
    "cart_pos": ("", 10),
    "cart_pos_name": ("cart_pos : ", 10),
}
TEXTS = ("task_state", "list_prog", "current_prog")
ALL = (*BOOLEANS, *NUMBERS, *TEXTS)
CONTROL = (
    "start", "stop", "clear_alarm", "pp_to_main", "motor_on", "motor_off", "switch_mode:auto", "switch_mode:manual",
    "open_drag", "close_drag", "load_prog:cell", "load_prog cell", "xCore::SocketInterface::Enable",
    "xCore::SocketInterface::Disable",
)  # fmt: skip
NUMBER = r"-?\d+\.\d{9,}"


def robot(scenario: str = "steady", keep: int = 0) -> VirtualRobot:
    return VirtualRobot(find_scenario(scenario), keep=keep)


def session(of: VirtualRobot, **options: object) -> ExternalSession:
    return ExternalSession(of, msgspec.convert(options, XcoreOptions))


def answer(word: str, at_s: float = 5.0, scenario: str = "cell", **options: object) -> str:
    (found,) = session(robot(scenario), **options).received(word.encode() + b"\r", at_s)
    return found.decode()


def middle(name: str) -> float:
    """The middle of the first such phase of the tour."""
    phases = find_scenario("cell").phases
    starts = itertools.accumulate((phase.seconds for phase in phases), initial=0.0)
    return next(start + row.seconds / 2 for start, row in zip(starts, phases, strict=False) if row.name == name)


@pytest.mark.parametrize("word", BOOLEANS)
def test_a_boolean_has_no_suffix_unless_it_is_set_so(word: str) -> None:
    assert answer(word) in {"true", "false"}
    assert answer(word, suffix_after_booleans=True) in {"true\r", "false\r"}


@pytest.mark.parametrize(("word", "form"), NUMBERS.items())
@pytest.mark.parametrize("separator", [",", ";", " ", "、"])
def test_numbers_stand_behind_their_prefix_with_separators_and_a_suffix(
    word: str, form: tuple[str, int], separator: str
) -> None:
    prefix, count = form
    numbers = separator.join([NUMBER] * count)
    assert re.fullmatch(f"{prefix}{numbers}\r", answer(word, separator=separator))


@pytest.mark.parametrize(("axes", "extra", "count"), [(6, 0, 6), (7, 0, 7), (6, 1, 7), (7, 6, 13)])
def test_joint_words_have_a_value_for_each_axis_and_the_further_ones(axes: int, extra: int, count: int) -> None:
    for word in ("jnt_pos", "jnt_vel", "jnt_trq"):
        assert answer(word, axes=axes, extra_joints=extra).count(",") == count - 1
    assert answer("cart_pos", axes=axes, extra_joints=extra).count(",") == 9


def test_the_seventh_axis_stands_still() -> None:
    assert [float(answer(word, axes=7).rstrip("\r").split(",")[6]) for word in ("jnt_pos", "jnt_vel", "jnt_trq")] == [
        0.0
    ] * 3


@pytest.mark.parametrize(
    ("phase", "told"),
    [
        ("idle", {"motor_on_state": "true", "robot_running_state": "false", "home_state": "true"}),
        ("program runs", {"robot_running_state": "true", "task_state": "program\r", "home_state": "false"}),
        ("program runs", {"operating_mode": "true", "current_prog": "virtual_cell\r"}),
        ("program pauses", {"robot_running_state": "false", "task_state": "ready\r"}),
        ("program pauses", {"current_prog": "virtual_cell\r"}),
        ("idle", {"current_prog": "null\r", "list_prog": "virtual_cell,virtual_test\r", "task_state": "ready\r"}),
        ("freedrive", {"task_state": "drag\r", "operating_mode": "false"}),
        ("collision", {"collision_state": "true", "fault_state": "false"}),
        ("fault", {"fault_state": "true", "collision_state": "false", "home_state": "false"}),
        ("emergency stop pressed", {"estop_state": "true", "motor_on_state": "false"}),
        ("power is off", {"motor_on_state": "false", "estop_state": "false"}),
        ("activation", {"motor_on_state": "false"}),
    ],
)
def test_each_phase_is_told_in_the_manuals_words(phase: str, told: dict[str, str]) -> None:
    assert {word: answer(word, middle(phase)) for word in told} == told


def test_the_level_of_the_emergency_stop_is_a_setting() -> None:
    pressed, released = middle("emergency stop pressed"), middle("idle")
    assert [answer("estop_state", at_s, estop_level="high") for at_s in (pressed, released)] == ["true", "false"]
    assert [answer("estop_state", at_s, estop_level="low") for at_s in (pressed, released)] == ["false", "true"]


def test_torques_may_be_per_mille_of_those_of_the_motors() -> None:
    rated = [91.0, 91.0, 78.0, 22.0, 20.0, 16.0]
    torques = [float(part) for part in answer("jnt_trq").split(",")]
    parts = [float(part) for part in answer("jnt_trq", torque_unit="permille").split(",")]
    assert parts == pytest.approx([1000 * torque / full for torque, full in zip(torques, rated, strict=True)])


@pytest.mark.parametrize("suffix", [r"\r", r"\r\n", r"\t", "$$", "ab"])
def test_requests_are_answered_however_they_are_cut(suffix: str) -> None:
    ending = msgspec.convert({"suffix": suffix}, XcoreOptions).ending
    stream = b"".join(word.encode() + ending for word in ALL)
    whole = session(robot(), suffix=suffix).received(stream, 3.0)
    single = session(robot(), suffix=suffix)
    assert [found for byte in stream for found in single.received(bytes([byte]), 3.0)] == whole
    assert len(whole) == len(ALL)
    for cut in range(1, len(stream), 7):
        halves = session(robot(), suffix=suffix)
        assert halves.received(stream[:cut], 3.0) + halves.received(stream[cut:], 3.0) == whole
    assert all(found.endswith(ending) != (word in BOOLEANS) for word, found in zip(ALL, whole, strict=True))


def test_a_word_without_its_suffix_is_not_answered_yet() -> None:
    asked = session(robot(), suffix=r"\r\n")
    assert asked.received(b"jnt_pos\r", 1.0) == []
    assert len(asked.received(b"\n", 1.0)) == 1


@pytest.mark.parametrize("word", CONTROL)
def test_a_control_word_is_counted_and_neither_answered_nor_obeyed(word: str) -> None:
    of = robot("idle")
    before = of.state(9.0)
    assert session(of).received(word.encode() + b"\r", 1.0) == []
    assert of.settings["control_words"] == 1
    assert of.state(9.0) == before


@pytest.mark.parametrize("word", ["", "state", "alarm_info", "JNT_POS", "jnt_pos ", "\n", "é", "collision_sate"])
def test_an_unknown_word_is_not_answered_and_no_control_word(word: str) -> None:
    of = robot()
    asked = session(of)
    assert asked.received(word.encode() + b"\rfault_state\r", 1.0) == [b"false"]
    assert (of.settings["unknown_words"], of.settings.get("control_words", 0), of.requests) == (1, 0, 2)


def test_a_controller_may_know_fewer_words() -> None:
    asked = session(robot(), unknown_words="collision_state, home_state")
    assert asked.received(b"collision_state\rhome_state\rfault_state\r", 1.0) == [b"false"]


def test_a_word_without_end_is_dropped_up_to_its_suffix() -> None:
    asked = session(robot())
    assert asked.received(b"x" * 100_000, 1.0) == []
    assert asked.received(b"x\rfault_state\r", 1.0) == [b"false"]


def test_a_slow_controller_answers_one_word_after_the_other() -> None:
    asked = session(robot(), slow_ms=50)
    assert asked.period_s is not None
    assert asked.received(b"fault_state\rtask_state\r", 1.0) == []
    assert asked.due(1.049) == []
    assert asked.due(1.051) == [b"false"]
    assert asked.due(1.051) == []
    assert asked.due(1.101) == [b"program\r"]
    assert asked.received(b"fault_state\r", 2.0) == []
    assert asked.due(2.051) == [b"false"]


def test_every_answer_is_counted_with_what_it_means() -> None:
    of = robot(keep=10)
    found = session(of).received(b"motor_on_state\rjnt_pos\rtask_state\r", 5.0)
    assert of.frames == of.requests == 3
    assert [sent.frame for sent in of.sent] == found
    assert of.sent[0].values() == {"motor_on_state": True}
    assert of.sent[1].values() == {"jnt_pos": pytest.approx(list(of.state(5.0).position))}
    assert of.sent[2].values() == {"task_state": "program"}
