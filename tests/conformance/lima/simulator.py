"""The virtual controller of an invented vendor."""

from __future__ import annotations

import math

import msgspec

from gateway.sim.simulator import Port, Simulator, VirtualRobot


class LinesSession:
    """Pushes a hello, then a line of state a period."""

    period_s: float | None = 0.02

    def __init__(self, robot: VirtualRobot, _options: msgspec.Struct) -> None:
        self._robot = robot
        self._seq = 0

    def received(self, _data: bytes, _now_s: float) -> list[bytes]:
        """Nobody asks anything."""
        return []

    def due(self, now_s: float) -> list[bytes]:
        """The next line; first a hello, and an empty line."""
        state = self._robot.state(now_s)
        self._seq += 1
        line = {
            "type": "state",
            "seq": self._seq,
            "angles": [math.degrees(angle) for angle in state.position[:3]],
            "volts": 24.0,
            "mode": "auto",
            "collision": state.phase.collision,
        }
        raw = msgspec.json.encode(line) + b"\n"
        self._robot.count(raw, now_s, lambda: line)
        return [b'{"type":"hello"}\n\n', raw] if self._seq == 1 else [raw]


SIMULATOR = Simulator(ports=(Port(protocol="lines", port=4712, session=LinesSession),))
