"""The records of a simulator, and the robot that its sessions speak for."""

from __future__ import annotations

import msgspec
import pytest

from gateway.sim.scenario import find_scenario
from gateway.sim.simulator import Port, Simulator, VirtualRobot


class Mute:
    """Says nothing."""

    period_s: float | None = None

    def __init__(self, robot: VirtualRobot, options: msgspec.Struct) -> None:
        pass

    def received(self, _data: bytes, _now_s: float) -> list[bytes]:
        """Answer nothing."""
        return []

    def due(self, _now_s: float) -> list[bytes]:
        """Push nothing."""
        return []


SIMULATOR = Simulator(ports=(Port(protocol="p", port=5001, session=Mute), Port(protocol=None, port=5000, session=Mute)))


def test_the_other_ports_keep_their_distance_from_the_main_one() -> None:
    assert SIMULATOR.port_numbers(None) == (5001, 5000)
    assert SIMULATOR.port_numbers(15001) == (15001, 15000)
    assert SIMULATOR.port_numbers(0) == (0, 0)


def test_a_port_that_leaves_no_room_for_the_others_is_refused() -> None:
    with pytest.raises(ValueError, match="would need the ports 1, 0"):
        SIMULATOR.port_numbers(1)


def test_another_scenario_begins_when_it_is_played() -> None:
    robot = VirtualRobot(find_scenario("idle"), start_s=100.0)
    assert robot.state(101.0).time_s == 1.0
    robot.play(find_scenario("estop"), 200.0)
    assert robot.state(205.0).phase.estop


def test_the_last_frames_are_kept_with_what_they_meant() -> None:
    robot = VirtualRobot(find_scenario("idle"), keep=2)
    for number in range(3):
        robot.count(bytes([number]), 0.0, lambda: {"a": 1})
    assert robot.frames == 3
    assert [(sent.number, sent.frame) for sent in robot.sent] == [(2, b"\1"), (3, b"\2")]
    assert robot.sent[-1].values() == {"a": 1}


def test_nothing_is_kept_unless_asked_for() -> None:
    robot = VirtualRobot(find_scenario("idle"))
    robot.count(b"x", 0.0, dict)
    assert (robot.frames, list(robot.sent)) == (1, [])
