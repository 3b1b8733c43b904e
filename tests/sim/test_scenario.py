"""Scenarios are pure functions of the time, and never jump."""

from __future__ import annotations

import re
from itertools import pairwise

import pytest

from gateway.api.model import Power, ProgramState
from gateway.sim.scenario import SCENARIOS, Phase, RobotState, Scenario, find_scenario


def walk(scenario: Scenario, step_s: float) -> list[RobotState]:
    return [scenario.at(number * step_s) for number in range(int(2.2 * min(scenario.seconds, 100) / step_s))]


@pytest.mark.parametrize("name", SCENARIOS)
def test_position_and_velocity_never_jump_even_where_the_scenario_loops(name: str) -> None:
    step_s = 0.01
    states = walk(find_scenario(name), step_s)
    for before, after in pairwise(states):
        for a, b, speed in zip(before.target_position, after.target_position, before.velocity, strict=True):
            assert b - a == pytest.approx(speed * step_s, abs=2e-3)
        assert after.velocity == pytest.approx(before.velocity, abs=0.2)


def test_the_state_is_a_pure_function_of_the_time() -> None:
    cell = find_scenario("cell")
    assert cell.at(31.4) == cell.at(31.4)


def test_the_cell_shows_everything_that_can_happen() -> None:
    phases = find_scenario("cell").phases
    assert {phase.program for phase in phases} == {ProgramState.RUNNING, ProgramState.PAUSED, ProgramState.STOPPED}
    assert {phase.power for phase in phases} == {Power.OFF, Power.BOOTING, Power.ENABLED}
    for what in ("freedrive", "collision", "fault", "estop"):
        assert any(getattr(phase, what) for phase in phases)


def test_the_emergency_stop_takes_the_power_away_and_ends_the_program() -> None:
    pressed = [phase for phase in find_scenario("estop").phases if phase.estop]
    assert [(phase.power, phase.program) for phase in pressed] == [(Power.OFF, ProgramState.STOPPED)]


def test_an_arm_at_rest_does_not_move() -> None:
    idle = find_scenario("idle")
    assert idle.at(1.0).target_position == idle.at(100.0).target_position
    assert not idle.at(1.0).moving


def test_a_pause_goes_on_counting_the_time_of_the_program() -> None:
    pause = find_scenario("pause")
    assert pause.at(7.0).program_s == pytest.approx(7.0)
    assert pause.at(9.0).program_s == pytest.approx(9.0)


def test_a_stopped_program_has_no_time() -> None:
    fault = find_scenario("fault")
    assert fault.at(6.0).program_s == 0.0
    assert fault.at(fault.seconds + 1.0).program_s == pytest.approx(1.0)


def test_the_phase_stays_the_same_object_as_long_as_it_lasts() -> None:
    cell = find_scenario("cell")
    assert cell.at(4.0).phase is cell.at(5.0).phase
    assert cell.at(4.0).phase is cell.at(4.0 + cell.seconds).phase


def test_an_unknown_scenario_names_those_that_there_are() -> None:
    with pytest.raises(ValueError, match=re.escape("no scenario 'cel'; there are cell, steady")):
        find_scenario("cel")


def test_a_ramp_longer_than_its_phase_is_refused() -> None:
    with pytest.raises(ValueError, match="phase short"):
        Phase(name="short", seconds=0.1)
