"""The Foxglove door over real sockets: the bytes by hand, from the protocol's specification."""

from __future__ import annotations

import json
import struct
import tracemalloc
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import aiohttp
import anyio
import anyio.lowlevel
import msgspec
import pytest

from gateway.api.model import EventKind, Pose, Quality, Sample, Tcp
from gateway.core.bus import Bus, ValueReading
from gateway.core.settings import BrokenRobot
from gateway.errors import VendorError
from gateway.server.foxglove import SUBPROTOCOLS
from gateway.server.outbox import QUEUED_EVENTS
from tests.server.kit import BOOT, Robot, T, cell, publish, publish_status, raise_command, raise_event, running_door

PATIENCE_S = 5
Json = dict[str, object]


class Guest:
    """A Foxglove client that knows nothing but the specification.

    Attributes:
        info: The server's first message.
        channels: What is advertised, by topic.
    """

    def __init__(self, socket: aiohttp.ClientWebSocketResponse) -> None:
        self.socket = socket
        self.info: Json = {}
        self.channels: dict[str, Json] = {}
        self._names = 0

    async def receive(self) -> Json | tuple[int, int, Json]:
        """The next message: a text one, or subscription, time in ns and payload of a binary one."""
        with anyio.fail_after(PATIENCE_S):
            frame = await self.socket.receive()
        if frame.type is aiohttp.WSMsgType.TEXT:
            found = json.loads(frame.data)
            if found["op"] == "advertise":
                self.channels |= {channel["topic"]: channel for channel in found["channels"]}
            return dict(found)
        assert frame.type is aiohttp.WSMsgType.BINARY, frame
        assert frame.data[0] == 1
        return (
            int.from_bytes(frame.data[1:5], "little"),
            int.from_bytes(frame.data[5:13], "little"),
            json.loads(frame.data[13:]),
        )

    async def told(self, op: str) -> Json:
        """The next text message with some `op`; samples in between are passed over."""
        while True:
            found = await self.receive()
            if isinstance(found, dict) and found["op"] == op:
                return found

    async def message(self) -> tuple[int, int, Json]:
        """The next binary message; nothing else may come before it."""
        found = await self.receive()
        assert isinstance(found, tuple), found
        return found

    async def send(self, message: object) -> None:
        """Send one object as text."""
        await self.socket.send_str(json.dumps(message))

    async def subscribe(self, *topics: str) -> list[int]:
        """Ask for channels by their topics; returns the ids of the subscriptions."""
        ids = [self._names + number for number in range(len(topics))]
        self._names += len(topics)
        wanted = [
            {"id": name, "channelId": self.channels[topic]["id"]} for name, topic in zip(ids, topics, strict=True)
        ]
        await self.send({"op": "subscribe", "subscriptions": wanted})
        return ids

    async def settle(self) -> None:
        """Read everything that is owed until now."""
        await self.send({"op": "nonsense"})
        await self.told("status")

    async def silence(self) -> Json:
        """Ask for nonsense and return its status: nothing else was owed before it."""
        await self.send({"op": "nonsense"})
        found = await self.receive()
        assert isinstance(found, dict), found
        assert found["op"] == "status"
        assert found["level"] == 1
        return found


def foxglove(url: str, query: str = "") -> str:
    """The address of the Foxglove door, of that of the native one."""
    return url.removesuffix("/ws") + "/foxglove" + query


@asynccontextmanager
async def visiting(url: str, protocol: str = SUBPROTOCOLS[0]) -> AsyncIterator[Guest]:
    """Connect, and read what every client is told first."""
    async with aiohttp.ClientSession() as session, session.ws_connect(url, protocols=(protocol,)) as socket:
        guest = Guest(socket)
        info = await guest.receive()
        assert isinstance(info, dict)
        guest.info = info
        await guest.settle()
        yield guest


def tcp_cell() -> tuple[Bus, list[Robot]]:
    """A robot whose tool centre point is known."""
    bus, robots = cell("r1")
    bus.add("r1", ["tcp"])
    return bus, robots


POSE = Pose(position=[0.1, -0.2, 0.3], orientation=[0.0, 0.0, 0.6, 0.8])
FOXGLOVE_POSE = {
    "position": {"x": 0.1, "y": -0.2, "z": 0.3},
    "orientation": {"x": 0.0, "y": 0.0, "z": 0.6, "w": 0.8},
}
BOTH = pytest.mark.parametrize("protocol", SUBPROTOCOLS)


@BOTH
async def test_the_server_names_itself_and_offers_every_topic_under_either_subprotocol(protocol: str) -> None:
    bus, robots = cell("r1", "r2", command_ring=10)
    async with running_door(bus, robots) as url, visiting(foxglove(url), protocol) as guest:
        assert guest.socket.protocol == protocol
        assert guest.info["op"] == "serverInfo"
        assert (guest.info["capabilities"], guest.info["supportedEncodings"]) == ([], [])
        assert guest.info["sessionId"] == BOOT
        assert guest.info["metadata"]["robots"] == "r1,r2"  # type: ignore[index]
        assert sorted(guest.channels) == sorted(f"/{name}" for name in bus.topics)
        ids = [channel["id"] for channel in guest.channels.values()]
        assert len(set(ids)) == len(ids)
        joints, events, commands = (guest.channels[f"/r2/{group}"] for group in ("joints", "events", "commands"))
        assert (joints["encoding"], joints["schemaEncoding"]) == ("json", "jsonschema")
        names = [channel["schemaName"] for channel in (joints, events, commands)]
        assert names == ["robot_gateway.joints", "foxglove.Log", "robot_gateway.commands"]
        assert guest.channels["/r1/vendor"]["schemaName"] == "robot_gateway.vendor.toy.polled"


@pytest.mark.parametrize("protocols", [(), ("robot-gateway.v1+json",), ("foxglove.websocket.v0", "x")])
async def test_another_subprotocol_is_refused_with_the_names_of_ours(protocols: tuple[str, ...]) -> None:
    bus, robots = cell()
    async with running_door(bus, robots) as url, aiohttp.ClientSession() as session:
        with pytest.raises(aiohttp.WSServerHandshakeError) as refused:
            await session.ws_connect(foxglove(url), protocols=protocols)
        assert refused.value.status == 400
        answer = await session.get(foxglove(url).replace("ws:", "http:"))
        assert answer.status == 400
        text = await answer.text()
        assert all(name in text for name in SUBPROTOCOLS)


async def test_of_several_subprotocols_the_first_that_is_known_is_spoken() -> None:
    bus, robots = cell()
    async with running_door(bus, robots) as url, aiohttp.ClientSession() as session:
        offered = ("x", SUBPROTOCOLS[1], SUBPROTOCOLS[0])
        async with session.ws_connect(foxglove(url), protocols=offered) as socket:
            assert socket.protocol == SUBPROTOCOLS[1]


async def test_a_sample_leaves_as_the_specification_says_byte_for_byte() -> None:
    bus, robots = cell("r1")
    async with running_door(bus, robots) as url, visiting(foxglove(url)) as guest:
        wanted = {"id": 0xFFFFFFFF, "channelId": guest.channels["/r1/joints"]["id"]}
        await guest.send({"op": "subscribe", "subscriptions": [wanted]})
        await guest.silence()
        publish(bus, "r1/joints", 7)
        frame = await guest.socket.receive()
    assert frame.data[:5] == b"\x01\xff\xff\xff\xff"
    assert frame.data[5:13] == struct.pack("<Q", (T + 7) * 1000)
    sample = json.loads(frame.data[13:])
    assert (sample["topic"], sample["seq"], sample["q"], sample["t"]) == ("r1/joints", 7, "GOOD", T + 7)
    assert sample["data"]["position"] == [7.0, None]
    assert sample["data"]["velocity"] is None


async def test_what_is_latched_comes_at_once_and_only_then_what_is_new() -> None:
    bus, robots = cell("r1")
    publish_status(bus, "r1/status", 1, in_motion=True)
    async with running_door(bus, robots) as url, visiting(foxglove(url)) as guest:
        status, link = await guest.subscribe("/r1/status", "/r1/link")
        first = [await guest.message() for _ in range(2)]
        assert [message[0] for message in first] == [status, link]
        publish_status(bus, "r1/status", 2, in_motion=False)
        name, _, sample = await guest.message()
        assert (name, sample["seq"]) == (status, 2)
        await guest.silence()


async def test_a_reading_that_is_latched_and_due_at_once_is_sent_once() -> None:
    bus, robots = tcp_cell()
    async with running_door(bus, robots, flush_s=0.05) as url, visiting(foxglove(url)) as guest:
        (whole,) = await guest.subscribe("/r1/tcp")
        await guest.silence()
        publish(bus, "r1/tcp", 1, Tcp(pose=POSE))
        (pose,) = await guest.subscribe("/r1/tcp/pose")
        assert sorted([(await guest.message())[0], (await guest.message())[0]]) == [whole, pose]
        await anyio.sleep(0.1)
        await guest.silence()


async def test_after_unsubscribing_nothing_comes_and_the_id_is_free() -> None:
    bus, robots = cell("r1")
    async with running_door(bus, robots) as url, visiting(foxglove(url)) as guest:
        (name,) = await guest.subscribe("/r1/joints")
        await guest.send({"op": "unsubscribe", "subscriptionIds": [name]})
        await guest.silence()
        assert bus.topics["r1/joints"].listeners == []
        publish(bus, "r1/joints", 1)
        await guest.silence()
        channel = guest.channels["/r1/vendor"]["id"]
        await guest.send({"op": "subscribe", "subscriptions": [{"id": name, "channelId": channel}]})
        await guest.silence()
        publish(bus, "r1/vendor", 2, {"word": 1})
        assert (await guest.message())[2]["data"] == {"word": 1}


async def test_a_client_that_leaves_costs_nothing_more() -> None:
    bus, robots = cell("r1")
    async with running_door(bus, robots) as url:
        async with visiting(foxglove(url)) as guest:
            await guest.subscribe("/r1/joints", "/r1/events")
            await guest.silence()
            assert len(bus.topics["r1/joints"].listeners) == 1
        with anyio.fail_after(PATIENCE_S):
            while bus.topics["r1/joints"].listeners or bus.topics["r1/events"].listeners:  # noqa: ASYNC110
                await anyio.sleep(0.01)


async def test_samples_are_encoded_once_for_all_clients_and_shared_with_the_native_door() -> None:
    bus, robots = tcp_cell()
    async with (
        running_door(bus, robots) as url,
        visiting(foxglove(url)) as one,
        visiting(foxglove(url)) as other,
    ):
        for guest in (one, other):
            await guest.subscribe("/r1/tcp", "/r1/tcp/pose", "/r1/tf")
            await guest.silence()
        made = publish(bus, "r1/tcp", 1, Tcp(pose=POSE))
        for guest in (one, other):
            for _ in range(3):
                await guest.message()
        assert len(made.encoded) == 3
        assert ("tcp", None, "robot-gateway.v1+json") in made.encoded


async def test_the_pose_of_the_tool_centre_point_is_a_pose_in_frame() -> None:
    bus, robots = tcp_cell()
    async with running_door(bus, robots) as url, visiting(foxglove(url)) as guest:
        assert guest.channels["/r1/tcp/pose"]["schemaName"] == "foxglove.PoseInFrame"
        await guest.subscribe("/r1/tcp/pose")
        await guest.silence()
        publish(bus, "r1/tcp", 250_000, Tcp(pose=POSE))
        _, t, told = await guest.message()
    assert t == (T + 250_000) * 1000
    stamp = {"sec": T // 1_000_000, "nsec": 250_000_000}
    assert told == {"timestamp": stamp, "frame_id": "r1/base", "pose": FOXGLOVE_POSE}


async def test_the_frame_tree_holds_what_is_known_and_nothing_else() -> None:
    bus, robots = tcp_cell()
    async with running_door(bus, robots) as url, visiting(foxglove(url)) as guest:
        assert guest.channels["/r1/tf"]["schemaName"] == "foxglove.FrameTransforms"
        await guest.subscribe("/r1/tf")
        await guest.silence()
        publish(bus, "r1/tcp", 1, Tcp(pose=POSE))
        publish(bus, "r1/tcp", 2, Tcp(pose=POSE, flange_pose=POSE))
        _, _, told = await guest.message()
        transforms = told["transforms"]
        assert isinstance(transforms, list)
        assert [(one["parent_frame_id"], one["child_frame_id"]) for one in transforms] == [
            ("r1/base", "r1/tcp"),
            ("r1/base", "r1/flange"),
        ]
        assert transforms[0]["translation"] == FOXGLOVE_POSE["position"]
        assert transforms[0]["rotation"] == FOXGLOVE_POSE["orientation"]


UNKNOWN_POSES: list[Pose | None] = [
    None,
    Pose(),
    Pose(position=[0.1, 0.2, 0.3]),
    Pose(orientation=[0.0, 0.0, 0.0, 1.0]),
    Pose(position=[0.1, None, 0.3], orientation=[0.0, 0.0, 0.0, 1.0]),
    Pose(position=[0.1, 0.2, 0.3], orientation=[0.0, 0.0, None, 1.0]),
    Pose(position=[0.1, 0.2], orientation=[0.0, 0.0, 0.0, 1.0]),
    Pose(position=[0.1, float("nan"), 0.3], orientation=[0.0, 0.0, 0.0, 1.0]),
    Pose(position="x y", orientation=[0.0, 0.0, 0.0, 1.0]),  # type: ignore[arg-type]
]


@pytest.mark.parametrize("pose", UNKNOWN_POSES)
async def test_a_pose_that_is_not_known_whole_is_not_sent_at_all(pose: Pose | None) -> None:
    bus, robots = tcp_cell()
    async with running_door(bus, robots) as url, visiting(foxglove(url)) as guest:
        whole, *_ = await guest.subscribe("/r1/tcp", "/r1/tcp/pose", "/r1/tf")
        await guest.silence()
        publish(bus, "r1/tcp", 1, Tcp(pose=pose, flange_pose=pose))
        assert (await guest.message())[0] == whole
        await guest.silence()


async def test_the_transform_of_a_stale_robot_is_not_sent_again() -> None:
    bus, robots = tcp_cell()
    publish(bus, "r1/tcp", 1, Tcp(pose=POSE))
    stale = Sample(topic="r1/tcp", seq=2, epoch="e.1", t=T + 2, t_last=T + 1, q=Quality.STALE, data=Tcp())
    async with running_door(bus, robots) as url, visiting(foxglove(url)) as guest:
        frames, whole = await guest.subscribe("/r1/tf", "/r1/tcp")
        assert {(await guest.message())[0], (await guest.message())[0]} == {frames, whole}
        bus.publish(bus.topics["r1/tcp"], ValueReading(stale))
        name, _, told = await guest.message()
        assert (name, told["q"], told["t_last"]) == (whole, "STALE", T + 1)
        await guest.send({"op": "unsubscribe", "subscriptionIds": [frames]})
        await guest.subscribe("/r1/tf")
        await guest.silence()


async def test_an_event_is_a_line_of_a_log_with_the_whole_event_beside_it() -> None:
    bus, robots = cell("r1")
    async with running_door(bus, robots) as url, visiting(foxglove(url)) as guest:
        await guest.subscribe("/r1/events")
        await guest.silence()
        raise_event(bus, "r1")
        bus.raise_event(bus.topics["r1/events"], T + 5, EventKind.ESTOP_PRESSED, None, None, {})
        _, t, first = await guest.message()
        _, _, second = await guest.message()
    assert t == T * 1000
    event = first.pop("event")
    assert event["kind"] == "motion.started"  # type: ignore[index]
    assert first == {
        "timestamp": {"sec": T // 1_000_000, "nsec": 0},
        "level": 2,
        "message": "motion.started: STANDSTILL → MOVING",
        "name": "r1",
        "file": BOOT,
        "line": 1,
    }
    assert (second["level"], second["message"], second["line"]) == (4, "estop.pressed", 2)


async def test_events_come_all_and_in_order_and_only_of_the_robot_that_was_asked_for() -> None:
    bus, robots = cell("r1", "r2", command_ring=100)
    async with running_door(bus, robots) as url, visiting(foxglove(url)) as guest:
        events, commands = await guest.subscribe("/r1/events", "/r1/commands")
        await guest.silence()
        for number in range(1500):
            raise_event(bus, "r1")
            raise_event(bus, "r2")
            if number == 0:
                raise_command(bus, "r1", number=3)
        lines: list[Json] = []
        told: list[Json] = []
        while len(lines) < 1500 or not told:
            name, _, payload = await guest.message()
            (lines if name == events else told).append(payload)
        assert [line["line"] for line in lines] == list(range(1, 3000, 2))
        assert name in {events, commands}
        assert [(one["kind"], one["to"]) for one in told] == [("command.issued", 3)]


async def test_samples_coalesce_to_the_newest_and_the_client_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("gateway.server.foxglove.outbox.MISSED_PERIOD_S", 0.0)
    bus, robots = cell("r1")
    async with running_door(bus, robots) as url, visiting(foxglove(url)) as guest:
        await guest.subscribe("/r1/joints")
        await guest.silence()
        for seq in range(1, 6):
            publish(bus, "r1/joints", seq)
        assert (await guest.message())[2]["seq"] == 5
        missed = await guest.receive()
        assert isinstance(missed, dict)
        assert (missed["op"], missed["level"], missed["id"]) == ("status", 1, "missed")
        assert "4 samples" in str(missed["message"])
        assert "r1/joints" in str(missed["message"])


async def test_a_url_limits_the_channels_and_the_rate() -> None:
    bus, robots = cell("r1", "r2")
    query = "?topics=*/joints,/r1/l*&rate_hz=20"
    async with running_door(bus, robots) as url, visiting(foxglove(url, query)) as guest:
        assert sorted(guest.channels) == ["/r1/joints", "/r1/link", "/r1/link_stats", "/r2/joints"]
        await guest.subscribe("/r1/joints")
        begin_s = anyio.current_time()
        seqs: list[int] = []
        async with anyio.create_task_group() as tasks:
            tasks.start_soon(publish_for_ever, bus)
            while len(seqs) < 6:
                seqs.append(int(str((await guest.message())[2]["seq"])))
            took_s = anyio.current_time() - begin_s
            tasks.cancel_scope.cancel()
        assert took_s > 5 / 20 - 0.01
        assert seqs == sorted(set(seqs))


async def publish_for_ever(bus: Bus) -> None:
    """Publish joints as often as the loop turns."""
    seq = 0
    while True:
        seq += 1
        publish(bus, "r1/joints", seq)
        await anyio.sleep(0.002)


@pytest.mark.parametrize(
    "query",
    [
        "?rate_hz=0",
        "?rate_hz=-1",
        "?rate_hz=1e9",
        "?rate_hz=nan",
        "?rate_hz=x",
        "?topics=",
        "?topics=*,,x",
        "?topics=" + "x" * 257,
        "?topics=" + ",".join("x" * 300),
        "?topic=*",
        "?rate_hz=1&rate_hz=2",
        "?fields=position",
    ],
)
async def test_rubbish_in_a_url_is_refused_before_anything_is_said(query: str) -> None:
    bus, robots = cell()
    async with running_door(bus, robots) as url, aiohttp.ClientSession() as session:
        with pytest.raises(aiohttp.WSServerHandshakeError) as refused:
            await session.ws_connect(foxglove(url, query), protocols=SUBPROTOCOLS)
        assert refused.value.status == 400


async def test_globs_that_match_nothing_are_said_and_the_client_stays() -> None:
    bus, robots = cell("r1")
    async with (
        running_door(bus, robots) as url,
        aiohttp.ClientSession() as session,
        session.ws_connect(foxglove(url, "?topics=r9/*"), protocols=SUBPROTOCOLS) as socket,
    ):
        guest = Guest(socket)
        assert (await guest.told("advertise"))["channels"] == []
        status = await guest.told("status")
        assert status["level"] == 2
        assert "r9/*" in str(status["message"])
        await guest.silence()


async def test_robots_that_come_and_go_are_advertised_and_unadvertised(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("gateway.server.foxglove.door._LOOK_S", 0.02)
    bus, robots = cell("r1", "r2")
    async with running_door(bus, robots) as url, visiting(foxglove(url)) as guest:
        known = {channel["id"] for channel in guest.channels.values()}
        await guest.subscribe("/r1/joints", "/r2/joints")
        gone = [bus.topics.pop(name) for name in list(bus.topics) if name.startswith("r2/")]
        ids = msgspec.convert((await guest.told("unadvertise"))["channelIds"], list[int])
        assert set(ids) == {guest.channels[f"/{topic.name}"]["id"] for topic in gone}
        assert all(topic.listeners == [] for topic in gone)
        bus.add("r3", ["joints"])
        (new,) = msgspec.convert((await guest.told("advertise"))["channels"], list[Json])
        assert new["topic"] == "/r3/joints"
        assert new["id"] not in known
        (name,) = await guest.subscribe("/r3/joints")
        await guest.silence()
        publish(bus, "r3/joints", 1)
        assert (await guest.message())[0] == name


async def test_a_robot_whose_plugin_is_broken_has_its_link() -> None:
    bus, robots = cell("r1")
    error = VendorError("kilo", "no such plugin")
    robots.append(BrokenRobot(name="r9", host="192.0.2.9", vendor="kilo", protocol="", error=error))
    bus.add("r9", ["link", "vendor"])
    async with running_door(bus, robots) as url, visiting(foxglove(url)) as guest:
        assert {"/r9/link", "/r9/vendor", "/r1/joints"} <= set(guest.channels)


WRONG = [
    ("{", "not understood"),
    ("", "not understood"),
    ("[]", "not understood"),
    ("null", "not understood"),
    ("[" * 5000, "not understood"),
    ('{"op":7}', "not understood"),
    ('{"subscriptions":[]}', "op"),
    ('{"op":"subscribe"}', "subscriptions"),
    ('{"op":"subscribe","subscriptions":{}}', "subscriptions"),
    ('{"op":"subscribe","subscriptions":[{"id":1}]}', "channelId"),
    ('{"op":"subscribe","subscriptions":[{"id":-1,"channelId":1}]}', "id"),
    ('{"op":"subscribe","subscriptions":[{"id":4294967296,"channelId":1}]}', "id"),
    ('{"op":"subscribe","subscriptions":[{"id":"a","channelId":1}]}', "id"),
    ('{"op":"subscribe","subscriptions":[{"id":1,"channelId":' + "9" * 5000 + "}]}", "not understood"),
    ('{"op":"subscribe","subscriptions":[{"id":1,"channelId":999}]}', "no channel 999"),
    ('{"op":"unsubscribe","subscriptionIds":[77]}', "no subscription 77"),
    ('{"op":"subscribe","filler":"' + "x" * 70_000 + '"}', "65536"),
    (b"", "binary"),
    (b"\x01\x00\x00\x00\x00{}", "binary"),
    (b"\xff" * 1000, "binary"),
]


@pytest.mark.parametrize(("junk", "says"), WRONG)
async def test_a_wrong_message_is_a_status_of_level_two_and_nothing_else(junk: str | bytes, says: str) -> None:
    bus, robots = cell("r1")
    async with running_door(bus, robots) as url, visiting(foxglove(url)) as guest:
        (name,) = await guest.subscribe("/r1/joints")
        await (guest.socket.send_str(junk) if isinstance(junk, str) else guest.socket.send_bytes(junk))
        status = await guest.told("status")
        assert status["level"] == 2
        assert says in str(status["message"])
        assert len(str(status["message"])) < 2000
        publish(bus, "r1/joints", 1)
        assert (await guest.message())[0] == name


@pytest.mark.parametrize(
    ("op", "says"),
    [("zzz" * 1000, "unknown op"), ("advertise", "clientPublish"), ("fetchAsset", "assets"), ("setParameters", "")],
)
async def test_what_this_server_has_no_capability_for_is_a_warning_however_often(op: str, says: str) -> None:
    bus, robots = cell("r1")
    async with running_door(bus, robots) as url, visiting(foxglove(url)) as guest:
        for _ in range(100):
            await guest.send({"op": op, "channels": [{"id": 1}]})
            status = await guest.told("status")
            assert status["level"] == 1
            assert says in str(status["message"])
            assert len(str(status["message"])) < 200


async def test_a_subscription_id_or_a_channel_is_taken_once() -> None:
    bus, robots = cell("r1")
    async with running_door(bus, robots) as url, visiting(foxglove(url)) as guest:
        (name,) = await guest.subscribe("/r1/joints")
        joints, vendor = (guest.channels[topic]["id"] for topic in ("/r1/joints", "/r1/vendor"))
        both = [{"id": name, "channelId": vendor}, {"id": 50, "channelId": joints}, {"id": 51, "channelId": vendor}]
        await guest.send({"op": "subscribe", "subscriptions": both})
        text = str((await guest.told("status"))["message"])
        assert f"subscription {name} already" in text
        assert "subscription 50: /r1/joints" in text
        await guest.silence()
        publish(bus, "r1/joints", 1)
        publish(bus, "r1/vendor", 1, {"word": 1})
        assert {(await guest.message())[0], (await guest.message())[0]} == {name, 51}
        await guest.silence()


async def test_ten_thousand_subscriptions_are_refused_in_one_sentence() -> None:
    bus, robots = cell("r1")
    async with running_door(bus, robots) as url, visiting(foxglove(url)) as guest:
        for first in range(0, 10_000, 1000):
            wanted = [{"id": first + number, "channelId": first + number} for number in range(1000)]
            await guest.send({"op": "subscribe", "subscriptions": wanted})
            status = await guest.told("status")
            assert "and 9" in str(status["message"])
            assert len(str(status["message"])) < 1000
        assert sum(len(topic.listeners) for topic in bus.topics.values()) <= len(guest.channels)
        wanted = [{"id": number, "channelId": 10**9 + number} for number in range(10_000)]
        await guest.send({"op": "subscribe", "subscriptions": wanted})
        assert "65536" in str((await guest.told("status"))["message"])


async def test_a_client_that_keeps_on_being_wrong_is_sent_away_alone() -> None:
    bus, robots = cell("r1")
    async with running_door(bus, robots) as url, visiting(foxglove(url)) as other, visiting(foxglove(url)) as guest:
        for _ in range(40):
            await guest.socket.send_str("{")
        assert await close_code(guest) == 1008
        await other.silence()


async def test_an_oversize_message_ends_the_connection_with_1009() -> None:
    bus, robots = cell("r1")
    async with running_door(bus, robots) as url, visiting(foxglove(url)) as guest:
        await guest.socket.send_str("x" * (2 << 20))
        assert await close_code(guest) == 1009


async def close_code(guest: Guest) -> int | None:
    """Read to the end; the code of the close frame."""
    with anyio.fail_after(PATIENCE_S):
        async for _ in guest.socket:
            pass
    return guest.socket.close_code


async def test_a_client_that_never_reads_is_bounded_and_sent_away_and_the_others_are_served() -> None:
    bus, robots = cell("r1")
    async with (
        running_door(bus, robots, stuck_s=0.3) as url,
        visiting(foxglove(url)) as other,
        visiting(foxglove(url)) as lazy,
    ):
        await other.subscribe("/r1/joints")
        await lazy.subscribe("/r1/vendor")
        await lazy.silence()
        lazy.socket._conn.transport.pause_reading()  # type: ignore[union-attr]
        tracemalloc.start()
        seq = 0
        with anyio.fail_after(PATIENCE_S):
            while bus.topics["r1/vendor"].listeners:
                seq += 1
                publish(bus, "r1/vendor", seq, {"filler": "x" * 20_000})
                publish(bus, "r1/joints", seq)
                await other.message()
        _, peak = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        assert seq > 100
        assert peak < 8 << 20
        lazy.socket._conn.transport.resume_reading()  # type: ignore[union-attr]
        assert await close_code(lazy) in {1013, 1006}


async def test_more_events_than_can_be_queued_send_the_client_away_with_1013() -> None:
    bus, robots = cell("r1")
    async with running_door(bus, robots) as url, visiting(foxglove(url)) as guest:
        await guest.subscribe("/r1/events")
        await guest.silence()
        for _ in range(QUEUED_EVENTS + 10):
            raise_event(bus, "r1")
        assert await close_code(guest) == 1013


async def test_the_end_of_the_gateway_is_said_with_1001() -> None:
    bus, robots = cell("r1")
    async with anyio.create_task_group() as tasks, running_door(bus, robots) as url:
        session = aiohttp.ClientSession()
        socket = await session.ws_connect(foxglove(url), protocols=SUBPROTOCOLS)
        tasks.start_soon(close_code, Guest(socket))
        await anyio.lowlevel.checkpoint()
    await session.close()
    assert socket.close_code == 1001


async def test_a_plugins_wrong_type_costs_its_group_and_its_event_only() -> None:
    bus, robots = tcp_cell()
    async with running_door(bus, robots) as url, visiting(foxglove(url)) as guest:
        await guest.subscribe("/r1/events", "/r1/tf")
        await guest.silence()
        publish(bus, "r1/tcp", 1, object())
        bus.raise_event(bus.topics["r1/events"], T, EventKind.MODE_CHANGED, object(), None, {"word": object()})
        _, _, told = await guest.message()
        assert told["message"] == "mode.changed"
        publish(bus, "r1/tcp", 2, Tcp(pose=POSE))
        assert "transforms" in (await guest.message())[2]


async def test_it_counts_what_it_delivers() -> None:
    bus, robots = cell("r1")
    async with (
        running_door(bus, robots) as url,
        visiting(foxglove(url)) as guest,
        aiohttp.ClientSession() as session,
    ):
        await guest.silence()
        answer = await session.get(url.removesuffix("/ws").replace("ws:", "http:") + "/metrics")
        lines = [line for line in (await answer.text()).splitlines() if 'door="foxglove"' in line]
        assert any(line.endswith(" 1.0") for line in lines), lines


async def test_it_stands_at_the_root_too_where_foxglove_looks_for_it() -> None:
    bus, robots = cell("r1")
    async with running_door(bus, robots) as url, visiting(url.removesuffix("ws")) as guest:
        assert "/r1/joints" in guest.channels


async def test_many_that_connect_and_drop_leave_nothing_behind_and_disturb_nobody() -> None:
    bus, robots = cell("r1")
    async with running_door(bus, robots) as url, visiting(foxglove(url)) as other:
        (name,) = await other.subscribe("/r1/joints")
        await other.silence()
        async with aiohttp.ClientSession() as session:
            for number in range(100):
                socket = await session.ws_connect(foxglove(url), protocols=SUBPROTOCOLS)
                if number % 2:
                    await socket.send_str('{"op":"subscribe","subscriptions":[{"id":0,"channelId":1}]}')
                socket._conn.transport.abort()  # type: ignore[union-attr]
        publish(bus, "r1/joints", 1)
        assert (await other.message())[0] == name
        with anyio.fail_after(PATIENCE_S):
            while len(bus.topics["r1/joints"].listeners) > 1:  # noqa: ASYNC110
                await anyio.sleep(0.01)


@pytest.mark.parametrize("op", ["\\ud800", "\\u0000", "ä" * 100])
async def test_an_op_of_odd_characters_is_a_warning(op: str) -> None:
    bus, robots = cell("r1")
    async with running_door(bus, robots) as url, visiting(foxglove(url)) as guest:
        await guest.socket.send_str(f'{{"op":"{op}"}}')
        assert (await guest.told("status"))["level"] in {1, 2}
        await guest.silence()
