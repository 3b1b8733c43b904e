"""The two encodings of the native protocol: each (topic, fields, encoding) is encoded once, never per client."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import msgspec

from gateway.api.messages import JSON_SUBPROTOCOL, MSGPACK_SUBPROTOCOL, Id, Request, Response, Result
from gateway.api.model import Event, Sample
from gateway.core.bus import Reading, Topic

Fields = tuple[tuple[str, ...], ...]  # dotted paths, taken apart


class Named(msgspec.Struct):
    """Of any message, its id: the rest is passed over without being built."""

    id: Id | None = None


class Encoding(Protocol):
    """How messages look on the wire."""

    name: str
    text: bool

    def encode(self, message: object) -> bytes:
        """Encode one message, sample or event."""
        ...

    def decode(self, message: bytes | str) -> Request:
        """Decode a request.

        Raises:
            msgspec.DecodeError: It is no message of this encoding; `ValidationError` where it is no known request.
        """
        ...

    def decode_id(self, message: bytes | str) -> Named:
        """Find the id of a request that is wrong.

        Raises:
            msgspec.DecodeError: It is no object, or its id is none.
        """
        ...

    def list_message(self, op: str, key: str, items: Sequence[bytes]) -> bytes:
        """Join encoded items to the message `{op, key: [items]}`."""
        ...


class Json:
    """Text frames."""

    name = JSON_SUBPROTOCOL
    text = True

    def __init__(self) -> None:
        self.encode = msgspec.json.Encoder().encode
        self.decode = msgspec.json.Decoder(Request).decode
        self.decode_id = msgspec.json.Decoder(Named).decode

    def list_message(self, op: str, key: str, items: Sequence[bytes]) -> bytes:
        """Join encoded items to one message."""
        return b'{"op":"%b","%b":[%b]}' % (op.encode(), key.encode(), b",".join(items))


class MsgPack:
    """Binary frames."""

    name = MSGPACK_SUBPROTOCOL
    text = False

    def __init__(self) -> None:
        self.encode = msgspec.msgpack.Encoder().encode
        self._requests: msgspec.msgpack.Decoder[Request] = msgspec.msgpack.Decoder(Request)
        self._named = msgspec.msgpack.Decoder(Named)

    def decode(self, message: bytes | str) -> Request:
        """Decode a request."""
        return self._requests.decode(_as_bytes(message))

    def decode_id(self, message: bytes | str) -> Named:
        """Find the id."""
        return self._named.decode(_as_bytes(message))

    def list_message(self, op: str, key: str, items: Sequence[bytes]) -> bytes:
        """Join encoded items to one message: a map of two with an array of 32-bit length."""
        head = b"\x82" + self.encode("op") + self.encode(op) + self.encode(key)
        return head + b"\xdd" + struct.pack(">I", len(items)) + b"".join(items)


JSON: Encoding = Json()
MSGPACK: Encoding = MsgPack()
ENCODINGS: dict[str, Encoding] = {JSON.name: JSON, MSGPACK.name: MSGPACK}


@dataclass(frozen=True, slots=True)
class Cut:
    """What of a sample a subscription wants, and in which encoding: the key of the reading's cache.

    Args:
        encoding: How it is encoded.
        fields: Only these paths of data; None: all.
    """

    encoding: Encoding
    fields: Fields | None

    def encoded(self, topic: Topic, reading: Reading) -> bytes:
        """The encoded sample, made once for all clients that want the same."""
        key = (topic.group.name, self.fields, self.encoding.name)
        found = reading.encoded.get(key)
        if found is None:
            try:
                found = self._encode(reading.sample(topic))
            except Exception as error:  # noqa: BLE001 - a plugin's wrong type costs its group, not the clients
                found = self._encode(reading.broken(topic, error))
            reading.encoded[key] = found
        return found

    def _encode(self, sample: Sample) -> bytes:
        if self.fields is not None:
            sample = msgspec.structs.replace(sample, data=project(sample.data, self.fields))
        return self.encoding.encode(sample)


def sound_sample(encoding: Encoding, topic: Topic, reading: Reading) -> Sample:
    """What a reading says of a topic, or the empty sample in the place of one that cannot be encoded."""
    sample = reading.sample(topic)
    try:
        encoding.encode(sample)
    except Exception as error:  # noqa: BLE001 - as above
        return reading.broken(topic, error)
    return sample


def project(data: object, fields: Fields) -> dict[str, object]:
    """Keep only some paths of a group.

    Args:
        data: A struct of the model, or the mapping of a vendor group.
        fields: Paths; one that the group does not have is left out.
    """
    kept: dict[str, object] = {}
    for path in fields:
        found, value = _find(data, path)
        if not found:
            continue
        at = kept
        for name in path[:-1]:
            below = at.setdefault(name, {})
            at = below if isinstance(below, dict) else {}
        at[path[-1]] = value
    return kept


def encode_events(encoding: Encoding, events: Sequence[Event]) -> bytes:
    """One message with some events."""
    return encoding.list_message("event", "events", [_encode_event(encoding, event) for event in events])


def encode_response(encoding: Encoding, message: Response) -> bytes:
    """One message of the gateway."""
    try:
        return encoding.encode(message)
    except Exception:
        if not isinstance(message, Result) or not message.events:
            raise
        events = [msgspec.Raw(_encode_event(encoding, event)) for event in message.events]
        return encoding.encode(msgspec.structs.replace(message, events=events))


def _encode_event(encoding: Encoding, event: Event) -> bytes:
    """Encode an event; its values are left out where a plugin's cannot be encoded, which their group reports."""
    try:
        return encoding.encode(event)
    except Exception:  # noqa: BLE001 - a plugin's wrong type costs its values, not the clients
        return encoding.encode(msgspec.structs.replace(event, before=None, after=None, raw={}))


def _find(data: object, path: Sequence[str]) -> tuple[bool, object]:
    for name in path:
        if isinstance(data, dict):
            if name not in data:
                return False, None
            data = data[name]
        elif isinstance(data, msgspec.Struct):
            if name not in data.__struct_fields__:
                return False, None
            data = getattr(data, name)
        elif data is None:
            return True, None
        else:
            return False, None
    return True, data


def _as_bytes(message: bytes | str) -> bytes:
    return message if isinstance(message, bytes) else message.encode()
