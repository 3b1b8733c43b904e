"""Recordings for tests: of virtual robots with what a live subscriber heard, and small ones made of known frames."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import cast

import anyio
import msgspec

from gateway.api.model import Event, Sample
from gateway.config.printing import toml_value
from gateway.core.bus import Reading, Topic
from gateway.core.registry import Registry
from gateway.core.settings import RobotSettings
from gateway.record.chunks import Chunk, pack
from gateway.record.making import Making
from gateway.record.mcapfile import Writer
from gateway.record.reading import Entry, Recording, open_recording
from gateway.record.replaying import Replay
from gateway.record.ring import Ring
from gateway.record.robots import robots_of
from gateway.record.spool import Begin, End, Raw, Said
from gateway.sim.chaos import CALM
from gateway.sim.simulator import Simulator
from gateway.testing.cell import virtual_cell
from gateway.testing.conformance import subjects

OWN = ("link", "link_stats", "events", "commands")
T0 = 1_777_000_000_000_000  # µs UTC, in April 2026
STEP = 10_000  # µs between frames
QUESTION = b"reqdata\x00"
Name = tuple[str, str, int]  # topic, epoch, seq
Plain = dict[str, object]


class Heard:
    """Collects what is published on some topics; a listener."""

    def __init__(self) -> None:
        self.samples: dict[Name, Plain] = {}
        self.events: list[Event] = []
        self.own: list[Sample] = []
        self.said: list[Said] = []

    def listen(self, topics: Mapping[str, Topic]) -> None:
        for topic in topics.values():
            topic.listeners.append(self)

    def on_reading(self, topic: Topic, reading: Reading) -> None:
        sample = reading.sample(topic)
        data = msgspec.json.encode(sample)
        if topic.group.name in OWN:
            self.own.append(sample)
            self.said.append(Said(topic=topic.name, t=sample.t, seq=sample.seq, data=data))
        elif sample.epoch:  # else it was said before the first session
            self.samples[sample.topic, sample.epoch, sample.seq] = plain(data)

    def on_event(self, topic: Topic, event: Event) -> None:
        self.events.append(event)
        self.said.append(Said(topic=topic.name, t=event.t, seq=event.seq, data=msgspec.json.encode(event)))


def plain(sample: bytes) -> Plain:
    """A sample as plain values, without where it comes from."""
    found: Plain = msgspec.json.decode(sample)
    del found["origin"]
    return found


@dataclass(slots=True)
class Recorded:
    """A live cell that is over: what was heard of it, its rings, and its robots as TOML."""

    robots: str
    heard: Heard = field(default_factory=Heard)
    rings: dict[str, Ring] = field(default_factory=dict)

    def ring(self, robot: RobotSettings) -> Ring:
        """The tap of a robot."""
        found = self.rings[robot.name] = Ring(robot.name, 60, 1 << 23)
        return found

    def file(self, path: Path, skip: int = 0) -> Recording:
        """Make the file of it; so many blocks of each ring are left out, so that it begins in the middle."""
        blocks = {name: ring.blocks(0.0)[skip:] for name, ring in self.rings.items()}
        with Writer(path) as writer:
            making = Making(writer)
            making.take(begin(self.robots))
            for name, kept in blocks.items():
                for block in kept:
                    making.take(Raw(robot=name, block=block))
            for said in self.heard.said:
                making.take(said)
            making.take(End(to_t=max(block.last_t for kept in blocks.values() for block in kept)))
            assert making.notes == []
        return open_recording(path)


def begin(robots: str, from_t: int = 0) -> Begin:
    """The first message of a spool."""
    return Begin(robots=robots, vendor_dirs=[], from_t=from_t, reason={"trigger": "test"}, gateway="0.0.0")


def robots_toml(vendor: str, protocol: str, count: int = 1, keys: Mapping[str, object] | None = None) -> str:
    """Robots r1, r2 … as a recorder writes them down."""
    text = ""
    for number in range(1, count + 1):
        entry = {"name": f"r{number}", "vendor": vendor, "protocol": protocol, "host": f"127.0.0.{number}", "port": 9}
        text += "[[robots]]\n"
        text += "".join(f"{key} = {toml_value(value)}\n" for key, value in {**entry, **(keys or {})}.items())
    return text


async def record(
    vendor: str,
    protocol: str,
    *,
    seconds: float,
    count: int = 1,
    settings: Mapping[str, object] | None = None,
    chaos: str = "",
) -> Recorded:
    """Run a live cell for so long, and keep what it said."""
    simulator = cast("Simulator", Registry().simulator(vendor))
    keys = {**simulator.keys(protocol), **(settings or {})}
    found = Recorded(robots_toml(vendor, protocol, count, keys))
    async with virtual_cell(
        vendor,
        protocol=protocol,
        count=count,
        settings=settings,
        chaos=chaos or CALM,
        seed=7,
        tap_of=found.ring,
    ) as cell:
        found.heard.listen(cell.gateway.bus.topics)
        await anyio.sleep(seconds)
    return found


def replayed(recording: Recording) -> tuple[Heard, Replay]:
    """What a replay of all robots of a recording publishes."""
    found = robots_of(recording)
    assert found.left_out == {}
    replay, heard = Replay(found.usable, recording.begins_t), Heard()
    heard.listen(replay.bus.topics)
    for entry in recording.entries():
        replay.take(entry)
    return heard, replay


def recorded_samples(recording: Recording) -> dict[Name, Plain]:
    """The canonical samples that a file holds."""
    found = {}
    for entry in recording.entries():
        if is_canonical(entry):
            sample = plain(entry.data)
            found[str(sample["topic"]), str(sample["epoch"]), cast("int", sample["seq"])] = sample
    return found


def is_canonical(entry: Entry) -> bool:
    """Whether it is a sample of a group that follows from bytes."""
    return not entry.group.startswith(("raw/", "session")) and entry.group not in OWN


@cache
def known_frames() -> tuple[bytes, ...]:
    """Frames of the rainbow plugin that are good, of one size."""
    found = [vector.raw for vector in subjects(Registry(), "rainbow")[0].vectors]
    return tuple(frame for frame in found if len(frame) == 580)[:4]


def known_chunks(n_frames: int, frames: Sequence[bytes] = (), epoch: str = "b00t.1", at: int = T0) -> list[Chunk]:
    """A session that asks for known frames."""
    wire = frames or known_frames()
    chunks = [Chunk(at, "begin", b"", epoch, 0)]
    for number in range(n_frames):
        t = at + (number + 1) * STEP
        chunks.append(Chunk(t - STEP // 2, "sent", QUESTION, epoch, number))
        chunks.append(Chunk(t, "received", wire[number % len(wire)], epoch, number))
    return chunks


def known_recording(path: Path, n_frames: int = 12, count: int = 1, robots: str = "", from_t: int = 0) -> Recording:
    """A small file of known frames, the same for every robot, with an event."""
    with Writer(path) as writer:
        making = Making(writer)
        making.take(begin(robots or robots_toml("rainbow", "reqdata", count), from_t))
        chunks = known_chunks(n_frames)
        for number in range(1, count + 1):
            for at in range(0, len(chunks), 6):
                making.take(Raw(robot=f"r{number}", block=pack(chunks[at : at + 6], (), ())))
        event = {"name": "b00t:1", "seq": 1, "robot": "r1", "t": T0 + 2 * STEP, "kind": "estop.pressed", "to": True}
        making.take(Said(topic="r1/events", t=T0 + 2 * STEP, seq=1, data=msgspec.json.encode({**event, "raw": {}})))
        making.take(End(to_t=T0 + n_frames * STEP))
    return open_recording(path)
