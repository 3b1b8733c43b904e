"""Many plain WebSocket clients in a process of their own: they check every `seq`, and cost as little as they can.

    python -m tests.end_to_end.load_clients HOST PORT FULL RATED SILENT

It says `ready` when every client has its first samples, and tells as one line of JSON what they got when its standard
input ends.
"""

from __future__ import annotations

import asyncio
import os
import struct
import sys
from collections import defaultdict

import msgspec
import uvloop

RATE_HZ = 10
STALL_US = 40_000
_ASK: dict[str, dict[str, object]] = {
    "full": {"topics": ["*/joints", "*/tcp"], "mode": "all"},
    "rated": {"topics": ["*/joints", "*/tcp"], "rate_hz": RATE_HZ},
    "silent": {"topics": ["*/joints", "*/tcp"], "mode": "all"},
}


class Sample(msgspec.Struct):
    """Of a sample what is checked; the rest is passed over."""

    topic: str
    seq: int
    epoch: str
    t: int


class Message(msgspec.Struct):
    """Of a message what is checked."""

    op: str
    samples: list[Sample] | dict[str, int] = []


class Report(msgspec.Struct):
    """What the clients got.

    Attributes:
        delivered: Samples of all clients.
        full: Samples of the clients at full rate, by client.
        messages: Messages of the clients at full rate.
        n_topics: The smallest number of topics that one of them saw.
        holes: Samples that are not the next of their topic.
        missed: How often a client at full rate was told that it missed some.
        rated: By client at a rate, the times of its samples by topic, µs.
        stalls: By topic, where one of the clients at full rate saw no sample for long: from and to, µs.
        lost: Connections that ended.
    """

    delivered: int = 0
    full: list[int] = []
    messages: int = 0
    n_topics: int = 0
    holes: int = 0
    missed: int = 0
    rated: list[dict[str, list[int]]] = []
    stalls: dict[str, list[tuple[int, int]]] = {}
    lost: int = 0


_DECODER = msgspec.json.Decoder(Message)


class LoadClient(asyncio.Protocol):
    """One client.

    Args:
        kind: What it asks for: full, rated or silent, which never reads.
        host: For the handshake.
    """

    def __init__(self, kind: str, host: str) -> None:
        self._kind = kind
        self._host = host
        self._data = bytearray()
        self._open = False
        self._transport: asyncio.Transport
        self._last: dict[str, Sample] = {}
        self.times: dict[str, list[int]] = defaultdict(list)
        self.stalls: dict[str, list[tuple[int, int]]] = defaultdict(list)
        self.report = Report()
        self.started = asyncio.Event()

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Shake hands."""
        assert isinstance(transport, asyncio.Transport) or hasattr(transport, "write")
        self._transport = transport  # type: ignore[assignment]  # uvloop's is no subclass
        lines = (
            "GET /ws HTTP/1.1",
            f"Host: {self._host}",
            "Upgrade: websocket",
            "Connection: Upgrade",
            "Sec-WebSocket-Version: 13",
            "Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==",
        )
        self._transport.write(("\r\n".join(lines) + "\r\n\r\n").encode())

    def connection_lost(self, _: Exception | None) -> None:
        """Take note of the end."""
        self.report.lost += 1

    def data_received(self, data: bytes) -> None:
        """Take what comes apart into frames."""
        self._data += data
        if not self._open:
            head, found, rest = self._data.partition(b"\r\n\r\n")
            if not found:
                return
            assert head.startswith(b"HTTP/1.1 101"), head
            self._open, self._data = True, rest
            self._transport.write(masked(msgspec.json.encode({"op": "subscribe", "id": 1, **_ASK[self._kind]})))
            if self._kind == "silent":
                self._transport.pause_reading()
                self.started.set()
                return
        self._take_frames()

    def _take_frames(self) -> None:
        at, view = 0, memoryview(self._data)
        while (found := _frame_at(view, at)) is not None:
            opcode, start, end = found
            if opcode == 0x81:
                self._take(_DECODER.decode(view[start:end]))
            elif opcode == 0x89:
                self._transport.write(masked(bytes(view[start:end]), 0x8A))
            at = end
        view.release()
        del self._data[:at]

    def _take(self, message: Message) -> None:
        if message.op == "missed":
            self.report.missed += 1
        if message.op != "data" or isinstance(message.samples, dict):
            return
        self.started.set()
        self.report.messages += 1
        self.report.delivered += len(message.samples)
        for sample in message.samples:
            before = self._last.get(sample.topic, sample)
            self._last[sample.topic] = sample
            if self._kind == "rated":
                self.times[sample.topic].append(sample.t)
            elif before is not sample:
                if before.epoch == sample.epoch and before.seq + 1 != sample.seq:
                    self.report.holes += 1
                if before.t + STALL_US < sample.t:
                    self.stalls[sample.topic].append((before.t, sample.t))

    @property
    def n_topics(self) -> int:
        """How many topics it has seen."""
        return len(self._last)


def _frame_at(view: memoryview, at: int) -> tuple[int, int, int] | None:
    """Opcode, start and end of the payload of a frame; None: it is not whole yet."""
    if len(view) < at + 2:
        return None
    size, start = view[at + 1], at + 2
    if size == 126:
        start += 2
    elif size == 127:
        start += 8
    if len(view) < start:
        return None
    if size >= 126:
        size = int.from_bytes(view[at + 2 : start], "big")
    return None if len(view) < start + size else (view[at], start, start + size)


def masked(payload: bytes, opcode: int = 0x81) -> bytes:
    """A client's frame, with a mask of zeros."""
    size = struct.pack("!B", 0x80 | len(payload)) if len(payload) < 126 else struct.pack("!BH", 0xFE, len(payload))
    return bytes([opcode]) + size + bytes(4) + payload


async def run(host: str, port: int, counts: dict[str, int]) -> Report:
    """Connect, say so, and read until the standard input ends."""
    loop = asyncio.get_running_loop()
    clients: dict[str, list[LoadClient]] = {kind: [] for kind in counts}
    for kind, count in counts.items():
        for _ in range(count):
            _, client = await loop.create_connection(
                lambda kind=kind: LoadClient(kind, f"{host}:{port}"),  # type: ignore[misc]
                host,
                port,
            )
            clients[kind].append(client)
            await client.started.wait()
    print("ready", flush=True)
    await loop.run_in_executor(None, sys.stdin.buffer.read)
    full, rated = clients["full"], clients["rated"]
    return Report(
        delivered=sum(client.report.delivered for client in full + rated),
        full=[client.report.delivered for client in full],
        messages=sum(client.report.messages for client in full),
        n_topics=min((client.n_topics for client in full + rated), default=0),
        holes=sum(client.report.holes for client in full),
        missed=sum(client.report.missed for client in full + rated),
        rated=[dict(client.times) for client in rated],
        stalls=dict(full[0].stalls),
        lost=sum(client.report.lost for client in full + rated),
    )


if __name__ == "__main__":
    _, asked_host, asked_port, *numbers = sys.argv
    with asyncio.Runner(loop_factory=uvloop.new_event_loop) as runner:
        wanted = dict(zip(("full", "rated", "silent"), map(int, numbers), strict=True))
        sys.stdout.buffer.write(msgspec.json.encode(runner.run(run(asked_host, int(asked_port), wanted))) + b"\n")
        sys.stdout.flush()
        os._exit(0)  # the silent ones are not waited for
