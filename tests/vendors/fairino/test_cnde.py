from __future__ import annotations

import random
import re
import struct

import msgspec
import pytest

from gateway.api.decoder import Event, Frame, Refused, Reject, Skipped
from gateway.api.normaliser import Normaliser
from tests.vendors.fairino.cnde_kit import running, talk
from vendors.fairino.cnde import UDP_STATES, CndeDecoder, CndeOptions, Learned, make_decoders
from vendors.fairino.cnde_narrowing import Narrowing
from vendors.fairino.cnde_protocol import CNDE, FirmwareProbe
from vendors.fairino.cnde_states import ALL_STATES
from vendors.fairino.cnde_wire import DATA, FIRMWARE, MESSAGE, configuration, frame
from vendors.fairino.simulator.cnde import CndeBehaviour

PAIR = CndeOptions(states=("program_state", "actual_joint_pos"))
STOP = bytes.fromhex("5a5a00030000a5a5")
START = bytes.fromhex("5a5a00020000a5a5")
JOINTS = (10.0, -20.5, 30.25, -40.0, 50.0, 60.0)
PAYLOAD = struct.pack("<B6d", 2, *JOINTS)


def success(text: str) -> bytes:
    return frame(MESSAGE, b"\0" + text.encode())


def vendor_values(found: Frame) -> dict[str, object]:
    data, _ = Normaliser((), {}).readers(found.layout)["vendor"].read(found)
    assert isinstance(data, dict)
    return data


def told(events: list[Event]) -> list[object]:
    return [
        (event.layout.name, event.raw)
        if isinstance(event, Frame)
        else (getattr(event, "reason", ""), getattr(event, "raw", b""))
        for event in events
    ]


def test_the_documented_example_comes_out_as_documented() -> None:
    names = ("std_DI_box", "output_DOUBLE_reg_10", "motion_queue_len")
    asked = configuration(names, 8)
    assert asked.hex(" ", 1).startswith("5a 5a 00 01 32 00 08 00")
    assert asked[8:-2] == b"std_DI_box,output_DOUBLE_reg_10,motion_queue_len"
    assert len(asked[8:-2]) == 48
    options = CndeOptions(states=names)
    decoder = CndeDecoder(options, Learned(Narrowing(names)))
    assert decoder.outgoing() == STOP
    assert decoder.tick() == b""
    assert decoder.tick() == asked
    decoder.feed(success("UINT8,DOUBLE_10,INT32"))
    assert decoder.outgoing() == START
    payload = struct.pack("<B10di", 0b1000_0001, *range(10), -3)
    assert len(payload) == 85
    (found,) = decoder.feed(frame(DATA, payload))
    assert isinstance(found, Frame)
    values = vendor_values(found)
    assert values["cl_dgt_input_l"]["raw"] == 0x81  # type: ignore[index] # of an object
    assert values["output_DOUBLE_reg_10"] == [float(number) for number in range(10)]
    assert values["mc_queue_len"] == -3
    assert values["jt_cur_pos"] == [None] * 6
    assert values["data_len"] == 85


def test_the_handshake_is_stop_silence_configuration_start() -> None:
    found = running(PAIR)
    assert found.sent == [STOP, configuration(PAIR.states, 8), START]
    assert found.decoder.goodbye() == STOP
    assert found.frames[0].raw[6:-2] == PAYLOAD
    assert found.decoder.notes == []
    assert found.frames[0].layout.name == "2 states, 57 bytes"


def test_the_default_set_holds_every_state_of_the_page_and_three_more() -> None:
    found = running()
    values = vendor_values(found.frames[0])
    assert len(found.configurations[0]) == 137
    assert values["jt_cur_pos"] == list(JOINTS)
    assert values["main_code"] == -7
    assert values["cl_analog_input_0"] == 4095.0
    assert values["currentLuaFileName"] == "/fruser/weld.lua"
    assert (values["robotTime_year"], values["robotTime_millisecond"]) == (2026, 789)
    assert isinstance(values["timestamp_us"], int)
    assert None not in values.values()


def test_every_field_of_the_page_can_be_asked_for() -> None:
    fields = {name for state in ALL_STATES.values() for name in state.fields}
    missing = {field.name for field in CNDE.layouts[0].fields} - fields - {"frame_head", "frame_cnt", "data_len"}
    assert missing == set()
    assert [field.name for field in CNDE.layouts[0].fields if not field.present] == []


def test_over_udp_configuration_and_frame_are_one_datagram_each() -> None:
    options = CndeOptions(transport="udp")
    found = running(options)
    assert found.configurations[0] == UDP_STATES
    assert len(configuration(UDP_STATES, 8)) <= 1400
    assert len(found.frames[0].raw) <= 1400
    assert {"actual_joint_pos", "robot_time", "emergency_stop", "target_TCP_pos"} <= set(UDP_STATES)


def test_frames_are_the_same_however_the_stream_is_cut() -> None:
    chance = random.Random(3)  # noqa: S311 - test data
    stream = b"".join(
        (frame(DATA, PAYLOAD), frame(MESSAGE, b"\x01hello"), b"junk", frame(DATA, PAYLOAD, 7), frame(DATA, PAYLOAD))
    )
    whole = running(PAIR).decoder.feed(stream)
    assert [type(event) for event in whole] == [Frame, Skipped, Reject, Frame, Frame]
    for _ in range(50):
        decoder = running(PAIR).decoder
        events: list[Event] = []
        at = 0
        while at < len(stream):
            step = chance.randint(1, 90)
            events += decoder.feed(stream[at : at + step])
            at += step
        frames = [event for event in events if isinstance(event, (Frame, Skipped))]
        assert told(list(frames)) == told([event for event in whole if not isinstance(event, Reject)])
        assert b"".join(event.raw for event in events if not isinstance(event, Refused)) == stream


def test_the_same_configuration_has_the_same_layout_in_every_session() -> None:
    options = CndeOptions()
    learned = Learned(Narrowing(options.wanted))
    first, second = talk(options, learned=learned), talk(options, learned=learned)
    first.tick(4)
    second.tick(4)
    assert first.frames[0].layout is second.frames[0].layout


def test_data_of_an_earlier_configuration_is_skipped_until_it_ends() -> None:
    found = talk(PAIR)
    for _ in range(6):
        assert told(found.hear(frame(DATA, bytes(10)))) == [("data before start", frame(DATA, bytes(10)))]
        found.tick()
    assert found.configurations == []
    assert found.sent.count(STOP) == 2  # the second after five ticks
    assert "being stopped" in found.decoder.notes[0]
    found.tick(4)
    assert found.frames


def test_data_that_overtakes_the_answer_to_start_is_read() -> None:
    found = talk(PAIR)
    found.deaf = 1
    found.tick(2)
    assert found.decoder.feed(success("UINT8,DOUBLE_6"))
    assert found.decoder.outgoing() == START
    (event,) = found.decoder.feed(frame(DATA, PAYLOAD))
    assert isinstance(event, Frame)
    assert found.decoder.ready
    assert told(found.decoder.feed(success("START_OK")))[0][0] == "message"  # type: ignore[index] # a pair


@pytest.mark.parametrize("lost", [1, 2, 3])
def test_over_udp_a_lost_datagram_is_repeated(lost: int) -> None:
    options = CndeOptions(transport="udp", states=PAIR.states)
    found = talk(options)
    if lost == 1:  # the first stop, while the output of an earlier session still runs
        earlier = running(options)
        found.session = earlier.session
        found.deaf = 0
    found.tick(lost - 1)
    found.deaf = 1
    found.tick(12)
    assert found.frames
    assert found.refusals == []


def test_over_tcp_nothing_is_repeated_for_seconds() -> None:
    found = talk(PAIR)
    found.deaf = 1
    found.tick(2)
    found.tick(49)
    assert found.sent.count(configuration(PAIR.states, 8)) == 1
    found.tick(4)
    assert found.frames


def test_a_wrong_tail_is_a_counted_reject_and_the_next_frame_is_found() -> None:
    found = running(PAIR)
    good = frame(DATA, PAYLOAD)
    events = found.hear(good[:-1] + b"\xa4" + good)
    assert told(events) == [("tail", good[:-1] + b"\xa4"), ("2 states, 57 bytes", good)]


@pytest.mark.parametrize("length", [0, 65535, 4097, 48, 50])
def test_a_length_that_lies_costs_little(length: int) -> None:
    found = running(PAIR)
    good = frame(DATA, PAYLOAD)
    bad = good[:4] + length.to_bytes(2, "little") + good[6:]
    events = found.hear(bad + good * 90)
    frames = [event for event in events if isinstance(event, Frame)]
    assert len(frames) >= 90 - 1
    assert all(event.raw == good for event in frames)
    reasons = {event.reason for event in events if isinstance(event, Reject)}
    assert reasons <= {"tail", "size", "length", "junk"}
    assert reasons


def test_on_a_datagram_a_length_that_lies_costs_that_datagram_alone() -> None:
    found = running(CndeOptions(transport="udp", states=PAIR.states))
    good = frame(DATA, PAYLOAD)
    for length in (0, 65535, 4097, 4000):
        assert not any(
            isinstance(event, Frame) for event in found.hear(good[:4] + length.to_bytes(2, "little") + good[6:])
        )
        found.decoder.end()
        assert [type(event) for event in found.hear(good)] == [Frame]
        assert found.decoder.end() == []


def test_the_magic_inside_the_payload_is_no_frame() -> None:
    inside = struct.pack("<B", 2) + frame(DATA, b"\0" * 8)[:16] * 3
    found = running(PAIR)
    tempting = frame(DATA, inside)
    assert len(inside) == len(PAYLOAD)
    assert told(found.hear(tempting * 3)) == [("2 states, 57 bytes", tempting)] * 3


def test_every_damaged_byte_is_a_reject_or_moves_no_other_field() -> None:
    good = frame(DATA, PAYLOAD)
    for at in range(len(good)):
        found = running(PAIR)
        bad = good[:at] + bytes((good[at] ^ 0xFF,)) + good[at + 1 :]
        events = found.hear(bad + good * 90)
        frames = [event.raw for event in events if isinstance(event, Frame)]
        if 6 <= at < len(good) - 2 or at == 2:
            assert frames == [bad] + [good] * 90
        else:
            assert set(frames) == {good}
            assert any(isinstance(event, (Reject, Skipped)) for event in events)


def test_half_a_frame_and_then_silence_is_truncated() -> None:
    found = running(PAIR)
    assert found.hear(frame(DATA, PAYLOAD)[:30]) == []
    (left,) = found.decoder.end()
    assert (left.reason, left.detail) == ("truncated", "the header promises 57 bytes, 30 came")


def test_a_message_in_the_middle_of_data_is_skipped_and_a_warning_is_shown() -> None:
    found = running(PAIR)
    events = found.hear(frame(DATA, PAYLOAD) + frame(MESSAGE, b"\x02joint 3 is warm") + frame(DATA, PAYLOAD))
    assert [type(event) for event in events] == [Frame, Skipped, Frame]
    assert found.decoder.notes == ['the controller says "joint 3 is warm"']
    found.hear(frame(MESSAGE, b"\x01by the way"))
    assert found.decoder.notes == ['the controller says "joint 3 is warm"']


def test_answers_that_nobody_asked_for_change_nothing() -> None:
    found = running(PAIR)
    events = found.hear(success("UINT8,DOUBLE_6,INT32") + frame(FIRMWARE, b"FR5") + frame(MESSAGE))
    assert [type(event) for event in events] == [Skipped] * 3
    assert found.decoder.ready
    assert len(found.sent) == 3


def test_an_answer_that_is_no_list_of_types_is_no_answer() -> None:
    found = talk(PAIR)
    found.deaf = 1
    found.tick(2)
    for text in ("", "STOP_OK", "hello, world"):
        found.hear(success(text))
    assert set(found.skipped) == {"message"}
    assert found.configurations == [PAIR.states]
    found.decoder.feed(success("UINT8,DOUBLE_6"))
    assert found.decoder.outgoing() == START


def test_data_frames_of_a_wrong_length_are_rejected_and_several_in_a_row_configure_again() -> None:
    found = running(PAIR)
    short = frame(DATA, PAYLOAD[:-8])
    good = frame(DATA, PAYLOAD)
    for _ in range(4):
        found.hear(short)
    found.hear(good)
    for _ in range(4):
        found.hear(short)
    assert found.rejects == ["length"] * 8
    assert len(found.sent) == 3
    found.hear(short)
    assert found.sent[3:] == [STOP]
    assert not found.decoder.ready
    found.tick(3)
    assert found.sent[4:] == [configuration(PAIR.states, 8), START]
    assert found.decoder.ready


def test_types_that_differ_from_the_table_are_the_truth_and_are_noted() -> None:
    found = running(PAIR, CndeBehaviour(types={"program_state": "INT32"}))
    assert vendor_values(found.frames[0])["program_state"] == 2
    assert found.frames[0].layout.by_name["program_state"].type == "i32"
    assert found.decoder.notes == ["types that differ from the vendor's table: program_state (INT32, not UINT8)"]


def test_types_that_no_field_can_hold_are_stepped_over_and_noted() -> None:
    decoder = CndeDecoder(PAIR, Learned(Narrowing(PAIR.states)))
    decoder.outgoing(), decoder.tick(), decoder.tick()
    decoder.feed(success("DOUBLE_3,DOUBLE_6"))
    (found,) = decoder.feed(frame(DATA, struct.pack("<9d", 1, 2, 3, *JOINTS)))
    assert isinstance(found, Frame)
    assert vendor_values(found)["jt_cur_pos"] == list(JOINTS)
    assert vendor_values(found)["program_state"] is None
    assert decoder.notes == ["left out, their types do not fit their fields: program_state (DOUBLE_3)"]


@pytest.mark.parametrize("types", ["UINT8", "UINT8,DOUBLE_6,INT32"])
def test_a_wrong_number_of_types_is_a_refusal(types: str) -> None:
    learned = Learned(Narrowing(PAIR.states))
    decoder = CndeDecoder(PAIR, learned)
    decoder.outgoing(), decoder.tick(), decoder.tick()
    decoder.feed(success(types))
    assert decoder.outgoing() == STOP
    assert not decoder.ready
    assert learned.said == f"{types.count(',') + 1} types for 2 states"


def test_a_state_of_an_unknown_type_is_left_out() -> None:
    found = talk(PAIR)
    found.deaf = 1
    found.tick(2)
    found.hear(success("FLOAT_3,DOUBLE_6"))
    found.tick(4)
    assert found.configurations[1:] == [("actual_joint_pos",)]
    assert found.frames
    assert found.decoder.notes == ["the controller refuses program_state; it says FLOAT_3 for a type"]


def test_a_refused_state_is_found_named_and_kept_for_the_run() -> None:
    known = set(ALL_STATES) - {"line_number"}
    options = CndeOptions()
    learned = Learned(Narrowing(options.wanted))
    found = talk(options, CndeBehaviour(known=known), learned)
    found.tick(60)
    assert found.frames
    assert len(found.configurations) <= Narrowing.MOST_TRIES
    assert set(found.configurations[-1]) == known
    (note,) = found.decoder.notes
    assert note == 'the controller refuses line_number; it says "NOT_FOUND"'
    again = talk(options, CndeBehaviour(known=known), learned)
    again.tick(4)
    assert again.configurations == [found.configurations[-1]]
    assert again.frames
    assert again.decoder.notes == found.decoder.notes


def test_a_controller_that_refuses_everything_is_refused_and_asked_anew_later() -> None:
    learned = Learned(Narrowing(CndeOptions().wanted))
    for _ in range(2):
        found = talk(behaviour=CndeBehaviour(known=()), learned=learned)
        found.tick(60)
        assert len(found.configurations) <= Narrowing.MOST_TRIES
        assert found.refusals[0].kind == "refused"
        assert 'it says "NOT_FOUND"' in found.refusals[0].reason


def test_a_controller_that_refuses_to_start_is_refused_after_three_configurations() -> None:
    decoder = CndeDecoder(PAIR, Learned(Narrowing(PAIR.states)))
    for _ in range(3):
        assert decoder.outgoing() == STOP
        assert [decoder.tick(), decoder.tick()] == [b"", configuration(PAIR.states, 8)]
        decoder.feed(success("UINT8,DOUBLE_6"))
        assert decoder.outgoing() == START
        events = decoder.feed(frame(MESSAGE, b"\x03BUSY"))
    assert events[-1] == Refused('the controller refuses to start; it says "BUSY"', "refused")


def test_nothing_but_what_is_allowed_is_ever_sent() -> None:
    for behaviour in (None, CndeBehaviour(known=set(ALL_STATES) - {"alarm"})):
        for options in (CndeOptions(period_ms=200), CndeOptions(transport="udp")):
            found = talk(options, behaviour)
            found.tick(60)
            for sent in (*found.sent, found.decoder.goodbye(), FirmwareProbe().outgoing()):
                assert any(re.fullmatch(pattern, sent) for pattern in CNDE.outgoing), sent
                assert sent[3] not in {0, 5}
    assert not any(re.fullmatch(pattern, frame(kind, b"\0")) for kind in (0, 5, 6, 7) for pattern in CNDE.outgoing)


def test_options_name_what_is_wrong_with_states() -> None:
    with pytest.raises(ValueError, match="'tool' is a field of the state 'tool_id'"):
        CndeOptions(states=("tool",))
    with pytest.raises(ValueError, match="'a,b' is no name of a state"):
        CndeOptions(states=("a,b",))
    with pytest.raises(ValueError, match="'alarm' stands twice"):
        CndeOptions(states=("alarm", "alarm"))
    with pytest.raises(ValueError, match="too many"):
        CndeOptions(states=tuple(f"output_DOUBLE_reg_{number:03}" for number in range(256)))
    with pytest.raises(msgspec.ValidationError):
        msgspec.convert({"period_ms": 4}, CndeOptions)


def test_two_robots_learn_nothing_from_each_other() -> None:
    first, second = make_decoders(CndeOptions(), 0), make_decoders(CndeOptions(), 0)
    decoders = [make() for make in (first, first, second)]
    assert all(isinstance(decoder, CndeDecoder) for decoder in decoders)
    learned = [decoder._learned for decoder in decoders if isinstance(decoder, CndeDecoder)]
    assert learned[0] is learned[1]
    assert learned[0] is not learned[2]


def test_the_probe_asks_for_the_version_and_starts_nothing() -> None:
    probe = FirmwareProbe()
    assert probe.outgoing() == frame(FIRMWARE)
    assert probe.outgoing() == b""
    assert [probe.tick() for _ in range(10)].count(frame(FIRMWARE)) == 2
    probe.feed(success("FR5,V3.9.7"))
    assert probe.notes == ['the controller says "FR5,V3.9.7"']
    assert probe.goodbye() == b""
