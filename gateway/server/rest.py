"""Snapshots over HTTP: robots, latest values, events read back, and schemas. Every address only reads."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Annotated

import msgspec
from aiohttp import web
from msgspec import Meta

from gateway.api import messages
from gateway.api.describe import group_schema
from gateway.api.messages import RobotInfo
from gateway.api.model import GROUPS, Delivery, Event, Sample
from gateway.core.bus import Topic
from gateway.server.access import ACCESS, cell_of
from gateway.server.answers import answer, converted, encoded, parameters, splitted
from gateway.server.bookmark import Bookmark
from gateway.server.cell import Cell
from gateway.server.outbox import Outbox
from gateway.server.requests import BadRequest, Requests
from gateway.server.wire import JSON, Cut, Json, encode_events

# No name of a topic, robot or field is nearly as long.
_MAX_NAME = 256


class RobotList(msgspec.Struct, frozen=True, kw_only=True):
    """Every robot with the state of its link."""

    robots: list[RobotInfo]
    access: Annotated[
        messages.AccessMode,
        Meta(description="Who is let in: programs of this machine, who has a token, or everybody without one."),
    ]


class EventList(msgspec.Struct, frozen=True, kw_only=True):
    """Events, in order."""

    events: list[Event]
    missed: int | None
    next: str


class GroupInfo(msgspec.Struct, frozen=True, kw_only=True):
    """One group of the model."""

    delivery: Delivery
    text: str
    schema: dict[str, object]


class SchemaList(msgspec.Struct, frozen=True, kw_only=True):
    """The model: the envelope of every sample, and its groups."""

    sample: dict[str, object]
    groups: dict[str, GroupInfo]


class _Array(Json):
    """JSON whose lists of messages are plain arrays."""

    def list_message(self, op: str, key: str, items: Sequence[bytes]) -> bytes:  # noqa: ARG002 - an encoding's signature
        """Join encoded items."""
        return b"[%b]" % b",".join(items)


_ARRAY = _Array()


async def robots(request: web.Request) -> web.Response:
    """Every robot with the state of its link."""
    parameters(request)
    return answer(RobotList(robots=cell_of(request).infos(), access=request.app[ACCESS].mode))


async def robot(request: web.Request) -> web.Response:
    """One robot.

    Raises:
        BadRequest: There is none of this name.
    """
    parameters(request)
    name = request.match_info["name"]
    infos = {info.name: info for info in cell_of(request).infos()}
    if name not in infos:
        known = ", ".join(infos) or "none"
        raise BadRequest("UNKNOWN_ROBOT", f"there is no robot {name[:_MAX_NAME]!r}; there are: {known}")
    return answer(infos[name])


async def topic(request: web.Request) -> web.Response:
    """The latest sample of a topic.

    Raises:
        BadRequest: There is none of this name, it lacks a field, or nothing has come yet.
    """
    found = splitted(parameters(request, "fields"), "fields")
    cell = cell_of(request)
    asked = _topic(cell, request.match_info["topic"])
    if asked.ring is not None:
        words = f"{asked.name} holds events: read /api/v1/events?topics={asked.name}"
        raise BadRequest("BAD_REQUEST", words)
    fields = None if "fields" not in found else _paths(cell, asked, found["fields"])
    if asked.latest is None:
        raise BadRequest("NOT_YET", f"nothing has come of {asked.name} yet")
    return encoded(Cut(JSON, fields).encoded(asked, asked.latest))


async def events(request: web.Request) -> web.Response:
    """Events read back from the rings.

    Raises:
        BadRequest: A parameter is not what it should be.
    """
    found = splitted(parameters(request, "since", "limit", "topics"), "since", "topics")
    wish = converted({"id": "url", **found}, messages.Events)
    cell = cell_of(request)
    result = Requests(cell, JSON, Outbox(JSON, 0.0, time.monotonic)).answer(wish)
    read = result.events or []
    since = [wish.since] if isinstance(wish.since, str) else wish.since
    bookmark = Bookmark(cell.match(wish.topics), since, from_oldest=True)
    if len(read) < wish.limit:
        bookmark.move_to_end()
    else:
        for event in read:
            bookmark.move(event.name)
    missed = None if result.missed == -1 else result.missed
    told = {"events": msgspec.Raw(encode_events(_ARRAY, read)), "missed": missed, "next": str(bookmark)}
    return answer(told)


async def schemas(request: web.Request) -> web.Response:
    """The schemas of every group."""
    parameters(request)
    groups = {
        name: GroupInfo(delivery=group.delivery, text=group.text, schema=group_schema(name))
        for name, group in GROUPS.items()
    }
    return answer(SchemaList(sample=msgspec.json.schema(Sample), groups=groups))


async def schema(request: web.Request) -> web.Response:
    """What a topic holds, and where each value comes from.

    Raises:
        BadRequest: There is none of this name.
    """
    parameters(request)
    cell = cell_of(request)
    return answer(cell.describe(_topic(cell, request.match_info["topic"])))


def _topic(cell: Cell, name: str) -> Topic:
    found = cell.topics.get(name)
    if found is None:
        raise BadRequest("UNKNOWN_TOPIC", cell.unknown_topic([name[:_MAX_NAME]]))
    return found


def _paths(cell: Cell, asked: Topic, fields: object) -> tuple[tuple[str, ...], ...]:
    names = msgspec.convert(fields, list[str])
    if len(max(names, key=len)) > _MAX_NAME:
        raise BadRequest("TOO_MUCH", f"a field has at most {_MAX_NAME} characters")
    unknown = cell.unknown_fields([asked], names)
    if unknown is not None:
        raise BadRequest("UNKNOWN_FIELD", unknown)
    return tuple(tuple(name.split(".")) for name in dict.fromkeys(names))
