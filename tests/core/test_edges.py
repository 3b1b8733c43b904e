from __future__ import annotations

import itertools
from collections.abc import Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.api.model import (
    Fault,
    Io,
    Motion,
    OperatingMode,
    Power,
    Program,
    ProgramState,
    Safety,
    SafetyState,
    Status,
)
from gateway.core.edges import EDGE_KEYS, Edge, EdgeFinder


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
    assert found == [[], [], ["safety.changed"], ["safety.changed"]]


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


def seen(finder: EdgeFinder, *states: Status | Safety) -> list[list[str]]:
    """The edges that each of some states shows."""
    return [
        status_kinds(finder, state) if isinstance(state, Status) else kinds(finder.observe_safety(state))
        for state in states
    ]


@pytest.mark.parametrize(
    "state",
    [
        Status(motion=Motion.MOVING),
        Status(motion=Motion.STANDSTILL),
        Status(program=Program(state=ProgramState.RUNNING)),
        Status(program=Program(state=ProgramState.STOPPED)),
        Status(e_stopped=False),
        Safety(collision=False, self_collision=False),
    ],
)
def test_a_null_between_two_equal_values_is_no_event(state: Status | Safety) -> None:
    nothing = type(state)()
    assert seen(EdgeFinder(), state, nothing, nothing, state, nothing, state) == [[]] * 6


def test_what_nobody_may_miss_is_told_again_after_a_null_with_nothing_known_before() -> None:
    finder = EdgeFinder()
    pressed = Status(e_stopped=True)
    assert seen(finder, pressed, Status(), pressed) == [["estop.pressed"], [], ["estop.pressed"]]
    _, (edge,) = EdgeFinder().observe_status(pressed, 1)
    assert (edge.before, edge.after) == (None, True)
    hit = Safety(collision=True)
    assert seen(finder, hit, hit, Safety(), hit) == [["collision.detected"], [], [], ["collision.detected"]]
    itself = Safety(self_collision=True)
    assert seen(finder, itself, Safety(), itself) == [["collision.detected"], [], ["collision.detected"]]


def test_what_was_released_while_nobody_could_see_it_is_told_once() -> None:
    finder = EdgeFinder()
    released = seen(
        finder, Status(e_stopped=True), Status(), Status(e_stopped=False), Status(), Status(e_stopped=False)
    )
    assert released == [["estop.pressed"], [], ["estop.released"], [], []]
    cleared = seen(finder, Safety(collision=True), Safety(), Safety(collision=False))
    assert cleared == [["collision.detected"], [], ["collision.cleared"]]


def test_motion_and_program_remember_their_last_known_value_through_a_null() -> None:
    finder = EdgeFinder()
    moving, still = Status(motion=Motion.MOVING), Status(motion=Motion.STANDSTILL)
    assert seen(finder, still, Status(), moving, Status(), still) == [
        [],
        [],
        ["motion.started"],
        [],
        ["motion.stopped"],
    ]
    runs, paused = (Status(program=Program(state=state)) for state in (ProgramState.RUNNING, ProgramState.PAUSED))
    stopped = Status(program=Program(state=ProgramState.STOPPED))
    found = seen(EdgeFinder(), stopped, Status(), runs, Status(program=Program()), paused, Status(), stopped)
    assert found == [[], [], ["program.started"], [], ["program.paused"], [], ["program.stopped"]]


@pytest.mark.parametrize(
    ("known", "kind"),
    [
        (Status(operating_mode=OperatingMode.MANUAL), "mode.changed"),
        (Status(power=Power.ENABLED), "power.changed"),
        (Safety(state=SafetyState.NORMAL), "safety.changed"),
    ],
)
def test_of_mode_power_and_safety_a_null_is_news_once_and_a_first_null_is_not(
    known: Status | Safety, kind: str
) -> None:
    nothing = type(known)()
    found = seen(EdgeFinder(), nothing, known, nothing, nothing, known, known)
    assert found == [[], [], [kind], [], [kind], []]


def test_a_null_whose_parts_have_not_come_says_nothing_and_a_value_counts_all_the_same() -> None:
    finder = EdgeFinder()
    untold = frozenset(EDGE_KEYS)
    known = Status(operating_mode=OperatingMode.MANUAL, power=Power.OFF, e_stopped=True, faults=[Fault("a")])
    finder.observe_status(known, 1)
    finder.observe_safety(Safety(state=SafetyState.NORMAL, collision=True))
    assert finder.observe_status(Status(), 2, untold) == (Status(), [])
    assert finder.observe_safety(Safety(), untold) == []
    again, edges = finder.observe_status(known, 3, untold)
    assert (kinds(edges), [fault.since for fault in again.faults or []]) == ([], [1])
    assert finder.observe_safety(Safety(state=SafetyState.NORMAL, collision=True), untold) == []
    changed = Status(operating_mode=OperatingMode.AUTOMATIC, power=Power.OFF, e_stopped=False)
    assert kinds(finder.observe_status(changed, 4, untold)[1]) == ["mode.changed", "estop.released"]


LEAVES: st.SearchStrategy[tuple[bool | None, Motion | None]] = st.tuples(
    st.sampled_from([None, False, True]), st.sampled_from([None, Motion.MOVING, Motion.STANDSTILL])
)


@given(st.lists(LEAVES, max_size=30))
def test_no_press_is_missed_and_pressed_and_released_take_turns_but_for_a_press_told_again(
    states: list[tuple[bool | None, Motion | None]],
) -> None:
    finder = EdgeFinder()
    pressed: bool | None = None
    before: bool | None = None
    for e_stopped, motion in states:
        found = [kind for kind in status_kinds(finder, Status(e_stopped=e_stopped, motion=motion)) if "estop" in kind]
        if e_stopped and not before:
            assert found == ["estop.pressed"]
        elif e_stopped is False and pressed:
            assert found == ["estop.released"]
        else:
            assert found == []
        before = e_stopped
        pressed = pressed if e_stopped is None else e_stopped


@given(st.lists(LEAVES, max_size=30))
def test_motion_starts_and_stops_in_turns_whatever_is_unknown_between(
    states: list[tuple[bool | None, Motion | None]],
) -> None:
    finder = EdgeFinder()
    found = [kind for _, motion in states for kind in status_kinds(finder, Status(motion=motion))]
    assert all(one != after for one, after in itertools.pairwise(found))


Triple = tuple[str, object, object]


def io_finder(*globs: str) -> Callable[..., list[Triple]]:
    """What a finder with some globs finds in the levels of the box's inputs and outputs."""
    finder = EdgeFinder(globs)

    def found(inputs: list[bool | None] | None, outputs: list[bool | None] | None = None) -> list[Triple]:
        io = Io(digital_in={"box": inputs}, digital_out={"box": outputs, "tool": None})
        return [(edge.key, edge.before, edge.after) for edge in finder.observe_io(io)]

    return found


def test_inputs_and_outputs_are_told_only_where_they_are_asked_for() -> None:
    found = io_finder("digital_in.box.1")
    assert found([False, False], [False]) == []
    assert found([True, False], [True]) == []
    assert found([True, True], [True]) == [
        ("io.digital_in.box", {"digital_in.box.1": False}, {"digital_in.box.1": True})
    ]
    silent = io_finder()
    assert silent([False]) == silent([True]) == []


@pytest.mark.parametrize(
    "glob", ["*", "digital_out", "digital_out.*", "digital_out.box", "*.b?x.0", "digital_*.*.[01]"]
)
def test_a_glob_matches_part_by_part_and_what_it_leaves_out_is_everything_below(glob: str) -> None:
    found = io_finder(glob)
    assert found(None, [False]) == []
    assert [after for _, _, after in found(None, [True])] == [{"digital_out.box.0": True}]


@pytest.mark.parametrize("glob", ["box", "digital_in.*", "digital_out.tool", "*.0", "digital_out.box.1"])
def test_a_glob_of_something_else_finds_nothing(glob: str) -> None:
    found = io_finder(glob)
    assert found(None, [False]) == found(None, [True]) == []


def test_an_input_that_nobody_can_see_for_a_while_keeps_its_last_level() -> None:
    found = io_finder("*")
    assert found([None]) == found([False]) == found([None]) == found(None) == found([False]) == []
    assert found([None]) == []
    assert [after for _, _, after in found([True])] == [{"digital_in.box.0": True}]
