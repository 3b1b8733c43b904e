"""What a vendor's `simulator` exports, and the virtual robot that its sessions speak for: sans-I/O, like decoders.

A `Simulator` has one or more `Port`s; each makes a `VirtualSession` for every connection.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Protocol

import msgspec

from gateway.api.vendor import Transport
from gateway.sim.scenario import RobotState, Scenario

HIGHEST_PORT = 65535


class VirtualSession(Protocol):
    """One client's connection to a virtual controller.

    Attributes:
        period_s: How often `due` wants to be called; None: never. It may change whenever bytes were received.
    """

    period_s: float | None

    def received(self, data: bytes, now_s: float, /) -> list[bytes]:
        """Take bytes, cut anywhere, and return the segments to send: one item is one send."""
        ...

    def due(self, now_s: float, /) -> list[bytes]:
        """Return the segments that are pushed now."""
        ...


@dataclass(frozen=True, slots=True)
class Sent:
    """One frame that was sent, and what it meant."""

    number: int
    now_s: float
    frame: bytes
    meant: Callable[[], Mapping[str, object]]

    def values(self) -> Mapping[str, object]:
        """Return the values that were put into the frame, by field."""
        return self.meant()


class VirtualRobot:
    """One virtual controller and its arm: a scenario, and counters that tests read.

    Args:
        scenario: What happens to it.
        start_s: When the scenario began, by the clock of the sessions' `now_s`.
        number: Which of several controllers it is, from 0.
        seed: For what is random about it.
        keep: How many of the last frames are kept in `sent`.

    Attributes:
        connections: How many connections were made to its state ports.
        requests: How many requests came in.
        frames: How many state frames went out.
        faults: How often chaos struck, by fault.
        sent: The last frames with what they meant, oldest first.
        settings: What clients have set, by a name of the vendor's; it outlasts their connections.
    """

    def __init__(
        self,
        scenario: Scenario,
        *,
        start_s: float = 0.0,
        number: int = 0,
        seed: int = 0,
        keep: int = 0,
    ) -> None:
        self.scenario = scenario
        self.number = number
        self.seed = seed
        self.connections = 0
        self.requests = 0
        self.frames = 0
        self.faults: Counter[str] = Counter()
        self.settings: dict[str, object] = {}
        self.sent: deque[Sent] = deque(maxlen=keep)
        self._start_s = start_s

    def play(self, scenario: Scenario, now_s: float) -> None:
        """Begin another scenario now."""
        self.scenario = scenario
        self._start_s = now_s

    def state(self, now_s: float) -> RobotState:
        """Return what the robot is and does."""
        return self.scenario.at(max(0.0, now_s - self._start_s))

    def count(self, frame: bytes, now_s: float, meant: Callable[[], Mapping[str, object]]) -> None:
        """Count a state frame that is being sent, and keep it with what it means."""
        self.frames += 1
        if self.sent.maxlen:
            self.sent.append(Sent(self.frames, now_s, frame, meant))


@dataclass(frozen=True, slots=True, kw_only=True)
class Port:
    """One listener of a virtual controller, or what calls a gateway instead.

    Args:
        protocol: The protocol that reads state there; None for a port that is no state protocol, which has no chaos and
            may be missing.
        port: The vendor's port.
        session: Makes the session of one connection from the robot and the simulator's options; over UDP one for each
            address that sends something.
        transport: `tcp` or `udp`.
        header: How many bytes of a frame are its header.
        fillers: Known frames that carry no state, for chaos to send in between.
        offered: Whether a controller with some options listens there at all; an older firmware may not.
        calls: The gateway, as host and port, that a controller with some options calls over TCP; None: it listens.
    """

    protocol: str | None
    port: int
    session: Callable[[VirtualRobot, msgspec.Struct], VirtualSession]
    transport: Transport = "tcp"
    header: int = 0
    fillers: tuple[bytes, ...] = ()
    offered: Callable[[msgspec.Struct], bool] = lambda _options: True
    calls: Callable[[msgspec.Struct], tuple[str, int] | None] = lambda _options: None


class NoSimulatorOptions(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The options of a simulator that has none."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Demo:
    """One way of reading a virtual controller: a robot of the demo, and what a test of the protocol begins with.

    Args:
        protocol: What is spoken.
        robot: Further keys of the robot's table in the configuration; the protocol's options stand in a mapping under
            its name.
    """

    protocol: str
    robot: Mapping[str, object] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True)
class Simulator:
    """A vendor's virtual controller.

    Args:
        ports: The main port first.
        options: A frozen msgspec struct of the vendor's own options; every field has a default and a description.
        demos: The ways of reading it that a demo shows; for each protocol the first is the usual one.
    """

    ports: tuple[Port, ...]
    options: type[msgspec.Struct] = NoSimulatorOptions
    demos: tuple[Demo, ...] = ()

    def keys(self, protocol: str) -> Mapping[str, object]:
        """Return the keys that a robot of a protocol needs in the configuration besides host and port."""
        return next((demo.robot for demo in self.demos if demo.protocol == protocol), {})

    def port_numbers(self, main: int | None) -> tuple[int, ...]:
        """Return the number of each port.

        Args:
            main: Overrides the main port, and the others keep their distance; 0 lets the system choose each; None is
                the vendor's.

        Raises:
            ValueError: A port would not be from 1 to 65535.
        """
        if main == 0:
            return (0,) * len(self.ports)
        shift = 0 if main is None else main - self.ports[0].port
        numbers = tuple(port.port + shift for port in self.ports)
        if not all(0 < number <= HIGHEST_PORT for number in numbers):
            shown = ", ".join(str(number) for number in numbers)
            raise ValueError(f"port {main} would need the ports {shown}: they go from 1 to {HIGHEST_PORT}")
        return numbers
