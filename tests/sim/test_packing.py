"""Packing all words at once gives what the table encodes."""

from __future__ import annotations

from gateway.api.layout import Field, Flag, Layout
from gateway.sim.packing import Packer

LAYOUT = Layout(
    name="t",
    size=16,
    source="made up",
    fields=(
        Field(name="a", offset=1, type="u8"),
        Field(name="b", offset=4, type="f32", count=2),
        Field(name="c", offset=12, type="u16", flags=(Flag(name="low", bit=0), Flag(name="high", bit=15))),
    ),
)


def test_a_frame_is_what_the_table_encodes() -> None:
    values = {"a": 7, "b": [1.5, -2.0], "c": {"low": 1, "high": 1}}
    packer = Packer(LAYOUT)
    assert packer.pack(packer.words(values)) == LAYOUT.encode(values)


def test_words_are_named_as_in_the_table() -> None:
    assert Packer(LAYOUT).named([7, 1.5, -2.0, 0x8001]) == {"a": 7, "b": [1.5, -2.0], "c": 0x8001}


def test_a_prefix_takes_the_words_of_the_whole() -> None:
    short = Packer(LAYOUT.prefix(8, name="s"))
    assert short.pack([7, 1.5, -2.0, 0x8001]) == LAYOUT.encode({"a": 7, "b": [1.5, -2.0]})[:8]
    assert short.named([7, 1.5, -2.0, 0x8001]) == {"a": 7, "b": [1.5]}
