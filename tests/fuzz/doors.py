"""What clients may say: requests of the native protocol, messages of Foxglove, lines on the control socket.

Messages are cut out of the data: JSON at each line's end, MessagePack by two bytes of length, and for Foxglove a byte
before each line says whether it is a text or a binary message.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from functools import cache, partial

import msgspec
import structlog

from gateway.api import messages
from gateway.core.bus import Bus
from gateway.reloading import Reload
from gateway.server.cell import Cell
from gateway.server.control import Command, _answer
from gateway.server.foxglove.messages import encode
from gateway.server.foxglove.outbox import Outbox as FoxgloveOutbox
from gateway.server.foxglove.session import Session
from gateway.server.outbox import Outbox
from gateway.server.requests import BadRequest, Requests, decode, id_of
from gateway.server.wire import JSON, MSGPACK, Encoding, encode_response
from tests.fuzz.target import Target
from tests.server import kit

_MOST = 100  # messages of one talk
_NATIVE: tuple[dict[str, object], ...] = (
    {"op": "subscribe", "id": "s", "topics": ["*/joints", "r1/*"], "rate_hz": 30.0, "fields": ["position"]},
    {"op": "subscribe", "id": 2, "topics": ["*"], "mode": "all", "since": "b00t:0"},
    {"op": "unsubscribe", "id": "s"},
    {"op": "get", "id": 3, "topics": ["r1/status", "r2/link"]},
    {"op": "events", "id": 4, "topics": ["*"], "since": ["b00t:1"], "limit": 10},
    {"op": "robots", "id": 5},
    {"op": "describe", "id": 6, "topic": "r1/vendor"},
    {"op": "ping", "id": 7},
)
_FOXGLOVE: tuple[dict[str, object], ...] = (
    {"op": "subscribe", "subscriptions": [{"id": 1, "channelId": 1}, {"id": 2, "channelId": 2}]},
    {"op": "unsubscribe", "subscriptionIds": [1, 9]},
    {"op": "getParameters", "parameterNames": [], "id": "x"},
    {"op": "advertise", "channels": []},
    {"op": "subscribeConnectionGraph"},
)


def native_json() -> Target:
    """Text frames of the native protocol."""
    lines = [msgspec.json.encode(request) for request in _NATIVE]
    return Target("native-json", partial(_native, JSON), (*lines, b"\n".join(lines)))


def native_msgpack() -> Target:
    """Binary frames of the native protocol."""
    encoded = [msgspec.msgpack.encode(request) for request in _NATIVE]
    told = [len(one).to_bytes(2, "big") + one for one in encoded]
    return Target("native-msgpack", partial(_native, MSGPACK), (*told, b"".join(told)))


def control() -> Target:
    """Lines on the control socket."""
    lines = (b'{"command":"reload"}', b'{"command":"reload","check":true,"drop":["r1"]}', b'{"command":"capture"}')
    return Target("control", _control, (*lines, b"\n".join(lines)))


def foxglove() -> Target:
    """Text and binary frames of Foxglove's protocol."""
    texts = [b"t" + msgspec.json.encode(message) for message in _FOXGLOVE]
    return Target("foxglove", _foxglove, (*texts, b"\n".join(texts), b"b\x01\x00\x00\x00\x01{}"))


@cache
def _cell() -> tuple[Bus, Cell]:
    bus, robots = kit.cell("r1", "r2", command_ring=100)
    kit.publish(bus, "r1/joints", 1)
    kit.publish_status(bus, "r2/status", 1, in_motion=True)
    for robot in ("r1", "r2", "r1"):
        kit.raise_event(bus, robot)
        kit.raise_command(bus, robot)
    return bus, Cell(robots, bus)


def _messages(encoding: Encoding, data: bytes) -> Iterator[bytes]:
    if encoding.text:
        yield from data.split(b"\n")[:_MOST]
        return
    for _ in range(_MOST):
        size = int.from_bytes(data[:2], "big")
        yield data[2 : 2 + size]
        data = data[2 + size :]
        if not data:
            return


def _native(encoding: Encoding, data: bytes) -> None:
    bus, cell = _cell()
    outbox = Outbox(encoding, 0.0, time.monotonic)
    requests = Requests(cell, encoding, outbox)
    for number, message in enumerate(_messages(encoding, data), start=1):
        said: messages.Response
        try:
            request = decode(encoding, message)
        except BadRequest as error:
            said = messages.Error(id=id_of(encoding, message), code=error.code, message=str(error))
        else:
            try:
                said = requests.answer(request)
            except BadRequest as error:
                said = messages.Error(id=request.id, code=error.code, message=str(error))
        encode_response(encoding, said)
        kit.publish(bus, "r1/joints", number)
        outbox.collect()
    outbox.close()
    _check_left(bus)


def _foxglove(data: bytes) -> None:
    bus, cell = _cell()
    outbox = FoxgloveOutbox(0.0, time.monotonic)
    session = Session(cell, ["*"], outbox)
    for said in session.hello():
        encode(said)
    for number, line in enumerate(data.split(b"\n")[:_MOST], start=1):
        answer = session.take_binary(line[1:]) if line[:1] == b"b" else session.take(line[1:])
        if answer is not None:
            encode(answer)
        kit.publish(bus, "r1/joints", number)
        outbox.collect()
        list(session.refresh())
    outbox.close()
    _check_left(bus)


def _control(data: bytes) -> None:
    async def reload(request: Reload) -> Reload:
        return request

    commands = {"reload": Command(Reload, reload)}
    log: structlog.typing.FilteringBoundLogger = structlog.wrap_logger(None, processors=[_dropped])
    for line in data.split(b"\n")[:_MOST]:
        answering = _answer(line, commands, log)
        try:
            answering.send(None)  # nothing in it waits
        except StopIteration as done:
            msgspec.json.encode(done.value)
        else:
            raise AssertionError("an answer waits for something")


def _dropped(*_: object) -> structlog.typing.EventDict:
    raise structlog.DropEvent


def _check_left(bus: Bus) -> None:
    """A client that has left listens to nothing."""
    listening = [name for name, topic in bus.topics.items() if topic.listeners]
    if listening:
        raise AssertionError(f"somebody still listens to {', '.join(listening)}")
