"""A token that may read some topics: by no door and no request does it learn of the others."""

from __future__ import annotations

import json

import aiohttp
import pytest

from gateway.api.messages import JSON_SUBPROTOCOL
from gateway.core.bus import Bus
from gateway.server.cell import Cell
from gateway.server.foxglove import SUBPROTOCOLS
from tests.server.kit import BOOT, Message, Robot, cell, publish, raise_command, raise_event
from tests.server.tokens import ABSENT, ALL, HIDDEN, R1, Browser, bearer, browsing, doors, guarded, token

JOINTS = "rgw_" + "joints-0__" * 4 + "abc"


def busy_cell() -> tuple[Bus, list[Robot]]:
    """Two robots of which everything is told."""
    bus, robots = cell(HIDDEN, "r1", command_ring=10)
    for robot in ("r1", HIDDEN):
        publish(bus, f"{robot}/joints", 1)
        raise_event(bus, robot)
        raise_command(bus, robot)
    return bus, robots


PATHS = [
    "/api/v1/robots",
    "/api/v1/robots/NAME",
    "/api/v1/topics/NAME/joints",
    "/api/v1/topics/NAME/joints?fields=position",
    "/api/v1/topics/NAME/events",
    "/api/v1/topics/NAME/zzz",
    "/api/v1/events",
    "/api/v1/events?topics=*",
    "/api/v1/events?topics=NAME/*",
    "/api/v1/events?topics=*/events,NAME/commands",
    f"/api/v1/events?since={BOOT}:0",
    "/api/v1/schema",
    "/api/v1/schema/NAME/joints",
    "/api/v1/schema/NAME/vendor",
    "/api/v1/stream?topics=*",
    "/api/v1/stream?topics=*&mode=all",
    "/api/v1/stream?topics=NAME/*",
    "/api/v1/stream?topics=*/joints&fields=NAME",
    f"/api/v1/stream?topics=*/events&since={BOOT}:0",
    "/api/v1/openapi.json",
    "/metrics",
    "/readyz",
    "/healthz",
]


def alike(answers: list[str]) -> bool:
    """Whether what is said of a hidden robot and of one that is not there differs in the name only."""
    hidden, absent = answers
    return hidden.replace(HIDDEN, ABSENT) == absent


@pytest.mark.parametrize("path", PATHS)
async def test_over_http_a_hidden_robot_is_as_if_it_did_not_exist(path: str) -> None:
    async with doors(*busy_cell()) as listener, browsing(listener.port) as browser:
        everything = await browser.get(path.replace("NAME", HIDDEN), ALL)
        answers = [await browser.get(path.replace("NAME", name), R1) for name in (HIDDEN, ABSENT)]
        head = await browser.get(path.replace("NAME", HIDDEN), R1, method="HEAD")
    assert answers[0].status == answers[1].status == head.status
    if "NAME" in path:
        assert alike([answer.text for answer in answers])
        assert answers[0].status in {400, 404} or HIDDEN not in answers[0].text
    else:
        assert everything.status == answers[0].status == 200
        assert HIDDEN not in answers[0].text


async def test_the_stream_that_comes_back_with_its_last_id_gets_its_own_events_alone() -> None:
    async with doors(*busy_cell()) as listener, browsing(listener.port) as browser:
        headers = {**bearer(R1), "Last-Event-ID": f"{BOOT}:0"}
        async with browser.session.get(f"{browser.base}/api/v1/stream?topics=*", headers=headers) as stream:
            text = b""
            while text.count(b"event: event") < 2:
                text += await stream.content.readany()
    assert HIDDEN not in text.decode()


async def asked(browser: Browser, secret: str, requests: list[Message], bus: Bus) -> list[Message]:
    """What a native client hears of some requests and of what happens after them."""
    heard: list[Message] = []
    async with browser.websocket("/ws", JSON_SUBPROTOCOL, headers=bearer(secret)) as socket:
        for number, request in enumerate(requests):
            await socket.send_json({"id": number, **request})
        await socket.send_json({"op": "ping", "id": "settled"})
        while not heard or heard[-1].get("id") != "settled":
            heard.append(await socket.receive_json())
        for robot in (HIDDEN, "r1"):
            publish(bus, f"{robot}/joints", 7)
            raise_event(bus, robot)
            raise_command(bus, robot)
        await socket.send_json({"op": "ping", "id": "end"})
        while heard[-1].get("id") != "end":
            heard.append(await socket.receive_json())
    return heard


REQUESTS: list[Message] = [
    {"op": "subscribe", "topics": ["*"]},
    {"op": "subscribe", "topics": ["*/joints", "NAME/status"], "mode": "all"},
    {"op": "subscribe", "topics": ["NAME/*"]},
    {"op": "subscribe", "topics": ["NAME/joint"]},
    {"op": "subscribe", "topics": ["*/events"], "since": f"{BOOT}:0"},
    {"op": "subscribe", "topics": ["*/joints"], "fields": ["NAME"]},
    {"op": "get", "topics": ["*"]},
    {"op": "get", "topics": ["NAME/joints"]},
    {"op": "events"},
    {"op": "events", "topics": ["NAME/events"]},
    {"op": "events", "since": f"{BOOT}:0", "topics": ["*"]},
    {"op": "robots"},
    {"op": "describe", "topic": "NAME/joints"},
    {"op": "describe", "topic": "NAME/vendor"},
    {"op": "unsubscribe"},
    {"op": "ping"},
]


@pytest.mark.parametrize("request_", REQUESTS, ids=lambda request: f"{request['op']} {request.get('topics', '')}")
async def test_on_the_native_door_a_hidden_robot_is_as_if_it_did_not_exist(request_: Message) -> None:
    refused = []
    for name in (HIDDEN, ABSENT):
        bus, robots = busy_cell()
        asking = json.loads(json.dumps(request_).replace("NAME", name))
        async with doors(bus, robots) as listener, browsing(listener.port) as browser:
            heard = await asked(browser, R1, [asking], bus)
        assert HIDDEN not in json.dumps([one for one in heard if one["op"] != "error"])
        refused.append(json.dumps([one for one in heard if one["op"] == "error"]))
    assert alike(refused)
    assert HIDDEN not in refused[0] or "NAME" in json.dumps(request_)


async def test_the_foxglove_door_offers_and_names_nothing_hidden() -> None:
    bus, robots = busy_cell()
    async with doors(bus, robots) as listener, browsing(listener.port) as browser:
        for path in ("/foxglove", "/foxglove?topics=*", f"/foxglove?topics={ABSENT}/*", "/"):
            heard = ""
            async with browser.websocket(path, SUBPROTOCOLS[0], headers=bearer(R1)) as socket:
                await socket.send_json({"op": "getParameters", "parameterNames": [], "id": "1"})
                channels = range(1, 60)
                await socket.send_json(
                    {"op": "subscribe", "subscriptions": [{"id": n, "channelId": n} for n in channels]}
                )
                for robot in (HIDDEN, "r1"):
                    publish(bus, f"{robot}/joints", 7)
                    raise_event(bus, robot)
                while '"op":"status"' not in heard:
                    heard += str((await socket.receive()).data)
            assert HIDDEN not in heard, path


async def test_who_may_read_one_group_sees_of_a_robot_that_group_and_whether_its_link_is_there() -> None:
    settings = guarded(token("joints", JOINTS, "*/joints"))
    async with doors(*busy_cell(), settings) as listener, browsing(listener.port) as browser:
        answer = await browser.get("/api/v1/robots", JOINTS)
        missing = await browser.get("/api/v1/topics/r1/link", JOINTS)
        hint = await browser.get("/api/v1/topics/r1/link_stat", JOINTS)
    robots = json.loads(answer.text)["robots"]
    assert [(robot["name"], robot["groups"], robot["link"]["peer"]) for robot in robots] == [
        (HIDDEN, ["joints"], ""),
        ("r1", ["joints"], ""),
    ]
    assert missing.status == hint.status == 404
    assert "link_stats" not in hint.text


def test_topics_that_come_later_are_seen_if_they_may_be_seen() -> None:
    bus, robots = cell("r1", "r2")
    whole = Cell(robots, bus)
    view = whole.limited(["r1/*"])
    assert set(view.robots) == {"r1"}
    bus.add("r1", ["tcp"])
    bus.add("r2", ["tcp"])
    assert "r1/tcp" in view.topics
    assert "r2/tcp" not in view.topics
    assert [topic.name for topic in view.match(["*/tcp"])] == ["r1/tcp"]


async def test_a_token_for_everything_reads_everything() -> None:
    async with doors(*busy_cell()) as listener, browsing(listener.port) as browser:
        assert HIDDEN in (await browser.get("/metrics", ALL)).text
        async with browser.websocket("/ws", headers=bearer(ALL)) as socket:
            assert (await socket.receive_json())["robots"] == [HIDDEN, "r1"]
        async with browser.websocket("/ws", headers=bearer(R1)) as socket:
            welcome = await socket.receive_json()
            assert (welcome["robots"], welcome["access"]) == (["r1"], "tokens")
            await socket.close()
            assert socket.close_code == aiohttp.WSCloseCode.OK


async def test_a_scope_follows_the_robots_that_come_and_go() -> None:
    bus, robots = cell("r1", HIDDEN)
    whole = Cell(robots, bus)
    seen = whole.limited(["r*/joints"])
    assert (list(seen.robots), list(seen.topics)) == (["r1"], ["r1/joints"])
    _, others = cell("r2")
    bus.add("r2", ["joints", "link"])
    assert list(seen.topics) == ["r1/joints", "r2/joints"]
    whole.replace([*robots, others[0]])
    assert list(seen.robots) == ["r1", "r2"]
    bus.remove(bus.of("r1"))
    assert list(seen.topics) == ["r2/joints"]
