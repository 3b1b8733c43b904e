from __future__ import annotations

from gateway.api.model import Fault, Motion, OperatingMode, Power, Program, ProgramState, Safety, SafetyState, Status
from gateway.core.edges import Edge, EdgeFinder


def kinds(edges: list[Edge]) -> list[str]:
    return [edge.kind.value for edge in edges]


def status_kinds(finder: EdgeFinder, status: Status) -> list[str]:
    return kinds(finder.observe_status(status, 1)[1])


def test_the_first_values_ever_seen_are_no_edges() -> None:
    running = Program(state=ProgramState.RUNNING)
    first = Status(operating_mode=OperatingMode.MANUAL, power=Power.ENABLED, motion=Motion.MOVING, program=running)
    assert status_kinds(EdgeFinder(), first) == []


def test_a_pressed_stop_and_a_collision_are_told_at_first_sight() -> None:
    assert status_kinds(EdgeFinder(), Status(e_stopped=True)) == ["estop.pressed"]
    assert kinds(EdgeFinder().observe_safety(Safety(collision=True))) == ["collision.detected"]


def test_every_change_of_power_and_mode_is_an_edge() -> None:
    finder = EdgeFinder()
    finder.observe_status(Status(operating_mode=OperatingMode.MANUAL, power=Power.OFF), 1)
    changed = Status(operating_mode=OperatingMode.AUTOMATIC, power=Power.ENABLED)
    assert status_kinds(finder, changed) == ["mode.changed", "power.changed"]


def test_a_safety_state_that_is_null_between_two_stops_gives_an_edge_each_way() -> None:
    finder = EdgeFinder()
    states = [None, SafetyState.PROTECTIVE_STOP, None, SafetyState.PROTECTIVE_STOP]
    found = [kinds(finder.observe_safety(Safety(state=state))) for state in states]
    assert found == [[], ["safety.changed"], ["safety.changed"], ["safety.changed"]]


def test_motion_starts_and_stops() -> None:
    finder = EdgeFinder()
    states = [Motion.STANDSTILL, Motion.MOVING, Motion.HAND_GUIDING, Motion.HOLD, Motion.MOVING, Motion.STANDSTILL]
    found = [status_kinds(finder, Status(motion=state)) for state in states]
    assert found == [[], ["motion.started"], [], ["motion.stopped"], ["motion.started"], ["motion.stopped"]]


def test_a_program_starts_pauses_resumes_and_stops() -> None:
    finder = EdgeFinder()
    states = [
        ProgramState.STOPPED,
        ProgramState.RUNNING,
        ProgramState.PAUSED,
        ProgramState.RUNNING,
        ProgramState.STOPPED,
    ]
    found = [status_kinds(finder, Status(program=Program(state=state))) for state in states]
    assert found == [[], ["program.started"], ["program.paused"], ["program.started"], ["program.stopped"]]


def test_an_emergency_stop_is_pressed_and_released() -> None:
    finder = EdgeFinder()
    found = [status_kinds(finder, Status(e_stopped=value)) for value in (False, True, True, False)]
    assert found == [[], ["estop.pressed"], [], ["estop.released"]]


def test_without_a_known_emergency_stop_there_is_no_event_of_it() -> None:
    finder = EdgeFinder()
    assert status_kinds(finder, Status(e_stopped=None)) == []
    assert status_kinds(finder, Status(e_stopped=None)) == []


def test_what_changed_while_nobody_could_see_it_is_an_edge_when_it_is_seen_again() -> None:
    finder = EdgeFinder()
    finder.observe_status(Status(e_stopped=False), 1)
    finder.observe_status(Status(e_stopped=None), 2)
    assert status_kinds(finder, Status(e_stopped=True)) == ["estop.pressed"]


def test_collisions_with_others_and_with_itself_are_detected_and_cleared() -> None:
    finder = EdgeFinder()
    calm = Safety(collision=False, self_collision=False, state=SafetyState.NORMAL)
    assert kinds(finder.observe_safety(calm)) == []
    hit = finder.observe_safety(Safety(collision=True, self_collision=False, state=SafetyState.PROTECTIVE_STOP))
    assert [(edge.kind.value, edge.key) for edge in hit] == [
        ("safety.changed", "safety.state"),
        ("collision.detected", "safety.collision"),
    ]
    assert kinds(finder.observe_safety(calm)) == ["safety.changed", "collision.cleared"]
    again = Safety(collision=False, self_collision=True, state=SafetyState.NORMAL)
    assert kinds(finder.observe_safety(again)) == ["collision.detected"]


def test_a_fault_keeps_the_time_it_was_first_seen_and_is_raised_and_cleared_once() -> None:
    finder = EdgeFinder()
    fault = Fault("sos", main=6)
    raised, edges = finder.observe_status(Status(faults=[fault]), 10)
    assert kinds(edges) == ["fault.raised"]
    again, edges = finder.observe_status(Status(faults=[fault, Fault("err_jam", joint=2)]), 20)
    assert kinds(edges) == ["fault.raised"]
    assert [one.since for one in raised.faults or []] == [10]
    assert [one.since for one in again.faults or []] == [10, 20]
    _, edges = finder.observe_status(Status(faults=[]), 30)
    assert kinds(edges) == ["fault.cleared", "fault.cleared"]
    assert [edge.before.since for edge in edges if isinstance(edge.before, Fault)] == [10, 20]


def test_faults_that_cannot_be_told_clear_nothing() -> None:
    finder = EdgeFinder()
    finder.observe_status(Status(faults=[Fault("sos", main=6)]), 1)
    assert status_kinds(finder, Status(faults=None)) == []
