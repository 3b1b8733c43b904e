"""Snapshots over HTTP, and the document that describes them."""

from __future__ import annotations

import re
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import aiohttp
import jsonschema
import msgspec
import pytest

from gateway.api.messages import Description, RobotInfo
from gateway.api.model import GROUPS, Sample
from gateway.core.bus import Bus, Topic
from gateway.server import openapi, rest
from gateway.server.http import _ROUTES
from gateway.server.openapi import ADDRESSES, openapi_text
from tests.server.kit import BOOT, CountingReading, Robot, cell, last_name, publish, raise_command, raise_event
from tests.server.kit import running_door as door

ROOT = Path(__file__).parents[2]
Answer = tuple[int, dict[str, object]]


class Web:
    """A client that asks for JSON."""

    def __init__(self, session: aiohttp.ClientSession, base: str) -> None:
        self._session = session
        self._base = base

    async def get(self, path: str) -> Answer:
        """Status and body of an answer."""
        async with self._session.get(f"{self._base}{path}") as answer:
            assert answer.content_type == "application/json"
            assert "Traceback" not in await answer.text()
            return answer.status, await answer.json()

    async def refused(self, path: str) -> tuple[int, str, str]:
        """Status, code and message of a refusal."""
        status, body = await self.get(path)
        assert body.keys() == {"code", "message"}
        return status, str(body["code"]), str(body["message"])


@asynccontextmanager
async def asking(bus: Bus, robots: list[Robot]) -> AsyncIterator[Web]:
    """Open the doors and ask them."""
    async with door(bus, robots) as url, aiohttp.ClientSession() as session:
        yield Web(session, url.replace("ws://", "http://").removesuffix("/ws"))


async def test_robots_are_told_together_and_alone() -> None:
    async with asking(*cell("r1", "r2")) as web:
        status, body = await web.get("/api/v1/robots")
        told = msgspec.convert(body["robots"], list[RobotInfo])
        assert (status, [robot.name for robot in told]) == (200, ["r1", "r2"])
        assert (await web.get("/api/v1/robots/r2"))[1] == msgspec.convert(body["robots"], list[object])[1]


async def test_a_topic_gives_its_latest_sample_and_the_fields_that_were_asked_for() -> None:
    bus, robots = cell("r1")
    publish(bus, "r1/joints", 4)
    async with asking(bus, robots) as web:
        _, body = await web.get("/api/v1/topics/r1/joints")
        assert (body["topic"], body["seq"], body["q"]) == ("r1/joints", 4, "GOOD")
        _, cut = await web.get("/api/v1/topics/r1/joints?fields=position")
        assert cut["data"] == {"position": [4.0, None]}
        _, same = await web.get("/api/v1/topics/r1%2Fjoints")
        assert same == body


async def test_a_topic_is_encoded_once_however_often_it_is_read() -> None:
    bus, robots = cell("r1")
    reading = publish(bus, "r1/joints", 4)
    async with asking(bus, robots) as web:
        for _ in range(3):
            await web.get("/api/v1/topics/r1/joints")
    assert reading.asked == 1


async def test_events_are_read_back_page_by_page_from_several_rings() -> None:
    bus, robots = cell("r1", "r2", command_ring=100)
    names = []
    for number in range(10):
        raise_event(bus, "r1")
        names.append(bus.events.last_name)
        names.append(raise_command(bus, "r2", number))
    read: list[object] = []
    since = ""
    async with asking(bus, robots) as web:
        for _ in range(7):
            _, body = await web.get(f"/api/v1/events?limit=3{since}")
            events = msgspec.convert(body["events"], list[dict[str, object]])
            assert len(events) <= 3
            assert body["missed"] == 0
            read += [event["name"] for event in events]
            since = f"&since={body['next']}"
        assert (await web.get(f"/api/v1/events?x{since}"))[0] == 400
        assert (await web.get(f"/api/v1/events?{since[1:]}"))[1]["events"] == []
    assert sorted(map(str, read)) == sorted(names)
    assert [name for name in read if str(name).startswith(BOOT)] == [f"{BOOT}:{seq}" for seq in range(1, 11)]


async def test_events_tell_how_many_are_gone_and_where_to_read_on() -> None:
    bus, robots = cell("r1", ring=3)
    for _ in range(10):
        raise_event(bus, "r1")
    async with asking(bus, robots) as web:
        _, body = await web.get(f"/api/v1/events?since={BOOT}:2&topics=r1/events")
        assert (body["missed"], body["next"]) == (5, f"{BOOT}:10")
        _, body = await web.get("/api/v1/events?since=before:2&topics=r1/events")
        assert body["missed"] is None
        _, body = await web.get("/api/v1/events?limit=1&topics=r1/events")
        assert (body["missed"], body["next"]) == (0, f"{BOOT}:8")


async def test_the_end_of_a_page_stands_before_what_was_not_read_of_another_ring() -> None:
    bus, robots = cell("r1", command_ring=2)
    for number in range(5):
        raise_command(bus, "r1", number, t=10**18)
    raise_event(bus, "r1")
    async with asking(bus, robots) as web:
        _, body = await web.get("/api/v1/events?limit=1&topics=r1/*")
        assert msgspec.convert(body["events"], list[dict[str, object]])[0]["kind"] == "motion.started"
        _, body = await web.get(f"/api/v1/events?topics=r1/*&since={body['next']}")
        assert (len(msgspec.convert(body["events"], list[object])), body["missed"]) == (2, 0)
        assert str(body["next"]).endswith(last_name(bus, "r1/commands"))


async def test_every_group_and_every_topic_has_a_schema() -> None:
    async with asking(*cell("r1")) as web:
        _, body = await web.get("/api/v1/schema")
        told = msgspec.convert(body, rest.SchemaList)
        assert set(told.groups) == set(GROUPS)
        for group in told.groups.values():
            jsonschema.Draft202012Validator.check_schema(group.schema)
        _, body = await web.get("/api/v1/schema/r1/joints")
        assert msgspec.convert(body, Description).sources["position"].units == ["deg"]


@pytest.mark.parametrize(
    ("path", "status", "code", "says"),
    [
        ("/api/v1/robots/r9", 404, "UNKNOWN_ROBOT", "there are: r1, r2"),
        ("/api/v1/robots?x=1", 400, "BAD_REQUEST", "unknown: x; this address takes none"),
        ("/api/v1/topics/r1/jonts", 404, "UNKNOWN_TOPIC", 'did you mean "r1/joints"?'),
        ("/api/v1/topics/*/joints", 404, "UNKNOWN_TOPIC", "*/joints"),
        ("/api/v1/topics/" + "x" * 4000, 404, "UNKNOWN_TOPIC", "no topic"),
        ("/api/v1/topics/..%2f..%2fetc%2fpasswd", 404, "UNKNOWN_TOPIC", "no topic"),
        ("/api/v1/topics/%ff%00", 404, "UNKNOWN_TOPIC", "no topic"),
        ("/api/v1/topics/r1/joints", 503, "NOT_YET", "nothing has come of r1/joints yet"),
        ("/api/v1/topics/r1/events", 400, "BAD_REQUEST", "/api/v1/events?topics=r1/events"),
        ("/api/v1/topics/r1/link?fields=stat", 400, "UNKNOWN_FIELD", "state"),
        ("/api/v1/topics/r1/link?fields=" + "x" * 300, 400, "TOO_MUCH", "256"),
        ("/api/v1/topics/r1/link?field=state", 400, "BAD_REQUEST", "unknown: field; allowed are fields"),
        ("/api/v1/topics/r1/link?fields=state&fields=t", 400, "BAD_REQUEST", "more than once: fields"),
        ("/api/v1/events?limit=0", 400, "BAD_REQUEST", "limit"),
        ("/api/v1/events?limit=10001", 400, "BAD_REQUEST", "10000"),
        ("/api/v1/events?limit=many", 400, "BAD_REQUEST", "limit"),
        ("/api/v1/events?since=zzz", 400, "BAD_REQUEST", "boot:seq"),
        ("/api/v1/events?since=", 400, "BAD_REQUEST", "boot:seq"),
        (f"/api/v1/events?since={BOOT}:1,{BOOT}:2", 400, "BAD_REQUEST", "more than once"),
        ("/api/v1/events?since=" + ",".join(["a:1"] * 300), 400, "BAD_REQUEST", "256"),
        ("/api/v1/events?topics=zzz", 404, "UNKNOWN_TOPIC", "zzz"),
        ("/api/v1/events?topics=" + "x" * 300, 400, "TOO_MUCH", "256"),
        ("/api/v1/events?last=1", 400, "BAD_REQUEST", "allowed are since, limit, topics"),
        ("/api/v1/schema/r1/zzz", 404, "UNKNOWN_TOPIC", "zzz"),
        ("/api/v1/schema?x", 400, "BAD_REQUEST", "unknown: x"),
        ("/api/v1/zzz", 404, "NOT_FOUND", "/api/v1/openapi.json"),
    ],
)
async def test_what_cannot_be_answered_says_why_and_what_to_do(path: str, status: int, code: str, says: str) -> None:
    async with asking(*cell("r1", "r2")) as web:
        found = await web.refused(path)
        assert found[:2] == (status, code)
        assert says in found[2]


class BrokenReading(CountingReading):
    """A reading that fails in a way that nobody expects."""

    def sample(self, topic: Topic) -> Sample:
        """Fail."""
        raise RuntimeError(topic.name)

    def broken(self, topic: Topic, error: Exception) -> Sample:
        """Fail again."""
        raise RuntimeError(topic.name) from error


async def test_an_internal_error_costs_its_request_and_shows_no_traceback() -> None:
    bus, robots = cell("r1", "r2")
    good = publish(bus, "r2/joints", 1)
    bus.topics["r1/joints"].latest = BrokenReading(good.sample(bus.topics["r2/joints"]))
    async with asking(bus, robots) as web:
        assert (await web.refused("/api/v1/topics/r1/joints"))[:2] == (500, "INTERNAL_SERVER_ERROR")
        assert (await web.get("/api/v1/topics/r2/joints"))[0] == 200


def test_the_document_in_docs_is_current() -> None:
    path = ROOT / "docs" / "openapi.json"
    assert path.read_text("utf-8") == openapi_text(), "docs/openapi.json is not current: run `make generated`"


async def test_the_document_names_every_address_and_is_served() -> None:
    routed = {re.sub(r":[^}]*", "", path) for path in _ROUTES} - {"/ws", "/foxglove"}
    assert routed == {address.path for address in ADDRESSES}
    async with asking(*cell("r1")) as web:
        assert (await web.get("/api/v1/openapi.json"))[1] == openapi.openapi()


def test_every_address_stands_on_the_page() -> None:
    page = (ROOT / "docs" / "http.md").read_text("utf-8")
    for path in _ROUTES:
        assert re.sub(r"{topic[^}]*}", "r1/joints", path).replace("{name}", "r1") + "`" in page, path


async def test_the_answers_are_what_the_document_says() -> None:
    bus, robots = cell("r1")
    publish(bus, "r1/joints", 1)
    raise_event(bus, "r1")
    made = openapi.openapi()
    components = {"components": made["components"]}
    async with asking(bus, robots) as web:
        for address in ADDRESSES:
            path = address.path.replace("{name}", "r1").replace("{topic}", "r1/joints")
            if address.body is not None:
                _, body = await web.get(path)
                jsonschema.validate(body, {"$ref": f"#/components/schemas/{address.body.__name__}", **components})
            if not address.path.endswith("}"):
                parameters = {one.name for one in address.parameters if one.where == "query"}
                _, _, message = await web.refused(f"{path}?zzz=1")
                assert set(re.findall(r"\w+", message.partition("allowed are")[2])) == parameters
