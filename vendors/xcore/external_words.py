"""The words of External Communication that only ask, and how their answers are read.

Source: xCore Control System User Manual V2.2_A, 10.3 External communication. `false` also means that the query has
failed, which the manual says of every word that answers true or false.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass

from gateway.api.record import Record, Value

SOURCE = "xCore Control System User Manual V2.2_A, 10.3 External communication"
FLAGS = {b"true": True, b"false": False, b"null": None}
CART_POS = 10  # x y z, a b c, q1 to q4
LONGEST = 4096  # bytes of an answer; the longest of the manual, ten numbers, has some 200

_NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
_NUMBERS = re.compile(rf"\s*({_NUMBER}(?:[\s,;\u3001]+{_NUMBER})*)[\s,;\u3001]*")
_NUMBERISH = re.compile(rf"\s*(?:{_NUMBER}|[+-]?(?:nan|inf))[\s,;\u3001]", re.IGNORECASE)  # the first of several
_PREFIX = re.compile(r"\s*([A-Za-z_]+)\s*:")  # of the forms of a word that name it
_SEPARATOR = re.compile(r"[\s,;\u3001]+")
_HIGHEST = 1e9  # no joint, length, speed or torque is beyond
_FEWEST = 3  # joint values of the smallest arm
_MOST_JOINTS = 13  # seven of the arm, and six beyond it
TASKS = ("ready", "jog", "load_identify", "dynamic_identify", "drag", "program", "demo", "rci", "debug")
_TASK = re.compile(r"[a-z]+(?:_[a-z]+)*")  # one that the manual does not list
_NO_TEXT = {flag.decode() for flag in FLAGS if FLAGS[flag] is not None}


class BadAnswerError(ValueError):
    """An answer that is none to its word; the text says what was found and what is expected."""


class OtherAnswerError(BadAnswerError):
    """An answer that can only be another word's: it has another shape."""


Parse = Callable[[str, int], object]


def _numbers(text: str) -> list[float]:
    found = _NUMBERS.fullmatch(text)
    if found is None:
        error = BadAnswerError if _NUMBERISH.match(text) else OtherAnswerError
        raise error(f"{_shown(text)} are no numbers")
    numbers = [float(one) for one in _SEPARATOR.split(found[1])]
    if any(abs(one) > _HIGHEST for one in numbers):
        raise BadAnswerError(f"{_shown(text)} holds a number beyond all measure")
    return numbers


def _joints(text: str, axes: int) -> list[float]:
    numbers = _numbers(text)
    if len(numbers) < axes:
        raise BadAnswerError(f"{len(numbers)} numbers for {axes} axes: if the robot has fewer, set axes")
    if len(numbers) > _MOST_JOINTS:
        raise BadAnswerError(f"{len(numbers)} numbers, and no robot has more than {_MOST_JOINTS} axes")
    return numbers


def _pose(text: str, _axes: int) -> list[float]:
    numbers = _numbers(text)
    if len(numbers) != CART_POS:
        raise OtherAnswerError(f"{len(numbers)} numbers, not {CART_POS}: x y z, a b c, q1 to q4")
    return numbers


def _text(text: str, _axes: int) -> str | None:
    if not all(character.isprintable() or character.isspace() for character in text):
        raise BadAnswerError(f"{_shown(text)} is no text that can be printed")
    told = text.strip()
    prefix = _PREFIX.match(told)
    if prefix is not None and prefix[1].lower() in WORDS:
        raise OtherAnswerError(f"{_shown(text)} is the answer to another word")
    if told in _NO_TEXT or (_NUMBERS.fullmatch(told) and len(_SEPARATOR.findall(told)) >= _FEWEST - 1):
        raise OtherAnswerError(f"{_shown(text)} is no text but the answer to another word")
    return None if told in {"", "null"} else told


def _task(text: str, _axes: int) -> str:
    told = text.strip()
    if told not in TASKS and (told in {*_NO_TEXT, "null"} or not _TASK.fullmatch(told)):
        raise OtherAnswerError(f"{_shown(text)} is no task, such as ready or program")
    return told


def _shown(text: str) -> str:
    return repr(text if len(text) <= 40 else f"{text[:40]}…")  # noqa: PLR2004 - what fits into a line


@dataclass(frozen=True, slots=True, kw_only=True)
class Word:
    """One word that may be asked.

    Args:
        name: The word itself.
        value: What it answers, as a row of the record.
        parse: Reads an answer that ends with the suffix; None: the answer is true, false or null, and complete by that.
        wish_hz: How often it is asked if nothing else is configured; 0: not.
    """

    name: str
    value: Value
    parse: Parse | None = None
    wish_hz: float = 0.0

    @property
    def kind(self) -> str:
        """What its answer looks like; an answer of one kind is none of another."""
        if self.parse is None:
            return "flag"
        if self.value.type is str:
            return "text"
        return "pose" if self.parse is _pose else "joints"

    def told_in(self, text: str) -> str:
        """An answer without the prefix that may name its word: `Jnt_vel : `.

        Raises:
            BadAnswerError: It names another word.
        """
        found = None if self.value.type is str else _PREFIX.match(text)
        if found is None:
            return text
        if found[1].lower() != self.name:
            raise OtherAnswerError(f"{_shown(text)} is the answer to another word")
        return text[found.end() :]


def _flag(name: str, meaning: str, wish_hz: float) -> Word:
    return Word(name=name, value=Value(name=name, type=bool, meaning=meaning), wish_hz=wish_hz)


def _array(name: str, unit: str | None, meaning: str, wish_hz: float, parse: Parse = _joints) -> Word:
    value = Value(name=name, type=list[float], unit=unit, meaning=meaning)
    return Word(name=name, value=value, parse=parse, wish_hz=wish_hz)


def _words(name: str, meaning: str, wish_hz: float, parse: Parse = _text) -> Word:
    return Word(name=name, value=Value(name=name, type=str, meaning=meaning), parse=parse, wish_hz=wish_hz)


_MORE = "axes beyond those of the arm follow, the rail in"
WORDS: dict[str, Word] = {
    word.name: word
    for word in (
        _array("jnt_pos", "rad", f"Joint positions; {_MORE} m", 2.0),
        _array("cart_pos", "mm|deg", "x y z, a b c, and a quaternion q1 to q4 whose order is not stated", 2.0, _pose),
        _flag("estop_state", "What it means depends on the controller's setting `e-stop level type`", 1.0),
        _flag("fault_state", "true: fault", 1.0),
        _array("jnt_vel", "rad/s", f"Joint velocities; {_MORE} m/s", 0.5),
        _array("jnt_trq", None, "Joint torques, in N·m or per mille of the rated torque: the manual says both", 0.5),
        _flag("collision_state", "true: collision; cobots only", 0.5),
        _flag("motor_on_state", "true: motors on", 0.5),
        _flag("robot_running_state", "true: a program runs", 0.5),
        _flag("operating_mode", "true: automatic; false: manual or waiting", 0.5),
        _words("task_state", ", ".join(TASKS), 0.5, _task),
        _words("current_prog", "Name of the loaded program; null: none", 0.5),
        _flag("home_state", "true: the home output is active", 0.0),
        _words("list_prog", "Names of the programs", 0.0),
        _words("state", "A word of older controllers, which the manual no longer lists", 0.0),
        _words("alarm_info", "A word of older controllers, which the manual no longer lists", 0.0),
    )
}

KINDS = {word.name: word.kind for word in WORDS.values()}

# What moves or switches something: listed so that no suffix can hold one of them.
CONTROL_WORDS = (
    "start",
    "stop",
    "clear_alarm",
    "pp_to_main",
    "motor_on",
    "motor_off",
    "switch_mode",
    "open_drag",
    "close_drag",
    "load_prog",
    "SocketInterface",
)

RECORD = Record(
    name="External communication",
    fields=tuple(word.value for word in WORDS.values()),
    source=SOURCE,
)
