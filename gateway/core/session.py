"""One connection to a controller: reads, asks at the protocol's period, and watches that good frames keep coming."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Protocol

import anyio

from gateway.api.decoder import Decoder, Event, Frame, Refused, RefusedKind, Reject
from gateway.api.vendor import OnStale
from gateway.core.aside import until_given_up
from gateway.core.clock import Clock, deadline_s
from gateway.core.tap import Tap
from gateway.core.transport import Connection
from gateway.errors import LinkError, LinkRefused, LinkStale

# The deadline of the watchdog moves on only when less than this share of it remains: moving it has a price.
_LAZY_SHARE = 0.8
# Deadlines stand on whole milliseconds: a fresh one may lie so much behind its time.
_WHOLE_MS = 0.002
_GOODBYE_S = 0.5
# Before silence is called so, whatever has come meanwhile is read.
_LAST_LOOK_S = 0.02


class Sink(Protocol):
    """Who takes what a session receives."""

    def received(self, n_bytes: int, events: Sequence[Event], at_s: float, decode_s: float) -> None:
        """Bytes were received and decoded, at a monotonic time in s."""
        ...

    def silent(self, reason: str, kind: RefusedKind | None) -> None:
        """No good frame came within `stale_s`, and the session is kept; `kind`: why none ever will."""
        ...


class Session:
    """Runs one connection until it is lost.

    Args:
        connection: The open connection; closed by its owner.
        decoder: Reads this connection only.
        sink: Takes the events.
        period_s: Time between requests; None where nothing is asked.
        tick_s: Time between ticks of a decoder that asks for nothing but may have to repeat itself; None: never.
        first_s: Time that the first good frame may take; None: `stale_s`.
        quiet_s: Time without a question after an answer that took longer than the period: what comes meanwhile answers
            none. 0: the next question leaves at once.
        stale_s: Time without a good frame after which the session is stale.
        on_stale: Whether a stale session ends.
        clock: Gives the receive times.
        tap: Is shown every byte, or None.
    """

    def __init__(
        self,
        connection: Connection,
        decoder: Decoder,
        sink: Sink,
        *,
        period_s: float | None,
        stale_s: float,
        on_stale: OnStale,
        clock: Clock,
        tick_s: float | None = None,
        first_s: float | None = None,
        quiet_s: float = 0.0,
        tap: Tap | None = None,
    ) -> None:
        self._connection = connection
        self._decoder = decoder
        self._sink = sink
        self._polls = period_s is not None
        self._period_s = period_s or tick_s
        self._first_s = max(first_s or 0.0, stale_s)
        self._stale_s = stale_s
        self._lazy_s = stale_s * _LAZY_SHARE
        self._watchdog = anyio.CancelScope()
        self._on_stale = on_stale
        self._quiet_s = quiet_s
        self._quiet_until_s = -math.inf
        self._now = clock.monotonic
        self._tap = tap
        self._wake = anyio.Event()
        self._owed = [decoder.outgoing()]
        self._overdue = False  # the decoder had nothing to ask when it was due: it waits for an answer
        self._n_bytes = self._n_frames = 0
        self._last_reject: Reject | None = None
        self._misfit: Reject | None = None  # a frame that no layout explains, in a session without a good one

    async def run(self) -> None:
        """Read and ask until the session is lost; never returns.

        Raises:
            LinkError: Why it was lost.
        """
        try:
            await self._read_and_ask()
        finally:
            now = self._now()
            self._note(0, self._decoder.end(), now, 0.0)
            goodbye = self._decoder.goodbye()
            if goodbye:
                with anyio.move_on_after(_GOODBYE_S, shield=True):
                    await self._say(goodbye)

    async def _read_and_ask(self) -> None:
        """Read, and ask beside it, until one of them cannot go on.

        A session that is lost shall leave nothing to the collector of garbage, as an exception does that is kept by a
        group or in a variable.
        """
        asking = anyio.CancelScope()
        lost: BaseException | None = None
        try:
            async with anyio.create_task_group() as tasks:
                tasks.start_soon(until_given_up, asking, self._ask)
                try:
                    await self._read()
                except LinkError as error:
                    lost = error
                asking.cancel()
        except BaseExceptionGroup as group:
            leaf = _first_leaf(group)
            if not isinstance(leaf, LinkError):
                raise leaf from group  # a mistake: the log shows all of it
            lost = lost or leaf  # what was read says more than that it could not be asked
            del leaf
        try:
            if lost is not None:
                raise lost
        finally:
            del lost

    async def _read(self) -> None:
        stale_at_s = self._now() + self._first_s
        while True:
            await self._read_until_silent(stale_at_s)
            if self._on_stale == "keep":
                self._sink.silent(self._silence(), "incompatible" if self._misfit else None)
            elif self._misfit:
                raise LinkRefused(self._silence(self._decoder.end()), "incompatible")
            else:
                raise LinkStale(self._silence(self._decoder.end()))
            stale_at_s = math.inf

    async def _read_until_silent(self, stale_at_s: float) -> None:
        """Read until no good frame has come in time, and none is waiting: a loop that stood still reads late."""
        with anyio.CancelScope(deadline=deadline_s(stale_at_s)) as watchdog:
            await self._read_under(watchdog)
        n_frames = -1
        while n_frames != self._n_frames:
            n_frames = self._n_frames
            with anyio.CancelScope(deadline=deadline_s(self._now() + _LAST_LOOK_S)) as watchdog:
                await self._read_under(watchdog)

    async def _read_under(self, watchdog: anyio.CancelScope) -> None:
        """Read; every good frame moves the deadline of the watchdog on."""
        self._watchdog = watchdog
        await self._connection.deliver(self._take)

    def _take(self, data: bytes) -> None:
        """Decode what has come, and say what it was.

        Raises:
            LinkRefused: The controller will never send what is wanted.
        """
        at_s = self._now()
        if self._tap is not None:
            self._tap.received(data, at_s)
        events: Sequence[Event] = self._decoder.feed(data)
        if self._connection.datagrams:
            events = [*events, *self._decoder.end()]
        self._note(len(data), events, at_s, self._now() - at_s)
        for event in events:
            if isinstance(event, Frame):
                if not self._lazy_s < self._watchdog.deadline - at_s < self._stale_s + _WHOLE_MS:
                    self._watchdog.deadline = deadline_s(at_s + self._stale_s)
            elif isinstance(event, Refused):
                raise LinkRefused(event.reason, event.kind)
        owed = self._decoder.outgoing()
        if self._overdue and self._quiet_s:
            self._quiet_until_s = at_s + self._quiet_s
        if owed or (self._overdue and not self._quiet_s):
            self._owed.append(owed)
            self._wake.set()

    async def _ask(self) -> None:
        """Send what the decoder owes: at once what it answers, at the period what it asks. The only sender."""
        due_s = math.inf if self._period_s is None else self._now() + (0.0 if self._polls else self._period_s)
        while True:
            self._wake = anyio.Event()
            owed, self._owed = self._owed, []
            now = self._now()
            overdue = self._overdue and not self._quiet_s
            if self._period_s and (overdue or now >= max(due_s, self._quiet_until_s)):
                asked = self._decoder.tick()
                if isinstance(asked, Refused):
                    raise LinkRefused(asked.reason, asked.kind)
                owed.append(asked)
                self._overdue = self._polls and not asked
                # Phase-locked: a late wake-up is caught up with, but never by more than one period.
                due_s = max(due_s + self._period_s, now - self._period_s) if asked else now + self._period_s
            for data in filter(None, owed):  # each a send, and so a datagram, of its own
                await self._send(data)
            with anyio.CancelScope(deadline=deadline_s(max(due_s, self._quiet_until_s))):
                await self._wake.wait()

    async def _send(self, data: bytes) -> None:
        if self._tap is not None:  # before it leaves: the answer may be there before the send returns
            self._tap.sent(data, self._now())
        await self._connection.send(data)

    async def _say(self, data: bytes) -> None:
        try:
            await self._send(data)
        except LinkError:
            return  # the controller is gone: nobody is left to be told

    def _note(self, n_bytes: int, events: Sequence[Event], at_s: float, decode_s: float) -> None:
        self._n_bytes += n_bytes
        for event in events:
            if type(event) is Frame:
                self._n_frames += 1
                self._misfit = None
            elif type(event) is Reject:
                self._last_reject = event
                if event.reason == "size" and not self._n_frames:
                    self._misfit = event
        self._sink.received(n_bytes, events, at_s, decode_s)

    def _silence(self, left: Sequence[Reject] = ()) -> str:
        """Say in words what a stale session has seen."""
        if left:
            self._note(0, left, self._now(), 0.0)
        if self._n_frames:
            return f"no good frame for {self._stale_s:g} s"
        if not self._n_bytes:
            return f"connected, but not one byte came within {self._first_s:g} s"
        if not self._decoder.ready:
            return f"connected, {self._n_bytes} bytes came, but the handshake was not finished"
        reject = self._misfit or self._last_reject
        why = f"; last reject: {reject.reason}{f' ({reject.detail})' if reject.detail else ''}" if reject else ""
        return f"connected, {self._n_bytes} bytes came, but no good frame{why}"


def _first_leaf(group: BaseExceptionGroup[BaseException]) -> BaseException:
    """The exception that matters of a group: one that is no link error hides behind none."""
    leaves = [_first_leaf(one) if isinstance(one, BaseExceptionGroup) else one for one in group.exceptions]
    return next((error for error in leaves if not isinstance(error, LinkError)), leaves[0])
