"""The AsyncAPI document of the native protocol, made of the message structs; written by `make generated`."""

from __future__ import annotations

import inspect
import typing
from collections.abc import Iterable

import msgspec

from gateway.api import messages
from gateway.api.model import GROUPS, SAFETY_NOTICE, Sample

REQUESTS: tuple[type[msgspec.Struct], ...] = typing.get_args(messages.Request)
RESPONSES: tuple[type[msgspec.Struct], ...] = typing.get_args(messages.Response)
Schema = dict[str, object]

_SCHEMAS = "#/components/schemas/{name}"
_CHANNEL = "#/channels/native"
_DESCRIPTION = f"""Everything that the gateway knows of its robots, read only. docs/protocol.md tells how it is used.

The subprotocol `{messages.JSON_SUBPROTOCOL}` (also without one) sends text frames of JSON,
`{messages.MSGPACK_SUBPROTOCOL}` binary frames of MessagePack; the messages are the same. A client ignores keys that it
does not know. {SAFETY_NOTICE}"""


def asyncapi() -> Schema:
    """The document `docs/asyncapi.json`: the gateway is the application that it describes."""
    schemas = _schemas()
    return {
        "asyncapi": "3.0.0",
        "info": {
            "title": "robot-gateway, native WebSocket protocol",
            "version": f"{messages.PROTOCOL_VERSION}.0.0",
            "description": _DESCRIPTION,
        },
        "defaultContentType": "application/json",
        "servers": {"local": {"host": "127.0.0.1:8765", "protocol": "ws", "description": "As it comes."}},
        "channels": {
            "native": {
                "address": "/ws",
                "description": "One connection of one client.",
                "messages": {_op(one): {"$ref": f"#/components/messages/{_op(one)}"} for one in REQUESTS + RESPONSES},
                "bindings": {"ws": {"query": _query(schemas["Subscribe"]), "bindingVersion": "0.1.0"}},
            }
        },
        "operations": {**{_op(one): _asked(one) for one in REQUESTS}, "push": _pushed()},
        "components": {"messages": {_op(one): _message(one) for one in REQUESTS + RESPONSES}, "schemas": schemas},
    }


def _op(struct: type[msgspec.Struct]) -> str:
    return str(struct.__struct_config__.tag)


def _schemas() -> dict[str, Schema]:
    """The schemas of all messages and of all groups of the model."""
    groups = [group.struct for group in GROUPS.values() if group.struct is not None]
    structs = [*REQUESTS, *RESPONSES, *groups]
    _, found = msgspec.json.schema_components(structs, schema_hook=_any, ref_template=_SCHEMAS)
    sample = typing.cast("dict[str, Schema]", found[Sample.__name__]["properties"])
    sample["data"] = {
        "description": "The group of the topic, or the chosen fields of it.",
        "type": ["object", "null"],
        "x-by-group": {
            group.name: _ref(group.struct) if group.struct else {"type": "object"}
            for group in GROUPS.values()
            if group.delivery != "event"
        },
    }
    return dict(sorted(found.items()))


def _any(kind: type) -> Schema:
    """Leaves of type `object` hold whatever the vendor has."""
    if kind is object:
        return {"description": "Any value."}
    raise NotImplementedError


def _ref(struct: type[msgspec.Struct]) -> Schema:
    return {"$ref": _SCHEMAS.format(name=struct.__name__)}


def _message(struct: type[msgspec.Struct]) -> Schema:
    return {"name": _op(struct), "title": struct.__name__, "summary": inspect.getdoc(struct), "payload": _ref(struct)}


def _refs(structs: Iterable[type[msgspec.Struct]]) -> list[Schema]:
    return [{"$ref": f"{_CHANNEL}/messages/{_op(one)}"} for one in structs]


def _asked(struct: type[msgspec.Struct]) -> Schema:
    """A request and its answer."""
    return {
        "action": "receive",
        "channel": {"$ref": _CHANNEL},
        "summary": inspect.getdoc(struct),
        "messages": _refs([struct]),
        "reply": {"channel": {"$ref": _CHANNEL}, "messages": _refs([messages.Result, messages.Error])},
    }


def _pushed() -> Schema:
    """What comes unasked: the welcome, and what subscriptions bring."""
    pushed: list[type[msgspec.Struct]] = [messages.Welcome, messages.Data, messages.EventMessage, messages.Missed]
    return {
        "action": "send",
        "channel": {"$ref": _CHANNEL},
        "summary": "The first message, and what the client's subscriptions bring.",
        "messages": _refs(pushed),
    }


def _query(subscribe: Schema) -> Schema:
    """A subscription in the URL: lists have commas."""
    properties = typing.cast("dict[str, Schema]", subscribe["properties"])
    named = [name for name in properties if name not in {"op", "id"}]
    return {
        "type": "object",
        "description": "A subscription of the name url; several topics, fields or names of events have commas between.",
        "properties": {name: {"type": "number" if name == "rate_hz" else "string"} for name in named},
    }
