"""One bad client in a process of its own, as rude as a socket allows.

    python -m tests.end_to_end.load_faults HOST PORT FAULT

It does wrong while told `go` on its standard input, stops at `rest`, and answers each word with the same one.
"""

from __future__ import annotations

import contextlib
import json
import select
import socket
import struct
import sys
import time
from collections.abc import Callable

_WAIT_S = 1.0
_TEXT, _BINARY, _MORE, _WHOLE = 0x1, 0x2, 0x0, 0x80


class Rude:
    """A bad client.

    Args:
        host: Where the gateway is.
        port: Its port.
    """

    def __init__(self, host: str, port: int) -> None:
        self._address = (host, port)
        self._kept: list[socket.socket] = []

    def never_reads(self) -> None:
        """Ask for everything and take nothing."""
        if not self._kept:
            self._keep(self._subscribed("*", small=True))

    def says_nothing(self) -> None:
        """Connect and wait, with and without a handshake."""
        if len(self._kept) < 20:
            self._keep(self._connected())
            self._keep(socket.create_connection(self._address))

    def connects_and_drops(self) -> None:
        """Five hundred connections, of which none says goodbye: some in the handshake, some after it."""
        for number in range(500):
            made = socket.create_connection(self._address)
            if number % 2:
                made.sendall(self._handshake())
            made.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            made.close()
            if told():
                return

    def asks_for_10_000_topics(self) -> None:
        """As one message over the limit, and as the most that fits."""
        self._tell(_TEXT | _WHOLE, subscribe([f"r{number}/joints" for number in range(10_000)]))
        self._tell(_TEXT | _WHOLE, subscribe([f"r{number}/*" for number in range(256)]))

    def asks_for_impossible_rates(self) -> None:
        """Zero, negative, absurd, not a number."""
        for rate in ("0", "-1", "1e9", "NaN", '"fast"', "1" + "0" * 400):
            text = subscribe(["*/joints"]).decode().replace("}", f', "rate_hz": {rate}}}')
            self._tell(_TEXT | _WHOLE, text.encode())

    def sends_binary(self) -> None:
        """Binary where text is due."""
        self._tell(_BINARY | _WHOLE, b"\x00\xff" * 500)

    def sends_fragments(self) -> None:
        """A message in a thousand pieces, and one that is never finished."""
        text = b'{"op": "ping", "id": "' + b"x" * 1000 + b'"}'
        pieces = [masked(_MORE if at else _TEXT, text[at : at + 1]) for at in range(len(text) - 1)]
        self._send(b"".join([*pieces, masked(_MORE | _WHOLE, text[-1:])]))
        self._send(masked(_TEXT, b"{"), keep=True)

    def sends_too_much(self) -> None:
        """Two megabytes at once."""
        self._send(masked(_TEXT | _WHOLE, b"x" * 2_000_000))

    def _tell(self, opcode: int, payload: bytes) -> None:
        self._send(masked(opcode, payload))

    def _send(self, data: bytes, *, keep: bool = False) -> None:
        made = self._connected()
        made.settimeout(_WAIT_S)
        with contextlib.suppress(OSError):
            made.sendall(data)
            made.recv(65_536)
        if keep and len(self._kept) < 20:
            self._keep(made)
        else:
            made.close()

    def _subscribed(self, topic: str, *, small: bool) -> socket.socket:
        made = self._connected(small=small)
        made.sendall(masked(_TEXT | _WHOLE, subscribe([topic], mode="all")))
        return made

    def _connected(self, *, small: bool = False) -> socket.socket:
        made = socket.socket()
        if small:
            made.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        made.connect(self._address)
        made.sendall(self._handshake())
        if not small:
            made.recv(4096)
        return made

    def _handshake(self) -> bytes:
        lines = (
            "GET /ws HTTP/1.1",
            f"Host: {self._address[0]}:{self._address[1]}",
            "Upgrade: websocket",
            "Connection: Upgrade",
            "Sec-WebSocket-Version: 13",
            "Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==",
        )
        return ("\r\n".join(lines) + "\r\n\r\n").encode()

    def _keep(self, made: socket.socket) -> None:
        self._kept.append(made)


def subscribe(topics: list[str], **more: object) -> bytes:
    """The request for some topics."""
    return json.dumps({"op": "subscribe", "id": 1, "topics": topics, **more}).encode()


def masked(opcode: int, payload: bytes) -> bytes:
    """A client's frame, with a mask of zeros."""
    size = len(payload)
    if size < 126:
        head = struct.pack("!BB", opcode, 0x80 | size)
    elif size < 1 << 16:
        head = struct.pack("!BBH", opcode, 0xFE, size)
    else:
        head = struct.pack("!BBQ", opcode, 0xFF, size)
    return head + bytes(4) + payload


def told() -> bool:
    """Whether a word waits on the standard input."""
    return bool(select.select([sys.stdin], [], [], 0)[0])


def run(act: Callable[[], None]) -> None:
    """Do as told."""
    for word in iter(sys.stdin.readline, ""):
        print(word.strip(), flush=True)
        while word.strip() == "go" and not told():
            with contextlib.suppress(OSError):
                act()
            time.sleep(0.002)


if __name__ == "__main__":
    run(getattr(Rude(sys.argv[1], int(sys.argv[2])), sys.argv[3]))
