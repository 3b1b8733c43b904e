"""docs/client.md: its example runs against a gateway, and what it lists is there."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import anyio

import gateway.client
from gateway.testing.cell import virtual_cell
from tests.cli.command import ROOT, environment

_PAGE = (ROOT / "docs" / "client.md").read_text("utf-8")


async def test_the_example_prints_connection_event_and_joints(tmp_path: Path) -> None:
    (example,) = re.findall(r"```python\n(.*?)```", _PAGE, re.DOTALL)
    path = tmp_path / "example.py"
    path.write_text(example, "utf-8")
    said = ""
    async with (
        virtual_cell("rainbow", scenario="pause") as cell,
        await anyio.open_process([sys.executable, str(path), cell.url], env=environment(), cwd=tmp_path) as process,
    ):
        assert process.stdout is not None
        with anyio.fail_after(15):
            while not ("r1/joints GOOD [" in said and "Event(" in said):
                said += (await process.stdout.receive()).decode()
        process.terminate()
    assert said.startswith("Connected(")


def test_it_has_as_many_lines_as_it_says() -> None:
    (example,) = re.findall(r"```python\n(.*?)```", _PAGE, re.DOTALL)
    body = [line for line in example.splitlines() if line.strip() and not line.startswith(("import", "from"))]
    assert len(body) <= 11


def test_every_item_that_may_come_is_told() -> None:
    rows = re.findall(r"^\| `(\w+)` \|", _PAGE, re.MULTILINE)
    assert rows == ["Sample", "Event", "Missed", "Connected", "Disconnected", "Refused"]
    assert {"Connected", "Disconnected", "Refused", "follow", "connect"} <= set(gateway.client.__all__)
