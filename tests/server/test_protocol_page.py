"""`docs/protocol.md`: its messages are those of the structs, and its Python example runs."""

from __future__ import annotations

import re
import sys
from collections import Counter
from pathlib import Path
from typing import get_args, get_type_hints

import anyio
import msgspec
import pytest

from gateway.api.messages import Error, Request, Response
from gateway.core.bus import Bus
from gateway.server.outbox import QUEUED_EVENTS, QUEUED_SAMPLES
from gateway.server.requests import _MAX_NAME
from tests.server.kit import cell, publish, running_door

PAGE = (Path(__file__).parents[2] / "docs" / "protocol.md").read_text("utf-8")
OBJECTS = [msgspec.json.decode(text) for text in re.findall(r"```json\n(.*?)```", PAGE, re.DOTALL)]
MESSAGES = [found for found in OBJECTS if "op" in found]
REQUESTS = {struct.__struct_config__.tag: struct for struct in get_args(Request)}
RESPONSES = {struct.__struct_config__.tag: struct for struct in get_args(Response)}


@pytest.mark.parametrize("message", MESSAGES, ids=lambda message: message["op"])
def test_every_message_of_the_page_is_one_of_the_protocol(message: dict[str, object]) -> None:
    struct = {**REQUESTS, **RESPONSES}[message["op"]]
    made = msgspec.convert(message, struct)
    assert unknown_keys(message, msgspec.to_builtins(made)) == []


def unknown_keys(shown: object, understood: object) -> list[str]:
    """The keys of an object that the structs did not take."""
    if isinstance(shown, dict) and isinstance(understood, dict):
        lost = [key for key in shown if key not in understood and shown[key] not in (None, {}, [])]
        return lost + [name for key in shown if key in understood for name in unknown_keys(shown[key], understood[key])]
    if isinstance(shown, list) and isinstance(understood, list):
        return [name for pair in zip(shown, understood, strict=True) for name in unknown_keys(*pair)]
    return []


def test_the_page_shows_every_message_and_every_key_of_a_request() -> None:
    shown = Counter(message["op"] for message in MESSAGES)
    assert set(shown) == set(REQUESTS) | set(RESPONSES)
    for op, struct in REQUESTS.items():
        (message,) = [message for message in MESSAGES if message["op"] == op]
        assert set(message) == {"op", *(field.encode_name for field in msgspec.structs.fields(struct))}


def test_every_code_and_limit_stands_on_the_page() -> None:
    (meta,) = get_type_hints(Error, include_extras=True)["code"].__metadata__
    codes = re.findall(r"[A-Z]+_[A-Z]+", meta.description)
    assert len(codes) == 5
    assert all(f"| `{code}` |" in PAGE for code in codes)
    assert all(f"{number}" in PAGE for number in (QUEUED_EVENTS, QUEUED_SAMPLES, _MAX_NAME))


async def keep_publishing(bus: Bus) -> None:
    """A robot that moves."""
    seq = 0
    while True:
        seq += 1
        publish(bus, "r1/joints", seq)
        await anyio.sleep(0.01)


async def test_the_python_example_runs(tmp_path: Path) -> None:
    (example,) = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
    lines = [line for line in example.splitlines() if line]
    assert len(lines) <= 10
    script = tmp_path / "example.py"
    script.write_text(example, "utf-8")
    bus, robots = cell("r1")
    async with running_door(bus, robots) as url, anyio.create_task_group() as tasks:
        tasks.start_soon(keep_publishing, bus)
        async with await anyio.open_process([sys.executable, str(script), url], stderr=None) as process:
            assert process.stdout is not None
            printed = b""
            with anyio.fail_after(10):
                while printed.count(b"\n") < 3:
                    printed += await process.stdout.receive()
            process.terminate()
        tasks.cancel_scope.cancel()
    assert re.match(rb"r1/joints GOOD \[\d+\.0, None\]\n", printed)
