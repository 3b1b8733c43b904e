"""A few clients in one process that look at every sample: how long it was under way, and whether one is missing.

    python -m tests.bench.listeners PORT DIALECT COUNT latency|check

It says `ready` when so many messages with samples have come, and for each line that it is told what it saw since the
last one; `latency` forgets what it saw before a line `new`.
"""

from __future__ import annotations

import gc
import math
import os
import select
import socket
import struct
import sys
import time
from collections.abc import Callable, Iterator

import msgspec

from tests.bench.controllers import STAMPED
from tests.bench.dialects import DIALECTS, frames, join, masked, received
from vendors.fairino.cnde import CndeOptions
from vendors.fairino.cnde_states import ALL_STATES, granted

_TEXT, _BINARY, _PING, _PONG = 0x81, 0x82, 0x89, 0x8A
_DEG = 180 / math.pi
_DATA, _MISSED = b'{"op":"data"', b'{"op":"missed"'
_KEPT = 20_000  # distinct messages that are remembered
_PATIENCE_S = 20.0
_TOPICS = {"latency": ("*/joints",), "check": ("*/joints", "*/tcp")}


class Seen(msgspec.Struct):
    """What the clients saw.

    Attributes:
        samples: How many samples.
        taken_s: How long they were under way, in s: the quantiles of `QUANTILES`.
        holes: Samples that are not the next of their topic.
        missed: How often a client was told that it missed some.
        lost: Connections that ended.
    """

    samples: int = 0
    taken_s: list[float] = []
    holes: int = 0
    missed: int = 0
    lost: int = 0


QUANTILES = (0.5, 0.99, 0.999)


class _Joints(msgspec.Struct):
    position: list[float | None] = []


class _Stamped(msgspec.Struct):
    data: _Joints = msgspec.field(default_factory=_Joints)


class _Numbered(msgspec.Struct):
    topic: str
    seq: int
    epoch: str


class _StampedMessage(msgspec.Struct):
    samples: list[_Stamped]


class _NumberedMessage(msgspec.Struct):
    op: str
    samples: list[_Numbered] | dict[str, int] = []


_STAMPS = msgspec.json.Decoder(_StampedMessage).decode
_NUMBERS = msgspec.json.Decoder(_NumberedMessage).decode


def _relay_frame() -> tuple[int, int]:
    """Size of a data frame with every state, and where its stamp is."""
    names = CndeOptions().wanted
    found = granted(names, tuple(ALL_STATES[name].type for name in names))
    return found.frame_size, found.layout.by_name[STAMPED].offset


class Stamps:
    """How long the samples of all clients were under way.

    What comes is kept as it is, and read when somebody asks: reading a message of one client would make those of the
    others wait, and a message that says more would look as if it had been under way for longer.
    """

    def __init__(self) -> None:
        self.seen = Seen()
        self._come: list[tuple[bytes, float]] = []
        self._bare: list[tuple[bytes, float]] = []
        self._frame_size, self._stamp_at = _relay_frame()

    def take(self, data: bytes, now_s: float, _client: int) -> None:
        """Take a message of the gateway."""
        if data.startswith(_DATA):
            self._come.append((data, now_s))
        else:
            self.seen.missed += data.startswith(_MISSED)

    def take_bare(self, data: bytes, now_s: float) -> bytes:
        """Take bytes of the relay; returns what is not a whole frame yet."""
        whole = len(data) - len(data) % self._frame_size
        if whole:
            self._bare.append((data[:whole], now_s))
        return data[whole:]

    def told(self) -> Seen:
        """What was seen since the last time."""
        taken_s = sorted([*self._of_messages(), *self._of_bare()])
        seen = self.seen
        self.forget()
        seen.samples = len(taken_s)
        seen.taken_s = [taken_s[min(len(taken_s) - 1, int(len(taken_s) * share))] for share in QUANTILES if taken_s]
        return seen

    def forget(self) -> None:
        """Forget what came so far."""
        self.seen, self._come, self._bare = Seen(), [], []

    def _of_messages(self) -> Iterator[float]:
        for data, now_s in self._come:
            for sample in _STAMPS(data).samples:
                if sample.data.position and sample.data.position[0] is not None:
                    yield now_s - sample.data.position[0] * _DEG

    def _of_bare(self) -> Iterator[float]:
        for data, now_s in self._bare:
            for at in range(self._stamp_at, len(data), self._frame_size):
                yield now_s - struct.unpack_from("<d", data, at)[0]

    @property
    def n_samples(self) -> int:
        """How many messages with samples came so far."""
        return len(self._come) + len(self._bare)


class Numbers:
    """Whether every sample is the next of its topic, for each client.

    Clients of one cohort get the same bytes, so that each message is parsed once: what it says first and last of each
    topic must follow what the client's messages before said last.
    """

    def __init__(self) -> None:
        self.seen = Seen()
        self._known: dict[bytes, _Read] = {}
        self._last: dict[int, dict[tuple[str, str], int]] = {}
        self.n_samples = 0

    def take(self, data: bytes, _now_s: float, client: int) -> None:
        """Take a message of the gateway."""
        read = self._known.get(data)
        if read is None:
            if len(self._known) > _KEPT:
                self._known.clear()
            read = self._known[bytes(data)] = _Read(data)
        last = self._last.setdefault(client, {})
        self.seen.missed += read.missed
        self.seen.holes += read.holes
        self.n_samples += read.count
        for topic, first in read.first.items():
            before = last.get(topic)
            if before is not None and first != before + 1:
                self.seen.holes += 1
        last.update(read.last)

    def take_bare(self, data: bytes, _now_s: float) -> bytes:
        """Bare bytes have no numbers."""
        self.n_samples += 1
        return data[:0]

    def told(self) -> Seen:
        """What was seen since the last time."""
        seen, self.seen = self.seen, Seen()
        seen.samples, self.n_samples = self.n_samples, 0
        return seen


class _Read:
    """What one message says."""

    __slots__ = ("count", "first", "holes", "last", "missed")

    def __init__(self, data: bytes) -> None:
        message = _NUMBERS(data)
        self.missed = message.op == "missed"
        self.count = self.holes = 0
        self.first: dict[tuple[str, str], int] = {}
        self.last: dict[tuple[str, str], int] = {}
        if message.op == "data" and isinstance(message.samples, list):
            self.count = len(message.samples)
            for sample in message.samples:
                topic = (sample.topic, sample.epoch)
                self.first.setdefault(topic, sample.seq)
                self.holes += topic in self.last and sample.seq != self.last[topic] + 1
                self.last[topic] = sample.seq


def _read_frames(sock: socket.socket, data: bytes, take: Callable[[bytes], None]) -> bytes:
    """Take the whole frames, answer pings; returns the rest."""
    end = 0
    for opcode, start, stop in frames(data):
        if opcode in {_TEXT, _BINARY}:
            take(data[start:stop])
        elif opcode == _PING:
            sock.setblocking(True)  # noqa: FBT003 - its signature
            sock.sendall(masked(data[start:stop], _PONG))
        end = stop
    return data[end:]


def _answered(looking: Stamps | Numbers) -> bool:
    """Answer a line of the standard input; whether there was one."""
    word = os.read(0, 4096)
    if word == b"new\n" and isinstance(looking, Stamps):
        looking.forget()
    if word:
        sys.stdout.buffer.write(msgspec.json.encode(looking.told()) + b"\n")
        sys.stdout.flush()
    return bool(word)


def run(port: int, dialect: str, count: int, kind: str) -> None:
    """Connect, say so, and look until the standard input ends."""
    looking: Stamps | Numbers = Stamps() if kind == "latency" else Numbers()
    socks, left = [], {}
    for _ in range(count):
        sock, rest = join(port, DIALECTS[dialect], _TOPICS[kind])
        socks.append(sock)
        left[sock] = rest
    numbers = {sock: number for number, sock in enumerate(socks)}
    poller = select.epoll()
    by_fd = {sock.fileno(): sock for sock in socks}
    for fd in (0, *by_fd):
        poller.register(fd, select.EPOLLIN)
    gc.disable()  # its pauses would be taken for the server's
    ready, until_s = False, time.monotonic() + _PATIENCE_S
    while True:
        for fd, _ in poller.poll(0.5):
            if fd == 0:
                if not _answered(looking):
                    return
                continue
            sock = by_fd[fd]
            try:
                data = left[sock] + received(sock)
            except ConnectionError:
                looking.seen.lost += 1
                poller.unregister(fd)
                continue
            now_s = time.monotonic()
            if dialect == "relay":
                left[sock] = looking.take_bare(data, now_s)
            else:
                number = numbers[sock]
                left[sock] = _read_frames(sock, data, lambda message: looking.take(message, now_s, number))  # noqa: B023
        if not ready and (looking.n_samples >= count or time.monotonic() > until_s):
            ready = True
            print("ready", flush=True)


if __name__ == "__main__":
    run(int(sys.argv[1]), sys.argv[2], int(sys.argv[3]), sys.argv[4])
