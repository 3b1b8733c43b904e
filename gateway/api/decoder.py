"""What a decoder is, and what comes out of one: frames, occurrences, skipped frames, rejects and refusals.

Decoders do no I/O: bytes in, events out, bytes owed. One instance serves one session.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal, Protocol, runtime_checkable

import msgspec

from gateway.api.layout import Layout
from gateway.api.model import EventKind, Quality
from gateway.api.record import Record

RefusedKind = Literal["out_of_step", "incompatible", "refused"]
# What explains a frame: a table of bytes, or a table of named values.
Table = Layout | Record


class Frame(msgspec.Struct, frozen=True, gc=False):
    """One delimited unit on the wire that carries state.

    Made once a frame on the hot path, hence a msgspec struct.

    Attributes:
        raw: All bytes of the frame, header and tail included.
        layout: The table that explains its payload.
        start: Where in `raw` the layout's offset 0 is.
        quality: UNCERTAIN where the frame is longer than its layout.
        values: What a record's decoder has parsed, by name: all of its values or some, None where the controller could
            not tell. Empty for a `Layout`, whose readers take them from `raw`.
    """

    raw: bytes
    layout: Table
    start: int = 0
    quality: Quality = Quality.GOOD
    values: Mapping[str, object] = {}

    def __str__(self) -> str:
        return f"Frame({self.layout.name}, {len(self.raw)} bytes)"


class Entry(msgspec.Struct, frozen=True):
    """One thing that has happened, as an event of the robot will tell it.

    Attributes:
        kind: What happened.
        data: A struct of the model.
        raw: The vendor's raw values that it follows from.
    """

    kind: EventKind
    data: object
    raw: dict[str, object] = {}


class Occurrence(msgspec.Struct, frozen=True):
    """A frame that tells what has happened rather than what is: its entries become events of the topic `commands`.

    It moves no deadline: only a `Frame` shows that the state is fresh.
    """

    raw: bytes
    entries: tuple[Entry, ...]

    def __str__(self) -> str:
        return f"Occurrence({len(self.entries)} entries, {len(self.raw)} bytes)"


class Skipped(msgspec.Struct, frozen=True, gc=False):
    """A known frame that carries no state: it moves no deadline and answers no request."""

    raw: bytes
    reason: str

    def __str__(self) -> str:
        return f"Skipped({self.reason}, {len(self.raw)} bytes)"


class Reject(msgspec.Struct, frozen=True, gc=False):
    """Bytes that are no frame.

    Attributes:
        raw: The discarded bytes.
        reason: A short, stable word that counters are kept by.
        detail: What was found and what was expected, for the operator.
    """

    raw: bytes
    reason: str
    detail: str = ""

    def __str__(self) -> str:
        return f"Reject({self.reason}, {len(self.raw)} bytes)"


class Refused(msgspec.Struct, frozen=True, gc=False):
    """The decoder cannot go on with this session.

    Attributes:
        reason: What happened, in words for the operator.
        kind: `out_of_step` (reconnect at once), `incompatible` (no layout explains the frames) or `refused` (login,
            version).
    """

    reason: str
    kind: RefusedKind = "refused"


Event = Frame | Occurrence | Skipped | Reject | Refused


class Decoder(Protocol):
    """Reads one session's bytes."""

    @property
    def ready(self) -> bool:
        """Whether the handshake is done, so that frames may come: a link that hears none says what is missing."""
        ...

    @property
    def notes(self) -> Sequence[str]:
        """What the operator should know of this session, one sentence each: shown in the link."""
        ...

    @property
    def gaps(self) -> int | None:
        """How many frames of this session the controller has numbered and we did not see; None: it tells no number."""
        ...

    def feed(self, data: bytes) -> list[Event]:
        """Take received bytes, cut anywhere, and return what they completed, in wire order.

        The joined `raw` of all events is a prefix of the stream, and the frames are the same however it is cut.
        """
        ...

    def end(self) -> list[Reject]:
        """Return what is left in the buffer when a datagram or the stream ends: it is no frame."""
        ...

    def outgoing(self) -> bytes:
        """Return the bytes owed to the controller now (hello, configuration, acknowledgement): one send each time."""
        ...

    def tick(self) -> bytes | Refused:
        """Return the next request or a retry; called at the protocol's period. b"" where nothing is due."""
        ...

    def goodbye(self) -> bytes:
        """Return the bytes owed before a wanted close."""
        ...


@runtime_checkable
class AskedDecoder(Protocol):
    """A decoder that only reads, of a protocol whose answers do not say what they answer: it is told the questions."""

    def asked(self, data: bytes) -> None:
        """Take the bytes that were sent, one request; what is received from now on answers it."""
        ...
