"""Rainbow Robotics RB series: state data by `reqdata` on port 5001. Port 5000 takes commands: it is never opened."""

from __future__ import annotations

from typing import Annotated, Literal, cast

import msgspec
from msgspec import Meta

from gateway.api.framing import Framing, Kind
from gateway.api.vendor import Protocol, Vendor
from vendors.rainbow.layouts import LAYOUTS
from vendors.rainbow.signals import SIGNALS


class ReqdataOptions(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Options of the `reqdata` protocol."""

    terminator: Annotated[
        Literal["", "\n"],
        Meta(description="Sent behind the seven bytes of the request: nothing, or a newline like the vendor's SDK."),
    ] = ""
    external_joints: Annotated[
        int,
        Meta(ge=0, le=6, description="How many external joints are connected; the frame does not say."),
    ] = 0


def request(options: msgspec.Struct) -> bytes:
    """The bytes that ask for one state frame."""
    return b"reqdata" + cast("ReqdataOptions", options).terminator.encode()


FRAMING = Framing(
    magic=b"$",
    header=4,
    length_at=1,
    length_adds=4,  # the length field does not count the header
    type_at=3,
    kinds=(
        Kind(type=3, name="state", layouts=LAYOUTS, smallest=464, largest=4100, step=4),
        Kind(type=4, name="configuration", smallest=96, largest=4100),
        Kind(type=10, name="pop-up", smallest=96, largest=4100),
    ),
    one_length=True,
)

VENDOR = Vendor(
    name="rainbow",
    title="Rainbow Robotics RB",
    protocols=(
        Protocol(
            name="reqdata",
            title="State data by polling, port 5001",
            port=5001,
            framing=FRAMING,
            signals=SIGNALS,
            options=ReqdataOptions,
            request=request,
            rate_hz=50.0,
            max_rate_hz=500.0,
            outgoing=(rb"reqdata\n?",),
            cost=20.0,
        ),
    ),
)
