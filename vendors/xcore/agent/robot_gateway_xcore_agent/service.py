"""The agent's one loop, for the tap and for the owner: what others hand over becomes lines, commands get their results.

The hand-over is made for a caller that must not wait: a ticket and an append to a bounded deque, no lock, no system
call. The deque forgets its oldest when it is full; the tickets show how many that were.
"""

from __future__ import annotations

import itertools
import logging
import time
from collections import deque
from typing import Any, Callable, Deque, Iterator, List, NamedTuple, Optional, Tuple

from robot_gateway_xcore_agent.desk import Desk
from robot_gateway_xcore_agent.lines import AGENT_VERSION, MAX_LINE, SCHEMA, UNITS, Members, dumps, plain
from robot_gateway_xcore_agent.objects import COMMANDS, Snapshot
from robot_gateway_xcore_agent.outbox import Limits
from robot_gateway_xcore_agent.reader import Identity, LogBook
from robot_gateway_xcore_agent.stream import Stream, now_us

log = logging.getLogger("robot_gateway_xcore_agent")

HEARTBEAT_S = 0.5
"""A state at least this often; the schema asks for one in a second."""
HANDED_OVER = 256
"""Messages that wait for the loop at most."""
PER_STEP = 32
"""Messages that one round takes from the hand-over."""
WAIT_S = 0.02
IDLE_WAIT_S = 0.1
"""Seconds between two looks at the hand-over, with a gateway and without."""
MISTAKE_S = 1.0
"""Seconds of rest after a mistake of ours."""
ENVELOPE = 512
"""Bytes that a line of `issued` needs beside its cmdID and its commands."""


class Issued(NamedTuple):
    """What an application appended: the id that the SDK gave ("" if it gives none), and copies of the commands."""

    command_id: str
    commands: List[Snapshot]


class Handed(NamedTuple):
    """One message on its way to the loop; `at_us` is microseconds since 1970, UTC."""

    ticket: int
    at_us: int
    kind: str
    content: Any


class Service:
    """The stream with everything that goes through it.

    Args:
        identity: What the hello says.
        limits: What a slow reader may leave unread.
    """

    def __init__(self, identity: Identity, limits: Optional[Limits] = None) -> None:
        self.stream = Stream(self._hello, limits)
        self.desk = Desk(None, None, self.stream.wake)
        self.unanswered: Callable[[], Optional[Members]] = lambda: None
        """Gives the state while a call of the SDK hangs."""
        self.n_lost = 0
        """Messages that no gateway got, in all."""
        self._identity = identity
        self._logs = LogBook()
        self._said_info: Optional[Members] = None
        self._tickets = itertools.count()
        self._handed: Deque[Handed] = deque(maxlen=HANDED_OVER)
        self._n_taken = 0
        self._first_ticket = 0  # what was handed over before the gateway came is not for it
        self._n_missing = 0
        self._n_counted = 0
        self._n_announced = 0
        self._stated_at = 0.0
        self._n_connections = 0

    @property
    def connected(self) -> bool:
        """Whether a gateway is there."""
        return self.stream.outbox is not None

    # What other threads call.

    def offer(self, kind: str, content: Any) -> None:
        """Hand a message over; never waits, never raises."""
        self._handed.append(Handed(next(self._tickets), now_us(), kind, content))

    def miss(self) -> None:
        """Count a message that could not even be handed over."""
        next(self._tickets)

    # What the loop's thread calls.

    def attach(self, desk: Desk, unanswered: Callable[[], Optional[Members]]) -> None:
        """Say who answers commands, and what is said while a call hangs."""
        self.desk = desk
        self.unanswered = unanswered

    def step(self, *, accepting: bool = True) -> None:
        """Do one round: read, answer, publish, send. A mistake of ours costs a gateway its connection, and no more."""
        try:
            self._step(accepting=accepting)
        except Exception:
            log.exception("session.failed")
            self.stream.close_session("a mistake of the agent")
            time.sleep(MISTAKE_S)

    def _step(self, *, accepting: bool) -> None:
        more = self._publish()
        wait_s = 0.0 if more else WAIT_S if self.connected else IDLE_WAIT_S
        for message in self.stream.step(wait_s, accepting=accepting):
            if message.get("type") == "command":
                self.desk.take(message)
            else:
                self.stream.n_rejected += 1
        if self.stream.n_connections != self._n_connections or not self.connected:
            self._n_connections = self.stream.n_connections
            self._first_ticket = next(self._tickets)
            self._n_taken += 1
            self._stated_at = 0.0
            self.desk.forget()
        for result in self.desk.results(time.monotonic()):
            self.stream.bare("result", result)

    def _hello(self) -> Members:
        self._said_info = self._identity.info
        return {
            "schema": SCHEMA,
            "agent": AGENT_VERSION,
            "sdkVersion": self._identity.sdk_version,
            "readOnly": True,
            "units": UNITS,
            "info": self._said_info,
        }

    def _publish(self) -> bool:
        """Turn what was handed over into lines; answers whether more is waiting."""
        for _ in range(PER_STEP):
            try:
                handed = self._handed.popleft()
            except IndexError:
                break
            self._n_taken += 1
            if not self.connected or handed.ticket < self._first_ticket:
                self._n_counted += handed.kind != "state"
            elif self._write(handed):
                self.stream.flush()
            else:
                self._n_counted += 1
            time.sleep(0)  # an application's thread that waits for the interpreter goes first
        self._settle()
        if self.connected:
            self._say()
        return bool(self._handed)

    def _settle(self) -> None:
        """Count tickets that never arrived: a second look, since a slower thread's may still be on its way."""
        n_expected = next(self._tickets) + 1
        self._n_taken += 1  # this look's own ticket
        missing = n_expected - self._n_taken - len(self._handed)
        self.n_lost = self._n_counted + self.stream.n_cut + max(0, min(self._n_missing, missing))
        self._n_missing = missing

    def _say(self) -> None:
        if self._said_info is None and self._identity.info is not None:
            self.stream.close_session("the robot's Info has become known: connect again", tell=True)
            return
        count = self.n_lost - self._n_announced
        if count > 0 and self.stream.numbered("lost", {"count": count}, now_us()):
            self._n_announced = self.n_lost
        now = time.monotonic()
        if now - self._stated_at >= HEARTBEAT_S:
            self._state(self.unanswered() or {}, now_us())

    def _state(self, members: Members, at_us: int) -> None:
        self._stated_at = time.monotonic()
        self.stream.state(members, at_us)

    def _write(self, handed: Handed) -> bool:
        try:
            if handed.kind == "state":
                self._state(handed.content, handed.at_us)
                return True
            content = handed.content
            if handed.kind == "log" and not self._logs.is_new(content["level"], content["log"], time.monotonic()):
                return True
            messages = list(_issued(content)) if handed.kind == "issued" else [(plain(content), b"")]
        except Exception as error:  # noqa: BLE001 - it came from an application: whatever is wrong with it costs itself
            log.warning("message.dropped reason=%r", f"{type(error).__name__}: {error}")
            return False
        sent = [self.stream.numbered(handed.kind, message, handed.at_us, rest) for message, rest in messages]
        return all(sent)


def _issued(issued: Issued) -> Iterator[Tuple[Members, bytes]]:
    """Encode commands one by one, in as many messages as lines need.

    Raises:
        ValueError: They are not commands of one class, or one of them is longer than a line.
    """
    name = issued.commands[0].name
    if name not in COMMANDS or any(command.name != name for command in issued.commands):
        raise ValueError("not commands of one class")
    head: Members = {"cmdID": issued.command_id, "class": name}
    room = MAX_LINE - ENVELOPE - len(dumps(head))
    parts: List[Tuple[int, List[bytes]]] = [(0, [])]
    left = room
    for index, command in enumerate(issued.commands):
        encoded = dumps(command.encoded(omit_defaults=True))
        time.sleep(0)
        if len(encoded) > room:
            raise ValueError(f"a command of {len(encoded)} bytes does not fit into a line")
        if len(encoded) + 1 > left:
            parts.append((index, []))
            left = room
        parts[-1][1].append(encoded)
        left -= len(encoded) + 1
    for first, commands in parts:
        members = head if len(parts) == 1 else {**head, "firstIndex": first, "total": len(issued.commands)}
        yield members, b'"commands":[' + b",".join(commands) + b"]"
