"""docs/operations.md against the source: every log event, metric and port stands there, and nothing that is not."""

from __future__ import annotations

import ast
import re
import shutil
import subprocess
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

import anyio
import pytest

from gateway.api.messages import RecorderInfo
from gateway.core.registry import Registry
from gateway.server.cell import Cell
from gateway.server.health import Pulse
from gateway.server.metrics import Scrapes
from gateway.server.traffic import Traffic
from tests.server.kit import cell

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs" / "operations.md").read_text("utf-8")
PAGES = ("README.md", "SECURITY.md", "CONTRIBUTING.md", "docs/operations.md", "docs/security.md")
# What a method of a log is called, and the level that its lines have.
LEVELS = {name: name for name in ("debug", "info", "warning", "error", "critical")} | {"exception": "error"}
_EVENT = re.compile(r"\| `([a-z_]+\.[a-z_]+)` \| ([a-z, ]+) \|")
_PROMTOOL = pytest.mark.skipif(
    shutil.which("promtool") is None, reason="promtool is not installed: apt-get install prometheus"
)


def is_log(node: ast.expr) -> bool:
    """Whether an expression is a log: `_LOG`, `log`, `self._log`, or one of them with values bound."""
    match node:
        case ast.Name(id=name) | ast.Attribute(attr=name):
            return name.lower().endswith("log")
        case ast.Call(func=ast.Attribute(value=value, attr="bind")):
            return is_log(value)
        case _:
            return False


def logged(source: str) -> Iterator[tuple[str, str]]:
    """Event and level of each line that a source may log."""
    for node in ast.walk(ast.parse(source)):
        match node:
            case ast.Call(func=ast.Attribute(value=value, attr=method)) if method in LEVELS and is_log(value):
                match node.args:
                    case [ast.Constant(value=str(event)), *_]:
                        yield event, LEVELS[method]
                    case _:
                        raise AssertionError(f"a log event that is no literal: {ast.unparse(node)}")
            case _:
                pass


def section(heading: str) -> str:
    """The text below a heading, to the next one of any level."""
    _, _, rest = PAGE.partition(f"{heading}\n")
    return re.split(r"^#+ ", rest, maxsplit=1, flags=re.MULTILINE)[0]


def blocks(language: str) -> list[str]:
    """The code blocks of a language."""
    return re.findall(rf"^```{language}\n(.*?)^```", PAGE, re.DOTALL | re.MULTILINE)


def test_every_log_event_stands_on_the_page_with_its_levels_and_no_other() -> None:
    events: dict[str, set[str]] = defaultdict(set)
    for path in sorted((ROOT / "gateway").rglob("*.py")):
        for event, level in logged(path.read_text("utf-8")):
            events[event].add(level)
    rows = _EVENT.findall(section("### Every event"))
    assert {event: set(levels.split(", ")) for event, levels in rows} == events
    assert len(rows) == len(events), "an event stands there twice"


def test_the_collector_sees_a_log_behind_every_name_that_the_house_uses() -> None:
    source = "_LOG.info('a.b')\nself._log.bind(x=1).exception('c.d')\nlog.debug('e.f')\nparser.error('no event')\n"
    assert list(logged(source)) == [("a.b", "info"), ("c.d", "error"), ("e.f", "debug")]


def test_every_metric_stands_on_the_page_and_no_other() -> None:
    bus, robots = cell("r1")
    doors = {door: Traffic() for door in ("native", "foxglove", "sse")}
    shown = Cell(robots, bus, recorder=RecorderInfo)
    families = Scrapes(delivered=lambda: doors, pulse=Pulse(), refused={}).registry(shown).collect()
    metrics = {f"{family.name}_total" if family.type == "counter" else family.name for family in families}
    assert set(re.findall(r"robot_gateway_[a-z_]+", PAGE)) == metrics


def test_every_protocol_stands_in_the_table_of_the_firewall_with_its_ports() -> None:
    rows = [row for row in section("## Firewall").splitlines() if row.startswith("| ")]
    registry = Registry()
    for name in registry.names():
        for protocol in registry.vendor(name).protocols:
            of_protocol = [row for row in rows if row.startswith(f"| {name} `{protocol.name}`")]
            assert of_protocol, f"{name} {protocol.name} has no row"
            for transport, port in (("TCP", protocol.port), ("UDP", protocol.udp_port)):
                assert port is None or any(f"{transport} {port} |" in row for row in of_protocol), (name, port)


@_PROMTOOL
@pytest.mark.parametrize(
    ("first", "command"),
    [("groups:", ("check", "rules")), ("scrape_configs:", ("check", "config", "--syntax-only"))],
    ids=["alerts", "scrape"],
)
async def test_prometheus_takes_what_the_page_shows(first: str, command: tuple[str, ...], tmp_path: Path) -> None:
    (block,) = (block for block in blocks("yaml") if block.startswith(first))
    file = tmp_path / "shown.yml"
    file.write_text(block, "utf-8")
    checked = await anyio.to_thread.run_sync(
        lambda: subprocess.run(["promtool", *command, file], capture_output=True, text=True, check=False)  # noqa: S603, S607
    )
    assert checked.returncode == 0, checked.stdout + checked.stderr


@pytest.mark.parametrize("page", PAGES)
def test_every_link_leads_somewhere(page: str) -> None:
    text = (ROOT / page).read_text("utf-8")
    for target in re.findall(r"\]\((?!https?:)([^)]+)\)", text):
        name, _, anchor = target.partition("#")
        file = (ROOT / page).parent / name if name else ROOT / page
        assert file.exists(), f"{page}: {target}"
        if anchor:
            assert anchor in anchors(file), f"{page}: {target}"


def anchors(file: Path) -> set[str]:
    """The anchors of a page's headings, as GitHub makes them."""
    headings = re.findall(r"^#+ (.+)$", file.read_text("utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("page", ["CONTRIBUTING.md", "docs/security.md"])
def test_every_test_that_a_page_names_is_there(page: str) -> None:
    named = re.findall(r"`(tests/[\w/.]+)`", (ROOT / page).read_text("utf-8"))
    assert named
    assert [path for path in named if not (ROOT / path).exists()] == []
