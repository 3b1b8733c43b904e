"""The native door over real sockets."""

from __future__ import annotations

import contextlib
import math
import time
import tracemalloc
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack

import aiohttp
import anyio
import anyio.lowlevel
import msgspec
import pytest
import websockets
from websockets.asyncio.client import ClientConnection
from websockets.asyncio.client import connect as foreign_connect

from gateway.api import messages
from gateway.api.messages import JSON_SUBPROTOCOL, MSGPACK_SUBPROTOCOL
from gateway.api.model import EventKind, Joints, Link, LinkState, Quality, Sample
from gateway.core.bus import Bus, Topic
from gateway.server.cell import Cell
from gateway.server.outbox import QUEUED_EVENTS, Outbox
from gateway.server.requests import Requests
from gateway.server.wire import JSON
from tests.server.kit import (
    BOOT,
    CountingReading,
    Robot,
    T,
    Talk,
    cell,
    last_name,
    publish,
    publish_status,
    raise_command,
    raise_event,
    running_door,
    talking,
)

both = pytest.mark.parametrize("protocol", [JSON_SUBPROTOCOL, MSGPACK_SUBPROTOCOL])


async def other_is_served(bus: Bus, other: Talk, seq: int) -> None:
    """Another client gets what is published now."""
    publish(bus, "r2/joints", seq)
    assert [sample["seq"] for sample in await other.samples()] == [seq]


@both
async def test_every_request_is_answered_in_either_encoding(protocol: str) -> None:
    bus, robots = cell("r1", "r2")
    publish(bus, "r1/joints", 3)
    raise_event(bus, "r1")
    async with running_door(bus, robots) as url, talking(url, protocol) as talk:
        assert await talk.ask("ping", id="x") | {"t": 0} == {"op": "result", "id": "x", "t": 0}
        subscribed = await talk.ask("subscribe", topics=["*/joints"], rate_hz=100.0, fields=["position"])
        assert subscribed == {"op": "result", "id": 7, "topics": ["r1/joints", "r2/joints"]}
        assert [sample["data"] for sample in await talk.samples()] == [{"position": [3.0, None]}]
        assert await talk.ask("unsubscribe") == {"op": "result", "id": 7}
        (sample,) = msgspec.convert((await talk.ask("get", topics=["r1/joints"]))["samples"], list[dict[str, object]])
        assert (sample["topic"], sample["seq"], sample["q"]) == ("r1/joints", 3, "GOOD")
        told = msgspec.convert((await talk.ask("robots"))["robots"], list[messages.RobotInfo])
        assert [(robot.name, robot.link.state) for robot in told] == [("r1", "ONLINE"), ("r2", "ONLINE")]
        described = msgspec.convert(
            (await talk.ask("describe", topic="r1/joints"))["description"], messages.Description
        )
        assert described.sources["position"].units == ["deg"]
        events = await talk.ask("events", since=f"{BOOT}:0", limit=5)
        assert msgspec.convert(events["events"], list[dict[str, object]])[0]["name"] == f"{BOOT}:1"
        assert events["missed"] == 0


async def test_the_welcome_names_versions_robots_and_limits() -> None:
    bus, robots = cell("r1", "r2")
    raise_event(bus, "r1")
    async with (
        running_door(bus, robots) as url,
        aiohttp.ClientSession() as session,
        session.ws_connect(url) as socket,
    ):
        welcome = msgspec.json.decode((await socket.receive()).data, type=messages.Welcome)
    assert welcome.protocol == 1
    assert welcome.robots == ["r1", "r2"]
    assert welcome.last_event == f"{BOOT}:1"
    assert welcome.limits.message_bytes == 65_536
    assert welcome.limits.subscriptions == 64


async def test_live_samples_states_and_events_arrive() -> None:
    bus, robots = cell("r1")
    async with running_door(bus, robots) as url, talking(url) as talk:
        await talk.ask("subscribe", topics=["r1/*"])
        await talk.samples()
        for seq in (1, 2):
            publish(bus, "r1/joints", seq)
            assert [sample["seq"] for sample in await talk.samples()] == [seq]
        publish_status(bus, "r1/status", 1, in_motion=True)
        assert [sample["topic"] for sample in await talk.samples()] == ["r1/status"]
        raise_event(bus, "r1")
        (event,) = msgspec.convert((await talk.receive("event"))["events"], list[dict[str, object]])
        assert (event["kind"], event["from"], event["to"]) == ("motion.started", "STANDSTILL", "MOVING")


async def test_mode_all_over_a_socket_has_no_hole() -> None:
    bus, robots = cell("r1")
    async with running_door(bus, robots) as url, talking(url) as talk:
        await talk.ask("subscribe", topics=["r1/joints"], mode="all")
        for seq in range(1, 501):
            publish(bus, "r1/joints", seq)
            if seq % 50 == 0:
                await anyio.lowlevel.checkpoint()
        seqs: list[object] = []
        while len(seqs) < 500:
            seqs += [sample["seq"] for sample in await talk.samples()]
        assert seqs == list(range(1, 501))


async def test_a_subscription_reads_on_after_a_named_event() -> None:
    bus, robots = cell("r1")
    for _ in range(4):
        raise_event(bus, "r1")
    async with running_door(bus, robots) as url, talking(url) as talk:
        await talk.ask("subscribe", topics=["*/events"], since=f"{BOOT}:2")
        events = msgspec.convert((await talk.receive("event"))["events"], list[dict[str, object]])
        assert [event["seq"] for event in events] == [3, 4]
        await talk.ask("subscribe", topics=["*/events"], since="before:1")
        assert (await talk.receive("missed"))["events"] is None


WRONG = [
    ({"op": "zzz", "id": 7}, "BAD_MESSAGE", "zzz"),
    ({"op": "ping"}, "BAD_MESSAGE", "id"),
    ({"id": 7}, "BAD_MESSAGE", "op"),
    ({"op": "ping", "id": None}, "BAD_MESSAGE", "id"),
    ({"op": "ping", "id": True}, "BAD_MESSAGE", "id"),
    ({"op": "ping", "id": 7, "zzz": 1}, "BAD_MESSAGE", "zzz"),
    ({"op": "subscribe", "id": 7}, "BAD_MESSAGE", "topics"),
    ({"op": "subscribe", "id": 7, "topics": "r1/joints"}, "BAD_MESSAGE", "topics"),
    ({"op": "subscribe", "id": 7, "topics": []}, "BAD_MESSAGE", "topics"),
    ({"op": "subscribe", "id": 7, "topics": [1]}, "BAD_MESSAGE", "topics"),
    ({"op": "subscribe", "id": 7, "topics": ["r1/jonts"]}, "UNKNOWN_TOPIC", 'did you mean "r1/joints"?'),
    ({"op": "subscribe", "id": 7, "topics": ["x" * 257]}, "TOO_MUCH", "256"),
    ({"op": "subscribe", "id": 7, "topics": ["*/joints"], "fields": ["positio"]}, "UNKNOWN_FIELD", "positio"),
    ({"op": "subscribe", "id": 7, "topics": ["*/joints"], "fields": ["position.9.x"]}, "UNKNOWN_FIELD", '"position"?'),
    ({"op": "subscribe", "id": 7, "topics": ["r1/vendor"], "fields": ["word.movin"]}, "UNKNOWN_FIELD", "word.moving"),
    ({"op": "subscribe", "id": 7, "topics": ["*/joints"], "fields": []}, "BAD_MESSAGE", "fields"),
    ({"op": "subscribe", "id": 7, "topics": ["*/joints"], "fields": ["x" * 257]}, "TOO_MUCH", "256"),
    ({"op": "subscribe", "id": 7, "topics": ["*/joints"], "rate_hz": 0}, "BAD_MESSAGE", "rate_hz"),
    ({"op": "subscribe", "id": 7, "topics": ["*/joints"], "rate_hz": -1}, "BAD_MESSAGE", "rate_hz"),
    ({"op": "subscribe", "id": 7, "topics": ["*/joints"], "rate_hz": 1e9}, "BAD_MESSAGE", "rate_hz"),
    ({"op": "subscribe", "id": 7, "topics": ["*/joints"], "rate_hz": "5"}, "BAD_MESSAGE", "rate_hz"),
    ({"op": "subscribe", "id": 7, "topics": ["*/joints"], "mode": "some"}, "BAD_MESSAGE", "mode"),
    ({"op": "subscribe", "id": 7, "topics": ["*/joints"], "mode": "all", "rate_hz": 5}, "BAD_REQUEST", "rate_hz"),
    ({"op": "subscribe", "id": 7, "topics": ["*/events"], "since": "x"}, "BAD_REQUEST", "boot:seq"),
    ({"op": "subscribe", "id": 7, "topics": ["*/events"], "since": []}, "BAD_MESSAGE", "since"),
    ({"op": "subscribe", "id": 7, "topics": ["*/events"], "since": [1]}, "BAD_MESSAGE", "since"),
    ({"op": "subscribe", "id": 7, "topics": ["*/events"], "since": ["a:1", "b"]}, "BAD_REQUEST", "boot:seq"),
    ({"op": "subscribe", "id": 7, "topics": ["*/events"], "since": ["a:1", "a:2"]}, "BAD_REQUEST", "more than once"),
    ({"op": "events", "id": 7, "since": ["a:1", "a:2"]}, "BAD_REQUEST", "more than once"),
    ({"op": "unsubscribe", "id": 8}, "BAD_REQUEST", "no subscription 8"),
    ({"op": "get", "id": 7, "topics": ["r3/*"]}, "UNKNOWN_TOPIC", "r3/*"),
    ({"op": "describe", "id": 7, "topic": "r1/joint"}, "UNKNOWN_TOPIC", "r1/joints"),
    ({"op": "describe", "id": 7, "topic": "x" * 60_000}, "TOO_MUCH", "256"),
    ({"op": "events", "id": 7, "limit": 0}, "BAD_MESSAGE", "limit"),
    ({"op": "events", "id": 7, "since": "a:b"}, "BAD_REQUEST", "boot:seq"),
    ([], "BAD_MESSAGE", "array"),
    (None, "BAD_MESSAGE", "Expected `object`"),
]


@both
@pytest.mark.parametrize(("request_", "code", "says"), WRONG)
async def test_a_wrong_request_is_an_error_with_its_id_and_nothing_else(
    protocol: str, request_: object, code: str, says: str
) -> None:
    bus, robots = cell("r1", "r2")
    async with running_door(bus, robots) as url, talking(url, protocol) as talk, talking(url) as other:
        await other.ask("subscribe", topics=["r2/joints"])
        await talk.send(request_)
        error = await talk.receive()
        assert error["op"] == "error"
        assert error["code"] == code
        assert says in str(error["message"])
        name = request_.get("id") if isinstance(request_, dict) else None
        assert error["id"] == (None if name is True else name)
        assert bus.topics["r1/joints"].listeners == []
        assert (await talk.ask("ping"))["op"] == "result"
        await other_is_served(bus, other, 1)


@pytest.mark.parametrize("rate_hz", [math.nan, math.inf, -math.inf])
async def test_msgpack_cannot_smuggle_in_a_rate_that_is_no_number(rate_hz: float) -> None:
    bus, robots = cell()
    async with running_door(bus, robots) as url, talking(url, MSGPACK_SUBPROTOCOL) as talk:
        error = await talk.ask("subscribe", topics=["*/joints"], rate_hz=rate_hz)
        assert (error["op"], error["code"]) == ("error", "BAD_MESSAGE")


@pytest.mark.parametrize(
    "text", ["{", "", "[" * 5000, '{"op":"ping","id":1}}', '{"op":"ping","id":' + "9" * 5000 + "}", "\0", "nul", "ä"]
)
async def test_malformed_json_is_an_error(text: str) -> None:
    bus, robots = cell()
    async with running_door(bus, robots) as url, talking(url) as talk:
        await talk.socket.send_str(text)
        assert (await talk.receive())["code"] == "BAD_MESSAGE"
        assert (await talk.ask("ping"))["op"] == "result"


@pytest.mark.parametrize("data", [b"", b"\xc1", b"\x81", b"\x91" * 5000, b"\xdf\xff\xff\xff\xff", b"\x82\xa2op"])
async def test_malformed_msgpack_is_an_error(data: bytes) -> None:
    bus, robots = cell()
    async with running_door(bus, robots) as url, talking(url, MSGPACK_SUBPROTOCOL) as talk:
        await talk.socket.send_bytes(data)
        assert (await talk.receive())["code"] == "BAD_MESSAGE"
        assert (await talk.ask("ping"))["op"] == "result"


async def test_a_frame_of_the_other_kind_is_an_error() -> None:
    bus, robots = cell()
    async with running_door(bus, robots) as url:
        async with talking(url) as talk:
            await talk.socket.send_bytes(b'{"op":"ping","id":1}')
            assert await talk.receive() == {
                "op": "error",
                "id": 1,
                "code": "BAD_MESSAGE",
                "message": "robot-gateway.v1+json takes text frames",
            }
        async with talking(url, MSGPACK_SUBPROTOCOL) as talk:
            await talk.socket.send_str("x")
            assert (await talk.receive())["message"] == "robot-gateway.v1+msgpack takes binary frames"


@pytest.mark.parametrize("filler", ["x", "€"])
async def test_a_message_over_64_kib_is_refused_by_its_bytes(filler: str) -> None:
    bus, robots = cell()
    size = len(filler.encode())
    async with running_door(bus, robots) as url, talking(url) as talk:
        await talk.socket.send_str(filler * (65_536 // size + 1))
        assert (await talk.receive())["code"] == "TOO_MUCH"
        await talk.socket.send_str('{"op":"ping","id":1' + " " * (65_536 - 20) + "}")
        assert (await talk.receive())["op"] == "result"


@both
async def test_a_message_over_64_kib_is_refused_under_its_id(protocol: str) -> None:
    bus, robots = cell()
    async with running_door(bus, robots) as url, talking(url, protocol) as talk:
        await talk.send({"op": "describe", "filler": ["x" * 100_000], "id": "mine", "topic": "y" * 800_000})
        error = await talk.receive()
        assert (error["code"], error["id"]) == ("TOO_MUCH", "mine")
        assert (await talk.ask("ping"))["op"] == "result"


async def test_a_message_far_over_the_limit_ends_the_connection_with_1009_and_the_others_go_on() -> None:
    bus, robots = cell()
    async with running_door(bus, robots) as url, talking(url) as talk, talking(url) as other:
        await other.ask("subscribe", topics=["r2/joints"])
        await talk.socket.send_str("x" * 2_000_000)
        assert await talk.close_code() == 1009
        await other_is_served(bus, other, 1)


async def test_the_65th_subscription_is_refused_and_a_known_id_replaces() -> None:
    bus, robots = cell()
    async with running_door(bus, robots) as url, talking(url) as talk:
        for number in range(64):
            assert (await talk.ask("subscribe", id=number, topics=["r1/joints"]))["op"] == "result"
        assert (await talk.ask("subscribe", id=64, topics=["r1/joints"]))["code"] == "TOO_MUCH"
        assert (await talk.ask("subscribe", id=63, topics=["r2/joints"]))["topics"] == ["r2/joints"]
        made = publish(bus, "r1/joints", 1)
        assert [sample["seq"] for sample in await talk.samples()] == [1] * 63
        assert (len(bus.topics["r1/joints"].listeners), made.asked) == (1, 1)


async def test_a_refused_replacement_leaves_the_old_subscription() -> None:
    bus, robots = cell()
    async with running_door(bus, robots) as url, talking(url) as talk:
        await talk.ask("subscribe", topics=["r2/joints"])
        assert (await talk.ask("subscribe", topics=["r9/joints"]))["op"] == "error"
        await other_is_served(bus, talk, 1)


async def test_a_client_that_sends_only_rubbish_is_closed_with_1008_and_the_others_go_on() -> None:
    bus, robots = cell()
    async with running_door(bus, robots) as url, talking(url) as talk, talking(url) as other:
        await other.ask("subscribe", topics=["r2/joints"])
        for _ in range(33):
            await talk.socket.send_str("rubbish")
        assert await talk.close_code() == 1008
        await other_is_served(bus, other, 1)


async def test_a_client_that_errs_now_and_then_stays() -> None:
    bus, robots = cell()
    async with running_door(bus, robots) as url, talking(url) as talk:
        for _ in range(3):
            for _ in range(30):
                await talk.send({"op": "zzz"})
                assert (await talk.receive())["op"] == "error"
            assert (await talk.ask("ping"))["op"] == "result"


async def test_the_url_subscribes() -> None:
    bus, robots = cell()
    publish(bus, "r1/joints", 1)
    publish(bus, "r1/status", 1)
    async with (
        running_door(bus, robots) as url,
        talking(f"{url}?topics=*/joints,*/status&rate_hz=30&fields=position") as talk,
    ):
        answer = await talk.receive()
        assert answer["id"] == "url"
        assert answer["topics"] == ["r1/joints", "r1/status", "r2/joints", "r2/status"]
        assert [sample["topic"] for sample in await talk.samples()] == ["r1/joints", "r1/status"]
        assert (await talk.ask("unsubscribe", id="url"))["op"] == "result"


async def test_a_url_that_names_an_unknown_topic_is_answered_in_the_protocol() -> None:
    bus, robots = cell()
    async with running_door(bus, robots) as url, talking(f"{url}?topics=r1/jonts") as talk:
        assert (await talk.receive())["code"] == "UNKNOWN_TOPIC"


@pytest.mark.parametrize("query", ["rate_hz=0", "rate_hz=nan", "rate_hz=inf", "rate_hz=x", "mode=some"])
async def test_a_url_that_is_wrong_is_refused_before_the_handshake(query: str) -> None:
    bus, robots = cell()
    async with running_door(bus, robots) as url, aiohttp.ClientSession() as session:
        with pytest.raises(aiohttp.WSServerHandshakeError) as refused:
            await session.ws_connect(f"{url}?topics=*/joints&{query}")
        assert refused.value.status == 400


@pytest.mark.parametrize(
    ("query", "says"),
    [
        ("topics=*/joints&rate=5&zzz=1", "unknown: rate, zzz; allowed are topics, rate_hz, mode, fields, since"),
        ("rate_hz=5", "rate_hz without topics"),
        ("topics=a/b&topics=c/d", "more than once: topics"),
        ("topic=*/joints", "unknown: topic; allowed are topics,"),
    ],
)
async def test_a_url_parameter_without_effect_is_refused_by_name(query: str, says: str) -> None:
    bus, robots = cell()
    async with (
        running_door(bus, robots) as url,
        aiohttp.ClientSession() as session,
        session.get(f"{url.replace('ws://', 'http://')}?{query}") as answer,
    ):
        assert answer.status == 400
        assert says in await answer.text()


class BrokenReading(CountingReading):
    """A reading whose plugin has put in what no encoding knows."""

    reported = 0

    def broken(self, topic: Topic, error: Exception) -> Sample:
        """The empty sample."""
        assert isinstance(error, TypeError)
        self.reported += 1
        return msgspec.structs.replace(self.sample(topic), data=Joints(), q=Quality.BAD)


def publish_broken(bus: Bus, name: str, data: object) -> BrokenReading:
    """Publish a reading that cannot be encoded."""
    made = BrokenReading(Sample(topic=name, seq=1, epoch="e.1", t=T, q=Quality.GOOD, data=data))
    bus.publish(bus.topics[name], made)
    return made


@both
async def test_what_cannot_be_encoded_comes_empty_with_q_bad_and_the_clients_stay(protocol: str) -> None:
    bus, robots = cell()
    wrong = msgspec.structs.replace(Joints(), position=[object()], velocity=[1.0])
    async with running_door(bus, robots) as url, talking(url, protocol) as talk, talking(url, protocol) as cut:
        await talk.ask("subscribe", topics=["*/joints"])
        await cut.ask("subscribe", topics=["*/joints"], fields=["velocity"])
        made = publish_broken(bus, "r1/joints", wrong)
        (sample,) = await talk.samples()
        assert (sample["q"], msgspec.convert(sample["data"], Joints)) == ("BAD", Joints())
        (sample,) = await cut.samples()
        assert (sample["q"], sample["data"]) == ("GOOD", {"velocity": [1.0]})
        (sample,) = msgspec.convert((await talk.ask("get", topics=["r1/joints"]))["samples"], list[dict[str, object]])
        assert sample["q"] == "BAD"
        assert made.reported == 2
        await other_is_served(bus, talk, 2)


@both
async def test_an_event_whose_values_cannot_be_encoded_comes_without_them(protocol: str) -> None:
    bus, robots = cell("r1")
    topic = bus.topics["r1/events"]
    async with running_door(bus, robots) as url, talking(url, protocol) as talk:
        await talk.ask("subscribe", topics=["*/events"])
        bus.raise_event(topic, T, EventKind.POWER_CHANGED, object(), "OFF", {"word": 1})
        (live,) = msgspec.convert((await talk.receive("event"))["events"], list[dict[str, object]])
        (read,) = msgspec.convert((await talk.ask("events"))["events"], list[dict[str, object]])
    for event in (live, read):
        assert (event["kind"], event["from"], event["to"], event["raw"]) == ("power.changed", None, None, {})


async def test_an_internal_error_closes_with_1011_and_the_others_go_on() -> None:
    bus, robots = cell("r1", "r2")
    link = msgspec.structs.replace(Link(state=LinkState.ONLINE, since=T, protocol="p", peer="h"), notes=[object()])
    async with running_door(bus, robots) as url, talking(url) as talk, talking(url) as other:
        await other.ask("subscribe", topics=["r2/joints"])
        publish(bus, "r1/link", 2, link)
        await talk.send({"op": "robots", "id": 1})
        assert await talk.close_code() == 1011
        await other_is_served(bus, other, 1)


async def test_a_client_that_never_reads_is_sent_away_with_1013_and_costs_bounded_memory() -> None:
    bus, robots = cell()
    async with running_door(bus, robots, stuck_s=0.2) as url, talking(url) as other, talking(url) as lazy:
        await other.ask("subscribe", topics=["r2/joints"])
        await lazy.ask("subscribe", topics=["r1/vendor"], mode="all")
        lazy.socket._conn.transport.pause_reading()  # type: ignore[union-attr]
        tracemalloc.start()
        seq = 0
        with anyio.fail_after(15):
            while bus.topics["r1/vendor"].listeners:
                for _ in range(500):
                    seq += 1
                    publish(bus, "r1/vendor", seq, {"filler": "x" * 2000})
                await other_is_served(bus, other, seq)
        _, peak = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        assert peak < 150_000_000
        lazy.socket._conn.transport.resume_reading()  # type: ignore[union-attr]
        assert await lazy.close_code() == 1013
        await other_is_served(bus, other, seq + 1)


async def test_a_client_that_pauses_and_reads_on_has_every_sample_in_order_and_pings_are_answered_in_between() -> None:
    bus, robots = cell("r1")
    async with running_door(bus, robots) as url, foreign_connect(url, proxy=None, max_queue=None) as socket:
        await socket.recv()
        await socket.send('{"op":"subscribe","id":1,"topics":["r1/vendor"],"mode":"all"}')
        await socket.recv()
        socket.transport.pause_reading()
        for seq in range(1, 4001):
            publish(bus, "r1/vendor", seq, {"filler": "x" * 5000})
            if seq % 20 == 0:
                await anyio.lowlevel.checkpoint()
            if seq % 1000 == 0:
                await socket.ping()
        socket.transport.resume_reading()
        pong = await socket.ping()
        seqs: list[int] = []
        with anyio.fail_after(10):
            while len(seqs) < 4000:
                message = msgspec.json.decode(await socket.recv(), type=messages.Response)
                assert isinstance(message, messages.Data), message
                seqs += [sample.seq for sample in message.samples]
            await pong
        assert seqs == list(range(1, 4001))


async def test_more_events_than_can_be_queued_end_with_1013_although_nothing_is_read() -> None:
    bus, robots = cell("r1")
    async with running_door(bus, robots, stuck_s=60.0) as url, talking(url) as lazy:
        await lazy.ask("subscribe", topics=["*/events"])
        lazy.socket._conn.transport.pause_reading()  # type: ignore[union-attr]
        topic = bus.topics["r1/events"]
        with anyio.fail_after(10):
            while topic.listeners:
                for _ in range(2000):
                    bus.raise_event(topic, T, EventKind.MODE_CHANGED, None, "x" * 1000, {})
                await anyio.sleep(0.001)
        lazy.socket._conn.transport.resume_reading()  # type: ignore[union-attr]
        assert await lazy.close_code() == 1013


async def ask_for_ever(talk: Talk, question: str) -> None:
    """Send a question until the connection ends, for 3 s at most."""
    with anyio.fail_after(3):
        while True:
            await talk.socket.send_str(question)


async def test_a_client_that_asks_and_asks_and_never_reads_is_not_read_either() -> None:
    bus, robots = cell()
    publish(bus, "r1/vendor", 1, {"filler": "x" * 200_000})
    question = '{"op":"get","id":1,"topics":["r1/vendor"]}'
    async with running_door(bus, robots, stuck_s=0.3) as url, talking(url) as lazy, talking(url) as other:
        lazy.socket._conn.transport.pause_reading()  # type: ignore[union-attr]
        tracemalloc.start()
        with pytest.raises((ConnectionError, TimeoutError)):
            await ask_for_ever(lazy, question)
        _, peak = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        assert peak < 50_000_000
        assert (await other.ask("ping"))["op"] == "result"


async def test_more_events_than_can_be_queued_end_with_1013() -> None:
    bus, robots = cell("r1")
    async with running_door(bus, robots) as url, talking(url) as talk:
        await talk.ask("subscribe", topics=["*/events"])
        for _ in range(QUEUED_EVENTS + 1):
            raise_event(bus, "r1")
        assert await talk.close_code() == 1013


async def test_a_client_that_vanishes_leaves_nothing_behind() -> None:
    bus, robots = cell()
    async with running_door(bus, robots) as url:
        async with talking(url) as talk:
            await talk.ask("subscribe", topics=["*"])
            talk.socket._conn.transport.abort()  # type: ignore[union-attr]
        with anyio.fail_after(5):
            while any(topic.listeners for topic in bus.topics.values()):
                publish(bus, "r1/joints", 1)
                await anyio.sleep(0.005)


async def subscribe_many(stack: AsyncExitStack, url: str, count: int) -> list[Talk]:
    talks = [await stack.enter_async_context(talking(url)) for _ in range(count)]
    for talk in talks:
        await talk.ask("subscribe", topics=["r1/joints"])
    return talks


async def test_many_clients_share_one_normalised_and_encoded_sample() -> None:
    bus, robots = cell()
    async with running_door(bus, robots) as url, AsyncExitStack() as stack:
        talks = await subscribe_many(stack, url, 20)
        made = publish(bus, "r1/joints", 1)
        for talk in talks:
            assert len(await talk.samples()) == 1
        assert made.asked == 1
        assert len(made.encoded) == 1


@both
async def test_a_foreign_client_agrees_on_subprotocol_and_frames(protocol: str) -> None:
    bus, robots = cell()
    async with (
        running_door(bus, robots) as url,
        foreign_connect(url, subprotocols=[websockets.Subprotocol(protocol)], proxy=None) as socket,
    ):
        assert socket.subprotocol == protocol
        welcome = await socket.recv()
        assert isinstance(welcome, str) == (protocol == JSON_SUBPROTOCOL)
        pong = await socket.ping()
        await pong


async def test_a_foreign_client_without_a_subprotocol_speaks_json() -> None:
    bus, robots = cell()
    async with running_door(bus, robots) as url, foreign_connect(url, proxy=None) as socket:
        assert socket.subprotocol is None
        assert msgspec.json.decode(await socket.recv())["op"] == "welcome"


async def read_to_the_end(socket: ClientConnection) -> AsyncIterator[websockets.Data]:
    with contextlib.suppress(websockets.ConnectionClosedError):
        async for message in socket:
            yield message


async def test_a_foreign_client_sees_the_close_codes() -> None:
    bus, robots = cell()
    async with running_door(bus, robots) as url:
        async with foreign_connect(url, proxy=None) as socket:
            for _ in range(33):
                await socket.send("rubbish")
            answers = [answer async for answer in read_to_the_end(socket)]
            assert all("BAD_MESSAGE" in str(answer) for answer in answers[1:])
            assert (socket.close_code, socket.close_reason) == (1008, "too many wrong messages")
        async with foreign_connect(url, proxy=None) as socket:
            await socket.close(1000)
            assert socket.close_code == 1000


async def test_an_empty_cell_answers() -> None:
    empty: list[Robot] = []
    async with running_door(Bus(cell()[0].events), empty) as url, talking(url) as talk:
        assert (await talk.ask("robots"))["robots"] == []
        assert (await talk.ask("subscribe", topics=["*"]))["code"] == "UNKNOWN_TOPIC"


async def events_of(talk: Talk, count: int) -> list[str]:
    """The names of so many events that are sent."""
    names: list[str] = []
    while len(names) < count:
        pushed = msgspec.convert((await talk.receive("event"))["events"], list[dict[str, object]])
        names += [str(event["name"]) for event in pushed]
    assert len(names) == count
    return names


def read_back(answer: dict[str, object]) -> tuple[list[str], object]:
    """The names of the events of an answer, and how many are missed."""
    return [str(event["name"]) for event in msgspec.convert(answer["events"], list[dict[str, object]])], answer[
        "missed"
    ]


def told_cell(command_ring: int = 100) -> tuple[Bus, list[Robot], dict[str, list[str]]]:
    """Two robots, with five events and five command objects each, taking turns; the names by topic."""
    bus, robots = cell("r1", "r2", command_ring=command_ring)
    told: dict[str, list[str]] = {"events": [], "r1": [], "r2": []}
    for number in range(5):
        raise_event_at(bus, "r1", T + 10 * number)
        told["events"].append(bus.events.last_name)
        for robot, after in (("r1", 1), ("r2", 2)):
            told[robot].append(raise_command(bus, robot, number, T + 10 * number + after))
    return bus, robots, told


def raise_event_at(bus: Bus, robot: str, t: int) -> None:
    bus.raise_event(bus.topics[f"{robot}/events"], t, EventKind.MOTION_STARTED, None, None, {})


async def test_the_events_of_all_rings_are_read_back_by_time() -> None:
    bus, robots, told = told_cell()
    by_time = [name for turn in zip(told["events"], told["r1"], told["r2"], strict=True) for name in turn]
    async with running_door(bus, robots) as url, talking(url) as talk:
        assert read_back(await talk.ask("events")) == (by_time, 0)
        assert read_back(await talk.ask("events", limit=4)) == (by_time[:4], 0)
        assert read_back(await talk.ask("events", topics=["r1/commands"], limit=2)) == (told["r1"][:2], 0)
        since = [told["events"][3], told["r2"][0]]
        expected = sorted([told["events"][4], *told["r1"], *told["r2"][1:]], key=by_time.index)
        assert read_back(await talk.ask("events", since=since)) == (expected, 0)


async def test_events_read_page_by_page_are_complete_whatever_the_limit() -> None:
    bus, robots, told = told_cell()
    everything = {name for names in told.values() for name in names}
    async with running_door(bus, robots) as url, talking(url) as talk:
        for limit in (1, 2, 7, 100):
            newest = {BOOT: f"{BOOT}:0"}
            found: list[str] = []
            while True:
                page, missed = read_back(await talk.ask("events", since=list(newest.values()), limit=limit))
                assert missed == 0
                if not page:
                    break
                found += page
                newest.update({name.rpartition(":")[0]: name for name in page})
            assert len(found) == len(everything)
            assert set(found) == everything


async def test_a_ring_keeps_its_own_order_where_time_went_back() -> None:
    bus, robots = cell("r1", "r2", command_ring=100)
    r1 = [raise_command(bus, "r1", 0, T + at) for at in (50, 10, 60)]
    r2 = [raise_command(bus, "r2", 0, T + at) for at in (20, 30)]
    async with running_door(bus, robots) as url, talking(url) as talk:
        names, _ = read_back(await talk.ask("events"))
    assert [name for name in names if name in r1] == r1
    assert [name for name in names if name in r2] == r2


@pytest.mark.parametrize("as_list", [True, False])
async def test_a_ring_that_no_name_belongs_to_is_read_from_its_beginning_and_what_is_gone_is_said_exactly(
    *, as_list: bool
) -> None:
    bus, robots, told = told_cell(command_ring=3)
    since = told["events"][4]
    async with running_door(bus, robots) as url, talking(url) as talk:
        names, missed = read_back(await talk.ask("events", since=[since] if as_list else since))
        assert sorted(names) == sorted([*told["r1"][2:], *told["r2"][2:]])
        assert missed == 4
        names, missed = read_back(await talk.ask("events", since=[since, told["r1"][0]]))
        assert (len(names), missed) == (6, 3)
        names, missed = read_back(await talk.ask("events", since=[since, told["r1"][3], told["r2"][1]]))
        assert (sorted(names), missed) == (sorted([told["r1"][4], *told["r2"][2:]]), 0)
        names, missed = read_back(await talk.ask("events", since=since, topics=["r1/events"]))
        assert (names, missed) == ([], 0)


async def test_a_name_of_another_boot_makes_the_loss_unknown_and_everything_comes() -> None:
    bus, robots, told = told_cell()
    async with running_door(bus, robots) as url, talking(url) as talk:
        names, missed = read_back(await talk.ask("events", since=["before:7", "other:3"]))
        assert (len(names), missed) == (15, -1)
        # one ring is known: what is gone of the others nobody knows
        names, missed = read_back(await talk.ask("events", since=[told["events"][4], "before:7"]))
        assert (len(names), missed) == (10, -1)
        # every ring that is asked for is named: nothing is unknown
        known = [told["events"][4], told["r1"][4], told["r2"][4], "before:7"]
        assert read_back(await talk.ask("events", since=known)) == ([], 0)


async def test_a_subscription_reads_on_in_every_ring_and_is_told_the_newest_names() -> None:
    bus, robots, told = told_cell()
    async with running_door(bus, robots) as url, talking(url) as talk:
        since = [told["events"][4], told["r1"][2], told["r2"][4]]
        answer = await talk.ask("subscribe", topics=["*/events", "*/commands"], since=since)
        newest = [told["events"][4], told["r1"][4], told["r2"][4]]
        assert sorted(msgspec.convert(answer["last_events"], list[str])) == sorted(newest)
        assert await events_of(talk, 2) == told["r1"][3:]
        live = [raise_command(bus, "r2"), raise_command(bus, "r1")]
        assert await events_of(talk, 2) == live


async def test_a_subscription_without_rings_is_told_no_names_and_one_without_events_that_nothing_was() -> None:
    bus, robots = cell("r1", command_ring=100)
    async with running_door(bus, robots) as url, talking(url) as talk:
        assert "last_events" not in await talk.ask("subscribe", id=1, topics=["*/joints"])
        answer = await talk.ask("subscribe", id=2, topics=["r1/*"])
        assert set(msgspec.convert(answer["last_events"], list[str])) == {
            f"{BOOT}:0",
            last_name(bus, "r1/commands"),
        }


async def test_a_refused_since_leaves_no_subscription() -> None:
    bus, robots, told = told_cell()
    async with running_door(bus, robots) as url, talking(url) as talk:
        refused = await talk.ask("subscribe", topics=["*/commands"], since=[told["r1"][0], told["r1"][1]])
        assert refused["code"] == "BAD_REQUEST"
        assert bus.topics["r1/commands"].listeners == []


async def test_the_url_reads_on_in_several_rings() -> None:
    bus, robots, told = told_cell()
    since = ",".join([told["events"][2], told["r1"][3], told["r2"][4]])
    async with (
        running_door(bus, robots) as url,
        talking(f"{url}?topics=*/events,*/commands&since={since}") as talk,
    ):
        assert (await talk.receive("result"))["id"] == "url"
        assert await events_of(talk, 3) == [told["events"][3], told["events"][4], told["r1"][4]]


async def test_a_flood_of_command_objects_while_a_client_is_away_is_read_back_complete_and_in_order() -> None:
    bus, robots = cell("r1", "r2", command_ring=20_000)
    raise_event(bus, "r1")
    async with running_door(bus, robots) as url:
        async with talking(url) as talk:
            await talk.ask("subscribe", topics=["*/events", "*/commands"])
            first = raise_command(bus, "r1")
            assert await events_of(talk, 1) == [first]
        flood = [raise_command(bus, "r1", number) for number in range(5000)]
        for _ in range(20):
            raise_event(bus, "r2")
        async with talking(url) as talk:
            since = [first, f"{BOOT}:1"]
            answer = await talk.ask("subscribe", topics=["*/events", "*/commands"], since=since)
            assert flood[-1] in msgspec.convert(answer["last_events"], list[str])
            names: list[str] = []
            while len(names) < 5020:
                message = await talk.receive()
                assert message["op"] == "event"  # nothing is missed
                names += [str(event["name"]) for event in msgspec.convert(message["events"], list[dict[str, object]])]
            assert [name for name in names if not name.startswith(f"{BOOT}:")] == flood
            assert [name for name in names if name.startswith(f"{BOOT}:")] == [f"{BOOT}:{n}" for n in range(2, 22)]
        async with talking(url) as talk:
            names, missed = read_back(await talk.ask("events", since=[first, f"{BOOT}:21"], limit=10_000))
            assert (names, missed) == (flood, 0)


async def test_a_flood_of_command_objects_pushes_no_edge_out_of_its_ring() -> None:
    bus, robots = cell("r1", ring=10, command_ring=10)
    raise_event(bus, "r1")
    for number in range(1000):
        raise_command(bus, "r1", number)
    async with running_door(bus, robots) as url, talking(url) as talk:
        assert read_back(await talk.ask("events", since=f"{BOOT}:0", topics=["*/events"])) == ([f"{BOOT}:1"], 0)
        names, missed = read_back(await talk.ask("events", since=f"{BOOT}:0"))
        assert (len(names), missed) == (11, 990)


async def test_a_topic_that_comes_while_a_long_request_is_answered_is_found_by_its_first_globs_too() -> None:
    bus, robots = cell("r1")
    requests = Requests(Cell(robots, bus), JSON, Outbox(JSON, 0.0, time.monotonic))
    globs = ["*/status", *(f"absent{number}/status" for number in range(40))]

    async def add() -> None:
        bus.add("r2", ["status"])

    async with anyio.create_task_group() as tasks:
        tasks.start_soon(add)
        result = await requests.answer_in_turns(messages.Subscribe(id=1, topics=globs))
    assert result.topics == ["r1/status", "r2/status"]
