"""Paths that a subscription may name: what the model and the tables have, and nothing else."""

from __future__ import annotations

import pytest

from gateway.api.layout import Field, Flag, Layout
from gateway.api.model import Analog, Io, Joints, Quality, Sample, Status, Tcp
from gateway.core.bus import ValueReading
from gateway.server.cell import Cell
from gateway.server.fields import Shape, has, nearest, shape_of, vendor_shape
from tests.server.kit import BOOT, T, cell

FLAG = (Flag(name="fet", bit=0), Flag(name="run", bit=1))
LAYOUT = Layout(
    name="short",
    size=28,
    source="invented",
    fields=(
        Field(name="angle", offset=0, type="f32"),
        Field(name="word", offset=4, type="u32", flags=FLAG),
        Field(name="jnt_info", offset=8, type="u32", count=5, flags=FLAG),
    ),
)
LONGER = Layout(
    name="long",
    size=28,
    source="invented",
    fields=(Field(name="word", offset=4, type="u32", flags=(*FLAG, Flag(name="late", bit=2))),),
)
VENDOR = vendor_shape([LAYOUT, LONGER])


@pytest.mark.parametrize(
    ("shape", "path"),
    [
        (shape_of(Joints), "position"),
        (shape_of(Tcp), "pose"),
        (shape_of(Tcp), "pose.position"),
        (shape_of(Status), "program.run_time"),
        (shape_of(Status), "faults"),
        (shape_of(Io), "digital_in"),
        (shape_of(Io), "digital_in.box"),
        (shape_of(Analog), "analog_in.box.raw"),
        (VENDOR, "angle"),
        (VENDOR, "word"),
        (VENDOR, "word.raw"),
        (VENDOR, "word.fet"),
        (VENDOR, "word.late"),
        (VENDOR, "jnt_info"),
    ],
)
def test_a_path_of_the_model_or_of_a_table_is_known(shape: Shape, path: str) -> None:
    assert has(shape, path.split("."))


@pytest.mark.parametrize(
    ("shape", "path", "meant"),
    [
        (shape_of(Tcp), "pose.positon", "pose.position"),
        (shape_of(Joints), "position.9.x", "position"),
        (shape_of(Joints), "position.0", "position"),
        (shape_of(Joints), "", None),
        (shape_of(Tcp), "pose.", "pose"),
        (shape_of(Io), "digital_inn.box", "digital_in"),
        (shape_of(Io), "digital_in.", "digital_in"),
        (shape_of(Io), "digital_in.box.3", "digital_in"),
        (shape_of(Analog), "analog_in.box.rw", "analog_in"),
        (VENDOR, "word.fett", "word.fet"),
        (VENDOR, "word.fet.x", "word.fet"),
        (VENDOR, "angle.x", "angle"),
        (VENDOR, "jnt_info.fet", "jnt_info"),
        (VENDOR, "jnt_info.raw", "jnt_info"),
        (VENDOR, "*", None),
        (VENDOR, "zzz", None),
    ],
)
def test_any_other_path_is_unknown_and_the_nearest_one_is_named(shape: Shape, path: str, meant: str | None) -> None:
    assert not has(shape, path.split("."))
    assert nearest(path, [shape]) == meant


def test_a_field_that_the_tables_do_not_list_is_known_once_the_robot_has_told_it() -> None:
    bus, robots = cell("r1")
    topic = bus.topics["r1/vendor"]
    one = Cell(robots, bus)
    assert one.unknown_fields([topic], ["word.moving", "angle"]) is None
    assert one.unknown_fields([topic], ["register_1"]) == (
        "no matched topic has register_1; ask describe for the fields"
    )
    told = {"angle": [1.0, 2.0], "register_1": 5}
    bus.publish(topic, ValueReading(Sample(topic=topic.name, seq=1, epoch=BOOT, t=T, q=Quality.GOOD, data=told)))
    assert one.unknown_fields([topic], ["register_1"]) is None
    assert one.unknown_fields([topic], ["register_1.x"]) == (
        'no matched topic has register_1.x; did you mean "register_1"?'
    )


def test_a_path_that_one_matched_topic_has_is_known_and_events_have_none() -> None:
    bus, robots = cell("r1")
    one = Cell(robots, bus)
    assert one.unknown_fields(bus.match(["*"]), ["position", "program.state", "state", "word.moving"]) is None
    assert one.unknown_fields([bus.topics["r1/events"]], ["kind"]) is not None


def test_of_many_wrong_paths_a_few_are_named() -> None:
    bus, robots = cell("r1")
    said = Cell(robots, bus).unknown_fields(bus.match(["*/joints"]), [f"zzz{number}" for number in range(5000)])
    assert said is not None
    assert said.startswith("no matched topic has zzz0, zzz1, ")
    assert "and 4992 more" in said
