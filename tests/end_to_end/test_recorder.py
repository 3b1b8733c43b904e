"""The flight recorder at work: an emergency stop, everything of sixteen robots, and a gateway that is killed."""

from __future__ import annotations

import contextlib
import dataclasses
import os
import signal
import sys
import time
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager
from pathlib import Path
from typing import cast

import anyio
import msgspec
import pytest
from mcap.reader import make_reader

from gateway.api.model import Event, Power
from gateway.app import running
from gateway.config import parse
from gateway.config.printing import toml_value
from gateway.core.bus import Reading, Topic
from gateway.core.registry import Registry
from gateway.server.health import BEAT_S
from gateway.sim.scenario import SCENARIOS, Phase, Scenario
from gateway.sim.server import VirtualController, serve
from gateway.sim.simulator import Simulator
from gateway.testing.cell import free_port
from tests.end_to_end.test_delivery import cpu_s, memory_kib, process

pytestmark = pytest.mark.alone
SOAK_S = float(os.environ.get("SOAK_SECONDS", "0"))
RUN_S = min(SOAK_S, 60.0) or 4.0
PERIOD_MS, SLOW_MS = 8, 40
SHOWN_MS = 20  # where it is not the load that is looked at
SHARE = 0.15  # of a core
RING_MB = 2.0
OPEN_MB = 40.0  # blocks that are not closed yet, openings, and what Python keeps for itself
_JSON = msgspec.json.Encoder()
_ESTOP = Scenario(
    "estop soon",
    "an arm that works, and whose emergency stop is pressed",
    (
        dataclasses.replace(SCENARIOS["steady"].phases[0], seconds=6.0),
        Phase(name="pressed", seconds=600.0, ramp_s=0.1, power=Power.OFF, estop=True),
    ),
)


class Live:
    """Keeps what every topic says, as a listener of the bus gets it."""

    def __init__(self) -> None:
        self.samples: dict[tuple[str, str, int], tuple[int, bytes]] = {}
        self.events: list[str] = []

    def on_reading(self, topic: Topic, reading: Reading) -> None:
        sample = reading.sample(topic)
        self.samples[topic.name, sample.epoch, sample.seq] = (sample.t, _JSON.encode(sample))

    def on_event(self, _topic: Topic, event: Event) -> None:
        self.events.append(f"{event.robot} {event.kind.value}")


def entry(name: str, controller: VirtualController, period_ms: int = PERIOD_MS) -> str:
    simulator = cast("Simulator", Registry().simulator("fairino"))
    keys = {**simulator.keys("cnde"), "cnde": {"period_ms": period_ms}}
    own = {"name": name, "vendor": "fairino", "protocol": "cnde", "host": controller.host}
    values = {**own, **keys, "port": controller.number_of("cnde")}
    return "\n[[robots]]\n" + "".join(f"{key} = {toml_value(value)}\n" for key, value in values.items())


@pytest.mark.limit(120)
async def test_an_emergency_stop_makes_one_file_with_what_every_listener_was_told(tmp_path: Path) -> None:
    registry, live = Registry(), Live()
    simulator = cast("Simulator", registry.simulator("fairino"))
    async with AsyncExitStack() as stack:
        text = '[server]\nlisten = "127.0.0.1:0"\n[recorder]\n'
        text += f'directory = {toml_value(str(tmp_path))}\nbefore_s = 2\nafter_s = 1\non = ["estop.pressed"]\n'
        shows = (("127.0.50.1", 1, _ESTOP), ("127.0.51.1", 7, SCENARIOS["steady"]))
        number = 0
        for host, count, scenario in shows:
            cell = serve(simulator, host=host, port=0, count=count, scenario=scenario)
            for controller in await stack.enter_async_context(cell):
                number += 1
                text += entry(f"r{number}", controller, SHOWN_MS)
        gateway = await stack.enter_async_context(running(parse(text, "test", registry)))
        for topic in gateway.bus.topics.values():
            topic.listeners.append(live)
        assert gateway.recorder is not None
        with anyio.fail_after(90):
            while gateway.recorder.info.recordings + gateway.recorder.info.failed == 0:  # noqa: ASYNC110
                await anyio.sleep(0.1)
        await anyio.sleep(0.3)
        assert gateway.recorder.info.error is None
    assert "r1 estop.pressed" in live.events
    (path,) = tmp_path.glob("*.mcap")  # noqa: ASYNC240
    assert path.name.endswith("_r1_estop.pressed.mcap")
    compare(path, live, [f"r{number}" for number in range(1, 9)])


def compare(path: Path, live: Live, robots: list[str]) -> None:
    """Hold a file against what a listener was told: the same samples, and of the time that it covers all of them."""
    recorded: dict[tuple[str, str, int], bytes] = {}
    last: dict[str, int] = {}
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        about = {key: value for one in reader.iter_metadata() for key, value in one.metadata.items()}
        for _, channel, message in reader.iter_messages():
            group = channel.topic.partition("/")[2]
            if group in {"session", "events", "commands"} or group.startswith("raw/"):
                continue
            sample = msgspec.json.decode(message.data, type=_Named)
            recorded[sample.topic, sample.epoch, sample.seq] = message.data
            last[sample.topic] = max(last.get(sample.topic, sample.t), sample.t)
    from_t, to_t = int(about["from"]), int(about["to"])
    for name, data in recorded.items():
        if name in live.samples:
            assert data == live.samples[name][1], name
        else:  # a state that stood when the recording began, as the first frame in it shows it again
            sample = msgspec.json.decode(data, type=_Named)
            assert sample.t < from_t, name
            stood = [one for (topic, *_), one in live.samples.items() if topic == sample.topic and one[0] <= sample.t]
            assert msgspec.json.decode(max(stood)[1], type=_Named).data == sample.data, name
    for robot in robots:
        joints = f"{robot}/joints"
        assert to_t - last[joints] < 1_000_000
        told = [name for name, (t, _) in live.samples.items() if name[0] == joints and from_t <= t <= last[joints]]
        assert len(told) > 20
        assert all(name in recorded for name in told)


class _Named(msgspec.Struct):
    topic: str
    epoch: str
    seq: int
    t: int
    data: dict[str, object]


@asynccontextmanager
async def recorded_gateway(
    folder: Path, robots: int, *, period_ms: int = PERIOD_MS, **recorder: object
) -> AsyncIterator[tuple[int, int, str]]:
    """A gateway in a process of its own that reads pushing controllers of this one; its pid, port and socket."""
    simulator, port = cast("Simulator", Registry().simulator("fairino")), free_port()
    control = folder / "run" / "control.sock"
    control.parent.mkdir(mode=0o755)
    async with serve(simulator, host="127.0.52.1", port=0, count=robots, scenario="steady") as controllers:
        text = f'[server]\nlisten = "127.0.0.1:{port}"\ncontrol = "{control}"\n[recorder]\n'
        text += "".join(f"{key} = {toml_value(value)}\n" for key, value in recorder.items())
        text += "".join(entry(f"r{number}", one, period_ms) for number, one in enumerate(controllers, start=1))
        (folder / "gateway.toml").write_text(text, "utf-8")
        arguments = ("run", "--config", str(folder / "gateway.toml"), "--log-level", "error")
        async with process("gateway", *arguments) as gateway:
            await until_online(port, robots)
            yield gateway.pid, port, str(control)


@pytest.mark.soak
@pytest.mark.limit(3 * RUN_S + 90)
async def test_recording_every_byte_of_sixteen_robots_costs_little_and_loses_nothing(tmp_path: Path) -> None:
    out = tmp_path / "out"
    async with recorded_gateway(tmp_path, 16) as (pid, _, control):
        await anyio.sleep(1)
        idle = await share(RUN_S, pid)
        arguments = ("record", "-o", str(out), "--raw-only", "--control", control)
        async with process("gateway", *arguments) as recording:
            await anyio.sleep(2)
            busy = await share(RUN_S, pid, recording.pid)
            recording.send_signal(signal.SIGINT)
            with anyio.fail_after(30):
                assert await recording.wait() == 0
        idle = max(idle, await share(RUN_S / 2, pid)) if SOAK_S else idle
    (path,) = out.iterdir()
    print(f"\n16 robots, {RUN_S:g} s: {idle:.1%} of a core without recording, {busy:.1%} with it, both processes")
    assert busy - idle <= SHARE
    check_frames(path, 16, RUN_S)


async def share(seconds: float, *pids: int) -> float:
    """How much of a core some processes take."""
    began, used = time.monotonic(), sum(map(cpu_s, pids))
    await anyio.sleep(seconds)
    return (sum(map(cpu_s, pids)) - used) / (time.monotonic() - began)


def check_frames(path: Path, robots: int, seconds: float) -> None:
    """Nothing is lost of any robot: its chunks are numbered without a gap, and nothing was dropped."""
    numbers: dict[str, list[int]] = {}
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        about = {key: value for one in reader.iter_metadata() for key, value in one.metadata.items()}
        for _, channel, message in reader.iter_messages():
            robot, _, group = channel.topic.partition("/")
            if group in {"session", "raw/received", "raw/sent"}:
                numbers.setdefault(robot, []).append(message.sequence)
    assert about["dropped"] == "0"
    assert len(numbers) == robots
    for found in numbers.values():
        assert sorted(found) == list(range(1, len(found) + 1))
        assert len(found) > 0.5 * seconds * 1000 / PERIOD_MS


@pytest.mark.limit(60)
async def test_a_gateway_that_is_killed_in_a_recording_leaves_no_file_or_a_readable_one(tmp_path: Path) -> None:
    recordings = tmp_path / "recordings"
    async with recorded_gateway(tmp_path, 4, directory=str(recordings), before_s=2, after_s=60) as (pid, _, control):
        snapshot = await anyio.run_process([sys.executable, "-m", "gateway", "snapshot", "--control", control])
        assert snapshot.returncode == 0
        with anyio.fail_after(10):
            while not list(recordings.glob("*.part")):  # noqa: ASYNC110
                await anyio.sleep(0.02)
        await anyio.sleep(0.5)
        os.kill(pid, signal.SIGKILL)
        with anyio.fail_after(15):  # its writer notices, and cleans up
            while list(recordings.iterdir()):  # noqa: ASYNC110
                await anyio.sleep(0.05)


@pytest.mark.limit(120)
async def test_the_loop_is_not_held_up_while_sixteen_robots_are_written(tmp_path: Path) -> None:
    folder = tmp_path / "recordings"
    async with recorded_gateway(tmp_path, 16, directory=str(folder), before_s=1, after_s=1) as (_, port, control):
        await anyio.sleep(3)
        before = await lags(port, 3.0)
        async with process("gateway", "snapshot", "--control", control) as snapshot, own_lag() as own:
            during = await lags(port, 4.0)
            with anyio.fail_after(30):
                assert await snapshot.wait() == 0
        assert list(folder.glob("*.mcap*")), "nothing was recorded meanwhile"
    usual = max(before, own.mean_s)  # a machine that has other things to do holds both loops up
    print(f"\nlag of the loop, mean: {usual * 1000:.2f} ms without, {during * 1000:.2f} ms during a recording")
    assert during < max(4 * usual, BEAT_S)


@dataclasses.dataclass
class _Lag:
    """How late a loop was."""

    total_s: float = 0.0
    count: int = 0

    @property
    def mean_s(self) -> float:
        return self.total_s / max(1, self.count)


@asynccontextmanager
async def own_lag() -> AsyncIterator[_Lag]:
    """Watch how late the loop of this process is meanwhile."""
    lag = _Lag()

    async def watch() -> None:
        while True:
            due_s = anyio.current_time() + BEAT_S
            await anyio.sleep_until(due_s)
            lag.total_s, lag.count = lag.total_s + anyio.current_time() - due_s, lag.count + 1

    async with anyio.create_task_group() as tasks:
        tasks.start_soon(watch)
        yield lag
        tasks.cancel_scope.cancel()


async def lags(port: int, seconds: float) -> float:
    """Mean lag of the loop in some time, s."""
    before = await metrics(port)
    await anyio.sleep(seconds)
    after = await metrics(port)
    count, total = (after[f"loop_lag_seconds_{what}"] - before[f"loop_lag_seconds_{what}"] for what in ("count", "sum"))
    return total / max(1.0, count)


async def metrics(port: int) -> dict[str, float]:
    """What the gateway tells of itself and its robots; of what comes for each robot the sum."""
    async with await anyio.connect_tcp("127.0.0.1", port) as stream:
        await stream.send(b"GET /metrics HTTP/1.0\r\nHost: localhost\r\n\r\n")
        text = b"".join([data async for data in stream]).decode()
    found: dict[str, float] = {}
    for line in text.splitlines():
        if line.startswith("robot_gateway_"):
            name, _, value = line.rpartition(" ")
            online = 'state="ONLINE"' in name
            short = name.partition("{")[0].removeprefix("robot_gateway_") + ("_online" if online else "")
            found[short] = found.get(short, 0.0) + float(value)
    return found


async def until_online(port: int, robots: int) -> None:
    """Wait until every robot is read, also on a machine that has other things to do."""
    with anyio.fail_after(45):
        while True:
            with contextlib.suppress(OSError):
                if (await metrics(port)).get("link_state_online", 0) >= robots:
                    return
            await anyio.sleep(0.2)


@pytest.mark.soak
@pytest.mark.skipif(not SOAK_S, reason="64 controllers and a gateway want a machine of their own")
@pytest.mark.limit(2 * RUN_S + 120)
async def test_the_rings_of_sixty_four_robots_stay_in_their_bound(tmp_path: Path) -> None:
    folder = tmp_path / "off"
    folder.mkdir()
    async with recorded_gateway(folder, 64, period_ms=SLOW_MS, enabled=False) as (pid, _, _):
        await anyio.sleep(RUN_S)
        without = memory_kib(pid)
    folder = tmp_path / "on"
    folder.mkdir()
    async with recorded_gateway(folder, 64, period_ms=SLOW_MS, ring_mb=RING_MB) as (pid, port, _):
        await anyio.sleep(RUN_S)
        with_it, kept = memory_kib(pid), (await metrics(port))["recorder_ring_bytes"]
    print(f"\n64 robots, {RUN_S:g} s: {without} KiB without rings, {with_it} KiB with {kept / 1e6:.1f} MB in them")
    assert 0 < kept <= RING_MB * 1e6
    assert with_it - without < (RING_MB + OPEN_MB) * 1024
