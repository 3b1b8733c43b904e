"""The socket side of the stream: listens, serves one gateway at a time, never blocks. One thread calls `step`."""

from __future__ import annotations

import contextlib
import logging
import selectors
import socket
import time
from typing import Callable, List, Optional, Tuple

from robot_gateway_xcore_agent.lines import MAX_LINE, LineReader, Members, TooLongError, line
from robot_gateway_xcore_agent.outbox import Limits, Outbox, OverflowedError

log = logging.getLogger("robot_gateway_xcore_agent")

CHUNKS_PER_STEP = 8
"""Reads in one round; a gateway that has more to say waits for the next."""
ONE_AT_A_TIME = "one gateway at a time: another one is connected"
# Polling, not epoll: a process that forks would share an epoll's set with its child.
_Selector = getattr(selectors, "PollSelector", selectors.SelectSelector)


def now_us() -> int:
    """The agent's clock: microseconds since 1970, UTC."""
    return time.time_ns() // 1000


class Stream:
    """One listener, at most one connection.

    Args:
        hello: Gives the members of the first message.
        limits: What a slow reader may leave unread.
    """

    def __init__(self, hello: Callable[[], Members], limits: Optional[Limits] = None) -> None:
        self._hello = hello
        self._limits = limits or Limits()
        self._listener: Optional[socket.socket] = None
        self._address: Optional[Tuple[str, int]] = None
        self._peer: Optional[socket.socket] = None
        self._reader = LineReader()
        self._moved_at = 0.0
        self._ours, self._wake = socket.socketpair()
        for end in (self._ours, self._wake):
            end.setblocking(False)  # noqa: FBT003 - a socket's method
        self.outbox: Optional[Outbox] = None
        """What the connected gateway is owed; None while there is none."""
        self.n_connections = 0
        self.n_rejected = 0
        self.n_cut = 0
        """Messages that must not be lost, but were cut off with their connection."""

    def listen(self, host: str, port: int) -> None:
        """Open the listener; port 0 takes a free one.

        Raises:
            OSError: The address cannot be had.
        """
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        listener = socket.socket(family, socket.SOCK_STREAM)
        try:
            if hasattr(socket, "SO_REUSEADDR") and not hasattr(socket, "SO_EXCLUSIVEADDRUSE"):
                listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            listener.bind((host, port))
            listener.listen(4)
            listener.setblocking(False)  # noqa: FBT003 - the same
        except BaseException:
            listener.close()
            raise
        host, port = listener.getsockname()[:2]
        self._listener, self._address = listener, (host, port)

    @property
    def listening(self) -> bool:
        """Whether the listener is open."""
        return self._listener is not None

    @property
    def address(self) -> Optional[Tuple[str, int]]:
        """Host and port that it listens on."""
        return self._address

    def wake(self) -> None:
        """End the wait of `step` from another thread."""
        with contextlib.suppress(OSError):  # full: it wakes anyway; closed: nobody waits
            self._wake.send(b"\0")

    def step(self, wait_s: float, *, accepting: bool = True) -> List[Members]:
        """Send what is owed, accept, and read; give the objects that came.

        Args:
            wait_s: How long to wait for something to do, in s.
            accepting: Whether to take connections yet.
        """
        self.flush()
        received: List[Members] = []
        ready = self._ready(wait_s, accepting=accepting)
        if self._ours in ready:
            with contextlib.suppress(OSError):
                self._ours.recv(4096)
        if self._peer in ready:
            self.flush()
            received.extend(self._read())
        if self._listener in ready:  # last: a gateway that has just gone makes room for its successor
            self._accept()
        return received

    def _ready(self, wait_s: float, *, accepting: bool) -> List[object]:
        with _Selector() as selector:
            selector.register(self._ours, selectors.EVENT_READ)
            if self._listener is not None and accepting:
                selector.register(self._listener, selectors.EVENT_READ)
            if self._peer is not None and self.outbox is not None:
                owed = selectors.EVENT_WRITE if self.outbox.n_owed else 0
                selector.register(self._peer, selectors.EVENT_READ | owed)
            return [key.fileobj for key, _ in selector.select(wait_s)]

    def _accept(self) -> None:
        if self._listener is None:
            return
        try:
            peer, address = self._listener.accept()
        except OSError:
            return  # it went away again
        peer.setblocking(False)  # noqa: FBT003 - the same
        if self._peer is not None:
            log.warning("session.refused peer=%s reason=%r", address, ONE_AT_A_TIME)
            with contextlib.suppress(OSError), peer:
                peer.send(line({"type": "closing", "seq": 1, "ts": now_us(), "reason": ONE_AT_A_TIME}))
            return
        with contextlib.suppress(OSError):
            peer.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
            peer.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._peer = peer
        self._reader = LineReader()
        self._moved_at = time.monotonic()
        self.n_connections += 1
        self.outbox = Outbox(self._limits)
        log.info("session.opened peer=%s", address)
        self._guarded(lambda box: box.bare("hello", self._hello()))

    def _read(self) -> List[Members]:
        objects: List[Members] = []
        for _ in range(CHUNKS_PER_STEP):
            if self._peer is None:
                break
            try:
                data = self._peer.recv(MAX_LINE)
            except (BlockingIOError, InterruptedError):
                break
            except OSError as error:
                self.close_session(str(error))
                break
            if not data:
                self.close_session("the gateway closed it")
                break
            found = self._reader.feed(data)
            self.n_rejected += found.n_rejected
            objects.extend(found.objects)
        return objects

    def state(self, members: Members, ts: int) -> None:
        """Send a state if somebody is there and fast enough; `ts` in microseconds."""
        self._guarded(lambda box: box.state(members, ts))

    def numbered(self, kind: str, members: Members, ts: int, rest: bytes = b"") -> bool:
        """Send a message that must not be dropped, as `Outbox.numbered` has it. Answers whether it was owed."""
        return self._guarded(lambda box: box.numbered(kind, members, ts, rest))

    def bare(self, kind: str, members: Members) -> bool:
        """Send a message without a sequence number. Answers whether it was owed."""
        return self._guarded(lambda box: box.bare(kind, members))

    def _guarded(self, owe: Callable[[Outbox], None]) -> bool:
        if self.outbox is None:
            return False
        try:
            owe(self.outbox)
        except OverflowedError as error:
            self.close_session(f"the gateway reads too slowly: {error}")
            return True  # it was owed, and is lost with all the rest of the connection
        except (TooLongError, TypeError, ValueError) as error:
            log.warning("message.dropped reason=%r", str(error))
            return False
        return True

    def flush(self) -> None:
        """Send what the socket takes at once."""
        if self._peer is None or self.outbox is None:
            return
        try:
            while self.outbox.n_owed:
                self.outbox.sent(self._peer.send(self.outbox.chunk()))
                self._moved_at = time.monotonic()
        except (BlockingIOError, InterruptedError):
            if time.monotonic() - self._moved_at > self._limits.stall_s:
                self.close_session("the gateway reads nothing any more")
        except OSError as error:
            self.close_session(str(error))
        else:
            self._moved_at = time.monotonic()

    def close_session(self, reason: str, *, tell: bool = False) -> None:
        """End the connection, if there is one; the listener stays.

        Args:
            reason: For the log.
            tell: Whether the gateway is told too, as far as its socket takes it at once.
        """
        if self._peer is None or self.outbox is None:
            return
        if tell:
            with contextlib.suppress(OSError, OverflowedError):
                self.outbox.numbered("closing", {"reason": reason}, now_us())
                while self.outbox.n_owed:
                    self.outbox.sent(self._peer.send(self.outbox.chunk()))
        n_dropped = self.outbox.n_state_dropped
        self.n_cut += self.outbox.n_unsent
        log.info("session.closed reason=%r n_dropped=%d n_rejected=%d", reason, n_dropped, self.n_rejected)
        with contextlib.suppress(OSError):
            self._peer.close()
        self._peer = self.outbox = None

    def close(self) -> None:
        """Close everything."""
        self.close_session("the agent ends", tell=True)
        self.abandon()

    def abandon(self) -> None:
        """Close this process's copies of the sockets without a word: what a forked child does."""
        ends = (self._listener, self._peer, self._ours, self._wake)
        for end in ends:
            if end is not None:
                with contextlib.suppress(OSError):
                    end.close()
        self._listener = self._peer = self.outbox = self._address = None
