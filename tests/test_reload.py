"""A gateway takes another configuration while it runs: with virtual controllers, over its real doors."""

from __future__ import annotations

from collections.abc import AsyncIterator, Mapping
from contextlib import AsyncExitStack, asynccontextmanager
from typing import cast

import anyio
import pytest

from gateway.app import Gateway, running
from gateway.config import Config, parse
from gateway.config.printing import toml_value
from gateway.core.registry import Registry
from gateway.server.listener import ListenError
from gateway.sim.server import VirtualController, serve
from gateway.sim.simulator import Simulator
from tests.server.kit import Talk, talking

REGISTRY = Registry()
PUSHED = {"vendor": "fairino", "protocol": "cnde"}
KEPT = {"vendor": "fairino", "protocol": "legacy"}


def config(*robots: dict[str, object], listen: str = "127.0.0.1:0", **server: object) -> Config:
    """A configuration of some robots."""
    text = "[server]\n" + "".join(
        f"{key} = {toml_value(value)}\n" for key, value in {"listen": listen, **server}.items()
    )
    for robot in robots:
        text += "\n[[robots]]\n" + "".join(f"{key} = {toml_value(value)}\n" for key, value in robot.items())
    return parse(text, "test", REGISTRY)


@asynccontextmanager
async def controllers(host: str, count: int) -> AsyncIterator[tuple[VirtualController, ...]]:
    """Virtual controllers that push."""
    simulator = cast("Simulator", REGISTRY.simulator("fairino"))
    async with serve(simulator, host=host, port=0, count=count, scenario="steady") as found:
        yield found


def entry(
    name: str, controller: VirtualController, kind: Mapping[str, str] = PUSHED, **more: object
) -> dict[str, object]:
    """The entry of a robot."""
    port = controller.number_of(kind["protocol"], "tcp")
    return {"name": name, **kind, "host": controller.host, "port": port, **more}


async def until_online(gateway: Gateway, *names: str) -> None:
    """Wait until some robots are online."""
    with anyio.fail_after(10):
        while not set(names) <= {info.name for info in gateway.infos() if info.link.state == "ONLINE"}:  # noqa: ASYNC110
            await anyio.sleep(0.02)


def link_of(gateway: Gateway, name: str) -> tuple[str, str | None, list[str]]:
    """State, reason and notes of a link."""
    link = {info.name: info.link for info in gateway.infos()}[name]
    return link.state.value, link.reason, link.notes


class Heard:
    """Everything that a subscriber is told, in order, as lines `topic quality` and `robot kind`."""

    def __init__(self, talk: Talk) -> None:
        self._talk = talk
        self.samples: dict[str, dict[str, object]] = {}
        self._lines: list[str] = []

    async def until(self, line: str) -> dict[str, object]:
        """Read until a line comes that was not asked for yet; the newest sample of its topic."""
        with anyio.fail_after(8):
            while line not in self._lines:
                message = await self._talk.receive()
                samples = message["samples"] if message["op"] == "data" else []
                for sample in cast("list[dict[str, object]]", samples):
                    self.samples[str(sample["topic"])] = sample
                    self._lines.append(f"{sample['topic']} {sample['q']}")
                for event in cast("list[dict[str, object]]", message["events"] if message["op"] == "event" else []):
                    self._lines.append(f"{event['robot']} {event['kind']}")
        del self._lines[: self._lines.index(line) + 1]
        return self.samples.get(line.split(maxsplit=1)[0], {})


def epoch_of(gateway: Gateway, name: str) -> str:
    """The epoch of the newest sample of a robot."""
    topic = gateway.bus.topics[f"{name}/joints"]
    assert topic.latest is not None
    return topic.latest.sample(topic).epoch


async def test_an_added_robot_comes_to_whoever_asked_for_its_kind_of_topic() -> None:
    async with controllers("127.0.40.1", 2) as (one, two), running(config(entry("r1", one))) as gateway:
        await until_online(gateway, "r1")
        async with talking(gateway.url) as talk:
            await talk.ask("subscribe", topics=["*/joints", "*/status", "*/link", "*/events"])
            plan = await gateway.reload(config(entry("r1", one), entry("r2", two)))
            assert ([robot.name for robot in plan.added], plan.unchanged) == (["r2"], 1)
            heard = Heard(talk)
            await heard.until("r2 robot.added")
            await heard.until("r2/joints DISCONNECTED")
            await heard.until("r2/joints GOOD")
            robots = (await talk.ask("robots"))["robots"]
            assert [robot["name"] for robot in cast("list[dict[str, object]]", robots)] == ["r1", "r2"]
        async with talking(gateway.url) as late:
            assert "r2/joints" in cast("list[str]", (await late.ask("subscribe", topics=["r2/*"]))["topics"])


async def test_a_removed_robot_says_so_and_its_topics_go_and_come_back_with_it() -> None:
    async with controllers("127.0.41.1", 2) as (one, two):
        both = config(entry("r1", one), entry("r2", two))
        async with running(both) as gateway:
            await until_online(gateway, "r1", "r2")
            async with talking(gateway.url) as talk:
                await talk.ask("subscribe", topics=["r2/joints", "r2/link", "r2/events"])
                await gateway.reload(config(entry("r1", one)))
                heard = Heard(talk)
                await heard.until("r2 robot.removed")
                await heard.until("r2/joints DISCONNECTED")
                assert heard.samples["r2/link"]["data"]["reason"] == "removed from the configuration"  # type: ignore[index]
                assert not [name for name in gateway.bus.topics if name.startswith("r2/")]
                assert (await talk.ask("describe", topic="r2/joints"))["code"] == "UNKNOWN_TOPIC"
                await gateway.reload(both)
                await heard.until("r2/joints GOOD")


async def test_a_changed_robot_keeps_its_topics_and_rings_in_a_new_epoch() -> None:
    async with controllers("127.0.42.1", 2) as (one, two), running(config(entry("r1", one))) as gateway:
        await until_online(gateway, "r1")
        before, ring = gateway.bus.topics["r1/joints"], gateway.bus.events.boot
        async with talking(gateway.url) as talk:
            await talk.ask("subscribe", topics=["r1/joints", "r1/events"])
            heard = Heard(talk)
            first = await heard.until("r1/joints GOOD")
            plan = await gateway.reload(config(entry("r1", two)))
            assert [change.key for change in plan.changed[0].keys] == ["host", "port"]
            await heard.until("r1 robot.changed")
            again = await heard.until("r1/joints GOOD")
            assert again["epoch"] != first["epoch"]
        assert gateway.bus.topics["r1/joints"] is before
        assert gateway.bus.events.boot == ring


async def test_another_protocol_takes_the_groups_away_that_it_does_not_have() -> None:
    async with controllers("127.0.43.1", 1) as (one,), running(config(entry("r1", one))) as gateway:
        await until_online(gateway, "r1")
        had = {name for name in gateway.bus.topics if name.startswith("r1/")}
        await gateway.reload(config(entry("r1", one, {"vendor": "fairino", "protocol": "status"})))
        await until_online(gateway, "r1")
        has = {name for name in gateway.bus.topics if name.startswith("r1/")}
        assert {info.name: info.protocol for info in gateway.infos()} == {"r1": "status"}
        assert {f"r1/{group}" for group in gateway.infos()[0].groups} == has
        assert "r1/joints" in had & has


async def test_a_session_that_must_not_be_dropped_is_held_back_and_the_rest_is_applied() -> None:
    async with AsyncExitStack() as stack:
        one, two, three = await stack.enter_async_context(controllers("127.0.44.1", 3))
        gateway = await stack.enter_async_context(running(config(entry("r1", one, KEPT), entry("r2", two))))
        await until_online(gateway, "r1", "r2")
        asked = config(entry("r1", one, KEPT, stale_s=3.0), entry("r3", three))
        plan = await gateway.reload(asked, check=True)
        assert {info.name for info in gateway.infos()} == {"r1", "r2"}
        assert [(held.name, held.what) for held in plan.held] == [("r1", "changed")]
        assert "reload --drop r1" in plan.held[0].reason
        epoch = epoch_of(gateway, "r1")
        await gateway.reload(asked)
        await until_online(gateway, "r1", "r3")
        assert "reload --drop r1" in link_of(gateway, "r1")[2][0]
        assert epoch_of(gateway, "r1") == epoch
        again = await gateway.reload(asked)
        assert ([held.name for held in again.held], again.unchanged) == (["r1"], 1)
        dropped = await gateway.reload(asked, drop=["r1"])
        assert [robot.name for robot in dropped.changed] == ["r1"]
        await until_online(gateway, "r1")
        assert link_of(gateway, "r1") == ("ONLINE", None, [])
        assert (await gateway.reload(asked)).unchanged == 2


async def test_what_waits_for_a_session_is_applied_when_that_ends_by_itself() -> None:
    async with controllers("127.0.45.1", 2) as (one, other), running(config(entry("r1", one, KEPT))) as gateway:
        await until_online(gateway, "r1")
        plan = await gateway.reload(config(entry("cell2", one, KEPT), entry("r3", other)))
        assert [(held.name, held.what) for held in plan.held] == [("r1", "removed"), ("cell2", "added")]
        assert {info.name for info in gateway.infos()} == {"r1", "r3"}
        await one.stop()
        with anyio.fail_after(5):
            while {info.name for info in gateway.infos()} != {"cell2", "r3"}:  # noqa: ASYNC110
                await anyio.sleep(0.02)


async def test_an_address_that_is_taken_changes_nothing() -> None:
    async with controllers("127.0.47.1", 1) as (one,), running(config()) as other, running(config()) as gateway:
        taken = f"127.0.0.1:{other.port}"
        with pytest.raises(ListenError, match="in use"):
            await gateway.reload(config(entry("r1", one), listen=taken))
        assert gateway.infos() == []
        async with talking(gateway.url) as talk:
            assert (await talk.ask("ping"))["op"] == "result"


async def test_another_address_opens_and_clients_of_the_old_one_are_told_1012() -> None:
    async with running(config()) as gateway, talking(gateway.url) as talk:
        async with anyio.create_task_group() as tasks:
            tasks.start_soon(talk.close_code)
            await gateway.reload(config(listen="127.0.0.2:0"))
        assert talk.socket.close_code == 1012
        async with talking(gateway.url) as again:
            assert (await again.ask("ping"))["op"] == "result"


async def test_a_client_stays_where_its_address_is_one_of_the_new_ones() -> None:
    async with running(config()) as gateway, talking(gateway.url) as talk:
        await gateway.reload(config(listen=f"0.0.0.0:{gateway.port}", insecure=True))
        assert (await talk.ask("ping"))["op"] == "result"
        async with talking(f"ws://127.0.0.1:{gateway.port}/ws") as again:
            assert (await again.ask("ping"))["op"] == "result"


async def test_rings_and_flush_time_change_at_once() -> None:
    async with running(config()) as gateway, talking(gateway.url) as talk:
        plan = await gateway.reload(config(flush_ms=7.0, event_ring=5))
        assert {one.key: one.after for one in plan.doors} == {"flush_ms": "7.0", "event_ring": "5"}
        assert gateway.bus.events.capacity == 5
        assert (await talk.ask("ping"))["op"] == "result"
        assert (await gateway.reload(config(flush_ms=7.0, event_ring=5))).doors == []
