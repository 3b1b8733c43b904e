"""One client of a virtual controller: what its session answers or pushes, in order, with the chaos of the plan."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable, Sequence
from functools import partial
from random import Random
from typing import TYPE_CHECKING, cast

from gateway.sim.chaos import CALM, Chaos, Delivery
from gateway.sim.simulator import Port

if TYPE_CHECKING:
    from asyncio import Handle, Transport

    from gateway.sim.server import VirtualController

# Bytes that are read at once, and sends that may be owed before no more is read.
_READ_SIZE = 2048
_MOST_OWED = 64


class Connection(asyncio.BufferedProtocol):
    """One client, whoever called. What it is owed leaves in order; the next send waits for the one before.

    Args:
        controller: Whose client it is.
        port: What it speaks.
        loop: Runs it.
        lost: Called when it has ended.
    """

    def __init__(
        self,
        controller: VirtualController,
        port: Port,
        loop: asyncio.AbstractEventLoop,
        lost: Callable[[], None] = lambda: None,
    ) -> None:
        self._controller = controller
        self._port = port
        self._loop = loop
        self._lost = lost
        self._plan = controller.plan if port.protocol is not None else CALM
        self._chaos: Chaos | None = None
        self._session = port.session(controller.robot, controller.options)
        self._owed: deque[Delivery] = deque()
        self._timers: dict[str, Handle] = {}
        self._buffer = bytearray(_READ_SIZE)
        self._held = b""
        self._full = False
        self._aborted = False
        self._period_s: float | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Take the connection; both loops set TCP_NODELAY by themselves."""
        self._transport = cast("Transport", transport)
        if self._aborted:
            self._transport.abort()
            return
        self._controller.connections.add(self)
        robot = self._controller.robot
        if self._port.protocol is not None:
            robot.connections += 1
        if not self._plan.is_calm:
            random = Random(f"{robot.seed}/{robot.number}/{robot.connections}")  # noqa: S311 - faults, not secrets
            fillers = self._port.fillers
            self._chaos = Chaos(self._plan, random, header=self._port.header, fillers=fillers, counts=robot.faults)
            if self._plan.cut_every_s:
                end = self._transport.abort if random.getrandbits(1) else self._transport.close
                self._timers["cut"] = self._loop.call_later(self._plan.cut_every_s, self._cut, end)
        self._follow_period()

    def get_buffer(self, _size_hint: int) -> bytearray:
        """Lend the buffer: a small one, because a client may send requests without end."""
        return self._buffer

    def buffer_updated(self, size: int) -> None:
        """Take what was read."""
        self.take(bytes(self._buffer[:size]))

    def take(self, data: bytes) -> None:
        """Let the session answer, after a stall where there is one."""
        left_s = self._plan.silence_left_s(self._loop.time() - self._controller.start_s)
        if left_s or self._held:
            self._controller.robot.faults["stall"] += 1
            self._held += data
            if "stall" not in self._timers:
                self._timers["stall"] = self._loop.call_later(left_s, self._end_stall)
        else:
            self._answer(data)

    def _end_stall(self) -> None:
        """Answer what was asked during a stall, like a controller whose process has hung."""
        held, self._held = self._held, b""
        del self._timers["stall"]
        self._answer(held)

    def _answer(self, data: bytes) -> None:
        try:
            self._send(self._session.received(data, self._loop.time()))
            self._follow_period()
        except Exception as error:  # noqa: BLE001 - one client's bytes must not stop the others
            self._failed(error)

    def eof_received(self) -> bool:
        """Go on pushing to a client that has only closed its own side, as careful readers do."""
        return self._session.period_s is not None

    def connection_lost(self, _exc: Exception | None) -> None:
        """Forget the client."""
        self._controller.connections.discard(self)
        self._owed.clear()
        for timer in self._timers.values():
            timer.cancel()
        self._lost()

    def pause_writing(self) -> None:
        """Stop reading the requests of a client that does not read the answers."""
        self._full = True
        self._balance()

    def resume_writing(self) -> None:
        """Go on."""
        self._full = False
        self._balance()

    def _balance(self) -> None:
        """Read on only while what is owed leaves."""
        if self._transport.is_closing():
            return
        if self._full or len(self._owed) > _MOST_OWED:
            self._transport.pause_reading()
        else:
            self._transport.resume_reading()

    def abort(self) -> None:
        """Close without a word, be it as soon as it is made."""
        self._aborted = True
        if self in self._controller.connections:
            self._transport.abort()

    def _cut(self, end: Callable[[], None]) -> None:
        self._controller.robot.faults["cut"] += 1
        end()

    def _follow_period(self) -> None:
        """Push at the session's period, which may have changed."""
        if self._session.period_s == self._period_s:
            return
        self._period_s = self._session.period_s
        if "push" in self._timers:
            self._timers.pop("push").cancel()
        if self._period_s is not None:
            self._push(self._loop.time(), self._period_s)

    def _push(self, at_s: float, period_s: float) -> None:
        """Call `due` at fixed times; what a slow client or a late loop missed is left out."""
        now_s = self._loop.time()
        next_s = max(at_s + period_s, now_s)
        period_s = self._session.period_s or period_s  # a client may have set another
        self._timers["push"] = self._loop.call_at(next_s, self._push, next_s, period_s)
        silent = self._chaos is not None and self._plan.silent(now_s - self._controller.start_s)
        if self._full or silent:
            return
        try:
            self._send(self._session.due(now_s))
        except Exception as error:  # noqa: BLE001 - as above
            self._failed(error)

    def _send(self, segments: Sequence[bytes]) -> None:
        if self._chaos is not None:
            self._owe(self._chaos.deliver(segments))
        elif len(segments) == 1 and not self._owed:
            self._transport.write(segments[0])
        elif segments:
            self._owe([Delivery(0.0, segment) for segment in segments])

    def _owe(self, deliveries: Sequence[Delivery]) -> None:
        idle = not self._owed
        self._owed.extend(deliveries)
        if idle and self._owed:
            self._next()
        if len(self._owed) > _MOST_OWED:
            self._balance()

    def _next(self) -> None:
        """Have the head sent when its time comes."""
        wait_s = self._owed[0].wait_s
        call = self._loop.call_soon if wait_s <= 0 else partial(self._loop.call_later, wait_s)
        self._timers["send"] = call(self._write)

    def _write(self) -> None:
        """Send the head: never two sends in one turn of the loop, which might join them."""
        if not self._owed or self._transport.is_closing():
            return
        self._transport.write(self._owed.popleft().data)
        if self._owed:
            self._next()
        if len(self._owed) == _MOST_OWED:
            self._balance()

    def _failed(self, error: Exception) -> None:
        context = {"message": "a virtual controller's session failed", "exception": error, "protocol": self}
        self._loop.call_exception_handler(context)
        self._transport.abort()
