"""The AsyncAPI document: it is one, and every message that a running gateway sends and takes is as it says."""

from __future__ import annotations

import copy
import json
from pathlib import Path
from typing import cast

import aiohttp
import anyio
import pytest
from jsonschema import Draft7Validator, Draft202012Validator

from gateway.api.model import GROUPS
from gateway.testing.cell import virtual_cell
from tests.asyncapi import REQUESTS, RESPONSES, Schema, asyncapi
from tests.server.kit import Message, Talk

_META = Path(__file__).parent / "schemas" / "asyncapi-3.0.0.json"
_ALL = {str(struct.__struct_config__.tag) for struct in (*REQUESTS, *RESPONSES)}


def test_the_document_is_valid_asyncapi() -> None:
    problems = list(Draft7Validator(json.loads(_META.read_text("utf-8"))).iter_errors(asyncapi()))
    assert [f"{list(one.absolute_path)}: {one.message[:200]}" for one in problems] == []


def test_the_schema_of_asyncapi_would_notice() -> None:
    validator = Draft7Validator(json.loads(_META.read_text("utf-8")))
    broken: list[Schema] = [copy.deepcopy(asyncapi()) for _ in range(3)]
    del broken[0]["info"]
    cast("dict[str, Schema]", broken[1]["operations"])["push"]["action"] = "shout"
    cast("dict[str, Schema]", broken[2]["channels"])["native"]["address"] = 7
    assert not any(validator.is_valid(one) for one in broken)


def closed(schema: object) -> object:
    """A copy in which no object has keys that the schema does not name: nothing is sent that is not described."""
    if isinstance(schema, list):
        return [closed(one) for one in schema]
    if not isinstance(schema, dict):
        return schema
    found = {key: closed(one) for key, one in schema.items()}
    if found.get("type") == "object" and "properties" in found:
        found.setdefault("additionalProperties", False)
    return found


class Judge:
    """Holds messages against the document; what it has seen it remembers."""

    def __init__(self) -> None:
        document = cast("dict[str, object]", closed(asyncapi()))
        self._components = {"components": document["components"]}
        self.seen: set[str] = set()

    def hold(self, message: Message) -> Message:
        """A message of either side."""
        op = str(message["op"])
        self.seen.add(op)
        self._check(message, f"#/components/messages/{op}/payload")
        samples = message.get("samples")
        for sample in samples if isinstance(samples, list) else ():
            struct = GROUPS[sample["topic"].rpartition("/")[2]].struct
            if struct is not None:
                self._check(sample["data"], f"#/components/schemas/{struct.__name__}")
        return message

    def _check(self, value: object, reference: str) -> None:
        errors = list(Draft202012Validator({"$ref": reference, **self._components}).iter_errors(value))
        assert [f"{list(one.absolute_path)}: {one.message[:300]}" for one in errors] == []


async def ask(judge: Judge, talk: Talk, op: str, **values: object) -> Message:
    """Send a request and hold it and everything up to its answer against the document."""
    request: Message = {"op": op, "id": 7, **values}
    await talk.send(judge.hold(request))
    while True:
        message = judge.hold(await talk.receive())
        if message["op"] in {"result", "error"}:
            return message


@pytest.mark.parametrize("vendor", ["rainbow", "fairino"])
async def test_every_message_of_a_running_gateway_is_as_it_says(vendor: str) -> None:
    judge = Judge()
    async with (
        virtual_cell(vendor, scenario="pause") as cell,
        aiohttp.ClientSession() as session,
        session.ws_connect(cell.url) as socket,
    ):
        talk = Talk(socket)
        judge.hold(await talk.receive())
        with anyio.fail_after(5):
            while cell.gateway.bus.events.last_seq == 0:  # noqa: ASYNC110 - the bus has no event for it
                await anyio.sleep(0.01)
        assert (await ask(judge, talk, "subscribe", topics=["*/joints", "r1/events"], since="b0:1"))["op"] == "result"
        for op in ("robots", "ping"):
            assert (await ask(judge, talk, op))["op"] == "result"
        assert (await ask(judge, talk, "get", topics=["*"]))["op"] == "result"
        assert (await ask(judge, talk, "events", since=["b0:1"], limit=5))["op"] == "result"
        for topic in ("r1/joints", "r1/vendor", "r1/link_stats"):
            assert (await ask(judge, talk, "describe", topic=topic))["op"] == "result"
        while not judge.seen >= {"data", "event", "missed"}:
            judge.hold(await talk.receive())
        assert (await ask(judge, talk, "unsubscribe"))["op"] == "result"
        assert (await ask(judge, talk, "get", topics=["nobody/joints"]))["op"] == "error"
    assert judge.seen == _ALL
