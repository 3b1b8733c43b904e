"""The OpenAPI 3.1 document of the HTTP door: the addresses from one table, the bodies from the structs."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import msgspec
from aiohttp import web

from gateway import __version__
from gateway.api.messages import MAX_EVENTS, MAX_RATE_HZ, Description, RobotInfo
from gateway.api.model import GROUPS, SAFETY_NOTICE, Sample
from gateway.server.answers import Failure, encoded, parameters
from gateway.server.health import Health, Readiness, Waiting
from gateway.server.rest import EventList, RobotList, SchemaList

_Schema = dict[str, object]
_REF = "#/components/schemas/{name}"
_SCHEMES: _Schema = {
    "bearer": {"type": "http", "scheme": "bearer", "description": "A token of the gateway."},
    "query": {"type": "apiKey", "in": "query", "name": "token", "description": "For clients that can send no header."},
}
# Without a token too: by default only programs of the gateway's own machine can connect, and need none.
_SECURITY: list[dict[str, list[str]]] = [{"bearer": []}, {"query": []}, {}]
_STRINGS: _Schema = {"type": "array", "items": {"type": "string"}, "minItems": 1}


@dataclass(frozen=True, slots=True)
class Parameter:
    """One parameter of an address.

    Args:
        name: As it stands in the URL or among the headers.
        text: What it means.
        schema: What it may be; an array stands with commas between.
        where: Its place.
        required: Whether it must be there.
        example: A value.
    """

    name: str
    text: str
    schema: _Schema
    where: str = "query"
    required: bool = False
    example: object = None


@dataclass(frozen=True, slots=True)
class Address:
    """One address that is read with GET.

    Args:
        path: Its template.
        name: Unique, for generated clients.
        text: What it gives.
        body: The struct of its JSON; None: text of another kind.
        media: Content type of the body.
        parameters: What it may be asked.
        errors: By status: why it may fail, and the struct that says so.
        is_open: Whether it is answered without a token where others need one.
    """

    path: str
    name: str
    text: str
    body: type[msgspec.Struct] | None
    media: str = "application/json"
    parameters: Sequence[Parameter] = ()
    errors: Sequence[tuple[int, str, type[msgspec.Struct]]] = ()
    is_open: bool = False


_NO_TOKEN = (401, "A token is needed, and none that is known came along.", Failure)
_BAD = (400, "A parameter is unknown or not what it should be.", Failure)
_NO_TOPIC = (404, "There is no such topic.", Failure)
_TOPIC = Parameter("topic", "`<robot>/<group>`.", {"type": "string"}, "path", required=True, example="r1/joints")
_GLOBS = "Topic globs, such as `*/joints` or `r1/*`."
_FIELDS = Parameter("fields", "Dotted paths in data: only these.", _STRINGS, example=["position"])
_SINCE = Parameter(
    "since", "Names of events, one for each ring: read on after them.", _STRINGS, example=["9f2c41d0:17"]
)
_LIMIT: _Schema = {"type": "integer", "minimum": 1, "maximum": MAX_EVENTS, "default": 1000}
_RATE: _Schema = {"type": "number", "exclusiveMinimum": 0, "maximum": MAX_RATE_HZ}
_MODE: _Schema = {"enum": ["latest", "all"], "default": "latest"}

ADDRESSES = (
    Address("/api/v1/robots", "robots", "Every robot with the state of its link.", RobotList, errors=[_BAD]),
    Address(
        "/api/v1/robots/{name}",
        "robot",
        "One robot.",
        RobotInfo,
        parameters=[Parameter("name", "The robot.", {"type": "string"}, "path", required=True, example="r1")],
        errors=[_BAD, (404, "There is no such robot.", Failure)],
    ),
    Address(
        "/api/v1/topics/{topic}",
        "topic",
        "The latest sample of a topic. Its slash stands as it is.",
        Sample,
        parameters=[_TOPIC, _FIELDS],
        errors=[_BAD, _NO_TOPIC, (503, "Nothing has come of the topic yet.", Failure)],
    ),
    Address(
        "/api/v1/events",
        "events",
        "Events read back from the rings, the oldest first.",
        EventList,
        parameters=[
            _SINCE,
            Parameter("limit", "At most so many.", _LIMIT),
            Parameter("topics", f"{_GLOBS} Default: all.", _STRINGS, example=["*/events"]),
        ],
        errors=[_BAD, (404, "No topic matches.", Failure)],
    ),
    Address("/api/v1/schema", "schemas", "The model: every group as JSON Schema.", SchemaList, errors=[_BAD]),
    Address(
        "/api/v1/schema/{topic}",
        "schema",
        "What a topic holds, where each value comes from, and what the robot can never tell.",
        Description,
        parameters=[_TOPIC],
        errors=[_BAD, _NO_TOPIC],
    ),
    Address(
        "/api/v1/stream",
        "stream",
        "Server-sent events: `sample` (a Sample), `event` (an Event, with an id) and `missed` (what was left out).",
        None,
        "text/event-stream",
        parameters=[
            Parameter("topics", _GLOBS, _STRINGS, required=True, example=["*/joints", "*/events"]),
            Parameter("rate_hz", "At most so often; phase-locked.", _RATE, example=10),
            Parameter("mode", "The newest value, or every sample up to a bound.", _MODE),
            _FIELDS,
            _SINCE,
            Parameter("Last-Event-ID", "The last id that came: goes before `since`.", {"type": "string"}, "header"),
        ],
        errors=[_BAD, (404, "No topic matches.", Failure)],
    ),
    Address("/api/v1/openapi.json", "openapi", "This document.", None, "application/json", errors=[_BAD]),
    Address("/metrics", "metrics", "Metrics for Prometheus.", None, "text/plain", errors=[_BAD]),
    Address(
        "/healthz",
        "healthz",
        "Whether the loop turns.",
        Health,
        errors=[_BAD, (503, "It has not turned for a while.", Failure)],
        is_open=True,
    ),
    Address(
        "/readyz",
        "readyz",
        "Whether every configured link has been tried.",
        Readiness,
        errors=[_BAD, (503, "Some have not.", Waiting)],
        is_open=True,
    ),
)


def openapi() -> _Schema:
    """The document."""
    structs = [address.body for address in ADDRESSES if address.body is not None]
    groups = [group.struct for group in GROUPS.values() if group.struct is not None]
    kinds = list(dict.fromkeys([*structs, *groups, Failure, Waiting]))
    _, components = msgspec.json.schema_components(kinds, schema_hook=_anything, ref_template=_REF)
    return {
        "openapi": "3.1.0",
        "info": {
            "title": "robot-gateway",
            "version": __version__,
            "summary": "Every robot of the cell, whatever its brand, as one honest stream.",
            "description": f"Every address only reads. Errors are `{{code, message}}`. {SAFETY_NOTICE}",
            "license": {"name": "Apache-2.0", "identifier": "Apache-2.0"},
        },
        "servers": [{"url": "http://127.0.0.1:8765", "description": "The default listener."}],
        "paths": {address.path: {"get": _operation(address)} for address in ADDRESSES},
        "components": {"schemas": components, "securitySchemes": _SCHEMES},
    }


@cache
def openapi_text() -> str:
    """The document as `docs/openapi.json` has it."""
    return json.dumps(openapi(), indent=2, ensure_ascii=False) + "\n"


async def document(request: web.Request) -> web.Response:
    """The document."""
    parameters(request)
    return encoded(openapi_text().encode())


def _operation(address: Address) -> _Schema:
    found = {"schema": _ref(address.body)} if address.body is not None else {"schema": {"type": "string"}}
    if address.body is None and address.media == "application/json":
        found = {"schema": {"type": "object"}}
    responses: _Schema = {"200": {"description": address.text, "content": {address.media: found}}}
    errors = list(address.errors)
    if not address.is_open:
        errors.append(_NO_TOKEN)
    for status, text, struct in errors:
        responses[str(status)] = {"description": text, "content": {"application/json": {"schema": _ref(struct)}}}
    asked = {"parameters": [_parameter(one) for one in address.parameters]} if address.parameters else {}
    security: _Schema = {} if address.is_open else {"security": _SECURITY}
    return {"operationId": address.name, "summary": address.text, **asked, "responses": responses, **security}


def _parameter(one: Parameter) -> _Schema:
    found: _Schema = {"name": one.name, "in": one.where, "description": one.text, "required": one.required}
    if one.schema.get("type") == "array":
        found |= {"style": "form", "explode": False}
    found["schema"] = one.schema
    return found if one.example is None else {**found, "example": one.example}


def _ref(struct: type[msgspec.Struct]) -> _Schema:
    return {"$ref": _REF.format(name=struct.__name__)}


def _anything(_: type) -> _Schema:
    """The schema of what may be any value; msgspec takes no empty one."""
    return {"description": "Any value."}
