"""The tables against a second transcription of the page, made from its C# declarations alone."""

from __future__ import annotations

import struct
from itertools import pairwise

import pytest

from gateway.api.layout import Layout
from tests.vendors.fairino.page import CODES, ROBOT_STATE_PKG, members, scalars
from vendors.fairino.layouts import (
    CHECKSUM_SIZE,
    CNDE_FIELDS,
    CNDE_STATES,
    FIRMWARE,
    LEGACY_LAYOUTS,
    LONGEST,
    STATES,
    STATUS_357,
    STATUS_433,
)

TYPES = {"byte": "u8", "UInt16": "u16", "int": "i32", "float": "f32", "double": "f64"}
SIZES = (584, 609, 773, 777, 888, 900, 902, 954, 960, 1184, 1236, 2073, 2074, 2075)
# What every size ends with, by the vendor's SDKs.
LAST_FIELDS = {
    584: "gripper_voltage",
    609: "auxState_servoTorque",
    773: "extAOState",
    777: "rbtEnableState",
    888: "endLuaErrCode",
    900: "gripperRotTorque",
    902: "weldingBreakOffState_weldArcState",
    954: "smartToolState",
    960: "wideVoltageCtrlBoxFanVel",
    1184: "loadCog",
    1236: "servoJCmdNum",
    2073: "tsWebStateComErr",
    2074: "exaxisCoordID",
    2075: "programRunState",
}


def declared() -> dict[str, tuple[int, str, int]]:
    """Offset, type and elements of every scalar and array, by adding up the declarations."""
    found, at = {}, 0
    for name, kind, count in scalars():
        size = struct.calcsize(f"<{CODES[kind]}")
        if name in {"cl_analog_input", "cl_analog_output"}:
            for index in range(count):
                found[f"{name}_{index}"] = (at + index * size, TYPES[kind], 1)
        else:
            found[name] = (at, TYPES[kind], count)
        at += size * count
    return found


def test_every_declaration_stands_where_the_page_has_it() -> None:
    wanted = declared()
    assert [field.name for field in LONGEST.fields] == list(wanted)
    for field in LONGEST.fields:
        offset, kind, count = wanted[field.name]
        if field.is_opaque:
            assert (field.offset, kind, field.size) == (offset, "u8", count)
        else:
            assert (field.offset, field.type, field.elements) == (offset, kind, count), field.name
            assert (field.count is None) == (count == 1), field.name


def test_the_page_has_133_members_and_2073_bytes() -> None:
    assert len(list(members(ROBOT_STATE_PKG))) == 133
    assert LONGEST.by_name["exaxisCoordID"].offset + CHECKSUM_SIZE == 2073


def test_there_are_no_gaps() -> None:
    ends = [field.end for field in LONGEST.fields]
    assert [field.offset for field in LONGEST.fields] == [0, *ends[:-1]]
    assert ends[-1] == LONGEST.size


def test_every_known_size_is_a_prefix_that_ends_with_a_whole_field() -> None:
    assert tuple(FIRMWARE) == SIZES
    assert tuple(layout.size + CHECKSUM_SIZE for layout in LEGACY_LAYOUTS) == SIZES
    for layout in LEGACY_LAYOUTS:
        here = [field for field in layout.fields if field.present]
        assert layout.name == str(layout.size + CHECKSUM_SIZE)
        assert here[-1].name == LAST_FIELDS[int(layout.name)]
        assert here[-1].end == layout.size
        assert all(field.present == field.elements for field in here)


@pytest.mark.parametrize("layout", [*LEGACY_LAYOUTS, STATUS_433, STATUS_357], ids=lambda layout: str(layout.name))
def test_tables_hold(layout: Layout) -> None:
    assert layout.problems() == []


def test_ids_3_to_133_are_134_names_and_each_field_belongs_to_one() -> None:
    assert [state.id for state in STATES] == sorted(state.id or 0 for state in STATES)
    assert {state.id for state in STATES} == set(range(3, 134))
    doubled = [state.id for state, after in pairwise(STATES) if state.id == after.id]
    assert doubled == [26, 59, 64]
    names = [state.name for state in STATES]
    assert len(set(names)) == len(names) == 134
    fields = [name for state in STATES for name in state.fields]
    assert fields == [field.name for field in LONGEST.fields[3:]]


def test_packed_states_have_as_many_bytes_as_their_fields() -> None:
    for state in STATES:
        if state.packed:
            rows = [LONGEST.by_name[name] for name in state.fields]
            assert state.type == f"UINT8_{rows[-1].end - rows[0].offset}"


def test_states_that_only_the_cnde_page_names_have_their_fields() -> None:
    assert [name for state in CNDE_STATES for name in state.fields] == [field.name for field in CNDE_FIELDS]
    assert not {field.name for field in CNDE_FIELDS} & set(LONGEST.by_name)


def test_port_8083_names_only_what_was_confirmed() -> None:
    named = {field.name for field in STATUS_433.fields if not field.name.startswith("unconfirmed_raw")}
    frame_parts = {"frame_head", "frame_cnt", "data_len"}
    confirmed = {"program_state", "jt_cur_pos", "tl_cur_pos", "jt_cur_tor", "program_name", "ft_sensor_data"}
    assert named == frame_parts | confirmed
    assert [field.offset for field in STATUS_433.fields][3:] == [5, 6, 8, 56, 104, 108, 156, 176, 184, 232]
    assert STATUS_433.fields[-1].end == 431
    assert STATUS_357.fields[-1].end == 355
