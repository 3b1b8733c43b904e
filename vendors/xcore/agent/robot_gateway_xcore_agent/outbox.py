"""What one gateway connection is owed: bytes in order, state that may be left out, and the bound past which it ends."""

from __future__ import annotations

from collections import deque
from typing import Deque, NamedTuple

from robot_gateway_xcore_agent.lines import Members, line


class Limits(NamedTuple):
    """How much a slow reader may leave unread, in bytes that are in no socket's buffer yet."""

    state_bytes: int = 65_536
    """With more owed than this, state is left out."""
    owed_bytes: int = 1_048_576
    """With more owed than this, the connection ends."""
    stall_s: float = 30.0
    """Seconds without a byte taken although some are owed, after which the connection ends."""


class OverflowedError(Exception):
    """The reader is too slow for what must not be dropped."""


class Outbox:
    """The bytes owed to one connection, and its sequence numbers."""

    def __init__(self, limits: Limits) -> None:
        self._limits = limits
        self._owed: Deque[bytes] = deque()
        self._weights: Deque[int] = deque()  # of each that is owed: how many messages are lost with it
        self._offset = 0
        self.n_owed = 0
        self.seq = 0
        self.n_state_dropped = 0

    def state(self, members: Members, ts: int) -> None:
        """Owe a state unless too much is owed already; the gap in `seq` then shows it.

        Args:
            members: What was read.
            ts: Microseconds since 1970, UTC.
        """
        if self.n_owed > self._limits.state_bytes:
            self.seq += 1
            self.n_state_dropped += 1
            return
        self.numbered("state", members, ts)

    def numbered(self, kind: str, members: Members, ts: int, rest: bytes = b"") -> None:
        """Owe a message that carries a sequence number.

        Args:
            kind: Its type.
            members: What it says.
            ts: Microseconds since 1970, UTC.
            rest: Further members that are JSON already.

        Raises:
            TooLongError: It does not fit into a line; nothing is owed and no number is used.
            ValueError: It cannot be said in JSON; the same.
            TypeError: The same.
            OverflowedError: Too much is owed.
        """
        message: Members = {"type": kind, "seq": self.seq + 1, "ts": ts}
        message.update(members)
        data = line(message, rest)
        self.seq += 1
        lost = members["count"] if kind == "lost" else int(kind not in ("state", "closing"))
        self._owe(data, lost)  # with a `lost` those that it tells of

    @property
    def n_unsent(self) -> int:
        """How many messages are owed that must not be lost; one that has begun to leave counts too."""
        return sum(self._weights)

    def bare(self, kind: str, members: Members) -> None:
        """Owe a message without a sequence number: hello, result, closing."""
        message: Members = {"type": kind}
        message.update(members)
        self._owe(line(message), 0)

    def _owe(self, data: bytes, weight: int) -> None:
        self._owed.append(data)
        self._weights.append(weight)
        self.n_owed += len(data)
        if self.n_owed > self._limits.owed_bytes:
            raise OverflowedError(f"{self.n_owed} bytes are unread")

    def chunk(self) -> bytes:
        """Give the next bytes to send; empty if nothing is owed."""
        return self._owed[0][self._offset :] if self._owed else b""

    def sent(self, n_bytes: int) -> None:
        """Note that so many bytes of the chunk are gone."""
        self.n_owed -= n_bytes
        self._offset += n_bytes
        if self._offset == len(self._owed[0]):
            self._owed.popleft()
            self._weights.popleft()
            self._offset = 0
