"""What Prometheus reads."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import aiohttp
import anyio
import pytest
from prometheus_client import CollectorRegistry, Metric
from prometheus_client.parser import text_string_to_metric_families

from gateway.api.model import Link, LinkState, LinkStats
from gateway.core.bus import Bus
from gateway.server.cell import Cell
from gateway.server.health import Pulse
from gateway.server.metrics import MOST_REASONS, OTHER_REASONS, Scrapes
from gateway.server.traffic import Traffic
from tests.server.kit import Now, Robot, T, cell, publish, raise_event, running_door, talking

PAGE = (Path(__file__).parents[2] / "docs" / "http.md").read_text("utf-8")
STATS = LinkStats(
    frames=100,
    skipped=2,
    rejects={"checksum": 3, "size": 1},
    gaps=4,
    sessions=5,
    n_bytes=6000,
    age=0.008,
    decode_time=0.00004,
)


def told(bus: Bus, stats: LinkStats = STATS) -> None:
    publish(bus, "r1/link_stats", 1, stats)


def address(url: str) -> str:
    return url.replace("ws://", "http://").replace("/ws", "/metrics")


async def scraped(url: str, accept: str = "") -> str:
    async with aiohttp.ClientSession() as session, session.get(address(url), headers={"Accept": accept}) as answer:
        assert answer.status == 200
        return await answer.text()


def values(text: str) -> dict[str, float]:
    """Every series without the labels that all series of a robot have."""
    found = {}
    for family in text_string_to_metric_families(text):
        for sample in family.samples:
            labels = {key: value for key, value in sample.labels.items() if key not in {"vendor", "protocol"}}
            rest = [labels.pop("robot")] if "robot" in labels else []
            rest += labels.values()
            found[" ".join([sample.name.removeprefix("robot_gateway_"), *rest])] = sample.value
    return found


async def test_a_scrape_tells_what_the_links_have_counted() -> None:
    bus, robots = cell("r1", "r2")
    told(bus)
    raise_event(bus, "r1")
    async with running_door(bus, robots) as url:
        text = await scraped(url)
    found = values(text)
    for name, value in {
        "frames_total r1": 100,
        "skipped_frames_total r1": 2,
        "rejects_total r1 checksum": 3,
        "rejects_total r1 size": 1,
        "gaps_total r1": 4,
        "sessions_total r1": 5,
        "received_bytes_total r1": 6000,
        "last_frame_age_seconds r1": 0.008,
        "decode_time_seconds r1": 0.00004,
        "frames_total r2": 0,
        "events_total": 1,
    }.items():
        assert found[name] == pytest.approx(value), name
    assert 'robot_gateway_frames_total{protocol="polled",robot="r1",vendor="toy"} 100.0' in text


async def test_what_is_not_known_has_no_series_rather_than_a_zero() -> None:
    bus, robots = cell("r1")
    told(bus, LinkStats(frames=1))
    async with running_door(bus, robots) as url:
        found = values(await scraped(url))
    assert not {"gaps_total r1", "last_frame_age_seconds r1", "clock_offset_seconds r1"} & found.keys()


async def test_the_state_of_a_link_is_one_of_all() -> None:
    bus, robots = cell("r1")
    publish(bus, "r1/link", 2, Link(state=LinkState.STALE, since=T, protocol="polled", peer="x"))
    async with running_door(bus, robots) as url:
        found = values(await scraped(url))
    assert {state: found[f"link_state r1 {state}"] for state in LinkState} == {
        state: float(state is LinkState.STALE) for state in LinkState
    }


async def test_subscribers_and_what_they_got_are_told_by_door() -> None:
    bus, robots = cell("r1")
    async with running_door(bus, robots) as url, talking(url) as talk, aiohttp.ClientSession() as session:
        await talk.ask("subscribe", topics=["r1/joints"])
        stream = address(url).replace("/metrics", "/api/v1/stream?topics=r1/joints,r1/link")
        async with session.get(stream) as lines:
            await lines.content.readuntil(b"data: ")
            for seq in range(3):
                publish(bus, "r1/joints", seq)
            await talk.samples()
            await lines.content.readuntil(b"event: missed")
            found = values(await scraped(url))
        assert (found["subscribers native"], found["subscribers sse"], found["subscribers foxglove"]) == (1, 1, 0)
        assert found["subscribed_topics r1"] == 2
        assert found["missed_samples_total sse"] == 2
        assert found["sent_bytes_total sse"] > 100
        assert found["sent_bytes_total native"] > 100
        assert "clients_sent_away_total native" not in found
        await talk.ask("unsubscribe")
        with anyio.fail_after(5):
            while values(await scraped(url))["subscribed_topics r1"]:  # noqa: ASYNC110 - until the stream is gone
                await anyio.sleep(0.05)


async def test_the_lag_of_the_loop_is_a_histogram() -> None:
    now = Now()
    pulse = Pulse(now)
    for lag_s in (0.0, 0.0, 0.3, 9.0):
        now.at_s += 0.1 + lag_s
        pulse.beat()
    (lag,) = (family for family in collected(*cell("r1"), pulse) if family.name.endswith("loop_lag_seconds"))
    found = {sample.labels.get("le", sample.name.rpartition("_")[2]): sample.value for sample in lag.samples}
    assert [found["0.005"], found["0.25"], found["0.5"], found["+Inf"], found["count"]] == [2, 2, 3, 4, 4]
    assert found["sum"] == pytest.approx(9.3)


def registry_of(bus: Bus, robots: list[Robot], pulse: Pulse | None = None) -> CollectorRegistry:
    scrapes = Scrapes(delivered=lambda: {"sse": Traffic()}, pulse=pulse or Pulse(), refused={})
    return scrapes.registry(Cell(robots, bus))


def collected(bus: Bus, robots: list[Robot], pulse: Pulse | None = None) -> list[Metric]:
    return list(registry_of(bus, robots, pulse).collect())


def test_a_plugin_that_invents_reasons_gets_a_bounded_number_of_series_that_never_fall() -> None:
    bus, robots = cell("r1")
    registry = registry_of(bus, robots)
    seen: dict[str, float] = {}
    for round_ in range(1, 4):
        reasons = {f"reason {number}": round_ for number in range(20 * round_)}
        told(bus, LinkStats(rejects={**reasons, "x" * 500: round_}))
        (rejects,) = (family for family in registry.collect() if family.name.endswith("_rejects"))
        found = {sample.labels["reason"]: sample.value for sample in rejects.samples}
        assert len(found) <= MOST_REASONS + 1
        assert all(len(reason) <= 64 for reason in found)
        assert all(found[reason] >= value for reason, value in seen.items())
        assert sum(found.values()) == round_ * (20 * round_ + 1)
        seen = found
    assert seen[OTHER_REASONS] == 3 * (61 - MOST_REASONS)


def test_the_number_of_series_is_what_the_page_says() -> None:
    bus, robots = cell(*(f"r{number}" for number in range(16)))
    rejects = {f"reason {number}": 1 for number in range(99)}
    for robot in robots:
        stats = LinkStats(rejects=rejects, gaps=1, age=1.0, decode_time=1.0, clock_offset=1.0)
        publish(bus, f"{robot.name}/link_stats", 1, stats)
    traffic = {door: Traffic() for door in ("native", "foxglove", "sse")}
    registry = Scrapes(delivered=lambda: traffic, pulse=Pulse(), refused={}).registry(Cell(robots, bus))
    assert sum(len(family.samples) for family in registry.collect()) == 16 * 43 + 28


def test_every_metric_stands_on_the_page() -> None:
    bus, robots = cell("r1")
    told(bus)
    for family in collected(bus, robots):
        name = family.name.removeprefix("robot_gateway_") + ("_total" if family.type == "counter" else "")
        assert f"`{name}`" in PAGE


def test_two_gateways_in_one_process_share_nothing() -> None:
    one, other = cell("r1"), cell("r1")
    told(one[0])
    names = {sample.name: sample.value for family in collected(*other) for sample in family.samples}
    assert names["robot_gateway_frames_total"] == 0


async def test_openmetrics_is_given_to_those_who_ask_for_it() -> None:
    bus, robots = cell("r1")
    async with running_door(bus, robots) as url:
        assert (await scraped(url, "application/openmetrics-text; version=1.0.0")).endswith("# EOF\n")
        assert "# EOF" not in await scraped(url, "*/*")


@pytest.mark.skipif(shutil.which("promtool") is None, reason="promtool is not installed: apt-get install prometheus")
async def test_promtool_finds_nothing_to_say() -> None:
    bus, robots = cell("r1", "r2")
    told(bus)
    async with running_door(bus, robots) as url:
        text = await scraped(url)
    checked = await anyio.to_thread.run_sync(
        lambda: subprocess.run(
            ["promtool", "check", "metrics"],  # noqa: S607 - where it stands differs by distribution
            input=text,
            capture_output=True,
            text=True,
            check=False,
        )
    )
    assert (checked.returncode, checked.stdout, checked.stderr) == (0, "", "")
