"""Compiled readers: one frame to one canonical group."""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.api import model
from gateway.api.compiler import compile_group, compile_vendor
from gateway.api.decoder import Frame
from gateway.api.layout import Field, Flag, Layout
from gateway.api.model import Quality
from gateway.api.normaliser import Normaliser
from gateway.api.reader import Reader
from gateway.api.readers import raw_values
from gateway.api.signals import Signal

TABLE = Layout(
    name="table",
    size=64,
    source="x",
    fields=(
        Field(name="angles", offset=0, type="f32", count=3, unit="deg"),
        Field(name="pose", offset=12, type="f32", count=6, unit="mm|deg"),
        Field(name="volts", offset=36, type="f32", count=2, unit="V"),
        Field(
            name="word",
            offset=44,
            type="u32",
            flags=(Flag(name="low", bit=0, width=2), Flag(name="bit", bit=7), Flag(name="top", bit=31)),
        ),
        Field(name="inputs", offset=48, type="i32", count=2, flags=(Flag(name="on", bit=0, width=2),)),
        Field(name="speed", offset=56, type="f32"),
        Field(name="seconds", offset=60, type="i32", unit="s"),
    ),
)


def compiled(*rows: Signal, layout: Layout = TABLE, options: Mapping[str, object] = {}) -> Reader:
    reader = compile_group(rows[0].group, layout, rows, options)
    assert reader is not None
    return reader


def read(values: Mapping[str, object], *rows: Signal, **more: object) -> tuple[object, Quality]:
    return compiled(*rows, **more).read(Frame(b"head" + TABLE.encode(values), TABLE, 4))  # type: ignore[arg-type] # layout, options


def test_units_follow_from_the_table() -> None:
    found, quality = read({"angles": [180.0, -90.0, 0.0]}, Signal("joints.position", "angles"))
    assert isinstance(found, model.Joints)
    assert found.position == pytest.approx([math.pi, -math.pi / 2, 0])
    assert quality is Quality.GOOD


def test_a_pose_takes_its_rotation_from_the_row() -> None:
    values = {"pose": [100.0, 200.0, -300.0, 0.0, 0.0, 90.0]}
    found, _ = read(values, Signal("tcp.pose", "pose", rotation="rpy_fixed_xyz"), Signal("tcp.target_pose", "pose"))
    assert isinstance(found, model.Tcp)
    assert found.pose is not None
    assert found.target_pose is not None
    assert found.pose.position == pytest.approx([0.1, 0.2, -0.3])
    assert found.pose.orientation == pytest.approx([0, 0, math.sqrt(0.5), math.sqrt(0.5)])
    assert found.target_pose.orientation is None


def test_a_substituted_row_is_named_and_sets_the_quality() -> None:
    row = Signal("tcp.pose", "pose", rotation="rpy_fixed_xyz", quality=Quality.SUBSTITUTED)
    reader = compiled(row)
    found, quality = reader.read(Frame(TABLE.encode({}), TABLE))
    assert isinstance(found, model.Tcp)
    assert found.substituted == ["pose"]
    assert quality is Quality.SUBSTITUTED


def test_bits_and_flags_become_booleans_of_their_own_bits_only() -> None:
    rows = (Signal("io.digital_in.box", "inputs"), Signal("io.digital_in.tool", ("inputs.on", "word.bit", "word.top")))
    found, _ = read({"inputs": [4, 3], "word": 0x8000_0000}, *rows)
    assert isinstance(found, model.Io)
    assert found.digital_in == {"box": [True, True], "tool": [False, True, False, True]}


def test_channels_carry_their_unit() -> None:
    found, _ = read({"volts": [1.5, -2.0]}, Signal("analog.analog_in.box", "volts"))
    assert isinstance(found, model.Analog)
    assert found.analog_in == {"box": model.Channels([1.5, -2.0], "V")}


def test_a_function_takes_raw_values_and_options() -> None:
    row = Signal(
        "status.tool_id", ("word.low", "inputs"), lambda low, both, base: low + sum(both) + base, options=("base",)
    )
    found, _ = read({"word": 3, "inputs": [10, 20]}, row, options={"base": 100})
    assert isinstance(found, model.Status)
    assert found.tool_id == 133


@pytest.mark.parametrize(("word", "fault", "calls"), [(0, [], 0), (0x8000_0003, [], 0), (128, ["7"], 1)])
def test_a_calm_row_calls_its_function_only_where_a_source_is_not_zero(word: int, fault: list[str], calls: int) -> None:
    called = []

    def faults(bit: int, inputs: list[int]) -> list[model.Fault]:
        called.append((bit, inputs))
        return [model.Fault("7")] if bit else []

    reader = compiled(Signal("status.faults", ("word.bit", "inputs"), faults, calm=list))
    called.clear()  # it was asked once what it says of zeros
    found, _ = reader.read(Frame(TABLE.encode({"word": word}), TABLE))
    assert isinstance(found, model.Status)
    assert [one.code for one in found.faults or []] == fault
    assert len(called) == calls


@pytest.mark.parametrize(("word", "faults"), [(0, 0), (128, 1)])
def test_a_calm_row_says_the_same_beside_a_value_that_is_not_finite(word: int, faults: int) -> None:
    calm = Signal("status.faults", "word.bit", lambda bit: [model.Fault("7")] * bit, calm=list)
    found, quality = read({"word": word, "speed": math.nan}, calm, Signal("status.speed_override", "speed"))
    assert isinstance(found, model.Status)
    assert (len(found.faults or []), found.speed_override, quality) == (faults, None, Quality.BAD)
    assert found.faults is not None


def test_an_array_of_two_units_has_an_equal_share_of_each() -> None:
    twisted = Layout(
        name="twisted",
        size=24,
        source="x",
        fields=(Field(name="twist", offset=0, type="f32", count=6, unit="mm/s|deg/s"),),
    )
    values = [1000.0, 2000.0, math.nan, 180.0, 90.0, 0.0]
    reader = compiled(Signal("tcp.twist", "twist"), layout=twisted)
    found, quality = reader.read(Frame(twisted.encode({"twist": values}), twisted))
    assert isinstance(found, model.Tcp)
    assert found.twist is not None
    assert found.twist[2] is None
    assert [*found.twist[:2], *found.twist[3:]] == pytest.approx([1.0, 2.0, math.pi, math.pi / 2, 0.0])
    assert quality is Quality.BAD


def test_what_is_said_of_zeros_must_be_what_the_function_says() -> None:
    with pytest.raises(ValueError, match=r"status\.in_error: of zeros .* says True, calm says False"):
        compiled(Signal("status.in_error", "word", lambda word: word == 0, calm=bool))


def test_nested_keys_build_nested_structs() -> None:
    rows = (Signal("status.program.run_time", "seconds"), Signal("status.speed_override", "speed"))
    found, _ = read({"seconds": 7, "speed": 0.5}, *rows)
    assert isinstance(found, model.Status)
    assert found.program is not None
    assert (found.program.run_time, found.program.state, found.speed_override) == (7, None, 0.5)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_what_is_not_finite_is_null_and_flagged(value: float) -> None:
    rows = (Signal("joints.position", "angles"), Signal("joints.current", "angles", lambda _: [1.0]))
    found, quality = read({"angles": [1.0, value, 2.0]}, *rows)
    assert isinstance(found, model.Joints)
    assert quality is Quality.BAD
    assert found.position is not None
    assert [part is None for part in found.position] == [False, True, False]
    assert found.current is None


def test_opposite_infinities_and_sums_beyond_a_float_are_told_apart() -> None:
    row = Signal("joints.position", "angles")
    assert read({"angles": [math.inf, -math.inf, 0.0]}, row)[1] is Quality.BAD
    assert read({"angles": [3e38, 3e38, 3e38]}, row)[1] is Quality.GOOD


def test_a_partial_function_is_called_with_none() -> None:
    row = Signal("status.tool_id", ("speed", "word.low"), lambda speed, low: -1 if speed is None else low, partial=True)
    assert read({"speed": math.nan, "word": 2}, row)[0] == model.Status(tool_id=-1)
    short = TABLE.prefix(56, name="short")
    found = compiled(row, layout=short).read(Frame(bytes(56), short))
    assert found == (model.Status(tool_id=-1), Quality.GOOD)


def test_what_is_cut_off_is_null_and_never_calls_a_function() -> None:
    def fail(_: object) -> int:
        raise AssertionError

    short = TABLE.prefix(40, name="short")
    rows = (Signal("status.tool_id", "word.low", fail), Signal("status.speed_override", "speed"))
    found, _ = compiled(*rows, layout=short).read(Frame(bytes(40), short))
    assert found == model.Status()
    analog, _ = compiled(Signal("analog.analog_in.box", "volts"), layout=short).read(Frame(bytes(40), short))
    assert analog == model.Analog(analog_in={"box": model.Channels([0.0, None], "V")})


def test_a_quality_counts_only_where_its_sources_are_in_the_frame() -> None:
    row = Signal("status.speed_override", "speed", quality=Quality.UNCERTAIN)
    assert compiled(row).read(Frame(bytes(64), TABLE))[1] is Quality.UNCERTAIN
    short = TABLE.prefix(40, name="short")
    assert compiled(row, layout=short).read(Frame(bytes(40), short))[1] is Quality.GOOD


def test_a_group_without_rows_has_no_reader() -> None:
    assert compile_group("wrench", TABLE, [Signal("joints.position", "angles")], {}) is None


@pytest.mark.parametrize(
    ("rows", "words"),
    [
        ((Signal("joints.position", "nothing"),), "no field or flag 'nothing'"),
        ((Signal("joints.nothing", "angles"),), "the model has no key"),
        ((Signal("joints.position", "volts"),), "converts to 'V', not to 'rad'"),
        ((Signal("joints.position", "inputs"),), "its source has no unit"),
        ((Signal("joints.position", ("angles", "volts")),), "different units"),
        ((Signal("joints.position", "angles"), Signal("joints.position", "angles")), "stands twice"),
        ((Signal("tcp.pose", "angles"),), "a pose needs a source in `mm|deg`"),
        ((Signal("status.tool_id", "inputs"),), "2 values need a function"),
        ((Signal("status.tool_id", "word.low", int, options=("nothing",)),), "no option 'nothing'"),
        ((Signal("analog.analog_in.box", "inputs"),), "channels without a unit"),
    ],
)
def test_a_row_that_cannot_be_is_refused(rows: tuple[Signal, ...], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        compiled(*rows)


def test_the_key_follows_the_named_bits_and_no_others() -> None:
    key = compiled(Signal("safety.collision", "word.low"), Signal("safety.soft_limit", "word.top")).key
    before = key(Frame(TABLE.encode({"word": 0}), TABLE))
    assert key(Frame(TABLE.encode({"word": 0x7FFF_FFFC, "speed": 1.0}), TABLE)) == before
    assert key(Frame(TABLE.encode({"word": 1}), TABLE)) != before
    assert key(Frame(TABLE.encode({"word": 0x8000_0000}), TABLE)) != before


def test_the_key_leaves_volatile_rows_out_and_takes_nan_for_the_same_nan() -> None:
    rows = (Signal("status.speed_override", "speed"), Signal("status.program.run_time", "seconds", volatile=True))
    key = compiled(*rows).key
    assert key(Frame(TABLE.encode({"seconds": 1}), TABLE)) == key(Frame(TABLE.encode({"seconds": 2}), TABLE))
    assert key(Frame(TABLE.encode({"speed": math.nan}), TABLE)) == key(Frame(TABLE.encode({"speed": math.nan}), TABLE))
    assert key(Frame(TABLE.encode({"speed": 0.5}), TABLE)) != key(Frame(TABLE.encode({"speed": 0.25}), TABLE))


def test_raw_values_are_read_by_source() -> None:
    payload = TABLE.encode({"word": 0x81, "inputs": [7, 8], "speed": math.nan})
    found = raw_values(Frame(payload, TABLE), ["word", "word.bit", "inputs.on", "speed"])
    assert found == {"word": 0x81, "word.bit": 1, "inputs.on": [3, 0], "speed": None}
    assert raw_values(Frame(payload, TABLE.prefix(44, name="short")), ["word.bit"]) == {"word.bit": None}


def test_the_vendor_group_names_every_field_and_flag() -> None:
    payload = TABLE.encode({"word": 0x83, "angles": [1.0, math.nan, 2.0]})
    found, quality = compile_vendor(TABLE).read(Frame(payload, TABLE))
    assert isinstance(found, dict)
    assert set(found) == set(TABLE.by_name)
    assert found["word"] == {"raw": 0x83, "low": 3, "bit": 1, "top": 0}
    assert found["inputs"] == [{"raw": 0, "on": 0}, {"raw": 0, "on": 0}]
    assert (found["angles"], quality) == ([1.0, None, 2.0], Quality.BAD)


def test_a_normaliser_compiles_once_a_layout_and_finds_sources_of_a_subtree() -> None:
    rows = [Signal("status.program.run_time", "seconds"), Signal("status.program.line", "word.low")]
    normaliser = Normaliser(rows, {})
    assert normaliser.groups == ("status", "vendor")
    assert normaliser.readers(TABLE) is normaliser.readers(TABLE)
    assert normaliser.sources("status.program") == ("seconds", "word.low")
    assert normaliser.sources("status.program.line") == ("word.low",)


@given(st.binary(min_size=64, max_size=64))
def test_no_bytes_make_a_reader_raise_or_tell_what_is_not_finite(payload: bytes) -> None:
    found, quality = compiled(Signal("joints.position", "angles")).read(Frame(payload, TABLE))
    assert isinstance(found, model.Joints)
    words = struct.unpack_from("<3f", payload)
    assert (quality is Quality.BAD) is not all(map(math.isfinite, words))
    assert [part is None for part in found.position or ()] == [not math.isfinite(word) for word in words]
