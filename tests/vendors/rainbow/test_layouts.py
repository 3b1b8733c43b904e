"""The state table, against a second transcription of both manuals: names, types, counts; words, shifts, masks."""

from __future__ import annotations

import re
import struct

import pytest

from gateway.api.layout import TYPES
from vendors.rainbow.layouts import LAYOUTS, STATE_464, STATE_484, STATE_488, STATE_512, STATE_580

# The struct declaration of reqdata V 4.3.1, in its order.
DECLARATION = """
char header[4]; float time; float jnt_ref[6]; float jnt_ang[6]; float jnt_cur[6]; float tcp_ref[6]; float tcp_pos[6];
float analog_in[4]; float analog_out[4]; int digital_in[16]; int digital_out[16]; float jnt_temperature[6];
int task_pc; int task_repeat; int task_run_id; int task_run_num; int task_run_time; int task_state;
float default_speed; int robot_state; int information_chunk_1; float reserved_1[6]; int jnt_info[6];
int collision_detect_onoff; int is_freedrive_mode; int real_vs_simulation_mode; int init_state_info; int init_error;
float tfb_analog_in[2]; int tfb_digital_in[2]; int tfb_digital_out[2]; float tfb_voltage_out;
int op_stat_collision_occur; int op_stat_sos_flag; int op_stat_self_collision; int op_stat_soft_estop_occur;
int op_stat_ems_flag; int information_chunk_2; int information_chunk_3; int inbox_trap_flag[2]; int inbox_check_mode[2];
float eft_fx; float eft_fy; float eft_fz; float eft_mx; float eft_my; float eft_mz; int information_chunk_4;
float extend_io1_analog_in[4]; float extend_io1_analog_out[4]; unsigned extend_io1_digital_info; float aa_joint_ref[6];
unsigned safety_board_stat_info;
"""
C_SIZES = {"char": 1, "float": 4, "int": 4, "unsigned": 4}
# The remarks "Byte count" of the same declaration: offsets that the manual itself states.
BYTE_COUNTS = {
    "time": 4,
    "tcp_ref": 80,
    "analog_in": 128,
    "jnt_temperature": 288,
    "task_pc": 312,
    "default_speed": 336,
    "reserved_1": 348,
    "collision_detect_onoff": 396,
    "init_state_info": 408,
    "tfb_analog_in": 416,
    "op_stat_collision_occur": 444,
    "information_chunk_2": 464,
    "inbox_trap_flag": 472,
    "eft_fx": 488,
    "information_chunk_4": 512,
    "extend_io1_analog_in": 516,
    "aa_joint_ref": 552,
    "safety_board_stat_info": 576,
}

Bits = set[tuple[int, int]]  # shift and width of `(word >> shift) & 0b1…`


def runs(text: str) -> Bits:
    """Shifts and widths, written `3` for one bit and `16:6` for more."""
    pairs = (one.split(":") for one in text.split())
    return {(int(shift), int(width[0]) if width else 1) for shift, *width in pairs}


EACH_BIT = " ".join(map(str, range(32)))
V431: dict[str, Bits] = {
    "information_chunk_1": runs("0 1 2 3 4 5 6 7 30 31"),
    "jnt_info": runs("0 1 2 3 4 5 6 7 8 9 10 11 12 13 14 15"),
    "information_chunk_2": runs("0:2 2:16"),
    "information_chunk_3": runs("0:2"),
    # The welding current is printed with 16 bits here: they would reach over the bits 28 and 29 of the same page.
    "information_chunk_4": runs("0:2 2:6 8:2 10 11 12 13 14 28:2"),
    "extend_io1_digital_info": runs(EACH_BIT),
}
V610: dict[str, Bits] = {
    "information_chunk_1": runs("0 1 2 3 4 5 6 7 8 9 10 11 12 13 14 15 16:6 22:6 28 29 30 31"),
    "jnt_info": runs("0 1 2 3 4 5 6 7 8 9 10 11 12 13 14 15"),
    "is_freedrive_mode": runs("0:2"),
    "real_vs_simulation_mode": runs("0:4"),
    "init_state_info": runs("0:6"),
    "init_error": runs("0:12"),
    "tfb_digital_in": runs("0:2"),
    "tfb_digital_out": runs("0:2"),
    "op_stat_collision_occur": runs("0:2"),
    "op_stat_sos_flag": runs("0:6"),
    "op_stat_self_collision": runs("0:2 2:2 4:28"),
    "op_stat_ems_flag": runs("0:6"),
    "information_chunk_2": runs("0:2 2:16 18:2 20:2 22:8"),
    "information_chunk_3": runs("0:2 2:16 18:2 20:2 22 23 24 25"),
    "inbox_trap_flag": runs("0:4"),
    "inbox_check_mode": runs("0:4"),
    "information_chunk_4": runs("0:2 2:6 8:2 10 11 12 13 14 15:13 28:2 30 31"),
    "extend_io1_digital_info": runs(EACH_BIT),
}
# Named in the table so that no bit of these words is lost; neither manual gives them a meaning.
RESERVED = {"jnt_info": runs("16:16"), "information_chunk_2": runs("30:2"), "information_chunk_3": runs("26:6")}


def declared() -> list[tuple[str, str, int | None]]:
    """Name, C type and count of each member."""
    found = re.findall(r"(\w+) (\w+)(?:\[(\d+)\])?;", DECLARATION)
    return [(name, kind, int(count) if count else None) for kind, name, count in found]


def test_the_table_has_the_fields_of_the_declaration_in_its_order() -> None:
    assert [(field.name, field.count) for field in STATE_580.fields] == [(name, count) for name, _, count in declared()]


def test_offsets_follow_from_the_declaration_by_the_rules_of_c() -> None:
    at = 0
    for (name, kind, count), field in zip(declared(), STATE_580.fields, strict=True):
        size = C_SIZES[kind]
        at += -at % size
        assert (field.name, field.offset, field.item_size) == (name, at, size)
        at += size * (count or 1)
    assert at == STATE_580.size == 580
    assert at // 4 == 145


def test_offsets_are_those_that_the_manual_remarks() -> None:
    assert {name: STATE_580.by_name[name].offset for name in BYTE_COUNTS} == BYTE_COUNTS


def test_types_are_those_of_the_declaration_but_words_of_bits_are_unsigned() -> None:
    chunks = {
        name for name in V610 if name.startswith("information_chunk") or name in {"jnt_info", "op_stat_self_collision"}
    }
    for name, kind, _ in declared():
        expected = "u32" if name in chunks else {"char": "u8", "float": "f32", "int": "i32", "unsigned": "u32"}[kind]
        assert STATE_580.by_name[name].type == expected, name


def test_every_bit_of_both_manuals_is_a_flag_and_no_other_is() -> None:
    table = {field.name: {(flag.bit, flag.width) for flag in field.flags} for field in STATE_580.fields if field.flags}
    assert table == {name: bits | RESERVED.get(name, set()) for name, bits in V610.items()}


def test_flags_say_which_manual_names_them_first() -> None:
    for name, (field, flag) in STATE_580.flag_owner.items():
        older = (flag.bit, flag.width) in V431.get(field.name, set())
        unnamed = (flag.bit, flag.width) in RESERVED.get(field.name, set())
        welding = flag.name == "target_weld_current_x10"
        assert (flag.since == "") is (older or unnamed or welding), name


def test_extension_inputs_are_the_low_half_and_outputs_the_high_half() -> None:
    for number in range(16):
        assert STATE_580.flag_owner[f"extend_io1_digital_info.ext_di_{number}"][1].bit == number
        assert STATE_580.flag_owner[f"extend_io1_digital_info.ext_do_{number}"][1].bit == 16 + number


@pytest.mark.parametrize("layout", LAYOUTS, ids=lambda layout: layout.name)
def test_the_lint_has_nothing_to_say(layout: object) -> None:
    assert layout in LAYOUTS
    assert [problem for table in LAYOUTS for problem in table.problems()] == []


@pytest.mark.parametrize(
    ("layout", "words", "last"),
    [
        (STATE_464, 116, "op_stat_ems_flag"),
        (STATE_484, 121, "inbox_check_mode"),
        (STATE_488, 122, "inbox_check_mode"),
        (STATE_512, 128, "eft_mz"),
        (STATE_580, 145, "safety_board_stat_info"),
    ],
    ids=lambda value: getattr(value, "name", None),
)
def test_older_frames_end_where_the_notes_say(layout: object, words: int, last: str) -> None:
    (found,) = [table for table in LAYOUTS if table is layout]
    assert found.size == 4 * words
    assert [field.name for field in found.fields if field.present][-1] == last


def test_the_484_bytes_hold_one_of_two_check_modes() -> None:
    assert STATE_484.by_name["inbox_check_mode"].present == 1
    assert STATE_488.by_name["inbox_check_mode"].present == 2


def test_the_run_time_is_read_from_frames_of_580_bytes_only() -> None:
    assert [layout.by_name["task_run_time"].present for layout in LAYOUTS] == [1, 0, 0, 0, 0]


def test_the_whole_frame_is_one_struct_without_padding() -> None:
    codes = {"char": "B", "float": "f", "int": "i", "unsigned": "I"}
    assert struct.calcsize("<" + "".join(f"{count or 1}{codes[kind]}" for _, kind, count in declared())) == 580
    assert {field.type for field in STATE_580.fields} <= set(TYPES)
