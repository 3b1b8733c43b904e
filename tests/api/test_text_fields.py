"""Fields of text and bytes, and frames whose size no table states."""

from __future__ import annotations

import struct

import pytest

from gateway.api.compiler import compile_group, compile_vendor
from gateway.api.decoder import Frame, Reject
from gateway.api.describe import vendor_schema
from gateway.api.framing import Checksum, FramedDecoder, Framing, Kind
from gateway.api.layout import Field, Layout
from gateway.api.model import Quality, Status
from gateway.api.readers import raw_values
from gateway.api.signals import Signal
from gateway.sim.packing import Packer

TABLE = Layout(
    name="table",
    size=24,
    source="made up",
    fields=(
        Field(name="number", offset=0, type="f64", meaning="a float"),
        Field(name="name", offset=8, type="text", size=8, meaning="a text"),
        Field(name="word", offset=16, type="u16", meaning="a word"),
        Field(name="raw", offset=18, type="bytes", size=6, meaning="bytes"),
    ),
)
PAYLOAD = struct.pack("<d8sH6s", 1.5, b"pick\0\0\0x", 7, b"\x00\x01\xfe\xff\x00\x00")


def vendor_values(layout: Layout, payload: bytes) -> object:
    return compile_vendor(layout).read(Frame(payload, layout))[0]


def test_text_ends_at_its_first_nul_and_bytes_are_shown_whole() -> None:
    assert vendor_values(TABLE, PAYLOAD) == {"number": 1.5, "name": "pick", "word": 7, "raw": "0001feff0000"}


def test_text_that_is_no_utf_8_is_replaced_not_lost() -> None:
    payload = PAYLOAD[:8] + b"a\xffb\xc3\xa9\0\0\0" + PAYLOAD[16:]
    values = vendor_values(TABLE, payload)
    assert isinstance(values, dict)
    assert values["name"] == "a\N{REPLACEMENT CHARACTER}bé"


def test_a_text_that_fills_its_field_needs_no_nul() -> None:
    payload = PAYLOAD[:8] + b"12345678" + PAYLOAD[16:]
    values = vendor_values(TABLE, payload)
    assert isinstance(values, dict)
    assert values["name"] == "12345678"


def test_a_frame_with_nan_still_tells_its_texts() -> None:
    payload = struct.pack("<d", float("nan")) + PAYLOAD[8:]
    data, quality = compile_vendor(TABLE).read(Frame(payload, TABLE))
    assert quality is Quality.BAD
    assert data == {"number": None, "name": "pick", "word": 7, "raw": "0001feff0000"}


def test_values_encode_to_padded_bytes_and_back() -> None:
    values = {"number": 1.5, "name": "né", "word": 7, "raw": "0102"}
    payload = TABLE.encode(values)
    assert payload[8:16] == "né".encode().ljust(8, b"\0")
    assert payload[18:] == b"\x01\x02\0\0\0\0"
    assert vendor_values(TABLE, payload) == {**values, "raw": "010200000000"}
    assert TABLE.encode({"name": None, "raw": None}) == bytes(24)


@pytest.mark.parametrize(
    ("values", "why"),
    [
        ({"name": "123456789"}, "8 bytes"),
        ({"raw": "00" * 7}, "6 bytes"),
        ({"raw": "xy"}, "hex"),
        ({"name": 5}, "no string"),
    ],
)
def test_what_does_not_fit_is_refused(values: dict[str, object], why: str) -> None:
    with pytest.raises(ValueError, match=why):
        TABLE.encode(values)


def test_a_text_that_is_cut_off_is_null() -> None:
    shorter = TABLE.prefix(12, name="12")
    assert vendor_values(shorter, PAYLOAD[:12]) == {"number": 1.5, "name": None, "word": None, "raw": None}
    assert shorter.dtype.names == ("number",)


def test_recordings_hold_the_same_bytes() -> None:
    record = TABLE.read_many(PAYLOAD * 2)[1]
    assert TABLE.by_name["name"].shown(record["name"].tolist()) == "pick"
    assert TABLE.by_name["raw"].shown(record["raw"].tolist()) == "0001feff0000"


def test_a_row_takes_the_text_and_the_key_follows_its_bytes() -> None:
    reader = compile_group("status", TABLE, [Signal("status.program.name", "name", str.upper)], {})
    assert reader is not None
    status, _ = reader.read(Frame(PAYLOAD, TABLE))
    assert isinstance(status, Status)
    assert status.program is not None
    assert status.program.name == "PICK"
    assert reader.key(Frame(PAYLOAD, TABLE)) != reader.key(Frame(PAYLOAD.replace(b"pick", b"pack"), TABLE))
    assert raw_values(Frame(PAYLOAD, TABLE), ["name", "word"]) == {"name": "pick", "word": 7}


def test_the_schema_says_string() -> None:
    properties = vendor_schema(TABLE)["properties"]
    assert isinstance(properties, dict)
    assert properties["name"]["type"] == properties["raw"]["type"] == ["string", "null"]


def test_the_simulators_packer_takes_them_too() -> None:
    packer = Packer(TABLE)
    words = packer.words({"number": 1.5, "name": "pick", "word": 7, "raw": "0001feff"})
    assert packer.pack(words)[:12] == PAYLOAD[:12]
    assert packer.named(words) == {"number": 1.5, "name": "pick", "word": 7, "raw": "0001feff0000"}


@pytest.mark.parametrize(
    "wrong", [{"type": "text"}, {"type": "u8", "size": 3}, {"type": "bytes", "size": 3, "count": 2}]
)
def test_size_belongs_to_text_and_bytes_alone(wrong: dict[str, object]) -> None:
    with pytest.raises(ValueError, match="`size` belongs to text and bytes"):
        Field(name="a", offset=0, **wrong)  # type: ignore[arg-type] # on purpose


LONG = Layout(
    name="20",
    size=18,
    source="made up",
    fields=(
        Field(name="head", offset=0, type="u16", meaning="magic"),
        Field(name="length", offset=2, type="u16", meaning="total size"),
        Field(name="values", offset=4, type="u16", count=7, meaning="words"),
    ),
)
SHORT = LONG.prefix(8, name="10")


def sum16(data: bytes) -> int:
    return sum(data) & 0xFFFF


FRAMING = Framing(
    magic=b"\xaa\xbb",
    header=4,
    length_at=2,
    kinds=(Kind(type=None, name="state", layouts=(SHORT, LONG), smallest=8, largest=40),),
    checksum=Checksum(type="u16", of=sum16),
    any_size=True,
)


def frame(total: int) -> bytes:
    data = (b"\xaa\xbb" + total.to_bytes(2, "little")).ljust(total - 2, b"\x01")
    return data + sum16(data).to_bytes(2, "little")


def only_frame(raw: bytes) -> Frame:
    (event,) = FramedDecoder(FRAMING).feed(raw)
    assert isinstance(event, Frame)
    return event


@pytest.mark.parametrize(
    ("total", "name", "quality", "present"),
    [
        (10, "10", Quality.GOOD, 2),
        (20, "20", Quality.GOOD, 7),
        (8, "8 bytes, the first of 10", Quality.UNCERTAIN, 1),
        (15, "15 bytes, the first of 20", Quality.UNCERTAIN, 4),
        (33, "20", Quality.UNCERTAIN, 7),
    ],
)
def test_a_size_that_no_table_states_is_read_as_far_as_one_goes(
    total: int, name: str, quality: Quality, present: int
) -> None:
    found = only_frame(frame(total))
    assert (found.layout.name, found.quality) == (name, quality)
    assert isinstance(found.layout, Layout)
    assert found.layout.by_name["values"].present == present


def test_frames_of_one_unknown_size_share_one_layout_in_every_session() -> None:
    assert only_frame(frame(15)).layout is only_frame(frame(15)).layout


@pytest.mark.parametrize("total", [7, 41])
def test_a_size_outside_the_limits_is_rejected(total: int) -> None:
    (event,) = FramedDecoder(FRAMING).feed(frame(total))
    assert isinstance(event, Reject)
    assert event.reason == "size"


def test_any_size_needs_a_checksum() -> None:
    with pytest.raises(ValueError, match="checksum"):
        Framing(magic=b"a", header=4, length_at=2, kinds=FRAMING.kinds, any_size=True)


def test_the_bytes_behind_the_payload_are_checksum_and_tail() -> None:
    assert FRAMING.behind == 2
    assert Framing(magic=b"a", header=4, length_at=2, kinds=FRAMING.kinds, tail=b"abc").behind == 3
