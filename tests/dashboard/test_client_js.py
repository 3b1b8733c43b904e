"""The JavaScript client: its example runs as documented, it resumes events, and it says what was refused."""

from __future__ import annotations

import re
import shutil
from pathlib import Path
from subprocess import DEVNULL, PIPE, STDOUT
from typing import cast

import anyio
import pytest

from gateway.api.model import EventKind
from gateway.server import pages
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


def raise_events(cell: HandMade, count: int) -> None:
    """Raise some events."""
    for number in range(count):
        cell.raise_event("r1", EventKind.MODE_CHANGED, number, number + 1)
