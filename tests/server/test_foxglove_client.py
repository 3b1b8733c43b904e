"""The public npm client of the Foxglove protocol reads virtual robots through the gateway: a foreign witness."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import anyio
import msgspec
import pytest
from anyio.abc import Process
from anyio.streams.buffered import BufferedByteReceiveStream
from jsonschema import Draft202012Validator

from gateway.api import plain_schemas as schemas
from gateway.api.model import GROUPS, Event
from gateway.core.bus import Bus, FrameReading, Reading, Topic
from gateway.server.foxglove import SUBPROTOCOLS
from gateway.testing.cell import virtual_cell

FOREIGN = Path(__file__).parents[1] / "foreign" / "foxglove"
PATIENCE_S = 15
INSTALL_S = 120
LINE = 1 << 24
EXACT_DIGITS = 16
Json = dict[str, object]


@pytest.fixture(scope="session")
def node() -> str:
    """Node with the pinned packages in place; installed by `npm ci` when they are not."""
    found, npm = shutil.which("node"), shutil.which("npm")
    if found is None or npm is None:
        pytest.skip("node and npm are needed for the public Foxglove client")
    lock, installed = FOREIGN / "package-lock.json", FOREIGN / "node_modules" / ".package-lock.json"
    if not installed.exists() or installed.stat().st_mtime < lock.stat().st_mtime:
        command = [npm, "ci", "--ignore-scripts", "--no-audit", "--no-fund"]
        done = subprocess.run(command, cwd=FOREIGN, capture_output=True, text=True, timeout=INSTALL_S, check=False)  # noqa: S603
        if done.returncode:
            fail = pytest.fail if os.environ.get("CI") else pytest.skip
            fail(f"npm ci could not install the public Foxglove client: {done.stderr.strip()[-300:]}")
    return found


class Recorder:
    """Listens to the bus beside the client: what every reading said, and every event."""

    def __init__(self, bus: Bus) -> None:
        self.samples: dict[tuple[object, object, object], Json] = {}
        self.events: list[Json] = []
        self._topics = bus.topics
        for topic in bus.topics.values():
            topic.listeners = [*topic.listeners, self]
            if topic.latest is not None:
                self._keep(topic, topic.latest)

    def on_reading(self, topic: Topic, reading: Reading) -> None:
        """Keep what it says of its topic; a frame says something of every topic of the robot."""
        if not isinstance(reading, FrameReading):
            self._keep(topic, reading)
            return
        for group in reading.stream.readers:
            known = self._topics.get(f"{topic.robot}/{group}")
            if known is not None and known.latest is reading:
                self._keep(known, reading)
        self._keep(topic, reading)

    def on_event(self, topic: Topic, event: Event) -> None:  # noqa: ARG002 - a listener's signature
        """Keep it."""
        self.events.append(plain(event))

    def _keep(self, topic: Topic, reading: Reading) -> None:
        sample = plain(reading.sample(topic))
        self.samples[sample["topic"], sample["epoch"], sample["seq"]] = sample


def plain(value: msgspec.Struct) -> Json:
    """What a struct is in JSON."""
    return msgspec.json.decode(msgspec.json.encode(value), type=dict[str, object])


def number(digits: str) -> float:
    """A number without a point: JavaScript writes large floats so."""
    return int(digits) if len(digits) <= EXACT_DIGITS else float(digits)


class NpmClient:
    """The npm client in a process of its own.

    Attributes:
        channels: What is advertised, by id.
        wanted: The channel of each subscription.
        messages: What came, with the subscription's channel.
        others: All other events by their name.
    """

    def __init__(self, process: Process) -> None:
        assert process.stdout is not None
        self._process = process
        self._lines = BufferedByteReceiveStream(process.stdout)
        self.channels: dict[int, Json] = {}
        self.wanted: dict[int, Json] = {}
        self.messages: list[tuple[Json, int, Json]] = []
        self.others: dict[str, list[object]] = {}

    async def tell(self, line: Json) -> None:
        """Tell it what to do."""
        assert self._process.stdin is not None
        await self._process.stdin.send(msgspec.json.encode(line) + b"\n")

    async def next(self) -> str:
        """Read one line; what kind of event it was."""
        with anyio.fail_after(PATIENCE_S):
            told = json.loads(await self._lines.receive_until(b"\n", LINE), parse_int=number)
        event, value = told["event"], told["value"]
        if event == "message":
            channel = self.wanted[value["subscriptionId"]]
            self.messages.append((channel, int(value["timestamp"]), value["payload"]))
        else:
            if event == "advertise":
                self.channels |= {channel["id"]: channel for channel in value}
            self.others.setdefault(event, []).append(value)
        return str(event)

    async def until(self, event: str) -> object:
        """Read on to an event."""
        while await self.next() != event:
            pass
        return self.others[event][-1]

    async def subscribe_to_all(self) -> None:
        """Subscribe to every channel, as Foxglove does one by one."""
        await self.tell({"send": '{"op":"nonsense"}'})
        await self.until("status")  # all advertisements have come
        for number, channel in enumerate(self.channels.values()):
            self.wanted[number] = channel  # the client counts them so
            await self.tell({"call": "subscribe", "args": [channel["id"]]})

    def of(self, topic: str) -> list[Json]:
        """The payloads that came on a topic."""
        return [payload for channel, _, payload in self.messages if channel["topic"] == topic]

    async def until_there_are(self, **counts: int) -> None:
        """Read on until so many messages have come on some topics of r1."""
        with anyio.fail_after(PATIENCE_S):
            while any(len(self.of(f"/r1/{name}")) < count for name, count in counts.items()):
                await self.next()


@asynccontextmanager
async def npm_client(node: str, url: str, protocol: str) -> AsyncIterator[NpmClient]:
    """Run the npm client against a gateway."""
    command = [node, str(FOREIGN / "client.mjs"), url, protocol]
    async with await anyio.open_process(command, stderr=None) as process:
        try:
            client = NpmClient(process)
            assert await client.until("open") == protocol
            yield client
        finally:
            if process.returncode is None:
                process.kill()


def strict(schema: object) -> object:
    """The schema with null where it is allowed, for a validator that knows nothing of `nullable`."""
    if isinstance(schema, list):
        return [strict(part) for part in schema]
    if not isinstance(schema, dict):
        return schema
    found = {key: strict(value) for key, value in schema.items()}
    if found.pop("nullable", False) is True:
        found["type"] = [found["type"], "null"]
        if "enum" in found:
            found["enum"] = [*found["enum"], None]  # type: ignore[misc]
    return found


def check_schemas(client: NpmClient) -> None:
    """Every message fits the schema of its channel."""
    validators = {
        channel["id"]: Draft202012Validator(
            msgspec.convert(strict(msgspec.json.decode(str(channel["schema"]))), dict[str, object])
        )
        for channel in client.channels.values()
    }
    for channel, _, payload in client.messages:
        validators[channel["id"]].validate(payload)


def check_samples(client: NpmClient, recorder: Recorder) -> None:
    """Every sample is one that the bus had, with its time, and each topic is in order."""
    last: dict[object, tuple[object, int]] = {}
    n_compared = 0
    for channel, t_ns, payload in client.messages:
        if not str(channel["schemaName"]).startswith("robot_gateway.") or "data" not in payload:
            continue
        assert channel["topic"] == f"/{payload['topic']}"
        assert t_ns == int(str(payload["t"])) * 1000
        known = recorder.samples.get((payload["topic"], payload["epoch"], payload["seq"]))
        is_latched = payload["topic"] not in last and GROUPS[str(payload["topic"]).split("/")[1]].delivery == "state"
        assert known == payload or (known is None and is_latched)
        n_compared += known is not None
        epoch, seq = last.get(payload["topic"], (None, -1))
        assert epoch != payload["epoch"] or int(str(payload["seq"])) > seq
        last[payload["topic"]] = (payload["epoch"], int(str(payload["seq"])))
    assert n_compared >= 20


def check_poses(client: NpmClient) -> None:
    """Every pose and transform is that of the sample of the same time."""
    samples = {t_ns: payload["data"] for channel, t_ns, payload in client.messages if channel["topic"] == "/r1/tcp"}
    for channel, t_ns, payload in client.messages:
        if channel["topic"] == "/r1/tcp/pose":
            pose = msgspec.convert(payload["pose"], dict[str, dict[str, float]])
            told = msgspec.convert(samples[t_ns], dict[str, object])["pose"]
            assert told == {part: list(values.values()) for part, values in pose.items()}
            stamp = msgspec.convert(payload["timestamp"], dict[str, int])
            assert stamp["sec"] * 10**9 + stamp["nsec"] == t_ns


def check_events(client: NpmClient, recorder: Recorder) -> None:
    """The log has every event of the bus since it was asked for, in order, once."""
    logged = [line["event"] for line in client.of("/r1/events")]
    assert logged
    begin = recorder.events.index(msgspec.convert(logged[0], dict[str, object]))
    assert logged == recorder.events[begin : begin + len(logged)]


@pytest.mark.limit(INSTALL_S + 60)
@pytest.mark.parametrize(("protocol", "path"), [(SUBPROTOCOLS[0], "/foxglove"), (SUBPROTOCOLS[1], "/")])
async def test_the_npm_client_sees_what_the_bus_says(node: str, protocol: str, path: str) -> None:
    async with virtual_cell("rainbow", count=2) as cell:
        url = cell.url.removesuffix("/ws") + path
        recorder = Recorder(cell.gateway.bus)
        async with npm_client(node, url, protocol) as client:
            await client.subscribe_to_all()
            await client.until_there_are(joints=20, events=1, tf=10, status=1, link_stats=1)
            await client.tell({"call": "close", "args": []})
            await client.until("close")
    topics = {str(channel["topic"]) for channel in client.channels.values()}
    assert topics == {f"/{name}" for name in cell.gateway.bus.topics} | {
        f"/r{number}/{name}" for number in (1, 2) for name in ("tcp/pose", "tf")
    }
    assert "error" not in client.others
    check_samples(client, recorder)
    check_poses(client)
    check_events(client, recorder)
    check_schemas(client)


@pytest.mark.limit(INSTALL_S + 60)
@pytest.mark.parametrize(("vendor", "spoken"), [("fairino", "cnde"), ("xcore", "external"), ("xcore", "objects")])
async def test_every_vendor_fits_its_schemas(node: str, vendor: str, spoken: str) -> None:
    async with virtual_cell(vendor, protocol=spoken) as cell:
        recorder = Recorder(cell.gateway.bus)
        async with npm_client(node, cell.url.removesuffix("/ws") + "/foxglove", SUBPROTOCOLS[0]) as client:
            await client.subscribe_to_all()
            await client.until_there_are(joints=8, link_stats=1)
    assert "error" not in client.others
    check_samples(client, recorder)
    check_schemas(client)


@pytest.mark.limit(INSTALL_S + 60)
async def test_the_npm_client_unsubscribes_and_reads_statuses(node: str) -> None:
    async with (
        virtual_cell("rainbow") as cell,
        npm_client(
            node, cell.url.removesuffix("/ws") + "/foxglove?topics=*/joints&rate_hz=20", SUBPROTOCOLS[0]
        ) as client,
    ):
        await client.subscribe_to_all()
        assert [channel["topic"] for channel in client.wanted.values()] == ["/r1/joints"]
        await client.until_there_are(joints=3)
        await client.tell({"call": "unsubscribe", "args": [0]})
        await client.tell({"call": "subscribe", "args": [12345]})
        status = msgspec.convert(await client.until("status"), dict[str, object])
        assert (status["level"], "no channel 12345" in str(status["message"])) == (2, True)
        n_before = len(client.messages)
        await client.tell({"call": "fetchAsset", "args": ["package://x", 1]})
        assert "assets" in str(await client.until("status"))
        assert len(client.messages) == n_before


@pytest.mark.limit(INSTALL_S + 60)
async def test_the_well_known_schemas_are_those_of_the_npm_package(node: str) -> None:
    async with (
        virtual_cell("rainbow") as cell,
        npm_client(node, cell.url.removesuffix("/ws") + "/foxglove", SUBPROTOCOLS[0]) as client,
    ):
        (told,) = client.others["schemas"]
    ours = {"Log": schemas.LOG, "PoseInFrame": schemas.POSE_IN_FRAME, "FrameTransforms": schemas.FRAME_TRANSFORMS}
    assert without_words(ours) == without_words(told)


def without_words(schema: object) -> object:
    """A schema without what only people read."""
    if isinstance(schema, list):
        return [without_words(part) for part in schema]
    if not isinstance(schema, dict):
        return schema
    return {key: without_words(value) for key, value in schema.items() if key not in {"description", "$comment"}}
