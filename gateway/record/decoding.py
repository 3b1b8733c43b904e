"""Decodes conversations: every frame and every reject with its place, and the values of the frames."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Literal

import msgspec

from gateway.api.decoder import AskedDecoder, Decoder, Event, Frame, Occurrence, Refused, Reject, Skipped
from gateway.api.model import Quality
from gateway.api.normaliser import Normaliser
from gateway.api.vendor import Protocol
from gateway.record.mcapfile import Mark
from gateway.record.pieces import Conversation, Piece
from gateway.record.reading import Recording

_MARK = msgspec.json.Decoder(Mark)
RowKind = Literal["frame", "occurrence", "skipped", "reject", "refused", "sent", "failed"]
_OPENS = {"begin", "opening"}


@dataclass(frozen=True, slots=True)
class Row:
    """One thing that a decoder has found.

    Attributes:
        offset: Where its first byte stands in what was received in the conversation.
        t: When its last byte was received, µs UTC; None: the file does not say.
        kind: What it is. `sent`: what was sent cannot be understood; `failed`: the plugin has.
        size: How many bytes it has.
        name: A frame's table, or why a reject is one.
        detail: More, in words.
        frame: The frame itself, or None.
    """

    offset: int
    t: int | None
    kind: RowKind
    size: int
    name: str
    detail: str = ""
    frame: Frame | None = None


@dataclass(slots=True)
class Found:
    """What was found in a conversation.

    Attributes:
        counts: Rows by kind.
        rejects: Rejects by reason.
        n_received: Bytes received.
        n_explained: Those of them that frames and rejects hold.
    """

    counts: Counter[str] = field(default_factory=Counter)
    rejects: Counter[str] = field(default_factory=Counter)
    n_received: int = 0
    n_explained: int = 0


class Decoding:
    """Reads one conversation.

    Args:
        conversation: What was said.
        make: Makes a decoder that only reads, for each session.

    Attributes:
        found: What was found so far.
    """

    def __init__(self, conversation: Conversation, make: Callable[[], Decoder]) -> None:
        self._conversation = conversation
        self._make = make
        self._decoder: Decoder | None = None
        self._offset = 0
        self.found = Found()

    def rows(self) -> Iterator[Row]:
        """Everything that its decoder finds, in order; a plugin that fails costs the rest of a session."""
        for piece in self._conversation.pieces:
            try:
                yield from self._take(piece)
            except Exception as error:  # noqa: BLE001 - it is a plugin that is judged here
                self._decoder = None
                yield self._count(Row(self._offset, piece.t, "failed", 0, type(error).__name__, f"{error!r}"))

    def _take(self, piece: Piece) -> Iterator[Row]:
        if piece.kind == "begin":
            yield from self._end(piece)
            self._decoder = self._make()
        elif piece.kind == "missing" or piece.kind == "end":  # noqa: PLR1714 - so that mypy follows
            yield from self._end(piece)
        elif piece.kind == "sent":
            yield from self._asked(piece)
        else:
            self.found.n_received += len(piece.data)
            if self._decoder is None:
                return
            yield from self._rows(self._decoder.feed(piece.data), piece)
            if self._conversation.datagrams:
                yield from self._rows(self._decoder.end(), piece)

    def _asked(self, piece: Piece) -> Iterator[Row]:
        decoder: object = self._decoder
        if not isinstance(decoder, AskedDecoder):
            return
        try:
            decoder.asked(piece.data)
        except ValueError as error:
            yield self._count(Row(self._offset, piece.t, "sent", 0, "unknown", str(error)))

    def _end(self, piece: Piece) -> Iterator[Row]:
        """A session, or an unbroken stretch of it, is over: what is left is no frame."""
        if self._decoder is not None:
            yield from self._rows(self._decoder.end(), piece)
        self._offset = self.found.n_received

    def _rows(self, events: Collection[Event], piece: Piece) -> Iterator[Row]:
        for event in events:
            raw = b"" if isinstance(event, Refused) else event.raw
            row = _row(event, self._offset, piece.t, len(raw))
            self._offset += len(raw)
            self.found.n_explained += len(raw)
            yield self._count(row)

    def _count(self, row: Row) -> Row:
        self.found.counts[row.kind] += 1
        if row.kind == "reject":
            self.found.rejects[row.name] += 1
        return row


def _row(event: Event, offset: int, t: int | None, size: int) -> Row:
    if isinstance(event, Frame):
        detail = "" if event.quality is Quality.GOOD else f"q {event.quality.value}"
        return Row(offset, t, "frame", size, event.layout.name, detail, event)
    if isinstance(event, Reject):
        return Row(offset, t, "reject", size, event.reason, event.detail)
    if isinstance(event, Skipped):
        return Row(offset, t, "skipped", size, event.reason)
    if isinstance(event, Occurrence):
        kinds = Counter(entry.kind.value for entry in event.entries)
        return Row(offset, t, "occurrence", size, ", ".join(f"{count} {kind}" for kind, count in kinds.items()))
    return Row(offset, t, "refused", 0, event.kind, event.reason)


class Values:
    """Reads the values of frames.

    Args:
        protocol: Whose frames they are.
        options: What signal rows may name as options.
        groups: Which groups are read; empty: all canonical ones.
    """

    def __init__(self, protocol: Protocol, options: Mapping[str, object], groups: Collection[str] = ()) -> None:
        self._normaliser = Normaliser(protocol.signals, options)
        self._groups = set(groups)

    @property
    def groups(self) -> list[str]:
        """The groups that such frames have."""
        return list(self._normaliser.groups)

    def read(self, frame: Frame) -> dict[str, object]:
        """The values of a frame as plain values, by group."""
        readers = self._normaliser.readers(frame.layout)
        wanted = self._groups or readers.keys() - {"vendor"}
        return {
            group: msgspec.to_builtins(reader.read(frame)[0]) for group, reader in readers.items() if group in wanted
        }


def recorded_pieces(recording: Recording, robot: str) -> Iterator[Piece]:
    """What a robot of a recording received and sent."""
    topics = [f"{robot}/raw/received", f"{robot}/raw/sent", f"{robot}/session"]
    for entry in recording.entries(topics):
        kind = entry.topic.rpartition("/")[2]
        if kind == "received":
            yield Piece("received", entry.data, entry.t)
        elif kind == "sent":
            yield Piece("sent", entry.data, entry.t)
        else:
            mark = _MARK.decode(entry.data)
            if mark.kind in _OPENS:
                yield Piece("begin", t=entry.t)
            elif mark.kind == "end":
                yield Piece("end", t=entry.t)
    yield Piece("end")
