"""Many cells into one hub, and who reads the plant keeps up: `python -m tests.export.many 10 25 50`.

One load program is all the cells; the server, the reader behind the plant's page and `tail` are processes of their own,
so that the share of a core that each takes can be told apart.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import anyio
import msgspec
from nats.js.api import KeyValueConfig, StreamConfig

from gateway import logs
from gateway.api.model import Event
from gateway.config.exports import NatsAccess
from gateway.core.bus import Change, Reading, Topic
from gateway.export.subjects import event_subjects
from gateway.plant import Plant as Read
from gateway.plant import reading
from tests.export.kit import Server, free_port, nats_server, now_us, talking

ROBOTS = 8
_START_S = 3.0  # tail is there by then
_TICKS = 100.0  # of the kernel's clock, in a second


class Row(msgspec.Struct):
    """What one number of cells came to."""

    cells: int
    events: int
    acknowledged: int
    shown: int
    tailed: int
    samples_per_s: float
    latency_p50_ms: float
    latency_p99_ms: float
    load_cpu: float
    server_cpu: float
    server_mb: float
    reader_cpu: float
    stored_mb: float
    live: int


class _Latencies:
    """How old samples are when they come to the reader's bus; both are on this machine."""

    def __init__(self) -> None:
        self.ages_ms: list[float] = []

    def on_reading(self, topic: Topic, reading: Reading) -> None:
        self.ages_ms.append((now_us() - reading.sample(topic).t) / 1000)

    def on_event(self, topic: Topic, event: Event) -> None:
        pass

    def on_topics(self, change: Change) -> None:
        for topic in change.added:
            if topic.group.name == "tcp":
                topic.listeners = [*topic.listeners, self]


def cpu_s(pid: int) -> float:
    """How long a process has computed."""
    words = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(words[11]) + int(words[12])) / _TICKS


def rss_mb(pid: int) -> float:
    """What it has in memory."""
    return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * 4096 / 1e6


@contextmanager
def tailing(server: Server, file: Path) -> Iterator[None]:
    """`robot-gateway tail` of all events into a file."""
    command = [sys.executable, "-m", "gateway", "tail", "--nats", server.url, "plant1.*.*.events", "-f", "json"]
    with file.open("wb") as out, subprocess.Popen(command, stdout=out) as process:  # noqa: S603 - our own program
        try:
            yield
        finally:
            process.terminate()


async def measure(cells: int, seconds: float, samples_hz: float = 1.0) -> Row:
    """Run so many cells for so long, each topic's samples at a rate."""
    with tempfile.TemporaryDirectory() as name, nats_server(Path(name) / "hub", port=free_port()) as server:
        folder = Path(name)
        command = [sys.executable, "-m", "tests.export.load", "--server", server.url, "--folder", name]
        command += ["--cells", str(cells), "--robots", str(ROBOTS), "--seconds", str(seconds)]
        command += ["--samples_hz", str(samples_hz)]
        async with talking(server.url) as client:
            await client.jetstream().create_key_value(KeyValueConfig(bucket="plant1"))
            await client.jetstream().add_stream(StreamConfig(name="plant1-events", subjects=event_subjects("plant1")))
        with tailing(server, folder / "tail"):
            await anyio.sleep(_START_S)
            async with reading(NatsAccess(servers=(server.url,)), "plant1") as read:
                latencies = _Latencies()
                read.bus.watch(latencies)
                pid = server.pid
                begun = (time.monotonic(), cpu_s(pid), time.process_time())
                done = await anyio.run_process(command)
                took_s = time.monotonic() - begun[0]
                row = msgspec.json.decode(done.stdout)
                shares = ((cpu_s(pid) - begun[1]) / took_s, (time.process_time() - begun[2]) / took_s)
                live = sum(cell.live for cell in read.cells.cells.values())
                await _settled(read, row["acknowledged"])
                shown = read.bus.events.last_seq
                await anyio.sleep(1)
        async with talking(server.url) as client:
            stored = (await client.jetstream().account_info()).storage / 1e6
        ages = sorted(latencies.ages_ms) or [0.0]
        return Row(
            cells=cells,
            events=row["events"],
            acknowledged=row["acknowledged"],
            shown=shown,
            tailed=len((folder / "tail").read_bytes().splitlines()),
            samples_per_s=round(row["samples"] / seconds),
            latency_p50_ms=round(ages[len(ages) // 2], 1),
            latency_p99_ms=round(ages[len(ages) * 99 // 100], 1),
            load_cpu=row["cpu_share"],
            server_cpu=round(shares[0], 3),
            server_mb=round(rss_mb(pid)),
            reader_cpu=round(shares[1], 3),
            stored_mb=round(stored, 1),
            live=live,
        )


async def _settled(read: Read, events: int) -> None:
    with anyio.move_on_after(5):
        while read.bus.events.last_seq < events:  # noqa: ASYNC110 - a count has no event
            await anyio.sleep(0.05)


async def main(*cells: str) -> None:
    """Measure, a row an argument: so many cells, or `50@10` for samples at 10 Hz."""
    for one in cells:
        number, _, rate = one.partition("@")
        row = await measure(int(number), 10.0, float(rate or 1.0))
        sys.stdout.write(f"{msgspec.json.encode(row).decode()}\n")
        sys.stdout.flush()


if __name__ == "__main__":
    logs.configure("error")
    anyio.run(main, *(sys.argv[1:] or ["10"]))
