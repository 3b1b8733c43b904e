"""The virtual controller of an invented vendor that answers words."""

from __future__ import annotations

import math

import msgspec

from gateway.sim.scenario import RobotState
from gateway.sim.simulator import Port, Simulator, VirtualRobot


class WordsSession:
    """Answers each word."""

    period_s: float | None = None

    def __init__(self, robot: VirtualRobot, _options: msgspec.Struct) -> None:
        self._robot = robot
        self._buffer = b""

    def received(self, data: bytes, now_s: float) -> list[bytes]:
        """Answer the words that are whole."""
        *words, self._buffer = (self._buffer + data).split(b"\r")
        answers = []
        for word in words:
            answer = _answer(word.decode(), self._robot.state(now_s))
            self._robot.requests += 1
            self._robot.count(answer, now_s, dict)
            answers.append(answer)
        return answers

    def due(self, _now_s: float) -> list[bytes]:
        """Nothing is pushed."""
        return []


def _answer(word: str, state: RobotState) -> bytes:
    if word == "moving":
        return b"true" if state.moving else b"false"
    told = {"pos": ",".join(f"{math.degrees(angle):.4f}" for angle in state.position[:3]), "volts": "24.0"}
    return told.get(word, "auto").encode() + b"\r"


SIMULATOR = Simulator(ports=(Port(protocol="words", port=4713, session=WordsSession),))
