"""The JavaScript client: its example runs as documented, it resumes events, and it says what was refused."""

from __future__ import annotations

import dataclasses
import re
import shutil
from pathlib import Path
from subprocess import DEVNULL, PIPE, STDOUT
from typing import cast

import anyio
import pytest

from gateway.api.model import EventKind
from gateway.server import pages
from gateway.testing.cell import virtual_cell
from tests.client.secured import ONLY_R1, asking
from tests.dashboard.browser import browsing, needs_chromium, open_page, page_url
from tests.dashboard.kit import HandMade, doors

ROOT = Path(__file__).parents[2]
NODE = shutil.which("node")
pytestmark = pytest.mark.limit(60)
_PATIENCE_S = 20
_URL = "ws://127.0.0.1:8765/ws"
_EVENTS = """async (url) => {
  const { connect } = await import('./client.js');
  const gateway = window.gateway = connect(url);
  window.names = [];
  window.missed = [];
  window.states = [];
  gateway.onstate = (state) => states.push(state);
  await new Promise((onTopics) => {
    gateway.subscribe(['*/events'], {
      onEvent: (event) => names.push(event.name), onMissed: ({ events }) => missed.push(events), onTopics,
    });
  });
}"""
_TWO = """async (url) => {
  const { connect } = await import('./client.js');
  const gateway = window.gateway = connect(url);
  window.all = [];
  window.one = [];
  const listening = (topics, onEvent) => new Promise((onTopics) => {
    gateway.subscribe(topics, { onEvent, onTopics });
  });
  await listening(['*/events'], () => { throw new Error('of the handler'); });
  await listening(['*/events'], (event) => all.push(event.name));
  await listening(['r2/events'], (event) => one.push(event.name));
}"""
_LET_IN = """async ([url, token, wrong]) => {
  const { connect } = await import('./client.js');
  const gateway = window.gateway = connect(url, { token });
  const names = (await gateway.robots()).map((robot) => robot.name);
  let said;
  try { connect(url, { token: wrong }); } catch (error) { said = `${error.code}: ${error.message}`; }
  return [names, gateway.welcome.access, gateway._socket.protocol, said];
}"""
_GLOBS = """async (url) => {
  const { connect } = await import('./client.js');
  const gateway = window.gateway = connect(url);
  window.kinds = [];
  window.topics = new Set();
  await new Promise((onTopics) => {
    gateway.subscribe(['*/event[s]'], { onEvent: (event) => kinds.push(event.kind) });
    gateway.subscribe(['r?/join*', '[z-a]/x'], { onSample: (sample) => topics.add(sample.topic), onTopics });
  });
}"""
_REFUSED = """async (url) => {
  const { connect } = await import('./client.js');
  const gateway = connect(url);
  const refused = new Promise((resolve) => { gateway.onerror = (error) => resolve(error.code); });
  gateway.subscribe(['r1/jiont'], {});
  const codes = [await refused];
  for (const ask of [() => gateway.describe('r9/joints'), () => gateway.ask('nonsense'), () => gateway.get(['*'])]) {
    codes.push(await ask().then((found) => found.length, (error) => error.code));
  }
  const late = gateway.robots().catch((error) => error.code);
  gateway.close();
  return [...codes, await late, await gateway.robots().catch((error) => error.code), gateway.state];
}"""


def example() -> str:
    """The example of the documentation."""
    found = re.search(r"```js\n(.*?)```", (ROOT / "docs" / "client-js.md").read_text(), re.DOTALL)
    assert found is not None
    return found[1]


def test_the_example_has_about_ten_lines() -> None:
    assert len(example().splitlines()) <= 12


@pytest.mark.skipif(NODE is None, reason="node is missing: apt-get install nodejs, and this test runs")
async def test_the_example_runs_in_node(tmp_path: Path) -> None:
    shutil.copy(pages.FOLDER / "client.js", tmp_path / "client.js")
    (tmp_path / "package.json").write_text('{"type": "module"}')
    cell = HandMade("r1")
    cell.work("r1", turn=0.5)
    async with doors(cell) as url:
        (tmp_path / "example.js").write_text(example().replace(_URL, url))
        command = [cast("str", NODE), "--no-warnings", "--experimental-websocket", "example.js"]
        with anyio.fail_after(_PATIENCE_S):
            done = await anyio.run_process(
                command, cwd=tmp_path, stdin=DEVNULL, stdout=PIPE, stderr=STDOUT, check=False
            )
    said = done.stdout.decode()
    if "bad option" in said:
        pytest.skip("this node has no WebSocket")
    assert (done.returncode, said) == (0, "r1 ONLINE\nr1/joints GOOD [ 0.5, -0.5, null ]\n")


@needs_chromium
async def test_a_page_reads_events_on_where_they_stopped_each_once() -> None:
    cell = HandMade("r1")
    async with browsing() as context:
        async with doors(cell) as url:
            port = int(url.rsplit(":", 1)[1].split("/")[0])
            watched = await open_page(context, f"{page_url(url)}icon.svg")
            await watched.page.goto(f"{page_url(url)}client.js")  # a page of the same origin without the dashboard
            await watched.page.evaluate(_EVENTS, url)
            raise_events(cell, 3)
            await watched.until("names.length === 3")
        raise_events(cell, 1500)  # more than the ring holds
        async with doors(cell, port):
            await watched.until("names.length === 1003")
            await watched.until("missed.length > 0")
            names = await watched.page.evaluate("names")
            assert await watched.page.evaluate("missed") == [500]
            assert names == [f"b00t:{number}" for number in (1, 2, 3, *range(504, 1504))]
            states = cast("list[str]", await watched.page.evaluate("states"))
            assert states[0] == "live"
            assert {"lost", "connecting"} <= set(states)
            assert states[-1] == "live"
            await watched.page.close()


@needs_chromium
async def test_what_the_gateway_refuses_has_its_code() -> None:
    cell = HandMade("r1")
    cell.work("r1")
    async with doors(cell) as url, browsing() as context:
        watched = await open_page(context, f"{page_url(url)}client.js")
        found = await watched.page.evaluate(_REFUSED, url)
        assert found == ["UNKNOWN_TOPIC", "UNKNOWN_TOPIC", "BAD_MESSAGE", 7, "CLOSED", "CLOSED", "closed"]


@needs_chromium
async def test_each_subscription_reads_on_by_itself_and_a_handler_that_fails_costs_no_other_message() -> None:
    cell = HandMade("r1", "r2")
    async with browsing() as context:
        async with doors(cell) as url:
            port = int(url.rsplit(":", 1)[1].split("/")[0])
            watched = await open_page(context, f"{page_url(url)}icon.svg")
            await watched.page.goto(f"{page_url(url)}client.js")
            await watched.page.evaluate(_TWO, url)
            raise_events(cell, 2)
            cell.raise_event("r2", EventKind.MODE_CHANGED, 0, 1)
            await watched.until("all.length === 3 && one.length === 1")
        cell.raise_event("r2", EventKind.MODE_CHANGED, 1, 2)
        raise_events(cell, 1)
        async with doors(cell, port):
            await watched.until("all.length === 5 && one.length === 2")
            cell.raise_event("r2", EventKind.MODE_CHANGED, 2, 3)
            await watched.until("all.length === 6 && one.length === 3")
            assert await watched.page.evaluate("all") == [f"b00t:{number}" for number in range(1, 7)]
            assert await watched.page.evaluate("one") == ["b00t:3", "b00t:4", "b00t:6"]
            thrown = [complaint for complaint in watched.complaints if "exception: " in complaint]
            assert thrown == ["exception: of the handler"] * 6
            await watched.page.close()


@needs_chromium
async def test_a_token_is_said_as_a_subprotocol_and_stands_in_no_address_and_no_error() -> None:
    async with doors(HandMade("r1", "r2"), settings=asking()) as url, browsing() as context:
        watched = await open_page(context, f"{page_url(url)}client.js")
        asked: list[str] = []
        watched.page.on("websocket", lambda socket: asked.append(socket.url))
        told = await watched.page.evaluate(_LET_IN, [url, ONLY_R1, "no token"])
        assert told == [
            ["r1"],
            "tokens",
            "robot-gateway.v1+json",
            "BAD_TOKEN: the token is empty or has characters that no token has",
        ]
        assert asked == [url]
        assert ONLY_R1 not in await watched.page.evaluate("JSON.stringify({ ...gateway, _socket: null })")


@needs_chromium
async def test_a_robot_that_is_added_belongs_to_the_globs_that_match_it() -> None:
    async with virtual_cell("rainbow", count=2) as cell, browsing() as context:
        whole = cell.gateway.config
        await cell.gateway.reload(dataclasses.replace(whole, robots=whole.robots[:1]))
        watched = await open_page(context, f"{page_url(cell.url)}client.js")
        await watched.page.evaluate(_GLOBS, cell.url)
        await cell.gateway.reload(whole)
        await watched.until("kinds.includes('robot.added') && topics.has('r2/joints')")
        assert await watched.page.evaluate("[...topics].some((topic) => !/^r[12].joints$/.test(topic))") is False


def raise_events(cell: HandMade, count: int) -> None:
    """Raise some events."""
    for number in range(count):
        cell.raise_event("r1", EventKind.MODE_CHANGED, number, number + 1)
