"""The sessions of the virtual Rainbow controller, one class a port."""

from __future__ import annotations

from typing import cast

import msgspec

from gateway.sim.simulator import VirtualRobot
from vendors.rainbow.simulator.encoding import Encoder, RainbowOptions

REQUEST = b"reqdata"


class StateSession:
    """Port 5001: one frame for each request, with or without a newline behind it."""

    period_s: float | None = None

    def __init__(self, robot: VirtualRobot, options: msgspec.Struct) -> None:
        self._robot = robot
        self._encoder = Encoder(robot, cast("RainbowOptions", options))
        self._rest = b""

    def received(self, data: bytes, now_s: float) -> list[bytes]:
        """Answer every request; one that is cut in two is found too."""
        data = self._rest + data
        requests = data.count(REQUEST)
        self._rest = _unfinished(data)
        self._robot.requests += requests
        return [self._encoder.frame(now_s) for _ in range(requests)]

    def due(self, _now_s: float) -> list[bytes]:
        """Nothing is pushed."""
        return []


def _unfinished(data: bytes) -> bytes:
    """The end of the data that may be the beginning of a request."""
    for length in range(min(len(REQUEST) - 1, len(data)), 0, -1):
        if REQUEST.startswith(data[-length:]):
            return data[-length:]
    return b""


class CommandSession:
    """Port 5000: every command is acknowledged and none is executed."""

    period_s: float | None = None

    def __init__(self, _robot: VirtualRobot, _options: msgspec.Struct) -> None:
        pass

    def received(self, data: bytes, _now_s: float) -> list[bytes]:
        """Acknowledge each line; the last one needs no newline."""
        answers = []
        for line in data.splitlines():
            if not line.strip():
                continue
            answers.append(b"The command was executed\n")
            if b"get_control_box_info()" in line:
                answers.append(b"info[controlbox][8.7.3,1]\n")
        return answers

    def due(self, _now_s: float) -> list[bytes]:
        """Nothing is pushed."""
        return []
