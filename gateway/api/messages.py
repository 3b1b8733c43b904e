"""The native WebSocket protocol, v1: its messages as structs, for the gateway and for clients.

One object per message; `op` is the tag. Subprotocol `robot-gateway.v1+json` sends text frames,
`robot-gateway.v1+msgpack` binary ones; the messages are the same.
"""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec
from msgspec import Meta

from gateway.api.model import Event, Link, Sample

JSON_SUBPROTOCOL = "robot-gateway.v1+json"
MSGPACK_SUBPROTOCOL = "robot-gateway.v1+msgpack"
PROTOCOL_VERSION = 1
# Offered besides one of these with the token behind it; never the one that the gateway picks.
TOKEN_SUBPROTOCOL = "bearer."  # noqa: S105 - what comes before a token is none

MAX_MESSAGE_BYTES = 65_536
MAX_SUBSCRIPTIONS = 64
MAX_RATE_HZ = 1000.0
MAX_EVENTS = 10_000

Id = Annotated[int | str, Meta(description="Chosen by the client; stands in the answer.")]
Globs = Annotated[list[str], Meta(min_length=1, max_length=256, description="Topic globs: */joints, r1/*.")]
Mode = Literal["latest", "all"]
AccessMode = Literal["loopback", "tokens", "insecure"]
Name = Annotated[str, Meta(description="Name of an event, boot:seq: read on after it.")]
Since = Name | Annotated[list[Name], Meta(min_length=1, max_length=256, description="One name for each ring.")]


class Subscribe(msgspec.Struct, tag_field="op", tag="subscribe", forbid_unknown_fields=True, kw_only=True):
    """Ask for topics until unsubscribed."""

    id: Id
    topics: Globs
    rate_hz: Annotated[float, Meta(gt=0, le=MAX_RATE_HZ, description="At most so often; phase-locked.")] | None = None
    mode: Annotated[Mode, Meta(description="The newest value, or every sample up to a bound.")] = "latest"
    fields: Annotated[list[str], Meta(min_length=1, description="Dotted paths in data: only these.")] | None = None
    since: Since | None = None


class Unsubscribe(msgspec.Struct, tag_field="op", tag="unsubscribe", forbid_unknown_fields=True, kw_only=True):
    """End a subscription."""

    id: Id


class Get(msgspec.Struct, tag_field="op", tag="get", forbid_unknown_fields=True, kw_only=True):
    """Ask for the latest samples, once."""

    id: Id
    topics: Globs


class Events(msgspec.Struct, tag_field="op", tag="events", forbid_unknown_fields=True, kw_only=True):
    """Read events back from the rings."""

    id: Id
    since: Since | None = None
    limit: Annotated[int, Meta(ge=1, le=MAX_EVENTS)] = 1000
    topics: Globs = msgspec.field(default_factory=lambda: ["*"])


class Robots(msgspec.Struct, tag_field="op", tag="robots", forbid_unknown_fields=True, kw_only=True):
    """Ask which robots there are and how their links do."""

    id: Id


class Describe(msgspec.Struct, tag_field="op", tag="describe", forbid_unknown_fields=True, kw_only=True):
    """Ask what a topic holds."""

    id: Id
    topic: str


class Ping(msgspec.Struct, tag_field="op", tag="ping", forbid_unknown_fields=True, kw_only=True):
    """Ask for a sign of life."""

    id: Id


Request = Subscribe | Unsubscribe | Get | Events | Robots | Describe | Ping


class RobotInfo(msgspec.Struct, frozen=True, kw_only=True):
    """One robot as `robots` tells it."""

    name: str
    vendor: str
    protocol: str
    groups: Annotated[list[str], Meta(description="Groups that the robot has as topics.")]
    link: Link
    reject_counts: Annotated[dict[str, int], Meta(description="Rejects by reason since the gateway started.")] = {}
    frames: int = 0
    age: Annotated[
        float | None,
        Meta(description="Age of the last good frame.", extra_json_schema={"unit": "s"}),
    ] = None


class ExportInfo(msgspec.Struct, frozen=True, kw_only=True):
    """One exporter as `robots` tells it to who may see the whole cell."""

    name: Annotated[str, Meta(description="Its table in the configuration, such as nats.")]
    target: Annotated[str, Meta(description="Where it sends, in words; never a secret.")]
    connected: bool
    since: Annotated[
        int, Meta(description="Since when it is, or is not, UTC since 1970.", extra_json_schema={"unit": "µs"})
    ]
    reason: Annotated[str | None, Meta(description="Why it is not connected.")] = None
    waiting_events: Annotated[int, Meta(description="Events in the outbox that nobody has acknowledged.")] = 0
    waiting_bytes: Annotated[int, Meta(description="What they take.", extra_json_schema={"unit": "byte"})] = 0
    oldest: Annotated[float | None, Meta(description="Age of the oldest of them.", extra_json_schema={"unit": "s"})] = (
        None
    )
    sent: Annotated[dict[str, int], Meta(description="Since the start: samples, states, and acknowledged events.")] = {}
    dropped_events: Annotated[int, Meta(description="Events that will never arrive, since the outbox was made.")] = 0
    notes: Annotated[list[str], Meta(description="What the operator should know of it, one sentence each.")] = []


class RecorderInfo(msgspec.Struct, frozen=True, kw_only=True):
    """How the flight recorder does."""

    directory: Annotated[str | None, Meta(description="Where recordings are written; null: nowhere.")] = None
    recording: Annotated[str | None, Meta(description="The file that is being written; null: none is.")] = None
    recordings: Annotated[int, Meta(description="Recordings written since the gateway started.")] = 0
    failed: Annotated[int, Meta(description="Recordings since then that could not be written.")] = 0
    last: Annotated[str | None, Meta(description="The last recording that was written.")] = None
    error: Annotated[str | None, Meta(description="Why the last one could not be written; null: it could.")] = None
    ring_bytes: Annotated[int, Meta(description="Memory that the last seconds of all robots take.")] = 0


class SourceInfo(msgspec.Struct, frozen=True, kw_only=True):
    """Where the value of one key comes from."""

    fields: Annotated[list[str], Meta(description="The vendor's fields or flags.")]
    units: Annotated[list[str | None], Meta(description="Their units in the manual.")]
    quality: Annotated[str, Meta(description="Best quality that the value can have.")] = "GOOD"


class Description(msgspec.Struct, frozen=True, kw_only=True):
    """What a topic holds."""

    topic: str
    delivery: Literal["sample", "state", "event"]
    schema: Annotated[dict[str, object], Meta(description="JSON Schema of data, with units.")]
    sources: Annotated[dict[str, SourceInfo], Meta(description="By key: what it follows from.")] = {}
    never: Annotated[list[str], Meta(description="Keys that this vendor can never tell: always null.")] = []


class Limits(msgspec.Struct, frozen=True, kw_only=True):
    """What one connection may ask for."""

    message_bytes: int = MAX_MESSAGE_BYTES
    subscriptions: int = MAX_SUBSCRIPTIONS
    rate_hz: float = MAX_RATE_HZ
    queued_samples: int
    queued_events: int


class Welcome(msgspec.Struct, tag_field="op", tag="welcome", frozen=True, kw_only=True):
    """The first message of the gateway."""

    protocol: int = PROTOCOL_VERSION
    gateway: Annotated[str, Meta(description="Version of the gateway.")]
    robots: list[str]
    last_event: Annotated[str, Meta(description="Name of the newest event.")]
    limits: Limits
    access: Annotated[
        AccessMode,
        Meta(description="Who is let in: programs of this machine, who has a token, or everybody without one."),
    ] = "loopback"


class Data(msgspec.Struct, tag_field="op", tag="data", frozen=True, kw_only=True):
    """Everything due for this client now; in order per topic."""

    samples: list[Sample]


class EventMessage(msgspec.Struct, tag_field="op", tag="event", frozen=True, kw_only=True):
    """Events, in order."""

    events: list[Event]


class Missed(msgspec.Struct, tag_field="op", tag="missed", frozen=True, kw_only=True):
    """What this client asked for and did not get."""

    samples: Annotated[dict[str, int], Meta(description="By topic: coalesced away or over the bound.")] = {}
    events: Annotated[int | None, Meta(description="Gone from the ring; null: their number is not known.")] = 0


class Result(msgspec.Struct, tag_field="op", tag="result", frozen=True, kw_only=True, omit_defaults=True):
    """The answer to a request; which of the parts is there follows from the request."""

    id: int | str
    topics: Annotated[list[str], Meta(description="subscribe: the topics that match now.")] | None = None
    last_events: (
        Annotated[list[str], Meta(description="subscribe: the newest event of each ring that the topics have.")] | None
    ) = None
    samples: Annotated[list[Sample], Meta(description="get.")] | None = None
    events: Annotated[list[Event], Meta(description="events.")] | None = None
    missed: Annotated[int, Meta(description="events: how many are gone; -1: their number is not known.")] | None = None
    robots: Annotated[list[RobotInfo], Meta(description="robots.")] | None = None
    exports: Annotated[list[ExportInfo], Meta(description="robots: where the cell is sent besides.")] | None = None
    recorder: Annotated[RecorderInfo, Meta(description="robots: where there is one and all may be seen.")] | None = None
    description: Annotated[Description, Meta(description="describe.")] | None = None
    t: Annotated[int, Meta(description="ping: the gateway's UTC time.", extra_json_schema={"unit": "µs"})] | None = None


class Error(msgspec.Struct, tag_field="op", tag="error", frozen=True, kw_only=True):
    """A request was refused; nothing else has changed."""

    id: int | str | None = None
    code: Annotated[str, Meta(description="Stable: BAD_MESSAGE, UNKNOWN_TOPIC, UNKNOWN_FIELD, BAD_REQUEST, TOO_MUCH.")]
    message: Annotated[str, Meta(description="What is wrong and what to do.")]


Response = Welcome | Data | EventMessage | Missed | Result | Error
