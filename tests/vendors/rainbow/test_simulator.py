"""The virtual Rainbow controller says what its robot does, in frames that our own decoder and the notes agree on."""

from __future__ import annotations

import itertools
import math

import msgspec
import numpy as np
import pytest

from gateway.api.decoder import Frame, Skipped
from gateway.api.framing import FramedDecoder
from gateway.api.layout import Layout
from gateway.sim.scenario import Fault, FaultKind, Phase, Scenario, find_scenario
from gateway.sim.simulator import VirtualRobot
from vendors.rainbow import FRAMING
from vendors.rainbow.layouts import LAYOUTS, STATE_580
from vendors.rainbow.simulator import SIMULATOR
from vendors.rainbow.simulator.encoding import FILLERS, RainbowOptions
from vendors.rainbow.simulator.sessions import CommandSession, StateSession

SIZES = sorted(layout.size for layout in LAYOUTS)


def robot(scenario: str | Scenario = "cell", keep: int = 100) -> VirtualRobot:
    return VirtualRobot(find_scenario(scenario) if isinstance(scenario, str) else scenario, keep=keep)


def session(of: VirtualRobot, **options: object) -> StateSession:
    return StateSession(of, msgspec.convert(options, RainbowOptions))


def values(scenario: str | Scenario, now_s: float) -> dict[str, object]:
    """The values of the frame that a controller sends at a time, read with the table of the decoder."""
    (frame,) = session(robot(scenario)).received(b"reqdata", now_s)
    record = STATE_580.read_many(frame)[0]
    return {name: record[name].tolist() for name in STATE_580.by_name}


def flag(found: dict[str, object], name: str) -> int:
    field, row = STATE_580.flag_owner[name]
    word = found[field.name]
    assert isinstance(word, int)
    return word >> row.bit & row.mask


def phase(name: str) -> tuple[str, float]:
    """The middle of the first such phase of the tour."""
    cell = find_scenario("cell")
    starts = itertools.accumulate((phase.seconds for phase in cell.phases), initial=0.0)
    return "cell", next(
        start + row.seconds / 2 for start, row in zip(starts, cell.phases, strict=False) if row.name == name
    )


def test_a_request_is_answered_with_one_frame_of_580_bytes_whose_size_field_says_576() -> None:
    (frame,) = session(robot()).received(b"reqdata", 5.0)
    assert len(frame) == 580
    assert frame[:4] == bytes([0x24, 0x40, 0x02, 3])


@pytest.mark.parametrize(
    ("segments", "frames"),
    [
        ([b"reqdata"], [1]),
        ([b"reqdata\n"], [1]),
        ([b"reqdatareqdata\nreqdata"], [3]),
        ([b"req", b"data"], [0, 1]),
        ([b"reqdatar", b"eqdat", b"a\n"], [1, 0, 1]),
        ([b"rereqdata"], [1]),
        ([b"nonsense reqdat", b"x"], [0, 0]),
        ([b"reqdata"] * 3, [1, 1, 1]),
    ],
)
def test_every_request_gets_its_frame_however_the_requests_are_cut(segments: list[bytes], frames: list[int]) -> None:
    of = robot()
    asked = session(of)
    assert [len(asked.received(segment, 1.0)) for segment in segments] == frames
    assert of.requests == of.frames == sum(frames)


@pytest.mark.parametrize("size", [*SIZES, 604, 1024])
def test_frames_of_every_length_are_accepted_by_the_decoder(size: int) -> None:
    (sent,) = session(robot(), layout=size).received(b"reqdata", 5.0)
    (event,) = FramedDecoder(FRAMING).feed(sent)
    assert isinstance(event, Frame)
    assert len(event.raw) == size
    assert isinstance(event.layout, Layout)
    assert event.layout.size == min(size, 580)


def test_a_short_frame_is_the_beginning_of_a_whole_one_but_for_the_run_time() -> None:
    at_s = 8.0
    (whole,) = session(robot()).received(b"reqdata", at_s)
    (short,) = session(robot(), layout=512).received(b"reqdata", at_s)
    assert short[4:328] == whole[4:328]
    assert short[332:] == whole[332:512]
    assert np.frombuffer(short[328:332], "<f4")[0] == np.frombuffer(whole[328:332], "<i4")[0] == 5


def test_a_size_field_that_counts_the_header_is_no_frame() -> None:
    (sent,) = session(robot(), size_counts="frame").received(b"reqdata", 5.0)
    assert not any(isinstance(event, Frame) for event in FramedDecoder(FRAMING).feed(sent))


@pytest.mark.parametrize("size", [460, 500, 582, 4104])
def test_a_length_that_no_box_sends_is_refused(size: int) -> None:
    with pytest.raises(msgspec.ValidationError):
        msgspec.convert({"layout": size}, RainbowOptions)


@pytest.mark.parametrize("size", [*SIZES, 604])
def test_what_a_frame_meant_is_what_the_decoders_table_reads(size: int) -> None:
    of = robot()
    asked = session(of, layout=size)
    for at_s in np.arange(0.0, 80.0, 1.7):
        (frame,) = asked.received(b"reqdata", float(at_s))
        sent = of.sent[-1]
        assert sent.frame == frame
        layout = next(layout for layout in sorted(LAYOUTS, key=lambda row: -row.size) if layout.size <= size)
        record = layout.read_many(frame[: layout.size])[0]
        for name in layout.dtype.names or ():
            assert record[name].tolist() == pytest.approx(sent.values()[name], rel=1e-6), name


def test_what_clients_must_mask_or_ignore_is_not_zero() -> None:
    found = values("idle", 5.0)
    assert flag(found, "op_stat_self_collision.time_zone_raw") != 0
    assert flag(found, "op_stat_self_collision.self_collision") == 0
    assert all(isinstance(word, int) and word >> 16 for word in np.array(found["jnt_info"]).tolist())
    assert all(np.array(found["reserved_1"]) != 0)
    assert found["time"] != 0


def test_the_time_is_finite_unless_asked_otherwise() -> None:
    assert all(math.isfinite(float(str(values("idle", float(at_s))["time"]))) for at_s in range(50))
    of = robot()
    session(of, time="nan").received(b"reqdata", 5.0)
    assert math.isnan(float(str(of.sent[-1].values()["time"])))


def test_a_healthy_box_reads_as_on_the_recording() -> None:
    found = values("idle", 5.0)
    for name in ("information_chunk_1.estop_1", "information_chunk_1.estop_2", "information_chunk_1.arm_power"):
        assert flag(found, name) == 1
    assert flag(found, "information_chunk_2.config_di_16") == flag(found, "information_chunk_3.config_di_17") == 1
    assert (found["task_state"], found["robot_state"], found["init_state_info"]) == (1, 1, 6)


def test_the_measured_pose_is_a_copy_of_the_commanded_one() -> None:
    found = values("steady", 5.0)
    assert found["tcp_pos"] == found["tcp_ref"]
    assert found["jnt_ang"] != found["jnt_ref"]


def test_what_moves_inside_words_moves() -> None:
    first, later = values("steady", 5.0), values("steady", 6.3)
    for name in ("time", "op_stat_self_collision", "task_run_time", "jnt_ang"):
        assert first[name] != later[name], name
    assert flag(first, "information_chunk_3.tcp_speed_x10") != flag(later, "information_chunk_3.tcp_speed_x10")


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("idle", {"task_state": 1, "robot_state": 1, "op_stat_soft_estop_occur": 0}),
        ("program runs", {"task_state": 3, "robot_state": 3, "op_stat_soft_estop_occur": 0}),
        ("program pauses", {"task_state": 2, "op_stat_soft_estop_occur": 1, "op_stat_collision_occur": 0}),
        ("freedrive", {"is_freedrive_mode": 1, "task_state": 1}),
        ("collision", {"op_stat_collision_occur": 1, "robot_state": 1, "task_state": 2}),
        ("fault", {"op_stat_sos_flag": 6, "task_state": 1}),
        ("emergency stop pressed", {"init_state_info": 0, "op_stat_ems_flag": 0}),
        ("power is off", {"init_state_info": 0}),
        ("activation", {"init_state_info": 3}),
    ],
)
def test_each_phase_is_told_in_the_manuals_words(name: str, expected: dict[str, int]) -> None:
    found = values(*phase(name))
    assert {key: found[key] for key in expected} == expected


def test_the_bits_of_a_joint_tell_position_control_from_hand_guiding() -> None:
    def bits(name: str) -> set[int]:
        return {word & 0xF for word in np.array(values(*phase(name))["jnt_info"]).tolist()}

    assert bits("idle") == {0b0111}
    assert bits("freedrive") == {0b1101}
    assert bits("power is off") == {0}


def test_a_pressed_emergency_stop_reads_0_on_both_channels_and_takes_the_power() -> None:
    found = values(*phase("emergency stop pressed"))
    for name in ("estop_1", "estop_2", "arm_power", "box_48v_out"):
        assert flag(found, f"information_chunk_1.{name}") == 0


def test_a_collision_has_a_cause() -> None:
    assert flag(values(*phase("collision")), "op_stat_self_collision.last_out_collision_cause") == 1
    assert flag(values("idle", 1.0), "op_stat_self_collision.last_out_collision_cause") == 0


@pytest.mark.parametrize(
    ("kind", "code", "name"),
    [
        (FaultKind.ENCODER, 1, "enc_nonius_err"),
        (FaultKind.FOLLOWING_ERROR, 5, "err_jam"),
        (FaultKind.OVER_CURRENT, 6, "err_cur"),
        (FaultKind.OVER_TEMPERATURE, 11, "err_tmp"),
    ],
)
def test_a_fault_has_its_code_and_its_bit_at_its_joint(kind: FaultKind, code: int, name: str) -> None:
    found = values(Scenario("broken", "", (Phase(name="fault", seconds=9, fault=Fault(kind, 4)),)), 1.0)
    assert found["op_stat_sos_flag"] == code
    row = STATE_580.flag_owner[f"jnt_info.{name}"][1]
    assert [word >> row.bit & 1 for word in np.array(found["jnt_info"]).tolist()] == [0, 0, 0, 0, 1, 0]


def test_the_frames_without_state_are_skipped_by_the_decoder() -> None:
    assert [len(filler) for filler in FILLERS] == [96, 628, 1012]
    events = FramedDecoder(FRAMING).feed(b"".join(FILLERS))
    assert [type(event) for event in events] == [Skipped] * 3


@pytest.mark.parametrize(
    ("data", "answers"),
    [
        (b"task play\n", [b"The command was executed\n"]),
        (b"task play", [b"The command was executed\n"]),
        (b"move_j(jnt[0,0,0,0,0,0], 1, 1) ", [b"The command was executed\n"]),
        (b"a\nb\n", [b"The command was executed\n"] * 2),
        (b"get_control_box_info()\n", [b"The command was executed\n", b"info[controlbox][8.7.3,1]\n"]),
        (b"\n \n", []),
    ],
)
def test_a_command_is_acknowledged_and_not_executed(data: bytes, answers: list[bytes]) -> None:
    of = robot("idle")
    before = of.state(5.0)
    assert CommandSession(of, RainbowOptions()).received(data, 1.0) == answers
    assert of.state(5.0) == before


def test_the_simulator_serves_both_ports_and_the_demo_knows_the_polarity() -> None:
    assert [(port.protocol, port.port) for port in SIMULATOR.ports] == [("reqdata", 5001), (None, 5000)]
    assert SIMULATOR.keys("reqdata") == {"estop_polarity": "active_low"}
