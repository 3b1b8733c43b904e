"""A recording is replayed: the same samples again, the rest as it was told, and a plugin's mistakes cost one robot."""

from __future__ import annotations

import dataclasses
import shutil
from pathlib import Path

import msgspec
import pytest

from gateway.api.decoder import Decoder
from gateway.api.model import Link, LinkState, Quality
from gateway.core.registry import Registry
from gateway.record.chunks import Chunk, Silence, pack
from gateway.record.making import Making
from gateway.record.mcapfile import Writer
from gateway.record.reading import open_recording
from gateway.record.replaying import Replay
from gateway.record.robots import robots_of
from gateway.record.spool import End, Raw, Said
from tests.record.kit import (
    STEP,
    T0,
    Name,
    Plain,
    begin,
    known_chunks,
    known_recording,
    record,
    recorded_samples,
    replayed,
    robots_toml,
)

PROTOCOLS = [(name, protocol.name) for name in Registry().names() for protocol in Registry().vendor(name).protocols]
# Sessions end and begin again, frames are cut and damaged, and silence is noticed.
CHAOS = "split=0.3,junk=0.02,corrupt=0.02,header=0.01,stall=0.5/1.3,cut=1.1"
RESTLESS = {"stale_s": 0.3}
WARM_UP_US = 1_000_000  # where frames tell parts, those that were told before the beginning are missing
FURTHER: list[tuple[str, str, dict[str, object]]] = [
    ("fairino", "cnde", {"cnde": {"states": ["robot_mode", "actual_joint_pos", "program_state"]}}),
    ("fairino", "cnde", {"cnde": {"transport": "udp"}}),
    ("xcore", "external", {"external": {"words": {"jnt_pos": 20, "motor_on_state": 10}, "axes": 6}}),
]


def lost_by(live: dict[Name, Plain], found: dict[Name, Plain], later_us: int) -> list[Name]:
    """The live samples that are not the same in what was found, of its time without so much of its beginning."""
    since = min(int(str(sample["t"])) for sample in found.values()) + later_us
    return [
        name
        for name, sample in live.items()
        if int(str(sample["t"])) >= since and _told(sample) and found.get(name) != sample
    ]


def _told(sample: Plain) -> bool:
    """Whether it tells values; of a silence before the first frame `vendor` does not know which it lacks."""
    return sample["q"] not in {"STALE", "DISCONNECTED"} or not str(sample["topic"]).endswith("/vendor")


@pytest.mark.limit(40)
@pytest.mark.parametrize(
    ("vendor", "protocol", "settings"),
    [*((vendor, protocol, {}) for vendor, protocol in PROTOCOLS), *FURTHER],
    ids=lambda value: value if isinstance(value, str) else ",".join(value),
)
async def test_what_a_live_gateway_told_is_told_again_also_from_the_middle_of_a_session(
    vendor: str, protocol: str, settings: dict[str, object], tmp_path: Path
) -> None:
    spoken = Registry().vendor(vendor).protocol(protocol)
    keys = settings if spoken.slowest_s is not None else {**settings, **RESTLESS}  # it may not be stale so soon
    live = await record(vendor, protocol, seconds=3.0, settings=keys, chaos=CHAOS)

    whole = live.file(tmp_path / "whole.mcap")
    heard, replay = replayed(whole)

    assert heard.samples == live.heard.samples
    assert replay.tallies["r1"].sessions > 1 or "transport" in str(settings)  # datagrams are not cut
    in_file = recorded_samples(whole)
    assert in_file == {name: sample for name, sample in heard.samples.items() if not name[0].endswith("/vendor")}

    part = live.file(tmp_path / "part.mcap", skip=1)
    heard, replay = replayed(part)

    assert heard.samples
    assert lost_by(live.heard.samples, heard.samples, WARM_UP_US if spoken.records else 0) == []
    in_file = recorded_samples(part)
    assert in_file == {name: sample for name, sample in heard.samples.items() if not name[0].endswith("/vendor")}
    assert [sample.data for sample in heard.own] == [sample.data for sample in live.heard.own]
    assert {sample.origin for sample in heard.own} == {"replay"}
    # A link says at its own time that it is online, a command has that of its bytes: a recording is in order of time.
    in_time = sorted(live.heard.events, key=lambda event: event.t)
    assert [(event.kind, event.t) for event in heard.events] == [(event.kind, event.t) for event in in_time]


def test_samples_of_a_replay_say_so(tmp_path: Path) -> None:
    recording = known_recording(tmp_path / "known.mcap")
    found = robots_of(recording)
    replay = Replay(found.usable, recording.begins_t)

    for entry in recording.entries():
        replay.take(entry)

    topics = [topic for topic in replay.bus.topics.values() if topic.latest is not None]
    assert len(topics) > 5
    assert {topic.latest.sample(topic).origin for topic in topics if topic.latest} == {"replay"}
    assert replay.tallies["r1"].frames == 12
    assert replay.tallies["r1"].events == {"estop.pressed": 1}


def test_before_the_first_frame_and_behind_the_last_no_values_stand(tmp_path: Path) -> None:
    recording = known_recording(tmp_path / "known.mcap")
    replay = Replay(robots_of(recording).usable, recording.begins_t)
    joints, link = replay.bus.topics["r1/joints"], replay.bus.topics["r1/link"]
    before = joints.latest

    for entry in recording.entries():
        replay.take(entry)
    among = joints.latest
    replay.end(recording.last_t)

    assert before is not None
    assert among is not None
    assert joints.latest is not None
    assert link.latest is not None
    assert before.sample(joints).q is Quality.DISCONNECTED
    assert among.sample(joints).q is not Quality.DISCONNECTED
    assert joints.latest.sample(joints).q is Quality.DISCONNECTED
    told = link.latest.sample(link).data
    assert isinstance(told, Link)
    assert told.state is LinkState.DISCONNECTED
    assert told.reason == "the recording ends here"


def test_an_event_is_told_once_as_it_was_recorded(tmp_path: Path) -> None:
    heard, _ = replayed(known_recording(tmp_path / "known.mcap", count=2))

    assert [(event.robot, event.kind.value, event.after, event.t) for event in heard.events] == [
        ("r1", "estop.pressed", True, T0 + 2 * STEP)
    ]


def test_a_plugin_that_fails_costs_its_robot_and_says_so(tmp_path: Path) -> None:
    recording = known_recording(tmp_path / "known.mcap", count=2)
    found = robots_of(recording).usable

    def broken(_options: msgspec.Struct) -> Decoder:
        raise RuntimeError("not today")

    robot = found["r1"]
    found["r1"] = dataclasses.replace(robot, protocol=dataclasses.replace(robot.protocol, make_observer=broken))
    replay = Replay(found, recording.begins_t)

    for entry in recording.entries():
        replay.take(entry)

    assert replay.tallies["r1"].problem == "its plugin failed: RuntimeError('not today')"
    assert replay.tallies["r2"].frames == 12


def test_what_another_version_wrote_is_counted_and_left_out(tmp_path: Path) -> None:
    path = tmp_path / "new.mcap"
    with Writer(path) as writer:
        making = Making(writer)
        making.take(begin(robots_toml("rainbow", "reqdata")))
        making.take(Raw(robot="r1", block=pack(known_chunks(3), (), ())))
        making.take(Said(topic="r1/events", t=T0, seq=1, data=b'{"kind":"coffee.spilled"}'))
        making.take(Said(topic="r1/link", t=T0, seq=1, data=b'{"kind":1}'))
        making.take(Said(topic="r1/weather", t=T0, seq=1, data=b'{"sun":true}'))
        making.take(End(to_t=T0))

    _, replay = replayed(open_recording(path))

    assert replay.unreadable == 2
    assert replay.tallies["r1"].frames == 3


def test_where_the_clock_was_set_back_the_bytes_stay_in_their_order(tmp_path: Path) -> None:
    path = tmp_path / "back.mcap"
    hour = 3_600_000_000
    first, second = known_chunks(5), known_chunks(5, epoch="b00t.2", at=T0 - hour)
    with Writer(path) as writer:
        making = Making(writer)
        making.take(begin(robots_toml("rainbow", "reqdata", 2)))
        for number in (1, 2):
            making.take(Raw(robot=f"r{number}", block=pack([*first, *second], (), ())))
        making.take(End(to_t=T0))
    recording = open_recording(path)

    heard, replay = replayed(recording)

    assert recording.about["set_back"] == "yes"
    assert replay.tallies["r1"].frames == replay.tallies["r2"].frames == 10
    assert [name[1:] for name in heard.samples if name[0] == "r1/joints"] == [
        *(("b00t.1", number) for number in range(1, 6)),
        *(("b00t.2", number) for number in range(1, 6)),
    ]
    assert recorded_samples(recording).items() <= heard.samples.items()


def test_silence_and_age_are_told_again(tmp_path: Path) -> None:
    path = tmp_path / "silent.mcap"
    chunks = known_chunks(3)
    t = T0 + 100 * STEP
    silence = msgspec.json.encode(Silence(Quality.STALE, T0 + 3 * STEP))
    chunks += [Chunk(t, "silent", silence, "b00t.1", 3), Chunk(t + 1, "expired", b"", "b00t.1", 4)]
    chunks += [Chunk(t + 2, "end", b"", "b00t.1", 4)]
    with Writer(path) as writer:
        making = Making(writer)
        making.take(begin(robots_toml("rainbow", "reqdata")))
        making.take(Raw(robot="r1", block=pack(chunks, (), ())))
        making.take(End(to_t=t))

    heard, _ = replayed(open_recording(path))

    last = heard.samples["r1/joints", "b00t.1", 4]
    assert (last["q"], last["t"], last["t_last"]) == ("STALE", t, T0 + 3 * STEP)


def test_a_recording_of_the_robots_as_another_configuration_has_them(tmp_path: Path) -> None:
    recording = known_recording(tmp_path / "known.mcap", count=2)
    other = tmp_path / "gateway.toml"
    other.write_text(
        '[[robots]]\nname = "r1"\nvendor = "rainbow"\nhost = "127.0.0.1"\nport = 9\nestop_polarity = "active_high"\n'
    )

    found = robots_of(recording, config=other)

    assert found.usable["r1"].estop_polarity == "active_high"
    assert found.usable["r2"].estop_polarity is None


def test_a_vendor_that_is_not_installed_leaves_its_robot_out(tmp_path: Path) -> None:
    robots = robots_toml("rainbow", "reqdata") + robots_toml("kilo", "push").replace('"r1"', '"r2"')
    recording = known_recording(tmp_path / "known.mcap", count=2, robots=f'vendor_dirs = ["/opt/kilo"]\n{robots}')

    found = robots_of(recording)

    assert list(found.usable) == ["r1"]
    assert "its vendor 'kilo' is not installed here, known are fairino" in found.left_out["r2"]
    assert 'it was recorded with vendor_dirs = ["/opt/kilo"]' in found.left_out["r2"]
    assert "--vendor-dir" in found.left_out["r2"]


def test_the_folders_of_plugins_that_a_recording_names_are_not_run(tmp_path: Path) -> None:
    folder = tmp_path / "vendors" / "kilo"
    folder.mkdir(parents=True)
    (folder / "__init__.py").write_text("raise SystemExit('this was run')")
    folder.parent.chmod(0o755)
    robots = f'vendor_dirs = ["{folder.parent}"]\n' + robots_toml("kilo", "push")
    recording = known_recording(tmp_path / "known.mcap", robots=robots)

    found = robots_of(recording)

    assert found.usable == {}
    shutil.rmtree(folder)


@pytest.mark.parametrize(
    ("robots", "told"),
    [
        ("", "does not say how it was configured"),
        ("= no toml =", "does not say how it was configured"),
        (robots_toml("rainbow", "reqdata").replace("port", "prt"), "it cannot be used as it was recorded"),
        (robots_toml("rainbow", "gossip"), "it cannot be used as it was recorded"),
    ],
)
def test_a_robot_whose_recorded_configuration_is_of_no_use_says_why(robots: str, told: str, tmp_path: Path) -> None:
    recording = known_recording(tmp_path / "known.mcap", robots=robots or "\n")

    found = robots_of(recording)

    assert told in found.left_out["r1"]
    assert "--config" in found.left_out["r1"]


def test_a_robot_that_is_not_in_the_recording_cannot_be_chosen(tmp_path: Path) -> None:
    recording = known_recording(tmp_path / "known.mcap")

    with pytest.raises(KeyError, match="r7"):
        robots_of(recording, names=["r7"])
