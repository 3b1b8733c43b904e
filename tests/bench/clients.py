"""Many clients in one process that only count: what they read is not parsed, but each sample's marker is found.

    python -m tests.bench.clients PORT DIALECT COUNT TOPIC…

It says `ready` when each has its first sample, and for each line that it is told how many samples came so far. Sockets
are emptied every few milliseconds in one sweep: waking for each message would cost the machine more than the servers.
"""

from __future__ import annotations

import os
import select
import socket
import sys
import time

import msgspec

from tests.bench.dialects import DIALECTS, Dialect, join

_SWEEP_S = 0.005
_BUFFER = bytearray(1 << 18)
_PATIENCE_S = 15.0


class Counted(msgspec.Struct):
    """What the clients got so far.

    Attributes:
        delivered: Samples of all clients.
        least: Samples of the client with the fewest.
        most: Samples of the client with the most.
        n_bytes: Bytes of all clients.
        lost: Connections that ended.
        at_s: Monotonic time of the sweep that ended with these numbers.
    """

    delivered: int
    least: int
    most: int
    n_bytes: int
    lost: int
    at_s: float


class Counter:
    """One client.

    Args:
        sock: Has asked for its samples.
        left: What it was sent already.
        marker: Stands once in each sample.
    """

    def __init__(self, sock: socket.socket, left: bytes, marker: bytes) -> None:
        self._sock = sock
        self._marker = marker
        self._tail = left[1 - len(marker) :]
        self.count = left.count(marker)
        self.n_bytes = len(left)
        self.lost = False
        sock.setblocking(False)  # noqa: FBT003 - its signature

    def sweep(self) -> None:
        """Read what is there, and count."""
        edge = len(self._marker) - 1
        while not self.lost:
            try:
                size = self._sock.recv_into(_BUFFER)
            except BlockingIOError:
                return
            except ConnectionError:
                size = 0
            self.lost = size == 0
            self.n_bytes += size
            self.count += _BUFFER.count(self._marker, 0, size)
            self.count += (self._tail + _BUFFER[: min(edge, size)]).count(self._marker)
            self._tail = (
                (self._tail + bytes(_BUFFER[:size]))[-edge:] if size < edge else bytes(_BUFFER[size - edge : size])
            )
            if size < len(_BUFFER):
                return


def _told(counters: list[Counter]) -> bytes:
    counts = [one.count for one in counters]
    n_bytes, lost = sum(one.n_bytes for one in counters), sum(one.lost for one in counters)
    told = Counted(sum(counts), min(counts), max(counts), n_bytes, lost, time.monotonic())
    return msgspec.json.encode(told)


def _say(line: bytes) -> None:
    sys.stdout.buffer.write(line + b"\n")
    sys.stdout.flush()


def run(port: int, dialect: Dialect, count: int, topics: tuple[str, ...]) -> None:
    """Connect, say so, and count until the standard input ends."""
    counters: list[Counter] = []
    for _ in range(count):
        counters.append(Counter(*join(port, dialect, topics), dialect.marker))
        for one in counters[:-1]:
            one.sweep()
    until_s, ready = time.monotonic() + _PATIENCE_S, False
    while True:
        began_s = time.monotonic()
        for one in counters:
            one.sweep()
        if not ready and (all(one.count for one in counters) or began_s > until_s):
            ready = True
            _say(b"ready")
        if select.select([0], [], [], 0)[0]:
            if not os.read(0, 4096):
                return
            _say(_told(counters))
        time.sleep(max(0.0, began_s + _SWEEP_S - time.monotonic()))


if __name__ == "__main__":
    run(int(sys.argv[1]), DIALECTS[sys.argv[2]], int(sys.argv[3]), tuple(sys.argv[4:]))
