"""How a client of each server asks for all samples, and what in the bytes it gets is one sample."""

from __future__ import annotations

import socket
import struct
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import msgspec

_TEXT, _BINARY = 0x81, 0x82
_TIMEOUT_S = 20.0
_READ = 1 << 16


@dataclass(frozen=True, slots=True, kw_only=True)
class Dialect:
    """What one kind of client does.

    Args:
        marker: Bytes that stand once in each sample.
        path: Where the WebSocket door is; None: the bytes come bare.
        subprotocol: What is asked for; None: nothing.
        ask: Asks for all samples, after the handshake; gets the socket and what has come already, returns what is left.
    """

    marker: bytes
    path: str | None = "/"
    subprotocol: str | None = None
    ask: Callable[[socket.socket, bytes, tuple[str, ...]], bytes] = lambda _, left, __: left


def join(port: int, dialect: Dialect, topics: tuple[str, ...]) -> tuple[socket.socket, bytes]:
    """Connect and ask; returns the socket and what came behind the handshake."""
    sock = socket.create_connection(("127.0.0.1", port), _TIMEOUT_S)
    if dialect.path is None:
        return sock, b""
    lines = [
        f"GET {dialect.path} HTTP/1.1",
        f"Host: 127.0.0.1:{port}",
        "Upgrade: websocket",
        "Connection: Upgrade",
        "Sec-WebSocket-Version: 13",
        "Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==",
    ]
    if dialect.subprotocol:
        lines.append(f"Sec-WebSocket-Protocol: {dialect.subprotocol}")
    sock.sendall(("\r\n".join(lines) + "\r\n\r\n").encode())
    data = b""
    while b"\r\n\r\n" not in data:
        data += received(sock)
    head, _, left = data.partition(b"\r\n\r\n")
    assert b" 101 " in head.partition(b"\r\n")[0], head
    return sock, dialect.ask(sock, left, topics)


def received(sock: socket.socket) -> bytes:
    """The next bytes.

    Raises:
        ConnectionError: There are no more.
    """
    data = sock.recv(_READ)
    if not data:
        raise ConnectionError("the server has closed the connection")
    return data


def masked(payload: bytes, opcode: int = _TEXT) -> bytes:
    """A client's frame, with a mask of zeros."""
    size = struct.pack("!B", 0x80 | len(payload)) if len(payload) < 126 else struct.pack("!BH", 0xFE, len(payload))
    return bytes([opcode]) + size + bytes(4) + payload


def frames(data: bytes) -> Iterator[tuple[int, int, int]]:
    """Opcode, start and end of the payload of each whole frame of a server."""
    at = 0
    while len(data) >= at + 2:
        size, start = data[at + 1], at + 2
        width = {126: 2, 127: 8}.get(size, 0)
        if width:
            start += width
            size = int.from_bytes(data[at + 2 : start], "big") if len(data) >= start else len(data)
        if len(data) < start + size:
            return
        yield data[at], start, start + size
        at = start + size


RATED_HZ = 10.0
_Wish = Mapping[str, object]


def _ask_native(
    encode: Callable[[object], bytes], opcode: int, wish: _Wish = MappingProxyType({"mode": "all"})
) -> Callable[[socket.socket, bytes, tuple[str, ...]], bytes]:
    def ask(sock: socket.socket, left: bytes, topics: tuple[str, ...]) -> bytes:
        sock.sendall(masked(encode({"op": "subscribe", "id": 1, "topics": topics, **wish}), opcode))
        return left

    return ask


def _ask_foxglove(sock: socket.socket, left: bytes, topics: tuple[str, ...]) -> bytes:
    """Subscribe to every channel that is advertised, once as many are known as there are topics."""
    known: list[int] = []
    while len(known) < len(topics):
        end = 0
        for opcode, start, end in frames(left):
            said = msgspec.json.decode(left[start:end]) if opcode == _TEXT else {}
            known += [channel["id"] for channel in said.get("channels", ()) if said["op"] == "advertise"]
        left = left[end:]
        if len(known) < len(topics):
            left += received(sock)
    wanted = [{"id": number, "channelId": channel} for number, channel in enumerate(known)]
    sock.sendall(masked(msgspec.json.encode({"op": "subscribe", "subscriptions": wanted})))
    return left


_JSON, _MSGPACK = b'"seq":', b"\xa3seq"
DIALECTS = {
    "json": Dialect(marker=_JSON, path="/ws", ask=_ask_native(msgspec.json.encode, _TEXT)),
    "msgpack": Dialect(
        marker=_MSGPACK,
        path="/ws",
        subprotocol="robot-gateway.v1+msgpack",
        ask=_ask_native(msgspec.msgpack.encode, _BINARY),
    ),
    "foxglove-json": Dialect(marker=_JSON, subprotocol="foxglove.sdk.v1", ask=_ask_foxglove),
    "foxglove-msgpack": Dialect(marker=_MSGPACK, subprotocol="foxglove.sdk.v1", ask=_ask_foxglove),
    "websockets-json": Dialect(marker=_JSON),
    "websockets-msgpack": Dialect(marker=_MSGPACK),
    "json-rated": Dialect(marker=_JSON, path="/ws", ask=_ask_native(msgspec.json.encode, _TEXT, {"rate_hz": RATED_HZ})),
    "relay": Dialect(marker=b"\xa5\xa5\x5a\x5a", path=None),
}
