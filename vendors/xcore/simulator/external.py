"""The virtual controller's side of External Communication: one answer for each monitor word, none for any other.

Words and answers: manual V2.2_A, 10.3. Control words are counted and not obeyed.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from functools import partial
from typing import cast

import msgspec

from gateway.api.lines import Lines
from gateway.sim.scenario import RobotState
from gateway.sim.simulator import VirtualRobot
from vendors.xcore.simulator import telling
from vendors.xcore.simulator.options import XcoreOptions
from vendors.xcore.simulator.telling import DEG

# Keys of VirtualRobot.settings: how many words came that ask for something to happen, and that nobody knows.
CONTROL_WORDS = "control_words"
UNKNOWN_WORDS = "unknown_words"

_LONGEST_WORD = 1024
_LOOK_S = 0.002  # how often a slow controller looks whether its answer is due
_DIGITS = 12
_MM = 1000.0
_NULL = "null"

_CONTROL = (
    "start", "stop", "clear_alarm", "pp_to_main", "motor_on", "motor_off", "switch_mode:auto", "switch_mode:manual",
    "open_drag", "close_drag", "xCore::SocketInterface::Enable", "xCore::SocketInterface::Disable",
)  # fmt: skip
_CONTROL_WITH_NAME = "load_prog"

_BOOLEANS: Mapping[str, Callable[[RobotState], bool]] = {
    "motor_on_state": telling.powered,
    "robot_running_state": telling.running,
    "estop_state": lambda state: state.phase.estop,
    "fault_state": lambda state: state.phase.fault is not None,
    "operating_mode": telling.automatic,
    "home_state": telling.at_home,
    "collision_state": lambda state: state.phase.collision,
}
_ESTOP = "estop_state"


def _positions(state: RobotState, options: XcoreOptions) -> list[float]:
    return telling.joints(state, options) + telling.extras(options)


def _velocities(state: RobotState, options: XcoreOptions) -> list[float]:
    return telling.velocities(state, options) + [0.0] * options.extra_joints


def _torques(state: RobotState, options: XcoreOptions) -> list[float]:
    found = telling.torques(state, options)
    if options.torque_unit == "permille":
        found = [1000 * torque / rated for torque, rated in zip(found, telling.RATED_TORQUE, strict=False)]
    return found + [0.0] * options.extra_joints


def _pose(state: RobotState, _options: XcoreOptions) -> list[float]:
    tcp = state.tcp
    return [
        *(_MM * metres for metres in tcp.position),
        *(DEG * angle for angle in tcp.rpy),
        *telling.quaternion(tcp.rpy),
    ]


_NUMBERS: Mapping[str, tuple[str, Callable[[RobotState, XcoreOptions], list[float]]]] = {
    "jnt_pos": ("", _positions),
    "jnt_pos_name": ("jnt_pos : ", _positions),
    "jnt_vel": ("", _velocities),
    "jnt_vel_name": ("Jnt_vel : ", _velocities),
    "jnt_trq": ("", _torques),
    "jnt_trq_name": ("Jnt_trq : ", _torques),
    "cart_pos": ("", _pose),
    "cart_pos_name": ("cart_pos : ", _pose),
}


def _task(state: RobotState, _options: XcoreOptions) -> str:
    if state.phase.freedrive:
        return "drag"
    return "program" if telling.running(state) else "ready"


def _projects(_state: RobotState, options: XcoreOptions) -> str:
    return options.separator.join(telling.PROJECTS)


def _project(state: RobotState, _options: XcoreOptions) -> str:
    return telling.project(state) or _NULL


_TEXTS: Mapping[str, Callable[[RobotState, XcoreOptions], str]] = {
    "task_state": _task,
    "list_prog": _projects,
    "current_prog": _project,
}


class ExternalSession:
    """One connection, whoever made it: it is the gateway that asks."""

    def __init__(self, robot: VirtualRobot, options: msgspec.Struct) -> None:
        self._robot = robot
        self._options = cast("XcoreOptions", options)
        self._end = self._options.ending
        self._slow_s = self._options.slow_ms / 1000
        self._lines = Lines(self._end, _LONGEST_WORD)
        self._owed: deque[tuple[float, str]] = deque()
        self.period_s: float | None = _LOOK_S if self._slow_s else None

    def received(self, data: bytes, now_s: float) -> list[bytes]:
        """Take words, and answer them in their order."""
        for line in self._lines.feed(data):
            if isinstance(line, bytes):
                self._take(line[: -len(self._end)].decode("utf-8", "replace"), now_s)
        return self.due(now_s)

    def due(self, now_s: float) -> list[bytes]:
        """Return the answers whose time has come; each tells what is then."""
        answers = []
        while self._owed and self._owed[0][0] <= now_s:
            answers.append(self._answer(self._owed.popleft()[1], now_s))
        return answers

    def _take(self, word: str, now_s: float) -> None:
        self._robot.requests += 1
        if word in _CONTROL or word.startswith(_CONTROL_WITH_NAME):
            self._count(CONTROL_WORDS)
        elif word in self._options.unknown or not _known(word):
            self._count(UNKNOWN_WORDS)
        else:
            before_s = self._owed[-1][0] if self._owed else now_s
            self._owed.append((max(now_s, before_s) + self._slow_s, word))

    def _count(self, name: str) -> None:
        self._robot.settings[name] = cast("int", self._robot.settings.get(name, 0)) + 1

    def _answer(self, word: str, now_s: float) -> bytes:
        value, answer = self._told(word, self._robot.state(now_s))
        self._robot.count(answer, now_s, partial(dict, {word: value}))
        return answer

    def _told(self, word: str, state: RobotState) -> tuple[object, bytes]:
        """The value of a word, and the answer that tells it."""
        options = self._options
        if word in _NUMBERS:
            prefix, read = _NUMBERS[word]
            numbers = read(state, options)
            text = options.separator.join(f"{number:.{_DIGITS}f}" for number in numbers)
            return numbers, f"{prefix}{text}".encode() + self._end
        if word in _TEXTS:
            text = _TEXTS[word](state, options)
            return text, text.encode() + self._end
        found = _BOOLEANS[word](state) != (word == _ESTOP and options.estop_level == "low")
        answer = b"true" if found else b"false"
        return found, answer + self._end if options.suffix_after_booleans else answer


def _known(word: str) -> bool:
    return word in _BOOLEANS or word in _NUMBERS or word in _TEXTS
