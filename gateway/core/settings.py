"""What the core must know of one robot: a plain record that the configuration is resolved into."""

from __future__ import annotations

from dataclasses import dataclass, field
from datetime import tzinfo
from typing import Literal

import msgspec

from gateway.api.vendor import NoOptions, Protocol, Vendor
from gateway.errors import VendorError

EstopPolarity = Literal["active_low", "active_high"]


@dataclass(frozen=True, slots=True, kw_only=True)
class RobotSettings:
    """One robot, ready to run.

    Args:
        name: The first part of its topics.
        host: Address of the controller.
        port: Port of the controller.
        vendor: The plugin.
        protocol: The protocol that is spoken.
        rate_hz: Rate of the requests; None where the controller pushes.
        stale_s: Time without a good frame after which the link is stale.
        clock_zone: Time zone of the controller's own clock; None: not known, so `t_src` stays null.
        estop_polarity: Level of a pressed emergency stop; None: not known, so `e_stopped` stays null.
        io_events: Globs of the inputs and outputs whose changes are events, such as `digital_in.box.3`.
        options: The protocol's own options.
        origin: `sim` for a virtual controller of the demo.
    """

    name: str
    host: str
    port: int
    vendor: Vendor
    protocol: Protocol
    rate_hz: float | None
    stale_s: float
    estop_polarity: EstopPolarity | None = None
    clock_zone: tzinfo | None = None
    io_events: tuple[str, ...] = ()
    options: msgspec.Struct = field(default_factory=NoOptions)
    origin: Literal["live", "sim"] = "live"

    @property
    def signal_options(self) -> dict[str, object]:
        """Everything that a signal row may name as an option."""
        return {"estop_polarity": self.estop_polarity, **msgspec.structs.asdict(self.options)}


@dataclass(frozen=True, slots=True, kw_only=True)
class BrokenRobot:
    """A robot whose plugin could not be loaded: it is shown with the reason, and the others run.

    Args:
        name: The first part of its topics.
        host: Address of the controller.
        vendor: Name of the plugin.
        protocol: Name of the protocol, or "" for the default one.
        error: Why the plugin is of no use.
    """

    name: str
    host: str
    vendor: str
    protocol: str
    error: VendorError


@dataclass(frozen=True, slots=True, kw_only=True)
class ToldRobot:
    """A robot that another gateway reads: what it says of it is all that is known here.

    Args:
        name: The first part of its topics, such as `cell1/r1`.
        vendor: Name of the plugin there.
        protocol: Name of the protocol there.
    """

    name: str
    vendor: str
    protocol: str
