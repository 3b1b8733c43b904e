"""What the loads are put together of: controllers, a gateway or another server, each a process of its own."""

from __future__ import annotations

import tempfile
import time
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import cast

import msgspec

from gateway.api.decoder import Frame
from gateway.api.normaliser import Normaliser
from gateway.config.printing import toml_value
from gateway.core.bus import Bus
from gateway.core.clock import SystemClock, Timeline
from gateway.core.events import EventRing
from gateway.core.publisher import Publisher
from gateway.core.registry import Registry
from gateway.server.wire import JSON, MSGPACK, Cut
from gateway.sim.scenario import find_scenario
from gateway.sim.simulator import Simulator, VirtualRobot
from gateway.testing.cell import free_port
from tests.bench.clients import Counted
from tests.bench.plan import Plan
from tests.bench.processes import Process, ProcessEndedError, module, running
from tests.bench.schedule import Phases
from tests.vendors.fairino.cnde_kit import Talk
from vendors.fairino.cnde import CndeDecoder, CndeOptions, Learned
from vendors.fairino.cnde_narrowing import Narrowing
from vendors.fairino.simulator.cnde import CndeBehaviour, CndeSession

_PATIENCE_S = 30.0
_ENCODINGS = {"json": JSON, "msgpack": MSGPACK}


class Metrics(msgspec.Struct, frozen=True):
    """Of the gateway's own metrics, what the benchmarks look at.

    Args:
        frames: Good frames of each robot.
        gaps: Frames that the controllers numbered and that did not come.
        missed: Samples that clients asked for and did not get.
        lag_sum_s: All lags of the loop together.
        beats: How many lags that are.
        late: How many of them were over 25 ms.
    """

    frames: tuple[int, ...]
    gaps: int
    missed: int
    lag_sum_s: float
    beats: int
    late: int


@contextmanager
def controllers(count: int, rate_hz: float, phases: Phases = "spread") -> Iterator[tuple[Process, list[int]]]:
    """Virtual controllers and their ports."""
    with running(module("controllers", count, rate_hz, phases)) as process:
        yield process, msgspec.json.decode(process.line(), type=list[int])


@contextmanager
def gateway(ports: list[int], flush_ms: float | None = None, *, recorder: bool = True) -> Iterator[tuple[Process, int]]:
    """A gateway that reads every one of some controllers, and its port."""
    with tempfile.TemporaryDirectory() as folder:
        port, path = free_port(), Path(folder) / "gateway.toml"
        path.write_text(configuration(port, ports, flush_ms, recorder=recorder), "utf-8")
        with running(["-m", "gateway", "run", "--config", str(path), "--log-level", "error"]) as process:
            _wait_until_read(port, len(ports))
            yield process, port


def configuration(port: int, controllers: list[int], flush_ms: float | None = None, *, recorder: bool = True) -> str:
    """The text of a gateway's configuration."""
    keys = cast("Simulator", Registry().simulator("fairino")).keys("cnde")
    text = f'[server]\nlisten = "127.0.0.1:{port}"\n' + (f"flush_ms = {flush_ms}\n" if flush_ms is not None else "")
    text += "" if recorder else "\n[recorder]\nenabled = false\n"
    for number, controller in enumerate(controllers, start=1):
        own = {"name": f"r{number}", "vendor": "fairino", "protocol": "cnde", "host": "127.0.0.1"}
        entry = {**own, **keys, "port": controller}
        text += "\n[[robots]]\n" + "".join(f"{key} = {toml_value(value)}\n" for key, value in entry.items())
    return text


@contextmanager
def relay(ports: list[int]) -> Iterator[tuple[Process, int]]:
    """The bare relay of some controllers, and its port."""
    with running(module("servers.relay", *ports)) as process:
        yield process, int(process.line())


@contextmanager
def publisher(name: str, plan: Plan, phases: Phases, encoding: str) -> Iterator[tuple[Process, int]]:
    """A server that publishes the bytes of a sample of the gateway's, and its port; `sdk` or `broadcast`."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "payload"
        path.write_bytes(payload(encoding))
        arguments = module(f"servers.{name}", plan.robots, plan.rate_hz, phases, encoding, path)
        with running(arguments) as process:
            yield process, int(process.line())


@contextmanager
def clients(port: int, dialect: str, count: int, topics: list[str]) -> Iterator[Process]:
    """Clients that count, once each has its first sample."""
    with running(module("clients", port, dialect, count, *topics)) as process:
        if process.line() != b"ready":
            raise ProcessEndedError("the clients are not ready")
        yield process


def counted(process: Process) -> Counted:
    """What some clients have got so far."""
    return msgspec.json.decode(process.ask("?"), type=Counted)


def metrics(port: int) -> Metrics:
    """The gateway's metrics of now."""
    with urllib.request.urlopen(f"http://127.0.0.1:{port}/metrics", timeout=_PATIENCE_S) as answer:
        lines = [line for line in answer.read().decode().splitlines() if not line.startswith("#")]
    found = [(name, float(value)) for name, _, value in (line.rpartition(" ") for line in lines)]

    def values(start: str) -> list[float]:
        return [value for name, value in found if name.startswith(f"robot_gateway_{start}")]

    beats = values("loop_lag_seconds_count")
    return Metrics(
        frames=tuple(map(int, values("frames_total"))),
        gaps=int(sum(values("gaps_total"))),
        missed=int(sum(values("missed_samples_total"))),
        lag_sum_s=sum(values("loop_lag_seconds_sum")),
        beats=int(sum(beats)),
        late=int(sum(beats) - sum(values('loop_lag_seconds_bucket{le="0.025"}'))),
    )


def _live() -> Talk:
    """A conversation with a moving robot, which sends every state that the gateway asks for."""
    options = CndeOptions()
    session = CndeSession(VirtualRobot(find_scenario("steady")), CndeBehaviour())
    talk = Talk(CndeDecoder(options, Learned(Narrowing(options.wanted))), session)
    talk.tick(10)
    return talk


def live_frame() -> Frame:
    """A frame of a moving robot."""
    return _live().frames[-1]


def live_decoder() -> CndeDecoder:
    """A decoder whose handshake is done: what is read of recordings is another."""
    return _live().decoder


def payload(encoding: str) -> bytes:
    """One encoded sample of the joints, as the gateway sends it."""
    frame = live_frame()
    bus, clock = Bus(EventRing(1)), SystemClock()
    signals = Registry().vendor("fairino").protocol("cnde").signals
    source = Publisher("r1", bus, Normaliser(signals, {"estop_polarity": "active_low"}), "live")
    source.begin("2026-01-01T00:00:00Z", Timeline(clock))
    source.frame(frame, clock.monotonic())
    topic = bus.topics["r1/joints"]
    assert topic.latest is not None
    return Cut(_ENCODINGS[encoding], None).encoded(topic, topic.latest)


def _wait_until_read(port: int, robots: int) -> None:
    until_s = time.monotonic() + _PATIENCE_S
    while time.monotonic() < until_s:
        try:
            if sum(count > 0 for count in metrics(port).frames) == robots:
                return
        except OSError:  # not there yet, or not quite
            pass
        time.sleep(0.1)
    raise ProcessEndedError("not every robot is read")
