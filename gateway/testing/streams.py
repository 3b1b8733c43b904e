"""Streams for the checks: how they are cut, what comes out of them and where it stood."""

from __future__ import annotations

import random
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

from gateway.api.decoder import Decoder, Event, Frame, Occurrence, Refused, Reject, Skipped
from gateway.api.framing import Framing
from gateway.api.layout import TYPES
from gateway.testing.subject import CheckFailed

# A damaged byte: all bits, the lowest, the highest, and one more.
DAMAGES = (0xFF, 0x01, 0x80, None)
BITS = tuple(1 << bit for bit in range(8))


@dataclass(frozen=True, slots=True)
class Placed:
    """An event and where its bytes stood in the stream."""

    start: int
    event: Frame | Occurrence | Skipped | Reject

    @property
    def end(self) -> int:
        """The first byte behind it."""
        return self.start + len(self.event.raw)


def feed_all(decoder: Decoder, chunks: Iterable[bytes]) -> list[Event]:
    """Feed chunks one after the other."""
    return [event for chunk in chunks for event in decoder.feed(chunk)]


def placed(events: Iterable[Event]) -> list[Placed]:
    """Where each event's bytes stood, by byte conservation."""
    found, at = [], 0
    for event in events:
        if isinstance(event, Refused):
            continue
        found.append(Placed(at, event))
        at += len(event.raw)
    return found


def frames(events: Iterable[Event]) -> list[Frame]:
    """Only the frames."""
    return [event for event in events if isinstance(event, Frame)]


def cuts(data: bytes, chance: random.Random) -> Iterator[tuple[str, list[bytes]]]:
    """Ways to cut a stream: whole, byte by byte, and several at random."""
    yield "whole", [data]
    yield "byte by byte", [data[at : at + 1] for at in range(len(data))]
    for largest in (3, 50, 700, 3000):
        yield f"in random pieces of up to {largest} bytes", list(_pieces(data, largest, chance))


def damaged(raw: bytes, at: int, damage: int | None) -> bytes:
    """A copy with one byte changed."""
    byte = (raw[at] + 1) & 0xFF if damage is None else raw[at] ^ damage
    return raw[:at] + bytes((byte,)) + raw[at + 1 :]


def structure(framing: Framing, raw: bytes) -> frozenset[int]:
    """The bytes of a frame that say where it begins and ends: magic, length, type, checksum and tail."""
    spans = [range(len(framing.magic)), range(framing.length_at, framing.length_at + TYPES[framing.length_type][2])]
    behind = len(framing.tail) + (TYPES[framing.checksum.type][2] if framing.checksum else 0)
    spans.append(range(len(raw) - behind, len(raw)))
    if framing.type_at is not None:
        spans.append(range(framing.type_at, framing.type_at + 1))
    return frozenset(at for span in spans for at in span)


def check_conserved(
    stream: bytes, events: Sequence[Event], left: Sequence[Reject], how: str, *, blank: bool = False
) -> None:
    """Check that no byte is lost, doubled or moved.

    Args:
        stream: What was fed.
        events: What came out.
        left: What was left at the end.
        how: How it was fed.
        blank: Whether white space at the end of the stream may be left out: what ends an answer, or does not.

    Raises:
        CheckFailed: The joined `raw` is not the stream.
    """
    joined = b"".join(event.raw for event in (*events, *left) if not isinstance(event, Refused))
    if joined == stream or (blank and stream.startswith(joined) and not stream[len(joined) :].strip()):
        return
    same = next(
        (at for at, (a, b) in enumerate(zip(joined, stream, strict=False)) if a != b), min(len(joined), len(stream))
    )
    raise CheckFailed(
        f"fed {how}, the events hold {len(joined)} bytes of a stream of {len(stream)} and differ from byte {same} on: "
        "put every byte into the `raw` of exactly one event, in wire order, and what is left into end()",
    )


def pending(decoder: Decoder) -> int:
    """How many bytes a decoder says it keeps; 0 where it does not say."""
    found: object = getattr(decoder, "pending", 0)
    return found if isinstance(found, int) else 0


def _pieces(data: bytes, largest: int, chance: random.Random) -> Iterator[bytes]:
    at = 0
    while at < len(data):
        size = chance.randint(1, largest)
        yield data[at : at + size]
        at += size
