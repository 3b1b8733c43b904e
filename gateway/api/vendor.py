"""What a plugin exports: one `Vendor` record with a `Protocol` record for each wire protocol that it reads."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from datetime import tzinfo
from functools import partial
from typing import Literal, cast

import msgspec

from gateway.api.decoder import Decoder, Table
from gateway.api.documents import DocumentType
from gateway.api.framing import FramedDecoder, Framing
from gateway.api.layout import Layout
from gateway.api.polling import Polled
from gateway.api.record import Record
from gateway.api.signals import Signal

OnStale = Literal["close", "keep"]
Transport = Literal["tcp", "udp", "tcp_server"]
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
        zone: Its time zone where the protocol states one; None: each robot's configuration may.
    """

    fields: tuple[str, ...]
    read: Callable[..., tuple[int, int, int, int, int, int, int]]
    zone: tzinfo | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Protocol:
    """One wire protocol of a vendor.

    Args:
        name: Short lower-case name; also the name of its options table in the configuration.
        title: One line for people.
        port: The vendor's port; None: it has none, each robot's configuration must give it.
        udp_port: The vendor's port over UDP, where the protocol's option `transport` may be "udp"; None: TCP only.
        framing: Where the parts of a binary frame stand; None for a text protocol.
        records: The tables of a text protocol.
        signals: Rows from fields to canonical keys.
        options: A frozen msgspec struct of the protocol's own options; every field has a default.
        request: Makes the bytes that ask for one frame from the options; None where the controller pushes.
        make_reader: Makes a decoder that only reads, for recordings; None: the framing's.
        make_observer: Makes the same for the sessions of a robot with given options, where what they were agreed on or
            what was asked matters: it may be an `AskedDecoder`. None: as `make_reader`.
        make_decoders: Makes, from a robot's options and the rate it is asked at (0: it is not), what makes the decoder
            of each of its sessions: for a protocol with a discipline of its own. What one session learns for the next
            ones stays between the two.
        tick_s: Time between ticks of such a decoder, in s: its retries.
        handshake_s: Time that a session may take to its first good frame, in s; None: `stale_s`.
        rate_hz: Default rate of the requests; None where the controller pushes.
        max_rate_hz: Highest rate that may be configured.
        quiet: Share of the period without a question after an answer that took longer than it, where answers do not say
            what they answer: one too many that comes meanwhile is noticed. 0: the next question leaves at once.
        stale_s: Default time without a good frame after which the link is stale.
        on_stale: `close`: the session is closed and opened again; `keep`: it stays, because closing may stop the robot.
        outgoing: Patterns (of the `re` module, matched whole) of every byte sequence that may ever be sent.
        cost: The stated limit of decode and normalise of one frame, as a multiple of `struct.unpack` of the same bytes.
        wall_clock: The controller's own clock in its frames, or None.
        when_refused: What it probably means that the port is closed, and what to do, for the operator.
        probe: Makes the decoder that asks whether a controller speaks this; None: as in a session with the defaults.
        commands: Whether it tells of command objects, so that the robot has a topic `commands`.
        slowest_s: Gives, from the options and the configured rate, the longest time between two answers that tell the
            same value, in s; None: every answer tells everything.
        hazard: Why even connecting and closing again may do harm: probing leaves it out unless it is allowed.
    """

    name: str
    title: str
    port: int | None
    udp_port: int | None = None
    framing: Framing | None = None
    records: tuple[Record, ...] = ()
    signals: tuple[Signal, ...]
    options: type[msgspec.Struct] = NoOptions
    request: Callable[[msgspec.Struct], bytes] | None = None
    make_reader: DecoderFactory | None = None
    make_observer: Callable[[msgspec.Struct], Decoder] | None = None
    make_decoders: Callable[[msgspec.Struct, float], DecoderFactory] | None = None
    tick_s: float | None = None
    handshake_s: float | None = None
    rate_hz: float | None = None
    max_rate_hz: float | None = None
    quiet: float = 0.0
    stale_s: float = 1.0
    on_stale: OnStale = "close"
    outgoing: tuple[bytes, ...] = ()
    cost: float = 20.0
    wall_clock: WallClock | None = None
    when_refused: str = ""
    probe: DecoderFactory | None = None
    commands: bool = False
    slowest_s: Callable[[msgspec.Struct, float], float] | None = None
    hazard: str = ""

    def __post_init__(self) -> None:
        if (self.framing is None) == (not self.records):
            raise ValueError(f"protocol {self.name}: it has either a framing or records")
        if self.framing is None and (self.make_reader is None or self.request is not None):
            raise ValueError(f"protocol {self.name}: a text protocol makes its own decoders")

    @property
    def layouts(self) -> tuple[Layout, ...]:
        """Every table of a binary protocol."""
        return tuple(layout for kind in self.framing.kinds for layout in kind.layouts) if self.framing else ()

    @property
    def tables(self) -> tuple[Table, ...]:
        """Every table of the protocol."""
        return self.layouts or self.records

    @property
    def longest(self) -> Table:
        """The table that the others are prefixes of, or the largest."""
        return max(self.layouts, key=lambda layout: layout.size) if self.layouts else self.records[0]

    def reader(self) -> Decoder:
        """Make a decoder that only reads: for recordings, and for streams that are pushed."""
        if self.make_reader is not None:
            return self.make_reader()
        return FramedDecoder(cast("Framing", self.framing))

    def observer(self, options: msgspec.Struct) -> Decoder:
        """Make a decoder that reads a recorded session of a robot with these options: it is told what was sent."""
        if self.make_observer is not None:
            return self.make_observer(options)
        return self.reader() if self.request is None else self.decoder(options)

    def transport(self, options: msgspec.Struct) -> Transport:
        """What a robot with these options is reached over."""
        if getattr(options, "role", "client") == "server":
            return "tcp_server"
        return "udp" if self.udp_port is not None and getattr(options, "transport", "tcp") == "udp" else "tcp"

    def port_of(self, options: msgspec.Struct) -> int | None:
        """The vendor's port for a robot with these options; None: it must be configured."""
        return self.udp_port if self.udp_port is not None and self.transport(options) == "udp" else self.port

    def decoders(self, options: msgspec.Struct, rate_hz: float | None = None) -> DecoderFactory:
        """Make what makes the decoders of one robot, session after session; None: at the protocol's own rate."""
        if self.make_decoders:
            return self.make_decoders(options, rate_hz or self.rate_hz or 0.0)
        return partial(self.decoder, options)

    def decoder(self, options: msgspec.Struct) -> Decoder:
        """Make the decoder of one live session."""
        if self.make_decoders:
            return self.decoders(options)()
        if self.request is None:
            return self.reader()
        return Polled(FramedDecoder(cast("Framing", self.framing)), self.request(options))


@dataclass(frozen=True, slots=True, kw_only=True)
class Vendor:
    """One plugin: everything that the gateway knows of a brand.

    Args:
        name: The name of the plugin's folder.
        title: The brand, for people.
        protocols: Its protocols; the first is the default.
        documents: Kinds of files that `robot-gateway validate` checks; the first is the default.
        exempt: Conformance checks that are skipped, each with the reason.
    """

    name: str
    title: str
    protocols: tuple[Protocol, ...]
    documents: tuple[DocumentType, ...] = ()
    exempt: Mapping[str, str] = field(default_factory=dict)

    def protocol(self, name: str | None = None) -> Protocol:
        """Find a protocol, or the default one.

        Raises:
            KeyError: There is none of that name.
        """
        return self.protocols[0] if name is None else {protocol.name: protocol for protocol in self.protocols}[name]
