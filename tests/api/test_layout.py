"""Tables: decode, encode, prefixes and the lint."""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.api.compiler import compile_vendor
from gateway.api.decoder import Frame
from gateway.api.layout import Field, Flag, Layout, is_finite

WORD = Field(
    name="word",
    offset=12,
    type="u32",
    meaning="Bits",
    flags=(Flag(name="low", bit=0, width=3), Flag(name="high", bit=31), Flag(name="middle", bit=4, width=12)),
)
TABLE = Layout(
    name="whole",
    size=28,
    source="An invented manual",
    fields=(
        Field(name="kind", offset=0, type="u8", meaning="Kind"),
        Field(name="angles", offset=4, type="f32", count=2, unit="deg", meaning="Angles"),
        WORD,
        Field(name="counts", offset=16, type="i16", count=3, meaning="Counters"),
        Field(name="last", offset=24, type="i32", meaning="Last"),
    ),
)


def read(layout: Layout, payload: bytes) -> Mapping[str, object]:
    found, _ = compile_vendor(layout).read(Frame(payload, layout))
    assert isinstance(found, dict)
    return found


def test_a_payload_is_read_at_the_offsets_of_the_table() -> None:
    payload = struct.pack("<Bxxx2fI3hxxi", 7, 1.5, -2.25, 0x8000_0FF5, -1, 2, -3, -9)
    assert read(TABLE, payload) == {
        "kind": 7,
        "angles": [1.5, -2.25],
        "word": {"raw": 0x8000_0FF5, "low": 5, "high": 1, "middle": 0xFF},
        "counts": [-1, 2, -3],
        "last": -9,
    }


def test_a_table_in_any_order_reads_the_same() -> None:
    turned = Layout(name="turned", size=28, source="x", fields=tuple(reversed(TABLE.fields)))
    payload = bytes(range(28))
    assert read(turned, payload) == read(TABLE, payload)


def test_big_endian_words_are_read_as_such() -> None:
    layout = Layout(
        name="big",
        size=6,
        source="x",
        byteorder=">",
        fields=(Field(name="a", offset=0, type="u16"), Field(name="b", offset=2, type="f32")),
    )
    assert read(layout, struct.pack(">Hf", 258, 0.5)) == {"a": 258, "b": 0.5}
    assert layout.encode({"a": 258, "b": 0.5}) == struct.pack(">Hf", 258, 0.5)
    assert layout.read_many(struct.pack(">HfHf", 1, 2.0, 3, 4.0))["a"].tolist() == [1, 3]


def test_a_prefix_gives_null_for_what_is_cut_off_also_inside_an_array() -> None:
    short = TABLE.prefix(21, name="short")
    found = read(short, TABLE.encode({"counts": [4, 5, 6], "last": 7})[:21])
    assert found["counts"] == [4, 5, None]
    assert found["last"] is None
    assert short.dtype.itemsize == 21


def test_a_prefix_can_leave_out_a_field_of_another_meaning() -> None:
    short = TABLE.prefix(24, name="short", absent=("angles",))
    assert read(short, bytes(24))["angles"] == [None, None]


def test_a_cut_off_field_encodes_to_nothing_and_reads_back_as_null() -> None:
    short = TABLE.prefix(12, name="short")
    payload = short.encode({"angles": [1.0, 2.0], "counts": [1, 2, 3], "last": 4, "word": 5})
    assert len(payload) == 12
    assert read(short, payload)["last"] is None


@pytest.mark.parametrize("size", [0, -4, 28, 29])
def test_a_prefix_must_be_shorter(size: int) -> None:
    with pytest.raises(ValueError, match="a prefix has 1 to 27 bytes"):
        TABLE.prefix(size, name="x")


def test_a_prefix_of_an_unknown_field_is_refused() -> None:
    with pytest.raises(ValueError, match="no field nothing"):
        TABLE.prefix(4, name="x", absent=("nothing",))


def test_what_is_not_named_is_encoded_as_zero() -> None:
    assert TABLE.encode({"kind": 1}) == b"\x01" + bytes(27)


def test_flags_win_over_the_raw_word() -> None:
    payload = TABLE.encode({"word": {"raw": 0xFFFF_FFFF, "middle": 0, "high": 0}})
    assert read(TABLE, payload)["word"] == {"raw": 0x7FFF_000F, "low": 7, "high": 0, "middle": 0}


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"nothing": 1}, "no field nothing"),
        ({"angles": [1.0]}, "angles takes 2 values"),
        ({"angles": 1.0}, "angles takes 2 values"),
        ({"kind": 256}, "kind = 256"),
        ({"kind": "x"}, "'x' is no number"),
        ({"word": {"nothing": 1}}, "no flag 'nothing'"),
        ({"word": {"low": 8}}, "takes 0 to 7, not 8"),
        ({"last": 1.5}, "last = 1.5"),
    ],
)
def test_what_cannot_be_encoded_is_refused_with_its_name(values: Mapping[str, object], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        TABLE.encode(values)


def test_none_is_encoded_as_zero() -> None:
    assert TABLE.encode({"angles": [None, 1.0], "last": None})[4:8] == bytes(4)


def test_payloads_end_to_end_are_read_in_bulk() -> None:
    payloads = b"".join(TABLE.encode({"last": number, "counts": [number, 0, -number]}) for number in range(5))
    records = TABLE.read_many(payloads)
    assert records["last"].tolist() == [0, 1, 2, 3, 4]
    assert records["counts"][:, 2].tolist() == [0, -1, -2, -3, -4]
    with pytest.raises(ValueError, match="buffer size"):
        TABLE.read_many(payloads[:-1])


def test_an_unknown_type_is_refused_at_once() -> None:
    with pytest.raises(ValueError, match="type 'f16' is unknown; known are u8"):
        Field(name="a", offset=0, type="f16")


def field(name: str = "a", offset: int = 0, kind: str = "u32", **more: object) -> Field:
    return Field(name=name, offset=offset, type=kind, **more)  # type: ignore[arg-type] # names of its fields


@pytest.mark.parametrize(
    ("fields", "problem"),
    [
        ((field(), field(offset=4)), "a: the name stands twice"),
        ((field(), field("b", 3)), "b: at 3 it overlaps a, which ends at 4"),
        ((field("b", 4), field("a", 0)), "a: at 0 it overlaps b, which ends at 8"),
        ((field(offset=6),), "a: it ends behind the 8 bytes of the layout"),
        ((field(unit="furlong"),), "a: unit 'furlong' is unknown"),
        ((field(kind="u8", count=3, unit="mm|deg"),), "a: a pose has six elements"),
        ((field(flags=(Flag(name="x", bit=31, width=2),)),), "a.x: it does not fit u32"),
        ((field(flags=(Flag(name="x", bit=0, width=2), Flag(name="y", bit=1))),), "a.y: it overlaps another flag"),
        ((field(flags=(Flag(name="raw", bit=0),)),), "a: flag names must be unique, and none may be `raw`"),
        ((field(kind="f32", flags=(Flag(name="x", bit=0),)),), "a: a float has no flags"),
    ],
)
def test_the_lint_names_what_is_wrong(fields: tuple[Field, ...], problem: str) -> None:
    assert problem in Layout(name="x", size=8, fields=fields, source="x").problems()


def test_the_lint_finds_a_missing_source_and_nothing_in_a_good_table() -> None:
    assert TABLE.problems() == []
    assert Layout(name="x", size=28, fields=TABLE.fields, source="").problems() == [
        "no source: name manual, version and section",
    ]


def test_finite_means_neither_null_nor_nan_nor_infinite() -> None:
    assert [is_finite(value) for value in (0, 1.5, None, math.nan, -math.inf)] == [True, True, False, False, False]


FLOATS = st.floats(width=32, allow_nan=False, allow_infinity=False)
VALUES = st.fixed_dictionaries(
    {
        "kind": st.integers(0, 255),
        "angles": st.lists(FLOATS, min_size=2, max_size=2),
        "word": st.fixed_dictionaries(
            {"low": st.integers(0, 7), "high": st.integers(0, 1), "middle": st.integers(0, 4095)},
        ),
        "counts": st.lists(st.integers(-(2**15), 2**15 - 1), min_size=3, max_size=3),
        "last": st.integers(-(2**31), 2**31 - 1),
    },
)


@given(VALUES)
def test_whatever_is_encoded_decodes_to_the_same(values: dict[str, object]) -> None:
    found = dict(read(TABLE, TABLE.encode(values)))
    word = found.pop("word")
    assert isinstance(word, dict)
    assert {name: value for name, value in word.items() if name != "raw"} == values["word"]
    assert found == {name: value for name, value in values.items() if name != "word"}


@given(st.binary(min_size=28, max_size=28), st.integers(1, 27))
def test_a_prefix_tells_what_the_whole_tells_as_far_as_it_goes(payload: bytes, size: int) -> None:
    short = read(TABLE.prefix(size, name="short"), payload[:size])
    for name, value in read(TABLE, payload).items():
        shown = short[name]
        pairs = (
            zip(value, shown, strict=True) if isinstance(value, list) and isinstance(shown, list) else [(value, shown)]
        )
        assert all(there is None or there == whole for whole, there in pairs)


@given(st.binary(min_size=28, max_size=28))
def test_bulk_and_single_reading_agree(payload: bytes) -> None:
    single = read(TABLE, payload)
    record = TABLE.read_many(payload)[0]
    assert record["counts"].tolist() == single["counts"]
    assert record["last"].item() == single["last"]
    for shown, bulk in zip(single["angles"], record["angles"].tolist(), strict=True):  # type: ignore[call-overload] # a list
        assert shown == bulk if math.isfinite(bulk) else shown is None


def test_a_layout_whose_firmware_is_known_says_so_and_a_further_prefix_does_not() -> None:
    whole = Layout(name="8", size=8, fields=(Field(name="a", offset=0, type="u32"),), source="none", firmware="2.0")
    assert whole.title == "8 (firmware 2.0)"
    assert whole.prefix(4, name="4", firmware="1.0 to 1.3").title == "4 (firmware 1.0 to 1.3)"
    assert whole.prefix(6, name="6 bytes, the first of 8").title == "6 bytes, the first of 8"
