"""Scenarios: what happens to a virtual robot, as data, and its state as a pure function of time.

A scenario is a row of phases that loops. Nothing here knows a vendor: its simulator says all this in its own words.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property
from itertools import accumulate

import msgspec

from gateway.api.model import Power, ProgramState
from gateway.sim import motion
from gateway.sim.motion import CYCLE_S, ArmPose, Six


class FaultKind(StrEnum):
    """What can fail, in words that every vendor has a code for."""

    OVER_CURRENT = "over_current"
    OVER_TEMPERATURE = "over_temperature"
    ENCODER = "encoder"
    FOLLOWING_ERROR = "following_error"


@dataclass(frozen=True, slots=True)
class Fault:
    """A fault of one joint; joints count from 0 at the base."""

    kind: FaultKind
    joint: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Phase:
    """A stretch of time in which only the motion changes.

    Args:
        name: Shown to people.
        seconds: How long it lasts.
        rate: Speed along the path: 1 is the program at full speed, 0 stands still.
        ramp_s: How long the arm takes from the rate before to this one.
        power: How far the arm is powered up.
        program: What the program does.
        freedrive: Somebody guides the arm by hand.
        collision: A collision was noticed and stopped the arm.
        fault: What is broken, or None.
        estop: The emergency stop is pressed.
        speed_override: Where the speed bar stands, 0 to 1.
    """

    name: str
    seconds: float
    rate: float = 0.0
    ramp_s: float = 0.5
    power: Power = Power.ENABLED
    program: ProgramState = ProgramState.STOPPED
    freedrive: bool = False
    collision: bool = False
    fault: Fault | None = None
    estop: bool = False
    speed_override: float = 1.0

    def __post_init__(self) -> None:
        if not 0 <= self.ramp_s <= self.seconds:
            raise ValueError(
                f"phase {self.name}: ramp_s is {self.ramp_s}, seconds {self.seconds}: 0 <= ramp_s <= seconds"
            )


class RobotState(msgspec.Struct, frozen=True, gc=False):
    """What a virtual robot is and does at one moment.

    Attributes:
        time_s: Time since the scenario began.
        phase: What is going on: the same object as long as the phase lasts.
        progress: How much of the phase is over, 0 to 1.
        moving: Whether the arm moves, by program or by hand.
        position: Measured joint angles, rad.
        target_position: Commanded joint angles, rad.
        velocity: Joint velocities, rad/s.
        current: Joint currents, A.
        temperature: Joint temperatures, K.
        tcp: Pose and speed of the TCP, of the commanded angles.
        cycles: Finished cycles of the path.
        program_s: How long the program has run, pauses included; 0 where it does not run.
        gripper_closed: The gripper's output and its feedback.
    """

    time_s: float
    phase: Phase
    progress: float
    moving: bool
    position: Six
    target_position: Six
    velocity: Six
    current: Six
    temperature: Six
    tcp: ArmPose
    cycles: int
    program_s: float
    gripper_closed: bool


_NO_CURRENT: Six = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
_GRIPPED = (0.25, 0.75)  # the part of a cycle in which the gripper is closed


@dataclass(frozen=True)
class Scenario:
    """A named row of phases that loops.

    Args:
        name: What `--scenario` calls it.
        meaning: One line for people.
        phases: At least one.
    """

    name: str
    meaning: str
    phases: tuple[Phase, ...]

    @cached_property
    def seconds(self) -> float:
        """How long one loop lasts."""
        return sum(phase.seconds for phase in self.phases)

    def at(self, time_s: float) -> RobotState:
        """Return the state at a time since the scenario began."""
        loop, within = divmod(time_s, self.seconds)
        number = bisect_right(self._starts, within) - 1
        phase = self.phases[number]
        since = within - self._starts[number]
        place, rate = self._along(number, since)
        place += loop * self._loop_place_s + self._places_s[number]
        target, velocity = motion.target(place, rate)
        powered = phase.power is Power.ENABLED
        cycles, part = divmod(place / CYCLE_S, 1.0)
        return RobotState(
            time_s=time_s,
            phase=phase,
            progress=since / phase.seconds,
            moving=rate > 0,
            position=motion.measured(target, velocity),
            target_position=target,
            velocity=velocity,
            current=motion.currents(target, velocity) if powered else _NO_CURRENT,
            temperature=motion.temperatures(time_s),
            tcp=motion.forward(target, velocity),
            cycles=int(cycles),
            program_s=self._program_s(number, since, loop),
            gripper_closed=_GRIPPED[0] <= part < _GRIPPED[1],
        )

    @cached_property
    def _starts(self) -> tuple[float, ...]:
        return (0.0, *accumulate(phase.seconds for phase in self.phases[:-1]))

    @cached_property
    def _places_s(self) -> tuple[float, ...]:
        """The place on the path where each phase begins; the last item is where the loop ends."""
        ends = (self._along(number, phase.seconds)[0] for number, phase in enumerate(self.phases))
        return (0.0, *accumulate(ends))

    @cached_property
    def _loop_place_s(self) -> float:
        return self._places_s[-1]

    @cached_property
    def _program_began_s(self) -> tuple[float | None, ...]:
        """When the program of each phase was started, by the loop's time; None where none runs."""
        began: list[float | None] = []
        before: float | None = None
        for phase, start in zip(self.phases, self._starts, strict=True):
            if phase.program is ProgramState.STOPPED:
                before = None
            elif before is None:
                before = start
            began.append(before)
        return tuple(began)

    def _along(self, number: int, since_s: float) -> tuple[float, float]:
        """How far along the path a phase has come, and at what rate; the rate never jumps, not at the loop's end."""
        phase = self.phases[number]
        before = self.phases[number - 1].rate
        if since_s >= phase.ramp_s:
            return (before + phase.rate) / 2 * phase.ramp_s + phase.rate * (since_s - phase.ramp_s), phase.rate
        rate = before + (phase.rate - before) * since_s / phase.ramp_s
        return (before + rate) / 2 * since_s, rate

    def _program_s(self, number: int, since_s: float, loop: float) -> float:
        began = self._program_began_s[number]
        if began is None:
            return 0.0
        never_stops = None not in self._program_began_s
        return self._starts[number] + since_s - began + (loop * self.seconds if never_stops else 0.0)


def _program(seconds: float, **changes: float) -> Phase:
    rate = changes.get("speed_override", 1.0)
    return Phase(name="program runs", seconds=seconds, rate=rate, program=ProgramState.RUNNING, speed_override=rate)


def _idle(seconds: float) -> Phase:
    return Phase(name="idle", seconds=seconds)


def _power_up() -> Iterator[Phase]:
    yield Phase(name="power is off", seconds=2, power=Power.OFF)
    yield Phase(name="activation", seconds=3, power=Power.BOOTING)


def _pause(seconds: float) -> Phase:
    return Phase(name="program pauses", seconds=seconds, program=ProgramState.PAUSED)


def _freedrive(seconds: float) -> Phase:
    return Phase(name="freedrive", seconds=seconds, rate=0.25, freedrive=True)


def _collision(seconds: float) -> Phase:
    paused = ProgramState.PAUSED
    return Phase(name="collision", seconds=seconds, ramp_s=0.1, program=paused, collision=True)


def _fault(seconds: float) -> Phase:
    return Phase(name="fault", seconds=seconds, ramp_s=0.1, fault=Fault(FaultKind.OVER_CURRENT, 2))


def _estop(seconds: float) -> Phase:
    return Phase(name="emergency stop pressed", seconds=seconds, ramp_s=0.1, power=Power.OFF, estop=True)


_CELL = (
    _idle(3),
    _program(10),
    _pause(3),
    _program(8, speed_override=0.6),
    _idle(2),
    _freedrive(5),
    _idle(2),
    _program(6),
    _collision(3),
    _idle(2),
    _program(6),
    _fault(4),
    _idle(2),
    _program(6),
    _estop(4),
    *_power_up(),
)

SCENARIOS: Mapping[str, Scenario] = {
    scenario.name: scenario
    for scenario in (
        Scenario("cell", "all of these in turn, and a power-up", _CELL),
        Scenario("steady", "a program that runs for ever", (_program(3600),)),
        Scenario("idle", "an arm under power that stands still", (_idle(3600),)),
        Scenario("pause", "a program that pauses and resumes", (_program(5), _pause(3))),
        Scenario("freedrive", "an arm that is guided by hand", (_idle(2), _freedrive(5))),
        Scenario("collision", "a program that collides", (_program(5), _collision(3), _idle(2))),
        Scenario("fault", "a joint that fails and is reset", (_program(5), _fault(3), _idle(2))),
        Scenario(
            "estop", "the emergency stop is pressed and released", (_program(4), _estop(3), *_power_up(), _idle(1))
        ),
        Scenario(
            "off", "a controller whose arm has no power", (Phase(name="power is off", seconds=3600, power=Power.OFF),)
        ),
    )
}


def find_scenario(name: str) -> Scenario:
    """Find a scenario.

    Raises:
        ValueError: There is none of that name.
    """
    if name not in SCENARIOS:
        raise ValueError(f"no scenario {name!r}; there are {', '.join(SCENARIOS)}")
    return SCENARIOS[name]
