"""Records: named values that a decoder has parsed, read into groups of the model and described."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import Annotated, cast

import jsonschema
import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec import Meta

from gateway.api.decoder import Frame
from gateway.api.describe import describe, vendor_schema
from gateway.api.layout import Field, Layout
from gateway.api.model import (
    Channels,
    Fault,
    Io,
    Joints,
    Motion,
    OperatingMode,
    Pose,
    Program,
    Quality,
    Safety,
    Status,
    Tcp,
    Wrench,
)
from gateway.api.normaliser import Normaliser
from gateway.api.reader import Reader
from gateway.api.readers import group_reader, raw_values, unit_of, vendor_reader, words_reader
from gateway.api.record import Record, Value
from gateway.api.rotations import pose_from_rpy
from gateway.api.signals import Signal
from gateway.server.fields import has, vendor_shape


class Maker(msgspec.Struct, frozen=True):
    """A struct inside a struct."""

    name: str | None = None


class Tool(msgspec.Struct, frozen=True):
    """A struct inside a value."""

    mass: float | None = None
    maker: Maker | None = None


class Key(msgspec.Struct, frozen=True):
    """Another one."""

    pressed: bool
    tool: Tool


RECORD = Record(
    name="told",
    source="invented",
    fields=(
        Value(name="angles", type=list[float | None], unit="deg", meaning="Joints"),
        Value(name="speed", type=float, unit="mm/s", meaning="Speed"),
        Value(name="override", type=float, unit="%", meaning="Override"),
        Value(name="ratio", type=float, meaning="Override without a unit"),
        Value(name="pose", type=list[float], unit="mm|deg", meaning="Position, angles and what follows"),
        Value(name="forces", type=list[float], meaning="No unit is given"),
        Value(name="mode", type=str, meaning="Mode"),
        Value(name="moving", type=bool, meaning="Whether it moves"),
        Value(name="line", type=int, meaning="Line"),
        Value(name="inputs", type=list[bool], meaning="Inputs"),
        Value(name="raw_in", type=list[float], meaning="Analog inputs"),
        Value(name="keys", type=dict[str, Key], meaning="Keys"),
        Value(name="tool", type=Tool, meaning="Tool"),
        Value(name="faults", type=list[Fault], meaning="Faults", own=True),
        Value(name="count", type=Annotated[int, Meta(ge=0)], unit="1", meaning="Counter"),
    ),
)
AS_TOLD = {
    "angles": [180.0, None],
    "speed": 1500.0,
    "override": 50.0,
    "ratio": 0.25,
    "pose": [1000.0, 2000.0, 3000.0, 0.0, 0.0, 180.0, 7.0],
    "forces": [1.0],
    "mode": "auto",
    "moving": True,
    "line": 3,
    "inputs": [True, False],
    "raw_in": [1.5],
    "keys": {"a": Key(pressed=True, tool=Tool(mass=1.0))},
    "tool": Tool(maker=Maker("x")),
    "faults": [Fault("7")],
    "count": 1,
}


def frame(**values: object) -> Frame:
    return Frame(b"", RECORD, values=values)


def reader(group: str, *signals: Signal, **options: object) -> Reader:
    found = group_reader(group, RECORD, signals, options)
    assert found is not None
    return found


def read(signal: Signal | Sequence[Signal], values: dict[str, object], **options: object) -> tuple[object, Quality]:
    signals = [signal] if isinstance(signal, Signal) else signal
    return reader(signals[0].group, *signals, **options).read(frame(**values))


def test_arrays_are_converted_element_by_element_and_null_stays_null() -> None:
    data, quality = read(Signal("joints.position", "angles"), AS_TOLD)
    assert (data, quality) == (Joints(position=[math.pi, None]), "GOOD")


def test_an_array_may_be_a_tuple() -> None:
    data, _ = read(Signal("joints.position", "angles"), {"angles": (180.0,)})
    assert data == Joints(position=[math.pi])


@pytest.mark.parametrize(
    ("key", "source", "value"),
    [
        ("tcp.speed", "speed", 1.5),
        ("status.speed_override", "override", 0.5),
        ("status.speed_override", "ratio", 0.25),
        ("status.in_motion", "moving", True),
        ("status.tool_id", "line", 3),
        ("status.faults", "faults", [Fault("7")]),
    ],
)
def test_scalars_are_converted_and_what_has_no_unit_is_taken_as_it_is(key: str, source: str, value: object) -> None:
    data, _ = read(Signal(key, source), AS_TOLD)
    assert getattr(data, key.partition(".")[2]) == value


@pytest.mark.parametrize("source", RECORD.by_name)
def test_a_value_that_was_not_told_is_null(source: str) -> None:
    row = Signal("status.operating_mode", source, lambda told: told)
    for values in ({}, {source: None}):
        assert read(row, cast("dict[str, object]", values)) == (Status(), "GOOD")


def test_a_pose_takes_six_numbers_and_leaves_what_follows() -> None:
    data, _ = read(Signal("tcp.pose", "pose", rotation="rpy_fixed_xyz"), AS_TOLD)
    assert data == Tcp(pose=pose_from_rpy(1.0, 2.0, 3.0, 0.0, 0.0, math.pi))


def test_a_pose_whose_rotation_is_not_known_has_no_orientation() -> None:
    assert read(Signal("tcp.pose", "pose"), AS_TOLD)[0] == Tcp(pose=Pose([1.0, 2.0, 3.0], None))


@pytest.mark.parametrize("told", [[], [1.0] * 5, [1.0, None, 1.0, 1.0, 1.0, 1.0], None])
def test_a_pose_that_is_not_whole_is_null(told: object) -> None:
    assert read(Signal("tcp.pose", "pose"), {"pose": told})[0] == Tcp()


def test_a_function_gets_the_sources_in_order_and_the_options_that_its_row_names() -> None:
    def via(mode: str, line: int, *, offset: int) -> int:
        return len(mode) + line + offset

    row = Signal("status.tool_id", ("mode", "line"), via, options=("offset",))
    assert read(row, AS_TOLD, offset=10, other=1)[0] == Status(tool_id=17)


def test_a_function_is_called_only_when_all_its_sources_are_told() -> None:
    row = Signal("status.tool_id", ("mode", "line"), lambda mode, line: len(mode) + line)
    assert read(row, {"mode": "auto"})[0] == Status()
    assert read(row, {"mode": "auto", "line": None})[0] == Status()


def test_a_partial_function_is_called_with_null_for_what_is_not_told() -> None:
    row = Signal("status.in_motion", ("moving", "line"), lambda moving, line: (moving, line) == (None, 3), partial=True)
    assert read(row, {"line": 3})[0] == Status(in_motion=True)


def test_nested_keys_make_structs_and_free_keys_make_mappings() -> None:
    rows = [
        Signal("status.program.line", "line"),
        Signal("status.program.name", "mode"),
        Signal("status.in_motion", "moving"),
    ]
    assert read(rows, AS_TOLD)[0] == Status(program=Program(name="auto", line=3), in_motion=True)
    banks = [Signal("io.digital_in.box", "inputs"), Signal("io.digital_in.tool", "inputs", lambda told: told[:1])]
    assert read(banks, AS_TOLD)[0] == Io(digital_in={"box": [True, False], "tool": [True]})
    assert read(banks, {})[0] == Io(digital_in={"box": None, "tool": None})


def test_a_bank_of_channels_is_made_by_a_function() -> None:
    row = Signal("analog.analog_in.box", "raw_in", lambda told: Channels(raw=told))
    assert getattr(read(row, AS_TOLD)[0], "analog_in") == {"box": Channels(raw=[1.5])}  # noqa: B009 - any group
    with pytest.raises(ValueError, match="needs a function"):
        reader("analog", dataclasses.replace(row, via=None))


def test_the_quality_of_a_row_counts_only_where_it_tells_something() -> None:
    rows = [Signal("joints.position", "angles"), Signal("joints.velocity", "angles", _none, quality=Quality.UNCERTAIN)]
    assert read(rows, AS_TOLD)[1] == "GOOD"
    rows[1] = dataclasses.replace(rows[1], via=lambda told: told)
    assert read(rows, AS_TOLD)[1] == "UNCERTAIN"
    assert read(rows, {})[1] == "GOOD"


def _none(_: object) -> None:
    return None


def test_a_commanded_value_shown_as_measured_is_listed_while_it_tells_something() -> None:
    rows = [
        Signal("tcp.pose", "pose", quality=Quality.SUBSTITUTED),
        Signal("tcp.speed", "speed", quality=Quality.SUBSTITUTED),
        Signal("tcp.elbow", "line", float),
    ]
    both, quality = read(rows, AS_TOLD)
    assert (cast("Tcp", both).substituted, quality) == (["pose", "speed"], "SUBSTITUTED")
    one, quality = read(rows, {"speed": 1.0})
    assert (cast("Tcp", one).substituted, quality) == (["speed"], "SUBSTITUTED")
    assert read(rows, {"line": 1}) == (Tcp(elbow=1.0), "GOOD")


def test_a_doubtful_value_is_uncertain_and_only_while_it_tells_something() -> None:
    def stopped(told: bool, *, low: bool) -> bool | None:  # noqa: FBT001 - a value of the record
        return told is not low if told or low else None

    def doubtful(told: bool, *, low: bool) -> bool:  # noqa: FBT001
        return not told

    row = Signal("status.e_stopped", "moving", stopped, options=("low",), doubt=doubtful)
    assert read(row, {"moving": False}, low=True) == (Status(e_stopped=True), "UNCERTAIN")
    assert read(row, {"moving": True}, low=True) == (Status(e_stopped=False), "GOOD")
    assert read(row, {"moving": False}, low=False) == (Status(), "GOOD")  # it tells nothing, so there is no doubt
    assert read(row, {}, low=True) == (Status(), "GOOD")


def test_a_plain_value_can_be_doubted_too_and_the_worse_quality_wins() -> None:
    row = Signal("tcp.speed", "speed", quality=Quality.SUBSTITUTED, doubt=lambda told: told > 1000)
    assert read(row, {"speed": 5.0})[1] == "SUBSTITUTED"
    assert read(row, {"speed": 5000.0})[1] == "UNCERTAIN"


@pytest.mark.parametrize("wrong", [math.nan, math.inf, -math.inf])
def test_what_is_not_finite_is_null_and_bad_and_never_reaches_a_function(wrong: float) -> None:
    assert read(Signal("tcp.speed", "speed"), {"speed": wrong}) == (Tcp(), "BAD")
    assert read(Signal("tcp.speed", "speed", lambda told: 1 / told), {"speed": wrong}) == (Tcp(), "BAD")
    told: dict[str, object] = {"angles": [0.0, wrong]}
    assert read(Signal("joints.position", "angles"), told) == (Joints(position=[0.0, None]), "BAD")
    assert read(Signal("tcp.pose", "pose"), {"pose": [wrong] * 6}) == (Tcp(), "BAD")
    data, quality = vendor_reader(RECORD).read(frame(speed=1.0, angles=[wrong], keys={"a": wrong}))
    assert quality == "BAD"
    assert cast("dict[str, object]", data)["speed"] == 1.0
    assert cast("dict[str, object]", data)["angles"] == [None]
    assert cast("dict[str, object]", data)["keys"] == {"a": None}


def test_a_value_of_another_group_makes_this_one_no_worse() -> None:
    assert read(Signal("tcp.speed", "speed"), {"speed": 1.0, "angles": [math.nan]})[1] == "GOOD"


def test_the_key_follows_the_sources_and_not_what_always_changes() -> None:
    rows = [Signal("status.in_motion", "moving"), Signal("status.program.run_time", "line", float, volatile=True)]
    status = reader("status", *rows)
    assert status.key(frame(moving=True, line=1)) == status.key(frame(moving=True, line=2, mode="x"))
    assert status.key(frame(moving=True)) != status.key(frame(moving=False))
    assert status.key(frame(moving=False)) != status.key(frame(moving=None))
    assert status.key(frame(keys={"a": 1}, moving=None)) == status.key(frame())
    assert status.volatile == (("program", "run_time"),)
    assert status.empty == Status()


def test_the_vendor_group_has_every_value_under_its_name() -> None:
    vendor = vendor_reader(RECORD)
    assert vendor.read(frame(**AS_TOLD)) == (AS_TOLD, "GOOD")
    assert vendor.read(frame(line=1, unknown=2))[0] == {**dict.fromkeys(AS_TOLD), "line": 1}
    assert vendor.empty == dict.fromkeys(AS_TOLD)
    assert vendor.key(frame(line=1)) != vendor.key(frame(line=2))


def test_a_group_without_rows_has_no_reader() -> None:
    assert group_reader("joints", RECORD, [Signal("status.in_motion", "moving")], {}) is None
    assert group_reader("joints", RECORD, [], {}) is None


def test_words_are_values_in_the_order_they_are_named() -> None:
    read_words = words_reader(RECORD, ("line", "mode"))
    assert read_words is not None
    assert read_words(frame(mode="auto")) == (None, "auto")
    assert words_reader(RECORD, ("line", "nothing")) is None


def test_raw_values_and_units_are_the_manuals() -> None:
    assert raw_values(frame(speed=1.0), ("speed", "mode")) == {"speed": 1.0, "mode": None}
    assert unit_of(RECORD, "speed") == "mm/s"
    assert unit_of(RECORD, "mode") is None
    with pytest.raises(ValueError, match="record told has no value 'nothing'"):
        unit_of(RECORD, "nothing")


@pytest.mark.parametrize(
    ("row", "says"),
    [
        (Signal("tcp.speed", "nothing"), "record told has no value 'nothing'"),
        (Signal("tcp.speed", ("speed", "nothing"), lambda *_: 0.0, partial=True), "no value 'nothing'"),
        (Signal("tcp.speed", "speed", lambda told, **_: told, options=("size",)), "the robot has no option 'size'"),
        (Signal("tcp.speed", ("speed", "ratio")), r"several values need a function \(via\)"),
        (Signal("tcp.sped", "speed"), "the model has no key 'tcp.sped'"),
        (Signal("tcp.speed", "override"), "converts to '1', not to 'm/s'"),
        (Signal("tcp.speed", "ratio"), "is in m/s, but its source has no unit"),
        (Signal("wrench.force", "forces"), "is in N, but its source has no unit"),
        (Signal("tcp.speed", "pose"), r"unit 'mm\|deg' is unknown"),
        (Signal("tcp.pose", "angles"), r"a pose needs a source in `mm\|deg`"),
        (Signal("tcp.pose", "forces"), r"a pose needs a source in `mm\|deg`"),
    ],
)
def test_a_row_that_cannot_be_read_is_refused_when_the_reader_is_made(row: Signal, says: str) -> None:
    with pytest.raises(ValueError, match=says):
        group_reader(row.group, RECORD, [row], {})


@pytest.mark.parametrize("unit", ["deg|mm", "mm|mm", "mm|deg|deg"])
def test_a_pose_in_other_units_is_refused(unit: str) -> None:
    record = Record(name="x", source="x", fields=(Value(name="p", type=list[float], unit=unit, meaning="x"),))
    with pytest.raises(ValueError, match=r"converts to|argument"):
        group_reader("tcp", record, [Signal("tcp.pose", "p")], {})


@pytest.mark.parametrize(
    "rows",
    [
        (Signal("tcp.speed", "speed"), Signal("tcp.speed", "speed")),
        (Signal("tcp.pose", "pose"), Signal("tcp.pose.position", "pose", lambda told: told[:3])),
        (Signal("tcp.pose.position", "pose", lambda told: told[:3]), Signal("tcp.pose", "pose")),
        (Signal("io.digital_in.box", "inputs"), Signal("io.digital_in.box", "inputs")),
    ],
)
def test_two_rows_for_one_key_are_refused(rows: tuple[Signal, ...]) -> None:
    with pytest.raises(ValueError, match="stands twice"):
        group_reader(rows[0].group, RECORD, rows, {})


def test_a_part_of_what_stands_in_a_mapping_is_refused() -> None:
    row = Signal("analog.analog_in.box.raw", "raw_in", lambda told: told)
    with pytest.raises(ValueError, match=r"box\.raw: box needs a function \(via\) that makes the whole of it"):
        group_reader("analog", RECORD, [row], {})


def test_a_doubt_about_the_words_of_a_layout_is_refused() -> None:
    layout = Layout(name="x", size=4, source="x", fields=(Field(name="a", offset=0, type="f32", unit="mm/s"),))
    with pytest.raises(ValueError, match="only a record's values are doubted"):
        group_reader("tcp", layout, [Signal("tcp.speed", "a", doubt=lambda _: True)], {})


@given(
    st.dictionaries(
        st.sampled_from(["angles", "speed", "pose", "moving", "line"]),
        st.none() | st.floats() | st.lists(st.none() | st.floats(), max_size=8),
    )
)
def test_whatever_numbers_come_no_value_is_told_that_is_not_finite(told: dict[str, object]) -> None:
    values = {name: value for name, value in told.items() if isinstance(value, list) == (name in {"angles", "pose"})}
    rows = (
        Signal("joints.position", "angles"),
        Signal("tcp.speed", "speed"),
        Signal("tcp.pose", "pose", rotation="rpy_fixed_xyz"),
    )
    for group, found in Normaliser(rows, {}).readers(RECORD).items():
        data, quality = found.read(frame(**values))
        assert "NaN" not in repr(data).replace("nan", "NaN")
        assert "inf" not in repr(data)
        assert quality in {"GOOD", "BAD"}, group


def test_a_normaliser_knows_the_sources_of_groups_and_keys() -> None:
    rows = (Signal("status.in_motion", ("moving", "line"), lambda *_: None), Signal("status.program.line", "line"))
    normaliser = Normaliser((*rows, Signal("wrench.active", "moving")), {})
    assert normaliser.group_sources("status") == ("moving", "line")
    assert normaliser.sources("status.program") == ("line",)
    assert normaliser.groups == ("wrench", "status", "vendor")
    assert set(normaliser.readers(RECORD)) == {"wrench", "status", "vendor"}
    assert normaliser.readers(RECORD) is normaliser.readers(RECORD)
    assert normaliser.readers(RECORD)["wrench"].empty == Wrench()


def test_a_value_is_brought_into_its_type_or_refused_in_words() -> None:
    assert RECORD.convert("tool", {"mass": 1}) == Tool(mass=1.0)
    assert RECORD.convert("tool", None) is None
    assert RECORD.convert("angles", [1, None]) == [1.0, None]
    with pytest.raises(ValueError, match="line: Expected `int`, got `str`"):
        RECORD.convert("line", "3")
    with pytest.raises(ValueError, match="count: Expected `int` >= 0"):
        RECORD.convert("count", -1)
    with pytest.raises(ValueError, match=r"keys: .*pressed.* - at `\$\[...\]`"):
        RECORD.convert("keys", {"a": {"tool": {}}})


def test_the_table_is_linted() -> None:
    assert RECORD.problems() == []
    wrong = Record(
        name="wrong",
        source="",
        fields=(
            Value(name="a", type=float, unit="furlong", meaning="x"),
            Value(name="b", type=float),
            Value(name="b", type=float, unit="mm|furlong", meaning="x"),
        ),
    )
    assert wrong.problems() == [
        "no source: name manual, version and section",
        "b: the name stands twice",
        "a: unit 'furlong' is unknown",
        "b: no meaning",
        "b: unit 'mm|furlong' is unknown",
    ]


def test_the_schema_of_the_vendor_group_is_valid_and_the_group_obeys_it() -> None:
    schema = vendor_schema(RECORD)
    jsonschema.Draft202012Validator.check_schema(schema)
    validator = jsonschema.Draft202012Validator(schema)
    data, _ = vendor_reader(RECORD).read(frame(**AS_TOLD))
    validator.validate(msgspec.to_builtins(data))
    validator.validate(msgspec.to_builtins(vendor_reader(RECORD).empty))
    properties = cast("dict[str, dict[str, object]]", schema["properties"])
    assert properties["speed"]["unit"] == "mm/s"
    assert "unit" not in properties["mode"]
    assert set(cast("dict[str, object]", properties["keys"]["$defs"])) == {"Key", "Maker", "Tool"}
    assert all(part["description"] for part in properties.values())


@pytest.mark.parametrize("wrong", [{"tool": {"maker": {"name": 1}}}, {"keys": {"a": {"pressed": 1}}}, {"line": "3"}])
def test_the_schema_refuses_what_is_of_another_type_also_inside_structs(wrong: dict[str, object]) -> None:
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.Draft202012Validator(vendor_schema(RECORD)).validate(wrong)


def test_a_topic_is_described_with_sources_units_and_what_is_never_told() -> None:
    rows = (
        Signal("tcp.speed", "speed", quality=Quality.SUBSTITUTED),
        Signal("tcp.pose", ("pose", "mode"), lambda *_: None),
    )
    found = describe("r1/tcp", "tcp", RECORD, rows)
    assert found.sources["speed"].units == ["mm/s"]
    assert found.sources["speed"].quality == "SUBSTITUTED"
    assert found.sources["pose"].units == ["mm|deg", None]
    assert "elbow" in found.never
    assert not {"speed", "pose", "pose.position"} & set(found.never)
    assert describe("r1/vendor", "vendor", RECORD, rows).schema == vendor_schema(RECORD)


@pytest.mark.parametrize(
    ("path", "known"),
    [
        ("speed", True),
        ("tool.mass", True),
        ("keys.any.pressed", True),
        ("keys.any.tool.maker.name", True),
        ("keys.any", True),
        ("faults", True),
        ("speed.x", False),
        ("tool.weight", False),
        ("keys.any.name", False),
        ("faults.code", False),
        ("nothing", False),
    ],
)
def test_fields_may_name_what_is_inside_structs_and_mappings(path: str, *, known: bool) -> None:
    assert has(vendor_shape([RECORD]), path.split(".")) is known


def test_enumerations_come_through_a_function() -> None:
    rows = (
        Signal("status.operating_mode", "mode", {"auto": OperatingMode.AUTOMATIC}.get),
        Signal("status.motion", "moving", lambda told: Motion.MOVING if told else Motion.STANDSTILL),
        Signal("safety.collision", "moving"),
    )
    readers = Normaliser(rows, {}).readers(RECORD)
    status = Status(operating_mode=OperatingMode.AUTOMATIC, motion=Motion.MOVING)
    assert readers["status"].read(frame(**AS_TOLD))[0] == status
    assert readers["safety"].read(frame(moving=False))[0] == Safety(collision=False)
