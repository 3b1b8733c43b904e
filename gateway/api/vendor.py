"""What a plugin exports: one `Vendor` record with a `Protocol` record for each wire protocol that it reads."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Literal

import msgspec

from gateway.api.decoder import Decoder
from gateway.api.framing import FramedDecoder, Framing
from gateway.api.layout import Layout
from gateway.api.polling import Polled
from gateway.api.signals import Signal

OnStale = Literal["close", "keep"]
Transport = Literal["tcp", "udp"]
DecoderFactory = Callable[[], Decoder]


class NoOptions(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The options of a protocol that has none."""


# What a whole robot may be configured with, whatever its vendor; rows name them like a protocol's own options.
ROBOT_OPTIONS = ("estop_polarity",)


@dataclass(frozen=True, slots=True, kw_only=True)
class WallClock:
    """The controller's own wall clock, where its frames carry one.

    Args:
        fields: The sources, scalars or arrays, in the order that `read` takes their elements.
        read: Makes (year, month, day, hour, minute, second, microsecond) of the raw values.
    """

    fields: tuple[str, ...]
    read: Callable[..., tuple[int, int, int, int, int, int, int]]


@dataclass(frozen=True, slots=True, kw_only=True)
class Protocol:
    """One wire protocol of a vendor.

    Args:
        name: Short lower-case name; also the name of its options table in the configuration.
        title: One line for people.
        port: The vendor's port.
        udp_port: The vendor's port over UDP, where the protocol's option `transport` may be "udp"; None: TCP only.
        framing: Where the parts of a frame stand.
        signals: Rows from fields to canonical keys.
        options: A frozen msgspec struct of the protocol's own options; every field has a default.
        request: Makes the bytes that ask for one frame from the options; None where the controller pushes.
        make_decoders: Makes, from a robot's options, what makes the decoder of each of its sessions: for a protocol
            with a handshake of its own. What one session learns for the next ones stays between the two.
        tick_s: Time between ticks of such a decoder, in s: its retries.
        handshake_s: Time that a session may take to its first good frame, in s; None: `stale_s`.
        rate_hz: Default rate of the requests; None where the controller pushes.
        max_rate_hz: Highest rate that may be configured.
        stale_s: Default time without a good frame after which the link is stale.
        on_stale: `close`: the session is closed and opened again; `keep`: it stays, because closing may stop the robot.
        outgoing: Patterns (of the `re` module, matched whole) of every byte sequence that may ever be sent.
        cost: The stated limit of decode and normalise of one frame, as a multiple of `struct.unpack` of the same bytes.
        wall_clock: The controller's own clock in its frames, or None.
        when_refused: What it probably means that the port is closed, and what to do, for the operator.
        probe: Makes the decoder that asks whether a controller speaks this; None: as in a session with the defaults.
        hazard: Why even connecting and closing again may do harm: probing leaves it out unless it is allowed.
    """

    name: str
    title: str
    port: int
    udp_port: int | None = None
    framing: Framing
    signals: tuple[Signal, ...]
    options: type[msgspec.Struct] = NoOptions
    request: Callable[[msgspec.Struct], bytes] | None = None
    make_decoders: Callable[[msgspec.Struct], DecoderFactory] | None = None
    tick_s: float | None = None
    handshake_s: float | None = None
    rate_hz: float | None = None
    max_rate_hz: float | None = None
    stale_s: float = 1.0
    on_stale: OnStale = "close"
    outgoing: tuple[bytes, ...] = ()
    cost: float = 20.0
    wall_clock: WallClock | None = None
    when_refused: str = ""
    probe: DecoderFactory | None = None
    hazard: str = ""

    @property
    def layouts(self) -> tuple[Layout, ...]:
        """Every table of the protocol."""
        return tuple(layout for kind in self.framing.kinds for layout in kind.layouts)

    @property
    def longest(self) -> Layout:
        """The table that the others are prefixes of, or the largest."""
        return max(self.layouts, key=lambda layout: layout.size)

    def reader(self) -> FramedDecoder:
        """Make a decoder that only reads: for recordings, and for streams that are pushed."""
        return FramedDecoder(self.framing)

    def transport(self, options: msgspec.Struct) -> Transport:
        """What a robot with these options is reached over."""
        return "udp" if self.udp_port is not None and getattr(options, "transport", "tcp") == "udp" else "tcp"

    def port_of(self, options: msgspec.Struct) -> int:
        """The vendor's port for a robot with these options."""
        return self.udp_port if self.udp_port is not None and self.transport(options) == "udp" else self.port

    def decoders(self, options: msgspec.Struct) -> DecoderFactory:
        """Make what makes the decoders of one robot, session after session."""
        return self.make_decoders(options) if self.make_decoders else partial(self.decoder, options)

    def decoder(self, options: msgspec.Struct) -> Decoder:
        """Make the decoder of one live session."""
        if self.make_decoders:
            return self.make_decoders(options)()
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
