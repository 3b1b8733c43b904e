"""The messages of the Foxglove WebSocket protocol v1, as far as a server without capabilities needs them.

JSON objects in text frames, `op` is the tag; samples leave in binary frames (all numbers little-endian):

    | 0x01 | subscription id, u32 | receive time in ns, u64 | payload |

Source: github.com/foxglove/ws-protocol, docs/spec.md.
"""

from __future__ import annotations

import struct
from typing import Annotated

import msgspec
from msgspec import UNSET, Meta, UnsetType

SUBPROTOCOLS = ("foxglove.sdk.v1", "foxglove.websocket.v1")
MESSAGE_DATA = 1
INFO, WARNING, ERROR = range(3)  # levels of a status

# What a client may ask for only where the server has said so, and the capability that says it.
CAPABILITIES = {
    "advertise": "clientPublish",
    "unadvertise": "clientPublish",
    "getParameters": "parameters",
    "setParameters": "parameters",
    "subscribeParameterUpdates": "parametersSubscribe",
    "unsubscribeParameterUpdates": "parametersSubscribe",
    "subscribeConnectionGraph": "connectionGraph",
    "unsubscribeConnectionGraph": "connectionGraph",
    "fetchAsset": "assets",
}

_HEAD = struct.Struct("<BIQ")
_ENCODER = msgspec.json.Encoder()
Uint32 = Annotated[int, Meta(ge=0, le=2**32 - 1)]  # it has so much room in a binary frame


class ServerInfo(msgspec.Struct, tag_field="op", tag="serverInfo", frozen=True, kw_only=True, rename="camel"):
    """What every client is told first."""

    name: str
    capabilities: list[str] = []
    supported_encodings: list[str] = []
    metadata: dict[str, str]
    session_id: str


class Status(msgspec.Struct, tag_field="op", tag="status", frozen=True, kw_only=True):
    """A word to the person at the client; one with an id takes the place of the one before it."""

    level: int
    message: str
    id: str | UnsetType = UNSET


class Channel(msgspec.Struct, frozen=True, kw_only=True, rename="camel"):
    """One channel, as it is advertised; its schema is a JSON string that holds JSON, already escaped."""

    id: int
    topic: str
    encoding: str = "json"
    schema_name: str
    schema: msgspec.Raw
    schema_encoding: str = "jsonschema"


class Advertise(msgspec.Struct, tag_field="op", tag="advertise", frozen=True):
    """Channels that there are now."""

    channels: list[Channel]


class Unadvertise(msgspec.Struct, tag_field="op", tag="unadvertise", frozen=True, rename="camel"):
    """Channels that are gone."""

    channel_ids: list[int]


class Wanted(msgspec.Struct, frozen=True, rename="camel"):
    """One subscription of a client, which chooses its id."""

    id: Uint32
    channel_id: int


class Subscribe(msgspec.Struct, tag_field="op", tag="subscribe", frozen=True):
    """A client wants channels."""

    subscriptions: list[Wanted]


class Unsubscribe(msgspec.Struct, tag_field="op", tag="unsubscribe", frozen=True, rename="camel"):
    """A client has had enough."""

    subscription_ids: list[int]


class Head(msgspec.Struct):
    """Of any message of a client, what it is."""

    op: str


Request = Subscribe | Unsubscribe
Response = ServerInfo | Status | Advertise | Unadvertise
_HEADS = msgspec.json.Decoder(Head)
_REQUESTS: msgspec.json.Decoder[Request] = msgspec.json.Decoder(Request)
OPS = ("subscribe", "unsubscribe")


def op_of(text: bytes) -> str:
    """What a message of a client is.

    Raises:
        msgspec.DecodeError: It is no object with an `op`.
        UnicodeError, RecursionError: It is not even JSON.
    """
    return _HEADS.decode(text).op


def decode(text: bytes) -> Request:
    """Read a message whose `op` is one of `OPS`.

    Raises:
        msgspec.DecodeError: Something in it is wrong.
    """
    return _REQUESTS.decode(text)


def encode(message: Response) -> str:
    """One text frame."""
    return _ENCODER.encode(message).decode()


def data_frame(subscription: int, t: int, payload: bytes) -> bytes:
    """One binary frame with a sample or an event.

    Args:
        subscription: The client's id.
        t: When it was received, µs UTC.
        payload: What the channel's encoding says.
    """
    return _HEAD.pack(MESSAGE_DATA, subscription, t * 1000) + payload
