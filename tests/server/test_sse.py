"""Streams of server-sent events, with aiohttp as the client and with curl."""

from __future__ import annotations

import json
import shutil
import subprocess
from collections.abc import AsyncIterator, Iterator, Sequence
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import dataclass, field

import aiohttp
import anyio
import anyio.lowlevel
import pytest

from gateway.server import outbox, sse
from tests.server.kit import BOOT, cell, last_name, publish, raise_command, raise_event, running_door


@dataclass
class Frame:
    """One event of a stream, as the specification of EventSource reads it."""

    kind: str = "message"
    data: list[str] = field(default_factory=list)
    name: str | None = None
    comment: str | None = None
    retry: str | None = None

    @property
    def value(self) -> dict[str, object]:
        """The data."""
        found = json.loads("\n".join(self.data))
        assert isinstance(found, dict)
        return found


def parsed(lines: Sequence[str]) -> Frame:
    frame = Frame()
    for line in lines:
        key, _, value = line.partition(":")
        value = value.removeprefix(" ")
        match key:
            case "event":
                frame.kind = value
            case "data":
                frame.data.append(value)
            case "id":
                frame.name = value
            case "retry":
                frame.retry = value
            case "":
                frame.comment = value
    return frame


def frames_of(text: str) -> Iterator[Frame]:
    """The whole frames of a text; one that was cut off is none."""
    for block in text.split("\n\n")[:-1]:
        yield parsed(block.split("\n"))


class Reader:
    """A client that keeps the last id, as EventSource does."""

    def __init__(self, answer: aiohttp.ClientResponse, last_id: str = "") -> None:
        self.answer = answer
        self.last_id = last_id

    async def next(self, kind: str | None = None) -> Frame:
        """The next frame, or the next of a kind."""
        with anyio.fail_after(5):
            while True:
                block = (await self.answer.content.readuntil(b"\n\n")).decode()
                frame = parsed(block.rstrip("\n").split("\n"))
                self.last_id = frame.name or self.last_id
                if kind is None or frame.kind == kind:
                    return frame

    async def events(self, count: int) -> list[object]:
        """The names of the next so many events."""
        return [(await self.next("event")).value["name"] for _ in range(count)]


def at(url: str, query: str) -> str:
    return url.replace("ws://", "http://").replace("/ws", f"/api/v1/stream?{query}")


@asynccontextmanager
async def reading(url: str, query: str, last_id: str = "") -> AsyncIterator[Reader]:
    headers = {"Last-Event-ID": last_id} if last_id else {}
    async with aiohttp.ClientSession() as session, session.get(at(url, query), headers=headers) as answer:
        assert (answer.status, answer.content_type) == (200, "text/event-stream")
        reader = Reader(answer, last_id)
        opening = await reader.next()
        assert (opening.comment, opening.retry) == ("robot-gateway", "1000")
        yield reader


async def test_samples_states_and_events_come_as_they_are() -> None:
    bus, robots = cell("r1")
    publish(bus, "r1/joints", 1)
    async with running_door(bus, robots) as url, reading(url, "topics=r1/joints,r1/events&fields=position") as stream:
        assert (await stream.next("sample")).value["data"] == {"position": [1.0, None]}
        publish(bus, "r1/joints", 2)
        sample = await stream.next()
        assert (sample.kind, sample.value["seq"], sample.name) == ("sample", 2, None)
        raise_event(bus, "r1")
        event = await stream.next()
        assert (event.kind, event.value["kind"], event.name) == ("event", "motion.started", f"{BOOT}:1")


async def test_a_rate_is_kept_and_the_newest_value_comes() -> None:
    bus, robots = cell("r1")
    async with running_door(bus, robots) as url, reading(url, "topics=r1/joints&rate_hz=20") as stream:
        for seq in range(1, 11):
            publish(bus, "r1/joints", seq)
        assert (await stream.next("sample")).value["seq"] == 10


async def test_mode_all_has_no_hole() -> None:
    bus, robots = cell("r1")
    async with running_door(bus, robots) as url, reading(url, "topics=r1/joints&mode=all") as stream:
        for seq in range(1, 201):
            publish(bus, "r1/joints", seq)
        assert [(await stream.next("sample")).value["seq"] for _ in range(200)] == list(range(1, 201))


async def test_what_was_missed_is_an_event_of_its_own() -> None:
    bus, robots = cell("r1", ring=3)
    for _ in range(5):
        raise_event(bus, "r1")
    async with running_door(bus, robots) as url:
        async with reading(url, f"topics=r1/joints,r1/events&since={BOOT}:1") as stream:
            for seq in range(3):
                publish(bus, "r1/joints", seq)
            missed = await stream.next("missed")
            assert (missed.value["events"], missed.name) == (1, None)
        async with reading(url, "topics=r1/events", "before:7") as stream:
            assert await stream.events(3) == [f"{BOOT}:3", f"{BOOT}:4", f"{BOOT}:5"]
            assert (await stream.next("missed")).value["events"] is None


async def test_a_stream_that_is_cut_before_its_first_event_is_resumed_from_where_it_began() -> None:
    bus, robots = cell("r1")
    raise_event(bus, "r1")
    async with running_door(bus, robots) as url:
        async with reading(url, "topics=r1/events") as stream:
            assert stream.last_id == f"{BOOT}:1"
        raise_event(bus, "r1")
        async with reading(url, "topics=r1/events", stream.last_id) as again:
            assert await again.events(1) == [f"{BOOT}:2"]


async def test_one_id_resumes_every_ring_wherever_the_stream_is_cut() -> None:
    bus, robots = cell("r1", "r2", command_ring=1000)
    names: list[str] = []
    got: list[object] = []
    last_id = ""

    def happen(number: int) -> None:
        raise_event(bus, "r1")
        names.append(bus.events.last_name)
        names.append(raise_command(bus, "r1", number))
        if number % 3 == 0:
            names.append(raise_command(bus, "r2", number))

    async with running_door(bus, robots) as url:
        for round_ in range(12):
            async with reading(url, f"topics=*/events,*/commands&since={BOOT}:0", last_id) as stream:
                for number in range(20):
                    happen(20 * round_ + number)
                    if number % 7 == 0:
                        await anyio.lowlevel.checkpoint()
                got += await stream.events(7 + 5 * round_)  # and cut off in the middle of the rest
                last_id = stream.last_id
        async with reading(url, "topics=*/events,*/commands", last_id) as stream:
            got += await stream.events(len(names) - len(got))
    assert len(last_id.split(",")) == 3
    assert sorted(map(str, got)) == sorted(names)
    for boot in {name.partition(":")[0] for name in names}:
        mine = [name for name in got if str(name).startswith(f"{boot}:")]
        assert mine == [name for name in names if name.startswith(f"{boot}:")]


async def test_the_last_id_goes_before_the_since_of_the_url() -> None:
    bus, robots = cell("r1")
    for _ in range(4):
        raise_event(bus, "r1")
    async with running_door(bus, robots) as url:
        async with reading(url, f"topics=r1/events&since={BOOT}:1") as stream:
            assert await stream.events(1) == [f"{BOOT}:2"]
        async with reading(url, f"topics=r1/events&since={BOOT}:1", f"{BOOT}:3") as stream:
            assert await stream.events(1) == [f"{BOOT}:4"]


async def test_an_idle_stream_beats_and_its_id_follows_what_others_raise(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sse, "HEARTBEAT_S", 0.02)
    monkeypatch.setattr(sse, "_WATCH_S", 0.01)
    bus, robots = cell("r1", "r2", ring=5)
    async with running_door(bus, robots) as url:
        async with reading(url, "topics=r1/events") as stream:
            for _ in range(50):
                raise_event(bus, "r2")
            frame = await stream.next()
            while frame.name != f"{BOOT}:50":
                assert frame.comment == "heartbeat"
                frame = await stream.next()
        async with reading(url, "topics=r1/events", stream.last_id) as stream:
            raise_event(bus, "r1")
            assert (await stream.next()).kind in {"event", "message"}
            assert bus.events.last_name == f"{BOOT}:51"


@pytest.mark.parametrize(
    ("query", "last_id", "status", "says"),
    [
        ("", "", 400, "topics is missing"),
        ("rate_hz=5", "", 400, "topics is missing"),
        ("topics=zzz", "", 404, "no topic matches zzz"),
        ("topics=", "", 404, "no topic matches"),
        ("topics=r1/joints&zzz=1", "", 400, "allowed are topics, rate_hz, mode, fields, since"),
        ("topics=r1/joints&topics=r2/joints", "", 400, "more than once"),
        ("topics=r1/joints&rate_hz=0", "", 400, "rate_hz"),
        ("topics=r1/joints&rate_hz=-1", "", 400, "rate_hz"),
        ("topics=r1/joints&rate_hz=1e9", "", 400, "rate_hz"),
        ("topics=r1/joints&rate_hz=nan", "", 400, "rate_hz"),
        ("topics=r1/joints&rate_hz=", "", 400, "rate_hz"),
        ("topics=r1/joints&mode=some", "", 400, "mode"),
        ("topics=r1/joints&mode=all&rate_hz=5", "", 400, "rate_hz"),
        ("topics=r1/joints&fields=zzz", "", 400, "zzz"),
        ("topics=r1/events&since=zzz", "", 400, "boot:seq"),
        ("topics=r1/events", "zzz", 400, "boot:seq"),
        ("topics=r1/events", f"{BOOT}:1,{BOOT}:2", 400, "more than once"),
        ("topics=" + ",".join(["*/joints"] * 300), "", 400, "256"),
        ("topics=" + "x" * 300, "", 400, "256"),
    ],
)
async def test_a_wrong_wish_is_refused_with_words(query: str, last_id: str, status: int, says: str) -> None:
    bus, robots = cell("r1", "r2")
    async with (
        running_door(bus, robots) as url,
        aiohttp.ClientSession() as session,
        session.get(at(url, query), headers={"Last-Event-ID": last_id}) as answer,
    ):
        assert (answer.status, answer.content_type) == (status, "application/json")
        assert says in (await answer.json())["message"]
        assert not any(topic.listeners for topic in bus.topics.values())


async def test_a_head_request_gets_the_headers_and_no_stream() -> None:
    bus, robots = cell("r1")
    async with (
        running_door(bus, robots) as url,
        aiohttp.ClientSession() as session,
        session.head(at(url, "topics=r1/joints")) as answer,
    ):
        assert (answer.status, answer.content_type) == (200, "text/event-stream")
        assert not bus.topics["r1/joints"].listeners


async def test_a_client_that_leaves_is_noticed_though_nothing_is_sent(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sse, "_WATCH_S", 0.02)
    bus, robots = cell("r1")
    async with running_door(bus, robots) as url:
        async with reading(url, "topics=r1/joints"):
            assert bus.topics["r1/joints"].listeners
        with anyio.fail_after(5):
            while bus.topics["r1/joints"].listeners:  # noqa: ASYNC110 - nobody tells the end of a stream
                await anyio.sleep(0.01)


async def test_many_that_connect_and_drop_leave_nothing_behind(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sse, "_WATCH_S", 0.02)
    bus, robots = cell("r1")
    async with running_door(bus, robots) as url, reading(url, "topics=r1/joints") as good:
        ask = "GET /api/v1/stream?topics=r1/joints HTTP/1.1\r\n"
        port = int(url.rpartition(":")[2].removesuffix("/ws"))
        for number in range(200):
            async with await anyio.connect_tcp("127.0.0.1", port) as stream:
                await stream.send(f"{ask}Host: localhost\r\n\r\n".encode()[: None if number % 3 else 30])
        with anyio.fail_after(5):
            while len(bus.topics["r1/joints"].listeners) > 1:  # noqa: ASYNC110 - nobody tells the end of a stream
                await anyio.sleep(0.01)
        publish(bus, "r1/joints", 7)
        assert (await good.next("sample")).value["seq"] == 7


async def test_a_client_that_does_not_read_is_cut_off_and_costs_the_others_nothing() -> None:
    bus, robots = cell("r1", "r2")
    async with (
        running_door(bus, robots, stuck_s=0.2) as url,
        reading(url, "topics=r1/vendor&mode=all") as lazy,
        reading(url, "topics=r2/joints") as good,
    ):
        lazy.answer.connection.transport.pause_reading()  # type: ignore[union-attr]
        with anyio.fail_after(10):
            seq = 0
            while bus.topics["r1/vendor"].listeners:
                seq += 1
                publish(bus, "r1/vendor", seq, {"filler": "x" * 100_000})
                publish(bus, "r2/joints", seq)
                assert (await good.next("sample")).value["seq"] == seq
        lazy.answer.connection.transport.abort()  # type: ignore[union-attr]


async def test_more_events_than_can_wait_cut_the_stream_and_it_resumes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(outbox, "QUEUED_EVENTS", 50)
    bus, robots = cell("r1")
    got: list[object] = []
    async with running_door(bus, robots) as url:
        async with reading(url, "topics=r1/events") as stream:
            for _ in range(80):
                raise_event(bus, "r1")
            with pytest.raises((aiohttp.ClientError, anyio.EndOfStream, EOFError)):  # noqa: PT012 - which one is it?
                while True:
                    got += await stream.events(1)
        monkeypatch.setattr(outbox, "QUEUED_EVENTS", 1000)
        async with reading(url, "topics=r1/events", stream.last_id) as again:
            got += await again.events(80 - len(got))
    assert got == [f"{BOOT}:{seq}" for seq in range(1, 81)]


async def test_the_end_of_the_gateway_ends_streams_as_whole_answers() -> None:
    bus, robots = cell("r1")
    async with AsyncExitStack() as clients:
        with anyio.fail_after(2):
            async with running_door(bus, robots) as url:
                streams = [await clients.enter_async_context(reading(url, "topics=r1/joints")) for _ in range(5)]
        for stream in streams:
            assert (await stream.answer.content.read()).endswith(b": the gateway is stopping\n\n")


needs_curl = pytest.mark.skipif(shutil.which("curl") is None, reason="curl is not installed")


async def curl(url: str, seconds: float, last_id: str = "") -> tuple[int, str]:
    """Read a stream with curl for so long; its exit code and what it printed."""
    command = ["curl", "-sN", "--max-time", str(seconds), "-H", f"Last-Event-ID: {last_id}", url]
    run = lambda: subprocess.run(command, capture_output=True, text=True, check=False)  # noqa: E731, S603
    done = await anyio.to_thread.run_sync(run)
    return done.returncode, done.stdout


@needs_curl
async def test_curl_resumes_after_a_cut_and_nothing_is_lost_or_doubled() -> None:
    bus, robots = cell("r1", command_ring=5000)
    names: list[object] = []
    got: list[object] = []
    last_id = f"{BOOT}:0"

    async def happen() -> None:
        for number in range(300):
            raise_event(bus, "r1")
            names.append(bus.events.last_name)
            names.append(raise_command(bus, "r1", number))
            await anyio.sleep(0.005)

    def take(text: str) -> str:
        kept = last_id
        for frame in frames_of(text):
            kept = frame.name or kept
            if frame.kind == "event":
                got.append(frame.value["name"])
        return kept

    async with running_door(bus, robots) as url, anyio.create_task_group() as tasks:
        tasks.start_soon(happen)
        for _ in range(4):
            code, text = await curl(at(url, "topics=r1/events,r1/commands"), 0.4, last_id)
            assert code == 28  # the time is over: it was cut
            last_id = take(text)
        while len(names) < 600:  # noqa: ASYNC110 - until all has happened
            await anyio.sleep(0.01)
        take((await curl(at(url, "topics=r1/events,r1/commands"), 0.4, last_id))[1])
    assert len(got) == len(set(got)) == 600
    for boot in (BOOT, last_name(bus, "r1/commands").partition(":")[0]):
        mine = [name for name in got if str(name).startswith(f"{boot}:")]
        assert mine == [f"{boot}:{seq}" for seq in range(1, 301)]


@needs_curl
async def test_curl_sees_the_end_of_the_gateway_as_a_good_end() -> None:
    bus, robots = cell("r1")
    found: list[tuple[int, str]] = []

    async def read(url: str) -> None:
        found.append(await curl(at(url, "topics=r1/link"), 5))

    async with anyio.create_task_group() as tasks, running_door(bus, robots) as url:
        tasks.start_soon(read, url)
        while not bus.topics["r1/link"].listeners:  # noqa: ASYNC110 - until curl is there
            await anyio.sleep(0.01)
        await anyio.sleep(0.05)
    ((code, text),) = found
    assert code == 0
    assert [frame.kind for frame in frames_of(text) if frame.data] == ["sample"]
