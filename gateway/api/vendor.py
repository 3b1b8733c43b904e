"""What a plugin exports: one `Vendor` record with a `Protocol` record for each wire protocol that it reads."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Literal

import msgspec

from gateway.api.decoder import Decoder
from gateway.api.framing import FramedDecoder, Framing, Polled
from gateway.api.layout import Layout
from gateway.api.signals import Signal

OnStale = Literal["close", "keep"]


class NoOptions(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The options of a protocol that has none."""


# What a whole robot may be configured with, whatever its vendor; rows name them like a protocol's own options.
ROBOT_OPTIONS = ("estop_polarity",)


@dataclass(frozen=True, slots=True, kw_only=True)
class Protocol:
    """One wire protocol of a vendor.

    Args:
        name: Short lower-case name; also the name of its options table in the configuration.
        title: One line for people.
        port: The vendor's port.
        framing: Where the parts of a frame stand.
        signals: Rows from fields to canonical keys.
        options: A frozen msgspec struct of the protocol's own options; every field has a default.
        request: Makes the bytes that ask for one frame from the options; None where the controller pushes.
        rate_hz: Default rate of the requests; None where the controller pushes.
        max_rate_hz: Highest rate that may be configured.
        stale_s: Default time without a good frame after which the link is stale.
        on_stale: `close`: the session is closed and opened again; `keep`: it stays, because closing may stop the robot.
        outgoing: Patterns (of the `re` module, matched whole) of every byte sequence that may ever be sent.
        cost: The stated limit of decode and normalise of one frame, as a multiple of `struct.unpack` of the same bytes.
    """

    name: str
    title: str
    port: int
    framing: Framing
    signals: tuple[Signal, ...]
    options: type[msgspec.Struct] = NoOptions
    request: Callable[[msgspec.Struct], bytes] | None = None
    rate_hz: float | None = None
    max_rate_hz: float | None = None
    stale_s: float = 1.0
    on_stale: OnStale = "close"
    outgoing: tuple[bytes, ...] = ()
    cost: float = 20.0

    @property
    def layouts(self) -> tuple[Layout, ...]:
        """Every table of the protocol."""
        return tuple(layout for kind in self.framing.kinds for layout in kind.layouts)

    def reader(self) -> FramedDecoder:
        """Make a decoder that only reads: for recordings, and for streams that are pushed."""
        return FramedDecoder(self.framing)

    def decoder(self, options: msgspec.Struct) -> Decoder:
        """Make the decoder of one live session."""
        return Polled(self.reader(), self.request(options)) if self.request else self.reader()


@dataclass(frozen=True, slots=True, kw_only=True)
class Vendor:
    """One plugin: everything that the gateway knows of a brand.

    Args:
        name: The name of the plugin's folder.
        title: The brand, for people.
        protocols: Its protocols; the first is the default.
        exempt: Conformance checks that are skipped, each with the reason.
    """

    name: str
    title: str
    protocols: tuple[Protocol, ...]
    exempt: Mapping[str, str] = field(default_factory=dict)

    def protocol(self, name: str | None = None) -> Protocol:
        """Find a protocol, or the default one.

        Raises:
            KeyError: There is none of that name.
        """
        return self.protocols[0] if name is None else {protocol.name: protocol for protocol in self.protocols}[name]
