"""Which events a virtual robot of each vendor and protocol brings: the whole list of the model, and what is missing."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import anyio
import pytest

from gateway.api.model import Event, EventKind, Power, ProgramState
from gateway.core.registry import Registry
from gateway.sim.scenario import Fault, FaultKind, Phase, Scenario
from gateway.testing.cell import virtual_cell

_PHASE_S = 0.6


def _phase(name: str, **values: object) -> Phase:
    return dataclasses.replace(Phase(name=name, seconds=_PHASE_S, ramp_s=0.05), **values)  # type: ignore[arg-type]


# What happens in `cell`, in a few seconds; the gateway comes while the robot idles.
_EVERYTHING = Scenario(
    "everything",
    "all that a robot of the demo goes through",
    (
        _phase("idle", seconds=3.0),  # all cells begin in one process, which may be busy
        _phase("program runs", rate=1.0, program=ProgramState.RUNNING),
        _phase("program pauses", program=ProgramState.PAUSED),
        _phase("program runs", rate=1.0, program=ProgramState.RUNNING),
        _phase("idle"),
        _phase("freedrive", rate=0.25, freedrive=True),
        _phase("program runs", rate=1.0, program=ProgramState.RUNNING),
        _phase("collision", program=ProgramState.PAUSED, collision=True),
        _phase("idle"),
        _phase("fault", fault=Fault(FaultKind.OVER_CURRENT, 2)),
        _phase("idle"),
        _phase("emergency stop pressed", power=Power.OFF, estop=True),
        _phase("power is off", power=Power.OFF),
        _phase("activation", power=Power.BOOTING),
        _phase("idle", seconds=30.0),
    ),
)
_SECONDS = sum(phase.seconds for phase in _EVERYTHING.phases) - 30.0

_WORDS = ("operating_mode", "motor_on_state", "robot_running_state", "task_state", "fault_state", "estop_state")
_FAST = {
    "torque_unit": "Nm",
    "words": {
        **dict.fromkeys((*_WORDS, "collision_state"), 12.0),
        "jnt_pos": 5.0,
        **dict.fromkeys(("jnt_vel", "jnt_trq", "cart_pos", "current_prog"), 0.0),
    },
}
_IO: dict[str, object] = {"io_events": ["digital_in", "digital_out.*"]}
# what is read, with which settings; any other protocol as its rows tell, see below
_READ: dict[tuple[str, str], dict[str, object]] = {
    ("rainbow", "reqdata"): _IO,
    ("fairino", "cnde"): _IO,
    ("fairino", "legacy"): _IO,
    ("fairino", "status"): {},
    ("xcore", "external"): {"rate_hz": 100.0, "external": _FAST},
    ("xcore", "objects"): _IO,
}
_ALL = {
    kind.value
    for kind in EventKind
    if not kind.value.startswith(("command.", "robot."))
    and kind not in {EventKind.LINK_LOST, EventKind.LINK_INCOMPATIBLE}
}
_NO_PAUSE = "the controller's word for a program that pauses is the one for a program that stands"
# protocol -> the kinds that it cannot bring, each with the reason
_CANNOT: dict[tuple[str, str], dict[str, str]] = {
    ("rainbow", "reqdata"): {"mode.changed": "the frame has no operating mode"},
    ("fairino", "cnde"): {},
    ("fairino", "legacy"): {},
    ("fairino", "status"): dict.fromkeys(
        _ALL - {"link.online", "program.started", "program.paused", "program.stopped"},
        "of the frame only joints, pose, torques and the program are established",
    ),
    ("xcore", "external"): {
        "program.paused": _NO_PAUSE,
        "io.changed": "no word asks for inputs and outputs",
        "collision.cleared": "a `false` can mean that the query failed",
        "estop.released": "a `false` can mean that the query failed",
        "fault.cleared": "a `false` can mean that the query failed",
    },
    ("xcore", "objects"): {
        "program.paused": _NO_PAUSE,
        "fault.cleared": "the controller tells entries of its log, which do not go away",
    },
}
# kind -> the key that it follows from
_FOLLOWS = {
    "mode.changed": "status.operating_mode",
    "power.changed": "status.power",
    **dict.fromkeys(("motion.started", "motion.stopped"), "status.motion"),
    **dict.fromkeys(("program.started", "program.paused", "program.stopped"), "status.program.state"),
    "safety.changed": "safety.state",
    **dict.fromkeys(("estop.pressed", "estop.released"), "status.e_stopped"),
    **dict.fromkeys(("collision.detected", "collision.cleared"), "safety.collision"),
    **dict.fromkeys(("fault.raised", "fault.cleared"), "status.faults"),
    "io.changed": "io.",
}


def _add_protocols(registry: Registry) -> None:
    """Add each protocol that the tables above say nothing of: it brings whatever its rows can tell."""
    for name in registry.names():
        for protocol in registry.vendor(name).protocols:
            keys = [row.key for row in protocol.signals]
            silent = [kind for kind, key in _FOLLOWS.items() if not any(one.startswith(key) for one in keys)]
            _READ.setdefault((name, protocol.name), {} if "io.changed" in silent else _IO)
            _CANNOT.setdefault((name, protocol.name), dict.fromkeys(silent, "no row tells it"))


_REGISTRY = Registry()
_add_protocols(_REGISTRY)
_OF_LINK = {EventKind.LINK_ONLINE, EventKind.LINK_LOST, EventKind.LINK_INCOMPATIBLE}


@pytest.fixture(scope="module")
def told() -> dict[tuple[str, str], list[Event]]:
    """The events of every protocol, all of the same seconds."""
    found: dict[tuple[str, str], list[Event]] = {}

    async def read(number: int, which: tuple[str, str]) -> None:
        vendor, protocol = which
        cell = virtual_cell(
            vendor,
            protocol=protocol,
            scenario=_EVERYTHING,
            host=f"127.0.9.{number}",
            settings=_READ[which],
            registry=_REGISTRY,
        )
        async with cell as running:
            await anyio.sleep(_SECONDS + 1)
            found[which] = running.gateway.bus.events.since(None, 10_000)[0]

    async def read_all() -> None:
        async with anyio.create_task_group() as tasks:
            for number, which in enumerate(_READ, start=2):
                tasks.start_soon(read, number, which)

    anyio.run(read_all)
    return found


def test_the_table_has_every_protocol_that_there_is() -> None:
    registry = Registry()
    there = {(name, protocol.name) for name in registry.names() for protocol in registry.vendor(name).protocols}
    assert there == set(_READ) == set(_CANNOT)


@pytest.mark.limit(40)
@pytest.mark.parametrize("which", _READ, ids=" ".join)
def test_every_kind_of_event_comes_but_for_what_the_protocol_cannot_tell(
    which: tuple[str, str], told: dict[tuple[str, str], list[Event]]
) -> None:
    kinds = {event.kind.value for event in told[which]}
    assert _ALL - kinds == set(_CANNOT[which])
    assert kinds <= _ALL


@pytest.mark.limit(40)
@pytest.mark.parametrize("which", _READ, ids=" ".join)
def test_every_event_says_what_changed_with_the_vendors_raw_value(
    which: tuple[str, str], told: dict[tuple[str, str], list[Event]]
) -> None:
    for event in told[which]:
        assert event.before != event.after
        assert event.raw or event.kind in _OF_LINK, event
        assert any(value is not None for value in event.raw.values()) or event.after is None or event.kind in _OF_LINK


@pytest.mark.limit(40)
@pytest.mark.parametrize("which", [which for which, cannot in _CANNOT.items() if len(cannot) < 2], ids=" ".join)
def test_what_begins_also_ends_in_turns(which: tuple[str, str], told: dict[tuple[str, str], list[Event]]) -> None:
    for begins, ends in (
        ("motion.started", "motion.stopped"),
        ("estop.pressed", "estop.released"),
        ("collision.detected", "collision.cleared"),
    ):
        seen = [event.kind.value for event in told[which] if event.kind.value in {begins, ends}]
        assert seen == _turns(begins, ends, len(seen))


def _turns(one: str, other: str, count: int) -> Sequence[str]:
    return [one if number % 2 == 0 else other for number in range(count)]
