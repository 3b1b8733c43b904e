"""The decoder of our stream `xcore-objects/1`: one JSON object a line, hello first; see docs/xcore-objects.md.

The gateway only listens; what it may ask besides are reading commands, each answered by one result.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from typing import Annotated, cast

import msgspec
from msgspec import Meta

from gateway.api.asking import Rota
from gateway.api.decoder import Entry, Event, Frame, Occurrence, Refused, Reject, Skipped
from gateway.api.lines import Lines
from gateway.api.model import Command, CommandFeedback, CommandsMissed, EventKind
from gateway.api.numbers import Numbers
from gateway.api.vendor import DecoderFactory
from vendors.xcore.checking import ObjectError, list_problems_of, object_of
from vendors.xcore.log_faults import MOST, LogFaults
from vendors.xcore.objects import Info, LogInfo
from vendors.xcore.stream_record import LONGEST, RECORD, SCHEMA, UNITS
from vendors.xcore.stream_record import Entry as LogEntry

TICK_S = 0.1
# Reading commands that are asked for by name, and nothing else.
OUTGOING = rb'\{"type":"command","id":"g[0-9]+","name":"(?:toolset)","args":\{\}\}\n'
_ANSWER_TICKS = 50  # a reading command without a result for so long is given up
# What may be asked: reading commands whose result fills a value of the record.
QUESTIONS = ("toolset",)
_OBJECTS = {"cartPosture": "CartesianPosition", "keypad": "KeyPadState", "toolset": "Toolset"}
_PER_AXIS = ("jointPos", "jointVel", "jointTorque")
_HELD = {"collided", "rlExecution", "connected", "log", "faults"}
_STATE = frozenset(RECORD.by_name) - _HELD - {"ts", "toolset"}
_LATEST_US = 253_402_300_800_000_000  # the year 10000
_MOST = 2**53  # a number of messages beyond this is none
_WORD = (-(2**63), 2**64)  # whole numbers that every encoding can carry
_LONG = re.compile(rb"[\[:,\s-]\d{19}")  # what may be a whole number beyond
_SHOWN = 160  # characters of the agent's own words in a message
Wish = Annotated[
    float,
    Meta(
        ge=0.5, le=10, description="How often it is asked, in Hz: a value that is older than stale_s is told no more."
    ),
]
Json = Mapping[str, object]


class ObjectsOptions(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Options of the `objects` protocol."""

    ask: Annotated[
        dict[str, Wish],
        Meta(
            description="Reading commands that the gateway sends to the agent, each with its rate in Hz; every one is "
            f"a call of the vendor's SDK. Known: {', '.join(QUESTIONS)}."
        ),
    ] = {}

    def __post_init__(self) -> None:
        unknown = [name for name in self.ask if name not in QUESTIONS]
        if unknown:
            raise ValueError(f"ask: {unknown[0]!r} is no reading command whose result is used; {', '.join(QUESTIONS)}")


class BadMessageError(ValueError):
    """A message that cannot be used.

    Attributes:
        reason: A short, stable word that rejects are counted by.
    """

    def __init__(self, reason: str, detail: str) -> None:
        super().__init__(detail)
        self.reason = reason


class ObjectsDecoder:
    """One session with an agent.

    Args:
        options: The robot's options.
    """

    def __init__(self, options: ObjectsOptions) -> None:
        self._lines = Lines(b"\n", LONGEST)
        self._numbers = Numbers()
        self._rota = Rota(options.ask, 1 / TICK_S)
        self._faults = LogFaults()
        self._info: Info | None = None
        self._asked: dict[str, tuple[str, int]] = {}  # id -> what was asked, and in which tick
        self._ticks = self._questions = self._unanswered = 0
        self._held: dict[str, object] = {}  # what events have told, until the next of their kind
        self._refusals: dict[str, str] = {}
        self._farewell = self._bad_hello = ""
        self.ready = False

    @property
    def notes(self) -> Sequence[str]:
        """What the operator should know of this session."""
        found = []
        if self._bad_hello:
            found.append(f"the agent's hello cannot be used: {self._bad_hello}")
        elif not self.ready:
            found.append("connected, but no hello came: is it the agent of xcore-objects that listens there?")
        if self._farewell:
            found.append(f"the agent closes the connection and says: {self._farewell}")
        if self._held.get("connected") is False:
            found.append("the agent says that its SDK has lost the controller")
        found += [f"the agent refuses {name}: {why}" for name, why in self._refusals.items()]
        if self._faults.left_out:
            found.append(f"{self._faults.left_out} more log entries came than the {MOST} that are kept as faults")
        if self._unanswered:
            found.append(f"{self._unanswered} reading commands were not answered within {_ANSWER_TICKS * TICK_S:g} s")
        return found

    @property
    def gaps(self) -> int | None:
        """How many messages the agent has numbered and we did not see."""
        return self._numbers.gaps

    @property
    def pending(self) -> int:
        """How many bytes wait for the end of their line."""
        return self._lines.pending

    def feed(self, data: bytes) -> list[Event]:
        """Take received bytes and return what they completed."""
        events: list[Event] = []
        for line in self._lines.feed(data):
            events += self._line(line) if isinstance(line, bytes) else self._no_line(line)
        return events

    def _no_line(self, piece: Reject | Skipped) -> list[Event]:
        """What is too long, or no JSON object, may have held commands: nobody can know."""
        if not self.ready or isinstance(piece, Skipped):
            return [piece]
        return [piece, Occurrence(b"", (Entry(EventKind.COMMAND_MISSED, CommandsMissed(), {"reason": piece.reason}),))]

    def end(self) -> list[Reject]:
        """Return what is left in the buffer."""
        return self._lines.end()

    def outgoing(self) -> bytes:
        """Nothing is owed: the agent speaks first."""
        return b""

    def asked(self, data: bytes) -> None:
        """Take a reading command that was sent, where this decoder only reads.

        Raises:
            ValueError: It is none.
        """
        message = _parsed(data.strip())
        identifier, name = message.get("id"), message.get("name")
        if not isinstance(identifier, str) or name not in QUESTIONS:
            raise ValueError(f"{data[:80]!r} is no reading command whose result is used")
        self._asked[identifier] = (str(name), self._ticks)

    def tick(self) -> bytes | Refused:
        """Ask what is due, one question at a time for each name; give up what is not answered."""
        self._ticks += 1
        for question, (_, asked) in list(self._asked.items()):
            if self._ticks - asked > _ANSWER_TICKS:
                del self._asked[question]
                self._unanswered += 1
        if not self.ready:
            return b""
        name = self._rota.next()
        if name is None or any(name == asked for asked, _ in self._asked.values()):
            return b""
        self._questions += 1
        new = f"g{self._questions}"
        self._asked[new] = (name, self._ticks)
        return msgspec.json.encode({"type": "command", "id": new, "name": name, "args": {}}) + b"\n"

    def goodbye(self) -> bytes:
        """Nothing is owed before a close: the agent's connection to the robot is its own."""
        return b""

    def _line(self, raw: bytes) -> list[Event]:
        text = raw.strip(b"\r\n")
        if not text:
            return [Skipped(raw, "empty line")]
        try:
            message = _parsed(text)
        except BadMessageError as error:
            return self._no_line(Reject(raw, error.reason, str(error)))
        try:
            return self._message(raw, message)
        except BadMessageError as error:
            return [Reject(raw, error.reason, str(error))]

    def _message(self, raw: bytes, message: Json) -> list[Event]:
        kind = message.get("type")
        if not isinstance(kind, str):
            raise BadMessageError("no_type", "the message has no member `type` that is a text")
        if kind == "hello":
            return self._hello(raw, message)
        if kind == "closing":
            return self._closing(raw, message)
        if not self.ready:
            raise BadMessageError("no_hello", f"a message {kind[:40]!r} before the hello")
        handler = _HANDLERS.get(kind)
        try:
            self._count(kind, message, known=handler is not None)
            return [Skipped(raw, "unknown type")] if handler is None else handler(self, raw, message)
        except BadMessageError as error:
            if not _tells_of_commands(message):
                raise
            missed = Entry(EventKind.COMMAND_MISSED, CommandsMissed(count=_n_commands(message)), _raw(message))
            return [Reject(raw, error.reason, str(error)), Occurrence(b"", (missed,))]

    def _count(self, kind: str, message: Json, *, known: bool) -> None:
        """Follow the number of a message; results have none, and messages of a later agent may have none."""
        if kind == "result":
            return
        number = message.get("seq")
        if type(number) is int and 1 <= number <= _MOST:
            self._numbers.take(number)
        elif known:
            raise BadMessageError("value", f"{kind}: seq is {_short(number)}, not a whole number from 1 on")

    def _hello(self, raw: bytes, message: Json) -> list[Event]:
        schema = message.get("schema")
        if self.ready:
            raise BadMessageError("hello", "a second hello in one connection")
        if schema != SCHEMA:
            told = f"it speaks {_short(schema)}, this gateway {SCHEMA!r}: use an agent of the same version"
            return [Skipped(raw, "hello"), Refused(told, "incompatible")]
        units = message.get("units")
        if not isinstance(units, Mapping) or any(units.get(name) != unit for name, unit in UNITS.items()):
            told = f"its units are {_short(units)}, those of {SCHEMA} are {UNITS}"
            return [Skipped(raw, "hello"), Refused(told, "incompatible")]
        info = message.get("info")
        try:
            self._info = None if info is None else cast("Info", _object("info", "Info", info))
        except BadMessageError as error:
            self._bad_hello = str(error)
            raise
        self._bad_hello = ""
        self._numbers.take(0)  # messages are numbered from 1
        self.ready = True
        return [Skipped(raw, "hello")]

    def _closing(self, raw: bytes, message: Json) -> list[Event]:
        """The agent says why it is about to close; before a hello it never lets this gateway in."""
        self._farewell = str(message.get("reason"))[:160]
        events: list[Event] = [Skipped(raw, "closing")]
        return events if self.ready else [*events, Refused(f"the agent says: {self._farewell}")]

    def _state(self, raw: bytes, message: Json) -> list[Event]:
        values = self._values(message, {name: told for name, told in message.items() if name in _STATE})
        for name in _PER_AXIS:
            self._check_axes(name, values.get(name))
        running = values.get("operationState")
        if isinstance(running, str) and self._faults.observe(running):
            self._held["faults"] = self._faults.standing
        return [Frame(raw, RECORD, values={**values, **self._held})]

    def _event(self, raw: bytes, message: Json) -> list[Event]:
        name, data = message.get("event"), message.get("data")
        if not isinstance(data, Mapping):
            raise BadMessageError("value", "event: data is no object")
        if name == "moveExecution":
            return [Occurrence(raw, (_feedback(message, data),))]
        if name == "safety":
            return self._hold(raw, self._values(message, {"collided": data.get("collided")}))
        if name == "rlExecution":
            return self._hold(raw, self._values(message, {"rlExecution": data}))
        if name == "connection":
            values = self._values(message, {"connected": data.get("connected")})
            if values["connected"] is not False:
                return self._hold(raw, values)
            forgotten = dict.fromkeys(_STATE | _HELD | {"toolset"})
            self._held.clear()
            self._faults = LogFaults()
            return self._hold(raw, {**forgotten, **values})
        return [Skipped(raw, "unknown event")]

    def _hold(self, raw: bytes, values: dict[str, object]) -> list[Event]:
        """A frame of what an event tells; it stays so until the next one, so every state tells it again."""
        for name in _HELD & values.keys():
            if values[name] is None:
                self._held.pop(name, None)
            else:
                self._held[name] = values[name]
        return [Frame(raw, RECORD, values=values)]

    def _log(self, raw: bytes, message: Json) -> list[Event]:
        level = message.get("level")
        if level is not None and not isinstance(level, str):
            raise BadMessageError("value", f"log: level is {_short(level)}, not info, warning, error or null")
        entry = LogEntry(level, cast("LogInfo", _object("log", "LogInfo", message.get("log"))))
        values = self._values(message, {})
        values["log"] = entry
        if self._faults.take(entry):
            values["faults"] = self._faults.standing
        return self._hold(raw, values)

    def _issued(self, raw: bytes, message: Json) -> list[Event]:
        kind, commands, name = message.get("class"), message.get("commands"), message.get("cmdID")
        axes = None if self._info is None else self._info.joint_num
        if not isinstance(name, str):
            raise BadMessageError("value", "issued: cmdID is no text")
        wrong = list_problems_of(kind, commands, axes=axes)
        if wrong or not isinstance(kind, str) or not isinstance(commands, list):
            raise BadMessageError("command", f"issued {name[:40]}: {wrong[0] if wrong else 'no list of commands'}")
        first = _count_of(message, "firstIndex", 0)
        source, total = _raw(message), _count_of(message, "total", first + len(commands))
        if total < first + len(commands):
            raise BadMessageError("command", f"issued {name[:40]}: total is {total}, but {first + len(commands)} came")
        kind = kind if kind.endswith("Command") else f"{kind}Command"
        return [
            Occurrence(
                raw,
                tuple(
                    Entry(
                        EventKind.COMMAND_ISSUED,
                        Command(id=name, type=kind, index=index, total=total, object=one),
                        source,
                    )
                    for index, one in enumerate(commands, first)
                ),
            )
        ]

    def _lost(self, raw: bytes, message: Json) -> list[Event]:
        count = message.get("count")
        if type(count) is not int or not 1 <= count <= _MOST:
            raise BadMessageError("value", f"lost: count is {_short(count)}, not a whole number from 1 on")
        return [Occurrence(raw, (Entry(EventKind.COMMAND_MISSED, CommandsMissed(count=count), _raw(message)),))]

    def _result(self, raw: bytes, message: Json) -> list[Event]:
        asked = self._asked.pop(str(message.get("id")), None)
        if asked is None:
            raise BadMessageError("unrequested", f"a result for {_short(message.get('id'))}, which nobody waits for")
        name = asked[0]
        if message.get("ok") is not True:
            why = message.get("error") or f"ec {message.get('ec')}, {message.get('message')}"
            self._refusals[name] = str(why)[:_SHOWN]
            return [Skipped(raw, f"result of {name}: refused")]
        self._refusals.pop(name, None)
        return [Frame(raw, RECORD, values=self._values({}, {name: message.get("value")}))]

    def _values(self, message: Json, told: Json) -> dict[str, object]:
        """Values of the record, checked.

        Raises:
            BadMessageError: One of them is no such value.
        """
        found: dict[str, object] = {}
        for name, value in told.items():
            if name in _OBJECTS and value is not None:
                found[name] = _object(name, _OBJECTS[name], value)
                continue
            try:
                found[name] = RECORD.convert(name, value)
            except ValueError as error:
                raise BadMessageError("value", str(error)) from None
        if _is_time(message.get("ts")):
            found["ts"] = message["ts"]
        return found

    def _check_axes(self, name: str, value: object) -> None:
        axes = None if self._info is None else self._info.joint_num
        if axes is not None and isinstance(value, list) and len(value) != axes:
            raise BadMessageError("value", f"{name}: {len(value)} values for a robot of {axes} axes")


def _parsed(text: bytes) -> Json:
    try:
        message = msgspec.json.decode(text)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise BadMessageError("json", str(error)) from None
    if not isinstance(message, dict):
        raise BadMessageError("json", f"{text[:40]!r} is no JSON object")
    if _LONG.search(text) and not _encodes(message):
        raise BadMessageError("json", f"it holds a whole number outside of {_WORD[0]} to {_WORD[1] - 1}")
    return message


def _encodes(value: object) -> bool:
    """Whether all whole numbers inside fit into 64 bits."""
    if isinstance(value, dict):
        return all(map(_encodes, value.values()))
    if isinstance(value, list):
        return all(map(_encodes, value))
    return not isinstance(value, int) or _WORD[0] <= value < _WORD[1]


def _short(value: object) -> str:
    text = repr(value)
    return text if len(text) <= _SHOWN else f"{text[:_SHOWN]}…"


def _is_time(ts: object) -> bool:
    return type(ts) is int and 0 < ts < _LATEST_US


def _tells_of_commands(message: Json) -> bool:
    """Whether the message, could it be read, would tell something on the topic of the commands."""
    return message.get("type") in {"issued", "lost"} or message.get("event") == "moveExecution"


def _object(name: str, kind: str, value: object) -> object:
    if not isinstance(value, Mapping):
        raise BadMessageError("value", f"{name} is no object")
    try:
        return object_of(kind, value, lenient=True)
    except ObjectError as error:
        raise BadMessageError("value", f"{name}: {error}") from None


def _feedback(message: Json, data: Json) -> Entry:
    """The execution feedback of one command object."""
    index, reached = data.get("wayPointIndex"), data.get("reachTarget")
    told, custom = data.get("remark"), data.get("customInfo")
    if not isinstance(data.get("cmdID"), str):
        raise BadMessageError("value", "moveExecution: cmdID is no text")
    if not (index is None or type(index) is int) or not (reached is None or isinstance(reached, bool)):
        raise BadMessageError("value", "moveExecution: wayPointIndex is a whole number, reachTarget true or false")
    if not all(one is None or isinstance(one, str) for one in (told, custom)):
        raise BadMessageError("value", "moveExecution: remark and customInfo are texts")
    error = _failure(data.get("error"))
    if not _is_plain(error):
        raise BadMessageError("value", "moveExecution: error is no text, number, or object of them")
    feedback = CommandFeedback(
        id=cast("str", data["cmdID"]),
        index=index,
        reached=reached,
        error=error,
        text=cast("str | None", told) or None,
        custom=cast("str | None", custom),
    )
    return Entry(EventKind.COMMAND_EXECUTED, feedback, _raw(message))


def _failure(error: object) -> object:
    """What a feedback says went wrong; None where its error code says that nothing did."""
    return None if isinstance(error, Mapping) and not error.get("ec") else error or None


def _count_of(message: Json, name: str, otherwise: int) -> int:
    """A count that a message need not have.

    Raises:
        BadMessageError: It is none.
    """
    told = message.get(name, otherwise)
    if type(told) is not int or not 0 <= told <= _MOST:
        raise BadMessageError("value", f"{name} is {_short(told)}, not a whole number from 0 on")
    return told


def _n_commands(message: Json) -> int:
    """How many command objects a list holds that cannot be read; of any other message one."""
    commands = message.get("commands")
    return max(1, len(commands)) if message.get("type") == "issued" and isinstance(commands, list) else 1


def _is_plain(value: object) -> bool:
    """Whether it is a scalar, or an object of scalars."""
    parts = value.values() if isinstance(value, Mapping) else (value,)
    return all(part is None or isinstance(part, str | int | float) for part in parts)


def _raw(message: Json) -> dict[str, object]:
    """The number and the time of a message, as far as they are such."""
    found: dict[str, object] = {}
    if type(message.get("seq")) is int:
        found["seq"] = message["seq"]
    if _is_time(message.get("ts")):
        found["ts"] = message["ts"]
    return found


_HANDLERS: dict[str, Callable[[ObjectsDecoder, bytes, Json], list[Event]]] = {
    "state": ObjectsDecoder._state,  # noqa: SLF001 - the table is part of the class
    "event": ObjectsDecoder._event,  # noqa: SLF001
    "log": ObjectsDecoder._log,  # noqa: SLF001
    "issued": ObjectsDecoder._issued,  # noqa: SLF001
    "lost": ObjectsDecoder._lost,  # noqa: SLF001
    "result": ObjectsDecoder._result,  # noqa: SLF001
}


def make_decoders(options: msgspec.Struct, _rate_hz: float) -> DecoderFactory:
    """Make what makes the decoders of one robot."""
    return lambda: ObjectsDecoder(cast("ObjectsOptions", options))


def make_reader() -> ObjectsDecoder:
    """Make a decoder that only reads."""
    return ObjectsDecoder(ObjectsOptions())
