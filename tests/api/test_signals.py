"""Signal rows: what the model says of a key, and where a source is found."""

from __future__ import annotations

import pytest

from gateway.api.layout import Field, Flag, Layout
from gateway.api.model import FRAME_GROUPS, GROUPS, Status
from gateway.api.signals import Leaf, Signal, find_source, keys_of, leaf


@pytest.mark.parametrize(
    ("key", "found"),
    [
        ("joints.position", Leaf("array", "rad")),
        ("tcp.pose", Leaf("pose", None)),
        ("tcp.pose.position", Leaf("array", "m")),
        ("tcp.speed", Leaf("float", "m/s")),
        ("io.digital_in.box", Leaf("bits", None)),
        ("analog.analog_in.ext1", Leaf("channels", None)),
        ("status.speed_override", Leaf("float", "1")),
        ("status.program.line", Leaf("int", None)),
        ("status.in_motion", Leaf("bool", None)),
        ("status.motion", Leaf("other", None)),
        ("status.faults", Leaf("other", None)),
        ("controller.supplies.48v_in", Leaf("bool", None)),
        ("status.payload.cog", Leaf("array", "m")),
    ],
)
def test_the_model_says_shape_and_unit_of_a_key(key: str, found: Leaf) -> None:
    assert leaf(key) == found


@pytest.mark.parametrize(
    ("key", "words"),
    [
        ("joint.position", "its groups are joints"),
        ("joints", "no key 'joints'"),
        ("vendor.jnt_ang", "no key"),
        ("joints.positions", "here it has position, velocity"),
        ("joints.position.x", "it ends before 'x'"),
        ("status.program.lines", "here it has state, name, line"),
    ],
)
def test_a_key_that_the_model_does_not_have_is_refused(key: str, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        leaf(key)


def test_every_key_of_every_frame_group_is_a_leaf_or_a_subtree() -> None:
    for group in FRAME_GROUPS:
        struct = GROUPS[group].struct
        assert struct is not None
        for path in keys_of(struct):
            assert leaf(f"{group}.{path}")
    assert "program.run_time" in keys_of(Status)


def test_a_row_knows_its_group_path_and_sources() -> None:
    row = Signal("io.digital_in.box", ("a", "b.c"))
    assert (row.group, row.path, row.sources) == ("io", ("digital_in", "box"), ("a", "b.c"))
    assert Signal("tcp.pose", "a").sources == ("a",)


def test_a_source_is_a_field_or_a_flag_of_one() -> None:
    flag = Flag(name="bit", bit=3)
    field = Field(name="word", offset=0, type="u8", flags=(flag,))
    layout = Layout(name="x", size=1, fields=(field,), source="x")
    assert find_source(layout, "word") == (field, None)
    assert find_source(layout, "word.bit") == (field, flag)
    with pytest.raises(ValueError, match=r"layout x has no field or flag 'word.bat'"):
        find_source(layout, "word.bat")
