"""Delivery under load: many clients, storms of events, and clients that behave badly while others listen."""

from __future__ import annotations

import os
import resource
import statistics
import sys
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import cast

import anyio
import anyio.abc
import msgspec
import pytest
from anyio.streams.buffered import BufferedByteReceiveStream

from gateway.config.printing import toml_value
from gateway.core.bus import Bus
from gateway.core.registry import Registry
from gateway.sim.server import serve
from gateway.sim.simulator import Simulator
from gateway.testing.cell import free_port
from tests.end_to_end.load_clients import RATE_HZ, Report
from tests.end_to_end.load_faults import Rude
from tests.server.kit import BOOT, Talk, cell, publish, raise_event, running_door, talking

pytestmark = pytest.mark.alone
SOAK_S = float(os.environ.get("SOAK_SECONDS", "0"))
RUN_S = SOAK_S or 4.0
STORM_S = 10.0 if SOAK_S else 2.0
ROBOTS, PERIOD_MS = 16, 8
FULL, RATED, SILENT = 50, 10, 1
EDGES_HZ = 1000
MEMORY_KIB = 200_000
_ROOT = Path(__file__).parents[2]


@asynccontextmanager
async def process(*arguments: str) -> AsyncIterator[anyio.abc.Process]:
    """Run a Python module in a process of its own."""
    async with await anyio.open_process([sys.executable, "-m", *arguments], cwd=_ROOT, stderr=None) as running:
        try:
            yield running
        finally:
            if running.returncode is None:
                running.kill()


class Child:
    """A process that is told and answers in lines."""

    def __init__(self, running: anyio.abc.Process) -> None:
        assert running.stdin is not None
        assert running.stdout is not None
        self.stdin = running.stdin
        self._lines = BufferedByteReceiveStream(running.stdout)

    async def line(self) -> bytes:
        """Its next line."""
        with anyio.fail_after(20):
            return await self._lines.receive_until(b"\n", 1 << 24)

    async def tell(self, word: str) -> None:
        """Tell it something that it repeats."""
        await self.stdin.send(word.encode() + b"\n")
        assert await self.line() == word.encode()


@asynccontextmanager
async def loaded_gateway(folder: Path) -> AsyncIterator[tuple[anyio.abc.Process, int]]:
    """A gateway in a process of its own that reads sixteen pushing controllers of this one; its port."""
    registry, port = Registry(), free_port()
    simulator = cast("Simulator", registry.simulator("fairino"))
    keys = {**simulator.keys("cnde"), "cnde": {"period_ms": PERIOD_MS}}
    async with serve(simulator, port=0, count=ROBOTS, scenario="steady") as controllers:
        text = f'[server]\nlisten = "127.0.0.1:{port}"\n'
        for number, controller in enumerate(controllers, start=1):
            own = {"name": f"r{number}", "vendor": "fairino", "protocol": "cnde", "host": controller.host}
            entry = {**own, **keys, "port": controller.number_of("cnde")}
            text += "\n[[robots]]\n" + "".join(f"{key} = {toml_value(value)}\n" for key, value in entry.items())
        path = folder / "gateway.toml"
        path.write_text(text, "utf-8")
        async with process("gateway", "run", "--config", str(path), "--log-level", "error") as running:
            await until_all_are_online(port)
            yield running, port


async def until_all_are_online(port: int) -> None:
    """Wait until every robot is read."""
    with anyio.fail_after(15):
        while True:
            try:
                async with talking(f"ws://127.0.0.1:{port}/ws") as talk:
                    robots = msgspec.convert((await talk.ask("robots"))["robots"], list[dict[str, object]])
                    if all(cast("int", robot["frames"]) > 0 for robot in robots):
                        return
            except OSError:
                pass
            await anyio.sleep(0.1)


def cpu_s(pid: int) -> float:
    """CPU time of a process."""
    words = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(words[11]) + int(words[12])) / os.sysconf("SC_CLK_TCK")


def memory_kib(pid: int) -> int:
    """Resident memory of a process."""
    return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * resource.getpagesize() // 1024


@pytest.mark.soak
@pytest.mark.limit(RUN_S + 60)
async def test_fifty_clients_that_ask_for_all_miss_nothing_beside_one_that_never_reads(tmp_path: Path) -> None:
    async with loaded_gateway(tmp_path) as (gateway, port):
        numbers = [str(count) for count in (FULL, RATED, SILENT)]
        async with process("tests.end_to_end.load_clients", "127.0.0.1", str(port), *numbers) as running:
            child = Child(running)
            assert await child.line() == b"ready"
            before_s, memory = cpu_s(gateway.pid), [memory_kib(gateway.pid)]
            for _ in range(10):
                await anyio.sleep(RUN_S / 10)
                memory.append(memory_kib(gateway.pid))
            used_s = cpu_s(gateway.pid) - before_s
            await child.stdin.aclose()
            report = msgspec.json.decode(await child.line(), type=Report)
    print(f"\n{RUN_S:g} s, {ROBOTS} robots, {FULL} full, {RATED} at {RATE_HZ} Hz, {SILENT} silent: {report.delivered}")
    print(
        f"delivered, {used_s / report.delivered * 1e6:.2f} µs of CPU each, all of the gateway in it; {max(memory)} KiB"
    )
    assert (report.holes, report.missed, report.lost) == (0, 0, 0)
    assert report.n_topics == 2 * ROBOTS
    assert min(report.full) > 0.5 * max(report.full) > 0
    assert max(memory) < MEMORY_KIB
    for times in report.rated:
        for topic, stamps in times.items():
            assert len(set(stamps)) == len(stamps), topic
            stalls = [(a, b) for a, b in report.stalls.get(topic, []) if a >= stamps[0] and b <= stamps[-1]]
            silent_s = 0 if SOAK_S else sum(b - a for a, b in stalls) / 1e6  # a machine that is shared stands still
            slots = ((stamps[-1] - stamps[0]) / 1e6 - silent_s) * RATE_HZ
            assert abs(len(stamps) - 1 - slots) <= 1 + 2 * len(stalls), topic


async def storm(bus: Bus, count: int) -> None:
    """Raise so many edges, a thousand a second."""
    start_s, told = anyio.current_time(), 0
    while told < count:
        for _ in range(min(count, int((anyio.current_time() - start_s) * EDGES_HZ)) - told):
            raise_event(bus, "r1")
            told += 1
        await anyio.sleep(0.001)


async def read_events(talk: Talk, names: list[str], until: int) -> None:
    """Take events until so many are there."""
    while len(names) < until:
        message = await talk.receive()
        assert message["op"] in {"event", "result"}, message
        events = msgspec.convert(message.get("events", []), list[dict[str, object]])
        names += [str(event["name"]) for event in events]


@pytest.mark.soak
@pytest.mark.limit(STORM_S + 20)
async def test_a_client_that_is_cut_off_in_a_storm_of_events_resumes_and_has_all_of_them_once() -> None:
    bus, robots = cell("r1")
    count, names, others = int(STORM_S * EDGES_HZ), list[str](), list[str]()
    async with running_door(bus, robots) as url, talking(url) as other, anyio.create_task_group() as tasks:
        await other.ask("subscribe", topics=["*/events"])
        async with talking(url) as talk:
            await talk.ask("subscribe", topics=["*/events"])
            tasks.start_soon(storm, bus, count)
            tasks.start_soon(read_events, other, others, count)
            await read_events(talk, names, count // 4)
            talk.socket._conn.transport.abort()  # type: ignore[union-attr]
        await anyio.sleep(STORM_S / 2)
        async with talking(url) as talk:
            await talk.send({"op": "subscribe", "id": 1, "topics": ["*/events"], "since": names[-1]})
            await read_events(talk, names, count)
    assert names == [f"{BOOT}:{number}" for number in range(1, count + 1)]
    assert others == names


ROUNDS = 5
WINDOW_S = 1.0 if SOAK_S else 0.1
LEAST = 20  # samples that a percentile is made of
# The scheduler of a shared machine takes the loop away for some ms at a time: below this a ratio says nothing of the
# gateway. A client that the others wait for costs far more: the gateway's patience is measured in seconds.
FLOOR_S = 0.02
FAULTS = [name for name in vars(Rude) if not name.startswith("_")]


@dataclass
class Listening:
    """A good client in mode all, and how long its samples were under way."""

    sent_s: dict[int, float] = field(default_factory=dict)
    taken_s: list[float] = field(default_factory=list)
    seqs: list[int] = field(default_factory=list)

    async def publish(self, bus: Bus) -> None:
        """Publish a sample every millisecond."""
        seq = 0
        while True:
            seq += 1
            self.sent_s[seq] = anyio.current_time()
            publish(bus, "r1/joints", seq)
            await anyio.sleep(0.001)

    async def read(self, talk: Talk) -> None:
        """Take them."""
        while True:
            for sample in await talk.samples():
                seq = cast("int", sample["seq"])
                self.seqs.append(seq)
                self.taken_s.append(anyio.current_time() - self.sent_s[seq])

    async def p99_s(self) -> float:
        """Of the samples of the next while."""
        self.taken_s.clear()
        await anyio.sleep(WINDOW_S)
        while len(self.taken_s) < LEAST:  # noqa: ASYNC110 - the machine was taken away for the whole window
            await anyio.sleep(WINDOW_S)
        return statistics.quantiles(self.taken_s, n=100)[-1]


@pytest.mark.soak
@pytest.mark.limit(2 * ROUNDS * WINDOW_S + 30)
@pytest.mark.parametrize("fault", FAULTS)
async def test_a_bad_client_costs_the_others_neither_a_sample_nor_time(fault: str) -> None:
    bus, robots = cell("r1", "r2")
    quiet_s, faulty_s, good = [], [], Listening()
    async with running_door(bus, robots, stuck_s=0.2) as url, talking(url) as talk, anyio.create_task_group() as tasks:
        await talk.ask("subscribe", topics=["r1/joints"], mode="all")
        tasks.start_soon(good.publish, bus)
        tasks.start_soon(good.read, talk)
        port = url.rpartition(":")[2].partition("/")[0]
        async with process("tests.end_to_end.load_faults", "127.0.0.1", port, fault) as running:
            child = Child(running)
            for _ in range(ROUNDS):
                await child.tell("rest")
                quiet_s.append(await good.p99_s())
                await child.tell("go")
                faulty_s.append(await good.p99_s())
        tasks.cancel_scope.cancel()
    quiet, faulty = statistics.median(quiet_s), statistics.median(faulty_s)
    print(f"\n{fault}: p99 {quiet * 1e3:.2f} ms without, {faulty * 1e3:.2f} ms with it")
    assert good.seqs == list(range(good.seqs[0], good.seqs[0] + len(good.seqs)))
    assert faulty <= max(2 * quiet, FLOOR_S)
