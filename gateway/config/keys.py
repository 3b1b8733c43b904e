"""The keys of the configuration file: their types, limits and defaults, as msgspec structs."""

from __future__ import annotations

import ipaddress
import re
from typing import Annotated

import msgspec
from msgspec import Meta

from gateway.config.problems import quoted
from gateway.core.settings import EstopPolarity

TOP_KEYS = ("vendor_dirs", "server", "recorder", "robots", "export")
STALE_PERIODS = 5  # a link is not called stale before this many answers are missing
PART_PERIODS = 2  # nor a value that comes in turn with others, before this many of its own
STALE_LEAST_S = 0.02

Name = Annotated[
    str,
    Meta(
        pattern=r"^[a-z0-9_-]{1,32}(?!\n)$",
        description="The first part of every topic of the robot.",
        extra={"says": "a name of 1 to 32 characters a-z, 0-9, _ and -, in quotes"},
    ),
]


IoGlob = Annotated[
    str,
    Meta(pattern=r"^(digital_(in|out|\*)|\*)(\.[A-Za-z0-9_*?\[\]-]{1,32}){0,2}(?!\n)$"),
]


HostName = Annotated[str, Meta(pattern=r"^[A-Za-z0-9_][A-Za-z0-9_.-]{0,252}(?!\n)$")]
# As a browser writes it: no path, not even a slash at the end.
WebOrigin = Annotated[str, Meta(pattern=r"^(\*|[A-Za-z][A-Za-z0-9+.-]{0,31}://[^/?#@\s]{1,255})(?!\n)$")]


class Tls(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The table `[server.tls]`: what the listener shows to clients."""

    certificate: Annotated[
        str, Meta(description="File with the certificate and its chain, PEM.", extra={"says": "a file, in quotes"})
    ]
    key: Annotated[
        str, Meta(description="File with its key, PEM, without a password.", extra={"says": "a file, in quotes"})
    ]


class PeerLimits(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The table `[server.limits]`: how much one address may ask for. A proxy is one address."""

    connections: Annotated[int, Meta(ge=1, le=1_000_000, description="Open connections of one address.")] = 1000
    handshakes_per_s: Annotated[
        float,
        Meta(
            ge=0.1,
            le=1_000_000,
            description="Requests of one address in a second; after a rest five seconds' worth at once.",
        ),
    ] = 1000.0
    messages_per_s: Annotated[
        float,
        Meta(
            ge=0.1,
            le=1_000_000,
            description="Messages of one address in a second over all its WebSockets; faster ones are read later.",
        ),
    ] = 2000.0
    subscriptions: Annotated[
        int, Meta(ge=1, le=10_000_000, description="Subscriptions of one address over all its connections.")
    ] = 20_000


class Server(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The table `[server]`: the one listener and what it sends."""

    listen: Annotated[
        str,
        Meta(description="Address and port of the listener. Any but 127.0.0.1, [::1] and localhost needs tokens."),
    ] = "127.0.0.1:8765"
    insecure: Annotated[
        bool, Meta(description="Let everybody who reaches the listener read everything, without a token.")
    ] = False
    tokens: Annotated[
        str | None, Meta(description="File of tokens, as robot-gateway token makes it. Not set: nobody needs one.")
    ] = None
    allowed_hosts: Annotated[
        list[HostName],
        Meta(
            max_length=256,
            description="Names by which browsers reach this machine, besides localhost; addresses need not be named.",
            extra={"says": 'a list of host names such as ["cell.example.com"], without a port'},
        ),
    ] = []
    allowed_origins: Annotated[
        list[WebOrigin],
        Meta(
            max_length=256,
            description="Pages of other sites that may read; with tokens * stands for all.",
            extra={"says": 'a list of origins such as ["https://hmi.example.com:8443"], without a path'},
        ),
    ] = []
    tls: Annotated[Tls | None, Meta(description="Certificate and key. Not set: the doors speak in the clear.")] = None
    limits: PeerLimits = PeerLimits()
    control: Annotated[
        str | None,
        Meta(
            description="Path of the control socket. Not set: in the folder that the service manager or the user has.",
            extra={"says": "a path, in quotes"},
        ),
    ] = None
    flush_ms: Annotated[
        float,
        Meta(ge=0, le=1000, description="How long samples are gathered into one message; 0: one turn of the loop."),
    ] = 2.0
    event_ring: Annotated[
        int, Meta(ge=1, le=10_000_000, description="How many events are kept for subscribers that come back.")
    ] = 10_000
    command_ring: Annotated[
        int, Meta(ge=1, le=10_000_000, description="The same for the command objects and feedbacks of each robot.")
    ] = 20_000

    @property
    def address(self) -> tuple[str, int]:
        """Host and port of `listen`.

        Raises:
            ValueError: It is not written as host:port.
        """
        return split_listen(self.listen)


# The tables below [server], by their keys.
SERVER_TABLES: dict[str, type[msgspec.Struct]] = {"tls": Tls, "limits": PeerLimits}

# What a cell's people want to look into, as a rule.
TRIGGERS = ("fault.raised", "estop.pressed", "collision.detected", "link.lost")

Trigger = Annotated[
    str,
    Meta(
        pattern=r"^[a-z]+\.[a-z_]+(?!\n)$",
        description="Kind of event.",
        extra={"says": 'a kind of event such as "fault.raised"'},
    ),
]


class Recorder(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The table `[recorder]`: what is kept of the last seconds, and when it is written to a file."""

    enabled: Annotated[bool, Meta(description="Whether anything is kept at all.")] = True
    directory: Annotated[
        str,
        Meta(description="Folder of the recordings. Not set: recordings/ in the service's state folder, or none."),
    ] = ""
    on: Annotated[
        list[Trigger], Meta(max_length=64, description="Kinds of events that trigger a recording of the whole cell.")
    ] = msgspec.field(default_factory=lambda: list(TRIGGERS))
    before_s: Annotated[float, Meta(ge=0, le=3600, description="How long before its trigger a recording begins.")] = (
        30.0
    )
    after_s: Annotated[float, Meta(ge=0, le=600, description="How long after its trigger a recording ends.")] = 10.0
    ring_s: Annotated[float, Meta(ge=1, le=3600, description="How long each robot's bytes are kept in memory.")] = 60.0
    ring_mb: Annotated[
        float, Meta(ge=1, le=64_000, description="How many MB of memory that may take, compressed, of all robots.")
    ] = 32.0
    keep_files: Annotated[int, Meta(ge=1, le=1_000_000, description="How many recordings are kept.")] = 100
    keep_mb: Annotated[float, Meta(ge=1, description="How many MB they may take on the disk.")] = 2000.0
    keep_days: Annotated[float, Meta(gt=0, le=36500, description="How old they may become.")] = 90.0


class RobotTable(msgspec.Struct, frozen=True, kw_only=True):
    """One table `[[robots]]`; the options of its protocol stand in a table of the protocol's name below it."""

    name: Name
    vendor: Annotated[str, Meta(description="The plugin that reads the controller.")]
    protocol: Annotated[str | None, Meta(description="What is spoken with the controller.")] = None
    host: Annotated[str, Meta(description="Address or name of the controller, without the port.")]
    port: Annotated[int, Meta(ge=1, le=65535, description="Port of the controller.")] | None = None
    rate_hz: (
        Annotated[float, Meta(ge=0.001, description="How often a polled controller is asked for its state.")] | None
    ) = None
    stale_s: (
        Annotated[
            float,
            Meta(ge=STALE_LEAST_S, le=86400, description="Time without a good frame after which the link is stale."),
        ]
        | None
    ) = None
    clock_zone: Annotated[
        str | None,
        Meta(description="Time zone of the controller's own clock, such as Asia/Seoul. Not set: t_src stays null."),
    ] = None
    estop_polarity: Annotated[
        EstopPolarity | None,
        Meta(description="Level of the input while the emergency stop is pressed. Not set: e_stopped stays null."),
    ] = None
    io_events: Annotated[
        list[IoGlob],
        Meta(
            max_length=256,
            description="Inputs and outputs whose changes are events io.changed; globs may stand.",
            extra={"says": 'a list of inputs and outputs such as ["digital_in.box.3", "digital_out.*"]'},
        ),
    ] = []


def split_listen(listen: str) -> tuple[str, int]:
    """Split `host:port` or `[host]:port`.

    Raises:
        ValueError: It is written otherwise; the text says what is wrong.
    """
    match = re.fullmatch(r"(?:\[([^\[\]]+)\]|([^:\[\]]+)):([0-9]{1,5})", listen, re.ASCII)
    if match is None:
        brackets = '; an IPv6 address stands in brackets: "[::1]:8765"' if listen.count(":") > 1 else ""
        raise ValueError(f'{quoted(listen)} is not an address and a port like "127.0.0.1:8765"{brackets}')
    host, port = match[1] or match[2], int(match[3])
    if port > 65535:  # noqa: PLR2004  ports have 16 bits
        raise ValueError(f"{port} is no port: the highest is 65535")
    if match[1]:
        try:
            ipaddress.IPv6Address(host)
        except ValueError:
            raise ValueError(f"{quoted(host)} is no IPv6 address") from None
    elif fault := host_fault(host):
        raise ValueError(fault)
    return host, port


def is_loopback(host: str) -> bool:
    """Whether only this machine can connect to an address; a name of another kind than localhost never counts."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def canonical(host: str) -> str:
    """A host so that two ways of writing the same one are equal."""
    try:
        return str(ipaddress.ip_address(host))
    except ValueError:
        return host.lower().rstrip(".")


def host_fault(host: str) -> str | None:
    """Say why a text is no IPv4 address, IPv6 address or host name; None if it is one."""
    try:
        ipaddress.ip_address(host)
    except ValueError:
        pass
    else:
        return None
    if "://" in host or "/" in host:
        return f"{quoted(host)} is no host: give the name or address alone"
    if host.startswith("["):
        return f"{quoted(host)} is no host: here an IPv6 address stands without brackets"
    if re.fullmatch(r"[^:]+:[0-9]+", host):
        return f"{quoted(host)} is no host: the port stands under its own key, port"
    if re.fullmatch(r"[0-9.]+", host):
        return f"{quoted(host)} is no IPv4 address"
    if len(host) > 253 or not re.fullmatch(r"(?!-)[\w-]{1,63}(\.[\w-]{1,63})*\.?", host, re.ASCII):  # noqa: PLR2004  DNS
        return f"{quoted(host)} is neither an IP address nor a host name"
    return None
