"""An invented vendor that cannot make what makes its decoders."""

from __future__ import annotations

import msgspec

from gateway.api.decoder import Decoder
from gateway.api.framing import FramedDecoder, Framing, Kind
from gateway.api.layout import Field, Layout
from gateway.api.signals import Signal
from gateway.api.vendor import DecoderFactory, Protocol, Vendor

LAYOUT = Layout(
    name="maker",
    size=16,
    source="invented",
    fields=(
        Field(name="header", offset=0, type="u8", count=4),
        Field(name="angle", offset=4, type="f32", count=3, unit="deg"),
    ),
)
FRAMING = Framing(
    magic=b"$",
    header=4,
    length_at=1,
    length_adds=4,
    type_at=3,
    kinds=(Kind(type=3, name="state", layouts=(LAYOUT,), smallest=16, largest=64, step=4),),
)


def decoders(options: msgspec.Struct, rate_hz: float) -> DecoderFactory:
    """Fail, where the daemon asks; the kit's own checks are given a decoder."""
    raise RuntimeError(f"maker: no decoders of {options} at {rate_hz}")


def reader() -> Decoder:
    """A decoder for recordings."""
    return FramedDecoder(FRAMING)


VENDOR = Vendor(
    name="maker",
    title="Maker",
    protocols=(
        Protocol(
            name="pushed",
            title="fails before its first session",
            port=4000,
            framing=FRAMING,
            signals=(Signal("joints.position", "angle"),),
            make_reader=reader,
            make_decoders=decoders,
        ),
    ),
)
