"""How samples and events are written: JSON or MessagePack, the same envelope as the doors, made once for all."""

from __future__ import annotations

from collections.abc import Callable

import msgspec

from gateway.api.messages import JSON_SUBPROTOCOL, MSGPACK_SUBPROTOCOL
from gateway.api.model import Event
from gateway.core.bus import Reading, Topic

Encode = Callable[[object], bytes]
_BRACE = 0x7B  # what JSON objects begin with, and no map of MessagePack


class Encoder:
    """Writes one format.

    Args:
        name: json or msgpack.
    """

    def __init__(self, name: str) -> None:
        self.encode: Encode = msgspec.json.Encoder().encode if name == "json" else msgspec.msgpack.Encoder().encode
        # The doors' name of the same encoding: what they have made of a reading is taken from its cache.
        self._door = JSON_SUBPROTOCOL if name == "json" else MSGPACK_SUBPROTOCOL

    def sample(self, topic: Topic, reading: Reading) -> bytes:
        """A sample; of a plugin's mistake the empty one."""
        key = (topic.group.name, None, self._door)
        found = reading.encoded.get(key)
        if found is None:
            try:
                found = self.encode(reading.sample(topic))
            except Exception as error:  # noqa: BLE001 - a plugin's wrong type costs its group
                found = self.encode(reading.broken(topic, error))
            reading.encoded[key] = found
        return found


def encoded_event(encode: Encode, event: Event) -> bytes:
    """An event; without its values where a plugin's cannot be encoded, which their group reports."""
    try:
        return encode(event)
    except Exception:  # noqa: BLE001 - a plugin's wrong type costs its values
        return encode(shortened(event))


def shortened(event: Event) -> Event:
    """An event without its values."""
    return msgspec.structs.replace(event, before=None, after=None, raw={})


def without_values(payload: bytes) -> bytes:
    """A written event without its values: too long for the server as it is.

    Raises:
        msgspec.DecodeError: It is no event.
    """
    if payload[0] == _BRACE:
        return msgspec.json.encode(shortened(msgspec.json.decode(payload, type=Event)))
    return msgspec.msgpack.encode(shortened(msgspec.msgpack.decode(payload, type=Event)))
