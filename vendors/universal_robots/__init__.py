"""Universal Robots: the read-only real-time interface, port 30013. Port 30003 executes URScript: it is never opened."""

from __future__ import annotations

from gateway.api.framing import Framing, Kind
from gateway.api.vendor import Protocol, Vendor
from vendors.universal_robots.layouts import LAYOUTS
from vendors.universal_robots.signals import SIGNALS

FRAMING = Framing(
    magic=b"\0\0",  # the upper half of the size: no frame has 65536 bytes
    header=4,
    length_at=0,
    length_type="u32",
    kinds=(Kind(type=None, name="state", layouts=LAYOUTS, smallest=1044, largest=1220, step=4),),
    byteorder="big",
    one_length=True,
)

VENDOR = Vendor(
    name="universal_robots",
    title="Universal Robots CB3 and e-Series",
    protocols=(
        Protocol(
            name="realtime",
            title="Real-time interface, read-only, pushed on port 30013",
            port=30013,
            framing=FRAMING,
            signals=SIGNALS,
            when_refused="The interface may be switched off in PolyScope, in the security settings under services",
        ),
    ),
)
